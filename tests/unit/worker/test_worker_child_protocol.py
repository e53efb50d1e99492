"""The protocol between worker and simulation process: frames, and results that survive the way to the wire."""

import json
import math
import os
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from brink.sim.episode import EpisodeResult, Verdict
from brink.worker.child_protocol import (
    MAX_MESSAGE_CHARS,
    FrameBuffer,
    completed_document,
    encode_frame,
    failure_text,
    read_frame,
    write_all,
)
from brink.worker.errors import BrokenFrame, UnexpectedReply, UnserializableResult
from brink.worker.process import episode_result, parse_outcome
from brink.worker.wire import LARGEST_NUMBER, Completed, JobFailed

FINITE = st.floats(allow_nan=False, allow_infinity=False)
NUMBERS = st.floats(-LARGEST_NUMBER, LARGEST_NUMBER)
NAMES = st.text("abc@1-", min_size=1, max_size=8)
VERDICTS = st.builds(
    Verdict,
    robustness=NUMBERS,
    unit=st.sampled_from(["m", "s", "m/s"]),
    violated_at_s=st.none() | st.floats(0.0, 1e6),
)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | FINITE | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(NAMES, inner, max_size=3),
    max_leaves=6,
)
RESULTS = st.builds(
    EpisodeResult,
    verdicts=st.dictionaries(NAMES, VERDICTS, max_size=3),
    objectives=st.dictionaries(NAMES, NUMBERS, max_size=3),
    features=st.dictionaries(NAMES, JSON, max_size=3),
    provenance=st.dictionaries(NAMES, JSON, max_size=3),
    trace=st.none() | st.binary(max_size=50),
)


# The first use of `st.text` in a fresh checkout is slow: Hypothesis builds its table of Unicode categories.
@settings(suppress_health_check=[HealthCheck.too_slow])
@given(result=RESULTS)
def test_a_result_survives_the_wire(result: EpisodeResult) -> None:
    outcome = parse_outcome(json.loads(json.dumps(completed_document(result))))
    assert isinstance(outcome, Completed)
    assert episode_result(outcome) == result


def result(**changed: Any) -> EpisodeResult:
    values: dict[str, Any] = {"verdicts": {}, "objectives": {}, "features": {}, "provenance": {}}
    return EpisodeResult(**{**values, **changed})


@pytest.mark.parametrize(
    ("changed", "place"),
    [
        ({"objectives": {"gap": math.nan}}, "objectives.gap"),
        ({"objectives": {"gap": math.inf}}, "objectives.gap"),
        (
            {"verdicts": {"r": Verdict(robustness=math.nan, unit="m", violated_at_s=None)}},
            "verdicts.r.robustness",
        ),
        ({"objectives": {"gap": "near"}}, "objectives.gap"),
        ({"features": {"deep": [{"x": math.nan}]}}, "features"),
        ({"features": {"odd": object()}}, "features"),
        ({"provenance": {"x": -math.inf}}, "provenance"),
    ],
)
def test_result_that_json_cannot_represent_is_rejected_by_field(changed: dict[str, Any], place: str) -> None:
    with pytest.raises(UnserializableResult, match=place) as caught:
        completed_document(result(**changed))
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize(
    ("changed", "place"),
    [
        ({"verdicts": {"r": Verdict(robustness=1.0, unit="m" * 17, violated_at_s=None)}}, "verdicts.r.unit"),
        ({"verdicts": {"r": Verdict(robustness=1.0, unit="m", violated_at_s=-1.0)}}, "violated_at_s"),
        ({"trace": b"x" * 6_000_001}, "trace"),
    ],
)
def test_a_result_beyond_wire_bounds_becomes_a_failure_by_field(changed: dict[str, Any], place: str) -> None:
    outcome = parse_outcome(completed_document(result(**changed)))
    assert isinstance(outcome, JobFailed)
    assert outcome.reason == "error"
    assert place in outcome.message
    assert len(outcome.message) < 400


def test_a_trace_that_is_not_base64_is_rejected() -> None:
    with pytest.raises(UnexpectedReply, match="base64"):
        episode_result(Completed(verdicts={}, trace="not base64!"))


@settings(suppress_health_check=[HealthCheck.too_slow])
@given(message=st.text(max_size=9000), context=st.text(max_size=9000))
def test_a_failure_message_fits_the_wire(message: str, context: str) -> None:
    text = failure_text(message, context)
    assert len(text) <= MAX_MESSAGE_CHARS
    JobFailed(reason="error", message=text)


def test_a_failure_message_keeps_its_first_line_and_the_end_of_its_context() -> None:
    text = failure_text("it broke", "line\n" * 5000 + "the last line\n")
    assert text.startswith("it broke\n")
    assert text.endswith("the last line")


@given(bodies=st.lists(st.binary(max_size=200), max_size=8), cut=st.integers(1, 50))
def test_frames_are_reassembled_from_chunks_of_any_size(bodies: list[bytes], cut: int) -> None:
    stream = b"".join(encode_frame(body) for body in bodies)
    buffer, received = FrameBuffer(), []
    for start in range(0, len(stream), cut):
        buffer.feed(stream[start : start + cut])
        while (body := buffer.pop()) is not None:
            received.append(body)
    assert received == bodies


def test_frames_are_read_from_a_pipe_until_its_end() -> None:
    reader, writer = os.pipe()
    write_all(writer, encode_frame(b"one") + encode_frame(b""))
    os.close(writer)
    assert [read_frame(reader), read_frame(reader), read_frame(reader)] == [b"one", b"", None]
    os.close(reader)


@pytest.mark.parametrize(
    "sent", [b"\x00\x00\x00\x05hel", b"\x00\x00", b"\x00\x00\x00\x05", b"\xff\xff\xff\xff"]
)
def test_a_pipe_that_carries_something_other_than_frames_is_an_error(sent: bytes) -> None:
    reader, writer = os.pipe()
    write_all(writer, sent)
    os.close(writer)
    with pytest.raises(BrokenFrame):
        read_frame(reader)
    os.close(reader)


def test_an_oversized_frame_is_rejected_before_it_arrives() -> None:
    buffer = FrameBuffer()
    buffer.feed(b"\xff\xff\xff\xff")
    with pytest.raises(BrokenFrame, match="4294967295 bytes"):
        buffer.pop()
