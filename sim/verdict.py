"""The verdict of an episode in words: which requirements decide it, and every other one that was violated.

A campaign's verdict, safe or unsafe, is about the requirements that the campaign chose. An episode that holds these
may still violate another one, for example keep its distance to the car ahead and hit a pedestrian. Texts for people
therefore name the requirement: ``front gap held; hit a pedestrian at 12.8 s``.
"""

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
    "front-gap": "violated the front gap",
    "lane-keeping": "left the lane",
    "red-light": "ran a red light",
    "speed-limit": "exceeded the speed limit",
    "progress": "stood still too long",
    "no-dangerous-stop": "made a dangerous stop",
    "survival": "ended too early",
    "margin": "violated the margin",
    "function": "violated the requirement",
}
_COLLIDED: Final = {
    CollisionKind.VEHICLE: "hit a vehicle",
    CollisionKind.PEDESTRIAN: "hit a pedestrian",
    CollisionKind.OBJECT: "hit an object",
}


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
        return self.words if self.time_s is None else f"{self.words} at {self.time_s:.1f} s"


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
                requirement=name, time_s=verdict.violated_at_s, decides=name in deciding,
                words=violated_words(name, collision_kind(name, features)),
            )
            for name, verdict in verdicts.items()
            if verdict.robustness < 0
        ]  # fmt: skip
        found.sort(key=lambda one: (not one.decides, one.time_s is None, one.time_s or 0.0))
        return cls(deciding=tuple(deciding), violated=tuple(found))

    @property
    def unsafe(self) -> bool:
        """Whether a requirement that decides was violated."""
        return any(one.decides for one in self.violated)

    @property
    def others(self) -> tuple[Violated, ...]:
        """The violated requirements that do not decide the verdict."""
        return tuple(one for one in self.violated if not one.decides)

    def words(self, *, times: bool = True) -> str:
        """Return the verdict in words; empty if nothing is known to decide it and nothing was violated.

        Args:
            times: Whether to add the moments of violations.
        """
        told = [one.words_with_time if times else one.words for one in self.violated]
        if self.deciding and not self.unsafe:
            told.insert(0, held_words(self.deciding))
        return "; ".join(told)


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
    """Return what requirements that held are called, such as ``front gap held``."""
    if len(requirements) > MOST_NAMED:
        return f"all {len(requirements)} requirements held"
    return ", ".join(_held(name)[0] for name in requirements)


def drives_held(requirements: Sequence[str]) -> str:
    """Return what drives did that held requirements, such as ``held the front gap``."""
    if len(requirements) > MOST_NAMED:
        return f"held all {len(requirements)} requirements"
    return " and ".join(_held(name)[1] for name in requirements)


def _held(requirement: str) -> tuple[str, str]:
    words = _spaced(requirement)
    return _HELD.get(plain_id(requirement), (f"{words} held", f"held {words}"))


def violated_words(requirement: str, collision: CollisionKind | None = None) -> str:
    """Return what the ego did in an episode that violates a requirement, such as ``hit a pedestrian``.

    Args:
        requirement: Its id, with or without version.
        collision: What the ego hit, if known.
    """
    name = plain_id(requirement)
    if name == "no-collision":
        return _COLLIDED[collision] if collision is not None else "had a collision"
    return _VIOLATED.get(name, f"violated {_spaced(requirement)}")


def unsafe_words(requirements: Sequence[str]) -> str:
    """Return what the unsafe episodes of a campaign have in common, such as ``violated the front gap``."""
    if len(requirements) > MOST_NAMED:
        return f"violated at least one of {len(requirements)} requirements"
    return " or ".join(violated_words(name) for name in requirements)
