"""Estimation of thresholds: intervals, stretches, chancy places, and the lines along which units move."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from brink.search.conclusions import Outcome
from brink.search.errors import SpaceError
from brink.search.parameters import ResolutionByChoice
from brink.search.space import Categorical, Component, Dormant, Extent, Integer, Real, SearchSpace
from brink.search.thresholds import CurvePrior, Estimate, Trials, estimate, next_places
from brink.search.thresholds.line import Line

Curve = Callable[[float], float]

SHAPES: dict[str, Curve] = {
    "logistic": lambda x: 1 / (1 + math.exp(min(-x, 50.0))),
    "normal": lambda x: 0.5 * (1 + math.erf(x)),
    "linear": lambda x: min(max(0.5 + x, 0.0), 1.0),
    "gompertz": lambda x: math.exp(-math.exp(min(-x, 50.0))),
    "cauchy": lambda x: 0.5 + math.atan(x) / math.pi,
    "two steps": lambda x: 0.5 * sum(1 / (1 + math.exp(min(-20 * (x - at), 50.0))) for at in (-0.5, 0.5)),
    "with lapses": lambda x: 0.03 + 0.94 / (1 + math.exp(min(-x, 50.0))),
}
"""Rising curves, only one of them logistic."""


def inverse(curve: Curve, level: float) -> float:
    low, high = -50.0, 50.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if curve(middle) < level else (low, middle)
    return low


def placed(curve: Curve, middle: float, stretch: float) -> Curve:
    """Return a curve with its 50% point and its 20-80 stretch at given values."""
    low, half, high = (inverse(curve, level) for level in (0.2, 0.5, 0.8))
    return lambda place: curve((place - middle) / stretch * (high - low) + half)


def turning(
    curve: Curve, rng: np.random.Generator, *, resolution: float = 0.01, independent: bool = False
) -> tuple[Estimate, CurvePrior]:
    """Estimate a threshold as a search does: bisect under one seed, then simulate with fresh ones until it ends.

    Args:
        curve: Probability of a violation on a line from 0 to 1, which is all of the unit's range.
        rng: Decides what the seeds do.
        resolution: Of the unit.
        independent: Whether the verdicts under one seed have nothing in common.
    """
    seed, low, high = rng.random(), 0.0, 1.0
    while high - low > 0.25:
        middle = 0.5 * (low + high)
        is_unsafe = (rng.random() if independent else seed) < curve(middle)
        low, high = (low, middle) if is_unsafe else (middle, high)
    prior = CurvePrior(safe=low, unsafe=high, resolution=resolution, range=1.0)
    places, unsafe = list[float](), list[bool]()
    found = estimate(prior, trials(places, unsafe), rng)
    while found.outcome is Outcome.OPEN:
        for place in next_places(prior, found, 6, rng):
            places.append(place)
            unsafe.append(bool(rng.random() < curve(place)))
        found = estimate(prior, trials(places, unsafe), rng)
    assert found.trials == len(places) <= 45
    return found, prior


def trials(places: list[float], unsafe: list[bool]) -> Trials:
    return Trials(places=np.array(places), unsafe=np.array(unsafe, np.bool_))


def covered(shape: str, count: int, *, independent: bool = False) -> tuple[float, float]:
    """Return the share of intervals that contain the 50% point of synthetic thresholds, and of chancy conclusions."""
    inside, chancy = 0, 0
    for number in range(count):
        rng = np.random.default_rng([number, list(SHAPES).index(shape)])
        stretch = math.exp(rng.uniform(math.log(0.002), math.log(0.18)))
        middle, resolution = rng.uniform(0.15, 0.85), float(rng.choice([0.0033, 0.01]))
        curve = placed(SHAPES[shape], middle, stretch)
        found, _ = turning(curve, rng, resolution=resolution, independent=independent)
        inside += found.low <= middle <= found.high
        chancy += found.outcome is Outcome.CHANCY
    return inside / count, chancy / count


def test_intervals_of_few_synthetic_thresholds_hold() -> None:
    inside, chancy = covered("gompertz", 10)
    assert inside >= 0.8
    assert chancy <= 0.2


@pytest.mark.long("hundreds of thresholds of seven shapes; a few are estimated every time")
@pytest.mark.parametrize("independent", [False, True])
def test_intervals_hold_whatever_the_shape(independent: bool) -> None:
    """The 50% points of 168 thresholds are in 90% intervals, but for chance (two standard errors)."""
    found = {shape: covered(shape, 24, independent=independent) for shape in SHAPES}
    assert np.mean([inside for inside, _ in found.values()]) >= 0.855
    for shape, (inside, chancy) in found.items():
        assert inside >= 0.75, shape
        assert chancy <= (0.2 if shape == "cauchy" else 0.15), shape


@pytest.mark.parametrize("level", [0.5, 2 / 3])
def test_a_curve_that_levels_off_is_chancy(level: float) -> None:
    chancy = [
        turning(lambda x: level / (1 + math.exp(min(-(x - 0.4) * 100, 50.0))), np.random.default_rng(seed))[
            0
        ].outcome
        for seed in range(3)
    ]
    assert chancy == [Outcome.CHANCY] * 3


def test_a_wide_stretch_is_chancy() -> None:
    found = [turning(placed(SHAPES["logistic"], 0.5, 0.5), np.random.default_rng(s))[0] for s in range(3)]
    assert all(one.outcome is Outcome.CHANCY for one in found)


def test_what_is_unsafe_nowhere_is_chancy_and_its_middle_beyond_the_line() -> None:
    prior = CurvePrior(safe=0.4, unsafe=0.6, resolution=0.01, range=1.0)
    found = estimate(prior, trials(np.linspace(0, 1, 24).tolist(), [False] * 24), np.random.default_rng(1))
    assert found.outcome is Outcome.CHANCY
    assert found.middle == found.stretch == math.inf


def test_curves_pass_a_level_where_they_are_said_to() -> None:
    prior = CurvePrior(safe=0.3, unsafe=0.6, resolution=0.05, range=1.2)
    points = np.random.default_rng(2).random((200, 7))
    start, end = prior.shares(points, np.array([0.0, 1.0])).T
    for level, crossings in zip((0.2, 0.8), prior.crossings(points, (0.2, 0.8)), strict=True):
        for curve, place in zip(points, crossings.tolist(), strict=True):
            if math.isfinite(place):
                below, above = prior.shares(curve[None], place + np.array([-2e-6, 2e-6]))[0]
                assert below <= level <= above
        assert np.isfinite(crossings).sum() > 50
        assert np.array_equal(crossings == -np.inf, start >= level)
        assert np.array_equal(crossings == np.inf, end < level)


@pytest.mark.parametrize("middle", [0.02, 0.98])
def test_a_threshold_near_an_end_of_the_line_is_found(middle: float) -> None:
    found, _ = turning(placed(SHAPES["logistic"], middle, 0.01), np.random.default_rng(2))
    assert found.outcome is Outcome.THRESHOLD
    assert found.middle == pytest.approx(middle, abs=0.02)


def test_an_estimation_ends_when_the_interval_is_within_the_resolution_or_a_third_of_the_stretch() -> None:
    for seed in range(2):
        found, prior = turning(placed(SHAPES["normal"], 0.6, 0.05), np.random.default_rng(seed))
        assert (
            0.5 * (found.high - found.low) <= max(prior.resolution, found.stretch / 3) or found.trials >= 40
        )
        assert found.start < found.middle < found.end


def test_equal_trials_and_generators_give_equal_estimates_and_places() -> None:
    prior = CurvePrior(safe=0.25, unsafe=0.5, resolution=0.01, range=1.3)
    told = trials([0.1, 0.3, 0.4, 0.45, 0.9], [False, False, True, True, True])
    found = [estimate(prior, told, np.random.default_rng(3)) for _ in range(2)]
    assert (found[0].draws == found[1].draws).all()
    places = [next_places(prior, one, 5, np.random.default_rng(4)) for one in found]
    assert places[0] == places[1]
    assert all(0.0 <= place <= 1.0 for place in places[0])
    assert len(set(places[0])) > 1


@pytest.mark.parametrize(
    "wrong",
    [{"safe": 0.5, "unsafe": 0.5}, {"safe": -0.1}, {"unsafe": 1.1}, {"resolution": 0.0}, {"range": 0.0}],
)
def test_a_wrong_prior_is_refused(wrong: dict[str, float]) -> None:
    right = {"safe": 0.2, "unsafe": 0.5, "resolution": 0.01, "range": 1.0}
    with pytest.raises(ValueError, match="expected 0 <= safe < unsafe <= 1"):
        CurvePrior(**(right | wrong))


def test_trials_need_a_verdict_each() -> None:
    with pytest.raises(ValueError, match="expected one verdict for each place"):
        Trials(places=np.zeros(3), unsafe=np.zeros(2, np.bool_))


ERRORS = SearchSpace(
    (
        Component(
            "behaviour",
            (
                Categorical("type", ("none", "miss", "shift")),
                Real("severity", 0.0, 1.0, resolution=ResolutionByChoice("type", {"miss": 0.005})),
                Integer("frames", 0, 40),
                Real("left", 0.0, 800.0, "px", resolution=8.0),
                Real("right", 0.0, 800.0, "px"),
            ),
            (Dormant("type", "none", ("severity", "frames")), Extent("left", "right", 50.0, 800.0)),
        ),
    )
)
HELD = np.array([1.0, 0.9, 12.0, 100.0, 500.0])


def line_to(unit: tuple[int, ...], *safe: float, choice: float = 1.0) -> Line:
    end, start = np.array(HELD), np.array(HELD)
    start[0] = end[0] = choice
    start[list(unit)] = safe
    return Line(ERRORS, unit, start, end)


def test_places_on_a_line_are_shares_of_its_length() -> None:
    line = line_to((1,), 0.4)
    row = line.at(0.5)
    assert row is not None
    assert row.tolist() == [1.0, 0.65, 12.0, 100.0, 500.0]
    assert line.place_of(row) == pytest.approx(0.5)
    assert (line.resolution, line.range) == pytest.approx((0.01, 2.0))
    assert line.stated
    default = line_to((1,), 0.4, choice=2.0)
    assert default.resolution == pytest.approx(0.02)
    assert not default.stated


def test_places_of_whole_numbers_are_rounded() -> None:
    line = line_to((2,), 2)
    row = line.at(0.44)
    assert row is not None
    assert row[2] == 6.0
    assert line.place_of(row) == pytest.approx(0.4)
    assert line.resolution == pytest.approx(0.1)


def test_numbers_that_are_tied_together_move_together() -> None:
    line = line_to((3, 4), 0.0, 100.0)
    row = line.at(0.25)
    assert row is not None
    assert row[3:].tolist() == [25.0, 200.0]
    assert line.place_of(row) == pytest.approx(0.25)
    assert line.resolution == pytest.approx(8.0 / 400.0)


def test_a_line_is_held_in_all_but_its_unit() -> None:
    other = np.array(HELD)
    other[[1, 2]] = 0.2, 3.0
    with pytest.raises(SpaceError, match="differ in the numbers"):
        Line(ERRORS, (1,), other, HELD)
    with pytest.raises(SpaceError, match="differ in the numbers"):
        Line(ERRORS, (0,), np.array([2.0, *HELD[1:]]), HELD)
    with pytest.raises(SpaceError, match="differ in the numbers"):
        Line(ERRORS, (1,), HELD, HELD)
