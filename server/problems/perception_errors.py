"""What problems with errors of perception share: a variant without errors, and severities in physical units."""

from typing import Any, Final, Self

from brink.server.problems.base import SeverityScale
from brink.sim.perception_errors import Magnitude

NO_ERROR: Final = "none"
"""The type of an error that is none."""


class HasTrueVariant:
    """A problem that can also be simulated with a perception that is true.

    Attributes:
        params: Its parameters, the only argument of its constructor.
        is_true: Whether the perception is true.
    """

    params: Any
    is_true: bool = False

    def with_truth(self) -> Self | None:
        """Return the same problem with a perception that is true; None if this is it."""
        if self.is_true:
            return None
        found = type(self)(self.params)  # type: ignore[call-arg]
        found.is_true = True
        return found


def severity_scale(magnitude: Magnitude) -> SeverityScale:
    """Return what severities mean, given the magnitude of a type of error."""
    return SeverityScale(
        unit=magnitude.shown_unit,
        none=magnitude.number(magnitude.none),
        most=magnitude.number(magnitude.most),
        meaning=magnitude.meaning,
        decimals=0 if magnitude.shown_unit == "%" else 1,
    )
