"""Frames on a pipe: four bytes of length, big-endian, then that many bytes of JSON."""

import json
import os
import struct
from typing import Any

from brink.worker.errors import BrokenFrame

_LENGTH = struct.Struct(">I")
MAX_FRAME_BYTES = 64 * 1024 * 1024


def encode_frame(body: bytes) -> bytes:
    """Return a frame around a JSON text.

    Raises:
        BrokenFrame: It is too long.
    """
    if len(body) > MAX_FRAME_BYTES:
        raise BrokenFrame(f"a frame of {len(body)} bytes: at most {MAX_FRAME_BYTES} are allowed")
    return _LENGTH.pack(len(body)) + body


def encode_document(document: dict[str, Any]) -> bytes:
    """Return a frame around a JSON document."""
    return encode_frame(json.dumps(document, separators=(",", ":")).encode())


def write_all(fd: int, data: bytes) -> None:
    """Write all of `data` to a blocking file descriptor."""
    view = memoryview(data)
    while view:
        view = view[os.write(fd, view) :]


def read_frame(fd: int) -> bytes | None:
    """Read one frame from a blocking file descriptor; None at its end.

    Raises:
        BrokenFrame: The pipe ended inside a frame, or the frame is too long.
    """
    head = _read_exactly(fd, _LENGTH.size)
    if head is None:
        return None
    body = _read_exactly(fd, _length(head))
    if body is None:
        raise BrokenFrame("the pipe ended after the length of a frame")
    return body


class FrameBuffer:
    """Collects what a non-blocking pipe delivers and gives whole frames back."""

    __slots__ = ("_data",)

    def __init__(self) -> None:
        self._data = bytearray()

    def feed(self, data: bytes) -> None:
        """Add what was read."""
        self._data += data

    def pop(self) -> bytes | None:
        """Return the next whole frame's body, or None if it has not arrived yet.

        Raises:
            BrokenFrame: The frame is too long.
        """
        if len(self._data) < _LENGTH.size:
            return None
        end = _LENGTH.size + _length(bytes(self._data[: _LENGTH.size]))
        if len(self._data) < end:
            return None
        body = bytes(self._data[_LENGTH.size : end])
        del self._data[:end]
        return body


def _length(head: bytes) -> int:
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
