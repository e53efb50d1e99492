"""The pairs across the boundary of an experiment, printed."""

from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.text import Text

from brink.cli.options import plain_table
from brink.report.experiment_pairs import (
    COLUMNS,
    left_out_sentences,
    pair_sentences,
    settings_words,
    standing_cells,
)
from brink.search.analysis.count_comparison import problems_of
from brink.search.analysis.pair_comparison import PairCounts, PairRepeat, pair_standings
from brink.server.api.experiment_pairs import ExperimentPairs


def pair_repeats_of(pairs: ExperimentPairs) -> list[PairRepeat]:
    """Return the pairs of the finished campaigns."""
    return [
        PairRepeat(
            problem=one.problem,
            method=one.method,
            seed=one.seed,
            campaign=one.campaign,
            computed=one.computed,
            counts=PairCounts(**{name: getattr(one, name) or 0 for name in PairCounts.__slots__}),
        )
        for one in pairs.repeats
    ]


def print_experiment_pairs(screen: Console, pairs: ExperimentPairs) -> None:
    """Print the pairs of each method, and how methods compare."""
    repeats = pair_repeats_of(pairs)
    for sentence in left_out_sentences(pairs.left_out):
        text = sentence.replace("**", "").rstrip()
        screen.print(text, soft_wrap=True)
    if not repeats and not pairs.left_out:
        screen.print("no campaign has finished yet")
        return
    for problem in problems_of(repeats):
        screen.print(_table(repeats, problem, pairs.counted), "")
        screen.print(settings_words(pairs.eps, pairs.d_th), soft_wrap=True, style="dim")
        for sentence in pair_sentences(repeats, problem, level=pairs.alpha):
            text = sentence.replace("**", "").rstrip()
            screen.print(text, soft_wrap=True)
        screen.print()


def _table(repeats: Sequence[PairRepeat], problem: str, campaigns: int) -> Any:
    table = plain_table(
        "", *COLUMNS, right=COLUMNS, title=f"{problem}: pairs across the boundary, {campaigns} campaigns"
    )
    ours = [one for one in repeats if one.problem == problem]
    for one in pair_standings(ours):
        table.add_row(Text(one.method), *map(Text, standing_cells(one, computed=ours[0].computed)))
    return table
