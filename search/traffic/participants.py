"""Traffic participants, their timed actions, the road they are on, and their encoding in a vector.

A solution has 1 to 6 participants with 2 to 8 actions each. Every participant takes the same number of parameters:
its kind, its start relative to the ego, its speed, and eight triples of action, duration and magnitude. Missing
participants and actions come last, with all numbers 0. A magnitude is stored as a share of its action's range, so
magnitudes of different actions are comparable.

Coordinates are road coordinates. Stations run along the centre line of the lane on which the ego starts, with 0 at
the ego's centre; offsets run to the left, with 0 on that line. Traffic keeps to the right: the oncoming lane is one
lane width to the left.

Source: Tian et al., encoding of solutions.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import StrEnum
from typing import Any, Final, TypeAlias

from brink.search.errors import SpaceError
from brink.search.parameters import Categorical, Parameter, Real, ResolutionByChoice

MAX_PARTICIPANTS: Final = 6
MIN_ACTIONS: Final = 2
MAX_ACTIONS: Final = 8
MIN_DURATION_S: Final = 0.5
MAX_DURATION_S: Final = 6.0
REACH_M: Final = 55.0
RESOLUTION_M: Final = 0.25
RESOLUTION_S: Final = 0.1
RESOLUTION_MPS: Final = 0.25
RESOLUTION_RAD: Final = 0.05
_RESOLUTION_OF_UNIT: Final[Mapping[str, float]] = {"m/s2": 0.1, "m/s": 0.1, "lanes": 0.05}
"""Participants start within this distance of the ego, along and across the road: up to the nearest crossroads."""
NONE: Final = "none"


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadLimits:
    """Geometry of the road: a carriageway of two lanes with a pavement on each side.

    Attributes:
        lane_width_m: Width of each lane.
        strip_m: Width of the strip between a lane and the pavement, for example for parked cars.
        pavement_m: Width of each pavement.
        streets_m: Stations of the centre lines of crossing streets, ascending.
        clear_behind_m: Distance behind the ego's centre that is kept clear of starts on its lane.
        clear_ahead_m: Distance ahead of the ego's centre that is kept clear of starts on its lane.
    """

    lane_width_m: float = 3.5
    strip_m: float = 0.3
    pavement_m: float = 2.6
    streets_m: tuple[float, ...] = ()
    clear_behind_m: float = 9.0
    clear_ahead_m: float = 14.0

    def __post_init__(self) -> None:
        if not self.lane_width_m >= 2.5 or self.strip_m < 0 or not self.pavement_m >= 1.0:
            raise SpaceError(
                "RoadLimits: expected lanes of at least 2.5 m, strips of at least 0 m and pavements of at least 1 m"
            )

    @property
    def right_kerb_m(self) -> float:
        """Offset of the right kerb, where the pavement begins."""
        return -0.5 * self.lane_width_m - self.strip_m

    @property
    def left_kerb_m(self) -> float:
        """Offset of the left kerb, where the pavement begins."""
        return 1.5 * self.lane_width_m + self.strip_m

    def on_carriageway(self, offset_m: float) -> bool:
        """Return whether an offset lies between the kerbs."""
        return self.right_kerb_m < offset_m < self.left_kerb_m

    def street_lane(self, station_m: float, offset_m: float) -> float | None:
        """Return the station of the nearest lane that leads from a crossing street to the road; None without one."""
        half_m = (-0.5 if offset_m > 0 else 0.5) * self.lane_width_m
        lanes_m = [middle_m + half_m for middle_m in self.streets_m if abs(middle_m + half_m) <= REACH_M]
        return min(lanes_m, key=lambda lane_m: abs(lane_m - station_m), default=None)

    def describe(self) -> Mapping[str, Any]:
        """Return the road as a JSON object."""
        return {
            field.name: list(value) if isinstance(value := getattr(self, field.name), tuple) else value
            for field in fields(self)
        }


class Kind(StrEnum):
    """Kind of a participant."""

    CAR = "car"
    VAN = "van"
    PEDESTRIAN = "pedestrian"


class Action(StrEnum):
    """A manoeuvre that a participant carries out for some time."""

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
    """Meaning and range of an action's magnitude.

    Attributes:
        low: Smallest value.
        high: Largest value.
        unit: Its unit; empty for an action without a magnitude.
        meaning: What it measures, in words.
    """

    low: float
    high: float
    unit: str
    meaning: str


MAGNITUDES: Final[Mapping[Action, Magnitude]] = {
    Action.KEEP: Magnitude(low=0.0, high=0.0, unit="", meaning="none: speed and lane stay as they are"),
    Action.ACCELERATE: Magnitude(low=0.5, high=3.0, unit="m/s2", meaning="acceleration"),
    Action.DECELERATE: Magnitude(low=0.5, high=3.0, unit="m/s2", meaning="deceleration"),
    Action.BRAKE: Magnitude(low=3.0, high=8.0, unit="m/s2", meaning="deceleration"),
    Action.CHANGE_LEFT: Magnitude(low=0.3, high=1.0, unit="lanes", meaning="how far to its own left"),
    Action.CHANGE_RIGHT: Magnitude(low=0.3, high=1.0, unit="lanes", meaning="how far to its own right"),
    Action.CUT_IN: Magnitude(
        low=0.0, high=3.0, unit="m/s2", meaning="deceleration while it moves into the ego's lane"
    ),
    Action.CROSS: Magnitude(low=0.8, high=3.0, unit="m/s", meaning="speed at which it walks across"),
}
_MAGNITUDE_RESOLUTIONS: Final[Mapping[str, float]] = {
    action.value: _RESOLUTION_OF_UNIT[limits.unit] / (limits.high - limits.low)
    for action, limits in MAGNITUDES.items()
    if limits.unit
}
VEHICLE_ACTIONS: Final = tuple(action for action in Action if action is not Action.CROSS)
PEDESTRIAN_ACTIONS: Final = (Action.KEEP, Action.ACCELERATE, Action.DECELERATE, Action.BRAKE, Action.CROSS)
MAX_SPEEDS_MPS: Final[Mapping[Kind, float]] = {Kind.CAR: 15.0, Kind.VAN: 13.0, Kind.PEDESTRIAN: 3.0}
SIZES_M: Final[Mapping[Kind, tuple[float, float]]] = {
    Kind.CAR: (4.4, 1.8),
    Kind.VAN: (5.6, 2.0),
    Kind.PEDESTRIAN: (0.45, 0.55),
}
"""Length and width."""
KIND_CHOICES: Final = (NONE, *Kind)
ACTION_CHOICES: Final = (NONE, *Action)


@dataclass(frozen=True, slots=True, kw_only=True)
class Gene:
    """One timed action.

    Attributes:
        action: The manoeuvre.
        duration_s: How long it takes.
        magnitude: How strong it is, in the action's unit; 0 for an action without a magnitude.
    """

    action: Action
    duration_s: float
    magnitude: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Participant:
    """One traffic participant: a chromosome.

    Attributes:
        kind: Car, van or pedestrian.
        ds_m: Station of its start, relative to the ego.
        dd_m: Offset of its start, relative to the ego, positive to the left.
        dyaw_rad: Heading relative to the ego's lane, in [-pi, pi].
        speed_mps: Initial speed.
        genes: Its actions, in order.
    """

    kind: Kind
    ds_m: float
    dd_m: float
    dyaw_rad: float
    speed_mps: float
    genes: tuple[Gene, ...]

    @property
    def on_foot(self) -> bool:
        """Whether the participant is a pedestrian."""
        return self.kind is Kind.PEDESTRIAN


Solution: TypeAlias = tuple[Participant, ...]
"""All participants of one scenario."""


def share_of(action: Action, magnitude: float) -> float:
    """Return a magnitude as a share of its action's range, in [0, 1]."""
    limits = MAGNITUDES[action]
    if limits.high == limits.low:
        return 0.0
    return min(max((magnitude - limits.low) / (limits.high - limits.low), 0.0), 1.0)


def magnitude_of(action: Action, share: float) -> float:
    """Return the magnitude at a share of an action's range."""
    limits = MAGNITUDES[action]
    return limits.low + share * (limits.high - limits.low)


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterNames:
    """Names of one participant's parameters.

    Attributes:
        kind: Name of its kind.
        start: Names of station, offset, heading and speed.
        genes: Names of action, duration and magnitude, for each action.
        all: All names, in the order of the vector.
    """

    kind: str
    start: tuple[str, str, str, str]
    genes: tuple[tuple[str, str, str], ...]
    all: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        genes = [name for gene in self.genes for name in gene]
        object.__setattr__(self, "all", (self.kind, *self.start, *genes))

    @classmethod
    def of(cls, index: int) -> "ParameterNames":
        """Return the names for a participant; participants are numbered from 1."""
        prefix = f"p{index}."
        return cls(
            kind=prefix + "kind",
            start=(prefix + "ds_m", prefix + "dd_m", prefix + "dyaw_rad", prefix + "speed_mps"),
            genes=tuple(
                (f"{prefix}a{number}.action", f"{prefix}a{number}.duration_s", f"{prefix}a{number}.magnitude")
                for number in range(1, MAX_ACTIONS + 1)
            ),
        )

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the parameters with these names."""
        station, offset, heading, speed = self.start
        who = f"road user {self.kind.partition('.')[0].removeprefix('p')}"
        kinds, actions = (tuple(map(str, choices)) for choices in (KIND_CHOICES, ACTION_CHOICES))
        parameters: list[Parameter] = [
            Categorical(self.kind, kinds, title=f"{who}: kind"),
            Real(
                station, -REACH_M, REACH_M, "m", resolution=RESOLUTION_M, title=f"{who}: start along the road"
            ),
            Real(offset, -REACH_M, REACH_M, "m", resolution=RESOLUTION_M, title=f"{who}: start to the left"),
            Real(
                heading,
                -math.pi,
                math.pi,
                "rad",
                resolution=RESOLUTION_RAD,
                title=f"{who}: heading at the start",
            ),
            Real(
                speed,
                0.0,
                max(MAX_SPEEDS_MPS.values()),
                "m/s",
                resolution=RESOLUTION_MPS,
                title=f"{who}: speed at the start",
            ),
        ]
        for number, (action, duration, magnitude) in enumerate(self.genes, start=1):
            of = f"{who}, action {number}"
            parameters.append(Categorical(action, actions, title=f"{of}: manoeuvre"))
            parameters.append(
                Real(duration, 0.0, MAX_DURATION_S, "s", resolution=RESOLUTION_S, title=f"{of}: duration")
            )
            resolution = ResolutionByChoice(action, _MAGNITUDE_RESOLUTIONS)
            parameters.append(Real(magnitude, 0.0, 1.0, resolution=resolution, title=f"{of}: magnitude"))
        return tuple(parameters)

    def decode(self, values: Mapping[str, float]) -> Participant | None:
        """Return the participant in a component's stored values, or None if it is missing."""
        kind = KIND_CHOICES[int(values[self.kind])]
        if kind == NONE:
            return None
        genes = []
        for choice, duration, magnitude in self.genes:
            chosen = ACTION_CHOICES[int(values[choice])]
            if chosen != NONE:
                action = Action(chosen)
                size = magnitude_of(action, values[magnitude])
                genes.append(Gene(action=action, duration_s=values[duration], magnitude=size))
        station, offset, heading, speed = (values[name] for name in self.start)
        return Participant(
            kind=Kind(kind), ds_m=station, dd_m=offset, dyaw_rad=heading, speed_mps=speed, genes=tuple(genes)
        )

    def encode(self, participant: Participant) -> dict[str, float]:
        """Return the stored values of a participant."""
        values = dict.fromkeys(self.all, 0.0)
        values[self.kind] = float(KIND_CHOICES.index(participant.kind))
        start = (participant.ds_m, participant.dd_m, participant.dyaw_rad, participant.speed_mps)
        values.update(zip(self.start, start, strict=True))
        for gene, (action, duration, magnitude) in zip(participant.genes, self.genes, strict=False):
            values[action] = float(ACTION_CHOICES.index(gene.action))
            values[duration] = gene.duration_s
            values[magnitude] = share_of(gene.action, gene.magnitude)
        return values
