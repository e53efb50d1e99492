import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from brink.search.analysis.similarity import embedded
from brink.search.archive import Archive, Neighbourhood
from brink.search.metric import Metric
from brink.search.testing import example_spaces

NEAR = Neighbourhood(radius=0.3, p_th=0.1)
MIXED = example_spaces()["mixed"]


def archive_of(metric: Metric, rows: NDArray[np.float64]) -> Archive:
    count = len(rows)
    return Archive.empty(metric, NEAR).grown(
        np.arange(count), rows, np.zeros(count, bool), np.ones(count), keep_rows=False
    )


def mixed_archive(count: int) -> Archive:
    rng = np.random.default_rng(0)
    return archive_of(Metric.of_space(MIXED), np.array([MIXED.join(MIXED.sample(rng)) for _ in range(count)]))


def test_points_on_a_line_are_mapped_onto_a_line() -> None:
    rows = np.random.default_rng(0).random((40, 1))
    embedding = embedded(archive_of(Metric([1.0], [False]), rows))
    assert np.allclose(pdist(embedding.points), pdist(rows), atol=1e-9)
    assert np.allclose(embedding.points[:, 1], 0)
    assert embedding.explained == pytest.approx(1.0)


@pytest.mark.parametrize("exact_points", [2000, 50])
def test_distances_on_the_map_correlate_with_real_distances(exact_points: int) -> None:
    archive = mixed_archive(200)
    embedding = embedded(archive, exact_points=exact_points, landmarks=100)
    distance = archive.distances(range(200), range(200))[np.triu_indices(200, 1)]
    assert np.corrcoef(pdist(embedding.points), distance)[0, 1] > 0.7
    assert 0.3 < embedding.explained < 1


def test_landmarks_for_all_points_give_the_exact_map() -> None:
    archive = mixed_archive(120)
    exact = embedded(archive)
    landmarked = embedded(archive, exact_points=10, landmarks=120)
    assert np.allclose(exact.points, landmarked.points, atol=1e-9)


def test_map_is_reproducible_and_its_axes_point_to_the_most_distant_solution() -> None:
    archive = mixed_archive(150)
    first, second = embedded(archive), embedded(archive)
    assert np.array_equal(first.points, second.points)
    for axis in range(2):
        column = first.points[:, axis]
        assert column[np.abs(column).argmax()] > 0


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_a_few_solutions_have_a_map(count: int) -> None:
    embedding = embedded(mixed_archive(3).first(count))
    assert embedding.points.shape == (count, 2)
    assert np.isfinite(embedding.points).all()


def test_equal_solutions_lie_on_one_point() -> None:
    embedding = embedded(archive_of(Metric([1.0, 1.0], [False, True]), np.zeros((5, 2))))
    assert np.array_equal(embedding.points, np.zeros((5, 2)))
    assert embedding.explained == 1.0
