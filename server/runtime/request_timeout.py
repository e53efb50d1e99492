"""HTTP/1.1 with a request timeout: connections whose request does not arrive in time are closed.

The bodies of requests that are being served have their own timeout, in `brink.server.api.body_limits`.

A response may be complete while the client still sends the body, for example if the body is too large. Closing a
connection with unread data resets it, and clients that send everything before they read would never see the response.
So the rest of the body is read and discarded for a limited time, as nginx does (``lingering_close``).

The head of a response and the beginning of its body are sent in one write.
"""

import asyncio
from collections.abc import Callable
from typing import ClassVar, Final

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

LINGER_S: Final = 5.0
"""Time limit for the next part of a body after the response."""
MAX_LINGER_S: Final = 30.0
"""Time limit for all of it."""
MAX_HEAD_BYTES: Final = 64 * 1024
_TOO_LARGE: Final = (
    b"HTTP/1.1 431 Request Header Fields Too Large\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
)


class TimeoutProtocol(HttpToolsProtocol):
    """A connection with a time limit and a size limit for the head of each request.

    Attributes:
        stall_s: Time limit in seconds.
    """

    stall_s: ClassVar[float]
    _timer: asyncio.TimerHandle | None = None
    _head_open = False
    _head_bytes = 0
    _body_open = False
    _discarding = False
    _received_s = 0.0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start the timer for the first request."""
        super().connection_made(transport)
        self._update_timer()

    def data_received(self, data: bytes) -> None:
        """Process data, then restart or stop the timer."""
        self._received_s = self.loop.time()
        if self._discarding:
            return
        super().data_received(data)
        self._head_bytes = self._head_bytes + len(data) if self._head_open else 0
        if self._head_bytes > MAX_HEAD_BYTES and not self.transport.is_closing():
            self.transport.write(_TOO_LARGE)
            self.transport.close()
        self._update_timer()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the timer."""
        self._stop_timer()
        super().connection_lost(exc)

    def on_message_begin(self) -> None:
        """Record that a head has begun."""
        self._head_open = True
        super().on_message_begin()

    def on_headers_complete(self) -> None:
        """Record that a head has ended."""
        self._head_open, self._body_open = False, True
        super().on_headers_complete()
        if self.cycle is not None:
            self.cycle.transport = ResponseTransport(self.transport, self.close_after_response, self.loop)

    def on_message_complete(self) -> None:
        """Record that a body has ended."""
        self._body_open = False
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """Start the timer for a head that has begun; discard an unread body for a limited time."""
        super().on_response_complete()
        if self._head_open:
            self._update_timer()
        if self._body_open and not self._discarding:
            self._linger(self.cycle, self.loop.time() + MAX_LINGER_S)

    def close_after_response(self) -> None:
        """Close the connection for the client to read; discard an unread body for a limited time before that."""
        if not self._body_open:
            self.transport.close()
            return
        self._discarding = True
        self.flow.resume_reading()
        if self.transport.can_write_eof():
            self.transport.write_eof()
        self._linger(self.cycle, self.loop.time() + MAX_LINGER_S)

    def _linger(self, finished: object, end_s: float) -> None:
        """Wait for the rest of a body; close the connection once it is overdue.

        Args:
            finished: The exchange that it belongs to.
            end_s: When it must have ended, in the loop's time.
        """
        if self.transport.is_closing() or self.cycle is not finished or not self._body_open:
            return
        due_s = min(end_s, max(self._received_s, end_s - MAX_LINGER_S) + LINGER_S)
        if self.loop.time() >= due_s:
            self.transport.close()
        else:
            self.loop.call_at(due_s, self._linger, finished, end_s)

    def _update_timer(self) -> None:
        served = self.cycle is not None and not self.cycle.response_complete
        if not self._head_open and (self._body_open or served):
            self._stop_timer()
        elif self._timer is None:
            self._timer = self.loop.call_later(self.stall_s, self.transport.close)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


class ResponseTransport(asyncio.Transport):
    """The transport that a response writes to.

    The head and the beginning of the body are sent in one write, which wakes the client once instead of twice. The
    connection ends only after the client could read the response.

    Args:
        transport: The connection's transport.
        close: Ends the connection.
        loop: The event loop.
    """

    def __init__(
        self, transport: asyncio.Transport, close: Callable[[], None], loop: asyncio.AbstractEventLoop
    ) -> None:
        super().__init__()
        self._transport = transport
        self._close = close
        self._loop = loop
        self._head: bytes | bytearray | memoryview | None = None
        self._has_begun = False

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Send data; the first data waits for more, until the event loop's next iteration at the latest."""
        if not self._has_begun:
            self._has_begun = True
            self._head = data
            self._loop.call_soon(self._send_head)
        elif self._head is not None:
            head, self._head = self._head, None
            # Only the head if the body is empty: some event loops never finish sending an empty buffer.
            self._transport.writelines([head, data] if data else [head])
        else:
            self._transport.write(data)

    def close(self) -> None:
        """End the connection."""
        self._send_head()
        self._close()

    def _send_head(self) -> None:
        head, self._head = self._head, None
        if head is not None and not self._transport.is_closing():
            self._transport.write(head)

    def is_closing(self) -> bool:
        """Return whether the connection has ended or is about to."""
        return self._transport.is_closing()


def protocol_with_timeout(stall_s: float) -> type[TimeoutProtocol]:
    """Return the protocol class with a time limit in seconds."""
    return type("ConfiguredTimeoutProtocol", (TimeoutProtocol,), {"stall_s": stall_s})
