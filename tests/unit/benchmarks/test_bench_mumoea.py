"""The comparison of searches on traffic: measures, overlap of types, and the stand-in for a language model."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import mumoea
from benchmarks.mumoea import STAND_IN, Found, Measures, Overlap, SearchRun, Task, run_search
from benchmarks.stand_in import BROKEN_EVERY, StandInSeeds, serving
from brink.search.algorithm import Origin, SeedRequest
from brink.search.algorithms.mumoea import Mumoea, MumoeaConfig
from brink.search.analysis.violations import kinds_of
from brink.search.traffic.motion import HORIZON_S, STEP_S
from brink.server.llm.replies import RoadChecker
from brink.server.problems.npc_actions import NpcActions, NpcActionsParams

PARAMS = NpcActionsParams(participants=2, duration_s=5.0)
PROBLEM = NpcActions(PARAMS)
TIMES = round(HORIZON_S / STEP_S) + 1


def circumstances(requirement: str, kind: str) -> dict[str, Any]:
    """Return a violation whose type depends on the two words."""
    return {
        "requirement": requirement,
        "time_s": 3.0,
        "collision": None,
        "impact_speed_mps": None,
        "ego": {
            "speed_mps": 8.0,
            "accel_mps2": 0.0,
            "yaw_rate_radps": 0.0,
            "offset_m": 0.0,
            "offset_rate_mps": 0.0,
            "plan": "cruise",
        },
        "other": {
            "index": 1,
            "kind": kind,
            "action": "keep",
            "gap_m": 1.0,
            "bearing_rad": 0.0,
            "heading_rad": 0.0,
            "speed_mps": 5.0,
            "accel_mps2": 0.0,
            "in_way_s": 2.0,
        },
        "place": {"station_m": 20.0, "element": "straight", "light": "green"},
    }


CAR, PERSON = circumstances("front-gap@1", "car"), circumstances("front-gap@1", "pedestrian")


def found(number: int, *violations: dict[str, Any], at_m: float = 0.0, actions: int = 2) -> Found:
    """Return a violating solution with one participant that stands at a station."""
    return Found(
        number=number,
        violations=list(violations),
        waypoints=[[[at_m, 0.0]] * actions],
        positions=[[[at_m, 0.0]] * TIMES],
        cpu_s=0.1 * number,
    )


def search(*solutions: Found, method: str = "MOSAT", seed: int = 1) -> SearchRun:
    return SearchRun(
        method=method, seed=seed, simulations=100, failed=0, origins={}, found=list(solutions), cpu_s=20.0
    )


def test_distance_between_types_at_equal_times_does_not_grow_with_the_number_of_actions() -> None:
    brief = Measures.of(search(found(3, CAR), found(7, PERSON, at_m=10.0)))
    long = Measures.of(search(found(3, CAR, actions=8), found(7, PERSON, at_m=10.0, actions=8)))
    assert (brief.types, long.types) == (2, 2)
    assert brief.between_types_m == long.between_types_m == 10.0
    assert (brief.between_types_paper_m, long.between_types_paper_m) == (20.0, 80.0)
    assert np.isnan(Measures.of(search(found(3, CAR))).between_types_m)


def test_overlap_counts_types_that_the_other_method_finds_too() -> None:
    mine = [search(found(1, CAR), found(2, PERSON)), search(found(1, CAR), seed=2)]
    theirs = [
        search(found(4, CAR), method="NSGA-II"),
        search(method="NSGA-II", seed=2),
        search(found(9, PERSON), method="NSGA-II", seed=3),
    ]
    assert len({*kinds_of([CAR]), *kinds_of([PERSON])}) == 2
    one = Overlap.of(mine, theirs[:2])
    assert (one.method, one.other, one.types, one.shared, one.share) == ("MOSAT", "NSGA-II", 2, 1, 0.5)
    # Seeds 1 and 2, 2 and 1: nothing of two types, one of one.
    assert one.single == 0.5
    assert Overlap.of(mine, theirs).shared == 2
    back = Overlap.of(theirs, mine)
    assert (back.types, back.shared) == (2, 2)
    itself = Overlap.of(mine, mine)
    assert (itself.share, itself.single) == (1.0, 0.75)
    nothing = Overlap.of(theirs[1:2], mine)
    assert np.isnan([nothing.share, nothing.single]).all()


def request(number: int, count: int, **known: Any) -> SeedRequest:
    return SeedRequest(number=number, count=count, **known)


def test_the_stand_in_answers_over_the_path_of_language_models() -> None:
    with serving(PROBLEM.road, PROBLEM.max_participants) as endpoint:
        seeds, other, again = (StandInSeeds(PROBLEM, endpoint, seed) for seed in (1, 2, 1))
        first = seeds.proposals(request(0, 2 * BROKEN_EVERY))
        assert len(first) == 2 * BROKEN_EVERY
        # Two of ten are broken; of the two that replace them, none is.
        assert [one.origin for one in first] == [Origin.LLM] * 8 + [Origin.LLM_REPAIR] * 2
        assert seeds.spent.total_calls == 2
        assert again.proposals(request(0, 2 * BROKEN_EVERY)) == first
        assert other.proposals(request(0, 2 * BROKEN_EVERY)) != first
        known = tuple(one.solution for one in first[:3])
        differential = seeds.proposals(request(1, 4, exposed=known))
        assert seeds.spent.total_calls == 3
        assert seeds.spent.total_tokens > 0
    checker = RoadChecker(PROBLEM.road, PROBLEM.max_participants)
    assert all(checker.problems(one.solution) == [] for one in [*first, *differential])


def test_a_search_with_the_stand_in_records_what_it_asked_and_where_solutions_come_from(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    config = MumoeaConfig(seeder="llm", differential="always", population_size=8, seeds=2)
    monkeypatch.setattr(mumoea, "METHODS", {STAND_IN: (Mumoea(), config)})
    run = run_search(Task(method=STAND_IN, seed=1, simulations=16, params=PARAMS, folder=tmp_path))
    assert (run.simulations, run.failed, sum(run.origins.values())) == (16, 0, 16)
    assert run.origins[Origin.LLM] >= 7
    assert run.calls >= 3
    assert run.tokens > 1000
    assert run.waited_s > 0
    times = [one.cpu_s for one in run.found]
    assert times == sorted(times)
    assert times[-1] <= run.cpu_s
    assert {len(points) for one in run.found for points in one.positions} == {TIMES}
