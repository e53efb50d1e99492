"""The change between two candidates of scripted traffic, in words."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from brink.search.pairs import Steps
from brink.search.traffic.constraint import participants_of
from brink.search.traffic.participants import Action, Gene, Kind, Participant
from brink.server.problems.base import Activity, SimulatedSolution
from brink.server.problems.changes import change_words, changes_between
from brink.server.problems.npc_actions import NpcActions

PROBLEM = NpcActions(NpcActions.params_type(participants=2))
RULE = participants_of(PROBLEM.space)[1]
CAR = Participant(
    kind=Kind.CAR,
    ds_m=43.0,
    dd_m=0.0,
    dyaw_rad=0.0,
    speed_mps=5.0,
    genes=(
        Gene(action=Action.KEEP, duration_s=1.4, magnitude=0.0),
        Gene(action=Action.CHANGE_LEFT, duration_s=2.0, magnitude=0.5),
        Gene(action=Action.CUT_IN, duration_s=3.0, magnitude=1.0),
    ),
)
WALKER = Participant(
    kind=Kind.PEDESTRIAN,
    ds_m=30.0,
    dd_m=-3.0,
    dyaw_rad=0.0,
    speed_mps=1.0,
    genes=tuple(Gene(action=Action.CROSS, duration_s=2.0, magnitude=1.0) for _ in range(2)),
)


def drive(*participants: Participant, active: np.ndarray[Any, Any] | None = None) -> SimulatedSolution:
    vectors = (RULE.encode(participants),)
    activity = None if active is None else Activity(active=active, effective=vectors[0])
    return SimulatedSolution(vectors=vectors, activity=activity)


def words(safe: SimulatedSolution, unsafe: SimulatedSolution) -> str:
    rows = [PROBLEM.space.join(tuple(one.vectors)) for one in (safe, unsafe)]
    units = Steps(PROBLEM.space).differing(*rows)
    return change_words(PROBLEM, safe, unsafe, changes_between(PROBLEM, safe, unsafe, units))


def acting(one: Participant, number: int, **changes: Any) -> Participant:
    genes = list(one.genes)
    genes[number - 1] = replace(genes[number - 1], **changes)
    return replace(one, genes=tuple(genes))


@pytest.mark.parametrize(
    ("unsafe", "expected"),
    [
        ((replace(CAR, ds_m=55.0),), "car 1 starts 55 m ahead instead of 43 m"),
        ((replace(CAR, ds_m=-20.0),), "car 1 starts 20 m behind instead of 43 m ahead"),
        ((replace(CAR, dd_m=3.5),), "car 1 starts 3.5 m to the left instead of 0 m"),
        ((replace(CAR, dyaw_rad=math.pi),), "car 1 heads towards the ego instead of the same way as the ego"),
        ((replace(CAR, speed_mps=6.2),), "car 1 starts at 6.2 m/s instead of 5 m/s"),
        ((replace(CAR, kind=Kind.VAN),), "road user 1 is a van instead of a car"),
        ((acting(CAR, 1, duration_s=2.1),), "car 1's 1st action lasts 2.1 s instead of 1.4 s"),
        (
            (acting(CAR, 2, magnitude=0.8),),
            "car 1's 2nd action goes 0.8 lane widths to its left instead of 0.5",
        ),
        (
            (acting(CAR, 1, action=Action.BRAKE, magnitude=4.0, duration_s=2.0),),
            "car 1's 1st action is braking hard instead of keeping its speed",
        ),
        ((replace(CAR, genes=CAR.genes[:2]),), "car 1's 3rd action (cutting in) is left out"),
        (
            (replace(acting(CAR, 1, duration_s=2.1), ds_m=55.0),),
            "car 1 starts 55 m ahead instead of 43 m; its 1st action lasts 2.1 s instead of 1.4 s",
        ),
        ((CAR, WALKER), "pedestrian 2 is added"),
    ],
)
def test_a_change_is_described_by_road_user(unsafe: tuple[Participant, ...], expected: str) -> None:
    assert words(drive(CAR), drive(*unsafe)) == expected


def test_only_the_largest_changes_are_described_and_the_others_counted() -> None:
    walker = acting(replace(WALKER, ds_m=52.0), 1, magnitude=2.0, duration_s=2.1)
    told = words(drive(CAR, WALKER), drive(replace(CAR, speed_mps=6.0), walker))
    assert told == (
        "pedestrian 2 starts 52 m ahead instead of 30 m; their 1st action crosses at 2 m/s instead of 1 m/s; "
        "car 1 starts at 6 m/s instead of 5 m/s; and 1 more change"
    )


def test_what_had_no_part_is_not_described() -> None:
    active = np.ones(PROBLEM.space.dimension, np.bool_)
    active[PROBLEM.space.column_names().index("road_users.p1.a3.duration_s")] = False
    changed = acting(replace(CAR, ds_m=55.0), 3, duration_s=6.0)
    told = words(drive(CAR, active=active), drive(changed, active=active))
    assert told == "car 1 starts 55 m ahead instead of 43 m"
