"""Figure: how the Pareto front of criticality and diversity moved, generation by generation."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from brink.plots.style import MUTED, UNSAFE, WIDTH_PX, frame, new_figure, say
from brink.search.algorithms.multi_objective import History, MultiObjectiveConfig, diversities
from brink.search.pareto import first_front
from brink.search.space import FloatArray, SearchSpace
from brink.search.traffic.variation import TrafficGenome

HEIGHT_PX: Final = 760
SHOWN: Final = 5
"""Fronts that are drawn: the first, the last, and some between."""

_SHADES: Final = ("#c6dbef", "#9ecae1", "#6baed6", "#2171b5", "#08306b")


def figure_fronts(
    title: str,
    space: SearchSpace,
    vectors: FloatArray,
    ends: Sequence[int],
    criticality: FloatArray,
    config: MultiObjectiveConfig,
) -> Figure:
    """Return the fronts of all solutions known after some generations.

    Diversity is that of a solution when it was told: its distance to what had been tried lately.

    Args:
        title: Of the campaign.
        space: What was searched; has participants.
        vectors: Of the archive, ascending by number, shape ``(n, d)``.
        ends: How many solutions the archive had after each generation.
        criticality: In m, shape ``(n,)``.
        config: The algorithm's settings.
    """
    figure = new_figure(
        HEIGHT_PX,
        f"{title}: what is critical and new",
        "Each line is the Pareto front of all solutions known after a generation: nobody is nearer to a violation\n"
        "and at the same time farther from what was tried in the generations before. Left of 0 somebody is hit.",
    )
    axes = figure.add_subplot()
    figure.subplots_adjust(left=100 / WIDTH_PX, right=1 - 60 / WIDTH_PX, top=0.82, bottom=0.1)
    frame(axes)
    axes.set_xlabel("criticality: least gap to anybody (m)")
    axes.set_ylabel("diversity: distance to what was tried lately (m)")
    known = [end for end in ends if end > 0]
    if not known:
        say(axes, "no generation is finished yet")
        return figure
    diversity = told_diversities(space, vectors, ends, config)
    axes.scatter(criticality, diversity, s=9, color=MUTED, alpha=0.25, linewidths=0)
    axes.axvline(0.0, color=UNSAFE, linewidth=1)
    chosen = np.unique(np.linspace(0, len(known) - 1, SHOWN).round().astype(int)).tolist()
    for place, shade in zip(chosen, _SHADES[-len(chosen) :], strict=True):
        end = known[place]
        front = first_front(criticality[:end], -diversity[:end])
        axes.plot(
            criticality[front], diversity[front], "o-", color=shade, markersize=4, linewidth=1.6,
            label=f"{end} solutions",
        )  # fmt: skip
    axes.legend(frameon=False, title="known")
    return figure


def told_diversities(
    space: SearchSpace, vectors: FloatArray, ends: Sequence[int], config: MultiObjectiveConfig
) -> FloatArray:
    """Return how far each solution was from what had been tried lately when it was told, in m, shape ``(n,)``."""
    genome = TrafficGenome.of(space)
    generations = np.searchsorted(ends, np.arange(len(vectors)), side="right").astype(np.float64)
    found = np.zeros(len(vectors))
    start = 0
    for end in ends:
        numbers = list(range(start, end))
        if numbers:
            none = np.zeros(end)
            book = History(
                rows=vectors[:end], criticality=none, gaps=np.zeros((end, genome.max_participants)), unsafe=none,
                generations=generations[:end], origins=none,
            )  # fmt: skip
            found[numbers] = diversities(genome, book, numbers, config)
        start = end
    return found
