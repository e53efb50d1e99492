"""Choices and defaults of guards: cheap to import, also for guards in a car, which have numpy alone."""

from enum import StrEnum
from typing import Final

DEFAULT_PROBLEM: Final = "urban-injected@1"
"""The problem that is driven unless another is named."""
FALSE_ALARMS: Final = 0.05
"""The share of safe drives with an alarm at which predictors are compared."""
FIRST_SEED: Final = 9001
"""Campaigns usually have small seeds, so that these drives are fresh."""
LIMITS: Final = (0.001, 0.999)
"""Smallest and largest threshold."""


class Sensor(StrEnum):
    """The sensors of a car besides its obstacle detector."""

    BOXES = "boxes"
    """Nothing."""
    RANGE = "range"
    """A coarse forward range sensor."""
