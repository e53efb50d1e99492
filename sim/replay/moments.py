"""Which moments of an episode tell its story: the decisive one, and a few that lead to it."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from brink.sim.replay.captions import plain_name, report_word
from brink.sim.replay.errors import ReplayError
from brink.sim.trace import ACTION, Event, Trace

FIRST_TOLD: Final = ("front-gap", "no-collision")
"""Requirements that a replay is about when none is named, in order of preference."""

LEAD_UP_S: Final = (1.0, 2.5, 5.0)
"""How long before the decisive moment to look, where nothing else happens."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """A sample worth a picture, and why."""

    sample: int
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Story:
    """What the replay of an episode is about.

    Attributes:
        requirement: Id of the requirement that is judged, as the trace has it.
        title: The same without its version.
        violated: Whether it is violated.
        decisive: Sample of the first violation, or of the least robustness.
        least: Least robustness of the episode.
        moments: Up to six, in order of time, with the decisive one among them.
    """

    requirement: str
    title: str
    violated: bool
    decisive: int
    least: float
    moments: tuple[Moment, ...]


def tell(trace: Trace, requirement: str | None = None, *, most: int = 6) -> Story:
    """Return the story of an episode.

    Args:
        trace: The episode.
        requirement: What to judge, its id with or without version; the front gap, or else the first requirement
            of the trace, if not given.
        most: Greatest number of moments, at least 2.

    Raises:
        ReplayError: The trace is empty, or does not have that requirement.
    """
    if len(trace.time_s) == 0:
        raise ReplayError("the trace has no samples: there is nothing to draw")
    chosen = _choose(trace, requirement)
    series = np.asarray(trace.robustness[chosen], dtype=np.float64)
    series = np.where(np.isnan(series), np.inf, series)
    below = np.flatnonzero(series < 0)
    decisive = int(below[0]) if below.size else int(series.argmin())
    return Story(
        requirement=chosen,
        title=plain_name(chosen),
        violated=bool(below.size),
        decisive=decisive,
        least=float(series.min()),
        moments=_moments(trace, decisive, violated=bool(below.size), most=most),
    )


def _injections(trace: Trace, decisive: int) -> list[tuple[int, str]]:
    """Return a sample within each injected detection, those before the decisive one first, with its label."""
    before: list[tuple[int, str]] = []
    after: list[tuple[int, str]] = []
    for label, word in enumerate(("vehicle", "person")):
        of_label = np.concatenate([[0], np.cumsum(trace.given_boxes.rows[:, 0].astype(int) == label)])
        counts = of_label[trace.given_boxes.first[1:]] - of_label[trace.given_boxes.first[:-1]]
        edges = np.flatnonzero(np.diff((counts > 0).astype(int), prepend=0, append=0))
        for start, end in edges.reshape(-1, 2).tolist():
            if start <= decisive:
                before.append(((start + min(end - 1, decisive)) // 2, word))
            else:
                after.append(((start + end - 1) // 2, word))
    return [*sorted(before, reverse=True), *sorted(after)]


def told_events(trace: Trace) -> list[Event]:
    """Return the events but for changes of the plan and of actions, which replays show as bands."""
    return [event for event in trace.events if event.kind != ACTION and not event.kind.startswith("plan-")]


def _choose(trace: Trace, requirement: str | None) -> str:
    if requirement is None:
        if not trace.robustness:
            raise ReplayError("the trace records no requirement: there is nothing to judge")
        told = min(
            trace.robustness,
            key=lambda name: FIRST_TOLD.index(plain_name(name)) if plain_name(name) in FIRST_TOLD else 9,
        )
        # A camera's episode is about any hazard: the one that happened, if the usual one did not.
        others = [
            name for name, series in trace.robustness.items() if trace.film is not None and np.any(series < 0)
        ]
        return told if told in others or not others else others[0]
    matching = [name for name in trace.robustness if requirement in (name, plain_name(name))]
    if not matching:
        known = ", ".join(trace.robustness) or "none"
        raise ReplayError(f"requirement: expected one that the trace records ({known}), got {requirement!r}")
    return requirement if requirement in matching else matching[0]


def _moments(trace: Trace, decisive: int, *, violated: bool, most: int) -> tuple[Moment, ...]:
    """Pick moments by weight, none closer to another than a twentieth of the episode."""
    last = len(trace.time_s) - 1
    candidates = [Moment(sample=decisive, reason="violation" if violated else "closest")]
    candidates += _before(trace, decisive)
    candidates += [Moment(sample=0, reason="start"), Moment(sample=last, reason="end")]
    apart = max(1, min(8, last // 20))
    chosen: list[Moment] = []
    for candidate in candidates:
        if len(chosen) < most and all(abs(candidate.sample - other.sample) >= apart for other in chosen):
            chosen.append(candidate)
    return tuple(sorted(chosen, key=lambda moment: moment.sample))


def _before(trace: Trace, decisive: int) -> list[Moment]:
    """Return moments in the order of how much they explain: lead-up, ghosts, events, plan changes."""
    time_s = trace.time_s
    found: list[Moment] = []

    def lead_up(seconds: float) -> None:
        at_s = time_s[decisive] - seconds
        if at_s >= time_s[0]:
            sample = int(np.abs(time_s - at_s).argmin())
            found.append(Moment(sample=sample, reason=f"{seconds:g} s before"))

    lead_up(LEAD_UP_S[0])
    if report_word(trace) == "injected":
        found += [
            Moment(sample=sample, reason=f"injected {word}") for sample, word in _injections(trace, decisive)
        ]
    changes = [i for i in range(1, decisive + 1) if trace.plan_mode[i] != trace.plan_mode[i - 1]]
    found += [Moment(sample=i, reason=f"plan: {trace.plan_mode[i]}") for i in changes[::-1][:2]]
    for event in reversed(told_events(trace)):
        sample = int(np.abs(time_s - event.time_s).argmin())
        if sample <= decisive:
            found.append(Moment(sample=sample, reason=event.kind))
    for seconds in LEAD_UP_S[1:]:
        lead_up(seconds)
    return found
