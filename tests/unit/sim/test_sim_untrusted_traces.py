"""Untrusted bytes that are not a trace raise InvalidEpisode, and no decompression bomb is unpacked."""

import io
import json
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from brink.sim.errors import InvalidEpisode
from brink.sim.trace import MAX_BYTES, TRACE_VERSION, Trace


def npz(**arrays: Any) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=True, **arrays)
    return buffer.getvalue()


def headed(header: object, **arrays: Any) -> bytes:
    return npz(header=np.frombuffer(json.dumps(header).encode(), dtype=np.uint8), **arrays)


def bomb() -> bytes:
    buffer = io.BytesIO()
    with (
        zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("ego.npy", "w") as member,
    ):
        for _ in range(MAX_BYTES // 2**20 + 1):
            member.write(bytes(2**20))
    return buffer.getvalue()


def claiming(shape: tuple[int, ...]) -> bytes:
    member = io.BytesIO()
    np.lib.format.write_array_header_1_0(member, {"descr": "<f8", "fortran_order": False, "shape": shape})
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("ego.npy", member.getvalue())
    return buffer.getvalue()


INVALID: Mapping[str, bytes] = {
    "no bytes": b"",
    "a text": b"the trace",
    "the start of an archive": b"PK\x03\x04" + bytes(40),
    "a truncated archive": npz(header=np.zeros(3))[:-30],
    "a decompression bomb": bomb(),
    "an array larger than memory": claiming((2**44,)),
    "pickles": npz(header=np.array([{}], dtype=object)),
    "no header": npz(ego=np.zeros(3)),
    "a header that is not JSON": npz(header=np.frombuffer(b"{", dtype=np.uint8)),
    "a header that is a list": headed([]),
    "an unclosed header": npz(header=np.frombuffer(b"[" * 100_000, dtype=np.uint8)),
    "another version": headed({"version": 99}),
    "nothing but a header": headed({"version": TRACE_VERSION}),
    "a header of wrong types": headed({"version": TRACE_VERSION, "ego_size_m": 1, "columns": 2}),
    "text in place of numbers": headed({"version": TRACE_VERSION}, ego=np.array(["x"])),
    "a position beyond the limit": headed({"version": TRACE_VERSION}, route=np.full((2, 2), 1e30)),
    "an infinite position": headed({"version": TRACE_VERSION}, route=np.full((2, 2), np.inf)),
    "more samples than the limit": headed({"version": TRACE_VERSION}, time_s=np.zeros(40_000)),
}


@pytest.mark.parametrize("document", [pytest.param(document, id=name) for name, document in INVALID.items()])
def test_bytes_that_are_not_a_trace_are_rejected(document: bytes) -> None:
    with pytest.raises(InvalidEpisode, match="trace"):
        Trace.from_bytes(document)
