"""The constraint on a component of traffic participants, which depends on the road, the kinds and the actions.

What `Participants.repair` returns can always be driven: the participants come first and empty places last; everyone
starts on a lane, a pavement or a side street, clear of all others; and every action fits its participant's kind.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from brink.search.errors import SpaceError, UnsupportedSpace
from brink.search.parameters import Categorical, Number, Parameter, Values
from brink.search.space import Component, FloatArray, SearchSpace, frozen_array
from brink.search.traffic.participants import (
    ACTION_CHOICES,
    KIND_CHOICES,
    MAGNITUDES,
    MAX_ACTIONS,
    MAX_DURATION_S,
    MAX_PARTICIPANTS,
    MAX_SPEEDS_MPS,
    MIN_ACTIONS,
    MIN_DURATION_S,
    NONE,
    PEDESTRIAN_ACTIONS,
    REACH_M,
    SIZES_M,
    VEHICLE_ACTIONS,
    Action,
    Kind,
    ParameterNames,
    RoadLimits,
    Solution,
)

ALONG_M = 1.0
ACROSS_M = 0.3
"""Minimum gaps between participants at the start, along and across the road."""

KERB_ROOM_M = 0.35
"""Minimum distance of pedestrians from the edges of a pavement."""

WAITS_M = 5.0
"""Minimum distance of vehicles in a side street from the kerb line at the start."""

_NO_ACTION = 0
_FILLER_S = 2.0
"""Duration of the `keep` actions appended to a participant with too few actions."""


@dataclass(frozen=True, slots=True)
class Start:
    """Where a participant starts.

    Attributes:
        ds_m: Station.
        dd_m: Offset.
        dyaw_rad: Heading: 0 or pi along the road, pi/2 to its left, -pi/2 to its right.
    """

    ds_m: float
    dd_m: float
    dyaw_rad: float

    @property
    def across(self) -> bool:
        """Whether the participant heads across the road."""
        return abs(math.cos(self.dyaw_rad)) < 0.5


def nearest_start(kind: Kind, start: Start, road: RoadLimits) -> Start:
    """Return the nearest start that the road allows, ignoring other participants.

    An allowed start is returned unchanged.

    Args:
        kind: Kind of the participant.
        start: The wanted start.
        road: The road.
    """
    ds_m = min(max(start.ds_m, -REACH_M), REACH_M)
    dd_m = min(max(start.dd_m, -REACH_M), REACH_M)
    if kind is Kind.PEDESTRIAN:
        return Start(ds_m, _on_pavement(dd_m, road), 0.0 if math.cos(start.dyaw_rad) >= 0 else math.pi)
    if not road.on_carriageway(dd_m):
        station_m = road.street_lane(ds_m, dd_m)
        if station_m is not None:
            return _in_street(dd_m, station_m, road)
    own = dd_m < 0.5 * road.lane_width_m
    middle_m = 0.0 if own else road.lane_width_m
    room_m = 0.5 * (road.lane_width_m - SIZES_M[kind][1])
    # A vehicle on the oncoming lane may be overtaking, but none starts on the ego's lane against the traffic.
    ahead = own or math.cos(start.dyaw_rad) > 0
    return Start(ds_m, min(max(dd_m, middle_m - room_m), middle_m + room_m), 0.0 if ahead else math.pi)


def _on_pavement(dd_m: float, road: RoadLimits) -> float:
    if dd_m < 0.5 * (road.left_kerb_m + road.right_kerb_m):
        kerb_m = road.right_kerb_m
        return min(max(dd_m, kerb_m - road.pavement_m + KERB_ROOM_M), kerb_m - KERB_ROOM_M)
    kerb_m = road.left_kerb_m
    return min(max(dd_m, kerb_m + KERB_ROOM_M), kerb_m + road.pavement_m - KERB_ROOM_M)


def _in_street(dd_m: float, station_m: float, road: RoadLimits) -> Start:
    if dd_m > 0:
        return Start(station_m, max(dd_m, road.left_kerb_m + WAITS_M), -0.5 * math.pi)
    return Start(station_m, min(dd_m, road.right_kerb_m - WAITS_M), 0.5 * math.pi)


@dataclass(frozen=True, slots=True)
class Box:
    """The area that a participant occupies, as ranges of station and offset."""

    low_s_m: float
    high_s_m: float
    low_d_m: float
    high_d_m: float

    @classmethod
    def of(cls, kind: Kind, start: Start) -> "Box":
        """Return the area of a participant, including half of its gap to others."""
        length_m, width_m = SIZES_M[kind]
        along_m, across_m = (width_m, length_m) if start.across else (length_m, width_m)
        half_s, half_d = 0.5 * (along_m + ALONG_M), 0.5 * (across_m + ACROSS_M)
        return cls(start.ds_m - half_s, start.ds_m + half_s, start.dd_m - half_d, start.dd_m + half_d)

    def overlaps(self, other: "Box") -> bool:
        """Return whether two areas overlap."""
        return (
            self.low_s_m < other.high_s_m
            and other.low_s_m < self.high_s_m
            and self.low_d_m < other.high_d_m
            and other.low_d_m < self.high_d_m
        )


def ego_box(road: RoadLimits) -> Box:
    """Return the area around the ego, on its lane, in which no participant starts."""
    half_m = 0.5 * road.lane_width_m
    return Box(-road.clear_behind_m, road.clear_ahead_m, -half_m, half_m)


def nearest_free_start(kind: Kind, start: Start, taken: Iterable[Box], road: RoadLimits) -> Start | None:
    """Return the nearest start in the same lane, pavement or street that is clear of others.

    Args:
        kind: Kind of the participant.
        start: A start that the road allows.
        taken: Areas of the others.
        road: The road.

    Returns:
        The start, or None if there is no room.
    """
    boxes = list(taken)
    for candidate in _alternatives(kind, start, road):
        box = Box.of(kind, candidate)
        if not any(box.overlaps(other) for other in boxes):
            return candidate
    return None


def _alternatives(kind: Kind, start: Start, road: RoadLimits) -> Iterator[Start]:
    """Yield a start and then starts at growing distances, along the road or back along the side street."""
    yield start
    step_m = SIZES_M[kind][0] + ALONG_M
    for count in range(1, math.ceil(2.0 * REACH_M / step_m)):
        for sign in (1.0, -1.0):
            if start.across:
                moved = Start(start.ds_m, start.dd_m + sign * count * step_m, start.dyaw_rad)
            else:
                moved = Start(start.ds_m + sign * count * step_m, start.dd_m, start.dyaw_rad)
            if nearest_start(kind, moved, road) == moved:
                yield moved


@dataclass(frozen=True, slots=True)
class Participants:
    """Constraint on a component of traffic participants; it owns all parameters of the component.

    Attributes:
        count: Largest number of participants.
        road: The road they are on.
        places: Names of each participant's parameters.
    """

    count: int
    road: RoadLimits
    places: tuple[ParameterNames, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not 1 <= self.count <= MAX_PARTICIPANTS:
            raise SpaceError(f"Participants: expected a count of 1 to {MAX_PARTICIPANTS}, got {self.count!r}")
        places = tuple(ParameterNames.of(index) for index in range(1, self.count + 1))
        object.__setattr__(self, "places", places)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters that the constraint owns."""
        return tuple(name for place in self.places for name in place.all)

    def fit(self, parameters: Mapping[str, Parameter]) -> None:
        """Raise SpaceError if the constraint does not fit the component's parameters."""
        for place in self.places:
            for parameter in place.parameters():
                given = parameters.get(parameter.name)
                if given is None or given.unlimited() != parameter:
                    raise SpaceError(f"Participants: expected the parameter {parameter!r}")
        self._fit_limits(parameters)

    def _fit_limits(self, parameters: Mapping[str, Parameter]) -> None:
        """Check the limits of an ODD: the same in all places, as repair moves participants and actions up."""
        first = self.places[0]
        for place in self.places:
            others = zip((place.kind, place.start[3]), (first.kind, first.start[3]), strict=True)
            genes = [pair for gene in place.genes for pair in zip(gene, first.genes[0], strict=True)]
            for name, other in (*others, *genes):
                if parameters[name].odd != parameters[other].odd:
                    raise SpaceError(
                        f"expected the same limit for {name} and {other}, as repair moves road users and actions "
                        f"up: limit {_pattern(name)}"
                    )
        action, duration, _ = first.genes[0]
        kinds, actions = _allowed(parameters[first.kind]), _allowed(parameters[action])
        if NONE not in kinds or kinds == {NONE}:
            raise SpaceError(f"expected {NONE} and at least one other choice of {_pattern(first.kind)}")
        if not actions >= {NONE, Action.KEEP}:
            raise SpaceError(f"expected {NONE} and {Action.KEEP} among the choices of {_pattern(action)}")
        speed, times = parameters[first.start[3]], parameters[duration]
        slowest = min(MAX_SPEEDS_MPS[Kind(kind)] for kind in kinds - {NONE})
        if isinstance(speed, Number) and speed.least > slowest:
            raise SpaceError(
                f"expected {_pattern(first.start[3])} to be at least {slowest:g} m/s or less, the largest speed of "
                f"one of the kinds; got {speed.least:g} m/s"
            )
        if isinstance(times, Number) and times.most < MIN_DURATION_S:
            raise SpaceError(f"expected {_pattern(duration)} to be up to {MIN_DURATION_S:g} s or more")

    def unlimited_names(self) -> tuple[str, ...]:
        """Return the places where participants start: they follow from the road and from the others."""
        return tuple(name for place in self.places for name in place.start[:3])

    def checks_limits(self) -> bool:
        """Return True: `problem` checks the limits, as the zeros of an empty place may lie outside."""
        return True

    def repair(self, values: Values, parameters: Mapping[str, Parameter]) -> None:
        """Repair the values in place; participants without room are dropped, valid values stay unchanged."""
        present = [self._repaired(values, place, parameters) for place in self.places if values[place.kind]]
        if not present:
            first = {**values, self.places[0].kind: float(self._first_kind(parameters))}
            present = [self._repaired(first, self.places[0], parameters)]
        taken = [ego_box(self.road)]
        kept: list[list[float]] = []
        for numbers in present:
            kind = Kind(KIND_CHOICES[int(numbers[0])])
            start = nearest_free_start(kind, Start(*numbers[1:4]), taken, self.road)
            if start is not None:
                taken.append(Box.of(kind, start))
                kept.append([numbers[0], start.ds_m, start.dd_m, start.dyaw_rad, *numbers[4:]])
        for index, place in enumerate(self.places):
            numbers = kept[index] if index < len(kept) else [0.0] * len(place.all)
            values.update(zip(place.all, numbers, strict=True))

    def _first_kind(self, parameters: Mapping[str, Parameter]) -> int:
        """Return the first kind that is allowed, a car without an ODD."""
        allowed = _allowed(parameters[self.places[0].kind])
        return next(place for place, kind in enumerate(KIND_CHOICES) if kind != NONE and kind in allowed)

    def _repaired(
        self, values: Values, place: ParameterNames, parameters: Mapping[str, Parameter]
    ) -> list[float]:
        """Return the repaired numbers of one participant, ignoring the others."""
        kind = Kind(KIND_CHOICES[int(values[place.kind])])
        ds_m, dd_m, dyaw_rad, speed_mps = (values[name] for name in place.start)
        heading = dyaw_rad if math.isfinite(dyaw_rad) else 0.0
        start = nearest_start(kind, Start(ds_m, dd_m, min(max(heading, -math.pi), math.pi)), self.road)
        numbers = [values[place.kind], start.ds_m, start.dd_m, start.dyaw_rad]
        speed_mps = _clipped(speed_mps, parameters[place.start[3]])
        numbers.append(min(max(speed_mps, 0.0), MAX_SPEEDS_MPS[kind]))
        genes = [
            _repaired_gene(kind, [values[name] for name in gene], [parameters[name] for name in gene])
            for gene in place.genes
            if values[gene[0]] != _NO_ACTION
        ]
        filler_s = _clipped(_FILLER_S, parameters[place.genes[0][1]])
        keep = (float(ACTION_CHOICES.index(Action.KEEP)), filler_s, 0.0)
        genes += [keep] * (MIN_ACTIONS - len(genes))
        genes += [(float(_NO_ACTION), 0.0, 0.0)] * (MAX_ACTIONS - len(genes))
        return numbers + [number for gene in genes for number in gene]

    def problem(self, values: Values, parameters: Mapping[str, Parameter]) -> str | None:
        """Return what is wrong with the values, or None."""
        repaired = dict(values)
        self.repair(repaired, parameters)
        for name in self.names:
            if values[name] != repaired[name]:
                expected = parameters[name].decode(repaired[name])
                return f"expected {name} to be {expected!r} given the other values, got {values[name]!r}"
        return None

    def describe(self) -> dict[str, Any]:
        """Return the constraint as a JSON object."""
        return {"type": "participants", "count": self.count, "road": dict(self.road.describe())}

    def decode(self, vector: FloatArray) -> Solution:
        """Return the participants in a vector of the component."""
        values = dict(zip(self.names, vector.tolist(), strict=True))
        decoded = (place.decode(values) for place in self.places)
        return tuple(participant for participant in decoded if participant is not None)

    def encode(self, participants: Solution) -> FloatArray:
        """Return the vector that encodes participants; it may need repair.

        Raises:
            SpaceError: There are too many participants, or one has too many actions.
        """
        if len(participants) > self.count:
            raise SpaceError(f"expected at most {self.count} participants, got {len(participants)}")
        for participant in participants:
            if len(participant.genes) > MAX_ACTIONS:
                raise SpaceError(f"expected at most {MAX_ACTIONS} actions, got {len(participant.genes)}")
        values = dict.fromkeys(self.names, 0.0)
        for participant, place in zip(participants, self.places, strict=False):
            values.update(place.encode(participant))
        return frozen_array([values[name] for name in self.names])


def _repaired_gene(
    kind: Kind, gene: Sequence[float], parameters: Sequence[Parameter]
) -> tuple[float, float, float]:
    choice, duration_s, magnitude = gene
    action = Action(ACTION_CHOICES[int(choice)])
    if kind is Kind.PEDESTRIAN and action not in PEDESTRIAN_ACTIONS:
        action = Action.CROSS if Action.CROSS in _allowed(parameters[0]) else Action.KEEP
    if kind is not Kind.PEDESTRIAN and action not in VEHICLE_ACTIONS:
        action = Action.KEEP
    has_magnitude = MAGNITUDES[action].unit != ""
    duration_s, magnitude = _clipped(duration_s, parameters[1]), _clipped(magnitude, parameters[2])
    return (
        float(ACTION_CHOICES.index(action)),
        min(max(duration_s, MIN_DURATION_S), MAX_DURATION_S),
        min(max(magnitude, 0.0), 1.0) if has_magnitude else 0.0,
    )


def _clipped(value: float, parameter: Parameter) -> float:
    """Return the nearest value within the ODD; the value itself without one."""
    return parameter.clipped(value) if isinstance(parameter, Number) and parameter.bounds else value


def _allowed(parameter: Parameter) -> set[str]:
    """Return the choices within the ODD."""
    if not isinstance(parameter, Categorical):
        return set()
    return {parameter.choices[code] for code in parameter.codes}


def _pattern(name: str) -> str:
    """Return the pattern for a parameter of all participants and actions: ``p*.a*.action`` for ``p2.a1.action``."""
    return re.sub(r"(?<=[pa])[0-9]+(?=\.)", "*", name)


def participants_component(name: str, count: int, road: RoadLimits) -> Component:
    """Return a component of traffic participants.

    Args:
        name: Name of the component.
        count: Largest number of participants.
        road: The road they are on.

    Raises:
        SpaceError: The count is out of range.
    """
    rule = Participants(count, road)
    return Component(name, tuple(p for place in rule.places for p in place.parameters()), (rule,))


def participants_of(space: SearchSpace) -> tuple[int, Participants]:
    """Return the index of the traffic-participants component and the component's `Participants` constraint.

    Raises:
        UnsupportedSpace: The space has no such component.
    """
    for index, component in enumerate(space.components):
        for rule in component.constraints:
            if isinstance(rule, Participants) and len(rule.names) == component.dimension:
                return index, rule
    raise UnsupportedSpace("expected a space with a component of traffic participants with timed actions")


def has_participants(space: SearchSpace) -> bool:
    """Return whether a space has a traffic-participants component."""
    try:
        participants_of(space)
    except UnsupportedSpace:
        return False
    return True
