"""What simulations show of a solution, a rate or a threshold: plain enumerations, cheap to import."""

from enum import StrEnum


class Conclusion(StrEnum):
    """What the repeats of one solution show about its unsafe probability."""

    BELOW = "below"
    """Its interval lies below p_th: safer than the boundary."""
    ABOVE = "above"
    """Its interval lies above p_th: less safe than the boundary."""
    NEAR = "near"
    """It meets the criterion of the boundary itself: both verdicts, and an interval close to p_th."""
    INCONCLUSIVE = "inconclusive"
    """Its interval contains p_th, but shows no more than that, for example after few simulations."""


class Decision(StrEnum):
    """What simulations say of a claim that a rate is at most some limit."""

    SHOWN = "shown"
    REFUTED = "refuted"
    NOT_SHOWN = "not shown"


class Outcome(StrEnum):
    """The conclusion of an estimation."""

    OPEN = "open"
    """More simulations are needed."""
    THRESHOLD = "threshold"
    """The probability passes from 20 to 80% within a fifth of the range."""
    CHANCY = "chancy"
    """It does not."""
