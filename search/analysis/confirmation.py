"""Whether a pair holds: the evidence from drives of both sides with other seeds.

The simulations of the search do not count: a pair is reported because of their verdicts, so they cannot speak against
it. A pair is confirmed if the verdicts of both sides are, and refuted if one of them is. A wrong claim of either kind
has a probability of at most `brink.search.sequential.ERROR`, however many drives there are.

Source: ours; docs/explanation/pairs.md.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Self

from brink.search.sequential import FIRST, INTERVAL, Verdict, exact_interval, verdict_of


class Confirmation(StrEnum):
    """The evidence on a pair from simulations with other seeds."""

    CONFIRMED = "confirmed"
    REFUTED = "refuted"
    UNDECIDED = "undecided"
    """Neither confirmed nor refuted by the drives that there are."""
    PENDING = "pending"
    """Undecided so far, but more is being simulated."""
    NOT_TRIED = "not tried"

    @property
    def rank(self) -> int:
        """Rank of the evidence: 0 supports the pair, 1 is inconclusive, 2 contradicts it."""
        return {Confirmation.CONFIRMED: 0, Confirmation.REFUTED: 2}.get(self, 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """How often a solution was unsafe with other seeds.

    Attributes:
        evaluated: Simulations with a verdict.
        unsafe: Unsafe ones among them.
        failed: Simulations without a verdict.
        low: Lower limit of the exact interval of the unsafe share, of 90% for sides; 0 without a verdict.
        high: Its upper limit; 1 without a verdict.
    """

    evaluated: int
    unsafe: int
    failed: int
    low: float
    high: float

    @classmethod
    def of(cls, unsafe: int, evaluated: int, failed: int = 0, *, confidence: float = INTERVAL) -> Self:
        """Return the share of counts, with its interval."""
        low, high = exact_interval(unsafe, evaluated, confidence)
        return cls(evaluated=evaluated, unsafe=unsafe, failed=failed, low=low, high=high)

    @property
    def probability(self) -> float | None:
        """Unsafe share; None without a verdict."""
        return self.unsafe / self.evaluated if self.evaluated else None

    @property
    def drives(self) -> int:
        """All simulations, with a verdict or without."""
        return self.evaluated + self.failed

    def keeps(self, *, unsafe: bool) -> Verdict:
        """Return whether these drives confirm that the solution is unsafe, or safe."""
        other = self.evaluated - self.unsafe if unsafe else self.unsafe
        return verdict_of(other, self.evaluated, self.failed)


def confirmation_of(safe: Share, unsafe: Share, *, pending: bool = False) -> Confirmation:
    """Return the evidence on a pair from simulations of both sides with other seeds.

    Args:
        safe: How often the safe side was unsafe.
        unsafe: How often the unsafe side was.
        pending: Whether a side is being simulated again.
    """
    sides = safe.keeps(unsafe=False), unsafe.keeps(unsafe=True)
    if Verdict.REFUTED in sides:
        return Confirmation.REFUTED
    if set(sides) == {Verdict.HOLDS}:
        return Confirmation.CONFIRMED
    if pending:
        return Confirmation.PENDING
    return Confirmation.UNDECIDED if safe.drives or unsafe.drives else Confirmation.NOT_TRIED


def is_judged(safe: Share, unsafe: Share) -> bool:
    """Return whether both sides have enough drives to be confirmed, or the pair is refuted."""
    return confirmation_of(safe, unsafe) is Confirmation.REFUTED or min(safe.drives, unsafe.drives) >= FIRST
