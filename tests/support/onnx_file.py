"""ONNX files of tiny networks, written without the package onnx, which is not among the test tools.

A network returns one constant array, whatever its input image; it may insist on a size of the image, and answer with
NaN. The numbers of the fields are those of onnx.proto.
"""

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

_FLOAT: Final = 1
_INT: Final = 2
_OPSET: Final = 17


def write_network(
    file: Path,
    output: NDArray[np.float32],
    *,
    input_px: tuple[int, int] | None = None,
    needs_px: tuple[int, int] | None = None,
    metadata: Mapping[str, str] | None = None,
    nan_unless_mean: float | None = None,
) -> str:
    """Write a network; return its detector id.

    Args:
        file: The file to write.
        output: What it returns.
        input_px: Width and height of the input that it states; None for any.
        needs_px: Width and height of the images on which it works; None for any.
        metadata: What its exporter says of it.
        nan_unless_mean: The mean, in [0, 1], of the only images on which its output is not NaN.
    """
    width_px, height_px = input_px or (0, 0)
    sides: list[int | str] = [1, 3, height_px, width_px] if input_px else [1, 3, "height", "width"]
    constants = {"boxes": output, "nothing": np.zeros(1, np.float32)}
    nodes = []
    seen = "images"
    if needs_px is not None:
        constants["grid"] = np.zeros((1, 3, needs_px[1], needs_px[0]), np.float32)
        nodes.append(_node("Add", ["images", "grid"], "seen"))
        seen = "seen"
    nodes.append(_node("ReduceMean", [seen], "mean", keepdims=0))
    factor = "mean"
    if nan_unless_mean is not None:  # the root of a negative number, unless the mean is within .001
        constants["wanted"] = np.full(1, nan_unless_mean, np.float32)
        constants["near"] = np.full(1, 0.001, np.float32)
        nodes += [
            _node("Sub", ["mean", "wanted"], "beyond"),
            _node("Abs", ["beyond"], "apart"),
            _node("Sub", ["near", "apart"], "left"),
            _node("Sqrt", ["left"], "root"),
        ]
        factor = "root"
    nodes += [_node("Mul", [factor, "nothing"], "none"), _node("Add", ["boxes", "none"], "output0")]
    graph = b"".join(
        [
            *(_message(1, node) for node in nodes),
            _text(2, "graph"),
            *(_message(5, _tensor(name, values)) for name, values in constants.items()),
            _message(11, _value("images", sides)),
            _message(12, _value("output0", output.shape)),
        ]
    )
    said = [_text(1, key) + _text(2, value) for key, value in (metadata or {}).items()]
    file.write_bytes(
        _number(1, 8)
        + _message(7, graph)
        + _message(8, _text(1, "") + _number(2, _OPSET))
        + b"".join(_message(14, one) for one in said)
    )
    return f"onnx:{file}"


def _node(kind: str, inputs: Sequence[str], output: str, **attributes: int) -> bytes:
    settings = [_text(1, name) + _number(3, value) + _number(20, _INT) for name, value in attributes.items()]
    named = [_text(1, name) for name in inputs]
    return b"".join([*named, _text(2, output), _text(4, kind), *(_message(5, one) for one in settings)])


def _tensor(name: str, values: NDArray[np.float32]) -> bytes:
    sides = b"".join(_number(1, side) for side in values.shape)
    numbers = struct.pack(f"<{values.size}f", *values.ravel().tolist())
    return sides + _number(2, _FLOAT) + _text(8, name) + _message(9, numbers)


def _value(name: str, sides: Sequence[int | str]) -> bytes:
    shape = b"".join(
        _message(1, _text(2, side) if isinstance(side, str) else _number(1, side)) for side in sides
    )
    return _text(1, name) + _message(2, _message(1, _number(1, _FLOAT) + _message(2, shape)))


def _varint(value: int) -> bytes:
    parts = bytearray()
    while value > 0x7F:
        parts.append(value & 0x7F | 0x80)
        value >>= 7
    parts.append(value)
    return bytes(parts)


def _number(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value)


def _message(field: int, content: bytes) -> bytes:
    return _varint(field << 3 | 2) + _varint(len(content)) + content


def _text(field: int, content: str) -> bytes:
    return _message(field, content.encode())
