"""Numbers in steps and on log scales: how they are stored, and what every search makes of them."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brink.python.study import Study
from brink.search.analysis.dependence import parameter_columns
from brink.search.errors import SpaceError
from brink.search.metric import Metric
from brink.search.odd import limited, odd_words
from brink.search.pairs import Steps
from brink.search.parameters import Integer, Number, Real
from brink.search.shorthand import space_of
from brink.search.space import Component, Extent, SearchSpace

STEPPED = Real("gap", 0.0, 10.0, "m", step=0.1)
WHOLE = Integer("cars", -2, 10, step=4)
RATE = Real("rate", 1e-6, 1.0, "1/s", log=True)
NUMBERS = [STEPPED, WHOLE, RATE, Real("x", 0.05, 0.95, step=0.3), Real("y", 1 / 3, 1e300, log=True)]


@pytest.mark.parametrize("number", NUMBERS, ids=lambda number: number.name)
@given(share=st.floats(-0.5, 1.5), seed=st.integers(0, 99))
def test_what_is_drawn_or_repaired_is_valid_and_survives_being_written(
    number: Number, share: float, seed: int
) -> None:
    repaired = number.clipped(number.least + share * number.range)
    for value in (repaired, number.draw(np.random.default_rng(seed))):
        assert number.problem(value) is None
        assert number.clipped(value) == value
        assert number.encode(number.decode(value)) == value
        low, high = number.ends
        assert low - 1e-10 * abs(low) <= float(number.decode(value)) <= high * (1 + 1e-10)


def test_values_on_steps_have_the_digits_of_the_step() -> None:
    assert [STEPPED.decode(STEPPED.clipped(value)) for value in (0.26, 0.31, 99.0)] == [0.3, 0.3, 10.0]
    assert STEPPED.encode(3 * 0.1) == 0.3  # 3 * 0.1 is another float
    assert [WHOLE.clipped(value) for value in (-9, 1.9, 7.0)] == [-2, 2, 6]
    with pytest.raises(SpaceError, match=r"in steps of 0\.1, got 0\.25"):
        STEPPED.encode(0.25)


def test_every_step_and_every_factor_is_as_likely() -> None:
    rng = np.random.default_rng(1)
    drawn = np.array([WHOLE.draw(rng) for _ in range(4000)])
    assert np.unique(drawn).tolist() == [-2, 2, 6, 10]
    assert np.abs(np.unique(drawn, return_counts=True)[1] / 1000 - 1).max() < 0.15
    rates = RATE.shown(np.array([RATE.draw(rng) for _ in range(4000)]))
    assert abs(np.median(rates) / 1e-3 - 1) < 0.3


def test_the_distance_is_that_of_the_scale_and_midpoints_are_on_steps() -> None:
    space = space_of([RATE])
    rows = np.array([[RATE.encode(value)] for value in (1e-6, 1e-3, 1.0)])
    distances = Metric.of_space(space).between(rows, rows)
    assert distances[0, 1] == pytest.approx(0.5) == distances[1, 2]
    middle = Steps(space).between(rows[0], rows[2], np.random.default_rng(1))
    assert middle is not None
    assert RATE.decode(float(middle[0])) == pytest.approx(1e-3, rel=1e-9)

    steps = Steps(space_of([STEPPED]))
    middle = steps.between(np.array([0.2]), np.array([0.5]), np.random.default_rng(1))
    assert middle is not None
    assert middle[0] in (0.3, 0.4)
    assert steps.are_one_step_apart(np.array([0.2]), np.array([0.3]))
    assert steps.largest_tight(0.0) == pytest.approx(0.01)


def test_resolutions_are_steps_and_factors() -> None:
    space = space_of(
        [
            STEPPED,
            Real("fine", 0.0, 1.0, step=0.001),
            RATE,
            Real("stated", 1.0, 9.0, log=True, resolution=1.5),
        ]
    )
    resolutions, stated = space.resolutions(space.join(space.sample(np.random.default_rng(1))))
    assert resolutions.tolist() == pytest.approx([0.1, 0.01, 0.01 * math.log(1e6), math.log(1.5)])
    assert stated.tolist() == [False, False, False, True]


def test_an_odd_and_people_see_values_in_their_unit() -> None:
    space = space_of([STEPPED, RATE])
    within = limited(space, {"parameters.rate": {"min": 1e-3}, "parameters.gap": {"max": 2}})
    assert odd_words(within) == "parameters: gap is 0 to 2 m; parameters: rate is 0.001 to 1 1/s"
    rows = np.array([within.join(within.sample(np.random.default_rng(seed))) for seed in range(50)])
    gap, rate = parameter_columns(within, rows)
    assert gap.values.max() <= 2.0
    assert rate.values.min() >= 1e-3
    assert space_of({"gap": STEPPED}).size == 101


def test_steps_and_log_scales_have_no_part_in_constraints_between_edges() -> None:
    edges = (Real("left", 0.0, 8.0, step=0.5), Real("right", 0.0, 8.0))
    with pytest.raises(SpaceError, match="neither steps nor a log scale"):
        SearchSpace((Component("box", edges, (Extent("left", "right", 1.0, 8.0),)),))


@pytest.mark.parametrize(
    ("declared", "boundary"),
    [((0, 10, 0.1), 6.25), ({"min": 1e-6, "max": 1, "log": True}, 1e-4)],
    ids=["steps", "log"],
)
def test_a_search_narrows_a_boundary_down_to_a_step_or_a_factor(declared: object, boundary: float) -> None:
    study = Study({"x": declared}, "edge@2", simulations=200, params={"trials": 0})
    while trials := study.ask():
        for trial in trials:
            study.tell(trial, float(trial.values["x"]) - boundary)
    frame = study.to_pandas()
    above, below = frame.x[~frame.unsafe].min(), frame.x[frame.unsafe].max()
    assert below < boundary < above
    assert above - below == pytest.approx(0.1) if isinstance(declared, tuple) else above / below < 1.2
