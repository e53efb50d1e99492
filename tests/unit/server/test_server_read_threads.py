"""Threads for costly reads: few in line, ended when their time is up, and when the coordinator stops."""

import re
import threading
import time

import pytest

from brink.search.deadline import check_time
from brink.server.errors import TooCostly, Unavailable
from brink.server.read_threads import ReadThreads


def for_ever(began: threading.Event) -> None:
    while True:
        began.set()
        check_time()


def test_a_read_is_ended_when_its_time_is_up() -> None:
    threads = ReadThreads(1, "brink-test", limit_s=0.2)
    began = threading.Event()
    while not began.is_set():  # on a slow machine, it may be its turn too late
        with pytest.raises(TooCostly) as ended:
            threads.submit(for_ever, began).result(60.0)
    assert re.search(r"ended after 0.2 s.*request less", str(ended.value))
    assert threads.submit(lambda: 7).result(60.0) == 7
    threads.close()


def test_a_read_that_waited_for_too_long_does_not_begin() -> None:
    threads = ReadThreads(1, "brink-test", limit_s=0.5)
    began, go_on, ran = threading.Event(), threading.Event(), threading.Event()

    def hold() -> bool:
        began.set()
        return go_on.wait(60.0)

    while not began.is_set():  # on a slow machine, it may be its turn too late
        first = threads.submit(hold)
        began.wait(0.6)
    second = threads.submit(ran.set)
    time.sleep(0.6)  # until its time is up
    go_on.set()
    assert first.result(60.0)
    with pytest.raises(TooCostly, match=r"waited longer than the 0\.5 s"):
        second.result(60.0)
    assert not ran.is_set()
    threads.close()


def test_no_more_reads_are_taken_than_may_be_pending() -> None:
    threads = ReadThreads(1, "brink-test", limit_s=60.0, most_pending=2)
    go_on = threading.Event()
    taken = [threads.submit(go_on.wait, 60.0) for _ in range(2)]
    with pytest.raises(Unavailable, match="2 costly reads are pending") as refused:
        threads.submit(go_on.wait, 60.0)
    assert refused.value.retry_after_s > 0
    go_on.set()
    assert all(one.result(60.0) for one in taken)
    assert threads.submit(lambda: 7).result(60.0) == 7
    threads.close()


def test_closing_ends_what_is_going_on_and_cancels_what_waits() -> None:
    threads = ReadThreads(1, "brink-test", limit_s=600.0)
    began = threading.Event()
    running, waiting = threads.submit(for_ever, began), threads.submit(lambda: 7)
    assert began.wait(60.0)
    threads.close()
    with pytest.raises(Unavailable, match="stopping"):
        running.result(0)
    assert waiting.cancelled()
    with pytest.raises(Unavailable, match="stopping"):
        threads.submit(lambda: 7)


def test_time_in_line_does_not_count_on_patient_threads() -> None:
    threads = ReadThreads(1, "brink-test", limit_s=0.05, patient=True)
    began, go_on = threading.Event(), threading.Event()

    def hold() -> bool:
        began.set()
        return go_on.wait(60.0)

    first, second = threads.submit(hold), threads.submit(for_ever, threading.Event())
    assert began.wait(60.0)
    time.sleep(0.1)  # longer than a function may take
    go_on.set()
    assert first.result(60.0)
    with pytest.raises(TooCostly, match=r"ended after 0\.05 s"):
        second.result(60.0)
    threads.close()
