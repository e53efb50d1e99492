"""Formulas as requirements of drives: verdicts like those of requirements in Python, in traces and in words."""

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.drives import urban_drive

from brink.pictures.story import story_of
from brink.sim.episode import EpisodeSpec, Json
from brink.sim.errors import InvalidEpisode, SimulationCrashed
from brink.sim.formula_requirement import FARTHEST_M, SIGNALS, FormulaRequirement, formula_requirements
from brink.sim.requirements import FrontGap, SpeedLimit, WorldSample
from brink.sim.trace import Trace
from brink.sim.urban.simulator import BrinkDrive

SAMPLE = WorldSample(
    time_s=0.1,
    x_m=0.0,
    y_m=0.0,
    yaw_rad=0.0,
    speed_mps=5.0,
    station_m=0.0,
    offset_m=0.0,
    heading_error_rad=0.0,
    ego_length_m=4.0,
    ego_width_m=1.8,
    lane_left_m=1.7,
    lane_right_m=-1.7,
    speed_limit_mps=8.0,
)


def requirement(stl: str, unit: str = "m", **more: Json) -> FormulaRequirement:
    return formula_requirements({"own": {"stl": stl, "unit": unit, **more}})["own"]


def drive(number: int, formulas: Mapping[str, Json], *, record: bool = False) -> Any:
    known = EpisodeSpec.from_json(json.loads(json.dumps(urban_drive(number).about["spec"])))
    spec = replace(known, requirements=(*known.requirements, *formulas), formulas=formulas)
    assert EpisodeSpec.from_json(spec.to_json()) == spec
    return BrinkDrive().run(spec, record=record)


def test_an_episode_without_formulas_keeps_its_hash() -> None:
    spec = EpisodeSpec.from_json(json.loads(json.dumps(urban_drive(0).about["spec"])))
    assert "formulas" not in spec.canonical_json()
    assert spec.digest() != replace(spec, formulas={"own": {"stl": "speed_mps < 9", "unit": "m/s"}}).digest()


@pytest.mark.parametrize("number", [1, 4])
def test_a_formula_gives_the_verdict_of_the_same_requirement_in_python(number: int) -> None:
    result = drive(number, {"gap": {"stl": "always (front_gap_m >= 1.5)", "unit": "m"}})
    own, python = result.verdicts["gap"], result.verdicts["front-gap@1"]
    assert own.robustness == pytest.approx(min(python.robustness, FARTHEST_M - 1.5))
    assert (own.unit, own.violated_at_s) == (python.unit, python.violated_at_s)


def test_a_violation_is_shown_when_it_is_decided() -> None:
    stl = "eventually[0:3] (speed_mps < 0.1 and accel_mps2 > 5)"
    result = drive(1, {"slow-down": {"stl": stl, "unit": "m/s"}}, record=True)
    verdict = result.verdicts["slow-down"]
    trace = Trace.from_bytes(result.trace)
    story = story_of(trace, "slow-down")
    assert verdict.robustness < 0
    assert verdict.violated_at_s == pytest.approx(3.0, abs=0.05)
    assert trace.robustness["slow-down"].min() == pytest.approx(verdict.robustness, rel=1e-6)
    assert story.words.startswith("violated slow down at 3.0 s")
    assert (story.unit, story.formula) == ("m/s", stl)
    assert abs(trace.time_s[story.decisive] - 3.0) < 0.2


@pytest.mark.parametrize(
    ("stl", "python"),
    [
        ("always (front_gap_m >= 1.5)", FrontGap),
        ("always (speed_limit_mps + 0.5 >= speed_mps and speed_limit_mps + 0.5 >= -speed_mps)", SpeedLimit),
    ],
)
def test_a_formula_measures_what_the_same_requirement_in_python_does(stl: str, python: Any) -> None:
    mine, other = requirement(stl, horizon=50.0), python()
    rng = np.random.default_rng(0)
    for step in range(200):
        gap_m = None if rng.random() < 0.2 else float(rng.uniform(0, 60))
        sample = replace(
            SAMPLE, time_s=0.05 * (step + 1), speed_mps=float(rng.normal(5, 2)), front_gap_m=gap_m
        )
        mine.observe(sample)
        other.observe(sample)
        assert mine.verdict().robustness == pytest.approx(other.verdict().robustness, abs=2e-9)
        assert mine.verdict().violated_at_s == other.verdict().violated_at_s


def test_signals_are_what_they_are_called() -> None:
    one = requirement("always (accel_mps2 > -3)", "m/s²")
    for step, speed_mps in enumerate((5.0, 4.9, 4.0)):
        one.observe(replace(SAMPLE, time_s=0.1 * (step + 1), speed_mps=speed_mps))
    verdict = one.verdict()
    assert verdict.robustness == pytest.approx(-6.0)
    assert verdict.violated_at_s == pytest.approx(0.3)
    read = {name: signal(SAMPLE) for name, signal in SIGNALS.items()}
    assert (read["front_gap_m"], read["speed_mps"], read["light_red"]) == (FARTHEST_M, 5.0, False)


def test_what_only_yes_or_no_decides_has_the_horizon_as_its_robustness() -> None:
    one = requirement("always not collision", horizon=20.0)
    one.observe(SAMPLE)
    assert one.verdict().robustness == 20.0
    assert one.margins(np.array([0.0])).tolist() == [np.inf]


def test_a_comparison_without_a_value_fails_the_episode() -> None:
    one = requirement("always front_gap_m / speed_mps > 1", "s")
    one.observe(replace(SAMPLE, speed_mps=0.0, front_gap_m=0.0))
    with pytest.raises(SimulationCrashed, match="not a number"):
        one.verdict()


@pytest.mark.parametrize(
    ("name", "stated", "message"),
    [
        ("Own!", {"stl": "collision", "unit": "1"}, "expected a name of lower-case letters"),
        ("own", "always collision", "expected {stl: FORMULA, unit: UNIT}"),
        ("own", {"stl": "collision"}, "expected {stl: FORMULA, unit: UNIT}"),
        ("own", {"stl": "collision", "unit": ""}, "expected a unit such as m"),
        ("own", {"stl": "collision", "unit": "1", "horizon": -1}, "expected a horizon above 0"),
        ("own", {"stl": "front_gap > 1", "unit": "m"}, "no signal 'front_gap' .*did you mean 'front_gap_m'"),
        ("own", {"stl": "speed_mps >", "unit": "m"}, "character 12: expected a signal or a number"),
    ],
)
def test_a_wrong_statement_is_refused(name: str, stated: Json, message: str) -> None:
    with pytest.raises(InvalidEpisode, match=message):
        drive(1, {name: stated})
