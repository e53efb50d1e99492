"""Untrusted bytes that are not a trace raise InvalidEpisode, and no decompression bomb is unpacked."""

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.traces import make_trace

from brink.sim.errors import InvalidEpisode
from brink.sim.trace import MAX_BYTES, TRACE_VERSION, Trace


def npz(**arrays: Any) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=True, **arrays)
    return buffer.getvalue()


def headed(header: object, **arrays: Any) -> bytes:
    return npz(header=np.frombuffer(json.dumps(header).encode(), dtype=np.uint8), **arrays)


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


def test_a_decompression_bomb_is_rejected() -> None:
    buffer = io.BytesIO()
    with (
        zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("ego.npy", "w") as member,
    ):
        for _ in range(MAX_BYTES // 2**20 + 1):
            member.write(bytes(2**20))
    with pytest.raises(InvalidEpisode, match="trace"):
        Trace.from_bytes(buffer.getvalue())


def test_what_the_camera_saw_is_kept_and_optional() -> None:
    trace = make_trace(samples=3)
    shares = np.array([1.0, 0.5, np.nan], np.float32)
    pitch_rad = np.array([0.0, -0.01, 0.02], np.float32)
    seen = replace(
        trace, pitch_rad=pitch_rad, actors=(replace(trace.actors[0], visible=shares), *trace.actors[1:])
    )
    again, before = (Trace.from_bytes(one.to_bytes()) for one in (seen, trace))
    assert again.pitch_rad is not None
    assert np.array_equal(again.pitch_rad, pitch_rad)
    assert again.actors[0].visible is not None
    assert np.array_equal(again.actors[0].visible, shares, equal_nan=True)
    assert again.actors[1].visible is None
    assert before.pitch_rad is None
    assert all(actor.visible is None for actor in before.actors)


@pytest.mark.parametrize("samples", [2, 4])
def test_what_the_camera_saw_must_have_an_entry_for_each_sample(samples: int) -> None:
    trace = make_trace(samples=3)
    wrong = np.zeros(samples, np.float32)
    with pytest.raises(InvalidEpisode, match="pitch_rad: expected shape"):
        Trace.from_bytes(replace(trace, pitch_rad=wrong).to_bytes())
    actors = (replace(trace.actors[0], visible=wrong), *trace.actors[1:])
    with pytest.raises(InvalidEpisode, match=r"visible.0: expected shape"):
        Trace.from_bytes(replace(trace, actors=actors).to_bytes())
