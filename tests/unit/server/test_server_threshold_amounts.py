"""Values of numbers in the units in which people read thresholds."""

from collections.abc import Mapping

import numpy as np
import pytest

from brink.search.algorithm import Evaluation
from brink.search.parameters import Value
from brink.search.space import Component, Real, SearchSpace
from brink.server.findings.thresholds.words import Amounts, parameter_words
from brink.server.problems.base import InProcessProblem, NoParams, Problem, SimulatedSolution, Vectors
from brink.server.problems.catalogue import make_problem
from brink.sim.driving.interface import PERCEPTION_STEP_S
from brink.sim.urban.detection_errors import MAGNITUDES, ErrorType


def test_severities_are_read_in_the_unit_of_their_error() -> None:
    problem = make_problem("urban-errors@1", {})
    space = problem.space
    values = space.decode(space.sample(np.random.default_rng(1)))
    values["behaviour"] |= {"error_2.type": "miss", "error_2.target": "lead", "error_2.severity": 0.25}
    row = space.join(space.encode(values))
    column = space.column_names().index("behaviour.error_2.severity")
    amounts = Amounts.of(problem, column, row, space.resolutions(row)[0][column])
    longest = MAGNITUDES[ErrorType.MISS].most
    assert (amounts.unit, amounts.decimals) == ("s", 1)
    assert amounts.words(0.25) == f"{0.25 * longest:.1f} s"
    assert amounts.interval(0.5, 0.25) == f"[{0.25 * longest:.1f}, {0.5 * longest:.1f}]"
    traits = problem.traits("behaviour.error_2.severity", values)
    assert traits[:3] == ("severity", "miss", "lead")
    assert traits[-1] == values["scenario"]["road_curve"]


def test_steps_are_read_in_seconds() -> None:
    problem = make_problem("urban-injected@1", {})
    space = problem.space
    row = space.join(space.sample(np.random.default_rng(1)))
    name = "behaviour.trajectory_1.t0_step"
    amounts = Amounts.of(problem, space.column_names().index(name), row, 1.0)
    assert amounts.words(13.0) == f"{13 * PERCEPTION_STEP_S:.1f} s"
    assert problem.traits(name, space.decode(space.split(row)))[0] == "t0_step"


def errors(kind: str) -> tuple[Problem, Mapping[str, Mapping[str, Value]]]:
    """Return a problem and a decoded solution whose second error is of a type."""
    problem = make_problem("urban-errors@1", {})
    values = problem.space.decode(problem.space.sample(np.random.default_rng(1)))
    error: dict[str, Value] = {
        "type": kind,
        "target": "lead",
        "severity": 0.25,
        "onset": "lead_brakes",
        "onset_s": 4.0,
    }
    second = {f"error_2.{name}": value for name, value in error.items()}
    return problem, {**values, "behaviour": {**values["behaviour"], **second, "error_2.duration_s": 2.0}}


@pytest.mark.parametrize(
    ("kind", "field", "words"),
    [
        ("miss", "severity", "how long the target is not reported"),
        ("right", "duration_s", "how long the lead is reported 1.0 m too far right"),
        ("right", "onset_s", "from when on the lead is reported 1.0 m too far right"),
    ],
)
def test_a_number_of_an_error_is_named_by_what_the_error_does(kind: str, field: str, words: str) -> None:
    problem, values = errors(kind)
    side = SimulatedSolution(vectors=problem.space.encode(values))
    assert parameter_words(problem, f"behaviour.error_2.{field}", side, "s") == words


def test_an_edge_of_a_box_is_named_by_where_it_is() -> None:
    problem = make_problem("urban-injected@1", {})
    side = SimulatedSolution(vectors=problem.space.sample(np.random.default_rng(1)))
    words = parameter_words(problem, "behaviour.trajectory_2.y_min_1_px", side, "px")
    assert words == "upper edge of the last box of report 2 in the image"


def test_a_component_is_named_only_where_two_have_a_parameter_of_that_name() -> None:
    class Plain(InProcessProblem):
        id = "plain@1"
        summary = "Plain."
        params_type = NoParams

        def __init__(self) -> None:
            first = Component("parameters", (Real("gap_mps", 0.0, 1.0, unit="m/s"), Real("speed", 0.0, 1.0)))
            self.space = SearchSpace((first, Component("other", (Real("speed", 0.0, 1.0),))))

        def evaluate(self, vectors: Vectors) -> Evaluation:
            raise NotImplementedError

    problem = Plain()
    side = SimulatedSolution(vectors=problem.space.sample(np.random.default_rng(1)))
    words = [parameter_words(problem, name, side, "m/s") for name in problem.space.column_names()]
    assert words == ["gap", "parameters: speed", "other: speed"]


def test_a_moment_under_the_same_condition_is_given_as_seconds_alone() -> None:
    problem, values = errors("right")
    later = {**values, "behaviour": {**values["behaviour"], "error_2.onset_s": 5.5}}
    sides = [SimulatedSolution(vectors=problem.space.encode(one)) for one in (values, later)]
    words = problem.words_of_change(sides[0], sides[1], ["behaviour.error_2.onset_s"])
    assert (
        words == "the lead is reported 1.0 m too far right, when the lead brakes after 5.5 s instead of 4 s"
    )


def test_amounts_of_values_beyond_the_line_are_unknown() -> None:
    amounts = Amounts(unit="m", at_0=0.0, per_1=2.0, decimals=1)
    assert amounts.amount(np.inf) is None
    assert amounts.interval(1.0, np.inf) == "[2.0, beyond]"
    assert amounts.difference(0.01, 0.1) == "less than 0.2 m"


def test_a_difference_below_the_resolution_names_the_resolution_itself() -> None:
    amounts = Amounts(unit="m", at_0=0.0, per_1=4.0, decimals=1)
    assert amounts.difference(0.21 / 4.0, 0.25 / 4.0) == "less than 0.25 m"  # not 0.2: it is more than that


def test_amounts_of_a_log_scale_are_numbers_and_their_differences_factors() -> None:
    amounts = Amounts(unit="1/s", at_0=0.0, per_1=1.0, decimals=8, digits=3)
    value = float(np.log(1.2345e-4))
    assert amounts.words(value) == "0.000123 1/s"
    assert amounts.amount(value) == pytest.approx(1.2345e-4)
    assert np.exp(amounts.rounded(value)) == pytest.approx(1.23e-4)
    assert amounts.interval(value, value - 1.0) == "[4.54e-05, 0.000123]"
    assert amounts.difference(np.log(1.5), np.log(1.1)) == "a factor of 1.5"
    assert amounts.difference(0.0, np.log(1.1)) == "a factor of less than 1.1"
    assert amounts.apart(np.log(1.5)) == pytest.approx(1.5)


def test_one_step_is_singular_and_symbols_stay() -> None:
    steps = Amounts(unit="steps", at_0=0.0, per_1=1.0, decimals=0)
    assert steps.difference(0.5, 1.0) == "less than 1 step"
    assert (steps.words(1.0), steps.words(11.0)) == ("1 step", "11 steps")
    assert Amounts(unit="s", at_0=0.0, per_1=1.0, decimals=0).words(1.0) == "1 s"
