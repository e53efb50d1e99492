"""Whether a drive is safe or unsafe over episode seeds: two of Wald's sequential probability ratio tests at once.

A drive is *safe* if violations are rare, *unsafe* if it nearly always violates; anything in between is *unclear*. One
test decides whether violations are rare (`RARE`) or happen in half of the drives, its mirror image whether drives
without one are rare or half. The drive is called safe or unsafe once the test of that claim has ruled out one half,
and unclear as soon as neither can within `MOST` drives. Therefore

- at most `WRONG` of drives that violate half of the time or more are called safe, and of those that violate half of
  the time or less, unsafe,
- of the drives that were simulated, at most a fifth contradict the verdict.

A clear case takes `CLEAR` drives. Drives that failed have no verdict. They count against whatever is claimed.

Sources: Wald 1945, Sequential tests of statistical hypotheses; Sobel and Wald 1949, A sequential decision procedure
for choosing one of three hypotheses.
"""

import math
from enum import StrEnum
from typing import Final

RARE: Final = 0.1
"""Probability of what is rare."""
HALF: Final = 0.5
WRONG: Final = 0.05
"""Largest probability that a drive that violates in half of its simulations is called safe, and the reverse."""
MISSED: Final = 0.1
"""Error rate of the test for a drive with rare violations, which is not called safe then."""
MOST: Final = 20
"""Drives after which a test that has not decided ends."""
_LIMIT: Final = math.log((1 - MISSED) / WRONG)
_FOR: Final = math.log((1 - RARE) / (1 - HALF))
_AGAINST: Final = math.log(HALF / RARE)
"""What a drive for a claim and one against it add to the log-likelihood ratio and take from it."""


def _needed(against: int) -> int:
    """Return the number of drives for a claim that decides, with a number of drives against it."""
    return math.ceil((_LIMIT + against * _AGAINST) / _FOR)


CLEAR: Final = _needed(0)
"""Drives that a clear case takes."""


class Decision(StrEnum):
    """What drives with different seeds show."""

    SAFE = "safe"
    UNSAFE = "unsafe"
    UNCLEAR = "unclear"
    """Neither, and no further drives would change that."""
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
    if unsafe >= _needed(safe + failed):
        return Decision.UNSAFE
    if safe >= _needed(unsafe + failed):
        return Decision.SAFE
    if drives < min(CLEAR, most):
        return Decision.OPEN
    if not evaluated:
        return Decision.CANNOT_RUN
    left = max(most - drives, 0)
    reachable = safe + left >= _needed(unsafe + failed) or unsafe + left >= _needed(safe + failed)
    return Decision.OPEN if left and reachable else Decision.UNCLEAR


def further_drives(unsafe: int, evaluated: int, failed: int = 0, *, most: int = MOST) -> int:
    """Return the smallest number of further drives, failed or not, after which the test may end; 0 if it has.

    Args:
        unsafe: Drives that violated.
        evaluated: Drives with a verdict.
        failed: Drives without one.
        most: Drives after which the test ends.
    """
    if decide(unsafe, evaluated, failed, most=most) is not Decision.OPEN:
        return 0
    safe, drives = evaluated - unsafe, evaluated + failed
    left = most - drives
    decided = min(_needed(unsafe + failed) - safe, _needed(safe + failed) - unsafe)
    given_up = max(
        _until_unreachable(safe, unsafe + failed, left), _until_unreachable(unsafe, safe + failed, left)
    )
    return min(max(min(decided, given_up), min(CLEAR, most) - drives), left)


def _until_unreachable(supporting: int, against: int, left: int) -> int:
    """Return after how many further drives against a claim those that are left cannot decide for it."""
    return next((more for more in range(left) if supporting + left - more < _needed(against + more)), left)
