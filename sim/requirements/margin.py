"""The bookkeeping that most requirements share: smallest robustness so far, first violation, finite bounds."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping

from brink.sim.episode import Json, Verdict
from brink.sim.requirements.requirement import WorldSample


class Margin(ABC):
    """Base of requirements that have a robustness at each control step by itself.

    A subclass sets `unit` and `horizon` and implements `robustness_at`.
    """

    unit = "m"
    horizon = 50.0

    def __init__(self) -> None:
        self._smallest = self.horizon
        self._violated_at_s: float | None = None

    @abstractmethod
    def robustness_at(self, sample: WorldSample) -> float:
        """Return the robustness at a sample; `observe` cuts it at the horizon."""

    def observe(self, sample: WorldSample) -> float:
        """Take the next control step and return the robustness at it, finite.

        Raises:
            ValueError: The robustness is not a number: the sample holds a NaN.
        """
        robustness = self.robustness_at(sample)
        horizon = self.horizon
        if robustness > horizon:
            robustness = horizon
        elif robustness < -horizon:
            robustness = -horizon
        elif math.isnan(robustness):
            raise ValueError(
                f"{type(self).__name__}: the sample at {sample.time_s} s holds a NaN: {sample!r}"
            )
        if robustness < self._smallest:
            self._smallest = robustness
        if robustness < 0.0 and self._violated_at_s is None:
            self._violated_at_s = sample.time_s
        return robustness

    def verdict(self) -> Verdict:
        """Return the smallest robustness so far (the horizon before any sample) and the first violation."""
        return Verdict(robustness=self._smallest, unit=self.unit, violated_at_s=self._violated_at_s)

    def features(self) -> Mapping[str, Json]:
        """Return further facts of the episode that this requirement knows, by name."""
        return {}
