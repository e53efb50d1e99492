"""Resolutions of the parameters of problems: differences that people would call the same."""

from collections.abc import Mapping
from enum import StrEnum
from typing import Any, Final

from brink.search.parameters import ResolutionByChoice
from brink.sim.perception_errors import Magnitude

RESOLUTION_S: Final = 0.1
RESOLUTION_M: Final = 0.25
RESOLUTION_MPS2: Final = 0.1
RESOLUTION_PX: Final = 8.0
RESOLUTION_SHARE: Final = 0.01
_BY_UNIT: Final[Mapping[str, float]] = {"s": RESOLUTION_S, "m": RESOLUTION_M, "share": RESOLUTION_SHARE}


def severity_resolution(label: str, magnitudes: Mapping[Any, Magnitude]) -> ResolutionByChoice:
    """Return the resolution of a severity, so that its magnitude has the resolution of the magnitude's unit.

    Args:
        label: Name of the parameter that chooses the type of error.
        magnitudes: The magnitude of each type; types whose unit has no resolution keep the default.
    """
    by_choice = {}
    for kind, magnitude in magnitudes.items():
        assert isinstance(kind, StrEnum)
        if magnitude.unit in _BY_UNIT:
            by_choice[kind.value] = _BY_UNIT[magnitude.unit] / abs(magnitude.most - magnitude.none)
    return ResolutionByChoice(label, by_choice)
