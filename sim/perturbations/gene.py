"""What a perturbation technique is: a gene with numbered levels, weakest first; and what a frame is.

Plain data, without OpenCV, so that a coordinator can build a search space of genes that only workers can apply.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from brink.sim.perturbations.errors import InvalidPerturbation

Frame: TypeAlias = npt.NDArray[np.uint8]
"""A picture: RGB, uint8, shape ``(height, width, 3)``."""

Transform: TypeAlias = Callable[[Frame, float, np.random.Generator], Frame]
"""Returns a new frame from (frame, value of a level, generator). Pure: the frame it is given is read-only."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Gene:
    """A technique of perturbation.

    Attributes:
        name: Such as ``gaussian_noise``.
        values: Parameter of levels 1, 2, ..., so that strength never falls with the level. Level 0 has none: it is
            "no effect".
        unit: What the values are, such as ``px``.
        effect: What it does to a frame, in one sentence.
    """

    name: str
    values: tuple[float, ...]
    unit: str
    effect: str

    def __post_init__(self) -> None:
        if not self.values:
            raise InvalidPerturbation(f"{self.name}: expected at least one value beside level 0, got none")

    @property
    def levels(self) -> int:
        """Number of levels, "no effect" included."""
        return len(self.values) + 1

    @property
    def representative_levels(self) -> tuple[int, ...]:
        """The lowest, middle and highest level that have an effect, each once."""
        return tuple(dict.fromkeys((1, self.levels // 2, self.levels - 1)))

    def value(self, level: int) -> float | None:
        """Return the parameter of a level, None for level 0.

        Raises:
            InvalidPerturbation: There is no such level.
        """
        self.check(level)
        return self.values[level - 1] if level else None

    def intensity(self, level: int) -> float:
        """Return the rank of a level in [0, 1]: 0 for no effect, 1 for the strongest.

        The rank, never the value: the values of `shifted_pixels` fall while its strength rises.

        Raises:
            InvalidPerturbation: There is no such level.
        """
        self.check(level)
        return level / (self.levels - 1)

    def check(self, level: int) -> None:
        """Check the index of a level.

        Raises:
            InvalidPerturbation: There is no such level.
        """
        if isinstance(level, bool) or not isinstance(level, int) or not 0 <= level < self.levels:
            raise InvalidPerturbation(
                f"{self.name}: expected a level in 0 to {self.levels - 1} (0 has no effect), got {level!r}"
            )
