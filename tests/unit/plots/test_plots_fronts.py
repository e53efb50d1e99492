"""The figure of fronts: what it draws, and the diversity that it recomputes."""

import numpy as np
import pytest

from brink.plots.fronts import figure_fronts, told_diversities
from brink.search.algorithm import Scored
from brink.search.algorithms.multi_objective import CRITICALITY
from brink.search.algorithms.nsga2 import Nsga2, Nsga2Config
from brink.search.space import SearchSpace
from brink.search.traffic.constraint import participants_component
from brink.search.traffic.participants import RoadLimits

SPACE = SearchSpace((participants_component("npcs", 2, RoadLimits()),))
CONFIG = Nsga2Config(population_size=10)


def test_diversity_is_what_the_search_saw_when_it_was_told() -> None:
    algorithm = Nsga2()
    state = algorithm.start(SPACE, CONFIG, seed=1, budget=40)
    ends, seen = [], {}
    while not algorithm.finished(state):
        state, candidates = algorithm.ask(state)
        answers = {
            c.number: Scored(unsafe=False, robustness=1.0, objectives={CRITICALITY: 1.0 + c.number})
            for c in candidates
        }
        before = len(state.history)
        state = algorithm.tell(state, answers)
        ends.append(len(state.archive))
        fresh = {n: d for n, d in zip(state.population, state.diversity.tolist(), strict=True) if n >= before}
        seen.update(fresh)
    assert seen
    found = told_diversities(SPACE, state.archive.vectors, ends, CONFIG)
    for number, diversity in seen.items():
        assert found[number] == pytest.approx(diversity)
    figure = figure_fronts("npcs", SPACE, state.archive.vectors, ends, 1.0 + np.arange(40.0), CONFIG)
    (axes,) = figure.axes
    drawn = [line for line in axes.lines if str(line.get_label()).endswith("solutions")]
    assert [line.get_label() for line in drawn] == [f"{end} solutions" for end in ends]
    for line in drawn:
        heights = np.asarray(line.get_ydata(), np.float64)
        assert (np.diff(heights) > 0).all() or len(heights) == 1


def test_without_a_generation_it_says_so() -> None:
    figure = figure_fronts("npcs", SPACE, np.empty((0, SPACE.dimension)), [], np.empty(0), CONFIG)
    assert any("no generation" in text.get_text() for axes in figure.axes for text in axes.texts)
