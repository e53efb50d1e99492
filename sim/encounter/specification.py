"""The specification of an encounter: the place, the scripts of the road users, and their descriptions.

A script consists of stretches of motion along and across the road. Stations run along the centre line of the ego's
first lane from 0 at the ego's initial centre; offsets are to the left of it. This module has no heavy imports.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Self

from brink.sim.episode import Json, JsonObject, check_fields, nearest
from brink.sim.errors import InvalidEpisode
from brink.sim.world.road import PARKING_STRIP_M, build_road
from brink.sim.world.scenario import SCENARIO_CHOICES, UrbanScenario

REFERENCE: Final = "reference"
"""The mode of behaviours that name a reference driver, and the option that compares violations with theirs."""
MAX_ROAD_USERS: Final = 6
MAX_STRETCHES: Final = 64
_MAX_DISTANCE_M: Final = 2_000.0
_RANGES: Final[Mapping[str, tuple[float, float]]] = {
    "from_s": (0.0, 600.0),
    "lasts_s": (0.0, 600.0),
    "s_m": (-_MAX_DISTANCE_M, _MAX_DISTANCE_M),
    "d_m": (-_MAX_DISTANCE_M, _MAX_DISTANCE_M),
    "heading_rad": (-math.pi, math.pi),
    "speed_mps": (0.0, 40.0),
    "accel_mps2": (-12.0, 12.0),
    "aside_m": (-10.0, 10.0),
}


class Kind(StrEnum):
    """Kind of road user."""

    CAR = "car"
    VAN = "van"
    PEDESTRIAN = "pedestrian"


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """A section of a script: motion with constant acceleration and one smooth lateral shift.

    Attributes:
        action: Name of the manoeuvre.
        from_s: Start time.
        lasts_s: Duration.
        s_m: Station at the start.
        d_m: Offset at the start.
        heading_rad: Direction of travel relative to the road, without the lateral shift.
        speed_mps: Speed at the start.
        accel_mps2: Acceleration.
        aside_m: Lateral shift to the road user's own left.
    """

    action: str
    from_s: float
    lasts_s: float
    s_m: float
    d_m: float
    heading_rad: float
    speed_mps: float
    accel_mps2: float
    aside_m: float

    def at(self, time_s: float) -> tuple[float, float, float, float]:
        """Return station, offset, heading and speed at a time in the script; beyond its end the motion continues."""
        t = time_s - self.from_s
        within_s = min(max(t, 0.0), self.lasts_s)
        along_m = (self.speed_mps + 0.5 * self.accel_mps2 * within_s) * within_s
        speed = max(0.0, self.speed_mps + self.accel_mps2 * within_s)
        along_m += speed * max(0.0, t - self.lasts_s)
        share = within_s / self.lasts_s if self.lasts_s > 0 else 1.0
        left_m = self.aside_m * share * share * (3.0 - 2.0 * share)
        turn = 0.0
        if self.aside_m and speed > 0.1 and self.lasts_s > 0:
            turn = math.atan2(self.aside_m * 6.0 * share * (1.0 - share) / self.lasts_s, speed)
        cos_yaw, sin_yaw = math.cos(self.heading_rad), math.sin(self.heading_rad)
        return (
            self.s_m + along_m * cos_yaw - left_m * sin_yaw,
            self.d_m + along_m * sin_yaw + left_m * cos_yaw,
            self.heading_rad + turn,
            speed,
        )

    @classmethod
    def from_json(cls, where: str, document: Json) -> "Stretch":
        """Read a stretch from a JSON object.

        Raises:
            InvalidEpisode: A field is missing, unknown or out of range.
        """
        if not isinstance(document, dict):
            raise InvalidEpisode(f"{where}: expected an object, got {document!r:.80}")
        check_fields(where, document, ("action", *_RANGES))
        action = document["action"]
        if not isinstance(action, str) or not 0 < len(action) <= 40:
            raise InvalidEpisode(f"{where}.action: expected a name of 1 to 40 characters, got {action!r:.80}")
        numbers = {}
        for name, (low, high) in _RANGES.items():
            value = document[name]
            if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
                raise InvalidEpisode(
                    f"{where}.{name}: expected a number in [{low:g}, {high:g}], got {value!r:.80}"
                )
            numbers[name] = float(value)
        return cls(action=action, **numbers)


@dataclass(frozen=True, slots=True, kw_only=True)
class Script:
    """The motion of one road user.

    Attributes:
        kind: Kind of road user.
        stretches: At least one, in order of time, the first from time 0.
    """

    kind: Kind
    stretches: tuple[Stretch, ...]

    def stretch_at(self, time_s: float) -> Stretch:
        """Return the stretch at a time."""
        for stretch in self.stretches:
            if time_s < stretch.from_s + stretch.lasts_s:
                return stretch
        return self.stretches[-1]

    @classmethod
    def from_json(cls, where: str, document: Json) -> "Script":
        """Read a script from a JSON object.

        Raises:
            InvalidEpisode: A field is missing, unknown or out of range.
        """
        if not isinstance(document, dict):
            raise InvalidEpisode(f"{where}: expected an object, got {document!r:.80}")
        check_fields(where, document, ("kind", "stretches"))
        kind, items = document["kind"], document["stretches"]
        known = tuple(item.value for item in Kind)
        if not isinstance(kind, str) or kind not in known:
            raise InvalidEpisode(
                f"{where}.kind: expected one of {', '.join(known)}; got {kind!r}{nearest(kind, known)}"
            )
        if not isinstance(items, list) or not 1 <= len(items) <= MAX_STRETCHES:
            raise InvalidEpisode(
                f"{where}.stretches: expected a list of 1 to {MAX_STRETCHES} items, got {items!r:.80}"
            )
        stretches = tuple(
            Stretch.from_json(f"{where}.stretches[{index}]", item) for index, item in enumerate(items)
        )
        begins = [stretch.from_s for stretch in stretches]
        if begins[0] != 0.0 or begins != sorted(begins):
            raise InvalidEpisode(
                f"{where}.stretches: expected start times (from_s) in ascending order, the first 0"
            )
        return cls(kind=Kind(kind), stretches=stretches)


def scripts_from_json(document: Json) -> tuple[Script, ...]:
    """Read the scripts of all road users.

    Raises:
        InvalidEpisode: There are too many scripts, or one is invalid.
    """
    if not isinstance(document, list) or len(document) > MAX_ROAD_USERS:
        raise InvalidEpisode(
            f"scenario.road_users: expected a list of at most {MAX_ROAD_USERS} road users, got {document!r:.80}"
        )
    return tuple(
        Script.from_json(f"scenario.road_users[{index}]", item) for index, item in enumerate(document)
    )


def stretch_to_json(fields: Mapping[str, float], action: str) -> JsonObject:
    """Return a stretch as a JSON object of a specification."""
    return {"action": action, **{name: fields[name] for name in _RANGES}}


PLACE_FIELDS: Final = tuple(name for name in SCENARIO_CHOICES if name != "pedestrians")
"""Fields of a place: the urban scenario's parameters except the number of pedestrians."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EncounterScenario:
    """The place and the scripted road users.

    Attributes:
        place: Road, task, time of day, weather.
        road_users: Scripts of all other road users.
    """

    place: UrbanScenario
    road_users: tuple[Script, ...]

    @classmethod
    def from_json(cls, document: Mapping[str, Json]) -> Self:
        """Read a scenario from a JSON object.

        Raises:
            InvalidEpisode: A field is missing, unknown or invalid.
        """
        if "road_users" not in document:
            raise InvalidEpisode(
                f"scenario.road_users: missing; expected {', '.join((*PLACE_FIELDS, 'road_users'))}"
            )
        if "pedestrians" in document:
            raise InvalidEpisode(
                "scenario: unknown field 'pedestrians'; list people as road_users of kind 'pedestrian'"
            )
        place = {name: value for name, value in document.items() if name != "road_users"}
        return cls(
            place=UrbanScenario.from_json({**place, "pedestrians": 0}),
            road_users=scripts_from_json(document["road_users"]),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class LaneLayout:
    """The geometry of a road that scripts depend on. Offsets start at the middle of the ego's first lane.

    Attributes:
        lane_width_m: Width of each of the two lanes; the oncoming lane is on the left.
        strip_m: Width of the parking strip between lane and kerb.
        pavement_m: Width of each pavement.
        crossing_streets_m: Stations of the centres of streets that cross the road.
    """

    lane_width_m: float
    strip_m: float
    pavement_m: float
    crossing_streets_m: tuple[float, ...]


def get_lane_layout(place: UrbanScenario) -> LaneLayout:
    """Return the lane layout of a place."""
    road = build_road(place.road_curve, place.road_id, place.road_length)
    return LaneLayout(
        lane_width_m=road.style.lane_width_m,
        strip_m=PARKING_STRIP_M if road.style.parking else 0.0,
        pavement_m=road.style.pavement_m,
        crossing_streets_m=tuple(j.forward_m for j in road.junctions if j.left and j.right),
    )


ACTION_WORDS: Final[Mapping[str, str]] = {
    "keep": "keeps going",
    "accelerate": "accelerates",
    "decelerate": "slows down",
    "brake": "brakes hard",
    "change_left": "moves to its left",
    "change_right": "moves to its right",
    "cut_in": "cuts in",
    "cross": "crosses the road",
}
_MAX_ACTIONS: Final = 3


def describe_script(script: Mapping[str, Json]) -> str:
    """Describe a script: where the road user starts and what it does, except for keeping its speed."""
    stretches = script["stretches"]
    assert isinstance(stretches, list)
    steps = [stretch for stretch in stretches if isinstance(stretch, Mapping)]
    telling = dict.fromkeys(str(step["action"]) for step in steps if step["action"] != "keep")
    acts = [ACTION_WORDS.get(action, action.replace("_", " ")) for action in telling]
    shown = ", ".join(acts[:_MAX_ACTIONS]) or "keeps going"
    return f"{script['kind']} {_start(steps[0])}: {shown}{', …' if len(acts) > _MAX_ACTIONS else ''}"


def _start(first: Mapping[str, Json]) -> str:
    s_m, d_m, heading = (float(str(first[name])) for name in ("s_m", "d_m", "heading_rad"))
    along = f"{abs(s_m):.0f} m {'ahead' if s_m >= 0 else 'behind'}"
    side = "" if abs(d_m) < 1.0 else f", {abs(d_m):.1f} m to the {'left' if d_m > 0 else 'right'}"
    speed = float(str(first["speed_mps"]))
    comes = ""
    if math.cos(heading) < -0.5:
        comes = ", oncoming"
    elif abs(math.sin(heading)) > 0.5:
        comes = ", crossing"
    return f"{along}{side}{comes} at {speed:.0f} m/s"
