"""The paper's thresholds, shares of the budget and measures, with ours beside them: plain values, cheap to import.

Source: Sharifi et al. 2023, evaluation.
"""

from enum import StrEnum
from typing import Protocol, TypeVar

T_co = TypeVar("T_co", covariant=True)

PAPER_T_BS = (0.01, 0.03, 0.05, 0.10, 0.15, 0.20)
PAPER_D_THS = (0.1, 0.2, 0.3)
"""Minimum distances of the paper's tables."""
D_THS = (*PAPER_D_THS, 0.4, 0.5)
"""Minimum distances at which campaigns are scored: those of the paper's tables, then larger ones."""
PAPER_FRACTIONS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
PAPER_BUDGET = 1_300
PAPER_LEVEL = 0.01
"""Level of the paper's tests, which are not corrected for their number."""
LEVEL = 0.05
"""Adjusted p-value up to which a difference is significant, unless another level is chosen."""


class _BothMeasures(Protocol[T_co]):
    """Values of both measures."""

    @property
    def dbs(self) -> T_co: ...

    @property
    def strict(self) -> T_co: ...


class Measure(StrEnum):
    """A measure of a campaign's result."""

    DBS = "dbs"
    STRICT = "strict"

    def of(self, figures: _BothMeasures[T_co]) -> T_co:
        """Return the values of this measure, shape ``(fractions, len(PAPER_T_BS), len(D_THS))``."""
        return figures.dbs if self is Measure.DBS else figures.strict
