"""How replays show a guard: its alarms, the interventions of the fallback, and a violation that they prevent."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from brink.pictures.pair import DrivePair, Mark, Side
from brink.pictures.story import Judged, story_of
from brink.sim.trace import Trace
from brink.sim.verdict import clock_words

ALARM, FALLBACK = "alarm", "fallback"
"""The guard raises the alarm and the fallback does not intervene; it intervenes, with or without an alarm."""
_PHRASES: Final = {
    "slow-down": "slows the car down",
    "safe-stop": "brakes",
    "ignore-boxes": "ignores implausible boxes",
    "none": "does nothing",
}
"""What fallbacks do, by id without version."""


def guard_words(trace: Trace) -> list[str]:
    """Return the state of the guard at each sample: `ALARM`, `FALLBACK` or nothing; all empty without a guard."""
    guard = trace.guard
    if guard is None:
        return [""] * len(trace.time_s)
    return [
        FALLBACK if intervenes else ALARM if alarm else ""
        for alarm, intervenes in zip(guard.alarm.tolist(), guard.intervenes.tolist(), strict=True)
    ]


def guard_probability(trace: Trace) -> NDArray[np.float64] | None:
    """Return the guard's probability of a violation within its longest horizon, shape ``(n,)``; None without one."""
    if trace.guard is None or not trace.guard.horizons_s:
        return None
    return np.asarray(trace.guard.probabilities[:, -1], np.float64)


def fallback_words(fallback_id: str) -> str:
    """Return the effect of a fallback in a few words, such as ``brakes``."""
    return _PHRASES.get(fallback_id.partition("@")[0], f"intervenes ({fallback_id})")


def prevented_pair(alone: Trace, guarded: Trace, requirement: Judged = None) -> DrivePair:
    """Return a drive with a violation and the same drive with a guard, the violation first.

    Args:
        alone: The drive without the guard.
        guarded: The same drive with it.
        requirement: Ids of the requirements that count; for the default see `story_of`.
    """
    story = story_of(alone, requirement)
    words = guard_words(guarded)
    marks = []
    began_s = None
    if words.count(FALLBACK):
        began_s = float(guarded.time_s[words.index(FALLBACK)])
        marks.append(Mark(began_s, FALLBACK))
    fallback = fallback_words("" if guarded.guard is None else guarded.guard.fallback)
    deed = "nothing happens" if began_s is None else f"the fallback {fallback} at {clock_words(began_s)}"
    then = story_of(guarded, story.requirement).words
    return DrivePair(
        safe=Side(
            trace=guarded, name="guarded", car="with the guard", chip="GUARDED", outcome=f"{deed}; {then}"
        ),
        unsafe=Side(trace=alone, name="alone", car="without the guard", chip="ALONE", outcome=story.words),
        change=f"Without the guard: {story.words}.\nWith the guard: {deed}; {then}.",
        requirement=story.requirement,
        unsafe_first=True,
        about_reports=False,
        marks=tuple(marks),
    )
