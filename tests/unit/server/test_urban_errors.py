"""The problem of an obstacle detector that reports the truth with errors: episodes, activity and words."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.marks import mostly_long
from support.urban_pairs import SCENARIO

from brink.search.pairs import Steps
from brink.search.space import Categorical
from brink.server.errors import InvalidInput
from brink.server.problems.base import NO_PART, Activity, SimulatedSolution, activity_of, describe_candidate
from brink.server.problems.catalogue import make_problem
from brink.server.problems.changes import NOTHING_ACTIVE, change_words, changes_between
from brink.server.problems.error_slots import NO_ERROR
from brink.server.problems.sumo import SumoDrivers, SumoDriversParams
from brink.server.problems.urban_errors import UrbanErrors, UrbanErrorsParams
from brink.sim.catalogue import make_simulator
from brink.sim.episode import EpisodeResult
from brink.sim.urban.behaviour import steps_from_json
from brink.sim.urban.detection_errors import (
    BOX_TYPES,
    MAGNITUDES,
    MAX_ERRORS,
    DetectionError,
    ErrorType,
    Target,
    errors_from_json,
)

URBAN = UrbanErrors(UrbanErrorsParams())
SHORT = UrbanErrors(UrbanErrorsParams(errors=3, duration_s=8.0))
MISS: dict[str, Any] = {
    "type": "miss",
    "target": "lead",
    "onset": "time",
    "onset_s": 4.2,
    "duration_s": 2.0,
    "severity": 1.3 / 8.0,
}
FAR = {**MISS, "type": "too_far", "severity": 0.2}
NONE = {**MISS, "type": NO_ERROR, "onset_s": 0.0, "duration_s": 0.0, "severity": 0.0}


def candidate(*errors: dict[str, Any], problem: UrbanErrors = URBAN, **scenario: str) -> tuple[Any, ...]:
    values = {
        f"error_{number}.{name}": value
        for number, one in enumerate([*errors, *[NONE] * (problem.params.errors - len(errors))], start=1)
        for name, value in one.items()
    }
    return problem.space.encode({"scenario": {**SCENARIO, **scenario}, "behaviour": values})


def errors_of(problem: UrbanErrors, vectors: Any) -> tuple[DetectionError, ...]:
    spec = problem.episode(vectors, 1)
    return errors_from_json(spec.behaviour, spec.duration_s)


@given(st.integers(0, 2**32 - 1), st.sampled_from([URBAN, SHORT]))
def test_every_candidate_becomes_an_episode_that_the_simulator_accepts(
    seed: int, problem: UrbanErrors
) -> None:
    vectors = problem.space.sample(np.random.default_rng(seed))
    found = errors_of(problem, vectors)
    values = problem.space.decode(vectors)["behaviour"]
    present = [
        f"error_{number}."
        for number in range(1, problem.params.errors + 1)
        if values[f"error_{number}.type"] != NO_ERROR
    ]
    assert len(found) == len(present)
    for prefix, one in zip(present, found, strict=True):
        scale = MAGNITUDES[one.type]
        assert (one.type, one.target) == (values[prefix + "type"], values[prefix + "target"])
        assert one.magnitude == scale.at(float(values[prefix + "severity"]))
        assert one.severity == pytest.approx(values[prefix + "severity"])
        if scale.has_window:
            assert (one.onset, one.onset_s) == (values[prefix + "onset"], values[prefix + "onset_s"])
        if scale.has_duration:
            assert one.duration_s == values[prefix + "duration_s"]
    words = problem.words(vectors)
    assert words.endswith("; " + (" and ".join(one.words for one in found) or "no error"))


@pytest.mark.parametrize(
    ("kind", "severity", "magnitude"),
    [
        ("miss", 0.25, 2.0),
        ("late", 1.0, 8.0),
        ("flicker", 0.3, 0.3),
        ("too_far", 0.5, 0.5),
        ("too_near", 0.5, 0.4),
        ("left", 0.25, 1.0),
        ("right", 1.0, 4.0),
        ("too_large", 0.1, 0.1),
        ("too_small", 1.0, 0.8),
        ("wrong_label", 0.5, 4.0),
        ("short_range", 0.0, 60.0),
        ("short_range", 0.75, 15.0),
        ("ghost_on_road", 0.5, 4.0),
        ("ghost_in_image", 0.0, 0.0),
    ],
)
def test_a_severity_becomes_a_magnitude(kind: str, severity: float, magnitude: float) -> None:
    (one,) = errors_of(URBAN, candidate({**MISS, "type": kind, "severity": severity}))
    assert one.magnitude == pytest.approx(magnitude)


@pytest.mark.parametrize("problem", [URBAN, SumoDrivers(SumoDriversParams())], ids=lambda problem: problem.id)
def test_the_defaults_of_algorithms_name_parameters_and_choices(problem: UrbanErrors | SumoDrivers) -> None:
    defaults = problem.algorithm_defaults
    parameters = {
        f"{component.name}.{one.name}": one
        for component in problem.space.components
        for one in component.parameters
    }
    chosen = {**defaults["fixed"], **defaults["truth"], **defaults.get("grossest", {})}
    for condition, needed in defaults.get("needs", {}).items():
        name, _, value = condition.partition("=")
        chosen[name] = value
        chosen |= {other: choice for other, choices in needed.items() for choice in choices}
    assert {defaults["severity"], *chosen} <= set(parameters)
    for name, value in chosen.items():
        one = parameters[name]
        assert value in one.choices if isinstance(one, Categorical) else one.low <= value <= one.high


@pytest.mark.parametrize(
    ("params", "pointer"),
    [
        ({"errors": 0}, "errors"),
        ({"errors": MAX_ERRORS + 1}, "errors"),
        ({"errors": 1.5}, "errors"),
        ({"duration_s": 4.9}, "duration_s"),
        ({"duration_s": 121.0}, "duration_s"),
        ({"fidelity": "tricycle"}, "fidelity"),
        ({"requirement": "front-gap"}, "requirement"),
        ({"requirement": []}, "requirement"),
        ({"timeout_s": 0.0}, "timeout_s"),
        ({"error": 2}, "error"),
    ],
)
def test_parameters_outside_their_bounds_are_refused(params: dict[str, Any], pointer: str) -> None:
    with pytest.raises(InvalidInput) as caught:
        make_problem("urban-errors@1", params)
    assert [one.pointer for one in caught.value.errors] == [f"/problem/params/{pointer}"]


def test_with_the_truth_there_is_no_error() -> None:
    vectors = candidate(MISS, FAR)
    truth = URBAN.with_truth()
    assert truth is not None
    assert truth.space.column_names() == URBAN.space.column_names()
    assert errors_of(truth, vectors) == ()
    assert truth.episode(vectors, 3).scenario == URBAN.episode(vectors, 3).scenario
    assert truth.words(vectors).endswith("; no error")
    assert truth.with_truth() is None
    assert activity_of(truth, vectors, {"features": {"error_steps": []}}) is None
    assert len(errors_of(URBAN, vectors)) == 2, "the problem itself is as it was"


def known(vectors: Any, *steps: Any, problem: UrbanErrors = URBAN) -> Activity:
    found = activity_of(problem, vectors, {"features": {"error_steps": [*steps]}})
    assert found is not None
    return found


def inactive(found: Activity, problem: UrbanErrors = URBAN) -> set[str]:
    names = problem.space.column_names()
    return {name for name, active in zip(names, found.active, strict=True) if not active}


def members(number: int, *fields: str) -> set[str]:
    return {f"behaviour.error_{number}.{name}" for name in fields or MISS}


NUMBERS = ("target", "onset", "onset_s", "duration_s", "severity")


@pytest.mark.parametrize("kind", BOX_TYPES)
def test_parameters_that_a_type_lacks_are_inactive(kind: ErrorType) -> None:
    vectors = candidate({**FAR, "type": kind.value})
    lacks: tuple[str, ...] = ()
    if kind in (ErrorType.LATE, ErrorType.SHORT_RANGE):
        lacks = ("onset", "onset_s", "duration_s")
    elif kind in (ErrorType.MISS, ErrorType.WRONG_LABEL, ErrorType.GHOST_ON_ROAD, ErrorType.GHOST_IN_IMAGE):
        lacks = ("duration_s",)
    expected = {f"behaviour.error_1.{name}" for name in lacks} | members(2, *NUMBERS)
    found = known(vectors, [10, 20])
    assert inactive(found) == expected
    assert found.idle == ()
    assert found.effective.tolist() == np.concatenate(vectors).tolist()


def test_an_error_that_never_acted_is_as_good_as_none() -> None:
    vectors = candidate(MISS, FAR)
    found = known(vectors, None, [50, 69])
    assert inactive(found) == members(1)
    assert found.idle == ()
    same = candidate(NONE, FAR)
    assert found.effective.tolist() == np.concatenate(same).tolist()
    assert describe_candidate(URBAN, vectors, found) == describe_candidate(URBAN, same)


@pytest.mark.parametrize(
    ("errors", "steps", "expected"),
    [
        ((MISS, FAR), [None, None], members(1) | members(2)),
        # Where there is no error, another type would have been one.
        ((NONE, MISS), [None], members(1, *NUMBERS) | members(2)),
        ((), [], members(1, *NUMBERS) | members(2, *NUMBERS)),
    ],
    ids=["two", "one", "none"],
)
def test_a_behaviour_in_which_nothing_acted_is_idle(
    errors: tuple[dict[str, Any], ...], steps: list[Any], expected: set[str]
) -> None:
    vectors = candidate(*errors)
    found = known(vectors, *steps)
    assert found.idle == ("behaviour",)
    assert inactive(found) == expected
    assert describe_candidate(URBAN, vectors, found).endswith(f"; no error; {NO_PART}")


@pytest.mark.parametrize(
    "result",
    [
        None,
        {},
        {"features": {}},
        {"features": {"error_steps": []}},
        {"features": {"error_steps": [[1, 2], [1, 2]]}},
        {"features": {"error_steps": [[2, 1]]}},
        {"features": {"error_steps": ["1"]}},
        {"features": {"error_steps": {"0": [1, 2]}}},
    ],
    ids=["no result", "no features", "older", "too few", "too many", "backwards", "text", "object"],
)
def test_what_was_not_recorded_is_unknown(result: dict[str, Any] | None) -> None:
    vectors = candidate(MISS)
    assert activity_of(URBAN, vectors, result) is None
    assert describe_candidate(URBAN, vectors).endswith("; the lead is not reported for 1.3 s from 4.2 s on")


@pytest.fixture(name="run", scope="module")
def _run() -> Callable[[Any, int], EpisodeResult]:
    """Run an episode of `SHORT`."""
    simulator = make_simulator(SHORT.needs)
    return lambda vectors, seed: simulator.run(SHORT.episode(vectors, seed))


@pytest.mark.parametrize("number", mostly_long(range(30), range(12), "further random candidates"))
def test_inactive_parameters_do_not_change_the_episode(
    run: Callable[[Any, int], EpisodeResult], number: int
) -> None:
    rng = np.random.default_rng([11, number])
    vectors = SHORT.space.sample(rng)
    result = run(vectors, number)
    steps = steps_from_json(result.features["error_steps"])
    assert steps is not None
    found = known(vectors, *result.features["error_steps"], problem=SHORT)  # type: ignore[misc]
    assert bool(found.idle) == all(one is None for one in steps)
    # What never acted becomes no error, and all other inactive parameters are drawn afresh.
    behaviour = SHORT.space.decode(SHORT.space.split(found.effective))["behaviour"]
    unused = inactive(found, SHORT)
    for parameter in SHORT.space.components[1].parameters:
        prefix, _, name = parameter.name.partition(".")
        if f"behaviour.{parameter.name}" not in unused or name == "type":
            continue
        if isinstance(parameter, Categorical):
            behaviour[parameter.name] = str(rng.choice(parameter.choices))
        elif behaviour[f"{prefix}.type"] != NO_ERROR:  # the numbers of no error are 0
            behaviour[parameter.name] = float(rng.uniform(parameter.low, parameter.high))
    changed = SHORT.space.encode(
        {"scenario": SHORT.space.decode(vectors)["scenario"], "behaviour": behaviour}
    )
    assert not unused or not np.array_equal(SHORT.space.join(changed), SHORT.space.join(vectors))
    again = run(changed, number)
    assert again.verdicts == result.verdicts
    assert again.objectives == result.objectives
    acted = [one for one in result.features["error_steps"] if one is not None]  # type: ignore[union-attr]
    assert {**again.features, "error_steps": acted} == {**result.features, "error_steps": acted}
    assert again.features["error_steps"] == acted


def test_the_drives_contain_errors_of_all_kinds_of_activity() -> None:
    """Keep the check above from comparing only drives without any error."""
    behaviours = [
        SHORT.space.decode(SHORT.space.sample(np.random.default_rng([11, number])))["behaviour"]
        for number in range(12)
    ]
    kinds = {values[f"error_{index}.type"] for values in behaviours for index in (1, 2, 3)}
    assert len(kinds - {NO_ERROR}) >= 8


def solution(*errors: dict[str, Any], acted: bool = True, **scenario: str) -> SimulatedSolution:
    vectors = candidate(*errors, problem=URBAN, **scenario)
    steps = [[50, 60] if acted else None for one in errors if one["type"] != NO_ERROR]
    result = {"features": {"error_steps": steps}}
    return SimulatedSolution(vectors=vectors, activity=activity_of(URBAN, vectors, result), result=result)


def words(safe: SimulatedSolution, unsafe: SimulatedSolution) -> str:
    rows = [URBAN.space.join(tuple(one.vectors)) for one in (safe, unsafe)]
    units = Steps(URBAN.space).differing(*rows)
    return change_words(URBAN, safe, unsafe, changes_between(URBAN, safe, unsafe, units))


LONGER = {**MISS, "severity": 1.5 / 8.0}


@pytest.mark.parametrize(
    ("safe", "unsafe", "expected"),
    [
        (MISS, LONGER, "the lead is not reported for 1.5 s instead of 1.3 s"),
        (LONGER, MISS, "the lead is not reported for 1.3 s instead of 1.5 s"),
        (
            {**MISS, "target": "oncoming"},
            {**LONGER, "target": "oncoming"},
            "no oncoming vehicle is reported for 1.5 s instead of 1.3 s",
        ),
        (FAR, {**FAR, "severity": 0.25}, "the lead is reported 25% instead of 20% too far away"),
        (
            {**FAR, "type": "left"},
            {**FAR, "type": "left", "severity": 0.25},
            "the lead is reported 1 m instead of 0.8 m too far left",
        ),
        (
            {**MISS, "type": "short_range", "severity": 0.5},
            {**MISS, "type": "short_range", "severity": 0.75},
            "every vehicle going the same way is reported only within 15 m instead of 30 m",
        ),
        (
            {**MISS, "type": "late"},
            {**LONGER, "type": "late"},
            "every vehicle going the same way is first reported 1.5 s instead of 1.3 s late",
        ),
        (
            MISS,
            {**LONGER, "onset_s": 4.5},
            "the lead is not reported for 1.5 s instead of 1.3 s, from 4.5 s instead of 4.2 s",
        ),
        (
            MISS,
            {**LONGER, "onset": "lead_brakes"},
            "the lead is not reported for 1.5 s instead of 1.3 s, when the lead brakes after 4.2 s instead of from "
            "4.2 s on",
        ),
        (
            FAR,
            {**FAR, "severity": 0.25, "duration_s": 2.5},
            "the lead is reported 25% instead of 20% too far away, for 2.5 s instead of 2 s",
        ),
        (
            MISS,
            FAR,
            "the lead is reported 20% too far away for 2.0 s from 4.2 s on (in the safe drive, the lead is not "
            "reported for 1.3 s from 4.2 s on)",
        ),
        (
            MISS,
            {**MISS, "target": "pedestrian"},
            "the nearest pedestrian is not reported for 1.3 s from 4.2 s on (in the safe drive, the lead is not "
            "reported for 1.3 s from 4.2 s on)",
        ),
        (NONE, MISS, "the lead is not reported for 1.3 s from 4.2 s on"),
        (
            NONE,
            {**MISS, "onset": "pedestrian_steps_out"},
            "the lead is not reported for 1.3 s when a pedestrian steps out after 4.2 s",
        ),
        (MISS, NONE, "without the error that the lead is not reported for 1.3 s from 4.2 s on"),
    ],
)
def test_a_change_of_an_error_is_described(
    safe: dict[str, Any], unsafe: dict[str, Any], expected: str
) -> None:
    assert words(solution(safe), solution(unsafe)) == expected
    assert words(solution(NONE, safe), solution(NONE, unsafe)) == expected


def test_what_had_no_part_in_either_drive_is_not_described() -> None:
    assert words(solution(MISS), solution({**MISS, "duration_s": 5.0})) == NOTHING_ACTIVE
    assert words(solution(MISS, acted=False), solution(LONGER, acted=False)) == NOTHING_ACTIVE
    assert words(solution(NONE), solution({**NONE, "target": "crossing"})) == NOTHING_ACTIVE


@pytest.mark.parametrize("kind", BOX_TYPES)
def test_severities_have_the_scale_of_their_type(kind: ErrorType) -> None:
    scale = URBAN.severity_scale({"behaviour.error_1.type": kind.value, "behaviour.error_2.type": NO_ERROR})
    assert scale is not None
    assert scale.meaning == MAGNITUDES[kind].meaning
    (one,) = errors_of(URBAN, candidate({**MISS, "type": kind.value, "severity": 0.3}))
    assert scale.words(0.3) == MAGNITUDES[kind].words(one.magnitude)
    assert scale.words(0.3) in one.words


@pytest.mark.parametrize(
    "choices", [{}, {"behaviour.error_1.type": NO_ERROR}, {"behaviour.error_2.type": "miss"}]
)
def test_without_a_type_severities_have_no_scale(choices: dict[str, str]) -> None:
    assert URBAN.severity_scale(choices) is None


@pytest.mark.parametrize(
    ("kind", "target", "expected"),
    [
        ("miss", "lead", "not reporting the lead for 1.3 s"),
        ("miss", None, "not reporting road users for 1.3 s"),
        ("miss", "oncoming", "not reporting any oncoming vehicle for 1.3 s"),
        ("flicker", "everybody", "not reporting any road user 1.3 s of the time"),
        ("late", "pedestrian", "first reporting every pedestrian 1.3 s late"),
        ("short_range", "lead", "reporting every vehicle going the same way only within 1.3 s"),
        ("wrong_label", "pedestrian", "reporting the nearest pedestrian with the wrong label for 1.3 s"),
        ("too_far", "oncoming", "reporting every oncoming vehicle 1.3 s too far away"),
        ("ghost_on_road", "pedestrian", "reporting a person who is not there on the road for 1.3 s"),
        (
            "ghost_in_image",
            "crossing",
            "reporting a crossing vehicle that is not there at a fixed place in the image for 1.3 s",
        ),
    ],
)
def test_an_error_is_described_as_an_activity(kind: str, target: str | None, expected: str) -> None:
    choices = {"behaviour.error_1.type": kind}
    if target is not None:
        choices["behaviour.error_1.target"] = target
    assert URBAN.error_words(choices, "1.3 s") == expected


@pytest.mark.parametrize("kind", BOX_TYPES)
def test_each_error_has_words_of_its_own(kind: ErrorType) -> None:
    choices = [
        {"behaviour.error_1.type": one.value, "behaviour.error_1.target": Target.EVERYBODY.value}
        for one in ErrorType
    ]
    found = [URBAN.error_words(one, "1.3 s") for one in choices]
    assert len(set(found)) == len(ErrorType)
    assert all("1.3 s" in one for one in found)
    assert errors_of(URBAN, candidate({**MISS, "type": kind.value}))[0].words in URBAN.words(
        candidate({**MISS, "type": kind.value})
    )
