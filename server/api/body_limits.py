"""The limits on request bodies: how large, how many JSON values, and how long they may take to arrive.

All limits are enforced while a body arrives, so that a refused body is neither kept in memory nor parsed. JSON values
are counted without parsing: each value but the first one follows a comma or an opening bracket outside of strings.
Parsed, a value can take fifty times the memory of its text, and a parser runs without giving way to other requests.
"""

import asyncio
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from starlette.types import Message, Receive

MIN_BODY_BYTES_PER_S: Final = 10_000.0
"""Average rate at which a body must arrive once it takes longer than the request timeout."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BodyLimit:
    """The limit on the bodies of one route.

    Attributes:
        max_bytes: Largest body.
        max_values: Largest number of JSON values in it.
    """

    max_bytes: int
    max_values: int

    def words(self) -> str:
        """Describe the limit on a body."""
        return f"expected at most {self.max_bytes} bytes and {self.max_values} JSON values"


_SLICE_BYTES: Final = 64 * 1024
"""Text looked at in one go; bounds the memory for a text of nothing but quotation marks."""


class ValueCounter:
    """Counts the values of a JSON text that arrives in parts, without parsing it.

    It only has to be right up to the first error of the text, where a parser stops.

    Attributes:
        values: Number of commas and opening brackets outside of strings so far.
    """

    def __init__(self) -> None:
        self.values = 0
        self._in_string = False
        self._held = b""
        self._is_wide = False

    def add(self, part: bytes) -> None:
        """Count the values of the next part."""
        for start in range(0, len(part), _SLICE_BYTES):
            self._add(part[start : start + _SLICE_BYTES])

    def _add(self, part: bytes) -> None:
        # In UTF-16 and UTF-32, which json.loads reads as well, quotation marks cannot be told from escaped ones here.
        self._is_wide = self._is_wide or b"\0" in part
        if self._is_wide:
            self.values += _structure(part)
            return
        text = self._held + part
        if b"\\" in text:
            text = text.replace(b"\\\\", b"").replace(b'\\"', b"")
        self._held = text[-1:] if text.endswith(b"\\") else b""  # the next part begins with what it escapes
        pieces = text.split(b'"')
        self.values += _structure(b"".join(pieces[int(self._in_string) :: 2]))
        self._in_string ^= len(pieces) % 2 == 0


def _structure(text: bytes) -> int:
    return text.count(b",") + text.count(b"[") + text.count(b"{")


DEFAULT_LIMIT: Final = BodyLimit(max_bytes=4 * 1024 * 1024, max_values=100_000)
"""Campaigns and everything else that people send. A campaign may give a thousand solutions to start from."""
LIMITS: Final[Mapping[str, BodyLimit]] = {
    "/api/v1/jobs/lease": BodyLimit(max_bytes=256 * 1024, max_values=2_000),
    "/api/v1/jobs/heartbeat": BodyLimit(max_bytes=256 * 1024, max_values=2_000),
    # Results carry traces, and what simulators record.
    "/api/v1/jobs/results": BodyLimit(max_bytes=64 * 1024 * 1024, max_values=100_000),
}
"""Limits of paths that differ from `DEFAULT_LIMIT`."""


def body_limit(path: str, max_bytes: int) -> BodyLimit:
    """Return the limit on the bodies of a path.

    Args:
        path: The path.
        max_bytes: Largest body of any path, in bytes.
    """
    limit = LIMITS.get(path, DEFAULT_LIMIT)
    return BodyLimit(max_bytes=min(limit.max_bytes, max_bytes), max_values=limit.max_values)


class LimitedBody:
    """A request body that looks like a disconnect once it exceeds its limit or takes too long to arrive.

    Args:
        receive: Returns the next part of the body.
        limit: The limit.
        stall_s: How long the body may take to arrive, unless it is large.
    """

    def __init__(self, receive: Receive, limit: BodyLimit, stall_s: float) -> None:
        self._receive = receive
        self._limit = limit
        self._received_bytes = 0
        self._counter = ValueCounter()
        self._ended = False
        self._began_s = time.monotonic()
        self._stall_s = stall_s
        self.late = False
        """Whether the body took too long to arrive."""

    @property
    def exceeded(self) -> bool:
        """Whether the body is larger than the limit."""
        return self._received_bytes > self._limit.max_bytes or self._counter.values > self._limit.max_values

    async def receive(self) -> Message:
        """Return the next part of the body; after the last one, wait for the client to disconnect."""
        if self.exceeded:
            return {"type": "http.disconnect"}
        if self._ended:
            return await self._receive()
        due_s = self._began_s + self._stall_s + self._received_bytes / MIN_BODY_BYTES_PER_S
        try:
            async with asyncio.timeout(max(0.0, due_s - time.monotonic())):
                message = await self._receive()
        except TimeoutError:
            self.late = True
            return {"type": "http.disconnect"}
        part: bytes = message.get("body", b"")
        self._received_bytes += len(part)
        self._counter.add(part)
        self._ended = not message.get("more_body", False)
        return {"type": "http.disconnect"} if self.exceeded else message
