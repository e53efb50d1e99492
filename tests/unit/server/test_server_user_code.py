"""Calls of code of users: on threads of their own, and for a limited time."""

import functools
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import pytest

from brink.server import user_code
from brink.server.errors import Unavailable
from brink.server.user_code import USER_CODE, CodeExited, CodeStalled, guarded

PLUGIN = "brought@1"


@contextmanager
def serving(limit_s: float = 60.0) -> Iterator[user_code.Serving]:
    """Limit calls until the end of the block, as a coordinator on another thread does."""
    started = USER_CODE.begin(limit_s)
    started.loop_thread = -1
    try:
        yield started
    finally:
        USER_CODE.end(started)


@pytest.fixture
def gate() -> Iterator[threading.Event]:
    """Something to wait for, which is there when the test has ended."""
    event = threading.Event()
    yield event
    event.set()
    for one in USER_CODE.stalled():
        one.thread.join(60.0)
    assert not USER_CODE.stalled()


@runtime_checkable
class Describes(Protocol):
    def words(self) -> str: ...


class Brought:
    id: ClassVar[str] = PLUGIN

    def __init__(self, gate: threading.Event | None = None) -> None:
        self.gate = gate

    def where(self) -> threading.Thread:
        """Return the thread that runs this."""
        return threading.current_thread()

    def twice(self) -> tuple[threading.Thread, threading.Thread]:
        return threading.current_thread(), self.where()

    def waits(self) -> str:
        assert self.gate is not None
        self.gate.wait()
        return "returned"

    def loops(self) -> None:
        while True:
            pass

    def fails(self) -> None:
        raise ValueError("expected a number")

    def times_out(self) -> None:
        raise TimeoutError("of its own")

    def exits(self) -> None:
        raise SystemExit(3)

    @property
    def thread(self) -> threading.Thread:
        return threading.current_thread()

    @functools.cached_property
    def kept_thread(self) -> threading.Thread:
        return threading.current_thread()

    @staticmethod
    def static_thread() -> threading.Thread:
        return threading.current_thread()

    @classmethod
    def class_thread(cls) -> threading.Thread:
        return threading.current_thread()


@dataclass(frozen=True, slots=True)
class Frozen:
    value: int

    def double(self) -> int:
        return 2 * self.value


def test_every_way_into_a_guarded_object_runs_on_a_daemon_thread() -> None:
    brought = guarded(PLUGIN, Brought())
    with serving():
        for thread in (
            brought.where(),
            brought.thread,
            brought.kept_thread,
            brought.static_thread(),
            brought.class_thread(),
        ):
            assert thread is not threading.current_thread()
            assert thread.daemon


def test_guarded_object_is_still_an_instance_of_its_class_and_protocols() -> None:
    brought = guarded(PLUGIN, Brought())
    assert isinstance(brought, Brought)
    assert not isinstance(brought, Describes)
    assert (type(brought).__name__, type(brought).__module__) == ("Brought", __name__)
    assert guarded(PLUGIN, Frozen(3)).double() == 6


def test_code_that_calls_itself_stays_on_its_thread() -> None:
    with serving():
        outer, inner = guarded(PLUGIN, Brought()).twice()
    assert outer is inner


def test_without_a_coordinator_code_is_called_directly() -> None:
    assert guarded(PLUGIN, Brought()).where() is threading.current_thread()


def test_errors_of_the_code_reach_the_caller() -> None:
    brought = guarded(PLUGIN, Brought())
    with serving(), USER_CODE.on_behalf("campaign"):
        with pytest.raises(ValueError, match="expected a number"):
            brought.fails()
        with pytest.raises(TimeoutError, match="of its own"):
            brought.times_out()
        with pytest.raises(CodeExited, match="SystemExit: 3"):
            brought.exits()


def test_code_that_does_not_return_is_abandoned_and_its_thread_ends_when_it_does(
    gate: threading.Event,
) -> None:
    brought = guarded(PLUGIN, Brought(gate))
    with serving(limit_s=0.05), USER_CODE.on_behalf("campaign"):
        with pytest.raises(CodeStalled, match=r"waits of brought@1 did not return within 0\.05 s"):
            brought.waits()
        (stalled,) = USER_CODE.stalled("campaign")
        assert USER_CODE.stalled("another") == []
        gate.set()
        stalled.thread.join(60.0)
        assert USER_CODE.stalled("campaign") == []


def test_a_loop_without_end_is_ended(gate: threading.Event) -> None:
    with serving(limit_s=0.05), USER_CODE.on_behalf("campaign"):
        with pytest.raises(CodeStalled):
            guarded(PLUGIN, Brought()).loops()
        for one in USER_CODE.stalled():
            one.thread.join(60.0)
        assert not USER_CODE.stalled()


def test_after_some_stalled_calls_further_ones_are_refused_for_this_caller_alone(
    gate: threading.Event,
) -> None:
    brought = guarded(PLUGIN, Brought(gate))
    with serving(limit_s=0.01), USER_CODE.on_behalf("campaign"):
        for _ in range(user_code.MOST_STALLED):
            with pytest.raises(CodeStalled, match="did not return"):
                brought.waits()
        with pytest.raises(CodeStalled, match="4 earlier calls have not returned"):
            brought.where()
    with serving(), USER_CODE.on_behalf("another campaign"):
        assert brought.where().daemon


def test_slow_calls_for_requests_wait_in_line(gate: threading.Event, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(user_code, "LINE_S", 0.01)
    brought = guarded(PLUGIN, Brought(gate))
    with serving():
        first = [threading.Thread(target=brought.waits) for _ in range(user_code.AT_ONCE)]
        for thread in first:
            thread.start()
        deadline = time.monotonic() + 60.0
        while len(USER_CODE._waiting) < len(first):
            assert time.monotonic() < deadline
            time.sleep(0.001)  # between two looks
        with pytest.raises(CodeStalled, match="busy with earlier calls"):
            brought.where()
        with USER_CODE.on_behalf("campaign"):  # a step has no line
            assert brought.where().daemon
        gate.set()
        for thread in first:
            thread.join()
        assert brought.where().daemon


def test_a_coordinator_that_stops_waits_for_no_code(gate: threading.Event) -> None:
    brought = guarded(PLUGIN, Brought(gate))
    raised: list[Exception] = []

    def call() -> None:
        try:
            brought.waits()
        except Unavailable as error:
            raised.append(error)

    with serving() as started, USER_CODE.on_behalf("campaign"):
        caller = threading.Thread(target=call)
        caller.start()
        deadline = time.monotonic() + 60.0
        while not USER_CODE._waiting:
            assert time.monotonic() < deadline
            time.sleep(0.001)  # between two looks
        USER_CODE.stop(started)
        caller.join(60.0)
        assert [str(error) for error in raised] == ["the coordinator is stopping"]
        with pytest.raises(Unavailable, match="stopping"):
            brought.where()


def test_on_the_thread_of_an_event_loop_code_gets_little_time(gate: threading.Event) -> None:
    brought = guarded(PLUGIN, Brought(gate))
    started = USER_CODE.begin(60.0)
    try:
        with pytest.raises(CodeStalled, match=r"within 0\.25 s"):
            brought.waits()
    finally:
        USER_CODE.end(started)


def test_a_request_that_gives_up_leaves_the_code_its_time(
    gate: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(user_code, "VIEW_LIMIT_S", 0.01)
    returned: list[str] = []
    with serving(limit_s=3600.0):
        with pytest.raises(CodeStalled, match=r"within 0\.01 s"):
            USER_CODE.call(PLUGIN, "words", lambda: returned.append(Brought(gate).waits()))
        (stalled,) = USER_CODE.stalled()
        gate.set()
        stalled.thread.join(60.0)
    assert returned == ["returned"]


def test_an_import_is_never_interrupted(gate: threading.Event) -> None:
    returned: list[str] = []
    before = set(threading.enumerate())
    with serving(limit_s=0.01), USER_CODE.on_behalf("campaign"):
        with pytest.raises(CodeStalled, match="import of brought@1"):
            USER_CODE.call(PLUGIN, user_code.IMPORT, lambda: returned.append(Brought(gate).waits()))
        (stalled,) = USER_CODE.stalled()
        assert set(threading.enumerate()) - before <= {stalled.thread}, "nobody ends it"
        gate.set()
        stalled.thread.join(60.0)
    assert returned == ["returned"]
