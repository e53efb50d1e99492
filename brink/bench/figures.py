"""Measured figures and their targets."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One measured figure.

    Attributes:
        what: Name of the measurement.
        value: The figure.
        target: The target in words; empty if there is none.
        met: Whether the target is met; None if there is none.
        note: Sample sizes and further figures.
    """

    what: str
    value: float
    target: str
    met: bool | None
    note: str = ""
