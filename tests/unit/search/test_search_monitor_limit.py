"""Fitting a monitor ends when its time is up, and when the coordinator stops."""

import threading
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from brink.search.analysis import boosted_trees, neighbours
from brink.search.analysis.choices import Model
from brink.search.analysis.folds import divisions, kinds_of_solutions
from brink.search.analysis.monitor import Monitor
from brink.search.space import Component, Real, SearchSpace
from brink.server.errors import TooCostly, Unavailable
from brink.server.read_threads import ReadThreads

SPACE = SearchSpace((Component("where", (Real("x", -2, 2),)), Component("what", (Real("y", -2, 2),))))
ROWS = np.random.default_rng(1).uniform(-2, 2, (200, 2))
TIMES = 10**5
"""How many times as many models as usual; that takes hours."""


class Endless:
    """A step of the fit that hands on far more work than usual, and tells when it is called."""

    def __init__(self, function: Callable[..., Sequence[Any]]) -> None:
        self.function, self.began = function, threading.Event()

    def __call__(self, *args: Any) -> list[Any]:
        self.began.set()
        return list(self.function(*args)) * TIMES


@pytest.fixture(params=Model)
def endless(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> tuple[Model, Endless]:
    model = Model(request.param)
    if model is Model.TREES:
        pytest.importorskip("sklearn")
        step = Endless(divisions)
        monkeypatch.setattr(boosted_trees, "divisions", step)
    else:
        step = Endless(kinds_of_solutions)
        monkeypatch.setattr(neighbours, "kinds_of_solutions", lambda *args: step(*args)[:2])
        monkeypatch.setattr(neighbours, "LEVELS", neighbours.LEVELS * TIMES)
    return model, step


def fit(model: Model) -> Monitor:
    return Monitor.fitted(SPACE, ROWS, ROWS.sum(axis=1) > 0, threshold=0.1, model=model)


def test_a_fit_ends_when_its_time_is_up(endless: tuple[Model, Endless]) -> None:
    threads = ReadThreads(1, "brink-test", limit_s=0.5, patient=True, instead="fit it elsewhere")
    with pytest.raises(TooCostly, match=r"ended after 0\.5 s.*fit it elsewhere"):
        threads.submit(fit, endless[0]).result(60.0)
    threads.close()


def test_closing_ends_a_fit(endless: tuple[Model, Endless]) -> None:
    threads = ReadThreads(1, "brink-test", limit_s=3600.0)
    running = threads.submit(fit, endless[0])
    assert endless[1].began.wait(60.0)
    threads.close()
    with pytest.raises(Unavailable, match="stopping"):
        running.result(0)
