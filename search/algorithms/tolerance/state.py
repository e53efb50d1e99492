"""The state of `tolerance@1`: the purpose of each candidate."""

from dataclasses import dataclass
from enum import IntEnum

from brink.search.algorithms.ledger import LedgerState
from brink.search.algorithms.tolerance.settings import ToleranceConfig
from brink.search.space import IntArray


class Purpose(IntEnum):
    """Why a candidate is simulated. The numbers are stored."""

    TRUTH = 0
    """Without an error; of a population."""
    SCREENING = 1
    """With the most severe error; of a group."""
    ERROR = 2
    """Of a cell."""
    AUDIT = 3
    """Of a cell, in a drive that is assumed to hold."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToleranceState(LedgerState):
    """State of the search.

    Attributes:
        config: Settings.
        jobs: Purpose, population, group or cell, and drive of each candidate, by its number, shape ``(n, 3)``.
        roots: Number of the candidate whose episode seed a drive has, by the number of the drive.
    """

    config: ToleranceConfig
    jobs: IntArray
    roots: tuple[int, ...]

    @property
    def drives(self) -> list[int]:
        """The drive of each candidate, by its number."""
        drives: list[int] = self.jobs[:, 2].tolist()
        return drives
