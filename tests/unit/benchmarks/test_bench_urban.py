"""Measurements of the urban problem: its cost, its difficulty, and the random candidates behind both."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.trials import mapped, process_memory_mb, run_record
from benchmarks.urban import (
    PARAMETERS,
    SPACE,
    consistent_effect_p,
    draw_candidate,
    neighbour,
    redraw,
    spec_of,
)
from brink.search.metric import Metric


@pytest.mark.long("runs many episodes")
def test_memory_does_not_grow_with_the_number_of_episodes() -> None:
    specs = [spec_of(draw_candidate(np.random.default_rng(index)), index) for index in range(90)]
    first_mb, last_mb = process_memory_mb(specs, settle=30)
    assert 20.0 < first_mb < 150.0
    assert last_mb - first_mb < 4.0


@given(st.integers(0, 2**32), st.integers(0, len(PARAMETERS) - 1))
def test_a_redraw_changes_its_parameter_and_stays_valid(seed: int, place: int) -> None:
    rng = np.random.default_rng(seed)
    base = draw_candidate(rng)
    before = SPACE.join(base)
    if SPACE.dormant(before)[place]:
        return
    other = redraw(base, place, rng)
    SPACE.check(other)
    assert np.array_equal(SPACE.join(base), before)
    changed = SPACE.join(other) != before
    if SPACE.categorical[place]:
        assert changed[place]
    groups = [one.name.rpartition(".")[0] for one in PARAMETERS]
    assert all(one == place or groups[one] == groups[place] != "" for one in np.flatnonzero(changed))


def test_neighbours_are_close_and_valid() -> None:
    metric = Metric.of_space(SPACE)
    for seed in range(100):
        rng = np.random.default_rng(seed)
        base = draw_candidate(rng)
        near = neighbour(base, rng)
        SPACE.check(near)
        assert 0.0 <= metric.between(SPACE.join(base)[None], SPACE.join(near)[None])[0, 0] < 0.2


def test_the_permutation_test_detects_effects_that_cancel_on_average_and_only_real_ones() -> None:
    rng = np.random.default_rng(5)
    context = rng.choice((-1.0, 1.0), size=(150, 1)) * (rng.random((150, 1)) < 0.3)
    assert consistent_effect_p(context + 0.5 * rng.normal(size=(150, 2)), rng, 999) < 0.01
    p_values = [consistent_effect_p(rng.normal(size=(150, 2)), rng, 199) for _ in range(60)]
    assert 0.25 < float(np.mean(p_values)) < 0.75
    assert consistent_effect_p(np.zeros((150, 2)), rng, 99) == 1.0


def test_trials_keep_their_order_and_do_not_depend_on_the_number_of_processes() -> None:
    specs = [spec_of(draw_candidate(np.random.default_rng(i)), i) for i in range(6)]
    alone, pooled = (
        [one.robustness for one in mapped(run_record, specs, processes=processes, part="", chunk=2)]
        for processes in (1, 2)
    )
    assert pooled == alone
    assert len({one["front-gap@1"] for one in alone}) > 1
