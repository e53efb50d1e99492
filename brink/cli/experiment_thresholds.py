"""The thresholds of an experiment, printed."""

from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.text import Text

from brink.cli.options import plain_table
from brink.report.experiment_thresholds import COLUMNS, distance_words, standing_cells, threshold_sentences
from brink.search.analysis.count_comparison import problems_of
from brink.search.analysis.threshold_comparison import ThresholdCounts, ThresholdRepeat, threshold_standings
from brink.server.api.experiment_thresholds import ExperimentThresholds


def threshold_repeats_of(thresholds: ExperimentThresholds) -> list[ThresholdRepeat]:
    """Return the thresholds of the finished campaigns."""
    return [
        ThresholdRepeat(
            problem=one.problem,
            method=one.method,
            seed=one.seed,
            campaign=one.campaign,
            computed=one.computed,
            counts=ThresholdCounts(**{name: getattr(one, name) or 0 for name in ThresholdCounts.__slots__}),
        )
        for one in thresholds.repeats
    ]


def print_experiment_thresholds(screen: Console, thresholds: ExperimentThresholds) -> None:
    """Print the thresholds of each method, and how methods compare."""
    repeats = threshold_repeats_of(thresholds)
    if not repeats:
        screen.print("no campaign has finished yet")
        return
    for problem in problems_of(repeats):
        screen.print(_table(repeats, problem, thresholds.counted), "")
        screen.print(distance_words(thresholds.d_th), soft_wrap=True, style="dim")
        for sentence in threshold_sentences(repeats, problem, level=thresholds.alpha):
            text = sentence.replace("**", "").rstrip()
            screen.print(text, soft_wrap=True)
        screen.print()


def _table(repeats: Sequence[ThresholdRepeat], problem: str, campaigns: int) -> Any:
    table = plain_table("", *COLUMNS, right=COLUMNS, title=f"{problem}: thresholds, {campaigns} campaigns")
    ours = [one for one in repeats if one.problem == problem]
    for one in threshold_standings(ours):
        table.add_row(Text(one.method), *map(Text, standing_cells(one, computed=ours[0].computed)))
    return table
