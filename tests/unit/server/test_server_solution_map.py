"""The map of a growing campaign: which points are drawn, and that they stay in place."""

from itertools import pairwise

import numpy as np
import pytest

from brink.search.archive import Archive, Neighbourhood
from brink.search.testing import example_spaces
from brink.server.dashboard import solution_map
from brink.server.dashboard.solution_map import drawn_rows, fitted_count, make_map

SPACE = example_spaces()["mixed"]


def archive_of(count: int) -> Archive:
    rng = np.random.default_rng(0)
    rows = np.array([SPACE.join(SPACE.sample(rng)) for _ in range(count)]).reshape(count, SPACE.dimension)
    return Archive.empty(SPACE, Neighbourhood(radius=0.3, p_th=0.1)).grown(
        np.arange(count), rows, rng.random(count) < 0.3, rng.random(count), keep_rows=False
    )


WHOLE = archive_of(400)


def test_points_stay_in_place_until_the_archive_has_grown_by_half() -> None:
    before = make_map(SPACE, WHOLE.first(200), ended=False)
    after = make_map(SPACE, WHOLE.first(210), ended=False, before=before)
    assert after.version == before.version
    assert np.array_equal(after.points[:200], before.points)
    assert len(after.points) == 210
    assert make_map(SPACE, WHOLE.first(330), ended=False, before=after).version != before.version


def test_a_late_request_for_an_earlier_archive_gets_only_its_points() -> None:
    later = make_map(SPACE, WHOLE.first(210), ended=False)
    earlier = make_map(SPACE, WHOLE.first(200), ended=False, before=later)
    assert later.version == earlier.version
    assert len(earlier.points) == len(earlier.rows) == 200
    assert np.allclose(earlier.points, later.points[:200])


def test_all_coordinators_draw_the_same_map() -> None:
    before = make_map(SPACE, WHOLE.first(150), ended=False)
    grown = make_map(SPACE, WHOLE.first(210), ended=False, before=before)
    fresh = make_map(SPACE, WHOLE.first(210), ended=False)
    assert grown.version == fresh.version
    assert np.allclose(grown.points, fresh.points)


def test_the_map_of_an_ended_campaign_is_fitted_to_all_solutions() -> None:
    ended = make_map(SPACE, WHOLE, ended=True, before=make_map(SPACE, WHOLE, ended=False))
    assert ended.version == "400-end"
    assert len(ended.points) == 400


@pytest.mark.parametrize("count", [0, 1, 2, 63, 64, 65])
def test_small_archives_are_mapped(count: int) -> None:
    for ended in (False, True):
        assert make_map(SPACE, WHOLE.first(count), ended=ended).points.shape == (count, 2)


def test_the_map_is_fitted_less_often_as_the_archive_grows() -> None:
    made = [fitted_count(count) for count in range(1, 60_000, 7)]
    steps = sorted(set(made))
    assert made == sorted(made)
    assert all(of <= count for of, count in zip(made, range(1, 60_000, 7), strict=True))
    assert all(later <= before * solution_map.GROWTH + 1 for before, later in pairwise(steps) if before >= 64)
    assert len(steps) < 110


def test_a_large_map_is_thinned_without_removing_points(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solution_map, "MAX_DRAWN", 100)
    monkeypatch.setattr(solution_map, "NEAREST", 40)
    first = drawn_rows(WHOLE.first(150), 140, ended=False)
    later = drawn_rows(WHOLE.first(160), 140, ended=False)
    assert np.array_equal(later[: len(first)], first)
    assert len(later) <= 100 + 20
    ended = drawn_rows(WHOLE, 400, ended=True)
    assert 60 <= len(ended) <= 100
    nearest = np.argsort(WHOLE.fitness, kind="stable")[:40]
    assert np.isin(nearest, ended).all(), "solutions near the boundary are always drawn"
