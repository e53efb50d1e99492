"""The small parts of a worker: frames, pace, backoff, outage, settings, log."""

import json
import logging
import os
from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from brink.worker.backoff import Backoff
from brink.worker.errors import BrokenFrame, CoordinatorAway, SettingsError
from brink.worker.frames import FrameBuffer, encode_frame, read_frame, write_all
from brink.worker.log import LineFormatter
from brink.worker.outage import Outage
from brink.worker.pace import Pace
from brink.worker.settings import WorkerSettings, new_worker_id

BODIES = st.lists(st.binary(max_size=200), max_size=8)
SECONDS = st.floats(0.0, 1e4, allow_nan=False)


@given(bodies=BODIES, cut=st.integers(1, 50))
def test_frames_come_out_whole_however_they_are_cut(bodies: list[bytes], cut: int) -> None:
    stream = b"".join(encode_frame(body) for body in bodies)
    buffer, received = FrameBuffer(), []
    for start in range(0, len(stream), cut):
        buffer.feed(stream[start : start + cut])
        while (body := buffer.pop()) is not None:
            received.append(body)
    assert received == bodies


def test_frames_pass_through_a_pipe_until_its_end() -> None:
    reader, writer = os.pipe()
    write_all(writer, encode_frame(b"one") + encode_frame(b""))
    os.close(writer)
    assert [read_frame(reader), read_frame(reader), read_frame(reader)] == [b"one", b"", None]
    os.close(reader)


@pytest.mark.parametrize(
    "sent", [b"\x00\x00\x00\x05hel", b"\x00\x00", b"\x00\x00\x00\x05", b"\xff\xff\xff\xff"]
)
def test_a_pipe_that_carries_something_else_is_an_error(sent: bytes) -> None:
    reader, writer = os.pipe()
    write_all(writer, sent)
    os.close(writer)
    with pytest.raises(BrokenFrame):
        read_frame(reader)
    os.close(reader)


def test_a_frame_that_claims_too_much_is_refused_before_it_arrives() -> None:
    buffer = FrameBuffer()
    buffer.feed(b"\xff\xff\xff\xff")
    with pytest.raises(BrokenFrame, match="4294967295 bytes"):
        buffer.pop()


@given(
    max_jobs=st.integers(1, 128),
    prefetch_s=SECONDS,
    episodes_s=st.lists(SECONDS, max_size=20),
    trips_s=st.lists(SECONDS, max_size=20),
)
def test_the_pace_stays_in_its_bounds(
    max_jobs: int, prefetch_s: float, episodes_s: list[float], trips_s: list[float]
) -> None:
    pace = Pace(max_jobs=max_jobs, prefetch_s=prefetch_s)
    for episode_s in episodes_s:
        pace = pace.after_episode(episode_s)
    for trip_s in trips_s:
        pace = pace.after_request(trip_s)
    assert 1 <= pace.hold <= max_jobs
    assert 0 <= pace.low < pace.hold
    assert not episodes_s or min(episodes_s) * 0.99 <= (pace.episode_s or 0.0) <= max(episodes_s) * 1.01


@pytest.mark.parametrize(
    ("episode_s", "hold"), [(None, 1), (60.0, 1), (0.6, 1), (0.25, 2), (0.07, 5), (0.001, 8), (0.0, 8)]
)
def test_a_worker_holds_a_set_time_of_work(episode_s: float | None, hold: int) -> None:
    assert Pace(max_jobs=8, prefetch_s=0.25, episode_s=episode_s).hold == hold


@given(failures=st.integers(1, 10_000), seed=st.integers(0, 2**32))
def test_the_backoff_is_spread_over_half_of_a_capped_doubling(failures: int, seed: int) -> None:
    delay_s = Backoff(first_s=0.5, cap_s=10.0).delay_s(failures, Random(seed))
    longest_s = min(10.0, 0.5 * 2 ** min(failures - 1, 20))
    assert longest_s / 2 <= delay_s <= longest_s


def test_an_outage_is_logged_at_growing_intervals_and_its_end_once(caplog: pytest.LogCaptureFixture) -> None:
    now_s = 0.0
    outage = Outage("http://c", Backoff(first_s=0.5, cap_s=10.0), Random(1), clock=lambda: now_s)
    said_at_s = []
    with caplog.at_level(logging.INFO):
        for second in range(1000):
            now_s = float(second)
            outage.failed(CoordinatorAway("no answer"), unsent=3)
            if caplog.records:
                said_at_s.append(second)
                caplog.clear()
        outage.over()
        outage.over()
    assert said_at_s == [0, 5, 15, 35, 75, 155, 315, 615, 915]
    assert [record.getMessage() for record in caplog.records] == ["the coordinator at http://c is back"]


def test_an_outage_waits_as_long_as_the_coordinator_asks() -> None:
    outage = Outage("http://c", Backoff(first_s=0.5, cap_s=10.0), Random(1), clock=lambda: 0.0)
    assert outage.failed(CoordinatorAway("busy", retry_after_s=42.0), unsent=0) == 42.0


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("server", "127.0.0.1:8700"),
        ("server", "ftp://host"),
        ("server", ""),
        ("worker_id", ""),
        ("worker_id", "x" * 65),
        ("max_jobs", 0),
        ("max_jobs", 129),
        ("wait_s", 61.0),
        ("wait_s", -1.0),
        ("memory_mib", -1),
        ("grace_s", float("inf")),
        ("prefetch_s", float("nan")),
        ("exit_when_idle_s", -0.1),
    ],
)
def test_a_setting_out_of_range_is_named(field: str, value: Any) -> None:
    with pytest.raises(SettingsError) as caught:
        WorkerSettings(**{"server": "http://127.0.0.1:8700", field: value})
    assert caught.value.field == field
    assert "expected" in str(caught.value)


def test_settings_do_not_show_the_token() -> None:
    assert "hush" not in repr(WorkerSettings(server="http://c", token="hush"))


def test_worker_ids_are_unique_and_short_enough_for_the_wire() -> None:
    ids = {new_worker_id() for _ in range(100)}
    assert len(ids) == 100
    assert max(map(len, ids)) <= 64


def test_a_log_line_is_one_line_with_its_fields() -> None:
    record = logging.makeLogRecord(
        {
            "name": "brink.worker.runner",
            "levelname": "WARNING",
            "msg": "two\nlines",
            "job": 7,
            "reason": "no luck",
        }
    )
    line = LineFormatter(worker="w-1").format(record)
    assert line.endswith('WARNING brink.worker.runner: two lines worker=w-1 job=7 reason="no luck"')


def test_a_log_line_keeps_its_stack() -> None:
    try:
        json.loads("{")
    except ValueError as error:
        record = logging.makeLogRecord(
            {"msg": "broken", "exc_info": (type(error), error, error.__traceback__)}
        )
    first, *stack = LineFormatter(worker="w-1").format(record).split("\n")
    assert "broken worker=w-1" in first
    assert "JSONDecodeError" in stack[-1]
