"""The problem of scripted traffic: from candidates to episodes and back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.circumstances import violation

from brink.search.algorithm import Scored
from brink.search.analysis.violations import signature_of
from brink.search.errors import ConfigError
from brink.server.problems.base import Describes, SimulatedProblem, TellsViolations
from brink.server.problems.npc_actions import ORACLES, NpcActions, NpcActionsParams
from brink.sim.encounter.specification import EncounterScenario
from brink.worker.wire import Completed, WireVerdict

PROBLEM = NpcActions(NpcActionsParams())


@given(st.integers(0, 2**32 - 1))
def test_every_candidate_becomes_an_episode_that_can_run(seed: int) -> None:
    vectors = PROBLEM.space.sample(np.random.default_rng(seed))
    spec = PROBLEM.episode(vectors, seed)
    scenario = EncounterScenario.from_json(spec.scenario)
    assert len(scenario.road_users) == len(PROBLEM.participants(vectors)) == len(PROBLEM.waypoints(vectors))
    for script, ends in zip(scenario.road_users, PROBLEM.waypoints(vectors), strict=True):
        last = script.stretches[-1]
        assert last.from_s + last.lasts_s >= PROBLEM.params.duration_s - 1e-6
        # What is driven at the end of the first action is what the search measures distances with.
        first = [stretch for stretch in script.stretches if stretch.action == script.stretches[0].action]
        assert script.stretches[0] in first
        assert any(
            np.allclose(stretch.at(stretch.from_s + stretch.lasts_s)[:2], ends[0], atol=1e-6)
            for stretch in script.stretches
        )


def outcome(**robustness: float) -> Completed:
    least = dict.fromkeys(ORACLES, 1.0) | {f"{name.replace('_', '-')}@1": r for name, r in robustness.items()}
    return Completed(
        verdicts={
            name: WireVerdict(robustness=value, unit="m", violated_at_s=None if value >= 0 else 2.0)
            for name, value in least.items()
        },
        objectives={"criticality_m": 0.7},
        features={"violations": [{"requirement": name} for name, value in least.items() if value < 0]},
    )


def test_any_violation_counts_or_the_one_that_was_chosen() -> None:
    hit = outcome(no_collision=-1.0, front_gap=-0.2)
    judged = PROBLEM.evaluation(hit)
    assert isinstance(judged, Scored)
    assert (judged.unsafe, judged.robustness, judged.objectives["criticality_m"]) == (True, -1.0, 0.7)
    gap = NpcActions(NpcActionsParams(violation="front-gap@1", criticality="robustness"))
    chosen = gap.evaluation(hit)
    assert isinstance(chosen, Scored)
    assert (chosen.robustness, chosen.objectives["criticality_m"]) == (-0.2, -0.2)
    assert [one["requirement"] for one in gap.violations(hit)] == ["front-gap@1"]
    assert len(PROBLEM.violations(hit)) == 2
    assert PROBLEM.violations(outcome()) == []


def test_a_verdict_says_which_kinds_of_violations_there_were() -> None:
    told = [violation(), violation("front-gap@1", collision=None)]
    hit = outcome(no_collision=-1.0, front_gap=-0.2).model_copy(update={"features": {"violations": told}})
    judged = PROBLEM.evaluation(hit)
    assert isinstance(judged, Scored)
    assert judged.kinds == {str(signature_of(one)) for one in told}
    of_gap = NpcActions(NpcActionsParams(violation="front-gap@1")).evaluation(hit)
    assert isinstance(of_gap, Scored)
    assert of_gap.kinds == {str(signature_of(told[1]))}


def test_it_is_what_it_says() -> None:
    assert isinstance(PROBLEM, SimulatedProblem)
    assert isinstance(PROBLEM, TellsViolations)
    assert isinstance(PROBLEM, Describes)
    assert PROBLEM.needs == "brink-encounter@1"
    camera = NpcActions(NpcActionsParams(sight="detector"))
    assert camera.needs == "brink-encounter-camera@1"
    spec = camera.episode(camera.space.sample(np.random.default_rng(1)), 1)
    assert spec.behaviour == {"mode": "detector", "detector": "brink-det@1", "threshold": 0.8}
    assert NpcActions(NpcActionsParams(sight="detector", detector="nobody@1")).wrong_inputs()
    assert PROBLEM.wrong_inputs() == []


def test_what_could_find_nothing_is_refused() -> None:
    with pytest.raises(ConfigError, match="no other road has lights"):
        NpcActionsParams(violation="red-light@1", road_curve="straight")
