"""Which parameters had a part in an episode, and the values that they had there."""

from typing import Any

import numpy as np
import pytest
from support.marks import mostly_long
from support.urban_pairs import BOX, NONE, SCENARIO

from brink.server.problems.base import NO_PART, Activity, activity_of, describe_candidate
from brink.server.problems.npc_actions import NpcActions
from brink.server.problems.urban_injected import UrbanInjected
from brink.sim.catalogue import make_simulator
from brink.sim.driving.interface import ObstacleLabel
from brink.sim.episode import EpisodeResult
from brink.sim.urban.behaviour import BOX_SIDES, InjectedTrajectory, steps_from_json

URBAN = UrbanInjected(UrbanInjected.params_type())
NPC = NpcActions(NpcActions.params_type())
SPACE = URBAN.space


def trajectory(label: str, start: int, end: int) -> dict[str, Any]:
    return {"label": label, "t0_step": start, "t1_step": end, **BOX}


def candidate(*trajectories: dict[str, Any]) -> tuple[Any, ...]:
    values = {
        f"trajectory_{number}.{name}": value
        for number, one in enumerate(trajectories, start=1)
        for name, value in one.items()
    }
    return SPACE.encode({"scenario": SCENARIO, "behaviour": values})


def outcome(*delivered: Any) -> dict[str, Any]:
    return {"features": {"delivered_steps": list(delivered), "ended_at_s": 10.0}}


def known(vectors: Any, result: dict[str, Any]) -> Activity:
    found = activity_of(URBAN, vectors, result)
    assert found is not None
    return found


def inactive(found: Activity) -> set[str]:
    names = SPACE.column_names()
    return {name for name, active in zip(names, found.active, strict=True) if not active}


def effective(found: Activity) -> dict[str, Any]:
    return SPACE.decode(SPACE.split(found.effective))["behaviour"]


def members(number: int, *, label: bool) -> set[str]:
    names = {f"behaviour.trajectory_{number}.{name}" for name in NONE}
    return names if label else names - {f"behaviour.trajectory_{number}.label"}


def test_a_trajectory_that_was_never_delivered_is_as_good_as_none() -> None:
    vectors = candidate(trajectory("person", 20, 60), trajectory("vehicle", 150, 250))
    found = known(vectors, outcome([20, 60], None))
    assert inactive(found) == members(2, label=True)
    same = candidate(trajectory("person", 20, 60), NONE)
    assert found.effective.tolist() == np.concatenate(same).tolist()
    assert found.idle == ()
    assert describe_candidate(URBAN, vectors, found) == describe_candidate(URBAN, same)
    assert describe_candidate(URBAN, vectors).endswith("reported: person 2.0-6.0 s, vehicle 15.0-25.0 s")


def test_the_numbers_of_a_null_trajectory_are_inactive_but_its_label_is_not() -> None:
    found = known(candidate(NONE, trajectory("person", 20, 60)), outcome([20, 60]))
    assert inactive(found) == members(1, label=False)


def shape(values: dict[str, Any]) -> InjectedTrajectory:
    first, last = ([values[f"trajectory_1.{side}_{end}_px"] for side in BOX_SIDES] for end in (0, 1))
    return InjectedTrajectory(
        label=ObstacleLabel.PERSON,
        t0_step=20.0,
        t1_step=float(values["trajectory_1.t1_step"]),
        first_px=(first[0], first[1], first[2], first[3]),
        last_px=(last[0], last[1], last[2], last[3]),
    )


def test_a_window_that_the_end_cuts_off_ends_there_with_the_box_of_that_time() -> None:
    vectors = candidate(trajectory("person", 20, 220), NONE)
    found = known(vectors, outcome([20, 99]))
    values = effective(found)
    assert values["trajectory_1.t1_step"] == 99
    whole, cut = (shape(one) for one in (SPACE.decode(vectors)["behaviour"], values))
    for step in range(20, 100):
        boxes = whole.box_at(step), cut.box_at(step)
        assert boxes[0] is not None
        assert boxes[1] is not None
        assert boxes[1][1:] == pytest.approx(boxes[0][1:])
    assert describe_candidate(URBAN, vectors, found).endswith("reported: person 2.0-9.9 s")
    assert vectors[1].tolist() == candidate(trajectory("person", 20, 220), NONE)[1].tolist(), "unchanged"


@pytest.mark.parametrize(
    ("trajectories", "delivered"),
    [((trajectory("person", 150, 250), NONE), [None]), ((NONE, NONE), [])],
    ids=["too late", "null"],
)
def test_a_behaviour_without_any_detection_says_so(trajectories: Any, delivered: list[Any]) -> None:
    vectors = candidate(*trajectories)
    found = known(vectors, outcome(*delivered))
    assert found.idle == ("behaviour",)
    assert describe_candidate(URBAN, vectors, found).endswith(f"; nothing reported; {NO_PART}")


@pytest.mark.parametrize(
    "result",
    [
        None,
        {},
        {"features": {"ended_at_s": 10.0}},
        {"features": {"delivered_steps": []}},
        {"features": {"delivered_steps": [[20, 60], [20, 60]]}},
        {"features": {"delivered_steps": [[60, 20]]}},
        {"features": {"delivered_steps": ["20"]}},
        {"features": {"delivered_steps": {"0": [20, 60]}}},
        {"features": {"delivered_steps": [[20.5, 60]]}},
    ],
    ids=[
        "no result",
        "no features",
        "older",
        "too few",
        "too many",
        "backwards",
        "text",
        "object",
        "fraction",
    ],
)
def test_what_was_not_recorded_is_unknown(result: dict[str, Any] | None) -> None:
    vectors = candidate(trajectory("person", 20, 220), NONE)
    assert activity_of(URBAN, vectors, result) is None
    assert describe_candidate(URBAN, vectors, None).endswith("reported: person 2.0-22.0 s")


def run(vectors: Any, seed: int) -> EpisodeResult:
    return make_simulator(URBAN.needs).run(URBAN.episode(vectors, seed))


def as_result(result: EpisodeResult) -> dict[str, Any]:
    return {"features": dict(result.features)}


@pytest.mark.parametrize("number", mostly_long(range(20), [0, 1, 2], "further random candidates"))
def test_inactive_parameters_do_not_change_the_episode(number: int) -> None:
    rng = np.random.default_rng([7, number])
    vectors = SPACE.sample(rng)
    result = run(vectors, number)
    found = known(vectors, as_result(result))
    delivered = steps_from_json(result.features["delivered_steps"])
    assert delivered is not None
    last_step = round(float(str(result.features["ended_at_s"])) / 0.1)
    assert all(steps is None or steps[1] <= last_step for steps in delivered)
    # Another late trajectory in place of an inactive one, and null in place of what was never delivered.
    other = SPACE.decode(vectors)["behaviour"]
    for trajectory_number in (1, 2):
        prefix = f"trajectory_{trajectory_number}."
        if f"behaviour.{prefix}label" in inactive(found):
            other |= {prefix + name: value for name, value in NONE.items()}
    changed = SPACE.encode({"scenario": SPACE.decode(vectors)["scenario"], "behaviour": other})
    again = run(changed, number)
    assert again.objectives == result.objectives
    same = {name: value for name, value in result.features.items() if name != "delivered_steps"}
    assert {name: value for name, value in again.features.items() if name != "delivered_steps"} == same


def test_actions_that_begin_after_the_end_are_inactive() -> None:
    vectors = NPC.space.sample(np.random.default_rng(3))
    people = NPC.participants(vectors)
    names = NPC.space.column_names()
    late_s = people[0].genes[0].duration_s
    found = activity_of(NPC, vectors, {"features": {"ended_at_s": late_s}})
    assert found is not None
    active = {name for name, on in zip(names, found.active, strict=True) if on}
    assert {"road_users.p1.kind", "road_users.p1.a1.action", "road_users.p1.a1.duration_s"} <= active
    assert not any(name.startswith("road_users.p1.a2") for name in active)
    assert not any(name.startswith(f"road_users.p{len(people) + 1}.") for name in active)
    everything = activity_of(NPC, vectors, {"features": {"ended_at_s": 1e6}})
    assert everything is not None
    assert everything.effective.tolist() == vectors[0].tolist()
    assert describe_candidate(NPC, vectors, everything) == describe_candidate(NPC, vectors)
    assert describe_candidate(NPC, vectors, found) != describe_candidate(NPC, vectors)
    for unknown in ({}, {"ended_at_s": "soon"}, {"ended_at_s": True}, {"ended_at_s": None}):
        assert activity_of(NPC, vectors, {"features": unknown}) is None
