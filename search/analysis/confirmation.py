"""Whether a pair holds: how often each of its sides was unsafe when it was simulated again with other seeds.

The simulations of the search do not count: a pair is reported because of their verdicts, so they cannot speak against
it.

Source: ours; docs/explanation/pairs.md.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Self

SAFE_AT_MOST: Final = 0.2
"""Largest unsafe share of the safe side of a confirmed pair."""
UNSAFE_AT_LEAST: Final = 0.8
"""Smallest unsafe share of the unsafe side of a confirmed pair."""
LEAST_DRIVES: Final = 10
"""Simulations of each side that say whether a pair is confirmed.

Those that are missing, as after a failure, may have had either verdict. If the answer depends on them, there is none.
"""


class Confirmation(StrEnum):
    """What simulations with other seeds say of a pair.

    One that is not confirmed is not refuted: with few drives, the interval of a side may well reach the limit.
    """

    CONFIRMED = "confirmed"
    NOT_CONFIRMED = "not confirmed"
    TOO_FEW = "too few drives"
    PENDING = "pending"
    """Too few drives so far, but more are being simulated."""
    NOT_TRIED = "not tried"

    @property
    def rank(self) -> int:
        """Place in the order of evidence: 0 speaks for the pair, 1 says nothing, 2 speaks against it."""
        return {Confirmation.CONFIRMED: 0, Confirmation.NOT_CONFIRMED: 2}.get(self, 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """How often a solution was unsafe with other seeds.

    Attributes:
        evaluated: Simulations with a verdict.
        unsafe: Unsafe ones among them.
        low: Lower limit of the Wilson interval of the unsafe share; 0 without a verdict.
        high: Its upper limit; 1 without a verdict.
    """

    evaluated: int
    unsafe: int
    low: float
    high: float

    @classmethod
    def of(cls, unsafe: int, evaluated: int) -> Self:
        """Return the share of counts, with its 95% interval."""
        # Commands that only need the limits above start without NumPy.
        from brink.search.fitness import wilson_interval

        low, high = wilson_interval(unsafe, evaluated) if evaluated else (0.0, 1.0)
        return cls(evaluated=evaluated, unsafe=unsafe, low=float(low), high=float(high))

    @property
    def probability(self) -> float | None:
        """Unsafe share; None without a verdict."""
        return self.unsafe / self.evaluated if self.evaluated else None


def confirmation_of(safe: Share, unsafe: Share, *, pending: bool = False) -> Confirmation:
    """Return what the simulations of both sides of a pair with other seeds say of it.

    Args:
        safe: How often the safe side was unsafe.
        unsafe: How often the unsafe side was.
        pending: Whether the sides that have too few drives are being simulated again.
    """
    if pending and min(safe.evaluated, unsafe.evaluated) < LEAST_DRIVES:
        return Confirmation.PENDING
    if not safe.evaluated and not unsafe.evaluated:
        return Confirmation.NOT_TRIED
    if _most_unsafe(safe) <= SAFE_AT_MOST and _least_unsafe(unsafe) >= UNSAFE_AT_LEAST:
        return Confirmation.CONFIRMED
    if _least_unsafe(safe) > SAFE_AT_MOST or _most_unsafe(unsafe) < UNSAFE_AT_LEAST:
        return Confirmation.NOT_CONFIRMED
    return Confirmation.TOO_FEW


def _least_unsafe(side: Share) -> float:
    """Return the unsafe share if all simulations that are missing had been safe."""
    return side.unsafe / max(side.evaluated, LEAST_DRIVES)


def _most_unsafe(side: Share) -> float:
    """Return the unsafe share if all simulations that are missing had been unsafe."""
    missing = max(0, LEAST_DRIVES - side.evaluated)
    return (side.unsafe + missing) / max(side.evaluated, LEAST_DRIVES)
