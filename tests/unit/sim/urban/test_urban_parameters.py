import json
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from brink.sim.driving.interface import ObstacleLabel
from brink.sim.episode import JsonObject
from brink.sim.errors import InvalidEpisode
from brink.sim.urban.behaviour import (
    BOX_FIELDS,
    TRAJECTORY_FIELDS,
    BehaviourMode,
    DetectorBehaviour,
    InjectedTrajectory,
)
from brink.sim.world.scenario import SCENARIO_CHOICES, UrbanScenario

scenarios = st.fixed_dictionaries({name: st.sampled_from(v) for name, v in SCENARIO_CHOICES.items()})


def trajectory(**changes: object) -> JsonObject:
    corners = dict(zip(BOX_FIELDS, (100.0, 200.0, 250.0, 400.0, 300.0, 500.0, 200.0, 500.0), strict=True))
    document: JsonObject = {"label": "vehicle", "t0_step": 10.0, "t1_step": 110.0, **corners}
    document.update(changes)  # type: ignore[arg-type]
    return document


def behaviour(*trajectories: JsonObject) -> JsonObject:
    return {"mode": "injected", "trajectories": list(trajectories)}


@given(scenarios)
def test_a_scenario_survives_a_json_round_trip(document: JsonObject) -> None:
    scenario = UrbanScenario.from_json(json.loads(json.dumps(document)))
    assert scenario.to_json() == document
    assert UrbanScenario.from_json(scenario.to_json()) == scenario


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("weather", "hard rain", "did you mean 'hard_rain'"),
        ("weather", 3, "expected one of clear, cloudy"),
        ("pedestrians", 5, "expected one of 0, 18"),
        ("pedestrians", True, "expected one of 0, 18"),
        ("road_id", 3, "expected one of 0, 1, 2"),
        ("driving_task", "first_exist", "did you mean 'first_exit'"),
    ],
)
def test_an_invalid_value_is_rejected_with_the_choices(field: str, value: object, expected: str) -> None:
    document: JsonObject = {name: choices[0] for name, choices in SCENARIO_CHOICES.items()}
    document[field] = value  # type: ignore[assignment]
    with pytest.raises(InvalidEpisode, match=expected) as raised:
        UrbanScenario.from_json(document)
    assert field in str(raised.value)


def test_errors_name_missing_and_unknown_fields() -> None:
    document: JsonObject = {name: choices[0] for name, choices in SCENARIO_CHOICES.items()}
    with pytest.raises(InvalidEpisode, match=r"'wether' \(did you mean 'weather'\?\)"):
        UrbanScenario.from_json({**document, "wether": "clear"})
    del document["road_id"]
    with pytest.raises(InvalidEpisode, match=r"scenario\.road_id: missing"):
        UrbanScenario.from_json(document)


def test_a_box_moves_linearly_and_only_appears_between_its_steps() -> None:
    (read,) = DetectorBehaviour.from_json(behaviour(trajectory())).trajectories
    assert [read.box_at(step) is not None for step in (9, 10, 60, 110, 111)] == [
        False,
        True,
        True,
        True,
        False,
    ]
    box = read.box_at(60)
    assert box is not None
    assert box.label is ObstacleLabel.VEHICLE
    assert (box.x_min_px, box.x_max_px, box.y_min_px, box.y_max_px) == (200.0, 350.0, 225.0, 450.0)


@given(st.floats(0, 100), st.floats(0.5, 150), st.integers(0, 300))
def test_a_box_stays_within_the_hull_of_its_two_ends(t0: float, length: float, step: int) -> None:
    ghost = InjectedTrajectory(
        label=ObstacleLabel.PERSON,
        t0_step=t0,
        t1_step=t0 + length,
        first_px=(0.0, 50.0, 10.0, 60.0),
        last_px=(700.0, 800.0, 500.0, 600.0),
    )
    box = ghost.box_at(step)
    assert (box is not None) == (t0 <= step <= t0 + length)
    if box is not None:
        assert 0.0 <= box.x_min_px <= 700.0
        assert 50.0 <= box.x_max_px <= 800.0
        assert box.x_max_px - box.x_min_px >= 50.0 - 1e-9
        assert box.y_max_px - box.y_min_px >= 50.0 - 1e-9


def test_null_trajectories_are_dropped() -> None:
    null: JsonObject = {"label": "null", **dict.fromkeys(TRAJECTORY_FIELDS[1:], 0.0)}
    read = DetectorBehaviour.from_json(behaviour(null, trajectory(label="person")))
    assert [item.label for item in read.trajectories] == [ObstacleLabel.PERSON]


@given(st.lists(st.sampled_from(["vehicle", "person"]), max_size=4))
def test_a_behaviour_survives_a_json_round_trip(labels: list[str]) -> None:
    read = DetectorBehaviour.from_json(behaviour(*(trajectory(label=label) for label in labels)))
    assert DetectorBehaviour.from_json(read.to_json()) == read


def test_the_oracle_takes_no_trajectories() -> None:
    assert DetectorBehaviour.from_json({"mode": "oracle"}).mode is BehaviourMode.ORACLE
    with pytest.raises(InvalidEpisode, match="unknown field 'trajectories'"):
        DetectorBehaviour.from_json({"mode": "oracle", "trajectories": []})


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"label": "vehikle"}, "did you mean 'vehicle'"),
        ({"t1_step": 10.0}, "t1_step: expected more than t0_step"),
        ({"t1_step": 301.0}, r"t1_step: expected a number in \[0, 300\]"),
        ({"x_min_0_px": 250.0}, "x_max_0_px: expected more than x_min_0_px"),
        ({"y_max_1_px": 601.0}, r"y_max_1_px: expected a number in \[0, 600\]"),
        ({"y_max_1_px": float("nan")}, "y_max_1_px: expected a number"),
        ({"y_max_1_px": "wide"}, "y_max_1_px: expected a number"),
        ({"colour": 1.0}, "unknown field 'colour'"),
    ],
)
def test_an_invalid_trajectory_is_rejected_with_its_field(changes: dict[str, object], expected: str) -> None:
    with pytest.raises(InvalidEpisode, match=expected):
        DetectorBehaviour.from_json(behaviour(trajectory(**changes)))


def test_an_unknown_mode_is_rejected() -> None:
    with pytest.raises(InvalidEpisode, match="did you mean 'oracle'"):
        DetectorBehaviour.from_json({"mode": "oracel"})


def test_parameters_can_be_read_without_loading_the_physics() -> None:
    code = (
        "import sys, brink.sim.urban.behaviour, brink.sim.world.scenario, brink.server.problems.urban_injected;"
        "sys.exit('pybullet' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
