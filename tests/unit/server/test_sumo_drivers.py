"""The problem of drivers in SUMO who perceive with an error: episodes, activity, words and parameters."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brink.search.pairs import Steps
from brink.server.errors import InvalidInput
from brink.server.problems.base import NO_PART, Activity, SimulatedSolution, activity_of, describe_candidate
from brink.server.problems.catalogue import make_problem
from brink.server.problems.changes import change_words, changes_between
from brink.server.problems.error_slots import NO_ERROR
from brink.server.problems.sumo import SumoDrivers, SumoDriversParams
from brink.sim.adapters.sumo.specification import MAGNITUDES, Drive, ErrorType, Network
from brink.sim.catalogue import make_simulator

ANYWHERE = SumoDrivers(SumoDriversParams())
RING = SumoDrivers(SumoDriversParams(network="ring", duration_s=15.0))
ROADS = Path(__file__).parents[3] / "sim" / "adapters" / "sumo" / "roads"
TRAFFIC: dict[str, Any] = {
    "network": "arterial",
    "demand": 0.8,
    "trucks": 0.15,
    "imperfection": 0.5,
    "signals_s": 12.0,
    "automated": 0.3,
    "surface": "dry",
    "incident": "lead_brakes",
    "incident_s": 12.0,
    "incident_mps2": 4.0,
}
CALM = {**TRAFFIC, "incident": "none", "incident_s": 0.0, "incident_mps2": 0.0}
FAR: dict[str, Any] = {
    "type": "too_far",
    "affected": "ego",
    "onset_s": 3.0,
    "duration_s": 20.0,
    "severity": 0.1,
}
MISS = {**FAR, "type": "miss", "severity": 0.25}
NONE = {**FAR, "type": NO_ERROR, "onset_s": 0.0, "duration_s": 0.0, "severity": 0.0}
RAN = {"ended_at_s": 60.0, "incident_at_s": 12.0, "error_acted_at_s": 3.0}


def candidate(error: dict[str, Any], traffic: dict[str, Any] = TRAFFIC) -> tuple[Any, ...]:
    return ANYWHERE.space.encode({"scenario": traffic, "behaviour": error})


@given(st.integers(0, 2**32 - 1), st.sampled_from([ANYWHERE, RING]))
def test_every_candidate_becomes_an_episode_that_the_simulator_accepts(
    seed: int, problem: SumoDrivers
) -> None:
    vectors = problem.space.sample(np.random.default_rng(seed))
    drive = Drive.of(problem.episode(vectors, 1))
    values = problem.space.decode(vectors)["behaviour"]
    assert (drive.error is None) == (values["type"] == NO_ERROR)
    if drive.error is not None:
        assert drive.error.magnitude == MAGNITUDES[drive.error.type].at(float(values["severity"]))
    assert problem.words(vectors) == drive.words


@pytest.mark.parametrize(
    ("params", "pointer"),
    [
        ({"network": "motorways"}, "network"),
        ({"requirement": []}, "requirement"),
        ({"requirement": ["front-gap@1", "front-gap@1"]}, "requirement"),
        ({"requirement": "front-gap"}, "requirement"),
        ({"requirement": "lane-keeping@1"}, "requirement"),
        ({"duration_s": 4.0}, "duration_s"),
        ({"headway_s": 0.1}, "headway_s"),
        ({"network_file": "a.net.xml"}, "demand_file"),
        ({"demand_file": "a.rou.xml"}, "network_file"),
        ({"network_file": "a.net.xml", "demand_file": "a.rou.xml", "network": "grid"}, "network"),
        ({"seed": 1}, "seed"),
    ],
)
def test_parameters_outside_their_bounds_are_refused(params: dict[str, Any], pointer: str) -> None:
    with pytest.raises(InvalidInput) as raised:
        make_problem("sumo-drivers@1", params)
    assert raised.value.errors[0].pointer == f"/problem/params/{pointer}"


def own(
    folder: Path, ego: str = "ego", demand: str = '<routes><vehicle id="ego" depart="0"/></routes>'
) -> SumoDrivers:
    file = folder / "demand.rou.xml"
    file.write_text(demand, encoding="utf-8")
    params = SumoDriversParams(
        network_file=str(ROADS / "ring.net.xml.gz"), demand_file=str(file), ego=ego, duration_s=10.0
    )
    return SumoDrivers(params)


def test_files_of_ones_own_are_checked_at_submission(tmp_path: Path) -> None:
    assert own(tmp_path).wrong_inputs() == []
    [(field, message)] = own(tmp_path, ego="me").wrong_inputs()
    assert field == "ego"
    assert "such as ego; got 'me'" in message
    [(field, message)] = own(tmp_path, demand="<net/>").wrong_inputs()
    assert (field, "got <net>" in message) == ("demand_file", True)
    missing = SumoDrivers(SumoDriversParams(network_file="no.net.xml", demand_file="no.rou.xml"))
    assert [name for name, _ in missing.wrong_inputs()] == ["network_file", "demand_file"]
    assert ANYWHERE.wrong_inputs() == []


def test_files_of_ones_own_take_the_place_of_the_networks(tmp_path: Path) -> None:
    problem = own(tmp_path)
    names = problem.space.column_names()
    assert not {"scenario.network", "scenario.trucks", "scenario.imperfection", "scenario.signals_s"} & set(
        names
    )
    vectors = problem.space.sample(np.random.default_rng(1))
    files = problem.episode(vectors, 1).scenario["files"]
    assert isinstance(files, dict)
    assert files["ego"] == "ego"
    assert problem.words(vectors).startswith("network of one's own, traffic at")


def test_with_the_truth_nobody_errs() -> None:
    truth = ANYWHERE.with_truth()
    assert truth is not None
    assert truth.with_truth() is None
    spec = truth.episode(candidate(FAR), 3)
    assert spec.behaviour == {"mode": "errors", "error": None}
    assert spec.scenario == ANYWHERE.episode(candidate(FAR), 3).scenario
    assert truth.words(candidate(FAR)).endswith("; no error")
    found = activity_of(truth, candidate(FAR), {"features": {**RAN, "error_acted_at_s": None}})
    assert found is not None
    assert found.idle == ("behaviour",)


@pytest.mark.parametrize("kind", ErrorType)
def test_severities_have_a_scale_and_words(kind: ErrorType) -> None:
    choices = {"behaviour.type": kind.value}
    scale = ANYWHERE.severity_scale(choices)
    assert scale is not None
    assert ANYWHERE.error_words(choices, scale.words(0.5)).startswith("perceiving ")
    assert ANYWHERE.severity_scale({"behaviour.type": NO_ERROR}) is None
    assert ANYWHERE.severity_scale({}) is None


def inactive(
    error: dict[str, Any], traffic: dict[str, Any] = TRAFFIC, **features: float | None
) -> tuple[set[str], Activity]:
    found = activity_of(ANYWHERE, candidate(error, traffic), {"features": {**RAN, **features}})
    assert found is not None
    names = ANYWHERE.space.column_names()
    return {name for name, active in zip(names, found.active, strict=True) if not active}, found


BEHAVIOUR = {f"behaviour.{name}" for name in FAR}
INCIDENT = {"scenario.incident", "scenario.incident_s", "scenario.incident_mps2"}


def test_everything_has_a_part_where_the_error_acted_and_the_lead_braked() -> None:
    assert inactive(FAR)[0] == set()
    assert inactive(MISS)[0] == {"behaviour.duration_s"}
    assert inactive(FAR, {**TRAFFIC, "network": "motorway"})[0] == {"scenario.signals_s"}


def test_what_did_not_happen_has_no_part() -> None:
    names, found = inactive(FAR, incident_at_s=None, error_acted_at_s=None)
    assert names == BEHAVIOUR | INCIDENT
    assert found.idle == ("behaviour",)
    vectors = ANYWHERE.space.split(found.effective)
    assert np.array_equal(found.effective, np.concatenate(candidate(NONE, CALM)))
    assert ANYWHERE.words(vectors) == ANYWHERE.words(candidate(NONE, CALM))
    shown = describe_candidate(ANYWHERE, candidate(FAR), found)
    assert shown.endswith(f"; no error; {NO_PART}")


def test_what_was_not_to_happen_might_have_been_chosen() -> None:
    names, _ = inactive(NONE, CALM, incident_at_s=None, error_acted_at_s=None)
    assert names == (BEHAVIOUR | INCIDENT) - {"behaviour.type", "scenario.incident"}


@pytest.mark.parametrize("features", [{}, {"ended_at_s": None}, {"ended_at_s": True}, {"ended_at_s": "60"}])
def test_without_a_record_nothing_is_known(features: dict[str, Any]) -> None:
    assert activity_of(ANYWHERE, candidate(FAR), {"features": features}) is None


def change(old: tuple[Any, ...], new: tuple[Any, ...]) -> str:
    safe, unsafe = (SimulatedSolution(vectors=vectors) for vectors in (old, new))
    units = Steps(ANYWHERE.space).differing(*(ANYWHERE.space.join(vectors) for vectors in (old, new)))
    return change_words(ANYWHERE, safe, unsafe, changes_between(ANYWHERE, safe, unsafe, units))


@pytest.mark.parametrize(
    ("error", "traffic", "words"),
    [
        ({"severity": 0.2}, {}, "the ego perceives things ahead 180% instead of 90% too far away"),
        ({"onset_s": 4.5}, {}, "the ego perceives things ahead 90% too far away, from 4.5 s instead of 3 s"),
        (
            {"duration_s": 21.0},
            {},
            "the ego perceives things ahead 90% too far away, for 21 s instead of 20 s",
        ),
        (
            {"affected": "fleet"},
            {},
            "from 3.0 s on, every automated car perceives things ahead 90% too far away for 20.0 s "
            "(in the safe drive, from 3.0 s on, the ego perceives things ahead 90% too far away for 20.0 s)",
        ),
        ({}, {"demand": 0.85}, "traffic is at 85% of capacity instead of 80%"),
        ({}, {"surface": "icy"}, "the road is icy instead of dry"),
        (
            {},
            {"network": "ring"},
            "the network is a ring road instead of an arterial road with traffic lights",
        ),
        ({}, {"incident_mps2": 4.1}, "the vehicle ahead brakes at 4.1 m/s² instead of 4 m/s²"),
        ({}, {"signals_s": 13.0}, "the traffic begins 13 s into the cycle of the lights instead of 12 s"),
    ],
)
def test_changes_have_words(error: dict[str, Any], traffic: dict[str, Any], words: str) -> None:
    assert change(candidate(FAR), candidate({**FAR, **error}, {**TRAFFIC, **traffic})) == words


@pytest.mark.long("needs SUMO")
@pytest.mark.parametrize("network", Network)
def test_what_had_no_part_can_change_without_any_effect(network: Network) -> None:
    problem = SumoDrivers(SumoDriversParams(network=network.value, duration_s=10.0))
    simulator = make_simulator(problem.needs)
    rng = np.random.default_rng(4)
    for seed in range(4):
        vectors = problem.space.sample(rng)
        result = simulator.run(problem.episode(vectors, seed))
        activity = problem.activity(vectors, result.features)
        assert activity is not None
        effective = problem.space.split(activity.effective)
        again = simulator.run(problem.episode(effective, seed))
        assert again.verdicts == result.verdicts
