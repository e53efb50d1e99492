"""Magnitudes of perception errors, shared by all simulators."""

from dataclasses import dataclass
from typing import Final

MODE: Final = "errors"
"""The mode of a behaviour that consists of errors."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Magnitude:
    """The magnitude of a type of error.

    Attributes:
        unit: Its unit; a share is a fraction of 1.
        none: The magnitude without effect, at severity 0.
        most: The magnitude at severity 1.
        meaning: What it measures.
        has_window: Whether the error begins at an onset; otherwise it holds for the whole episode.
        has_duration: Whether the window's length is a parameter of its own, and not the magnitude.
    """

    unit: str
    none: float
    most: float
    meaning: str
    has_window: bool = True
    has_duration: bool = False

    def at(self, severity: float) -> float:
        """Return the magnitude of a severity in [0, 1]."""
        return self.none + severity * (self.most - self.none)

    def severity(self, magnitude: float) -> float:
        """Return the severity of a magnitude; above 1 beyond the studied range."""
        return max((magnitude - self.none) / (self.most - self.none), 0.0)

    @property
    def shown_unit(self) -> str:
        """The unit in which the magnitude is displayed."""
        return "%" if self.unit == "share" else self.unit

    def number(self, magnitude: float) -> float:
        """Return a magnitude in the displayed unit."""
        return 100.0 * magnitude if self.unit == "share" else magnitude

    def words(self, magnitude: float) -> str:
        """Return a magnitude with its unit, such as ``1.3 s`` or ``18%``."""
        return f"{100.0 * magnitude:.0f}%" if self.unit == "share" else f"{magnitude:.1f} {self.unit}"
