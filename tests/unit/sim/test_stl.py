"""Signal temporal logic: robustness as rtamt computes it, the time of violation, and errors with their position."""

import json
import random
from collections.abc import Mapping
from typing import Final

import numpy as np
import pytest
from numpy.typing import ArrayLike
from support.stl_formulas import RECORDED, cases

from brink.formula import FormulaError
from brink.sim.stl import SMALLEST, Satisfaction, Stl

TIMES_S: Final = (0.0, 1.0, 2.0, 3.0, 5.0, 8.0)
SIGNALS: Final[Mapping[str, tuple[float, ...]]] = {
    "gap": (9.0, 6.0, 3.0, 1.0, 2.0, 4.0),
    "speed": (5.0, 5.0, 4.0, 2.0, 0.0, 0.0),
    "brakes": (0, 0, 1, 1, 0, 0),
    "lane": (1, 1, 2, 2, 2, 3),
}


def satisfaction(formula: str) -> Satisfaction:
    return Stl(formula).satisfaction(TIMES_S, SIGNALS)


@pytest.mark.parametrize(
    "part",
    [
        slice(0, 200),
        pytest.param(slice(200, None), marks=pytest.mark.long("further formulas of the same kinds")),
    ],
)
def test_random_formulas_have_the_robustness_that_rtamt_computes(part: slice) -> None:
    """Recordings are sampled unevenly; rtamt 0.4.10 in dense time, see `support.stl_formulas`."""
    known = json.loads(RECORDED.read_text())
    assert len(known) == 2_000
    found = [
        Stl(formula).satisfaction(times, signals).robustness
        for formula, (times, signals) in list(cases())[part]
    ]
    np.testing.assert_allclose(found, known[part], rtol=1e-8, atol=2 * SMALLEST)


@pytest.mark.parametrize(
    ("formula", "robustness", "violated_at_s"),
    [
        ("always (gap > 1.5)", -0.5, 3.0),
        ("always[0:2.9] (gap > 1.5)", 1.5, None),  # the sample at 2 s lasts until 3 s
        ("always[0:3] (gap > 1.5)", -0.5, 3.0),
        ("always[3.5:4] gap > 1.5", -0.5, 3.0),  # what holds at 3.5 s was recorded at 3 s
        ("always[20:30] gap > 5", -1.0, 8.0),  # the last values hold from then on
        ("eventually[0:4] speed < 1", -1.0, 3.0),  # with the sample at 3 s, which lasts until 5 s
        ("eventually[0:5] speed < 1", 1.0, None),
        ("eventually gap > 10", -1.0, 8.0),  # it might still have happened
        ("always (gap < 4 implies eventually[0:2] speed < 1)", -1.0, 3.0),
        ("always (gap < 4 implies eventually[0:3] speed < 1)", 1.0, None),
        ("gap > 2 until speed < 1", -1.0, 3.0),
        ("gap > 0.5 until[0:4] speed < 1", -1.0, 3.0),
        ("gap > 0.5 until[4:6] speed < 1", 0.5, None),
        ("gap > 5 and speed > 6 or gap > 20", -1.0, 0.0),
        ("not eventually gap < 2", -1.0, 3.0),
        ("always (brakes or gap > 5)", -3.0, 5.0),  # yes or no decides where, metres by how much
        ("always (gap > 1.5 or not brakes)", -0.5, 3.0),
        ("always (lane == 2 implies gap > 0)", 1.0, None),
        ("always (lane != 3)", -np.inf, 8.0),
        ("always (1 <= lane <= 3)", SMALLEST, None),
        ("always (lane < 3)", -SMALLEST, 8.0),
        ("not eventually lane >= 3", -SMALLEST, 8.0),
        ("always max(gap, speed) >= 2", SMALLEST, None),
    ],
)
def test_robustness_and_the_first_sample_that_decides(
    formula: str, robustness: float, violated_at_s: float | None
) -> None:
    found = satisfaction(formula)
    assert found.robustness == pytest.approx(robustness, rel=1e-12)
    assert found.violated_at_s == violated_at_s


def test_whatever_follows_a_violation_does_not_undo_it() -> None:
    rng = random.Random(2)
    checked = 0
    for formula, (times, signals) in list(cases())[:200]:
        parsed = Stl(formula)
        at_s = parsed.satisfaction(times, signals).violated_at_s
        if at_s is None:
            continue
        count = times.index(at_s) + 1
        for scale in (1.0, 1e3):
            other = {
                name: [*series[:count], *(rng.gauss(0, scale) for _ in times[count:])]
                for name, series in signals.items()
            }
            assert parsed.satisfaction(times, other).violated_at_s == at_s, formula
        checked += count < len(times)
    assert checked > 30


def test_margins_have_the_robustness_as_their_least_and_are_negative_from_the_violation_on() -> None:
    for formula, (times, signals) in list(cases())[:200]:
        parsed = Stl(formula)
        found, margins = parsed.satisfaction(times, signals), parsed.margins(times, signals)
        below = np.flatnonzero(margins < 0)
        assert margins.min() == found.robustness, formula
        assert (times[below[0]] if below.size else None) == found.violated_at_s, formula


def test_margins_of_what_must_hold_always_are_those_of_each_sample() -> None:
    margins = Stl("always[1:5] gap > 1.5 and always speed < 8").margins(TIMES_S, SIGNALS)
    assert margins.tolist() == [3.0, 3.0, 1.5, -0.5, 0.5, 8.0]


def test_texts_are_compared() -> None:
    signals: dict[str, ArrayLike] = {"light": ["green", "amber", "red"], "speed": [5.0, 4.0, 3.0]}
    found = Stl('always (light == "red" implies speed < 1)').satisfaction([0, 1, 2], signals)
    assert found == Satisfaction(robustness=-2.0, violated_at_s=2.0)


@pytest.mark.parametrize(
    ("formula", "message"),
    [
        ("always[0:20 (gap > 1)", r"character 13: expected '\]', got '\('"),
        ("always[5:2] gap > 1", "character 10: expected an end of at least 5, got '2'"),
        ("always[-1:2] gap > 1", "character 8: expected a number of seconds, got '-'"),
        ("gap >", "character 6: expected a signal or a number, got the end"),
        ("gap > * 2", r"character 7: expected a signal or a number, got '\*'"),
        ("gap > 1 speed < 2", "character 9: expected an operator, got 'speed'"),
        ("gap > 1)", r"character 8: expected and, or, until, implies or the end, got '\)'"),
        ("gap > 1 ; x", "character 9: expected a signal, a number or an operator, got ';'"),
        ("(gap > 1", r"character 9: expected '\)', got the end"),
        ("gap > 1 and exec('x')", r"character 13: .*exec\('x'\) is not allowed"),
        ("gap.__class__() > 1", "character 1: .*is not allowed"),
        ("not " * 40 + "gap > 1", "character 121: expected at most 30 operators within each other"),
        ("", "expected a formula such as"),
        ("x" * 1_001, "expected a formula of at most 1000 characters, got 1001"),
    ],
)
def test_a_wrong_formula_is_refused_with_the_position_of_the_fault(formula: str, message: str) -> None:
    with pytest.raises(FormulaError, match=message):
        Stl(formula)


@pytest.mark.parametrize(
    ("times_s", "signals", "message"),
    [
        ([0, 1], {"a": [1, 2]}, "no signal 'gap'; there are a"),
        ([0, 1], {"gap": [1, 2, 3]}, r"signal 'gap': expected shape \(2,\), as the times, got \(3,\)"),
        ([0, 1], {"gap": ["near", "far"]}, "signal 'gap': expected numbers"),
        ([0, 1], {"gap": [1, np.nan]}, "'gap > 1': not a number 1 s after the first sample"),
        ([0, 0], {"gap": [1, 2]}, "times: expected increasing ones, got 0 s after 0 s"),
        ([0, np.inf], {"gap": [1, 2]}, "times: expected finite seconds"),
        ([], {"gap": []}, "times: expected at least one sample"),
    ],
)
def test_a_recording_that_cannot_be_judged_is_refused(
    times_s: list[float], signals: dict[str, list[float]], message: str
) -> None:
    with pytest.raises(FormulaError, match=message):
        Stl("always gap > 1").satisfaction(times_s, signals)


def test_a_formula_knows_its_signals_and_when_it_can_begin_to_be_judged() -> None:
    parsed = Stl("always[2:5] (gap > 1 until[3:4] speed < `own limit` or gap < 9)")
    assert (parsed.names, parsed.begins_s) == (("gap", "speed", "own limit"), 5.0)
