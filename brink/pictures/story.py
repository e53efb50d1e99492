"""The story of an episode: the requirement it is judged by, the moments that explain it, and their captions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final, TypeAlias, TypeVar

import numpy as np

from brink.pictures.scene import (
    LABELS,
    PERSON,
    STANDING_MARGIN_M,
    ReplayError,
    count_wrong,
    gap_words,
    has_errors,
    impact_at,
    is_injected,
    plain_name,
    spec_part,
)
from brink.sim.aeb.specification import describe_perturbations, describe_street
from brink.sim.catalogue import REQUIREMENTS, is_own_plugin, make_requirement, requirement_ids
from brink.sim.episode import Json
from brink.sim.errors import InvalidEpisode
from brink.sim.requirements import REQUIRED_GAP_M, CollisionKind, NoDangerousStop
from brink.sim.trace import ACTION, VIOLATED_AT_S, WORDS, Event, Trace
from brink.sim.urban.detection_errors import errors_from_json
from brink.sim.verdict import Impact, clock_words, held_words, violated_words
from brink.sim.world.scenario import words_of_scenario

PREFERRED: Final = ("front-gap", "no-collision")
"""Requirements that a replay is about if none is named, in order of preference."""

_NO_VEHICLE_M: Final = 48.0
"""A greater margin of the front gap means that no vehicle is ahead."""
_MOST_MOMENTS: Final = 6
_LEAD_UP_S: Final = (1.0, 2.5, 5.0)
"""How long before the decisive moment to look for other moments."""

_LONGEST_S: Final = 600.0
"""No episode is longer; bounds the times in its errors."""
T = TypeVar("T")
Judged: TypeAlias = str | Sequence[str] | None
"""Ids of the requirements that a replay is about, with or without version."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """A sample that is worth drawing, and the reason.

    Attributes:
        sample: The sample.
        reason: Why, in a few words.
        time_s: Exact time of a violation; None if that of the sample is meant.
    """

    sample: int
    reason: str
    time_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ViolatedHere:
    """The first violation of a requirement in an episode.

    Attributes:
        requirement: Id of the requirement, as the trace records it.
        sample: Sample whose robustness tells of it: the lowest until the next sample.
        shown: Sample that shows it: the one whose time reads as its own.
        time_s: Its exact time; of old traces, up to a sample's length too early.
        lag_s: How long after `sample` that is.
        words: What the ego did and when, such as ``hit a pedestrian at 12.8 s``.
    """

    requirement: str
    sample: int
    shown: int
    time_s: float
    lag_s: float
    words: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Story:
    """The requirement and the moments that the replay of an episode shows.

    Attributes:
        requirement: Id of the requirement, as the trace records it.
        title: The same without its version.
        violated: Whether it is violated.
        decisive: Sample of the first violation, or of the lowest robustness.
        least: Lowest robustness of the episode, +inf if the requirement never applied.
        unit: Unit of the robustness; empty if it is unknown.
        formula: The requirement, if it is a formula; otherwise empty.
        moments: At most six, in order of time; the decisive one is among them.
        violations: First violations of all recorded requirements: of the one that the story is about, then by time.
        words: What happened, such as ``front gap held; hit a pedestrian at 12.8 s``.
        shown: Sample that a still image shows: the decisive one, or the first violation of another requirement if the
            one that the story is about held.
    """

    requirement: str
    title: str
    violated: bool
    decisive: int
    least: float
    unit: str
    formula: str
    moments: tuple[Moment, ...]
    violations: tuple[ViolatedHere, ...]
    words: str

    @property
    def lag_s(self) -> float:
        """Delay of the violation after the sample that records it; 0 without a violation."""
        return self.violations[0].lag_s if self.violated else 0.0

    @property
    def shown(self) -> int:  # noqa: D102  (see above)
        return self.violations[0].shown if self.violations else self.decisive


def story_of(trace: Trace, requirement: Judged = None) -> Story:
    """Return the story of an episode.

    Args:
        trace: The episode.
        requirement: Id of the requirement to judge, with or without version. Of several, and by default of all, the
            story is about the one that was violated first; if all held, about the front gap or, if the trace does not
            record it, about the first.

    Raises:
        ReplayError: The trace is empty, or does not record the requirement.
    """
    if len(trace.time_s) == 0:
        raise ReplayError("the trace has no samples: there is nothing to draw")
    chosen = _first_violated(trace, judged_requirements(trace, requirement))
    series = np.asarray(trace.robustness[chosen], dtype=np.float64)
    series = np.where(np.isnan(series), np.inf, series)
    below = np.flatnonzero(series < 0)
    decisive = int(below[0]) if below.size else int(series.argmin())
    violations = _violations(trace, chosen)
    words = [one.words for one in violations]
    if not below.size:
        words.insert(0, held_words([chosen]))
    others = [one for one in violations if one.requirement != chosen]
    return Story(
        requirement=chosen,
        title=plain_name(chosen),
        violated=bool(below.size),
        decisive=decisive,
        least=float(series.min()),
        unit=unit_of(trace, chosen),
        formula=str(_stated(trace, chosen).get("stl", "")),
        moments=_moments(trace, decisive, violations[0] if below.size else None, others),
        violations=violations,
        words="; ".join(words),
    )


def _violations(trace: Trace, chosen: str) -> tuple[ViolatedHere, ...]:
    """Return the first violations of all requirements: of the chosen one, then by time."""
    found = []
    for name, series in trace.robustness.items():
        below = np.flatnonzero(np.asarray(series) < 0)
        if below.size:
            sample = int(below[0])
            hit = _collision(trace, name)
            impact = None if hit is None else _impact_of(trace, hit)
            what = violated_words(name, None if hit is None else _kind_of(trace, hit), impact)
            time_s = _violated_at_s(trace, name, sample)
            words = f"{what} at {clock_words(time_s)}"
            shown = _reads_as(trace, time_s, sample)
            found.append(
                ViolatedHere(
                    requirement=name,
                    sample=sample,
                    shown=shown,
                    time_s=time_s,
                    words=words,
                    lag_s=max(0.0, time_s - float(trace.time_s[sample])),
                )
            )
    return tuple(sorted(found, key=lambda one: (one.requirement != chosen, one.time_s)))


def _reads_as(trace: Trace, time_s: float, sample: int) -> int:
    """Return the sample at or after a violation whose displayed time matches a given one; by default the former."""
    following = range(sample, min(sample + 2, len(trace.time_s)))
    read = clock_words(time_s)
    return next((one for one in following if clock_words(float(trace.time_s[one])) == read), sample)


def _violated_at_s(trace: Trace, requirement: str, sample: int) -> float:
    """Return the time of a first violation: a sample keeps the lowest robustness until the next one."""
    exact = trace.about.get(VIOLATED_AT_S)
    time_s = exact.get(requirement) if isinstance(exact, Mapping) else None
    if isinstance(time_s, int | float):
        return float(time_s)
    hit = _collision(trace, requirement)
    return float(trace.time_s[sample]) if hit is None else hit.time_s


def _collision(trace: Trace, requirement: str) -> Event | None:
    """Return the collision that violates a requirement, if that is what the requirement is about."""
    if plain_name(requirement) != "no-collision":
        return None
    return next((event for event in trace.events if event.kind == "collision"), None)


def _kind_of(trace: Trace, hit: Event) -> CollisionKind | None:
    """Return what the ego hit in a collision."""
    kinds = {actor.name: actor.kind for actor in trace.actors}
    kind = next((kinds[word] for word in hit.text.split() if word in kinds), CollisionKind.OBJECT)
    return next((one for one in CollisionKind if one == kind), None)


def _impact_of(trace: Trace, hit: Event) -> Impact | None:
    """Return how the ego and a road user met in a collision; None if it hit something else."""
    names = {actor.name: index for index, actor in enumerate(trace.actors)}
    actor = next((names[word] for word in hit.text.split() if word in names), None)
    if actor is None:
        return None
    return impact_at(trace, int(np.abs(np.asarray(trace.time_s) - hit.time_s).argmin()), actor)


def judged_requirements(trace: Trace, requirement: Judged) -> list[str]:
    """Return the requested requirements of a trace, by default all.

    Raises:
        ReplayError: The trace records none of them.
    """
    if requirement is None:
        if not trace.robustness:
            raise ReplayError("the trace records no requirement: there is nothing to judge")
        return list(trace.robustness)
    known = ", ".join(trace.robustness) or "none"
    if isinstance(requirement, str):
        matching = [name for name in trace.robustness if requirement in (name, plain_name(name))]
        if not matching:
            raise ReplayError(
                f"requirement: expected one that the trace records ({known}), got {requirement!r}"
            )
        return [requirement if requirement in matching else matching[0]]
    # Older traces record an earlier version of a requirement.
    asked = {name if name in trace.robustness else plain_name(name) for name in requirement}
    matching = [name for name in trace.robustness if {name, plain_name(name)} & asked]
    if not matching:
        raise ReplayError(
            f"requirement: expected some that the trace records ({known}), got {', '.join(requirement)}"
        )
    return matching


def _first_violated(trace: Trace, names: Sequence[str]) -> str:
    """Return which of some requirements was violated first; if all held, the preferred one."""
    first = {name: np.flatnonzero(np.asarray(trace.robustness[name]) < 0) for name in names}
    violated = {name: int(samples[0]) for name, samples in first.items() if samples.size}
    if not violated:
        return min(names, key=_preference)
    return min(violated, key=lambda name: (_violated_at_s(trace, name, violated[name]), _preference(name)))


def _preference(requirement: str) -> int:
    name = plain_name(requirement)
    return PREFERRED.index(name) if name in PREFERRED else len(PREFERRED)


def _moments(
    trace: Trace, decisive: int, violation: ViolatedHere | None, others: Sequence[ViolatedHere]
) -> tuple[Moment, ...]:
    """Pick the most important moments that are at least a twentieth of the episode apart.

    Args:
        trace: The episode.
        decisive: Sample of the lowest robustness, which counts without a violation.
        violation: Of the requirement that the story is about, if it is violated.
        others: Violations of other requirements.
    """
    last = len(trace.time_s) - 1
    if violation is None:
        candidates = [Moment(sample=decisive, reason="closest")]
        leads_to = others[0].shown if others else decisive
    else:
        candidates = [Moment(sample=violation.shown, reason="violation", time_s=violation.time_s)]
        leads_to = violation.shown
    candidates += [
        Moment(sample=one.shown, reason=one.words.partition(" at ")[0], time_s=one.time_s) for one in others
    ]
    candidates += _lead_up(trace, leads_to)
    candidates += [Moment(sample=0, reason="start"), Moment(sample=last, reason="end")]
    apart = max(1, min(8, last // 20))
    chosen: list[Moment] = []
    for candidate in candidates:
        if len(chosen) < _MOST_MOMENTS and all(
            abs(candidate.sample - other.sample) >= apart for other in chosen
        ):
            chosen.append(candidate)
    return tuple(sorted(chosen, key=lambda moment: moment.sample))


def _lead_up(trace: Trace, decisive: int) -> list[Moment]:
    """Return preceding moments, most explanatory first: just before, injections, plan changes, events, earlier."""
    time_s = trace.time_s
    found: list[Moment] = []

    def look_back(seconds: float) -> None:
        at_s = time_s[decisive] - seconds
        if at_s >= time_s[0]:
            sample = int(np.abs(time_s - at_s).argmin())
            found.append(Moment(sample=sample, reason=f"{seconds:g} s before"))

    look_back(_LEAD_UP_S[0])
    if report_word(trace) == "injected":
        found += [
            Moment(sample=sample, reason=f"injected {label}")
            for sample, label in _injections(trace, decisive)
        ]
    if has_errors(trace):
        wrong = count_wrong(trace) > 0
        found += [
            Moment(sample=i, reason="error begins" if wrong[i] else "error ends")
            for i in range(1, decisive + 1)
            if wrong[i] != wrong[i - 1]
        ][:2]
    changes = [i for i in range(1, decisive + 1) if trace.plan_mode[i] != trace.plan_mode[i - 1]]
    found += [Moment(sample=i, reason=f"plan: {trace.plan_mode[i]}") for i in changes[::-1][:2]]
    for event in reversed(notable_events(trace)):
        sample = int(np.abs(time_s - event.time_s).argmin())
        if sample <= decisive:
            found.append(Moment(sample=sample, reason=event.kind))
    for seconds in _LEAD_UP_S[1:]:
        look_back(seconds)
    return found


def _injections(trace: Trace, decisive: int) -> list[tuple[int, str]]:
    """Return a sample within each injected detection and its label, those before the decisive sample first."""
    before: list[tuple[int, str]] = []
    after: list[tuple[int, str]] = []
    for label, name in enumerate(LABELS[: PERSON + 1]):
        edges = np.flatnonzero(np.diff((reported(trace, label) > 0).astype(int), prepend=0, append=0))
        for start, end in edges.reshape(-1, 2).tolist():
            if start <= decisive:
                before.append(((start + min(end - 1, decisive)) // 2, name))
            else:
                after.append(((start + end - 1) // 2, name))
    return [*sorted(before, reverse=True), *sorted(after)]


def reported(trace: Trace, label: int) -> "np.ndarray[tuple[int], np.dtype[np.int64]]":
    """Return the number of boxes of a label reported to the driving system at each sample, shape ``(n,)``."""
    boxes = trace.given_boxes
    sums = np.concatenate([[0], np.cumsum(boxes.rows[:, 0].astype(np.int64) == label)])
    return np.asarray(sums[boxes.first[1:]] - sums[boxes.first[:-1]], dtype=np.int64)


def notable_events(trace: Trace) -> list[Event]:
    """Return the events except plan changes and actions, which replays show as bands."""
    return [event for event in trace.events if event.kind != ACTION and not event.kind.startswith("plan-")]


def event_caption(event: Event) -> str:
    """Return an event in words; an action names the road user, such as ``car-1: change lane``."""
    text = str(event.text)
    return text.replace("_", " ").replace(":", ": ", 1) if event.kind == ACTION else text


def runs(values: Sequence[T]) -> list[tuple[T, int, int]]:
    """Return each run of equal values as value, first and last index."""
    found: list[tuple[T, int, int]] = []
    for index, value in enumerate(values):
        if found and found[-1][0] == value:
            found[-1] = (value, found[-1][1], index)
        else:
            found.append((value, index, index))
    return found


def scenario_words(trace: Trace) -> str:
    """Return a one-line description of the scenario; empty if the trace does not describe it."""
    own = trace.about.get(WORDS)
    if isinstance(own, str):
        return own
    scenario = spec_part(trace, "scenario")
    words = ""
    if scenario:
        words = describe_street(scenario) if "crossing_m" in scenario else words_of_scenario(scenario)
    if has_errors(trace):
        words = "; ".join([*([words] if words else []), error_words(trace)])
    if spec_part(trace, "behaviour").get("trajectories") and not len(trace.given_boxes.rows):
        words += "; ends before the first injection"
    return words


def error_words(trace: Trace) -> str:
    """Describe the errors of the detector."""
    behaviour = spec_part(trace, "behaviour")
    try:
        errors = errors_from_json(behaviour, _LONGEST_S)
    except InvalidEpisode:
        return "unknown errors"  # any worker may have written the trace
    return " and ".join(error.words for error in errors) or "no error"


def perturbation_words(trace: Trace) -> str:
    """Describe the perturbations of the camera images, in order; empty if there were none."""
    steps = spec_part(trace, "behaviour").get("perturbations")
    if not isinstance(steps, list):
        return ""
    return describe_perturbations([step for step in steps if isinstance(step, Mapping)])


def report_word(trace: Trace) -> str:
    """Return how the reported boxes arose.

    Returns:
        ``injected``, ``wrong`` (of the truth with errors), ``detected`` in images, or ``seen`` (the ground truth).
    """
    if is_injected(trace):
        return "injected"
    if has_errors(trace):
        return "wrong"
    oracle = trace.film is None and spec_part(trace, "behaviour").get("mode") == "oracle"
    return "seen" if oracle else "detected"


def measured_words(requirement: str, robustness: float, unit: str) -> tuple[str, str]:
    """Describe the measurement of a requirement, and its limit.

    Of the front gap that is the gap itself, of any other requirement its margin: its distance from being violated.

    Args:
        requirement: Its id, with or without version.
        robustness: Its robustness, finite.
        unit: Unit of the robustness.
    """
    if no_needless_braking(requirement, robustness):
        return "no needless braking", "at this moment"
    if plain_name(requirement) != "front-gap":
        return with_unit(robustness, unit), "violated" if robustness < 0 else "to spare"
    if robustness > _NO_VEHICLE_M:
        return "no vehicle ahead", ""
    if robustness == STANDING_MARGIN_M:
        return "the ego stands", ""
    required = f"{REQUIRED_GAP_M:g} m"
    gap = gap_words(robustness + REQUIRED_GAP_M)
    if robustness >= 0:
        return gap, f"{required} required"
    shown = gap.removesuffix(" m")
    digits = len(shown.partition(".")[2])
    return gap, f"{REQUIRED_GAP_M - float(shown):.{digits}f} m short of {required}"


def no_needless_braking(requirement: str, robustness: float) -> bool:
    """Return whether this is the margin of `no-dangerous-stop` while the ego does not brake without a reason."""
    return plain_name(requirement) == "no-dangerous-stop" and robustness >= NoDangerousStop.horizon


def margin_name(requirement: str) -> str:
    """Return the name of a requirement's robustness, such as ``front gap margin``."""
    return f"{plain_name(requirement).replace('-', ' ')} margin"


def unit_of(trace: Trace, requirement: str) -> str:
    """Return the unit of the robustness of one of a trace's requirements; empty if it is unknown."""
    return str(_stated(trace, requirement).get("unit", _units().get(plain_name(requirement), "")))


def _stated(trace: Trace, requirement: str) -> Mapping[str, Json]:
    """Return what a campaign states about a requirement of its own: formula and unit."""
    known = spec_part(trace, "formulas") or spec_part(trace, "options").get("requirements")
    stated = known.get(requirement) if isinstance(known, Mapping) else None
    return stated if isinstance(stated, Mapping) else {}


@cache
def _units() -> Mapping[str, str]:
    """Return the units of robustness, by id without version, of the requirements that ship with the project."""
    own = [name for name in requirement_ids() if is_own_plugin(REQUIREMENTS, name)]
    return {plain_name(name): make_requirement(name).unit for name in own}


def with_unit(value: float, unit: str) -> str:
    """Return a robustness with sign and unit, such as ``−0.8 m``; with two decimal places if it is close to zero."""
    decimals = 1 if abs(value) >= 0.1 else 2
    return f"{value:+.{decimals}f}{f' {unit}' if unit else ''}".replace("-", "−")
