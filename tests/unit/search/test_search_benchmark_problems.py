import math

import numpy as np
import pytest

from brink.search.algorithms.mlcshe import Mlcshe
from brink.search.algorithms.random_search import RandomSearch
from brink.search.archive import Archive
from brink.search.boundary import dbs_grid, distinct_boundary
from brink.search.problems import mtq, onemax
from brink.search.testing import play


def test_mtq_known_values() -> None:
    assert mtq.robustness(0.75, 0.75) == 50.0
    assert mtq.robustness(0.25, 0.25) == -50.0
    assert mtq.robustness(0.75 + mtq.SAFE_RADIUS, 0.75) == pytest.approx(0.0, abs=1e-9)
    assert mtq.robustness(0.0, 1.0) == pytest.approx(150 * (1 - 10 * (0.5625 + 0.0625)) - 100)


def test_mtq_is_safe_in_the_disc_and_nowhere_else() -> None:
    points = np.random.default_rng(0).random((2000, 2))
    for x, y in points.tolist():
        inside = math.hypot(x - 0.75, y - 0.75) <= mtq.SAFE_RADIUS
        verdict = mtq.evaluate((np.array([x]), np.array([y])))
        assert verdict.unsafe == (not inside)
        assert verdict.unsafe == (verdict.robustness < 0)
    assert mtq.gap_to_boundary(0.75, 0.75) == pytest.approx(mtq.SAFE_RADIUS)


def test_onemax_known_values() -> None:
    def solution(ones: int) -> tuple[np.ndarray, np.ndarray]:
        row = np.repeat([1.0, 0.0], [ones, 20 - ones])
        left, right = onemax.SPACE.split(row)
        return left, right

    assert [onemax.evaluate(solution(n)).unsafe for n in (0, 4, 5, 20)] == [True, True, False, False]
    assert onemax.evaluate(solution(7)).robustness == 2.0
    assert onemax.SPACE.size == 2**20


def mtq_archive(algorithm: Mlcshe | RandomSearch, seed: int) -> Archive:
    config = algorithm.config_type(radius=mtq.RADIUS)
    return play(
        algorithm, mtq.SPACE, config, lambda c: mtq.evaluate(c.vectors), seed=seed, budget=1000
    ).archive


def test_mlcshe_finds_the_circle_that_bounds_the_safe_disc() -> None:
    for seed in range(3):
        archive = mtq_archive(Mlcshe(), seed)
        found = distinct_boundary(archive, 0.10, 0.05, strict=True)
        assert found.size >= 2
        gaps = [mtq.gap_to_boundary(*archive.vectors[i].tolist()) for i in found]
        # A tenth of a neighbourhood (|dx| + |dy| <= 0.1) is unsafe where its centre lies about 0.05 inside.
        assert max(gaps) < 0.08
        assert dbs_grid(mtq_archive(RandomSearch(), seed), (0.10,), (0.05,)).dbs[0, 0] == 0


def test_mlcshe_finds_boundary_solutions_of_onemax_that_random_search_does_not() -> None:
    found = {}
    for algorithm in (Mlcshe(), RandomSearch()):
        config = algorithm.config_type(radius=onemax.RADIUS)
        archive = play(
            algorithm, onemax.SPACE, config, lambda c: onemax.evaluate(c.vectors), seed=4, budget=5000
        ).archive
        found[algorithm.id] = archive.vectors[distinct_boundary(archive, 0.10, 0.1, strict=True)]
    assert len(found["random@1"]) == 0
    assert len(found["mlcshe@1"]) >= 5
    # Unsafe are fewer than five bits; a neighbour differs in at most two.
    assert set(found["mlcshe@1"].sum(axis=1)) <= {5.0, 6.0}
