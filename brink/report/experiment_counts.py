"""Parts of the report of an experiment that pairs and thresholds share: shares, and comparisons of methods."""

from collections.abc import Sequence
from enum import StrEnum
from typing import Final, TypeVar

from brink.report.text import p_text, table_row
from brink.search.analysis.count_comparison import CountDuel, Proportion

M = TypeVar("M", bound=StrEnum)
DASH: Final = "–"


def share_cell(value: Proportion | None, total: int, none: str, *, tried: int = 0) -> str:
    """Return a share with its interval, or why there is none.

    Args:
        value: The share.
        total: What it is a share of; 0 if there is nothing.
        none: What is said if there is nothing.
        tried: How many were simulated with other seeds.
    """
    if value is not None:
        return f"{value.share:.0%} [{value.low:.0%}, {value.high:.0%}], {value.count:,} of {value.of:,}"
    if not total:
        return none
    return "too few drives" if tried else "not tried"


def duel_words(duel: CountDuel[M], measured: str) -> str:
    """Return a comparison of two methods in words.

    Args:
        duel: The comparison.
        measured: What is compared, in the plural.
    """
    figures = f"{duel.first_mean:.1f} {measured} against {duel.second_mean:.1f}"
    if duel.result.p_value is None:
        return f"**{duel.first}** and **{duel.second}**: {figures}; {duel.says}."
    return (
        f"**{duel.first}** and **{duel.second}**: {figures}, A12 {duel.result.a12:.2f} ({duel.size}), "
        f"p {p_text(duel.result.p_value)}, corrected {p_text(duel.adjusted)}; {duel.says}."
    )


def duels_table(duels: Sequence[CountDuel[M]], measured: str) -> str:
    """Return comparisons as a table with its legend.

    Args:
        duels: At least one comparison.
        measured: What is compared, in the plural.
    """
    names = ["methods", measured, "U", "p", "corrected p", "A12", "conclusion"]
    rows = [table_row(names), table_row(["---"] * len(names))]
    for one in duels:
        adjusted = p_text(one.adjusted)
        rows.append(
            table_row(
                [
                    f"{one.first} : {one.second}",
                    f"{one.first_mean:.1f} : {one.second_mean:.1f}",
                    f"{one.result.u:g}",
                    p_text(one.result.p_value),
                    f"**{adjusted}**" if one.differs else adjusted,
                    f"{one.result.a12:.2f} {one.size}",
                    one.says,
                ]
            )
        )
    legend = (
        "*A12: probability that the first exceeds the second. Corrected: Holm's correction over the comparisons of "
        f"this table whose values differ. Bold: p at most {duels[0].level:g}.*"
    )
    return "\n".join(rows) + f"\n\n{legend}"
