"""The candidates with which the simulator's difficulty is measured are those that a campaign draws."""

from collections import Counter

import numpy as np
import pytest

from brink.search.component import FloatArray
from brink.search.metric import Metric
from brink.server.problems.base import SimulatedProblem
from brink.server.problems.catalogue import make_problem
from brink.sim.urban.draws import CATEGORICAL, PARAMETERS, Draw, distance, draw, neighbour, redraw

PROBLEM = make_problem("urban-injected@1", {})
SPACE = PROBLEM.space


def vectors(candidate: Draw) -> tuple[FloatArray, ...]:
    """Return a draw in the encoding of the search space."""
    values = [candidate.values[name] for name in PARAMETERS]
    encoded, start = [], 0
    for component in SPACE.components:
        end = start + component.dimension
        encoded.append(
            np.array(
                [
                    p.encode(str(v) if name in CATEGORICAL else v)
                    for p, name, v in zip(
                        component.parameters, PARAMETERS[start:end], values[start:end], strict=True
                    )
                ]
            )
        )
        start = end
    return tuple(encoded)


@pytest.mark.parametrize("seed", range(30))
def test_what_is_drawn_redrawn_or_moved_complies_with_the_search_space(seed: int) -> None:
    rng = np.random.default_rng(seed)
    base = draw(rng)
    changeable = [name for name in PARAMETERS if name in CATEGORICAL or not base.is_null(int(name[0]))]
    for candidate in (base, *(redraw(base, name, rng) for name in changeable), neighbour(base, rng)):
        for component, vector in zip(SPACE.components, vectors(candidate), strict=True):
            assert list(component.problems(vector)) == []


def test_the_distance_is_that_of_the_search_space() -> None:
    rng = np.random.default_rng(0)
    for _ in range(30):
        one, other = draw(rng), draw(rng)
        rows = (SPACE.join(vectors(candidate))[None] for candidate in (one, other))
        expected = Metric.of_space(SPACE).between(*rows)[0, 0]
        assert distance(one, other) == pytest.approx(expected, abs=1e-12)


def test_one_draws_as_the_other_does() -> None:
    """Means within five standard errors, for every parameter; labels and smallest boxes as often."""
    count = 3000
    mine = [np.concatenate(vectors(draw(np.random.default_rng(i)))) for i in range(count)]
    theirs = [SPACE.join(SPACE.sample(np.random.default_rng((1, i)))) for i in range(count)]
    for index, (a, b) in enumerate(zip(np.transpose(mine), np.transpose(theirs), strict=True)):
        error = np.sqrt((a.var() + b.var()) / count)
        assert abs(a.mean() - b.mean()) <= 5 * error, PARAMETERS[index]
    smallest = [
        Counter(bool(abs(row[11] - row[10] - 50.0) < 1e-9) for row in rows)[True] for rows in (mine, theirs)
    ]
    assert abs(smallest[0] - smallest[1]) < 0.05 * count


def test_an_episode_of_a_draw_is_that_of_its_vectors() -> None:
    assert isinstance(PROBLEM, SimulatedProblem)
    candidate = draw(np.random.default_rng(3))
    spec = candidate.spec(5, ("front-gap@1",))
    episode = PROBLEM.episode(vectors(candidate), 5)
    assert episode.scenario == spec.scenario
    trajectories = spec.behaviour["trajectories"]
    assert isinstance(trajectories, list)
    live = [t for t in trajectories if isinstance(t, dict) and t["label"] != "null"]
    assert episode.behaviour["trajectories"] == live
