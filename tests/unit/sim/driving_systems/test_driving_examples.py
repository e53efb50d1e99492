"""The examples drive, as plug-ins do: named by module and class, with the digest of their source."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from brink.server.problems.base import SupportsSeeds
from brink.server.problems.catalogue import make_problem
from brink.server.problems.driving_systems import driving_options
from brink.sim import catalogue
from brink.sim.catalogue import PLUGINS_VARIABLE, with_sources
from brink.sim.episode import EpisodeSpec, Json
from brink.sim.urban.options import DriveOptions
from brink.sim.urban.simulator import BrinkDrive
from brink.worker.child import SimulatorHost

EXAMPLES = Path(__file__).resolve().parents[4] / "examples" / "driving"
GHOST: dict[str, Json] = {"label": "vehicle", "t0_step": 40, "t1_step": 52}
GHOST |= {"x_min_0_px": 370.0, "x_max_0_px": 430.0, "y_min_0_px": 290.0, "y_max_0_px": 345.0}
GHOST |= {"x_min_1_px": 200.0, "x_max_1_px": 600.0, "y_min_1_px": 200.0, "y_max_1_px": 560.0}


@pytest.fixture(autouse=True)
def _as_plugins(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    monkeypatch.setenv(PLUGINS_VARIABLE, "idm,aeb")
    catalogue.import_plugin_modules.cache_clear()
    yield
    catalogue.import_plugin_modules.cache_clear()


def street(driving: str, curve: str = "left", **settings: Json) -> EpisodeSpec:
    return EpisodeSpec(
        simulator="brink-drive@3",
        scenario={
            "time_of_day": "noon",
            "weather": "clear",
            "pedestrians": 18,
            "road_curve": curve,
            "road_id": 0,
            "road_length": 0,
            "driving_task": "follow_road",
        },
        behaviour={"mode": "oracle"},
        requirements=("no-collision@1", "lane-keeping@1", "red-light@1", "speed-limit@1"),
        seed=2,
        duration_s=15.0,
        options={**DriveOptions().to_json(), **driving_options(driving, settings)},
    )


@pytest.mark.parametrize("curve", ["left", "crossroad"])
def test_idm_follows_its_lane_and_obeys(curve: str) -> None:
    result = BrinkDrive().run(street("idm:Idm", curve))
    assert [name for name, one in result.verdicts.items() if one.violated] == []
    way_m = result.features["way_m"]
    assert isinstance(way_m, float)
    assert way_m > 30.0


@pytest.mark.parametrize("curve", ["left", "crossroad"])
def test_fiss_plus_plans_obeys_and_is_the_same_again(curve: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("fiss_planner")
    monkeypatch.setenv(PLUGINS_VARIABLE, "fiss")
    spec = replace(street("fiss:FissPlus", curve), duration_s=12.0)
    first, again = BrinkDrive().run(spec, record=True), BrinkDrive().run(spec, record=True)
    assert [name for name, one in first.verdicts.items() if one.violated] == []
    way_m = first.features["way_m"]
    assert isinstance(way_m, float)
    assert way_m > 30.0
    assert first.trace == again.trace


def test_settings_reach_a_driving_system() -> None:
    near, far = (BrinkDrive().run(street("idm:Idm", headway_s=headway_s)) for headway_s in (1.0, 3.0))
    gaps_m = [one.features["least_front_gap_m"] for one in (near, far)]
    assert gaps_m[0] < gaps_m[1]  # type: ignore[operator]


def test_emergency_brake_alone_brakes_for_a_ghost_and_leaves_the_rest_to_brinks_own() -> None:
    haunted: dict[str, Json] = {"mode": "injected", "trajectories": [GHOST]}
    own, guarded = (
        BrinkDrive().run(replace(street(driving), behaviour=haunted))
        for driving in ("modular@1", "aeb:EmergencyBrake")
    )
    assert own.features["way_m"] != guarded.features["way_m"]
    spec = replace(street("aeb:EmergencyBrake"), behaviour={"mode": "injected", "trajectories": []})
    blind = BrinkDrive().run(spec)
    assert blind.features == BrinkDrive().run(replace(spec, options=street("modular@1").options)).features


def test_source_of_a_driving_system_is_part_of_the_episode() -> None:
    spec = with_sources(street("idm:Idm"))
    assert list(spec.sources) == ["modules/idm"]
    host = SimulatorHost()
    assert host.run(spec.to_json(), record=False)["kind"] == "completed"
    edited = replace(spec, sources={"modules/idm": "0" * 64})
    failure = host.run(edited.to_json(), record=False)
    assert failure["kind"] == "failed"
    assert "plug-in idm has source" in str(failure["message"])


def test_wrong_decision_fails_for_good_and_says_what_was_expected() -> None:
    spec = street("idm:Idm", headway_s="wide")
    failure = SimulatorHost().run(spec.to_json(), record=False)
    assert failure["reason"] == "invalid"
    first, *lines = str(failure["message"]).splitlines()
    assert first.startswith("driving system idm:Idm, it cannot be made: ValueError")
    assert any("idm.py" in line for line in lines)


def test_findings_say_whose_driving_system_drove() -> None:
    own, idm = (make_problem("urban-errors@1", {"driving": name}) for name in ("modular@1", "idm:Idm"))
    assert own.about_component == type(own).about_component
    assert idm.about_component.startswith(own.about_component)
    assert "idm:Idm drove. If it gets objects, Brink's localiser and tracker make them" in idm.about_component
    assert make_problem("npc-actions@1", {}).about_component == ""


def test_language_models_are_not_told_of_brinks_driving_system_when_another_one_drives() -> None:
    own, idm = (make_problem("npc-actions@1", {"driving": name}) for name in ("modular@1", "idm:Idm"))
    assert isinstance(own, SupportsSeeds)
    assert isinstance(idm, SupportsSeeds)
    assert "modular" in own.system
    assert "modular" not in idm.system


@pytest.mark.parametrize(
    ("driving", "message"),
    [
        ("nobody@1", "expected one of modular@1, MODULE:CLASS, command:FILE.yaml; got 'nobody@1'"),
        ("idm:Nobody", "idm has no function 'Nobody'"),
        ("os:system", "expected MODULE:FUNCTION with a module that --plugin or BRINK_PLUGINS names"),
        ("command:./planner", "expected command:NAME@DIGEST"),
    ],
)
@pytest.mark.parametrize(
    "problem_id", ["urban-injected@1", "urban-errors@1", "urban-camera@1", "urban-fitted@1", "npc-actions@1"]
)
def test_unknown_driving_system_is_an_error_at_submission(
    problem_id: str, driving: str, message: str
) -> None:
    (field, found), *_ = make_problem(problem_id, {"driving": driving}).wrong_inputs()
    assert field == "driving"
    assert message in found
    assert make_problem(problem_id, {"driving": "idm:Idm"}).wrong_inputs() == []
