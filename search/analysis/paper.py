"""The paper's thresholds, shares of the budget and measures: plain values, cheap to import.

Source: Sharifi et al. 2023, section 5.
"""

from enum import StrEnum
from typing import Protocol, TypeVar

T_co = TypeVar("T_co", covariant=True)

PAPER_T_BS = (0.01, 0.03, 0.05, 0.10, 0.15, 0.20)
PAPER_D_THS = (0.1, 0.2, 0.3)
PAPER_FRACTIONS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
PAPER_BUDGET = 1_300


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
        """Return the values of this measure, shape ``(fractions, len(PAPER_T_BS), len(PAPER_D_THS))``."""
        return figures.dbs if self is Measure.DBS else figures.strict
