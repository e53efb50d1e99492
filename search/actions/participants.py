"""A participant and its timed actions, and how they lie in a vector.

A solution has 1 to 6 participants of 2 to 8 actions each. In the vector every participant has the same room: what it
is, where it starts relative to the ego, how fast, and eight pairs of action and numbers. Participants and actions
that are not there come last; their numbers are 0.

An action's magnitude is stored as a share of the way between the least and the most that the action can have, so
that magnitudes of different actions compare. Source: Tian et al., encoding of solutions.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

from brink.search.actions.road import REACH_M
from brink.search.parameters import Categorical, Parameter, Real

MOST_PARTICIPANTS: Final = 6
LEAST_ACTIONS: Final = 2
MOST_ACTIONS: Final = 8
SHORTEST_S: Final = 0.5
LONGEST_S: Final = 6.0
NONE: Final = "none"


class Kind(StrEnum):
    """What a participant is."""

    CAR = "car"
    VAN = "van"
    PEDESTRIAN = "pedestrian"


class Action(StrEnum):
    """What a participant does for a while."""

    KEEP = "keep"
    ACCELERATE = "accelerate"
    DECELERATE = "decelerate"
    BRAKE = "brake"
    CHANGE_LEFT = "change_left"
    CHANGE_RIGHT = "change_right"
    CUT_IN = "cut_in"
    CROSS = "cross"


@dataclass(frozen=True, slots=True, kw_only=True)
class Magnitude:
    """What the magnitude of an action means.

    Attributes:
        least: Smallest value.
        most: Largest value.
        unit: Its unit; empty if the action has no magnitude.
        meaning: In words.
    """

    least: float
    most: float
    unit: str
    meaning: str


MAGNITUDES: Final[Mapping[Action, Magnitude]] = {
    Action.KEEP: Magnitude(least=0.0, most=0.0, unit="", meaning="none: speed and lane stay as they are"),
    Action.ACCELERATE: Magnitude(least=0.5, most=3.0, unit="m/s2", meaning="acceleration"),
    Action.DECELERATE: Magnitude(least=0.5, most=3.0, unit="m/s2", meaning="deceleration"),
    Action.BRAKE: Magnitude(least=3.0, most=8.0, unit="m/s2", meaning="deceleration"),
    Action.CHANGE_LEFT: Magnitude(least=0.3, most=1.0, unit="lanes", meaning="how far to its own left"),
    Action.CHANGE_RIGHT: Magnitude(least=0.3, most=1.0, unit="lanes", meaning="how far to its own right"),
    Action.CUT_IN: Magnitude(
        least=0.0, most=3.0, unit="m/s2", meaning="deceleration while it moves into the ego's lane"
    ),
    Action.CROSS: Magnitude(least=0.8, most=3.0, unit="m/s", meaning="speed at which it walks across"),
}
OF_VEHICLES: Final = tuple(action for action in Action if action is not Action.CROSS)
OF_PEDESTRIANS: Final = (Action.KEEP, Action.ACCELERATE, Action.DECELERATE, Action.BRAKE, Action.CROSS)
FASTEST_MPS: Final[Mapping[Kind, float]] = {Kind.CAR: 15.0, Kind.VAN: 13.0, Kind.PEDESTRIAN: 3.0}
SIZES_M: Final[Mapping[Kind, tuple[float, float]]] = {
    Kind.CAR: (4.4, 1.8),
    Kind.VAN: (5.6, 2.0),
    Kind.PEDESTRIAN: (0.45, 0.55),
}
"""Length and width."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Gene:
    """One timed action.

    Attributes:
        action: What is done.
        duration_s: For how long.
        magnitude: How much of it, in the action's unit; 0 for one that has none.
    """

    action: Action
    duration_s: float
    magnitude: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Participant:
    """One participant: a chromosome.

    Attributes:
        kind: What it is.
        ds_m: Station at which it starts, relative to the ego.
        dd_m: Offset at which it starts, relative to the ego, positive to the left.
        dyaw_rad: Heading relative to the ego's lane, in [-pi, pi].
        speed_mps: Speed at which it starts.
        genes: What it does, one after the other.
    """

    kind: Kind
    ds_m: float
    dd_m: float
    dyaw_rad: float
    speed_mps: float
    genes: tuple[Gene, ...]

    @property
    def on_foot(self) -> bool:
        """Whether it walks."""
        return self.kind is Kind.PEDESTRIAN


def share_of(action: Action, magnitude: float) -> float:
    """Return a magnitude as a share of the action's range, in [0, 1]."""
    room = MAGNITUDES[action]
    if room.most == room.least:
        return 0.0
    return min(max((magnitude - room.least) / (room.most - room.least), 0.0), 1.0)


def magnitude_of(action: Action, share: float) -> float:
    """Return the magnitude that a share of the action's range stands for."""
    room = MAGNITUDES[action]
    return room.least + share * (room.most - room.least)


@dataclass(frozen=True, slots=True, kw_only=True)
class Names:
    """Names of a participant's parameters.

    Attributes:
        kind: What it is.
        start: Station, offset, heading and speed.
        genes: Action, duration and magnitude of each action.
    """

    kind: str
    start: tuple[str, str, str, str]
    genes: tuple[tuple[str, str, str], ...]
    every: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        genes = [name for gene in self.genes for name in gene]
        object.__setattr__(self, "every", (self.kind, *self.start, *genes))


def names_of(index: int, actions: int = MOST_ACTIONS) -> Names:
    """Return the names of a participant's parameters; participants count from 1."""
    prefix = f"p{index}."
    return Names(
        kind=prefix + "kind",
        start=(prefix + "ds_m", prefix + "dd_m", prefix + "dyaw_rad", prefix + "speed_mps"),
        genes=tuple(
            (
                f"{prefix}a{number}.action",
                f"{prefix}a{number}.duration_s",
                f"{prefix}a{number}.magnitude",
            )
            for number in range(1, actions + 1)
        ),
    )


KIND_CHOICES: Final = (NONE, *Kind)
ACTION_CHOICES: Final = (NONE, *Action)


def parameters_of(names: Names) -> tuple[Parameter, ...]:
    """Return the parameters of one participant."""
    station, offset, heading, speed = names.start
    parameters: list[Parameter] = [
        Categorical(names.kind, tuple(str(kind) for kind in KIND_CHOICES)),
        Real(station, -REACH_M, REACH_M, "m"),
        Real(offset, -REACH_M, REACH_M, "m"),
        Real(heading, -math.pi, math.pi, "rad"),
        Real(speed, 0.0, max(FASTEST_MPS.values()), "m/s"),
    ]
    for action, duration, magnitude in names.genes:
        parameters.append(Categorical(action, tuple(str(choice) for choice in ACTION_CHOICES)))
        parameters.append(Real(duration, 0.0, LONGEST_S, "s"))
        parameters.append(Real(magnitude, 0.0, 1.0))
    return tuple(parameters)


def read(values: Mapping[str, float], names: Names) -> Participant | None:
    """Return the participant that stored values describe, or None if there is none."""
    chosen = KIND_CHOICES[int(values[names.kind])]
    if chosen == NONE:
        return None
    genes = []
    for action, duration, magnitude in names.genes:
        done = ACTION_CHOICES[int(values[action])]
        if done != NONE:
            what = Action(done)
            genes.append(
                Gene(
                    action=what, duration_s=values[duration], magnitude=magnitude_of(what, values[magnitude])
                )
            )
    station, offset, heading, speed = (values[name] for name in names.start)
    return Participant(
        kind=Kind(chosen), ds_m=station, dd_m=offset, dyaw_rad=heading, speed_mps=speed, genes=tuple(genes)
    )


def written(participant: Participant, names: Names) -> dict[str, float]:
    """Return the stored values of a participant."""
    values = dict.fromkeys(names.every, 0.0)
    values[names.kind] = float(KIND_CHOICES.index(participant.kind))
    start = (participant.ds_m, participant.dd_m, participant.dyaw_rad, participant.speed_mps)
    values.update(zip(names.start, start, strict=True))
    for gene, (action, duration, magnitude) in zip(participant.genes, names.genes, strict=False):
        values[action] = float(ACTION_CHOICES.index(gene.action))
        values[duration] = gene.duration_s
        values[magnitude] = share_of(gene.action, gene.magnitude)
    return values
