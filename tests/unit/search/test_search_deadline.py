"""Time limits end computations, and leave those without one alone."""

import threading
import time

import numpy as np
import pytest

from brink.search.deadline import Deadline, check_time, time_limit
from brink.search.errors import OutOfTime
from brink.search.metric import Metric


def distances() -> float:
    metric = Metric([1.0, 1.0], [False, False])
    rows = np.random.default_rng(1).random((200, 2))
    return float(metric.between(rows, rows).sum())


def test_distances_are_not_computed_once_the_time_is_up() -> None:
    with time_limit(Deadline(time.monotonic() - 1.0)), pytest.raises(OutOfTime):
        distances()


def test_a_limit_changes_no_result_and_ends_with_its_block() -> None:
    without = distances()
    with time_limit(Deadline(time.monotonic() + 600.0)):
        assert distances() == without
    with time_limit(Deadline(time.monotonic() - 1.0)):
        pass
    assert distances() == without


def test_a_deadline_that_another_thread_moves_ends_what_is_going_on() -> None:
    deadline, began, ended = Deadline(time.monotonic() + 600.0), threading.Event(), threading.Event()

    def compute() -> None:
        try:
            with time_limit(deadline):
                while True:
                    began.set()
                    check_time()
        except OutOfTime:
            ended.set()

    thread = threading.Thread(target=compute, daemon=True)
    thread.start()
    assert began.wait(60.0)
    check_time()  # the limit is that thread's
    deadline.due_s = 0.0
    assert ended.wait(60.0)
