import numpy as np
import pytest

from brink.search.archive import Archive, Neighbourhood
from brink.search.boundary import dbs, strict_dbs
from brink.search.sensitivity import by_p_th, by_radius, rescored
from brink.search.testing import example_spaces

SPACE = example_spaces()["mixed"]


def archive(radius: float = 0.3, p_th: float = 0.1) -> Archive:
    rng = np.random.default_rng(4)
    rows = np.array([SPACE.join(SPACE.sample(rng)) for _ in range(300)])
    unsafe = rng.random(300) < np.where(rows[:, -1] > np.median(rows[:, -1]), 0.3, 0.02)
    return Archive.empty(SPACE, Neighbourhood(radius=radius, p_th=p_th, z=1.96)).grown(
        np.arange(300), rows, unsafe, np.where(unsafe, -1.0, 1.0)
    )


@pytest.mark.parametrize(("radius", "p_th"), [(0.3, 0.25), (0.45, 0.1), (0.2, 0.3), (0.3, 0.1)])
def test_an_archive_scored_otherwise_is_the_one_that_would_have_been(radius: float, p_th: float) -> None:
    found, expected = rescored(archive(), radius=radius, p_th=p_th), archive(radius, p_th)
    assert found.neighbourhood == expected.neighbourhood
    for name in ("numbers", "unsafe", "neighbours", "unsafe_neighbours", "interval", "fitness"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_what_a_boundary_is_with_other_settings() -> None:
    for found in (
        by_radius(archive(), (0.2, 0.4), t_b=0.15, d_th=0.2),
        by_p_th(archive(), (0.05, 0.2), t_b=0.15, d_th=0.2),
    ):
        for one in found:
            known = archive(one.radius, one.p_th)
            assert (one.dbs, one.strict_dbs) == (dbs(known, 0.15, 0.2), strict_dbs(known, 0.15, 0.2))
            assert one.near == (known.fitness <= 0.15).sum()
            assert one.neighbours == np.median(known.neighbours)


def test_settings_out_of_range_are_refused() -> None:
    for wrong in ({"radius": -0.1}, {"p_th": 1.0}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            rescored(archive(), **wrong)
