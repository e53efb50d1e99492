"""The constraint that makes a component out of participants: what the road, the kinds and the actions allow.

Whatever comes out of `Participants.repair` is a solution that can be driven: participants first and then empty rooms,
each on a lane, a pavement or a side street, nobody on anybody else, actions that fit their kind.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from brink.search.actions.participants import (
    ACTION_CHOICES,
    FASTEST_MPS,
    KIND_CHOICES,
    LEAST_ACTIONS,
    LONGEST_S,
    MAGNITUDES,
    MOST_ACTIONS,
    MOST_PARTICIPANTS,
    OF_PEDESTRIANS,
    OF_VEHICLES,
    SHORTEST_S,
    Action,
    Kind,
    Names,
    Participant,
    names_of,
    parameters_of,
    read,
    written,
)
from brink.search.actions.placing import Box, Start, ego_box, freed, placed
from brink.search.actions.road import RoadLimits
from brink.search.component import Component, FloatArray, frozen_array
from brink.search.constraints import Values
from brink.search.errors import SpaceError, UnsupportedSpace
from brink.search.parameters import Parameter
from brink.search.space import SearchSpace

_NOBODY = 0
_NO_ACTION = 0
_FILLS_S = 2.0
"""How long a participant keeps on that has too few actions."""


@dataclass(frozen=True, slots=True)
class Participants:
    """Owns all parameters of a component of participants.

    Attributes:
        count: How many participants there may be.
        road: Where they are.
        rooms: The names of each participant's parameters.
    """

    count: int
    road: RoadLimits
    rooms: tuple[Names, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not 1 <= self.count <= MOST_PARTICIPANTS:
            raise SpaceError(f"Participants: expected 1 to {MOST_PARTICIPANTS}, got {self.count!r}")
        object.__setattr__(self, "rooms", tuple(names_of(index) for index in range(1, self.count + 1)))

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that it owns."""
        return tuple(name for room in self.rooms for name in room.every)

    def fit(self, parameters: Mapping[str, Parameter]) -> None:
        """Raise SpaceError if the constraint cannot be kept with these parameters."""
        for room in self.rooms:
            for parameter in parameters_of(room):
                if parameters.get(parameter.name) != parameter:
                    raise SpaceError(f"Participants: expected the parameter {parameter!r}")

    def repair(self, values: Values, parameters: Mapping[str, Parameter]) -> None:
        """Mend the values in place; values that comply stay as they are."""
        rooms = [self._somebody(values, room) for room in self.rooms if values[room.kind] != _NOBODY]
        if not rooms:
            first = dict(values)
            first[self.rooms[0].kind] = float(KIND_CHOICES.index(Kind.CAR))
            rooms = [self._somebody(first, self.rooms[0])]
        taken = [ego_box(self.road)]
        kept: list[list[float]] = []
        for somebody in rooms:
            kind = Kind(KIND_CHOICES[int(somebody[0])])
            start = freed(kind, Start(*somebody[1:4]), taken, self.road)
            if start is not None:
                taken.append(Box.of(kind, start))
                kept.append([somebody[0], start.ds_m, start.dd_m, start.dyaw_rad, *somebody[4:]])
        for index, room in enumerate(self.rooms):
            numbers = kept[index] if index < len(kept) else [0.0] * len(room.every)
            values.update(zip(room.every, numbers, strict=True))

    def _somebody(self, values: Values, room: Names) -> list[float]:
        """Return the mended numbers of a participant, but for where others are."""
        kind = Kind(KIND_CHOICES[int(values[room.kind])])
        ds_m, dd_m, dyaw_rad, speed = (values[name] for name in room.start)
        heading = dyaw_rad if math.isfinite(dyaw_rad) else 0.0
        start = placed(kind, Start(ds_m, dd_m, min(max(heading, -math.pi), math.pi)), self.road)
        numbers = [values[room.kind], start.ds_m, start.dd_m, start.dyaw_rad]
        numbers.append(min(max(speed, 0.0), FASTEST_MPS[kind]))
        genes = [
            _mended(kind, *(values[name] for name in gene))
            for gene in room.genes
            if values[gene[0]] != _NO_ACTION
        ]
        keep = (float(ACTION_CHOICES.index(Action.KEEP)), _FILLS_S, 0.0)
        genes += [keep] * (LEAST_ACTIONS - len(genes))
        genes += [(float(_NO_ACTION), 0.0, 0.0)] * (MOST_ACTIONS - len(genes))
        return numbers + [number for gene in genes for number in gene]

    def problem(self, values: Values, parameters: Mapping[str, Parameter]) -> str | None:
        """Return what is wrong with the values, or None."""
        mended = dict(values)
        self.repair(mended, parameters)
        for name in self.names:
            if values[name] != mended[name]:
                wanted = parameters[name].decode(mended[name])
                return f"expected {name} to be {wanted!r} with the rest, got {values[name]!r}"
        return None

    def describe(self) -> dict[str, Any]:
        """Return the constraint as a JSON object."""
        return {"type": "participants", "count": self.count, "road": dict(self.road.describe())}

    def read(self, vector: FloatArray) -> tuple[Participant, ...]:
        """Return the participants of a vector of the component."""
        values = dict(zip(self.names, vector.tolist(), strict=True))
        everybody = (read(values, room) for room in self.rooms)
        return tuple(participant for participant in everybody if participant is not None)

    def written(self, participants: tuple[Participant, ...]) -> FloatArray:
        """Return the vector of participants; it may need repair.

        Raises:
            SpaceError: There are too many of them, or one has too many actions.
        """
        if len(participants) > self.count:
            raise SpaceError(f"expected at most {self.count} participants, got {len(participants)}")
        for participant in participants:
            if len(participant.genes) > MOST_ACTIONS:
                raise SpaceError(f"expected at most {MOST_ACTIONS} actions, got {len(participant.genes)}")
        values = dict.fromkeys(self.names, 0.0)
        for participant, room in zip(participants, self.rooms, strict=False):
            values.update(written(participant, room))
        return frozen_array([values[name] for name in self.names])


def _mended(kind: Kind, choice: float, duration_s: float, magnitude: float) -> tuple[float, float, float]:
    action = Action(ACTION_CHOICES[int(choice)])
    if kind is Kind.PEDESTRIAN and action not in OF_PEDESTRIANS:
        action = Action.CROSS
    if kind is not Kind.PEDESTRIAN and action not in OF_VEHICLES:
        action = Action.KEEP
    has_magnitude = MAGNITUDES[action].unit != ""
    return (
        float(ACTION_CHOICES.index(action)),
        min(max(duration_s, SHORTEST_S), LONGEST_S),
        min(max(magnitude, 0.0), 1.0) if has_magnitude else 0.0,
    )


def participants_component(name: str, count: int, road: RoadLimits) -> Component:
    """Return a component of up to so many participants on a road.

    Raises:
        SpaceError: The count is out of range.
    """
    rule = Participants(count, road)
    return Component(name, tuple(p for room in rule.rooms for p in parameters_of(room)), (rule,))


def participants_of(space: SearchSpace) -> tuple[int, Participants]:
    """Return which component is made of participants, and its constraint.

    Raises:
        UnsupportedSpace: None is.
    """
    for index, component in enumerate(space.components):
        for rule in component.constraints:
            if isinstance(rule, Participants) and len(rule.names) == component.dimension:
                return index, rule
    raise UnsupportedSpace("expected a component of traffic participants with timed actions")
