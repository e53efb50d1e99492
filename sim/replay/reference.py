"""What a reference driver does in the system's place: in words, and as a pair of drives for pictures.

The trace of a drive with violations may include that of a reference driver among the same scripted road
users (`brink.sim.encounter.reference`), and says which violations a reference driver would have avoided. The pictures
are about the earliest of these, or about the collision that follows it shortly after.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from brink.sim.replay.pair import DrivePair, Mark, Side, counterpart_of, sample_at
from brink.sim.replay.scene import TOUCHES_M, gap_to, is_car, plain_name, spec_part
from brink.sim.replay.story import Judged, ViolatedHere, judged_requirements, runs, story_of
from brink.sim.trace import AVOIDABLE, Trace

_ARTICLES: Final[Mapping[str, str]] = {"careful": "A", "ideal": "An"}
"""Articles of the reference drivers, which are named as in specifications."""
_NOTES: Final[Mapping[str, str]] = {
    "careful": "avoidable by a careful driver",
    "ideal": "avoidable only by braking at once",
    "no": "not avoidable by braking",
}
"""What is said of violations, by who avoids them."""
_EXPLANATIONS: Final[Mapping[str, str]] = {
    "careful": (
        "The careful driver is that of UN Regulation No. 157, Annex 3: sees everybody, takes 0.4 s to judge a risk "
        "and 0.75 s to reach the brake, brakes with up to 0.774 g, and never swerves."
    ),
    "ideal": (
        "The ideal driver sees everybody, brakes at once with 0.774 g, and never swerves. A careful driver (UN "
        "Regulation No. 157, Annex 3), who needs time to react, would not have avoided it."
    ),
}
_LEADS_TO_S: Final = 3.0
"""A collision this soon after too small a gap is what the gap led to."""
_STANDS_MPS: Final = 0.3
_CREEPS_MPS: Final = 2.0
"""Below this speed, a driver who goes on a little after having braked has not left off."""
_INSTEAD: Final[Mapping[str, str]] = {
    "front-gap": "keeps the front gap",
    "no-collision": "hits nothing",
    "lane-keeping": "keeps the lane",
    "red-light": "runs no red light",
    "speed-limit": "keeps the speed limit",
    "progress": "does not stand still that long",
}
"""What a driver does in place of a violation that is about no road user."""
_LOOK_BACK_S: Final = 5.0
"""How long before the violation a driver may have braked who is not slow then."""
_BEFORE_S: Final = 1.5
"""How long before the violation a driver may be slow already who avoids it by being slow."""
_AFTERWARDS_S: Final = 1.0
"""How long after the violation a driver's distance still matters."""
_STOP: Final = "stop"


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """The system's drive with a violation, and that of a reference driver who avoids it.

    Attributes:
        about: The violation that the pictures are about.
        driver: The driver, as in specifications.
        violations: What the system violated of what was asked for, by time.
        driven: What the driver does instead, such as ``brakes at 11.9 s and stops 3.1 m short``, and what the driver
            violates.
        brakes_at_s: When the driver begins to brake; None if the driver drives on.
        reference: The driver's drive.
    """

    about: ViolatedHere
    driver: str
    violations: tuple[ViolatedHere, ...]
    driven: str
    brakes_at_s: float | None
    reference: Trace

    @property
    def name(self) -> str:
        """What the driver is called, such as ``careful driver``."""
        return f"{self.driver} driver"

    @property
    def system(self) -> str:
        """What the system did, such as ``hit a pedestrian at 12.8 s``."""
        return " and ".join(one.words for one in self.violations)

    @property
    def sentences(self) -> tuple[str, str]:
        """What the system did, and what the driver does instead, in a sentence each."""
        return f"The system {self.system}.", f"{_ARTICLES[self.driver]} {self.name} {self.driven}."

    @property
    def explanation(self) -> str:
        """Who the driver is, in a sentence."""
        return _EXPLANATIONS[self.driver]

    def pair(self, trace: Trace) -> DrivePair:
        """Return both drives, the system's first.

        Args:
            trace: The system's drive.
        """
        brakes = () if self.brakes_at_s is None else (Mark(self.brakes_at_s, f"{self.name} brakes"),)
        return DrivePair(
            safe=Side(
                trace=self.reference, name=self.driver, car=self.name, chip=self.driver.upper(), outcome=self.driven
            ),
            unsafe=Side(trace=trace, name="system", car="system", chip="SYSTEM", outcome=self.system),
            change="\n".join(self.sentences), facts=(self.explanation,), requirement=self.about.requirement,
            unsafe_first=True, about_reports=False, marks=brakes,
        )  # fmt: skip


def avoidable_by(trace: Trace, requirement: str) -> str | None:
    """Return who would have avoided the first violation of a requirement; None if that was not measured."""
    told = trace.about.get(AVOIDABLE)
    found = told.get(requirement) if isinstance(told, Mapping) else None
    return found if isinstance(found, str) and found in _NOTES else None


def avoidable_words(trace: Trace, requirement: str) -> str:
    """Return who would have avoided the first violation of a requirement in words; empty if that was not measured."""
    found = avoidable_by(trace, requirement)
    return "" if found is None else _NOTES[found]


def comparison_of(trace: Trace, requirement: Judged = None) -> Comparison | None:
    """Return the comparison of a drive with that of a reference driver who avoids its violation.

    Args:
        trace: The system's drive.
        requirement: As for `story_of`.

    Returns:
        The comparison; None if the trace has no such drive, or nobody avoids a violation that was asked for.

    Raises:
        ReplayError: As `story_of`.
    """
    reference = trace.reference
    if reference is None or not len(reference.time_s):
        return None
    driver = str(spec_part(reference, "behaviour").get("driver"))
    names = judged_requirements(trace, requirement)
    found = story_of(trace, requirement).violations
    asked = sorted((one for one in found if one.requirement in names), key=lambda one: one.time_s)
    avoided = [one for one in asked if avoidable_by(trace, one.requirement) == driver]
    if driver not in _ARTICLES or not avoided:
        return None
    about = _about(avoided)
    driven = _Driven.of(trace, about, reference)
    also = "; ".join(one.words for one in story_of(reference, about.requirement).violations)
    return Comparison(
        about=about, driver=driver, violations=tuple(asked), brakes_at_s=driven.brakes_at_s, reference=reference,
        driven=f"{driven.words} ({also})" if also else driven.words,
    )  # fmt: skip


def _about(violations: list[ViolatedHere]) -> ViolatedHere:
    """Return which of some violations the pictures are about, given by time."""
    first = violations[0]
    soon = [one for one in violations if one.time_s - first.time_s <= _LEADS_TO_S]
    return next((one for one in soon if one.requirement.startswith("no-collision")), first)


@dataclass(frozen=True, slots=True)
class _Driven:
    """What a driver does in place of a violation."""

    words: str
    brakes_at_s: float | None

    @classmethod
    def of(cls, trace: Trace, about: ViolatedHere, reference: Trace) -> Self:
        """Return what the driver does about a violation.

        Args:
            trace: The system's drive.
            about: Its violation.
            reference: The driver's drive.
        """
        end_s = float(reference.time_s[-1])
        if end_s < about.time_s and any(event.kind == "goal" for event in reference.events):
            return cls(f"drives on and has reached the end of its route at {end_s:.1f} s", None)
        slow = _slow_from(reference, about.time_s)
        since = sample_at(reference, about.time_s - _LOOK_BACK_S) if slow is None else slow
        begins = _brakes_from(reference, since, sample_at(reference, about.time_s) if slow is None else slow)
        until = sample_at(reference, about.time_s + _AFTERWARDS_S)
        actor = counterpart_of(trace, story_of(trace, about.requirement))
        if actor is None:
            outcome = _INSTEAD.get(plain_name(about.requirement), "does not")
        else:
            first = since if begins is None else max(begins, since)
            outcome = _distance_words(reference, actor, first, until)
        if begins is None:
            return cls(f"drives on and {outcome}", None)
        brakes_at_s = float(reference.time_s[begins])
        return cls(f"brakes at {brakes_at_s:.1f} s and {outcome}", brakes_at_s)


def _slow_from(trace: Trace, time_s: float) -> int | None:
    """Return since when a driver who has braked is slow around a time; None if the driver is not."""
    first, last = (sample_at(trace, time_s + offset_s) for offset_s in (-_BEFORE_S, _AFTERWARDS_S))
    speed_mps = trace.ego[:, 3]
    slowest = first + int(speed_mps[first : last + 1].argmin())
    if speed_mps[slowest] >= _CREEPS_MPS:
        return None
    while slowest > 0 and speed_mps[slowest - 1] < _CREEPS_MPS:
        slowest -= 1
    return slowest


def _brakes_from(trace: Trace, first: int, last: int) -> int | None:
    """Return when the last braking begins that goes on at, or begins in, a span of samples; None if there is none."""
    found = [
        begins
        for mode, begins, ends in runs(trace.plan_mode)
        if mode == _STOP and begins <= last and ends >= first
    ]
    return found[-1] if found else None


def _distance_words(trace: Trace, actor: int, first: int, until: int) -> str:
    """Return how close a driver comes to a road user, such as ``stops 3.1 m short``.

    No requirement is violated when others hit a standing car: the words say so.

    Args:
        trace: The driver's drive.
        actor: The road user.
        first: Sample from which on it matters.
        until: Sample up to which the distance matters.
    """
    samples = range(first, len(trace.time_s))
    gaps = {sample: gap.gap_m for sample in samples if (gap := gap_to(trace, sample, actor)) is not None}
    standing = {sample: gap_m for sample, gap_m in gaps.items() if trace.ego[sample, 3] < _STANDS_MPS}
    hit = next((sample for sample, gap_m in standing.items() if gap_m < TOUCHES_M), None)
    if hit is not None:
        what = "vehicle" if is_car(trace.actors[actor]) else "pedestrian"
        return f"stands when the {what} hits it at {float(trace.time_s[hit]):.1f} s"
    soon = [sample for sample in standing if sample <= until] or [
        sample for sample in gaps if sample <= until
    ]
    if not soon:
        return "does not meet it"
    nearest = min(soon, key=lambda sample: gaps[sample])
    away = f"{gaps[nearest]:.1f} m"
    if nearest in standing:
        return f"stops {away} short" if _is_ahead(trace, actor, nearest) else f"stops, {away} clear"
    return f"stays {away} clear"


def _is_ahead(trace: Trace, actor: int, sample: int) -> bool:
    """Return whether a road user is ahead of the middle of the car."""
    x_m, y_m, yaw_rad = (float(value) for value in trace.ego[sample, :3])
    dx_m, dy_m = (trace.actors[actor].motion[sample, :2] - (x_m, y_m)).tolist()
    return bool(dx_m * np.cos(yaw_rad) + dy_m * np.sin(yaw_rad) > 0)
