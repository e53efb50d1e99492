"""Measured figures, each with its target beside it."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One measured figure.

    Attributes:
        what: What was measured.
        value: The figure.
        target: What it should be, in words; empty if there is no target.
        met: Whether it is; None if there is no target.
        note: Sample sizes and further figures.
    """

    what: str
    value: float
    target: str
    met: bool | None
    note: str = ""
