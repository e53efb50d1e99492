"""Searches that start from known points and known results."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from brink.search.algorithm import (
    AnyAlgorithm,
    Candidate,
    Evaluation,
    Failed,
    Known,
    Scored,
    ask_all,
    nearest_to_boundary,
)
from brink.search.algorithms.edge import Edge, EdgeConfig, EdgeState, Purpose, Status
from brink.search.algorithms.ga import GeneticAlgorithm, GeneticAlgorithmConfig
from brink.search.algorithms.mlcshe import Mlcshe, MlcsheConfig
from brink.search.algorithms.random_search import RandomSearch, RandomSearchConfig
from brink.search.algorithms.thresholds import ThresholdConfig, ThresholdSearch
from brink.search.archive import Archive, archive_digest
from brink.search.document import Document
from brink.search.errors import ConfigError, DocumentError
from brink.search.metric import Metric
from brink.search.pairs import Steps, midpoints
from brink.search.problems import MTQ_SPACE, evaluate_mtq, mtq_gap_to_boundary
from brink.search.space import SearchSpace
from brink.search.testing import (
    ContractBroken,
    check_algorithm,
    example_spaces,
    play,
    started,
    stored_and_restored,
    synthetic_verdicts,
)

ALGORITHMS: Mapping[str, tuple[AnyAlgorithm, Any]] = {
    "random@1": (RandomSearch(), RandomSearchConfig(generation_size=20, in_flight=3)),
    "ga@1": (GeneticAlgorithm(), GeneticAlgorithmConfig(population_size=20)),
    "mlcshe@1": (Mlcshe(), MlcsheConfig(population_size=8)),
    "edge@1": (Edge(), EdgeConfig(d_th=0.05)),
    "edge@2": (ThresholdSearch(), ThresholdConfig(trials=18)),
}
REPEAT = ("edge@1", "edge@2")
"""Algorithms that ask for a solution more than once."""
ROUND: dict[str, Any] = {"eps": 0.002, "d_th": 0.05, "checks": 0, "margin": 0.0}
"""Settings of `edge@1` for MTQ, whose boundary is a circle."""

pytestmark = pytest.mark.usefixtures("fewer_trees")
each_algorithm = pytest.mark.parametrize("name", ALGORITHMS)


def random_rows(space: SearchSpace, count: int, seed: int) -> np.ndarray[Any, Any]:
    rng = np.random.default_rng(seed)
    return np.array([space.join(space.sample(rng)) for _ in range(count)])


def known_in(
    space: SearchSpace,
    results: int,
    points: int = 0,
    evaluate: Callable[[Candidate], Evaluation] | None = None,
) -> Known:
    """Return random known results with the verdicts of a synthetic problem, and random points."""
    judge = evaluate or synthetic_verdicts(space, failing=0.0)
    rows = random_rows(space, results, seed=100)
    scored = [judge(Candidate(number=n, vectors=space.split(row))) for n, row in enumerate(rows)]
    evaluations = [one for one in scored if isinstance(one, Scored)]
    return Known(
        rows=rows.reshape(-1, space.dimension),
        unsafe=np.array([one.unsafe for one in evaluations], np.bool_),
        robustness=np.array([one.robustness for one in evaluations]),
        points=random_rows(space, points, seed=200).reshape(-1, space.dimension),
    )


def known_of(archive: Archive) -> Known:
    """Return the solutions of a search as known results."""
    return Known(
        rows=archive.vectors, unsafe=archive.unsafe, robustness=archive.robustness, points=archive.vectors[:0]
    )


LONG = pytest.mark.long("takes seconds; another amount of what is known runs every time")
AMOUNTS = {name: [(40, 0), (0, 12), (40, 12), (3, 1)] for name in ALGORITHMS}
AMOUNTS |= {"edge@1": [(0, 12), (40, 12)], "edge@2": [(40, 0), (40, 12)]}
"""Numbers of known results and points."""


@pytest.mark.usefixtures("few_trees")
@pytest.mark.parametrize(
    ("name", "results", "points"),
    [
        pytest.param(
            name, results, points, marks=LONG if name in REPEAT and (results, points) != (40, 12) else ()
        )
        for name, amounts in AMOUNTS.items()
        for results, points in amounts
    ],
)
def test_a_warm_search_keeps_the_contract(name: str, results: int, points: int) -> None:
    algorithm, config = ALGORITHMS[name]
    space = example_spaces()["numeric"]
    check_algorithm(
        algorithm,
        space,
        budget=60 if name in REPEAT else 100,  # each of many small generations grows trees
        config=config,
        repeats=name in REPEAT,
        known=known_in(space, results, points),
    )


@pytest.mark.usefixtures("few_trees")
@pytest.mark.parametrize(
    ("name", "space_name"),
    [
        pytest.param(name, space, marks=LONG if space == "mixed" or name in REPEAT else ())
        for name in ALGORITHMS
        for space in ("mixed", "categorical")
    ],
)
def test_a_warm_search_keeps_the_contract_with_categories(name: str, space_name: str) -> None:
    algorithm, config = ALGORITHMS[name]
    space = example_spaces()[space_name]
    check_algorithm(
        algorithm, space, budget=80, config=config, repeats=name in REPEAT, known=known_in(space, 30, 5)
    )


@pytest.mark.usefixtures("few_trees")
@each_algorithm
def test_knowing_nothing_changes_nothing(name: str) -> None:
    algorithm, config = ALGORITHMS[name]
    space = example_spaces()["numeric"]
    judge = synthetic_verdicts(space)
    cold, warm = (
        play(algorithm, space, config, judge, seed=3, budget=100, known=known)
        for known in (None, Known.nothing(space.dimension))
    )
    assert archive_digest(cold.archive) == archive_digest(warm.archive)
    assert cold.documents == warm.documents


@pytest.mark.usefixtures("few_trees")
@each_algorithm
def test_known_results_are_neither_archived_nor_paid_for(name: str) -> None:
    algorithm, config = ALGORITHMS[name]
    space = example_spaces()["numeric"]
    known = known_in(space, 60)
    run = play(
        algorithm, space, config, synthetic_verdicts(space, failing=0.0), seed=1, budget=100, known=known
    )
    assert len(run.candidates) >= 100
    assert run.archive.numbers.tolist() == list(range(len(run.candidates)))
    again = run.archive.with_verdicts(run.archive.unsafe, run.archive.robustness)
    assert np.array_equal(run.archive.neighbours, again.neighbours)


@each_algorithm
def test_points_beyond_the_budget_are_refused(name: str) -> None:
    algorithm, config = ALGORITHMS[name]
    space = example_spaces()["numeric"]
    with pytest.raises(ConfigError, match="budget: expected at least the 101 simulations"):
        started(algorithm, space, config, seed=1, budget=100, known=known_in(space, 0, points=101))


def test_the_contract_notices_points_that_do_not_come_first() -> None:
    class Forgets(RandomSearch):
        def start_with(self, *args: Any, known: Known, **more: Any) -> Any:
            return self.start(*args, **more)

    space = example_spaces()["numeric"]
    with pytest.raises(ContractBroken, match="points to be the first candidates"):
        check_algorithm(Forgets(), space, budget=100, known=known_in(space, 5, 5))


def test_results_nearest_to_the_boundary_come_first_and_the_verdicts_take_turns() -> None:
    unsafe = np.array([False, False, True, False, True])
    robustness = np.array([3.0, 1.0, -9.0, 2.0, -8.0])
    assert nearest_to_boundary(unsafe, robustness).tolist() == [4, 1, 2, 3, 0]


def test_the_first_population_holds_the_known_results_nearest_to_the_boundary() -> None:
    space = example_spaces()["numeric"]
    known = known_in(space, 60)
    config = GeneticAlgorithmConfig(population_size=20)
    half = Known(
        rows=known.rows[:8], unsafe=known.unsafe[:8], robustness=known.robustness[:8], points=known.points
    )
    state = started(GeneticAlgorithm(), space, config, seed=1, budget=100, known=half)
    assert np.array_equal(state.population[:8], half.rows[half.nearest()])
    assert len(state.ledger.queue) == 12
    bred = started(GeneticAlgorithm(), space, config, seed=1, budget=100, known=known)
    parents = known.rows[known.nearest()[:20]]
    genes = {(column, value) for row in parents for column, value in enumerate(row.tolist())}
    inherited = [(c, v) in genes for child in bred.population for c, v in enumerate(child.tolist())]
    assert np.mean(inherited) >= 0.95  # all but the mutated ones


def test_the_first_populations_of_mlcshe_hold_the_components_of_known_results() -> None:
    space = example_spaces()["numeric"]
    known = known_in(space, 5)
    state = started(Mlcshe(), space, MlcsheConfig(population_size=8), seed=1, budget=100, known=known)
    for population, part in zip(state.populations, space.slices, strict=True):
        assert len(population) == 8
        assert np.array_equal(population.individuals[:5], known.rows[known.nearest()][:, part])


def test_known_results_count_as_neighbours_where_the_search_judges_fitness() -> None:
    space = example_spaces()["numeric"]
    algorithm, config = ALGORITHMS["ga@1"]
    known, judge = known_in(space, 200), synthetic_verdicts(space, failing=0.0)
    state, _ = ask_all(algorithm, started(algorithm, space, config, seed=1, budget=100, known=known))
    state = algorithm.tell(state, {c.number: judge(c) for c in state.pending})
    own = len(state.archive)
    together = Archive.empty(space, state.archive.neighbourhood).grown(
        np.arange(own + len(known)),
        np.concatenate([state.archive.vectors, known.rows]),
        np.concatenate([state.archive.unsafe, known.unsafe]),
        np.zeros(own + len(known)),
    )
    assert np.array_equal(state.fitness, together.fitness[:own])
    assert not np.array_equal(state.fitness, state.archive.fitness)


EdgeRun = tuple[EdgeState, list[tuple[Candidate, Purpose]]]
"""The end of a search, and its candidates with what each is for."""


def run_edge(
    seed: int,
    known: Known | None,
    judge: Callable[[Candidate], Evaluation],
    budget: int = 300,
    **settings: Any,
) -> EdgeRun:
    algorithm, asked = Edge(), list[tuple[Candidate, Purpose]]()
    config = EdgeConfig(**{**ROUND, **settings})
    state = started(algorithm, MTQ_SPACE, config, seed=seed, budget=budget, known=known)
    while not algorithm.finished(state):
        state, _ = ask_all(algorithm, state)
        asked += [(c, purpose) for c, (purpose, _, _) in zip(state.pending, state.jobs, strict=False)]
        state = algorithm.tell(state, {c.number: judge(c) for c in state.pending})
    return state, asked


def on_mtq(candidate: Candidate) -> Scored:
    return evaluate_mtq(candidate.vectors)


@pytest.fixture(scope="module")
def known_mtq() -> Known:
    return known_in(MTQ_SPACE, 300, evaluate=on_mtq)


@pytest.fixture(scope="module")
def warm(known_mtq: Known) -> EdgeRun:
    """A search for pairs that starts from known results."""
    return run_edge(1, known_mtq, on_mtq)


@pytest.fixture(scope="module")
def earlier() -> EdgeRun:
    """A search for pairs that knows nothing."""
    return run_edge(7, None, on_mtq)


def test_known_results_take_the_place_of_exploring(warm: EdgeRun, earlier: EdgeRun) -> None:
    (state, asked), (_, cold) = warm, earlier
    assert asked[0][1] is Purpose.ANCHOR
    assert cold[0][1] is Purpose.EXPLORE
    assert sum(p is Purpose.EXPLORE for _, p in asked) < 0.5 * sum(p is Purpose.EXPLORE for _, p in cold)
    kept = [b for b in state.brackets if b.status is Status.KEPT]
    rows = dict(zip(state.archive.numbers.tolist(), state.archive.vectors, strict=True))
    assert len(kept) >= 6
    for one in kept:
        middle = midpoints(rows[one.safe][None], rows[one.unsafe][None], MTQ_SPACE)[0]
        assert mtq_gap_to_boundary(*middle) <= 0.002


def test_anchors_are_known_and_new_solutions_with_seeds_of_their_own(known_mtq: Known, warm: EdgeRun) -> None:
    _, asked = warm
    anchors = [candidate for candidate, purpose in asked if purpose is Purpose.ANCHOR]
    known = {row.tobytes() for row in known_mtq.rows}
    assert anchors
    rows = {MTQ_SPACE.join(anchor.vectors).tobytes() for anchor in anchors}
    assert len(rows) == len(anchors)
    assert 0 < len(rows & known) < len(rows)
    assert {anchor.seed_number for anchor in anchors} == {None}


def test_both_sides_of_every_bracket_were_simulated_under_one_seed_of_this_search(warm: EdgeRun) -> None:
    state, asked = warm
    seeds = {c.number: c.number if c.seed_number is None else c.seed_number for c, _ in asked}
    assert state.brackets
    for bracket in state.brackets:
        assert seeds[bracket.safe] == seeds[bracket.unsafe] == bracket.seed


def test_an_anchor_whose_known_verdict_does_not_hold_makes_no_bracket(known_mtq: Known) -> None:
    """Every second known verdict is wrong, so every bracket must rest on what this search has seen."""
    wrong = np.arange(len(known_mtq)) % 2 == 0
    misled = replace(
        known_mtq,
        unsafe=known_mtq.unsafe ^ wrong,
        robustness=np.where(wrong, -known_mtq.robustness, known_mtq.robustness),
    )
    state, _ = run_edge(1, misled, on_mtq, budget=150)
    assert state.brackets
    unsafe = dict(zip(state.archive.numbers.tolist(), state.archive.unsafe.tolist(), strict=True))
    for bracket in state.brackets:
        assert (unsafe[bracket.safe], unsafe[bracket.unsafe]) == (False, True)


def test_no_pair_is_looked_for_where_known_results_are_one(earlier: EdgeRun) -> None:
    known, _ = earlier
    state, _ = run_edge(1, known_of(known.archive), on_mtq)
    before, after = (
        np.array(
            [
                midpoints(rows[b.safe][None], rows[b.unsafe][None], MTQ_SPACE)[0]
                for b in found.brackets
                if b.status is Status.KEPT
            ]
        )
        for found in (known, state)
        for rows in [dict(zip(found.archive.numbers.tolist(), found.archive.vectors, strict=True))]
    )
    assert len(after)
    assert (Metric.of_space(MTQ_SPACE).between(after, before) >= ROUND["d_th"] - ROUND["eps"]).all()


def test_solutions_whose_known_results_differ_are_no_anchors() -> None:
    rows = np.repeat(random_rows(MTQ_SPACE, 30, seed=5), 2, axis=0)
    unsafe = np.tile([False, True], 30)
    known = Known(rows=rows, unsafe=unsafe, robustness=np.where(unsafe, -1.0, 1.0), points=rows[:0])
    _, asked = run_edge(1, known, on_mtq, budget=80)
    anchors = {MTQ_SPACE.join(c.vectors).tobytes() for c, purpose in asked if purpose is Purpose.ANCHOR}
    assert not anchors & {row.tobytes() for row in rows}


def test_anchors_that_cannot_be_simulated_are_not_tried_again(known_mtq: Known) -> None:
    known = {row.tobytes() for row in known_mtq.rows}

    def never(candidate: Candidate) -> Evaluation:
        if MTQ_SPACE.join(candidate.vectors).tobytes() in known:
            return Failed(reason="crashed")
        return on_mtq(candidate)

    state, asked = run_edge(1, known_mtq, never, budget=150)
    anchors = [MTQ_SPACE.join(c.vectors).tobytes() for c, purpose in asked if purpose is Purpose.ANCHOR]
    assert len(anchors) == len(set(anchors))
    assert len(asked) == 150
    assert len(state.ledger.failed) == len(set(anchors) & known)


@each_algorithm
def test_a_stored_state_with_too_few_known_verdicts_is_refused(name: str) -> None:
    algorithm, config = ALGORITHMS[name]
    space = example_spaces()["numeric"]
    state = started(algorithm, space, config, seed=1, budget=100, known=known_in(space, 10))
    stored = algorithm.dump(state)
    arrays = {**stored.arrays, "known_results": stored.arrays["known_results"][:9]}
    broken = Document(kind=stored.kind, version=stored.version, header=stored.header, arrays=arrays)
    with pytest.raises(DocumentError, match="known_results: expected one for each of 10 rows, got 9"):
        algorithm.load(space, config, broken, stored_and_restored(state.archive))


def test_sides_of_known_pairs_are_tight(earlier: EdgeRun) -> None:
    found, _ = earlier
    state = started(Edge(), MTQ_SPACE, EdgeConfig(**ROUND), seed=1, budget=100, known=known_of(found.archive))
    half = len(state.prior.ends) // 2
    assert half >= sum(b.status is Status.KEPT for b in found.brackets)
    steps = Steps(MTQ_SPACE)
    for safe, unsafe in zip(state.prior.ends[:half], state.prior.ends[half:], strict=True):
        assert steps.is_tight(safe, unsafe, ROUND["eps"])
