"""The verdict on a drive of a suite: what its simulations show against what was expected."""

from enum import StrEnum
from typing import Final

from brink.search.wald import Decision


class SuiteVerdict(StrEnum):
    """What has become of a drive, those that need attention first."""

    BROKEN = "broken"
    """It was safe and is unsafe."""
    NOT_REPRODUCED = "not reproduced"
    """Nothing has changed, and it is not what it was found to be."""
    CANNOT_RUN = "cannot run"
    UNCLEAR = "unclear"
    """It violates too often for a safe drive and too rarely for an unsafe one, or too few seeds tell."""
    OPEN = "not simulated"
    """Too few simulations have ended."""
    FIXED = "fixed"
    """It was unsafe and is safe."""
    STILL_UNSAFE = "still unsafe"
    STILL_SAFE = "still safe"


SAFE: Final = "safe"
UNSAFE: Final = "unsafe"


def verdict_on(decision: Decision, expected: str, *, before: str = "", reproduce: str = "") -> SuiteVerdict:
    """Return what has become of a drive.

    Args:
        decision: What its simulations show.
        expected: What it should be, safe or unsafe.
        before: What an earlier run showed, safe or unsafe, which counts instead of what is expected; empty without
            one.
        reproduce: What it was found to be if nothing has changed since; empty if something has.
    """
    match decision:
        case Decision.CANNOT_RUN:
            return SuiteVerdict.CANNOT_RUN
        case Decision.UNCLEAR:
            return SuiteVerdict.UNCLEAR
        case Decision.OPEN:
            return SuiteVerdict.OPEN
    if reproduce and decision.value != reproduce:
        return SuiteVerdict.NOT_REPRODUCED
    was = before or expected
    if decision is Decision.SAFE:
        return SuiteVerdict.STILL_SAFE if was == SAFE else SuiteVerdict.FIXED
    return SuiteVerdict.STILL_UNSAFE if was == UNSAFE else SuiteVerdict.BROKEN


def passes(verdict: SuiteVerdict, expected: str) -> bool:
    """Return whether a drive is as expected.

    A known hazard passes whether it is still there, gone or unclear. What should be safe passes only if it is.

    Args:
        verdict: What has become of it.
        expected: What it should be, safe or unsafe.
    """
    if verdict in (SuiteVerdict.FIXED, SuiteVerdict.STILL_SAFE):
        return True
    return expected == UNSAFE and verdict in (SuiteVerdict.STILL_UNSAFE, SuiteVerdict.UNCLEAR)
