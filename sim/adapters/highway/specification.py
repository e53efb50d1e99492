"""What determines a highway-env episode: the scenario, and the errors in the ego's perception, as JSON and in words.

The ego perceives all vehicles within `RANGE_M`, as they are, apart from a few errors. This module does not import
highway-env, so that a coordinator can build a search space without it.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Self

from brink.sim.episode import Json, JsonObject, check_fields, parse_choice, parse_integer, parse_number
from brink.sim.errors import InvalidEpisode
from brink.sim.perception_errors import MODE, Magnitude

SIMULATOR_ID: Final = "highway-env@1"
MAX_DURATION_S: Final = 120.0
STEPS_PER_S: Final = 10
"""In each step the ego perceives and decides, then everybody moves."""
RANGE_M: Final = 100.0
"""Distance within which the ego perceives vehicles."""
MAX_ERRORS: Final = 8
"""Maximum number of errors in an episode."""
LONGEST_S: Final = 8.0


class RoadKind(StrEnum):
    """Environment of highway-env."""

    HIGHWAY = "highway"
    MERGE = "merge"
    ROUNDABOUT = "roundabout"
    INTERSECTION = "intersection"


class Goal(StrEnum):
    """Where the ego wants to go.

    On a highway, ``left`` and ``right`` are the outermost lanes, and with ``straight`` it changes lanes where that
    lets it drive faster.
    """

    LEFT = "left"
    STRAIGHT = "straight"
    RIGHT = "right"


USUAL_MPS: Final[Mapping[RoadKind, float]] = {
    RoadKind.HIGHWAY: 30.0,
    RoadKind.MERGE: 30.0,
    RoadKind.ROUNDABOUT: 12.0,
    RoadKind.INTERSECTION: 10.0,
}
"""Speed at which the ego of each road usually drives; scenarios give its speeds as shares of this."""
FEWEST_LANES, MOST_LANES = 2, 4
SHARES: Final[Mapping[str, tuple[float, float]]] = {
    "density": (0.5, 2.5),
    "traffic_speed": (0.4, 1.1),
    "ego_speed": (0.6, 1.2),
    "target_speed": (0.8, 1.3),
}
"""Ranges of the numbers of a scenario, relative to what is usual."""
_FIELDS: Final = ("road", "goal", "lanes", *SHARES)


@dataclass(frozen=True, slots=True, kw_only=True)
class HighwayScenario:
    """A road with traffic.

    Attributes:
        road: The environment.
        goal: Where the ego goes.
        lanes: Lanes of a highway, 2 to 4; the other roads ignore it.
        density: Traffic density relative to the environment's own.
        traffic_speed: Speed of the other vehicles relative to the environment's own.
        ego_speed: Speed at which the ego starts, relative to `USUAL_MPS`.
        target_speed: Speed at which it wants to drive, relative to `USUAL_MPS`.
    """

    road: RoadKind
    goal: Goal
    lanes: int
    density: float
    traffic_speed: float
    ego_speed: float
    target_speed: float

    @classmethod
    def from_json(cls, document: Mapping[str, Json]) -> Self:
        """Parse a scenario.

        Raises:
            InvalidEpisode: A field is missing, unknown or out of range.
        """
        check_fields("scenario", document, _FIELDS)
        shares = {
            name: parse_number(f"scenario.{name}", document[name], low, high)
            for name, (low, high) in SHARES.items()
        }
        return cls(
            road=parse_choice("scenario.road", document["road"], RoadKind),
            goal=parse_choice("scenario.goal", document["goal"], Goal),
            lanes=parse_integer("scenario.lanes", document["lanes"], FEWEST_LANES, MOST_LANES),
            **shares,
        )

    @property
    def words(self) -> str:
        """The scenario in words."""
        usual_mps = USUAL_MPS[self.road]
        return ", ".join(
            [
                self._road_words,
                _GOALS[self.road in STRAIGHT_ROADS][self.goal],
                f"traffic {100 * self.density:.0f}% as dense and {100 * self.traffic_speed:.0f}% as fast as usual",
                f"starts at {usual_mps * self.ego_speed:.1f} m/s and aims at {usual_mps * self.target_speed:.1f} m/s",
            ]
        )

    @property
    def _road_words(self) -> str:
        match self.road:
            case RoadKind.HIGHWAY:
                return f"Highway with {self.lanes} lanes"
            case RoadKind.MERGE:
                return f"Highway with {self.lanes} lanes and a merging lane"
            case RoadKind.ROUNDABOUT:
                return "Roundabout"
            case RoadKind.INTERSECTION:
                return "Intersection"


STRAIGHT_ROADS: Final = (RoadKind.HIGHWAY, RoadKind.MERGE)
"""Roads on which the ego chooses its lane."""
_GOALS: Final[Mapping[bool, Mapping[Goal, str]]] = {
    True: {
        Goal.LEFT: "to the left lane",
        Goal.STRAIGHT: "overtaking where it is faster",
        Goal.RIGHT: "to the right lane",
    },
    False: {Goal.LEFT: "turning left", Goal.STRAIGHT: "straight on", Goal.RIGHT: "turning right"},
}


class ErrorType(StrEnum):
    """What is wrong with the ego's perception."""

    MISS = "miss"
    LATE = "late"
    SHORT_RANGE = "short_range"
    GHOST = "ghost"
    TOO_FAR = "too_far"
    TOO_FAST = "too_fast"
    POSITION_NOISE = "position_noise"
    SPEED_NOISE = "speed_noise"


class Target(StrEnum):
    """Which vehicles an error affects.

    Of an error with a window, ``ahead`` is the nearest vehicle ahead on the ego's way when the window opens,
    ``left`` and ``right`` the nearest one in the neighbouring lane, ahead or beside, and ``crossing`` the nearest one
    that goes another way. The window waits until there is one. Errors without a window concern every vehicle that is
    such a target at the time. A ghost appears in that place; a crossing one comes from the right.
    """

    AHEAD = "ahead"
    LEFT = "left"
    RIGHT = "right"
    CROSSING = "crossing"
    ALL = "all"


MAGNITUDES: Final[Mapping[ErrorType, Magnitude]] = {
    ErrorType.MISS: Magnitude(
        unit="s", none=0.0, most=LONGEST_S, meaning="how long the target is not perceived"
    ),
    ErrorType.LATE: Magnitude(
        unit="s",
        none=0.0,
        most=LONGEST_S,
        has_window=False,
        meaning=f"how long after it came within {RANGE_M:g} m the target is first perceived",
    ),
    ErrorType.SHORT_RANGE: Magnitude(
        unit="m",
        none=RANGE_M,
        most=0.0,
        has_window=False,
        meaning="distance beyond which the target is not perceived",
    ),
    ErrorType.GHOST: Magnitude(
        unit="s", none=0.0, most=LONGEST_S, meaning="how long a vehicle that is not there is perceived"
    ),
    ErrorType.TOO_FAR: Magnitude(
        unit="share",
        none=0.0,
        most=1.0,
        has_duration=True,
        meaning="how much farther away the target is perceived, as a share of its distance",
    ),
    ErrorType.TOO_FAST: Magnitude(
        unit="m/s", none=0.0, most=15.0, has_duration=True, meaning="how much faster the target is perceived"
    ),
    ErrorType.POSITION_NOISE: Magnitude(
        unit="m",
        none=0.0,
        most=5.0,
        has_duration=True,
        meaning="standard deviation of the target's perceived position, along and across its heading",
    ),
    ErrorType.SPEED_NOISE: Magnitude(
        unit="m/s",
        none=0.0,
        most=10.0,
        has_duration=True,
        meaning="standard deviation of the target's perceived speed",
    ),
}

GHOST_DISTANCE_M: Final = (5.0, 80.0)
"""How far ahead of the ego's centre a ghost may appear."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PerceptionError:
    """One error of the ego's perception.

    Attributes:
        type: What is wrong.
        target: Which vehicles it concerns.
        magnitude: How wrong, in the unit of the type.
        onset_s: When its window opens.
        duration_s: Length of the window.
        distance_m: Where a ghost appears, ahead of the ego's centre.
    """

    type: ErrorType
    target: Target
    magnitude: float
    onset_s: float = 0.0
    duration_s: float = math.inf
    distance_m: float = math.nan

    def to_json(self) -> JsonObject:
        """Return the error as a JSON object, with the fields of its type."""
        values: JsonObject = {
            "type": self.type.value,
            "target": self.target.value,
            "magnitude": self.magnitude,
            "onset_s": self.onset_s,
            "duration_s": self.duration_s,
            "distance_m": self.distance_m,
        }
        return {name: values[name] for name in fields_of(self.type)}

    @classmethod
    def from_json(cls, where: str, document: Json, duration_s: float) -> Self:
        """Parse an error.

        Args:
            where: Where it stands, for messages.
            document: Its fields: those that `fields_of` lists for its type.
            duration_s: Length of the episode, which bounds times.

        Raises:
            InvalidEpisode: A field is missing, unknown or out of range.
        """
        if not isinstance(document, Mapping):
            raise InvalidEpisode(f"{where}: expected an object, got {document!r:.80}")
        kind = parse_choice(f"{where}.type", document.get("type"), ErrorType)
        scale = MAGNITUDES[kind]
        check_fields(where, document, fields_of(kind))
        lowest, highest = sorted((scale.none, scale.most))
        if scale.unit == "s":
            highest = max(highest, duration_s)
        magnitude = parse_number(f"{where}.magnitude", document["magnitude"], lowest, highest)
        bounds = {
            "onset_s": (0.0, duration_s),
            "duration_s": (0.0, duration_s),
            "distance_m": GHOST_DISTANCE_M,
        }
        values = {
            name: parse_number(f"{where}.{name}", document[name], *bounds[name])
            for name in fields_of(kind)
            if name in bounds
        }
        if scale.has_window and not scale.has_duration:
            values["duration_s"] = magnitude
        target = parse_choice(f"{where}.target", document["target"], Target)
        return cls(type=kind, target=target, magnitude=magnitude, **values)

    @property
    def severity(self) -> float:
        """The severity of the error; 0 has no effect."""
        return MAGNITUDES[self.type].severity(self.magnitude)

    @property
    def words(self) -> str:
        """The error in words, such as ``the vehicle ahead is not perceived for 1.3 s from 4.2 s on``."""
        parts = [self.words_with(MAGNITUDES[self.type].words(self.magnitude))]
        if MAGNITUDES[self.type].has_window:
            parts.append(f"from {self.onset_s:.1f} s on")
        if MAGNITUDES[self.type].has_duration:
            parts.append(f"for {self.duration_s:.1f} s")
        return " ".join(parts)

    def words_with(self, magnitude: str) -> str:
        """Describe the error with the given magnitude and without the window."""
        much = _PERCEIVES[self.type].format(much=magnitude)
        if self.type is ErrorType.GHOST:
            place = _GHOST_PLACES[self.target].format(at=f"{self.distance_m:.0f} m")
            return f"a vehicle that is not there {much} {place}"
        who = _SINGLE[self.target] if MAGNITUDES[self.type].has_window else _EVERY[self.target]
        if self.type is ErrorType.MISS and self.target is Target.ALL:
            return f"no vehicle {much.replace('not ', '', 1)}"
        return f"{who} {much}"


_SINGLE: Final = {
    Target.AHEAD: "the vehicle ahead",
    Target.LEFT: "the vehicle in the lane to the left",
    Target.RIGHT: "the vehicle in the lane to the right",
    Target.CROSSING: "the nearest crossing vehicle",
    Target.ALL: "every vehicle",
}
_EVERY: Final = {
    **_SINGLE,
    Target.LEFT: "any vehicle in the lane to the left",
    Target.RIGHT: "any vehicle in the lane to the right",
    Target.CROSSING: "any crossing vehicle",
}
_GHOST_PLACES: Final = {
    Target.AHEAD: "{at} ahead",
    Target.LEFT: "{at} ahead in the lane to the left",
    Target.RIGHT: "{at} ahead in the lane to the right",
    Target.CROSSING: "{at} ahead, crossing from the right",
    Target.ALL: "{at} ahead",
}
_PERCEIVES: Final = {
    ErrorType.MISS: "is not perceived for {much}",
    ErrorType.LATE: "is first perceived {much} late",
    ErrorType.SHORT_RANGE: "is perceived only within {much}",
    ErrorType.GHOST: "is perceived for {much}",
    ErrorType.TOO_FAR: "is perceived {much} too far away",
    ErrorType.TOO_FAST: "is perceived {much} too fast",
    ErrorType.POSITION_NOISE: "is perceived with a position noise of {much}",
    ErrorType.SPEED_NOISE: "is perceived with a speed noise of {much}",
}


def fields_of(kind: ErrorType) -> tuple[str, ...]:
    """Return the fields that an error of a type has."""
    scale = MAGNITUDES[kind]
    return (
        "type",
        "target",
        "magnitude",
        *(("onset_s",) if scale.has_window else ()),
        *(("duration_s",) if scale.has_duration else ()),
        *(("distance_m",) if kind is ErrorType.GHOST else ()),
    )


def errors_from_json(behaviour: Mapping[str, Json], duration_s: float) -> tuple[PerceptionError, ...]:
    """Parse the errors of a behaviour.

    Raises:
        InvalidEpisode: A field is missing, unknown or out of range.
    """
    check_fields("behaviour", behaviour, ("mode", "errors"))
    if behaviour["mode"] != MODE:
        raise InvalidEpisode(f"behaviour.mode: expected {MODE}, got {behaviour['mode']!r}")
    listed = behaviour["errors"]
    if not isinstance(listed, list) or len(listed) > MAX_ERRORS:
        raise InvalidEpisode(f"behaviour.errors: expected a list of at most {MAX_ERRORS}, got {listed!r:.80}")
    return tuple(
        PerceptionError.from_json(f"behaviour.errors[{index}]", document, duration_s)
        for index, document in enumerate(listed)
    )


def words_of_errors(errors: tuple[PerceptionError, ...]) -> str:
    """Return errors in words."""
    return " and ".join(error.words for error in errors) or "no error"
