"""Choices and defaults of analyses: cheap to import."""

from enum import StrEnum
from typing import Final

LEAST_OF_A_VERDICT: Final = 10
"""Minimum number of solutions of each verdict to which trees are fitted."""
RADII: Final = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5)
P_THS: Final = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5)
"""Default settings of a sensitivity analysis."""


class Model(StrEnum):
    """A kind of model."""

    TREES = "trees"
    NEIGHBOURS = "neighbours"
