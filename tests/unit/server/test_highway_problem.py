"""The problem of highway-env: episodes, activity and words."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brink.search.pairs import Steps
from brink.server.errors import InvalidInput
from brink.server.problems.base import NO_PART, SimulatedSolution, activity_of, describe_candidate
from brink.server.problems.catalogue import make_problem
from brink.server.problems.changes import change_words, changes_between
from brink.server.problems.error_slots import NO_ERROR
from brink.server.problems.highway import HighwayPerception, HighwayPerceptionParams
from brink.sim.adapters.highway.specification import (
    GHOST_DISTANCE_M,
    MAGNITUDES,
    ErrorType,
    HighwayScenario,
    errors_from_json,
)
from brink.sim.episode import Verdict
from brink.worker.wire import Completed

HIGHWAY = HighwayPerception(HighwayPerceptionParams())
SCENARIO: dict[str, Any] = {
    "road": "highway",
    "goal": "straight",
    "lanes": 3,
    "density": 1.0,
    "traffic_speed": 0.8,
    "ego_speed": 1.0,
    "target_speed": 1.2,
}
MISS: dict[str, Any] = {
    "type": "miss",
    "target": "ahead",
    "onset_s": 4.2,
    "duration_s": 7.0,
    "severity": 1.2 / 8.0,
    "distance_m": 30.0,
}
NONE: dict[str, Any] = {
    **dict.fromkeys(("onset_s", "duration_s", "severity", "distance_m"), 0.0),
    "type": NO_ERROR,
    "target": "ahead",
}
WORDS = (
    "Highway with 3 lanes, overtaking where it is faster, traffic 100% as dense and 80% as fast as usual, "
    "starts at 30.0 m/s and aims at 36.0 m/s"
)


def candidate(*errors: dict[str, Any], **scenario: Any) -> tuple[Any, ...]:
    values = {
        f"error_{number}.{name}": value
        for number, one in enumerate([*errors, NONE, NONE][:2], start=1)
        for name, value in one.items()
    }
    return HIGHWAY.space.encode({"scenario": {**SCENARIO, **scenario}, "behaviour": values})


def result(*steps: list[int] | None) -> dict[str, Any]:
    return {"features": {"error_steps": list(steps)}}


def change(safe: Any, unsafe: Any, *, acted: bool = True) -> str:
    """Return the words of the change between two candidates with one error each, which had an effect or not."""
    sides = []
    for vectors in (safe, unsafe):
        present = HIGHWAY.space.decode(vectors)["behaviour"]["error_1.type"] != NO_ERROR
        found = result(*([[1, 9] if acted else None] if present else []))
        sides.append(
            SimulatedSolution(vectors=vectors, activity=activity_of(HIGHWAY, vectors, found), result=found)
        )
    rows = [HIGHWAY.space.join(one) for one in (safe, unsafe)]
    units = Steps(HIGHWAY.space).differing(rows[0], rows[1])
    one, other = sides
    return change_words(HIGHWAY, one, other, changes_between(HIGHWAY, one, other, units))


@given(st.integers(0, 2**32 - 1))
def test_every_candidate_becomes_an_episode_that_the_simulator_accepts(seed: int) -> None:
    vectors = HIGHWAY.space.sample(np.random.default_rng(seed))
    spec = HIGHWAY.episode(vectors, seed)
    scenario = HighwayScenario.from_json(spec.scenario)
    errors = errors_from_json(spec.behaviour, spec.duration_s)
    values = HIGHWAY.space.decode(vectors)["behaviour"]
    present = [prefix for prefix in ("error_1.", "error_2.") if values[prefix + "type"] != NO_ERROR]
    assert len(errors) == len(present)
    for prefix, error in zip(present, errors, strict=True):
        assert error.severity == pytest.approx(values[prefix + "severity"])
        if error.type is ErrorType.GHOST:
            assert error.distance_m == max(float(values[prefix + "distance_m"]), GHOST_DISTANCE_M[0])
    words = " and ".join(error.words for error in errors) or "no error"
    assert HIGHWAY.words(vectors) == f"{scenario.words}; {words}"


def test_an_episode_records_both_requirements_and_those_that_decide() -> None:
    spec = HIGHWAY.episode(candidate(MISS), 7)
    assert (spec.simulator, spec.seed, spec.duration_s) == ("highway-env@1", 7, 20.0)
    assert spec.requirements == ("no-collision@1", "front-gap@1")
    one = HighwayPerception(HighwayPerceptionParams(requirement="speed-limit@1"))
    assert one.requirements == ("speed-limit@1",)
    assert one.episode(candidate(), 1).requirements == ("no-collision@1", "front-gap@1", "speed-limit@1")


def test_with_truth_there_are_no_errors() -> None:
    truth = HIGHWAY.with_truth()
    assert truth is not None
    assert truth.episode(candidate(MISS), 1).behaviour == {"mode": "errors", "errors": []}
    assert truth.words(candidate(MISS)) == f"{WORDS}; no error"
    assert truth.with_truth() is None
    assert truth.activity(candidate(MISS), {"error_steps": []}) is None
    assert len(HIGHWAY.episode(candidate(MISS), 1).behaviour["errors"]) == 1  # type: ignore[arg-type]


def test_the_verdict_is_the_worst_of_the_requirements() -> None:
    verdicts = {
        "no-collision@1": Verdict(robustness=0.3, unit="m", violated_at_s=None),
        "front-gap@1": Verdict(robustness=-0.2, unit="m", violated_at_s=3.0),
    }
    outcome = Completed.model_validate(
        {
            "verdicts": {
                name: {"robustness": one.robustness, "unit": one.unit, "violated_at_s": one.violated_at_s}
                for name, one in verdicts.items()
            },
            "objectives": {"front-gap@1:robustness": -0.2},
            "features": {},
            "provenance": {},
        }
    )
    found = HIGHWAY.evaluation(outcome)
    assert (found.unsafe, found.robustness) == (True, -0.2)  # type: ignore[union-attr]
    lenient = HighwayPerception(HighwayPerceptionParams(requirement="no-collision@1")).evaluation(outcome)
    assert (lenient.unsafe, lenient.robustness) == (False, 0.3)  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("params", "pointer", "expected"),
    [
        ({"roads": []}, "/problem/params/roads", "expected some of highway, merge, roundabout, intersection"),
        ({"roads": ["merge", "merge"]}, "/problem/params/roads", "each once"),
        ({"roads": ["motorway"]}, "/problem/params/roads", "got 'motorway'"),
        ({"requirement": "no-crash@1"}, "/problem/params/requirement", "got 'no-crash@1'"),
        ({"errors": 9}, "/problem/params/errors", ""),
        ({"lanes": 3}, "/problem/params/lanes", ""),
    ],
)
def test_wrong_parameters_are_refused(params: dict[str, Any], pointer: str, expected: str) -> None:
    with pytest.raises(InvalidInput) as refused:
        make_problem("highway-perception@1", params)
    (error,) = refused.value.errors
    assert error.pointer == pointer
    assert expected in error.message


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ({}, {"severity": 2.4 / 8}, "the vehicle ahead is not perceived for 2.4 s instead of 1.2 s"),
        ({}, {"onset_s": 5.0}, "the vehicle ahead is not perceived for 1.2 s, from 5 s instead of 4.2 s"),
        (
            {},
            {"target": "left"},
            "the vehicle in the lane to the left is not perceived for 1.2 s from 4.2 s on "
            "(in the safe drive, the vehicle ahead is not perceived for 1.2 s from 4.2 s on)",
        ),
        (
            {"type": "short_range", "severity": 0.5},
            {"type": "short_range", "severity": 0.9},
            "the vehicle ahead is perceived only within 10 m instead of 50 m",
        ),
        (
            {"type": "ghost"},
            {"type": "ghost", "distance_m": 20.0},
            "a vehicle that is not there is perceived for 1.2 s 20 m ahead, 20 m instead of 30 m ahead",
        ),
        (
            {"type": "too_fast", "severity": 0.2},
            {"type": "too_fast", "severity": 0.2, "duration_s": 9.0},
            "the vehicle ahead is perceived 3.0 m/s too fast, for 9 s instead of 7 s",
        ),
    ],
)
def test_a_change_of_an_error_has_words(old: dict[str, Any], new: dict[str, Any], expected: str) -> None:
    assert change(candidate({**MISS, **old}), candidate({**MISS, **new})) == expected


def test_only_parameters_that_had_a_part_are_active() -> None:
    names = HIGHWAY.space.column_names()
    vectors = candidate(MISS, {**MISS, "type": "short_range"}, road="roundabout")
    found = HIGHWAY.activity(vectors, {"error_steps": [[3, 8], None]})
    assert found is not None
    active = {name.partition(".")[2] for name, on in zip(names, found.active, strict=True) if on}
    assert active == {
        "road",
        "goal",
        "density",
        "traffic_speed",
        "ego_speed",
        "target_speed",
        "error_1.type",
        "error_1.target",
        "error_1.onset_s",
        "error_1.severity",
    }
    assert found.idle == ()
    assert "lanes" in {
        name.partition(".")[2]
        for name, on in zip(names, HIGHWAY.activity(candidate(), {"error_steps": []}).active, strict=True)  # type: ignore[union-attr]
        if on
    }


def test_errors_that_had_no_part_are_not_described() -> None:
    found = HIGHWAY.activity(candidate(MISS), {"error_steps": [None]})
    assert found is not None
    assert found.idle == ("behaviour",)
    assert describe_candidate(HIGHWAY, candidate(MISS), found) == f"{WORDS}; no error; {NO_PART}"
    assert change(candidate(MISS), candidate({**MISS, "onset_s": 9.0}), acted=False).startswith(
        "the two differ"
    )


def test_a_record_that_does_not_fit_is_ignored() -> None:
    for features in ({}, {"error_steps": [None, None]}, {"error_steps": "yes"}):
        assert HIGHWAY.activity(candidate(MISS), features) is None


@pytest.mark.parametrize("kind", ErrorType)
def test_every_error_has_a_scale_and_words(kind: ErrorType) -> None:
    choices = {"behaviour.error_1.type": kind.value, "behaviour.error_1.target": "crossing"}
    scale = HIGHWAY.severity_scale(choices)
    assert scale is not None
    assert (scale.none, scale.most) == tuple(
        map(MAGNITUDES[kind].number, (MAGNITUDES[kind].none, MAGNITUDES[kind].most))
    )
    assert scale.words(0.5) in HIGHWAY.error_words(choices, scale.words(0.5))
    assert "crossing" in HIGHWAY.error_words(choices, "1")
    assert HIGHWAY.severity_scale({"behaviour.error_1.type": NO_ERROR}) is None
