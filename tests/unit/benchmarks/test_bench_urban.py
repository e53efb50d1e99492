"""Measurements of the urban problem: its cost, its difficulty, and the random candidates behind both."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.trials import run_trials
from benchmarks.urban import (
    CATEGORICAL,
    PARAMETERS,
    Candidate,
    consistent_effect_p,
    distance,
    draw_candidate,
    neighbour,
    process_memory_mb,
    redraw,
    resident_mb,
)
from brink.search.metric import Metric
from brink.search.space import FloatArray
from brink.server.problems.base import SimulatedProblem
from brink.server.problems.catalogue import make_problem
from brink.sim.urban.behaviour import BOX_FIELDS, DetectorBehaviour, trajectory_ranges
from brink.sim.world.scenario import UrbanScenario


@pytest.mark.long("runs many episodes")
def test_memory_does_not_grow_with_the_number_of_episodes() -> None:
    first_mb, last_mb = process_memory_mb(90, settle=30)
    assert 20.0 < first_mb < 150.0
    assert last_mb - first_mb < 4.0
    assert resident_mb() > 20.0


seeds = st.integers(0, 2**32)


def check(candidate: Candidate) -> None:
    spec = candidate.spec(1, ("front-gap@1",))
    UrbanScenario.from_json(spec.scenario)
    DetectorBehaviour.from_json(spec.behaviour)
    for ghost in range(2):
        values = candidate.values
        if candidate.is_null(ghost):
            assert all(values[f"{ghost}.{name}"] == 0.0 for name in trajectory_ranges())
            continue
        assert float(values[f"{ghost}.t1_step"]) - float(values[f"{ghost}.t0_step"]) >= 300 / 18 - 1e-9
        for low, high in zip(BOX_FIELDS[::2], BOX_FIELDS[1::2], strict=True):
            assert float(values[f"{ghost}.{high}"]) - float(values[f"{ghost}.{low}"]) >= 50.0 - 1e-9


@given(seeds, st.sampled_from(PARAMETERS))
def test_a_redraw_changes_its_parameter_and_stays_valid(seed: int, name: str) -> None:
    rng = np.random.default_rng(seed)
    base = draw_candidate(rng)
    if "." in name and not name.endswith("label") and base.is_null(int(name[0])):
        return
    before = dict(base.values)
    other = redraw(base, name, rng)
    check(other)
    assert base.values == before
    if name in CATEGORICAL:
        assert other.values[name] != base.values[name]
    changed = {key for key in PARAMETERS if other.values[key] != base.values[key]}
    group = name.split(".")[0]
    assert all(key == name or ("." in name and key.startswith(f"{group}.")) for key in changed)


@given(seeds)
def test_distance_is_a_metric_on_candidates(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b, c = draw_candidate(rng), draw_candidate(rng), draw_candidate(rng)
    assert distance(a, a) == 0.0
    assert 0.0 <= distance(a, b) == distance(b, a) <= 1.0
    assert distance(a, c) <= distance(a, b) + distance(b, c) + 1e-12


@given(seeds)
def test_neighbours_are_close_and_valid(seed: int) -> None:
    rng = np.random.default_rng(seed)
    base = draw_candidate(rng)
    near = neighbour(base, rng)
    check(near)
    assert distance(base, near) < 0.2


def test_the_permutation_test_detects_effects_that_cancel_on_average_and_only_real_ones() -> None:
    rng = np.random.default_rng(5)
    context = rng.choice((-1.0, 1.0), size=(150, 1)) * (rng.random((150, 1)) < 0.3)
    assert consistent_effect_p(context + 0.5 * rng.normal(size=(150, 2)), rng, 999) < 0.01
    p_values = [consistent_effect_p(rng.normal(size=(150, 2)), rng, 199) for _ in range(60)]
    assert 0.25 < float(np.mean(p_values)) < 0.75
    assert consistent_effect_p(np.zeros((150, 2)), rng, 99) == 1.0


def test_trials_keep_their_order_and_do_not_depend_on_the_number_of_processes() -> None:
    specs = [draw_candidate(np.random.default_rng(i)).spec(i, ("front-gap@1",)) for i in range(6)]
    alone = list(run_trials(specs, processes=1))
    assert list(run_trials(specs, processes=2)) == alone
    assert len({trial.robustness for trial in alone}) > 1


PROBLEM = make_problem("urban-injected@1", {})
SPACE = PROBLEM.space


def vectors(candidate: Candidate) -> tuple[FloatArray, ...]:
    """Return a candidate in the encoding of the search space."""
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
def test_draws_redraws_and_neighbours_satisfy_the_search_space(seed: int) -> None:
    rng = np.random.default_rng(seed)
    base = draw_candidate(rng)
    changeable = [name for name in PARAMETERS if name in CATEGORICAL or not base.is_null(int(name[0]))]
    for candidate in (base, *(redraw(base, name, rng) for name in changeable), neighbour(base, rng)):
        for component, vector in zip(SPACE.components, vectors(candidate), strict=True):
            assert list(component.problems(vector)) == []


def test_the_distance_equals_the_metric_of_the_search_space() -> None:
    rng = np.random.default_rng(0)
    for _ in range(30):
        one, other = draw_candidate(rng), draw_candidate(rng)
        rows = (SPACE.join(vectors(candidate))[None] for candidate in (one, other))
        expected = Metric.of_space(SPACE).between(*rows)[0, 0]
        assert distance(one, other) == pytest.approx(expected, abs=1e-12)


def test_draws_have_the_distribution_of_the_search_space() -> None:
    """Means agree within five standard errors for every parameter, and smallest boxes are equally frequent."""
    count = 3000
    mine = [np.concatenate(vectors(draw_candidate(np.random.default_rng(i)))) for i in range(count)]
    theirs = [SPACE.join(SPACE.sample(np.random.default_rng((1, i)))) for i in range(count)]
    for index, (a, b) in enumerate(zip(np.transpose(mine), np.transpose(theirs), strict=True)):
        error = np.sqrt((a.var() + b.var()) / count)
        assert abs(a.mean() - b.mean()) <= 5 * error, PARAMETERS[index]
    smallest = [
        Counter(bool(abs(row[11] - row[10] - 50.0) < 1e-9) for row in rows)[True] for rows in (mine, theirs)
    ]
    assert abs(smallest[0] - smallest[1]) < 0.05 * count


def test_a_candidate_and_its_vectors_give_the_same_episode() -> None:
    assert isinstance(PROBLEM, SimulatedProblem)
    candidate = draw_candidate(np.random.default_rng(3))
    spec = candidate.spec(5, ("front-gap@1",))
    episode = PROBLEM.episode(vectors(candidate), 5)
    assert episode.scenario == spec.scenario
    trajectories = spec.behaviour["trajectories"]
    assert isinstance(trajectories, list)
    live = [t for t in trajectories if isinstance(t, dict) and t["label"] != "null"]
    assert episode.behaviour["trajectories"] == live
