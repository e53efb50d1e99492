"""Whether a drive is safe or unsafe over episode seeds: Wald's sequential probability ratio test.

A drive counts as *safe* if the probability of a violation is at most `SAFE_AT_MOST`, as *unsafe* if it is at least
`UNSAFE_AT_LEAST`; of either, the test is wrong with a probability of at most `ERROR`. In between it may say either,
or end as *unclear* after `MOST` drives. With these numbers, it decides once one verdict is four drives ahead of the
other, so a clear case takes four.

Drives that failed have no verdict. They count against whatever is claimed.

Source: Wald 1945, Sequential tests of statistical hypotheses.
"""

import math
from enum import StrEnum
from typing import Final

SAFE_AT_MOST: Final = 0.2
"""Largest probability of a violation of a safe drive."""
UNSAFE_AT_LEAST: Final = 0.8
"""Smallest probability of a violation of an unsafe drive."""
ERROR: Final = 0.01
"""Largest probability that a safe drive is called unsafe, and the reverse."""
MOST: Final = 20
"""Drives after which a test that has not decided ends."""
_UNSAFE_STEP: Final = math.log(UNSAFE_AT_LEAST / SAFE_AT_MOST)
_SAFE_STEP: Final = math.log((1 - UNSAFE_AT_LEAST) / (1 - SAFE_AT_MOST))
"""What a drive with each verdict adds to the log-likelihood ratio of unsafe to safe."""
_LIMIT: Final = math.log((1 - ERROR) / ERROR)
LEAD: Final = math.ceil(_LIMIT / _UNSAFE_STEP)
"""Drives by which one verdict must be ahead of the other: the steps are equal, as the two limits add up to 1."""


class Decision(StrEnum):
    """What drives with different seeds show."""

    SAFE = "safe"
    UNSAFE = "unsafe"
    UNCLEAR = "unclear"
    """Neither, after `MOST` drives."""
    CANNOT_RUN = "cannot run"
    """No drive had a verdict."""
    OPEN = "open"
    """More drives will tell."""


def decide(unsafe: int, evaluated: int, failed: int = 0, *, most: int = MOST) -> Decision:
    """Return what drives with different seeds show.

    Args:
        unsafe: Drives that violated.
        evaluated: Drives with a verdict.
        failed: Drives without one.
        most: Drives after which the test ends.

    Raises:
        ValueError: The counts do not fit together.
    """
    if not 0 <= unsafe <= evaluated or failed < 0 or most < 1:
        raise ValueError(
            f"expected 0 <= unsafe <= evaluated, 0 <= failed and 1 <= most, got {unsafe}, {evaluated}, {failed} and "
            f"{most}"
        )
    safe, drives = evaluated - unsafe, evaluated + failed
    if unsafe * _UNSAFE_STEP + (safe + failed) * _SAFE_STEP >= _LIMIT:
        return Decision.UNSAFE
    if (unsafe + failed) * _UNSAFE_STEP + safe * _SAFE_STEP <= -_LIMIT:
        return Decision.SAFE
    if not evaluated and drives >= min(LEAD, most):
        return Decision.CANNOT_RUN
    return Decision.OPEN if drives < most else Decision.UNCLEAR


def further_drives(unsafe: int, evaluated: int, failed: int = 0, *, most: int = MOST) -> int:
    """Return the smallest number of further drives after which the test may end; 0 if it has ended.

    Args:
        unsafe: Drives that violated.
        evaluated: Drives with a verdict.
        failed: Drives without one.
        most: Drives after which the test ends.
    """
    if decide(unsafe, evaluated, failed, most=most) is not Decision.OPEN:
        return 0
    safe = evaluated - unsafe
    return min(LEAD - max(unsafe - safe, safe - unsafe) + failed, most - evaluated - failed)
