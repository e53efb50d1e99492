"""The verdict of an episode in words: which requirements decide it, and every other one that was violated.

A campaign's verdict, safe or unsafe, is about the requirements that the campaign chose. An episode that holds these
may still violate another one, for example keep its distance to the car ahead and hit a pedestrian. Texts for people
therefore name the requirement: ``front gap held; hit a pedestrian at 12.8 s``.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol, Self

from brink.sim.requirements import CollisionKind

MOST_NAMED: Final = 3
"""More requirements than this are counted instead of named."""

_HELD: Final = {
    "front-gap": ("front gap held", "held the front gap"),
    "no-collision": ("no collision", "had no collision"),
    "lane-keeping": ("lane kept", "kept the lane"),
    "red-light": ("no red light run", "ran no red light"),
    "speed-limit": ("speed limit kept", "kept the speed limit"),
    "progress": ("no long standstill", "had no long standstill"),
    "no-dangerous-stop": ("no dangerous stop", "made no dangerous stop"),
    "survival": ("survived", "survived"),
    "margin": ("margin held", "held the margin"),
    "function": ("requirement held", "held the requirement"),
}
"""What a requirement that held is called, alone and after the word drives, by id without version."""
_VIOLATED: Final = {
    "front-gap": ("violated the front gap", "violate the front gap"),
    "no-collision": ("had a collision", "collide"),
    "lane-keeping": ("left the lane", "leave the lane"),
    "red-light": ("ran a red light", "run a red light"),
    "speed-limit": ("exceeded the speed limit", "exceed the speed limit"),
    "progress": ("stood still too long", "stand still too long"),
    "no-dangerous-stop": ("made a dangerous stop", "make a dangerous stop"),
    "survival": ("ended too early", "end too early"),
    "margin": ("violated the margin", "violate the margin"),
    "function": ("violated the requirement", "violate the requirement"),
}
"""What a drive did that violated a requirement, and what such drives do."""
_COLLIDED: Final = {
    CollisionKind.VEHICLE: "hit a vehicle",
    CollisionKind.PEDESTRIAN: "hit a pedestrian",
    CollisionKind.OBJECT: "hit an object",
}


_FRONT_RAD: Final = math.pi / 4 + 1e-6
"""Half of the ego's front and rear as seen from its centre, with its body scaled to a square."""
_MIDDLE_RAD: Final = math.pi / 12
_CORNER_RAD: Final = math.pi / 12
"""Who comes from the side and touches the ego this close to a rear corner runs into its side."""
_MOVES_MPS: Final = 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class Impact:
    """How the ego and another road user collided.

    Attributes:
        place: Part of the ego that was touched, such as ``front``, ``left side`` or ``right rear``.
        by_other: Whether the other road user ran into the ego: into its side or rear, and moving towards it.
        on_foot: Whether the other road user is a pedestrian.
    """

    place: str
    by_other: bool
    on_foot: bool

    @classmethod
    def of(
        cls, *, bearing_rad: float, heading_rad: float, speed_mps: float, ego_mps: float, on_foot: bool
    ) -> Self:
        """Return how the ego and another road user collided.

        Args:
            bearing_rad: Direction of the other's nearest point, with the ego's body scaled to a square.
            heading_rad: The other's heading relative to the ego's.
            speed_mps: The other's speed.
            ego_mps: The ego's speed.
            on_foot: Whether the other road user is a pedestrian.
        """
        off_rad = abs(bearing_rad)
        side = 1.0 if bearing_rad > 0 else -1.0
        sideways_mps = -side * speed_mps * math.sin(heading_rad)
        if off_rad <= _FRONT_RAD:
            return cls(place="front", by_other=False, on_foot=on_foot)
        at_corner = off_rad < math.pi - _FRONT_RAD + _CORNER_RAD and sideways_mps > _MOVES_MPS
        if off_rad >= math.pi - _FRONT_RAD and not at_corner:
            towards_mps = speed_mps * math.cos(heading_rad) - max(0.0, ego_mps)
            return cls(place="rear", by_other=towards_mps > _MOVES_MPS, on_foot=on_foot)
        along_rad = off_rad - math.pi / 2
        part = "side" if abs(along_rad) < _MIDDLE_RAD else "front" if along_rad < 0 else "rear"
        return cls(
            place=f"{'left' if side > 0 else 'right'} {part}",
            on_foot=on_foot,
            by_other=sideways_mps > _MOVES_MPS,
        )

    def words(self, who: str) -> str:
        """Return what happened to the ego, such as ``was driven into by car-2 at its left rear`` or ``hit car-4``.

        Args:
            who: Name of the other road user.
        """
        if self.by_other:
            return f"was {'walked' if self.on_foot else 'driven'} into by {who} at its {self.place}"
        with_side = "" if self.place == "front" else f" with its {self.place}"
        return f"hit {who}{with_side}"


def impact_in(requirement: str, features: Mapping[str, Any]) -> Impact | None:
    """Return how the ego and the other road user collided, according to the features of an episode.

    Args:
        requirement: Id of the requirement.
        features: Features of the episode, which any worker may have sent.
    """
    violations = features.get("violations")
    found = [one for one in violations if isinstance(one, Mapping)] if isinstance(violations, list) else []
    its = next((one for one in found if one.get("requirement") == requirement), None)
    return None if its is None else impact_of(its)


def impact_of(violation: Mapping[str, Any]) -> Impact | None:
    """Return how the ego and the other road user collided; None without a collision, or if that was not recorded.

    Args:
        violation: The circumstances of a violation, which any worker may have sent.
    """
    other, ego = violation.get("other"), violation.get("ego")
    if plain_id(str(violation.get("requirement"))) != "no-collision":
        return None
    if not isinstance(other, Mapping) or not isinstance(ego, Mapping):
        return None
    measured = [other.get(name) for name in ("bearing_rad", "heading_rad", "speed_mps")]
    numbers = [_number(value) for value in (*measured, ego.get("speed_mps"))]
    if not all(map(math.isfinite, numbers)):
        return None
    bearing_rad, heading_rad, speed_mps, ego_mps = numbers
    return Impact.of(
        bearing_rad=bearing_rad,
        heading_rad=heading_rad,
        speed_mps=speed_mps,
        ego_mps=ego_mps,
        on_foot=other.get("kind") == "pedestrian",
    )


def _number(value: object) -> float:
    """Return a value as a number; NaN if it is not one."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return float(str(value)) if is_number else math.nan


class MeasuredRequirement(Protocol):
    """The result of one requirement: `brink.sim.episode.Verdict`, or its counterpart on the wire."""

    @property
    def robustness(self) -> float: ...  # noqa: D102  (see Verdict)
    @property
    def violated_at_s(self) -> float | None: ...  # noqa: D102


@dataclass(frozen=True, slots=True, kw_only=True)
class Violated:
    """A requirement that an episode violated.

    Attributes:
        requirement: Its id.
        time_s: Simulated time of the first violation; None if it was not recorded.
        words: What the ego did, such as ``hit a pedestrian``.
        decides: Whether the campaign's verdict depends on it.
    """

    requirement: str
    time_s: float | None
    words: str
    decides: bool

    @property
    def words_with_time(self) -> str:
        """The words with the moment, such as ``hit a pedestrian at 12.8 s``."""
        return self.words if self.time_s is None else f"{self.words} at {clock_words(self.time_s)}"


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeVerdict:
    """What an episode showed about its requirements.

    Attributes:
        deciding: Ids of the requirements that decide the campaign's verdict; empty if they are unknown.
        violated: All violated requirements: those that decide first, then by time.
    """

    deciding: tuple[str, ...]
    violated: tuple[Violated, ...]

    @classmethod
    def of(
        cls, verdicts: Mapping[str, MeasuredRequirement], features: Mapping[str, Any], deciding: Sequence[str]
    ) -> Self:
        """Return the verdict of an episode.

        Args:
            verdicts: Results of all recorded requirements, by id.
            features: Features of the episode, which name what the ego hit.
            deciding: Ids of the requirements that decide the campaign's verdict.
        """
        found = [
            Violated(
                requirement=name,
                time_s=verdict.violated_at_s,
                decides=name in deciding,
                words=violated_words(name, collision_kind(name, features), impact_in(name, features)),
            )
            for name, verdict in verdicts.items()
            if verdict.robustness < 0
        ]
        found.sort(key=lambda one: (not one.decides, one.time_s is None, one.time_s or 0.0))
        return cls(deciding=tuple(deciding), violated=tuple(found))

    @property
    def unsafe(self) -> bool:
        """Whether a deciding requirement was violated."""
        return any(one.decides for one in self.violated)

    @property
    def others(self) -> tuple[Violated, ...]:
        """The violated requirements that do not decide the verdict."""
        return tuple(one for one in self.violated if not one.decides)

    def words(self, *, times: bool = True) -> str:
        """Return the verdict in words; empty if the deciding requirements are unknown and nothing was violated.

        Args:
            times: Whether to add the moments of violations.
        """
        told = [one.words_with_time if times else one.words for one in self.violated]
        if self.deciding and not self.unsafe:
            told.insert(0, held_words(self.deciding))
        return "; ".join(told)


def clock_words(time_s: float) -> str:
    """Return a simulated time in words, such as ``6.9 s``: halves are rounded up, whatever the type of the number."""
    return f"{math.floor(10.0 * time_s + 0.5 + 1e-4) / 10.0:.1f} s"


def plain_id(requirement: str) -> str:
    """Return the id of a requirement without its version."""
    return requirement.partition("@")[0]


def _spaced(requirement: str) -> str:
    return plain_id(requirement).replace("-", " ").replace("_", " ")


def collision_kind(requirement: str, features: Mapping[str, Any]) -> CollisionKind | None:
    """Return what the ego hit according to the features of an episode; None if they do not say."""
    kind = features.get(f"{requirement}:collision_kind")
    return next((one for one in CollisionKind if one.value == kind), None)


def held_words(requirements: Sequence[str]) -> str:
    """Return the phrase for a requirement that held, such as ``front gap held``."""
    if len(requirements) > MOST_NAMED:
        return f"all {len(requirements)} requirements held"
    return ", ".join(_held(name)[0] for name in requirements)


def drives_held(requirements: Sequence[str]) -> str:
    """Return the phrase for drives that held a requirement, such as ``held the front gap``."""
    if len(requirements) > MOST_NAMED:
        return f"held all {len(requirements)} requirements"
    return " and ".join(_held(name)[1] for name in requirements)


def _held(requirement: str) -> tuple[str, str]:
    words = _spaced(requirement)
    return _HELD.get(plain_id(requirement), (f"{words} held", f"held {words}"))


def violated_words(
    requirement: str, collision: CollisionKind | None = None, impact: Impact | None = None
) -> str:
    """Return the phrase for an episode that violates a requirement, such as ``hit a pedestrian``.

    Args:
        requirement: Its id, with or without version.
        collision: What the ego hit, if known.
        impact: How the two met, if known.
    """
    name = plain_id(requirement)
    if name == "no-collision" and collision is not None:
        if impact is not None:
            return impact.words(f"a{'n' if collision is CollisionKind.OBJECT else ''} {collision.value}")
        return _COLLIDED[collision]
    return _VIOLATED[name][0] if name in _VIOLATED else f"violated {_spaced(requirement)}"


def unsafe_words(requirements: Sequence[str]) -> str:
    """Return what the unsafe episodes of a campaign have in common, such as ``violated the front gap``."""
    if len(requirements) > MOST_NAMED:
        return f"violated at least one of {len(requirements)} requirements"
    return " or ".join(violated_words(name) for name in requirements)


def drives_violate(requirements: Sequence[str]) -> str:
    """Return what drives do that violate requirements, such as ``violate the front gap or collide``."""
    names = [plain_id(name) for name in requirements]
    told = [_VIOLATED[name][1] if name in _VIOLATED else f"violate {_spaced(name)}" for name in names]
    return " or ".join(told) or "violate the requirement"
