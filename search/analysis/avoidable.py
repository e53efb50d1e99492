"""Who would have avoided a violation, as the simulator measured it: reference drivers among the same road users.

What a careful driver avoids, a driving system should avoid. Apart from the other analyses, which need numpy.
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import Any, Final


class Avoidable(StrEnum):
    """Who would have avoided a violation, best first: what a careful driver avoids, a system should avoid."""

    CAREFUL = "careful"
    """The careful driver of UN Regulation No. 157."""
    IDEAL = "ideal"
    """Only a driver who brakes at once."""
    NO = "no"
    """Neither."""

    @property
    def words(self) -> str:
        """The phrase for such a violation."""
        return _AVOIDABLE[self]

    @property
    def by(self) -> str:
        """The driver, as shown in tables."""
        return _BY[self]


_AVOIDABLE: Final = {
    Avoidable.CAREFUL: "avoidable by a careful driver",
    Avoidable.IDEAL: "avoidable only by braking at once",
    Avoidable.NO: "not avoidable by braking",
}
_BY: Final = {Avoidable.CAREFUL: "careful driver", Avoidable.IDEAL: "ideal driver", Avoidable.NO: "neither"}
NOT_MEASURED: Final = "not measured"
"""What a table says where it is not known who would have avoided a violation."""
EXPLANATION: Final = (
    "The careful driver is that of UN Regulation No. 157, Annex 3: keeps the lane, sees everybody, takes 0.4 s to "
    "judge a risk and 0.75 s to reach the brake, and brakes with up to 0.774 g. The ideal driver brakes at once. "
    "Neither swerves."
)
"""Who the reference drivers are, in sentences."""


class AvoidedBy(StrEnum):
    """How the reference driver who avoids a violation does so."""

    BRAKING = "braking"
    """By having braked, for a road user or a red light, before the time of the violation."""
    DRIVING_ON = "driving on"
    """Without: it had passed earlier, or kept its lane."""


def avoided_by_of(violation: Mapping[str, Any]) -> AvoidedBy | None:
    """Return how the driver who avoids a violation does so; None if none does, or that was not recorded.

    Args:
        violation: Its circumstances, as reported by the encounter simulators.
    """
    recorded = violation.get("avoided_by")
    return next((one for one in AvoidedBy if one == recorded), None)


def by_words(avoidable: Avoidable | None) -> str:
    """Return who would have avoided a violation, for a table."""
    return NOT_MEASURED if avoidable is None else avoidable.by


def avoidable_first(avoidable: Avoidable | None) -> int:
    """Return a sort key that puts first the violations that a careful driver would have avoided."""
    return _PLACES[avoidable]


_PLACES: Final[Mapping[Avoidable | None, int]] = {
    Avoidable.CAREFUL: 0,
    Avoidable.IDEAL: 1,
    Avoidable.NO: 2,
    None: 2,
}


def avoidable_of(violation: Mapping[str, Any]) -> Avoidable | None:
    """Return who would have avoided a violation; None if that was not measured.

    Args:
        violation: Its circumstances, as reported by the encounter simulators.
    """
    recorded = violation.get("avoidable")
    return next((one for one in Avoidable if one == recorded), None)
