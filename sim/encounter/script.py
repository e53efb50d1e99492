"""Owns what a scripted road user does, as specifications have it: stretches of motion along and across a road.

Stations run along the centre line of the ego's first lane, 0 where the ego's middle starts; offsets run to its left.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from brink.sim.episode import Json, JsonObject, check_fields, nearest
from brink.sim.errors import InvalidEpisode

MOST_ROAD_USERS: Final = 6
MOST_STRETCHES: Final = 64
_FARTHEST_M: Final = 2_000.0
_RANGES: Final[Mapping[str, tuple[float, float]]] = {
    "from_s": (0.0, 600.0),
    "lasts_s": (0.0, 600.0),
    "s_m": (-_FARTHEST_M, _FARTHEST_M),
    "d_m": (-_FARTHEST_M, _FARTHEST_M),
    "heading_rad": (-math.pi, math.pi),
    "speed_mps": (0.0, 40.0),
    "accel_mps2": (-12.0, 12.0),
    "aside_m": (-10.0, 10.0),
}


class Kind(StrEnum):
    """What a road user is."""

    CAR = "car"
    VAN = "van"
    PEDESTRIAN = "pedestrian"


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """Motion with a constant acceleration and one smooth step aside.

    Attributes:
        action: What the road user means by it, in a word.
        from_s: When it begins.
        lasts_s: How long it takes.
        s_m: Station at its beginning.
        d_m: Offset at its beginning.
        heading_rad: Direction of travel relative to the road, but for the step aside.
        speed_mps: Speed at its beginning.
        accel_mps2: Acceleration.
        aside_m: How far it goes to its own left meanwhile.
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
        """Return station, offset, heading and speed at a time of the script; beyond its end it goes on as it is."""
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
            InvalidEpisode: A field is missing, unknown, or out of range.
        """
        if not isinstance(document, dict):
            raise InvalidEpisode(f"{where}: expected an object, got {document!r:.80}")
        check_fields(where, document, ("action", *_RANGES))
        action = document["action"]
        if not isinstance(action, str) or not 0 < len(action) <= 40:
            raise InvalidEpisode(f"{where}.action: expected a word, got {action!r:.80}")
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
    """What one road user does.

    Attributes:
        kind: What it is.
        stretches: One after the other, the first from time 0; at least one.
    """

    kind: Kind
    stretches: tuple[Stretch, ...]

    def stretch_at(self, time_s: float) -> Stretch:
        """Return what it does at a time."""
        for stretch in self.stretches:
            if time_s < stretch.from_s + stretch.lasts_s:
                return stretch
        return self.stretches[-1]

    @classmethod
    def from_json(cls, where: str, document: Json) -> "Script":
        """Read a script from a JSON object.

        Raises:
            InvalidEpisode: A field is missing, unknown, or out of range.
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
        if not isinstance(items, list) or not 1 <= len(items) <= MOST_STRETCHES:
            raise InvalidEpisode(
                f"{where}.stretches: expected a list of 1 to {MOST_STRETCHES}, got {items!r:.80}"
            )
        stretches = tuple(
            Stretch.from_json(f"{where}.stretches[{index}]", item) for index, item in enumerate(items)
        )
        begins = [stretch.from_s for stretch in stretches]
        if begins[0] != 0.0 or begins != sorted(begins):
            raise InvalidEpisode(f"{where}.stretches: expected them in order of time, the first from 0")
        return cls(kind=Kind(kind), stretches=stretches)


def scripts_from_json(document: Json) -> tuple[Script, ...]:
    """Read the scripts of all road users.

    Raises:
        InvalidEpisode: There are too many, or one is wrong.
    """
    if not isinstance(document, list) or len(document) > MOST_ROAD_USERS:
        raise InvalidEpisode(
            f"scenario.road_users: expected a list of at most {MOST_ROAD_USERS}, got {document!r:.80}"
        )
    return tuple(
        Script.from_json(f"scenario.road_users[{index}]", item) for index, item in enumerate(document)
    )


def stretch_json(fields: Mapping[str, float], action: str) -> JsonObject:
    """Return a stretch as specifications have it."""
    return {"action": action, **{name: fields[name] for name in _RANGES}}
