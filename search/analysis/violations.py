"""Violations with their types, and the number of distinct instances of a type.

The rules give a violation a type from the circumstances at the moment it happened. A type is a signature of six
words; violations with equal signatures have the same type. The authors of muMOEA assigned types by hand, by root
cause; these rules are automatic, and coarser in some places and finer in others. Circumstances are stored, so types
can be recomputed when the rules change (`RULES_VERSION`), and a person can override a type.

Whether a reference driver would have avoided a violation is measured by the simulator
(`brink.search.analysis.avoidable`). Whether the ego was at fault is decided by a rule of thumb.

Distinct instances of a type are clusters of scaled circumstances, found with DBSCAN.

Source: Ester, Kriegel, Sander, Xu, "A density-based algorithm for discovering clusters in large spatial databases
with noise" (DBSCAN), KDD 1996.
"""

import logging
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from typing import Any, Final

import numpy as np

from brink.search.analysis.avoidable import Avoidable, AvoidedBy, avoidable_of, avoided_by_of
from brink.search.space import FloatArray, IntArray

RULES_VERSION: Final = 4
NOTHING: Final = "nothing"

SECTORS: Final = ("front", "front left", "left", "rear left", "rear", "rear right", "right", "front right")
"""Sectors around the ego, counter-clockwise, 45 degrees each; ``front`` is centred straight ahead."""

NEIGHBOURS: Final = 3
"""Minimum number of points in a dense neighbourhood (min_samples), including the point itself."""

REACH: Final = 1.0
"""Maximum distance between neighbours (eps), in scaled circumstances."""

STANDS_MPS: Final = 0.3
"""Below this speed, the ego and others stand."""
_BRAKES_MPS2: Final = -1.5
_ACCELERATES_MPS2: Final = 1.0
_TURNS_RADPS: Final = 0.1
_SURPRISE_S: Final = 1.0
"""A counterpart that has been in the ego's way for less than this before a collision left no time to brake."""

_TAILGATES_S: Final = 1.5
"""Too small a gap is the ego's own fault once the counterpart has been ahead for this long."""

_FRONT_GAP: Final = ("front-gap@1", "front-gap@2")
_ALONE: Final = ("red-light@1", "speed-limit@1")
"""Requirements that the ego violates on its own, regardless of others nearby."""

_HAPPENED: Final[Mapping[str, tuple[str, str]]] = {
    "no-collision": ("collision", "collision with"),
    "front-gap": ("too close", "too close to"),
    "lane-keeping": ("lane left", "lane left beside"),
    "progress": ("stuck", "blocked by"),
    "red-light": ("red light run", "red light run beside"),
    "speed-limit": ("too fast", "too fast beside"),
}
"""What the violation of a requirement is, without a counterpart and before one."""
_PASSING: Final = {"overtake": "overtaking", "nudge": "nudging around"}
_CLASSES: Final = {"car": "vehicle", "van": "vehicle", "pedestrian": "pedestrian"}

_SPEED_MPS, _TURN_RAD, _WAY_M = 3.0, 0.5, 10.0
"""Differences in circumstances that count as one unit of distance."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Signature:
    """A type of violation.

    Attributes:
        requirement: The violated requirement.
        counterpart: What else was involved: vehicle, pedestrian, object, or nothing.
        sector: Sector of the ego in which the counterpart was.
        ego: What the ego was doing.
        other: What the counterpart was doing.
        place: The part of the road.
    """

    requirement: str
    counterpart: str
    sector: str
    ego: str
    other: str
    place: str

    def __str__(self) -> str:
        name = self.requirement.partition("@")[0]
        happened, happened_with = _HAPPENED.get(name, (f"{name} violated", f"{name} violated beside"))
        if self.counterpart != NOTHING:
            article = "an" if self.counterpart[0] in "aeiou" else "a"
            happened = f"{happened_with} {article} {self.counterpart}"
        if self.sector != NOTHING:
            happened += f" at the {self.sector} ({self.other})"
        return f"{happened}, ego {self.ego}, {self.place}"

    def to_json(self) -> dict[str, str]:
        """Return the signature as a JSON object."""
        return {field.name: value for field, value in zip(fields(self), astuple(self), strict=True)}


def signature_of(violation: Mapping[str, Any]) -> Signature:
    """Return the type of a violation.

    Args:
        violation: Its circumstances, as reported by the encounter simulators.

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
            _manoeuvre_of_other(other),
        )
    elif violation["collision"] is not None:
        counterpart = violation["collision"]
    return Signature(
        requirement=requirement,
        counterpart=counterpart,
        sector=sector,
        ego=_manoeuvre_of_ego(ego),
        other=doing,
        place=violation["place"]["element"],
    )


def niche_of(violation: Mapping[str, Any]) -> tuple[str, ...] | None:
    """Return the niche of a violation or of a closest approach: sector, other's action, ego's manoeuvre, place.

    Args:
        violation: Its circumstances.

    Returns:
        The niche; None if a circumstance is missing or malformed.
    """
    try:
        signature = signature_of(violation)
    except (LookupError, TypeError, ValueError) as error:
        log.warning("ignored invalid circumstances: %r", error)
        return None
    return signature.sector, signature.other, signature.ego, signature.place


def is_at_fault(violation: Mapping[str, Any]) -> bool:
    """Return whether the ego was at fault by a rule of thumb.

    It is at fault if it moved, was not hit from behind, and had the counterpart in its way for at least a second, or
    was overtaking or squeezing past.

    Args:
        violation: Its circumstances, as reported by the encounter simulators.

    Raises:
        KeyError: A circumstance is missing.
    """
    requirement, other = violation["requirement"], violation["other"]
    involved = other is not None and requirement not in _ALONE
    return _at_fault(requirement, violation["ego"], other if involved else None)


def kinds_of(violations: Iterable[Mapping[str, Any]]) -> frozenset[str]:
    """Return the types of violations in words, ignoring those with missing circumstances."""
    kinds = set()
    for violation in violations:
        try:
            kinds.add(str(signature_of(violation)))
        except (LookupError, TypeError, ValueError) as error:
            log.warning("ignored a violation with invalid circumstances: %r", error)
    return frozenset(kinds)


def sector_of(bearing_rad: float) -> str:
    """Return the sector of the ego in which a bearing lies."""
    return SECTORS[round(bearing_rad / (0.25 * math.pi)) % len(SECTORS)]


def _manoeuvre_of_ego(ego: Mapping[str, Any]) -> str:
    if abs(ego["speed_mps"]) < STANDS_MPS:
        return "standing"
    if ego["plan"] in _PASSING:
        return _PASSING[ego["plan"]]
    if ego["accel_mps2"] < _BRAKES_MPS2:
        return "braking"
    if abs(ego["yaw_rate_radps"]) > _TURNS_RADPS:
        return "turning left" if ego["yaw_rate_radps"] > 0 else "turning right"
    return "accelerating" if ego["accel_mps2"] > _ACCELERATES_MPS2 else "driving"


def _manoeuvre_of_other(other: Mapping[str, Any]) -> str:
    if other["speed_mps"] < STANDS_MPS:
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
    if abs(ego["speed_mps"]) < STANDS_MPS or sector_of(other["bearing_rad"]).startswith("rear"):
        return False
    if requirement in _FRONT_GAP:
        return bool(other["in_way_s"] >= _TAILGATES_S)
    return ego["plan"] in _PASSING or bool(other["in_way_s"] >= _SURPRISE_S)


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundViolation:
    """One violation of one solution.

    Attributes:
        number: Number of the solution.
        circumstances: Circumstances reported by the simulator.
        signature: Type according to the rules.
        name: Type assigned by a person, or None.
    """

    number: int
    circumstances: Mapping[str, Any]
    signature: Signature
    name: str | None

    @property
    def type(self) -> str:
        """The type in words."""
        return self.name or str(self.signature)

    @property
    def avoidable(self) -> Avoidable | None:
        """Who would have avoided it; None if that was not measured."""
        return avoidable_of(self.circumstances)

    @property
    def avoided_by(self) -> AvoidedBy | None:
        """How its driver avoids it; None if none does, or that was not recorded."""
        return avoided_by_of(self.circumstances)


@dataclass(frozen=True, slots=True, kw_only=True)
class ViolationType:
    """All violations of one type.

    Attributes:
        words: The type.
        violations: The violations, ascending by number.
    """

    words: str
    violations: tuple[FoundViolation, ...]

    @property
    def avoidable(self) -> Avoidable | None:
        """The best value among its violations; None if it was measured for none of them."""
        kinds = {violation.avoidable for violation in self.violations}
        return next((kind for kind in Avoidable if kind in kinds), None)

    @property
    def avoided_by(self) -> AvoidedBy | None:
        """How the best driver avoids its violations: by braking if that avoids any; None if that was not recorded."""
        kinds = {
            violation.avoided_by for violation in self.violations if violation.avoidable is self.avoidable
        }
        return next((one for one in AvoidedBy if one in kinds), None)

    @property
    def instances(self) -> int:
        """Number of distinct instances."""
        return instances([violation.circumstances for violation in self.violations])


def by_type(found: Sequence[FoundViolation]) -> list[ViolationType]:
    """Return violations grouped by type, in the order of discovery."""
    types: dict[str, list[FoundViolation]] = {}
    for violation in found:
        types.setdefault(violation.type, []).append(violation)
    return [ViolationType(words=words, violations=tuple(its)) for words, its in types.items()]


def scaled_circumstances(violation: Mapping[str, Any]) -> list[float]:
    """Return speeds, directions and position of a violation, scaled to comparable units."""
    ego, other = violation["ego"], violation["other"]
    numbers = [ego["speed_mps"] / _SPEED_MPS, violation["place"]["station_m"] / _WAY_M]
    if other is None:
        return [*numbers, 0.0, 0.0, 0.0, 0.0, 0.0]
    bearing, heading = other["bearing_rad"], other["heading_rad"]
    return [
        *numbers,
        other["speed_mps"] / _SPEED_MPS,
        math.cos(bearing) / _TURN_RAD,
        math.sin(bearing) / _TURN_RAD,
        math.cos(heading) / _TURN_RAD,
        math.sin(heading) / _TURN_RAD,
    ]


def dbscan(points: FloatArray, reach: float = REACH, neighbours: int = NEIGHBOURS) -> IntArray:
    """Return the cluster of each point, counted from 0; -1 for noise.

    Args:
        points: Shape ``(n, d)``.
        reach: Maximum distance between neighbours (eps).
        neighbours: Neighbours that make a point a core point, including itself (min_samples).

    Returns:
        Cluster numbers, shape ``(n,)``.
    """
    from scipy.sparse import csr_array  # slow to import
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    count = len(points)
    labels = np.full(count, -1, np.int64)
    if not count:
        return labels
    pairs = cKDTree(points).query_pairs(reach, output_type="ndarray").astype(np.int64)
    core = 1 + np.bincount(pairs.ravel(), minlength=count) >= neighbours
    links = pairs[core[pairs].all(axis=1)]
    graph = csr_array((np.ones(len(links), np.int8), (links[:, 0], links[:, 1])), shape=(count, count))
    component = connected_components(graph, directed=False)[1]
    numbers: dict[int, int] = {}
    for point in np.flatnonzero(core).tolist():
        labels[point] = numbers.setdefault(int(component[point]), len(numbers))
    for first, second in pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))].tolist():
        for border, inner in ((first, second), (second, first)):
            if core[inner] and not core[border] and labels[border] < 0:
                labels[border] = labels[inner]
    return labels


def instances(violations: Sequence[Mapping[str, Any]]) -> int:
    """Return the number of distinct instances among violations of one type: clusters plus unclustered ones."""
    labels = dbscan(np.array([scaled_circumstances(violation) for violation in violations]))
    return int(labels.max(initial=-1) + 1 + np.count_nonzero(labels < 0))
