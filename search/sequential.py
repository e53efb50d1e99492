"""Whether a solution keeps its verdict with other seeds: a sequential test with stated error rates.

A verdict *holds* if the probability of the other verdict, over episode seeds, is at most `LIMIT`. Drives with other
seeds decide. The test may be read after every drive, and the number of drives need not be fixed before: both error
rates bound the probability that the claim is *ever* made.

- It is confirmed that the verdict holds after `FIRST` drives without the other verdict; each drive with the other
  verdict asks for `FURTHER` more. If the other verdict has a probability of more than `LIMIT`, that happens with a
  probability of at most 4.91%.
- It is refuted once at least a third of the drives and 8/3 had the other verdict: 4 of 4, 5 of 7, 6 of 10. If the
  other verdict has a probability of at most `LIMIT`, that happens with a probability of at most 2.45%, so a pair of
  which both sides hold is refuted with at most 4.85%.
- Otherwise it is undecided, which is neither.

A drive without a verdict may have had either: it counts against whatever is claimed.

Both limits are straight lines of drives against other verdicts, as those of a sequential probability ratio test
(Wald 1945). Their places are whole numbers for which the probabilities of crossing, computed exactly, keep the error
rates: Wald's own limits assume that a line is met exactly, and need more drives. See docs/explanation/pairs.md and
ADR 68.
"""

from enum import StrEnum
from typing import Final

LIMIT: Final = 0.2
"""Largest probability of the other verdict of a solution whose verdict holds."""
ERROR: Final = 0.05
"""Largest probability that a pair is confirmed, or refuted, wrongly."""
FIRST: Final = 15
"""Drives without the other verdict that confirm."""
FURTHER: Final = 12
"""Further drives for each one with the other verdict."""
_PER_OTHER: Final = 3
_BEFORE_REFUTED: Final = 8
"""A verdict is refuted as long as the drives are at most `_PER_OTHER` times the other verdicts minus this."""
INTERVAL: Final = 0.9
"""Confidence of the exact intervals: each of their limits is wrong with a probability of at most `ERROR`."""


class Verdict(StrEnum):
    """The conclusion on a verdict from drives with other seeds."""

    HOLDS = "holds"
    REFUTED = "refuted"
    UNDECIDED = "undecided"


def drives_to_confirm(other: int) -> int:
    """Return how many drives confirm a verdict if `other` of them disagree with it."""
    return FIRST + FURTHER * other


def verdict_of(other: int, evaluated: int, failed: int = 0) -> Verdict:
    """Return the conclusion on a verdict from drives with other seeds.

    Args:
        other: Drives with the other verdict.
        evaluated: Drives with a verdict.
        failed: Drives without one, which may have had either.

    Raises:
        ValueError: The counts do not fit together.
    """
    if not 0 <= other <= evaluated or failed < 0:
        raise ValueError(
            f"expected 0 <= other <= evaluated and 0 <= failed, got {other}, {evaluated} and {failed}"
        )
    drives = evaluated + failed
    if drives >= drives_to_confirm(other + failed):
        return Verdict.HOLDS
    if 0 < drives <= _PER_OTHER * other - _BEFORE_REFUTED:
        return Verdict.REFUTED
    return Verdict.UNDECIDED


def exact_interval(count: int, of: int, confidence: float = INTERVAL) -> tuple[float, float]:
    """Return the exact (Clopper-Pearson) interval of a share; [0, 1] without trials.

    Exact for a number of drives that does not depend on their verdicts.

    Args:
        count: Drives counted.
        of: All drives.
        confidence: Probability, in (0, 1), with which the interval contains the true share, or more.

    References:
        Clopper and Pearson 1934.
    """
    from scipy.special import betaincinv  # commands that only need the rule start without SciPy

    beyond = (1 - confidence) / 2
    low = float(betaincinv(count, of - count + 1, beyond)) if count else 0.0
    high = float(betaincinv(count + 1, of - count, 1 - beyond)) if count < of else 1.0
    return low, high
