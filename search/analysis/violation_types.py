"""The rules that give a violation its type, from the circumstances of the moment at which it happened.

A type is a signature of seven words; two violations with the same signature are of one type. The authors of muMOEA
typed theirs by hand, by root cause; ours is automatic, and coarser in some places and finer in others. Circumstances
are stored, so that types can be made again when the rules change (`RULES_VERSION`), and a person can overrule one.
"""

import logging
import math
from collections.abc import Iterable, Mapping
from dataclasses import astuple, dataclass, fields
from typing import Any, Final

RULES_VERSION: Final = 2
NOTHING: Final = "nothing"

SECTORS: Final = ("front", "front left", "left", "rear left", "rear", "rear right", "right", "front right")
"""Of the ego, counter-clockwise, each an eighth of the way round; its corners are the middles of four of them."""

_STANDS_MPS: Final = 0.3
_BRAKES_MPS2: Final = -1.5
_ACCELERATES_MPS2: Final = 1.0
_TURNS_RADPS: Final = 0.1
_SURPRISE_S: Final = 1.0
"""Who came into the ego's way later than this before a collision left no time to brake."""

_TAILGATES_S: Final = 1.5
"""A gap that is too small to somebody who has been ahead for longer than this is the ego's own doing."""

_ALONE: Final = ("red-light@1", "speed-limit@1")
"""Requirements that the ego violates by itself, whoever is near."""

_PASSING: Final = ("overtake", "nudge")
log = logging.getLogger(__name__)

_CLASSES: Final = {"car": "vehicle", "van": "vehicle", "pedestrian": "pedestrian"}


@dataclass(frozen=True, slots=True)
class Signature:
    """A type of violation.

    Attributes:
        requirement: What was violated.
        counterpart: What else was involved: vehicle, pedestrian, object, or nothing.
        sector: Where that was, of the ego.
        ego: What the ego was doing.
        other: What the counterpart was doing.
        place: On what part of the road.
        at_fault: Whether a good driver in the ego's place would have avoided it: ``at fault`` or ``not at fault``.
    """

    requirement: str
    counterpart: str
    sector: str
    ego: str
    other: str
    place: str
    at_fault: str

    def __str__(self) -> str:
        who = (
            ""
            if self.counterpart == NOTHING
            else f" with {self.counterpart} at the {self.sector} ({self.other})"
        )
        return f"{self.requirement.partition('@')[0]}{who}, ego {self.ego}, {self.place}, {self.at_fault}"

    def to_json(self) -> dict[str, str]:
        """Return it as a JSON object."""
        return {field.name: value for field, value in zip(fields(self), astuple(self), strict=True)}


def signature_of(violation: Mapping[str, Any]) -> Signature:
    """Return the type of a violation.

    Args:
        violation: Its circumstances, as the simulator of encounters reports them.

    Raises:
        KeyError: A circumstance is missing.
    """
    requirement, ego, other = violation["requirement"], violation["ego"], violation["other"]
    involved = other is not None and requirement not in _ALONE
    counterpart, sector, doing = NOTHING, NOTHING, NOTHING
    if involved:
        counterpart, sector, doing = (
            _CLASSES[other["kind"]],
            sector_of(other["bearing_rad"]),
            _of_other(other),
        )
    elif violation["collision"] is not None:
        counterpart = violation["collision"]
    return Signature(
        requirement=requirement,
        counterpart=counterpart,
        sector=sector,
        ego=_of_ego(ego),
        other=doing,
        place=violation["place"]["element"],
        at_fault="at fault" if _at_fault(requirement, ego, other if involved else None) else "not at fault",
    )


def kinds_of(violations: Iterable[Mapping[str, Any]]) -> frozenset[str]:
    """Return the types of violations in words; one that lacks a circumstance has none."""
    kinds = set()
    for violation in violations:
        try:
            kinds.add(str(signature_of(violation)))
        except (LookupError, TypeError, ValueError) as error:
            log.warning("a violation that cannot be read, and so has no type: %r", error)
    return frozenset(kinds)


def sector_of(bearing_rad: float) -> str:
    """Return in which sector of the ego a bearing lies."""
    return SECTORS[round(bearing_rad / (0.25 * math.pi)) % len(SECTORS)]


def _of_ego(ego: Mapping[str, Any]) -> str:
    if abs(ego["speed_mps"]) < _STANDS_MPS:
        return "standing"
    if ego["plan"] in _PASSING:
        return {"overtake": "overtaking", "nudge": "nudging around"}[ego["plan"]]
    if ego["accel_mps2"] < _BRAKES_MPS2:
        return "braking"
    if abs(ego["yaw_rate_radps"]) > _TURNS_RADPS:
        return "turning left" if ego["yaw_rate_radps"] > 0 else "turning right"
    return "accelerating" if ego["accel_mps2"] > _ACCELERATES_MPS2 else "driving"


def _of_other(other: Mapping[str, Any]) -> str:
    if other["speed_mps"] < _STANDS_MPS:
        return "standing"
    action = str(other["action"]).replace("_", " ")
    if other["kind"] == "pedestrian":
        return action
    along = math.cos(other["heading_rad"])
    direction = "same way" if along > 0.7 else "oncoming" if along < -0.7 else "across"
    return f"{direction}, {action}"


def _at_fault(requirement: str, ego: Mapping[str, Any], other: Mapping[str, Any] | None) -> bool:
    if requirement == "progress@1":
        return other is None
    if other is None or requirement == "lane-keeping@1":
        return True
    if abs(ego["speed_mps"]) < _STANDS_MPS or sector_of(other["bearing_rad"]).startswith("rear"):
        return False
    if requirement == "front-gap@1":
        return bool(other["in_way_s"] >= _TAILGATES_S)
    return ego["plan"] in _PASSING or bool(other["in_way_s"] >= _SURPRISE_S)
