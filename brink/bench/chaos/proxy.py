"""A network that loses, repeats, delays and cuts messages, between workers and any of several coordinators."""

import asyncio
import random
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from brink.bench.chaos.ledger import Ledger

KINDS = (
    "request lost", "reply lost", "reply cut short", "request repeated", "request repeated late",
    "request delayed", "reply delayed", "answered 503",
)  # fmt: skip
LATE_S = (1.0, 8.0)
DELAY_S = (0.1, 5.0)
_END = b"\r\n\r\n"
_BUSY = b"HTTP/1.1 503 Service Unavailable\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"


@dataclass(frozen=True, slots=True)
class _Message:
    head: bytes
    body: bytes

    @property
    def raw(self) -> bytes:
        return self.head + self.body


class FaultyProxy:
    """Forwards HTTP/1.1 messages, and breaks a share of them.

    Args:
        ports: Where coordinators listen on this machine; each request goes to one of them, by chance.
        ledger: Gets what coordinators say of results, heard by the worker or not.
        share: Share of the requests that something happens to.
        rng: Decides.
    """

    def __init__(self, ports: Sequence[int], ledger: Ledger, *, share: float, rng: random.Random) -> None:
        self.faults: Counter[str] = Counter()
        self.requests = 0
        self.share = share
        self._ports = tuple(ports)
        self._ledger = ledger
        self._rng = rng
        self._late: set[asyncio.Task[_Message | None]] = set()
        self._server: asyncio.Server | None = None

    @property
    def url(self) -> str:
        """Where workers find it."""
        assert self._server is not None
        return f"http://127.0.0.1:{self._server.sockets[0].getsockname()[1]}"

    async def __aenter__(self) -> "FaultyProxy":
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._server is not None
        self._server.close()
        for task in self._late:
            task.cancel()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while True:
                answer, goes_on = await self._answer(await _read(reader))
                writer.write(answer)
                await writer.drain()
                if not goes_on:
                    return
        except (OSError, asyncio.IncompleteReadError, asyncio.CancelledError):
            return  # the worker has gone, or the trial is over
        finally:
            writer.close()

    async def _answer(self, request: _Message) -> tuple[bytes, bool]:
        """Return what the worker gets, and whether its connection goes on."""
        self.requests += 1
        fault = self._rng.choice(KINDS) if self._rng.random() < self.share else None
        if fault is not None:
            self.faults[fault] += 1
        match fault:
            case "request lost":
                return b"", False
            case "answered 503":
                return _BUSY, False
            case "request delayed":
                await asyncio.sleep(self._rng.uniform(*DELAY_S))
            case "request repeated late":
                self._forward_late(request)
            case _:
                pass
        reply = await self._forward(request)
        if fault == "request repeated":
            again = await self._forward(request)
            reply = self._rng.choice((reply, again))
        if reply is None:
            return b"", False
        match fault:
            case "reply lost":
                return b"", False
            case "reply cut short":
                return reply.raw[: self._rng.randrange(len(reply.raw))], False
            case "reply delayed":
                await asyncio.sleep(self._rng.uniform(*DELAY_S))
            case _:
                pass
        return reply.raw, True

    def _forward_late(self, request: _Message) -> None:
        async def forward() -> _Message | None:
            await asyncio.sleep(self._rng.uniform(*LATE_S))
            return await self._forward(request)

        task = asyncio.create_task(forward())
        self._late.add(task)
        task.add_done_callback(self._late.discard)

    async def _forward(self, request: _Message) -> _Message | None:
        """Pass a request on to a coordinator; None if none answers."""
        try:
            reader, writer = await asyncio.open_connection("127.0.0.1", self._rng.choice(self._ports))
        except OSError:
            return None
        try:
            writer.write(request.raw)
            reply = await _read(reader)
        except (OSError, asyncio.IncompleteReadError):
            return None
        finally:
            writer.close()
        if (
            b"/jobs/results " in request.head.partition(b"\r\n")[0]
            and b" 200 " in reply.head.partition(b"\r\n")[0]
        ):
            self._ledger.note(request.body, reply.body)
        return reply


async def _read(reader: asyncio.StreamReader) -> _Message:
    head = await reader.readuntil(_END)
    length = 0
    for line in head.split(b"\r\n"):
        name, _, value = line.partition(b":")
        if name.lower() == b"content-length":
            length = int(value)
    return _Message(head, await reader.readexactly(length))
