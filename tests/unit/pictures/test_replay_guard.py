"""Replays show when a guard raised the alarm, when the fallback intervened, and what they prevent."""

from dataclasses import replace

import numpy as np
import pytest
from support.traces import guarded, make_trace

from brink.pictures.guard import guard_words
from brink.server.api.episode_views import episode_view
from brink.sim.errors import InvalidEpisode
from brink.sim.trace import Trace

SAMPLES = 200


@pytest.fixture(scope="module")
def watched() -> Trace:
    return guarded(make_trace(samples=SAMPLES, violated=False))


def test_the_guard_survives_the_trace_as_bytes(watched: Trace) -> None:
    again = Trace.from_bytes(watched.to_bytes()).guard

    assert again is not None
    assert watched.guard is not None
    assert (again.fallback, again.horizons_s) == ("safe-stop@1", (1.0, 3.0))
    for name in ("probabilities", "alarm", "intervenes"):
        assert np.array_equal(getattr(again, name), getattr(watched.guard, name))


def test_a_trace_without_a_guard_has_none_and_the_same_bytes_as_ever() -> None:
    trace = make_trace(samples=20)

    assert Trace.from_bytes(trace.to_bytes()).guard is None
    assert b"guard" not in trace.to_bytes()


def test_a_guard_that_lacks_samples_makes_no_trace(watched: Trace) -> None:
    with pytest.raises(InvalidEpisode, match="probabilities of the guard: expected shape"):
        Trace.from_bytes(replace(make_trace(samples=SAMPLES - 1), guard=watched.guard).to_bytes())


def test_words_say_alarm_until_the_fallback_intervenes(watched: Trace) -> None:
    words = guard_words(watched)

    assert [words[place] for place in (39, 40, 44, 45, 70, 79, 80)] == [
        "",
        "alarm",
        "alarm",
        "fallback",
        "fallback",
        "fallback",
        "",
    ]
    assert not any(guard_words(make_trace(samples=10)))


def test_the_api_returns_probabilities_and_states(watched: Trace) -> None:
    view = episode_view(watched, ("front-gap@1",))

    assert view.guard is not None
    assert view.guard.fallback == "safe-stop@1"
    assert view.guard.state.count("fallback") == 35
    assert len(view.guard.probabilities) == 2
    assert view.guard.probabilities[1][-1] == 0.9
    assert episode_view(make_trace(samples=30), ()).guard is None
