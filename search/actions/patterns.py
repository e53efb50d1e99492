"""Hand-written hostile patterns: what drivers and pedestrians do that is hard to cope with.

`hostile_solution` puts whole solutions together and is the heuristic seeder; `motif` gives the single participants
that MOSAT breeds with. They are named what they are: patterns from experience, with random numbers.

Source: Tian et al., seeding; Tian et al., "MOSAT: Finding Safety Violations of Autonomous Driving Systems using
Multi-objective Genetic Algorithm", ESEC/FSE 2022, for the motifs.
"""

import math
from collections.abc import Callable
from typing import Final, TypeAlias

import numpy as np

from brink.search.actions.participants import (
    LONGEST_S,
    SHORTEST_S,
    Action,
    Gene,
    Kind,
    Participant,
    magnitude_of,
)
from brink.search.actions.road import RoadLimits
from brink.search.actions.variation import Solution

Pattern: TypeAlias = Callable[[RoadLimits, np.random.Generator], Solution]


def _gene(
    action: Action, shortest_s: float, longest_s: float, rng: np.random.Generator, least: float = 0.0
) -> Gene:
    """Return an action with a duration in a range and a magnitude from a share of its range up."""
    return Gene(
        action=action,
        duration_s=float(np.clip(rng.uniform(shortest_s, longest_s), SHORTEST_S, LONGEST_S)),
        magnitude=magnitude_of(action, float(rng.uniform(least, 1.0))),
    )


def _vehicle(
    rng: np.random.Generator, ds_m: float, dd_m: float, speed_mps: float, *genes: Gene, oncoming: bool = False
) -> Participant:
    kind = Kind.VAN if rng.random() < 0.25 else Kind.CAR
    heading = math.pi if oncoming else 0.0
    return Participant(
        kind=kind, ds_m=ds_m, dd_m=dd_m, dyaw_rad=heading, speed_mps=speed_mps, genes=tuple(genes)
    )


def brake_ahead(road: RoadLimits, rng: np.random.Generator) -> Solution:
    """Somebody ahead brakes hard, for no reason."""
    return (
        _vehicle(
            rng, float(rng.uniform(14.0, 32.0)), 0.0, float(rng.uniform(7.0, 11.0)),
            _gene(Action.KEEP, 0.5, 4.0, rng), _gene(Action.BRAKE, 1.5, 4.0, rng, 0.5),
        ),
    )  # fmt: skip


def cut_in(road: RoadLimits, rng: np.random.Generator) -> Solution:
    """Somebody beside or before the ego moves into its lane and slows down."""
    return (
        _vehicle(
            rng, float(rng.uniform(4.0, 22.0)), road.lane_width_m, float(rng.uniform(7.0, 11.0)),
            _gene(Action.KEEP, 0.5, 3.0, rng), _gene(Action.CUT_IN, 1.0, 2.5, rng, 0.3),
            _gene(Action.BRAKE, 1.0, 3.0, rng),
        ),
    )  # fmt: skip


def overtaken(road: RoadLimits, rng: np.random.Generator) -> Solution:
    """Somebody comes from behind, overtakes and cuts in."""
    return (
        _vehicle(
            rng, float(rng.uniform(-30.0, -10.0)), road.lane_width_m, float(rng.uniform(9.0, 13.0)),
            _gene(Action.ACCELERATE, 1.0, 3.0, rng), _gene(Action.CUT_IN, 1.0, 2.5, rng, 0.3),
            _gene(Action.BRAKE, 1.0, 3.0, rng),
        ),
    )  # fmt: skip


def from_behind(road: RoadLimits, rng: np.random.Generator) -> Solution:
    """Somebody behind accelerates towards the ego."""
    return (
        _vehicle(
            rng, float(rng.uniform(-35.0, -12.0)), 0.0, float(rng.uniform(8.0, 12.0)),
            _gene(Action.ACCELERATE, 1.0, 4.0, rng, 0.3), _gene(Action.KEEP, 1.0, 4.0, rng),
        ),
    )  # fmt: skip


def oncoming_overtake(road: RoadLimits, rng: np.random.Generator) -> Solution:
    """An oncoming vehicle overtakes a slower one and is on the ego's lane meanwhile."""
    ahead_m = float(rng.uniform(34.0, 48.0))
    return (
        _vehicle(
            rng, ahead_m, road.lane_width_m, float(rng.uniform(8.0, 12.0)),
            _gene(Action.KEEP, 0.5, 1.5, rng), _gene(Action.CHANGE_LEFT, 1.0, 2.0, rng, 0.5),
            _gene(Action.KEEP, 0.5, 2.5, rng), _gene(Action.CHANGE_RIGHT, 1.0, 2.0, rng, 0.5), oncoming=True,
        ),
        _vehicle(
            rng, ahead_m - float(rng.uniform(8.0, 16.0)), road.lane_width_m, float(rng.uniform(4.0, 7.0)),
            _gene(Action.KEEP, 2.0, 6.0, rng), _gene(Action.KEEP, 2.0, 6.0, rng), oncoming=True,
        ),
    )  # fmt: skip


def person_crosses(road: RoadLimits, rng: np.random.Generator) -> Solution:
    """A person steps onto the road, and perhaps stops in the middle of it."""
    right = rng.random() < 0.6
    second = _gene(Action.BRAKE, 0.5, 3.0, rng) if rng.random() < 0.4 else _gene(Action.CROSS, 1.0, 5.0, rng)
    first = _gene(Action.CROSS, 1.0, 3.0, rng, 0.2)
    genes = (_gene(Action.KEEP, 0.5, 3.0, rng), first, second)
    return (
        Participant(
            kind=Kind.PEDESTRIAN, ds_m=float(rng.uniform(8.0, 40.0)),
            dd_m=road.right_kerb_m - 0.5 if right else road.left_kerb_m + 0.5, dyaw_rad=0.0,
            speed_mps=float(rng.uniform(0.0, 1.5)), genes=genes,
        ),
    )  # fmt: skip


def squeeze(road: RoadLimits, rng: np.random.Generator) -> Solution:
    """The ego is pressed from both sides: somebody oncoming leans over while a person steps out on the right."""
    leans = _vehicle(
        rng, float(rng.uniform(30.0, 48.0)), road.lane_width_m, float(rng.uniform(6.0, 10.0)),
        _gene(Action.CHANGE_LEFT, 1.0, 3.0, rng), _gene(Action.KEEP, 1.0, 4.0, rng), oncoming=True,
    )  # fmt: skip
    return leans, *person_crosses(road, rng)


def from_street(road: RoadLimits, rng: np.random.Generator) -> Solution:
    """Somebody drives out of a crossing street without a look; where there is none, somebody brakes ahead."""
    if not road.streets_m:
        return brake_ahead(road, rng)
    right = rng.random() < 0.5
    street_m = road.streets_m[int(rng.integers(len(road.streets_m)))]
    (comes,) = brake_ahead(road, rng)
    return (
        Participant(
            kind=comes.kind, ds_m=street_m,
            dd_m=float(rng.uniform(8.0, 35.0)) * (-1.0 if right else 1.0), dyaw_rad=0.5 * math.pi,
            speed_mps=float(rng.uniform(4.0, 11.0)),
            genes=(_gene(Action.KEEP, 1.0, 4.0, rng), _gene(Action.ACCELERATE, 1.0, 4.0, rng)),
        ),
    )  # fmt: skip


PATTERNS: Final[tuple[Pattern, ...]] = (
    brake_ahead, cut_in, overtaken, from_behind, oncoming_overtake, person_crosses, squeeze, from_street,
)  # fmt: skip
MOTIFS: Final[tuple[Pattern, ...]] = (brake_ahead, cut_in, from_behind, overtaken)
"""Ahead brake; side-front cut-in; behind accelerate; side-behind accelerate and cut-in."""


def hostile_solution(road: RoadLimits, most: int, rng: np.random.Generator) -> Solution:
    """Return a solution of one to three patterns; it may need repair."""
    participants: list[Participant] = []
    for _ in range(int(rng.integers(1, 4))):
        participants.extend(PATTERNS[int(rng.integers(len(PATTERNS)))](road, rng))
    return tuple(participants[:most])


def motif(road: RoadLimits, rng: np.random.Generator) -> Participant:
    """Return a participant with one of MOSAT's motifs."""
    return MOTIFS[int(rng.integers(len(MOTIFS)))](road, rng)[0]
