"""HTTP/1.1 for strangers: a connection whose request does not come, or whose body does not end, is closed.

The bodies of requests that are served have a bound of their own, in `brink.server.api.middleware`.
"""

import asyncio
from typing import ClassVar, Final

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

LINGER_S: Final = 5.0
"""How long the rest of a body is read and dropped whose request was answered: so that the answer is not cut off."""
MAX_HEAD_BYTES: Final = 64 * 1024
_TOO_LARGE: Final = (
    b"HTTP/1.1 431 Request Header Fields Too Large\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
)


class Impatient(HttpToolsProtocol):
    """A connection that waits only so long for the head of a request, and takes only so much of it.

    Attributes:
        stall_s: How long.
    """

    stall_s: ClassVar[float]
    _due: asyncio.TimerHandle | None = None
    _head_open = False
    _head_bytes = 0
    _body_open = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for the first request."""
        super().connection_made(transport)
        self._look()

    def data_received(self, data: bytes) -> None:
        """Wait on, unless the head is there."""
        super().data_received(data)
        self._head_bytes = self._head_bytes + len(data) if self._head_open else 0
        if self._head_bytes > MAX_HEAD_BYTES and not self.transport.is_closing():
            self.transport.write(_TOO_LARGE)
            self.transport.close()
        self._look()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no more."""
        self._wait_no_more()
        super().connection_lost(exc)

    def on_message_begin(self) -> None:
        """Note that a head has begun."""
        self._head_open = True
        super().on_message_begin()

    def on_headers_complete(self) -> None:
        """Note that a head has ended."""
        self._head_open, self._body_open = False, True
        super().on_headers_complete()

    def on_message_complete(self) -> None:
        """Note that a body has ended."""
        self._body_open = False
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """Wait for the rest of a head that has begun; for a while, drop what comes of a body that nobody reads."""
        super().on_response_complete()
        if self._head_open:
            self._look()
        if self._body_open:
            self.loop.call_later(LINGER_S, self._close_unless_it_ended, self.cycle)

    def _look(self) -> None:
        served = self.cycle is not None and not self.cycle.response_complete
        if not self._head_open and (self._body_open or served):
            self._wait_no_more()
        elif self._due is None:
            self._due = self.loop.call_later(self.stall_s, self.transport.close)

    def _wait_no_more(self) -> None:
        if self._due is not None:
            self._due.cancel()
            self._due = None

    def _close_unless_it_ended(self, answered: object) -> None:
        if self.cycle is answered and self._body_open:
            self.transport.close()


def impatient(stall_s: float) -> type[Impatient]:
    """Return the protocol with a bound of so many seconds."""
    return type("BoundImpatient", (Impatient,), {"stall_s": stall_s})
