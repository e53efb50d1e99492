"""HTTP/1.1 for strangers: a connection whose request does not come, or whose body does not end, is closed.

The bodies of requests that are served have a bound of their own, in `server.api.guards`.
"""

import asyncio
from typing import ClassVar, Final

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

LINGER_S: Final = 5.0
"""How long the rest of a body is read and dropped whose request was answered: so that the answer is not cut off."""


class Impatient(H11Protocol):
    """A connection that waits only so long for the head of a request.

    Attributes:
        stall_s: How long.
    """

    stall_s: ClassVar[float]
    _due: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for the first request."""
        super().connection_made(transport)
        self._wait_for_a_head()

    def data_received(self, data: bytes) -> None:
        """Wait on, unless the head is there."""
        super().data_received(data)
        self._wait_for_a_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no more."""
        self._wait_no_more()
        super().connection_lost(exc)

    def on_response_complete(self) -> None:
        """Wait for the rest of a head that has begun; for a while, drop what comes of a body that nobody reads."""
        super().on_response_complete()
        begun, _ = self.conn.trailing_data
        if begun:
            self._wait_for_a_head()
        if self.conn.their_state is h11.SEND_BODY:
            self.loop.call_later(LINGER_S, self._close_unless_it_ended, self.cycle)

    def _wait_for_a_head(self) -> None:
        if self.conn.their_state is not h11.IDLE:
            self._wait_no_more()
        elif self._due is None:
            self._due = self.loop.call_later(self.stall_s, self.transport.close)

    def _wait_no_more(self) -> None:
        if self._due is not None:
            self._due.cancel()
            self._due = None

    def _close_unless_it_ended(self, answered: object) -> None:
        if self.cycle is answered and self.conn.their_state is h11.SEND_BODY:
            self.transport.close()


def impatient(stall_s: float) -> type[Impatient]:
    """Return the protocol with a bound of so many seconds."""
    return type("BoundImpatient", (Impatient,), {"stall_s": stall_s})
