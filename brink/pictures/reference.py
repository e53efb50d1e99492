"""A reference driver in the system's place: its actions in words, and as a pair of drives for pictures.

The trace of a drive with violations may include that of a reference driver among the same scripted road
users (`brink.sim.encounter.reference`), and says which violations a reference driver would have avoided. The pictures
are about the earliest of these, or about the collision that follows it shortly after.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from brink.pictures.motion import CREEPS_MPS, STANDS_MPS, brakings, distances
from brink.pictures.pair import DrivePair, Mark, Nearest, Side, counterpart_of, sample_at
from brink.pictures.scene import TOUCHES_M, impact_at, is_car, plain_name, spec_part
from brink.pictures.story import Judged, ViolatedHere, judged_requirements, runs, story_of
from brink.sim.requirements import REQUIRED_GAP_M
from brink.sim.trace import AVOIDABLE, Trace
from brink.sim.verdict import clock_words

_ARTICLES: Final[Mapping[str, str]] = {"careful": "A", "ideal": "An"}
"""Articles of the reference drivers, which are named as in specifications."""
_NOTES: Final[Mapping[str, str]] = {
    "careful": "avoidable by a careful driver",
    "ideal": "avoidable only by braking at once",
    "no": "not avoidable by braking",
}
"""Phrases for violations, by who avoids them."""
_EXPLANATIONS: Final[Mapping[str, str]] = {
    "careful": (
        "The careful driver is that of UN Regulation No. 157, Annex 3: sees all road users, takes 0.4 s to judge a "
        "risk and 0.75 s to reach the brake, brakes with up to 0.774 g, and never swerves."
    ),
    "ideal": (
        "The ideal driver sees all road users, brakes at once with 0.774 g, and never swerves. A careful driver (UN "
        "Regulation No. 157, Annex 3), who needs time to react, would not have avoided it."
    ),
}
_SETTING: Final = (
    "Other road users follow a script and do not watch for the car. There are no priority signs, and the reference "
    "driver applies no rules of priority."
)
_LEADS_TO_S: Final = 3.0
"""A collision this soon after another violation counts as its consequence."""
_STANDS_S: Final = 1.0
_CREEPS_M: Final = 0.5
"""A driver who stands for a shorter time, or moves up farther afterwards, creeps rather than stops."""
_INSTEAD: Final[Mapping[str, str]] = {
    "front-gap": "keeps the front gap",
    "no-collision": "hits nothing",
    "lane-keeping": "keeps the lane",
    "red-light": "runs no red light",
    "speed-limit": "keeps the speed limit",
    "progress": "does not stand still that long",
}
"""What a driver does in place of a violation that is about no road user."""
_MARKS: Final[Mapping[str, str]] = {
    "front-gap": f"within {REQUIRED_GAP_M:g} m",
    "no-collision": "collision",
    "lane-keeping": "leaves lane",
    "red-light": "red light",
    "speed-limit": "too fast",
    "progress": "stands too long",
}
"""What violations are called in a chart."""
_LOOK_BACK_S: Final = 5.0
"""How long before the violation a driver who is not slow may have braked."""
_BEFORE_S: Final = 1.5
"""How long before the violation a driver who avoids it by driving slowly may already be slow."""
_AS_NEAR_M: Final = 0.02
"""Distances this close are the same: the first one is shown."""
_AFTERWARDS_S: Final = 1.0
"""How long after the violation a driver's distance still matters."""
_ALONG: Final = 0.3
"""Cosine of the angle up to which a vehicle faces the same way."""
_CLOSER_M: Final = 0.3
"""A road user that comes nearer to the route by this much is on its way there."""
_HERE_M: Final = 10.0
"""Within this distance of the place of the violation, a drive has arrived there."""
_TOLERANCE_S: Final = 1e-3
_EARLIER_S: Final = 5.0
_APART_M: Final = 15.0
"""Drives at least this far apart, in time or distance, are not in the same place."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """The system's drive with a violation, and that of a reference driver who avoids it.

    Attributes:
        about: The violation that the pictures are about.
        driver: The driver, as in specifications.
        system: What the system did, up to the violation, such as ``hit pedestrian-1 at 12.8 s``.
        others: What else the system violated of what was asked for, in a sentence; empty if nothing.
        violated: All violations of what was asked for, by time, for a chart.
        words: The same in words, such as ``hit car-4 at 7.2 s``, by requirement.
        deed: What the driver does instead.
        driven: The same in words, such as ``brakes at 11.9 s and stops 3.1 m short of car-4``, and its violations.
        earlier: How much earlier the driver arrives where the violation is, in a sentence; empty if hardly.
        reference: The driver's drive.
    """

    about: ViolatedHere
    driver: str
    system: str
    others: str
    violated: tuple[Mark, ...]
    words: Mapping[str, str]
    deed: "Deed"
    driven: str
    earlier: str
    reference: Trace

    @property
    def name(self) -> str:
        """Name of the driver, such as ``careful driver``."""
        return f"{self.driver} driver"

    @property
    def brakes_at_s(self) -> float | None:
        """When the driver begins to brake; None if the driver drives on."""
        return self.deed.brakes_at_s

    @property
    def avoided_by(self) -> str:
        """A sentence that the driver has not braked before the violation; empty if it has."""
        if self.deed.braked:
            return ""
        how = "having passed earlier" if self.deed.passes else "driving on"
        return f"Avoided by {how}, not by braking: the {self.name} has not braked for anybody."

    @property
    def sentences(self) -> tuple[str, str]:
        """The actions of the system, and those of the driver instead, in a sentence each."""
        return f"The system {self.system}.", f"{_ARTICLES[self.driver]} {self.name} {self.driven}."

    @property
    def explanation(self) -> str:
        """Sentences that explain who the driver and the other road users are."""
        return f"{_EXPLANATIONS[self.driver]} {_SETTING}"

    def pair(self, trace: Trace) -> DrivePair:
        """Return both drives, the system's first.

        Args:
            trace: The system's drive.
        """
        deed = self.deed
        marks: tuple[Mark, ...] = ()
        if deed.brakes_at_s is not None:
            marks = (Mark(deed.brakes_at_s, f"{self.name} brakes{' again' if deed.again else ''}"),)
        return DrivePair(
            safe=Side(
                trace=self.reference,
                name=self.driver,
                car=self.name,
                chip=self.driver.upper(),
                outcome=self.driven,
                shown_s=deed.nearest.time_s if deed.nearest is not None and deed.passes else None,
            ),
            unsafe=Side(trace=trace, name="system", car="system", chip="SYSTEM", outcome=self.system),
            change="\n".join(self.sentences),
            findings=tuple(filter(None, (self.avoided_by, self.earlier))),
            facts=tuple(filter(None, (self.others, self.explanation))),
            requirement=self.about.requirement,
            unsafe_first=True,
            about_reports=False,
            marks=marks,
            violated=self.violated,
            nearest=deed.nearest,
        )


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
    deed = _deed(trace, about, reference)
    also = "; ".join(one.words for one in story_of(reference, about.requirement).violations)
    shown = [one for one in asked if about.time_s - _LEADS_TO_S <= one.time_s <= about.time_s]
    return Comparison(
        about=about,
        driver=driver,
        deed=deed,
        reference=reference,
        words={one.requirement: _system_words(trace, [one])[0] for one in asked},
        system=_listed(_system_words(trace, shown)),
        others=_others(trace, asked, shown),
        violated=tuple(
            Mark(one.time_s, _MARKS.get(plain_name(one.requirement), "violation")) for one in asked
        ),
        driven=f"{deed.words} ({also})" if also else deed.words,
        earlier=_earlier(trace, about, reference, driver),
    )


def _about(violations: list[ViolatedHere]) -> ViolatedHere:
    """Return the violations that the pictures are about, by time."""
    first = violations[0]
    soon = [one for one in violations if one.time_s - first.time_s <= _LEADS_TO_S]
    return next((one for one in soon if one.requirement.startswith("no-collision")), first)


def _system_words(trace: Trace, violations: Sequence[ViolatedHere]) -> list[str]:
    """Describe what the system violated, naming the road user; ``it`` refers to the same one again."""
    words: list[str] = []
    named: int | None = None
    for one in violations:
        actor = counterpart_of(trace, story_of(trace, one.requirement))
        did, name = one.words.rpartition(" at ")[0], "" if actor is None else trace.actors[actor].name
        who = "it" if actor is not None and actor == named else name
        if actor is not None and plain_name(one.requirement) == "front-gap":
            did = f"came within {REQUIRED_GAP_M:g} m of {who}"
        elif actor is not None:
            impact = impact_at(trace, sample_at(trace, one.time_s), actor)
            did = f"hit {who}" if impact is None else impact.words(name if impact.by_other else who)
        named = actor
        words.append(f"{did} at {clock_words(one.time_s)}")
    return words


def _others(trace: Trace, asked: Sequence[ViolatedHere], shown: Sequence[ViolatedHere]) -> str:
    """Describe in sentences what the system violated before and after what the pictures show."""
    sentences = [
        (when, _listed(_system_words(trace, some)))
        for when, some in (
            ("before", [one for one in asked if one.time_s < shown[0].time_s]),
            ("then", [one for one in asked if one.time_s > shown[-1].time_s]),
        )
    ]
    return " ".join(f"The system {when} {words}." for when, words in sentences if words)


def _listed(words: Sequence[str]) -> str:
    return " and ".join(filter(None, (", ".join(words[:-1]), *words[-1:])))


def _earlier(trace: Trace, about: ViolatedHere, reference: Trace, driver: str) -> str:
    """Return how much earlier a driver reaches the place of the violation; empty if the drives are close together."""
    sample = sample_at(trace, about.time_s)
    place = trace.ego[sample, :2]
    arrives_s = []
    for drive in (trace, reference):
        near = np.flatnonzero(np.hypot(*(drive.ego[:, :2] - place).T) < _HERE_M)
        if not near.size:
            return ""
        arrives_s.append(float(drive.time_s[near[0]]))
    earlier_s = arrives_s[0] - arrives_s[1]
    apart_m = float(np.hypot(*(reference.ego[sample_at(reference, about.time_s), :2] - place)))
    if earlier_s < 1.0 or (earlier_s <= _EARLIER_S and apart_m <= _APART_M):
        return ""
    return f"The {driver} driver arrives here {earlier_s:.0f} s earlier than the system."


@dataclass(frozen=True, slots=True, kw_only=True)
class Deed:
    """The action of a driver that avoids a violation.

    Attributes:
        words: The same in words.
        brakes_at_s: When the driver begins to brake for it; None if the driver drives on.
        again: Whether the driver has braked before that, and let go.
        braked: Whether the driver braked at all before the time of the violation.
        passes: Whether the driver has passed whom the violation is about by then.
        nearest: How near the driver comes to that one; None if it is nobody.
    """

    words: str
    brakes_at_s: float | None = None
    again: bool = False
    braked: bool
    passes: bool = False
    nearest: Nearest | None = None


def _deed(trace: Trace, about: ViolatedHere, reference: Trace) -> Deed:
    """Return the action by which a driver avoids a violation.

    Args:
        trace: The system's drive.
        about: Its violation.
        reference: The driver's drive.
    """
    held = brakings(reference)
    braked = any(reference.time_s[first] <= about.time_s + _TOLERANCE_S for first, _ in held)
    slow = _slow_from(reference, about.time_s)
    since = sample_at(reference, about.time_s - _LOOK_BACK_S) if slow is None else slow
    last = sample_at(reference, about.time_s) if slow is None else slow
    its = [first for first, end in held if first <= last and end >= since]
    begins = its[-1] if its else None
    actor = counterpart_of(trace, story_of(trace, about.requirement))
    if begins is None:
        return _without_braking(reference, about, actor, braked=braked)
    again = held[0][0] < begins
    brakes_at_s = float(reference.time_s[begins])
    outcome, nearest = _INSTEAD.get(plain_name(about.requirement), "does not"), None
    if actor is not None:
        until = sample_at(reference, about.time_s + _AFTERWARDS_S)
        outcome, nearest = _distance_words(reference, actor, max(begins, since), until)
    return Deed(
        words=f"brakes {'again ' if again else ''}at {clock_words(brakes_at_s)} and {outcome}",
        brakes_at_s=brakes_at_s,
        again=again,
        braked=braked,
        nearest=nearest,
    )


def _without_braking(reference: Trace, about: ViolatedHere, actor: int | None, *, braked: bool) -> Deed:
    """Describe a driver that does not brake for the violation's road user, and why that helps."""
    if actor is None:
        return Deed(
            words=f"drives on and {_INSTEAD.get(plain_name(about.requirement), 'does not')}", braked=braked
        )
    name, gaps_m = reference.actors[actor].name, distances(reference, actor)
    until = sample_at(reference, about.time_s + _AFTERWARDS_S)
    if not np.isfinite(gaps_m[: until + 1]).any():
        return Deed(words=f"drives on and does not meet {name}", braked=braked)
    least = int(np.nanargmin(gaps_m[: until + 1]))
    gap_m, at_s = float(gaps_m[least]), float(reference.time_s[least])
    away = f"{gap_m:.1f} m clear"
    end = min(sample_at(reference, about.time_s), len(reference.time_s) - 1)
    passes = not _is_ahead(reference, actor, end)
    nearest = Nearest(at_s, gap_m, away)
    if not passes:
        return Deed(
            words=f"does not need to brake and stays {away} of {name}", braked=braked, nearest=nearest
        )
    motion = reference.actors[actor].motion
    stands = bool(motion[least, 3] < STANDS_MPS)
    if not stands and _comes_closer(reference, actor, least):
        how = f"is past before {name} gets there, {away}"
    elif stands and not _stays(reference, actor, least):
        how = f"passes at {clock_words(at_s)}, {away}, before {name} moves off"
    else:
        how = f"passes {name} at {clock_words(at_s)}, {away}"
    return Deed(words=f"does not need to brake: it {how}", braked=braked, passes=True, nearest=nearest)


def _stays(trace: Trace, actor: int, sample: int) -> bool:
    """Return whether a road user that was stationary at a sample still is at the end of the drive."""
    speeds = trace.actors[actor].motion[sample:, 3]
    return bool((speeds[np.isfinite(speeds)] < STANDS_MPS).all())


def _comes_closer(trace: Trace, actor: int, sample: int) -> bool:
    """Return whether a road user later comes nearer to the route than at a sample."""
    if len(trace.route) < 2:
        return False
    places = trace.actors[actor].motion[sample:, :2]
    away_m = [float(np.hypot(*(trace.route - place).T).min()) for place in places if np.isfinite(place).all()]
    return bool(away_m) and min(away_m) < away_m[0] - _CLOSER_M


def _slow_from(trace: Trace, time_s: float) -> int | None:
    """Return since when a driver that has braked has been slow around a time; None if it is not slow."""
    first, last = (sample_at(trace, time_s + offset_s) for offset_s in (-_BEFORE_S, _AFTERWARDS_S))
    speed_mps = trace.ego[:, 3]
    slowest = first + int(speed_mps[first : last + 1].argmin())
    if speed_mps[slowest] >= CREEPS_MPS:
        return None
    while slowest > 0 and speed_mps[slowest - 1] < CREEPS_MPS:
        slowest -= 1
    return slowest


def _distance_words(trace: Trace, actor: int, first: int, until: int) -> tuple[str, Nearest | None]:
    """Return how close a driver comes to a road user, such as ``stops 3.1 m short of car-4``, and when.

    No requirement is violated when others hit a standing car: the words say so.

    Args:
        trace: The driver's drive.
        actor: The road user.
        first: Sample from which on it matters.
        until: Sample up to which the distance matters.
    """
    name, gaps_m = trace.actors[actor].name, distances(trace, actor)
    later = [sample for sample in range(first, len(trace.time_s)) if np.isfinite(gaps_m[sample])]
    hit = next((at for at in later if trace.ego[at, 3] < STANDS_MPS and gaps_m[at] < TOUCHES_M), None)
    if hit is not None:
        verb = "drives" if is_car(trace.actors[actor]) else "walks"
        return f"stands when {name} {verb} into it at {clock_words(float(trace.time_s[hit]))}", None
    standing = [at for at in _standing(trace, first, until) if at in later]
    if standing and np.hypot(*(trace.ego[until, :2] - trace.ego[standing[0], :2])) > _CREEPS_M:
        standing = []
    if not standing and not any(at <= until for at in later):
        return f"does not meet {name}", None
    lowest_m = min(gaps_m[at] for at in (standing or later))
    least = next(at for at in (standing or later) if gaps_m[at] <= lowest_m + _AS_NEAR_M)
    away = f"{lowest_m:.1f} m"
    ahead = _is_ahead(trace, actor, least)
    if standing:
        words = f"stops {away} short of {name}" if ahead else f"stops, {away} clear of {name}"
    else:
        behind = ahead and _goes_along(trace, actor, least)
        words = f"stays at least {away} {'behind' if behind else 'clear of'} {name}"
    return words, Nearest(float(trace.time_s[least]), float(lowest_m), away)


def _goes_along(trace: Trace, actor: int, sample: int) -> bool:
    """Return whether a road user is a vehicle that faces roughly the same way as the car."""
    turn_rad = float(trace.actors[actor].motion[sample, 2] - trace.ego[sample, 2])
    return is_car(trace.actors[actor]) and bool(np.cos(turn_rad) > _ALONG)


def _standing(trace: Trace, first: int, until: int) -> list[int]:
    """Return the samples from one on in which a driver stands for long, having stopped by another one."""
    stands = (np.abs(trace.ego[first:, 3]) < STANDS_MPS).tolist()
    found: list[int] = []
    for standing, begins, ends in runs(stands):
        lasts_s = float(trace.time_s[first + ends] - trace.time_s[first + begins])
        if (
            standing
            and first + begins <= until
            and (lasts_s >= _STANDS_S or first + ends == len(trace.time_s) - 1)
        ):
            found += range(first + begins, first + ends + 1)
    return found


def _is_ahead(trace: Trace, actor: int, sample: int) -> bool:
    """Return whether a road user is ahead of the middle of the car."""
    x_m, y_m, yaw_rad = (float(value) for value in trace.ego[sample, :3])
    dx_m, dy_m = (trace.actors[actor].motion[sample, :2] - (x_m, y_m)).tolist()
    return bool(dx_m * np.cos(yaw_rad) + dy_m * np.sin(yaw_rad) > 0)
