"""What can be concluded from one line of an experiment's tables beside another, in words.

A control that reads low proves nothing, whatever the test says; a p-value that does not survive its correction is no
difference.
"""

from collections.abc import Collection, Sequence

from brink.search.analysis.experiment_tables import Duel, Repeat

LEVEL = 0.05
"""Of an adjusted p-value at which a difference is called one."""


def conclusion(duel: Duel, first: float, second: float, low: Collection[str]) -> str:
    """Return what a duel says, as the end of a sentence about its figures.

    Args:
        duel: One line against another.
        first: Mean of the first line.
        second: Mean of the second.
        low: The methods of this problem whose control reads low.
    """
    differs, alone = duel.adjusted <= LEVEL, duel.result.p_value <= LEVEL
    chance = "by itself that would be a difference, but among so many comparisons it may be chance"
    if duel.second.control:
        if duel.first.method in low:
            return "the control reads low here, so that this proves nothing"
        if differs and first > second:
            return f"more than scenarios and chance give: {first - second:.1f} are owed to behaviour"
        if alone and first > second:
            return f"more than scenarios and chance give? {chance}"
        return "no more than scenarios and chance give, as far as these repeats can tell"
    if not differs:
        return chance if alone else "these repeats show no difference"
    better = duel.first.method if duel.result.a12 > 0.5 else duel.second.method
    return f"{better} finds more"


def with_low_controls(repeats: Sequence[Repeat], problem: str | None = None) -> list[str]:
    """Return the methods whose control reads low, with any of their seeds; on one problem, or on any."""
    return sorted(
        {
            one.method
            for one in repeats
            if one.scores.control and one.scores.control.reads_low and problem in (None, one.problem)
        }
    )
