"""What is no trace is told so, whatever it is: no bomb is unpacked, nothing else is raised."""

import io
import json
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from brink.sim.errors import InvalidEpisode
from brink.sim.trace import TRACE_VERSION, Trace
from brink.sim.trace_arrays import MOST_BYTES


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
        for _ in range(MOST_BYTES // 2**20 + 1):
            member.write(bytes(2**20))
    return buffer.getvalue()


def claiming(shape: tuple[int, ...]) -> bytes:
    member = io.BytesIO()
    np.lib.format.write_array_header_1_0(member, {"descr": "<f8", "fortran_order": False, "shape": shape})
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("ego.npy", member.getvalue())
    return buffer.getvalue()


WRONG: Mapping[str, bytes] = {
    "nothing": b"",
    "a text": b"the trace",
    "the beginning of an archive": b"PK\x03\x04" + bytes(40),
    "half of one": npz(header=np.zeros(3))[:-30],
    "a bomb": bomb(),
    "an array larger than memory": claiming((2**44,)),
    "pickles": npz(header=np.array([{}], dtype=object)),
    "no header": npz(ego=np.zeros(3)),
    "a header that is no JSON": npz(header=np.frombuffer(b"{", dtype=np.uint8)),
    "a header that is a list": headed([]),
    "a header without end": npz(header=np.frombuffer(b"[" * 100_000, dtype=np.uint8)),
    "another version": headed({"version": 99}),
    "a header alone": headed({"version": TRACE_VERSION}),
    "a header of other types": headed({"version": TRACE_VERSION, "ego_size_m": 1, "columns": 2}),
    "a text for a number": headed({"version": TRACE_VERSION}, ego=np.array(["x"])),
    "a place at the end of the world": headed({"version": TRACE_VERSION}, route=np.full((2, 2), 1e30)),
    "a place without end": headed({"version": TRACE_VERSION}, route=np.full((2, 2), np.inf)),
    "more samples than an hour has": headed({"version": TRACE_VERSION}, time_s=np.zeros(40_000)),
}


@pytest.mark.parametrize("document", [pytest.param(document, id=name) for name, document in WRONG.items()])
def test_what_is_no_trace_is_told_so(document: bytes) -> None:
    with pytest.raises(InvalidEpisode, match="trace"):
        Trace.from_bytes(document)
