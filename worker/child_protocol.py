"""The protocol between a worker and its simulation process: frames of JSON on two pipes.

A frame is a length (four bytes, big-endian) and that many bytes of JSON. The process sends one `Hello` once its
simulators are imported. The worker may then send any number of `RunEpisode` messages ahead, and the process answers
each with one `EpisodeReply`, in order. The outcome in a reply is a `brink.worker.wire.Completed` or `JobFailed` as
plain JSON.

Both sides import this module, so it needs nothing but the standard library: pydantic would add 11 MB to every
simulation process. The worker validates what it reads; the process trusts its worker.
"""

import base64
import json
import math
import os
import struct
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

from brink.sim.episode import EpisodeResult, Json, JsonObject
from brink.worker.errors import BrokenFrame, UnserializableResult

MAX_FRAME_BYTES = 64 * 1024 * 1024
MAX_MESSAGE_CHARS = 4000
"""Longest message of a failed job, as `brink.worker.wire.JobFailed` allows."""

_LENGTH = struct.Struct(">I")


@dataclass(frozen=True, slots=True, kw_only=True)
class ChildMessage:
    """Base class of the messages. The worker's side rejects unknown fields."""

    __pydantic_config__: ClassVar = {"extra": "forbid"}

    def to_frame(self) -> bytes:
        """Return the message as a frame.

        Raises:
            BrokenFrame: The message is too long.
            TypeError: A value is not JSON.
            ValueError: A value is not JSON.
        """
        document = {field.name: getattr(self, field.name) for field in fields(self)}
        return encode_frame(json.dumps(document, separators=(",", ":")).encode())


@dataclass(frozen=True, slots=True, kw_only=True)
class Hello(ChildMessage):
    """The first message: what the process can simulate.

    Attributes:
        simulators: Ids of the simulators that were imported.
        lacking: The extra that each of those that are not installed needs, by id.
        left_out: Why each of the others could not be imported, by id.
    """

    simulators: tuple[str, ...]
    lacking: dict[str, str]
    left_out: dict[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunEpisode(ChildMessage):
    """A request to run one episode.

    Attributes:
        ticket: Number that the reply repeats.
        spec: The `EpisodeSpec` as JSON.
        record: Whether the result must carry the trace.
    """

    ticket: int
    spec: dict[str, Any]
    record: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeReply(ChildMessage):
    """The outcome of one episode.

    Attributes:
        ticket: Number of the request.
        wall_s: Wall-clock time of the episode.
        outcome: A `Completed` or a `JobFailed` as JSON.
    """

    ticket: int
    wall_s: float
    outcome: dict[str, Any]


def encode_frame(body: bytes) -> bytes:
    """Return a frame around a JSON text.

    Raises:
        BrokenFrame: The text is too long.
    """
    if len(body) > MAX_FRAME_BYTES:
        raise BrokenFrame(f"a frame of {len(body)} bytes: at most {MAX_FRAME_BYTES} are allowed")
    return _LENGTH.pack(len(body)) + body


def write_all(fd: int, data: bytes) -> None:
    """Write all of `data` to a blocking file descriptor."""
    view = memoryview(data)
    while view:
        view = view[os.write(fd, view) :]


def read_frame(fd: int) -> bytes | None:
    """Read one frame from a blocking file descriptor; return None at the end of the stream.

    Raises:
        BrokenFrame: The stream ended inside a frame, or the frame is too long.
    """
    head = _read_exactly(fd, _LENGTH.size)
    if head is None:
        return None
    body = _read_exactly(fd, _body_length(head))
    if body is None:
        raise BrokenFrame("the pipe ended after the length of a frame")
    return body


class FrameBuffer:
    """Reassembles frames from the chunks that a non-blocking pipe delivers."""

    __slots__ = ("_data",)

    def __init__(self) -> None:
        self._data = bytearray()

    def feed(self, data: bytes) -> None:
        """Append a chunk."""
        self._data += data

    def pop(self) -> bytes | None:
        """Remove and return the body of the first frame, or return None while it is incomplete.

        Raises:
            BrokenFrame: The frame is too long.
        """
        if len(self._data) < _LENGTH.size:
            return None
        end = _LENGTH.size + _body_length(bytes(self._data[: _LENGTH.size]))
        if len(self._data) < end:
            return None
        body = bytes(self._data[_LENGTH.size : end])
        del self._data[:end]
        return body


def completed_document(result: EpisodeResult) -> JsonObject:
    """Return a result as the JSON of a `brink.worker.wire.Completed`.

    Raises:
        UnserializableResult: A number is not finite, or a value is not JSON.
    """
    return {
        "kind": "completed",
        "verdicts": {
            name: {
                "robustness": _number(f"verdicts.{name}.robustness", v.robustness),
                "unit": v.unit,
                "violated_at_s": None
                if v.violated_at_s is None
                else _number(f"verdicts.{name}.violated_at_s", v.violated_at_s),
            }
            for name, v in result.verdicts.items()
        },
        "objectives": {name: _number(f"objectives.{name}", x) for name, x in result.objectives.items()},
        "features": _json("features", result.features),
        "provenance": _json("provenance", result.provenance),
        "trace": None if result.trace is None else base64.b64encode(result.trace).decode("ascii"),
    }


def failed_document(reason: str, message: str, context: str = "") -> JsonObject:
    """Return a failure as the JSON of a `brink.worker.wire.JobFailed`.

    Args:
        reason: One of the reasons that `JobFailed` allows.
        message: What happened, in one line.
        context: Further lines, such as a stack; cut from the front if too long.
    """
    return {"kind": "failed", "reason": reason, "message": failure_text(message, context)}


def failure_text(message: str, context: str = "") -> str:
    """Join a message and its context in at most `MAX_MESSAGE_CHARS` characters.

    Args:
        message: What happened, in one line.
        context: Further lines; the last ones are kept.
    """
    context = context.rstrip().strip("\n")
    if not context:
        return message[:MAX_MESSAGE_CHARS]
    message = message[: MAX_MESSAGE_CHARS // 2]
    return f"{message}\n{context[-(MAX_MESSAGE_CHARS - len(message) - 1) :]}"


def _body_length(head: bytes) -> int:
    length: int = _LENGTH.unpack(head)[0]
    if length > MAX_FRAME_BYTES:
        raise BrokenFrame(f"a frame of {length} bytes: at most {MAX_FRAME_BYTES} are allowed")
    return length


def _read_exactly(fd: int, count: int) -> bytes | None:
    data = bytearray()
    while len(data) < count:
        part = os.read(fd, count - len(data))
        if not part:
            if data:
                raise BrokenFrame("the pipe ended inside a frame")
            return None
        data += part
    return bytes(data)


def _number(place: str, value: object) -> float:
    try:
        number = float(value)  # type: ignore[arg-type]  # a simulator may return anything that is a number
    except (TypeError, ValueError) as error:
        raise UnserializableResult(f"{place}: expected a number, got {str(value)[:80]!r}") from error
    if not math.isfinite(number):
        raise UnserializableResult(f"{place}: expected a finite number, got {number}")
    return number


def _json(place: str, values: Mapping[str, Json]) -> JsonObject:
    values = dict(values)
    try:
        json.dumps(values, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise UnserializableResult(f"{place}: {error}") from error
    return values
