"""HTTP/1.1 with a request timeout: connections whose request does not arrive in time are closed.

The bodies of requests that are being served have their own timeout, in `brink.server.api.middleware`.
"""

import asyncio
from typing import ClassVar, Final

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

LINGER_S: Final = 5.0
"""How long the rest of a body is discarded after an early response, so that the client can read the response."""
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

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start the timer for the first request."""
        super().connection_made(transport)
        self._update_timer()

    def data_received(self, data: bytes) -> None:
        """Process data, then restart or stop the timer."""
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

    def on_message_complete(self) -> None:
        """Record that a body has ended."""
        self._body_open = False
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """Start the timer for a head that has begun; discard an unread body for a limited time."""
        super().on_response_complete()
        if self._head_open:
            self._update_timer()
        if self._body_open:
            self.loop.call_later(LINGER_S, self._close_unless_ended, self.cycle)

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

    def _close_unless_ended(self, finished: object) -> None:
        if self.cycle is finished and self._body_open:
            self.transport.close()


def protocol_with_timeout(stall_s: float) -> type[TimeoutProtocol]:
    """Return the protocol class with a time limit in seconds."""
    return type("ConfiguredTimeoutProtocol", (TimeoutProtocol,), {"stall_s": stall_s})
