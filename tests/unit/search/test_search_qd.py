"""MAP-Elites on traffic: elites by niche, how children are made, what is refused when a state is restored."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from brink.search.algorithm import Candidate, Evaluation, Failed, Measure, Niche, Origin, Scored, ask_all
from brink.search.algorithms.multi_objective import gap_objective
from brink.search.algorithms.qd import (
    Elite,
    Operator,
    Qd,
    QdConfig,
    QdState,
    niches_of,
    parents_of,
    with_elites,
)
from brink.search.document import Document
from brink.search.errors import ConfigError, DocumentError
from brink.search.space import Categorical, Component, Real, SearchSpace
from brink.search.testing import example_spaces
from brink.search.traffic.constraint import participants_component
from brink.search.traffic.participants import RoadLimits, Solution
from brink.search.traffic.variation import TrafficGenome

SPACE = SearchSpace(
    (
        Component("scenario", (Categorical("weather", ("dry", "wet")),)),
        participants_component("npcs", 3, RoadLimits(streets_m=(30.0,))),
    )
)
GENOME = TrafficGenome.of(SPACE)
QD = Qd()
SMALL = QdConfig(generation_size=10, initial=20)
NEAR_M = 20.0


def solution_of(candidate: Candidate) -> Solution:
    return GENOME.solution(SPACE.join(candidate.vectors))


def behaved(candidate: Candidate) -> Evaluation:
    """Evaluate a candidate by its starts: the nearest participant counts; its action and speed name the niche."""
    if candidate.number % 11 == 3:
        return Failed(reason="synthetic")
    solution = solution_of(candidate)
    gaps = [abs(one.ds_m) + abs(one.dd_m) for one in solution]
    nearest = solution[int(np.argmin(gaps))]
    niche = Niche(
        name=(nearest.kind.value, nearest.genes[0].action.value, f"{nearest.speed_mps:.0f} m/s"),
        rank=int(min(gaps) > NEAR_M),
        value=min(gaps),
    )
    objectives = {gap_objective(index): gap for index, gap in enumerate(gaps, start=1)}
    return Scored(
        unsafe=niche.rank == 0, robustness=niche.value - NEAR_M, objectives=objectives, niches=(niche,)
    )


def played(
    algorithm: Any,
    config: Any,
    *,
    budget: int,
    seed: int = 1,
    judge: Callable[[Candidate], Evaluation] = behaved,
) -> tuple[Any, list[Candidate]]:
    """Return the final state of a search, and its candidates."""
    state = algorithm.start(SPACE, config, seed=seed, budget=budget)
    candidates: list[Candidate] = []
    while not algorithm.finished(state):
        state, _ = ask_all(algorithm, state)
        candidates += state.pending
        state = algorithm.tell(state, {one.number: judge(one) for one in state.pending})
    return state, candidates


def test_every_niche_keeps_its_best_solution() -> None:
    state, candidates = played(QD, SMALL, budget=150)
    best: dict[tuple[str, ...], tuple[int, float, int]] = {}
    for candidate in candidates:
        evaluation = behaved(candidate)
        for niche in evaluation.niches if isinstance(evaluation, Scored) else ():
            key = (niche.rank, niche.value, candidate.number)
            best[niche.name] = min(key, best.get(niche.name, key))
    found = {one.niche.name: (one.niche.rank, one.niche.value, one.number) for one in state.elites}
    assert found == best


def by_luck(candidate: Candidate) -> Evaluation:
    """As `behaved`, but every third drive seems far better than it is, and every fifth is in another niche."""
    evaluation = behaved(candidate)
    if not isinstance(evaluation, Scored):
        return evaluation
    [niche] = evaluation.niches
    if candidate.number % 3 == 0:
        niche = replace(niche, value=niche.value - 100)
    if candidate.number % 5 == 0:
        niche = replace(niche, name=("elsewhere", *niche.name))
    return replace(evaluation, niches=(niche,))


def test_elites_of_the_best_rank_are_simulated_again_under_a_seed_of_their_own() -> None:
    state, candidates = played(QD, SMALL, budget=300, judge=by_luck)
    assert len(candidates) == 300
    rows = {one.number: SPACE.join(one.vectors).tolist() for one in candidates}
    assert state.again
    assert len(set(state.again.values())) == len(state.again), "each once"
    assert all(rows[candidate] == rows[number] for candidate, number in state.again.items())
    assert all(one.seed_number is None for one in candidates)
    leading, _ = parents_of(state.elites)
    once = [one for one in leading if one.number not in {*state.again, *state.again.values()}]
    assert len(once) <= 2, "the budget leaves a second drive for nearly all"


def test_the_value_of_an_elite_is_the_mean_of_its_drives() -> None:
    """The best single drive is what luck makes of it."""
    state, _ = played(QD, SMALL, budget=300, judge=by_luck)
    leading, _ = parents_of(state.elites)
    twice = [one for one in leading if one.evaluations == 2]
    second = {number: candidate for candidate, number in state.again.items()}
    assert {one.seen for one in twice} == {1, 2}
    for one in twice:
        drives = [
            Candidate(number=n, vectors=row_of(state, one.number)) for n in (one.number, second[one.number])
        ]
        values = [
            niche.value
            for evaluation in map(by_luck, drives)
            if isinstance(evaluation, Scored)
            for niche in evaluation.niches
            if niche.name == one.niche.name
        ]
        assert len(values) == one.seen
        assert one.niche.value == pytest.approx(np.mean(values))


def row_of(state: QdState, number: int) -> Any:
    return SPACE.split(state.archive.vectors[int(np.searchsorted(state.archive.numbers, number))])


def test_an_elite_that_was_not_seen_again_gives_way_to_the_next_in_its_niche() -> None:
    lucky = replace(elite("a", 0, -50.0), number=3)
    missed = scored(Niche(name=("b",), rank=0, value=1.0))
    again, other = Candidate(number=7, vectors=()), Candidate(number=8, vectors=())
    doubted, _ = with_elites((lucky,), [again], {7: missed}, {7: 3})
    assert (doubted.number, doubted.evaluations, doubted.seen) == (3, 2, 1)
    worse = scored(Niche(name=("a",), rank=0, value=9.0))
    next_one, _ = with_elites((doubted,), [other], {8: worse})[:1] * 2
    assert (next_one.number, next_one.niche.value, next_one.evaluations) == (8, 9.0, 1)
    (kept,) = with_elites((lucky,), [again], {7: scored(Niche(name=("a",), rank=1, value=-90.0))}, {7: 3})
    assert (kept.niche.value, kept.seen) == (-50.0, 1), "a worse rank is not the same"


def test_solutions_without_a_verdict_are_never_elites() -> None:
    state, candidates = played(QD, SMALL, budget=150)
    failed = {one.number for one in candidates if isinstance(behaved(one), Failed)}
    assert failed
    assert not failed & {elite.number for elite in state.elites}


def test_origins_are_those_of_all_solutions_in_flight_and_in_the_queue() -> None:
    state = QD.start(SPACE, replace(SMALL, in_flight=3), seed=1, budget=100)
    state, generations = ask_all(QD, state)
    assert [len(generation) for generation in generations] == [10, 10, 10]
    assert len(state.queue_origins) == 30
    state = QD.tell(state, {one.number: behaved(one) for one in state.pending})
    assert len(state.ledger.queue) == 10
    assert len(state.queue_origins) == 30


def only(operator: Operator) -> QdConfig:
    """Return settings that use a single operator."""
    shares: dict[str, Any] = {f"share_{one}": float(one is operator) for one in Operator}
    return replace(SMALL, **shares)


def elite(name: str, rank: int, value: float, hits: int = 1) -> Elite:
    return Elite(niche=Niche(name=(name,), rank=rank, value=value), number=0, hits=hits)


def test_parents_are_the_best_elites_and_the_nearest_of_the_second_rank() -> None:
    best = [elite("a", 0, 9.0), elite("b", 0, -1.0)]
    near = [elite(f"near {n}", 1, float(n)) for n in (7, 3, 5, 1, 2, 6, 4, 8)]
    assert parents_of([*near, *best, elite("far", 2, -5.0)]) == (best, [near[3], near[4]])
    assert parents_of(near)[0] == near
    assert parents_of([]) == ([], [])


def scored(*niches: Niche) -> Scored:
    return Scored(unsafe=True, robustness=-1.0, niches=niches)


def test_better_ranks_come_before_better_values_and_equal_ones_change_nothing() -> None:
    elites = (elite("a", 1, 2.0),)
    for rank, value, number in ((1, 2.0, 0), (2, -9.0, 0), (1, 1.5, 5), (0, 7.0, 5)):
        niche = Niche(name=("a",), rank=rank, value=value)
        (found,) = with_elites(elites, [Candidate(number=5, vectors=())], {5: scored(niche)})
        assert (found.number, found.hits) == (number, 2)
        assert found.niche == (niche if number else elites[0].niche)


def test_a_solution_counts_once_in_each_of_its_niches() -> None:
    niches = [Niche(name=(name,), rank=rank, value=1.0) for name, rank in (("a", 3), ("a", 0), ("b", 0))]
    for given in (niches, niches[::-1]):
        found = with_elites((elite("b", 0, 0.0),), [Candidate(number=5, vectors=())], {5: scored(*given)})
        assert {(one.niche.name, one.niche.rank, one.number, one.hits) for one in found} == {
            (("b",), 0, 0, 2),
            (("a",), 0, 5, 1),
        }


def test_solutions_without_niches_lead_to_a_random_search() -> None:
    state = QD.start(SPACE, SMALL, seed=1, budget=60)
    while not QD.finished(state):
        state, _ = ask_all(QD, state)
        assert set(state.queue_origins) == {Origin.RANDOM}
        state = QD.tell(state, {one.number: Scored(unsafe=False, robustness=1.0) for one in state.pending})
    assert state.elites == ()


def test_measures_name_a_cell_of_a_grid_and_values_beyond_its_ranges_belong_to_the_outermost() -> None:
    gap, speed = (
        Measure(name="gap_m", low=0.0, high=20.0, unit="m"),
        Measure(name="count", low=-1.0, high=1.0),
    )
    assert [gap.cell(value, 4) for value in (-3.0, 4.9, 5.0, 20.0, 99.0)] == [
        "gap_m 0 to 5 m",
        "gap_m 0 to 5 m",
        "gap_m 5 to 10 m",
        "gap_m 15 to 20 m",
        "gap_m 15 to 20 m",
    ]
    safe = Scored(unsafe=False, robustness=0.5, measures={gap: 7.0, speed: 0.0})
    assert niches_of(safe, 2) == (Niche(name=("gap_m 0 to 10 m", "count 0 to 1"), rank=1, value=0.5),)
    assert niches_of(replace(safe, unsafe=True, robustness=-1.0, measures={speed: 0.0}), 2) == (
        Niche(name=("count 0 to 1",), rank=0, value=-1.0),
    )
    named = replace(safe, niches=(Niche(name=("named",), rank=0, value=2.0),))
    assert niches_of(named, 2) == named.niches, "a problem's own niches come first"
    with pytest.raises(ValueError, match="low < high"):
        Measure(name="gap_m", low=1.0, high=1.0)


@pytest.mark.parametrize("name", ["mixed", "numeric", "slots"])
def test_any_space_with_measures_is_searched_for_an_elite_of_each_cell(name: str) -> None:
    """More cells than random search reaches, in a space without participants."""
    space = example_spaces()[name]
    real = next(place for place, one in enumerate(space.parameters) if isinstance(one, Real))
    parameter = space.parameters[real]
    assert isinstance(parameter, Real)
    measure = Measure(name="first", low=parameter.low, high=parameter.high)

    def judge(candidate: Candidate) -> Evaluation:
        row = space.join(candidate.vectors)
        share = (row[real] - parameter.low) / parameter.range
        return Scored(unsafe=share > 0.9, robustness=0.9 - share, measures={measure: float(row[real])})

    state = QD.start(space, SMALL, seed=1, budget=120)
    while not QD.finished(state):
        state, _ = ask_all(QD, state)
        state = QD.tell(state, {one.number: judge(one) for one in state.pending})
    assert len(state.archive) == 120
    assert {elite.niche.name for elite in state.elites} == {
        (measure.cell(v, 5),) for v in np.linspace(parameter.low, parameter.high, 11)
    }
    grown = state.archive.unsafe[20:].mean()
    assert grown > 2 * 0.1, "variants of unsafe elites, not random draws, of which 10% are unsafe"
    assert all(space.contains(space.split(row)) for row in state.archive.vectors)


def test_patterns_need_participants() -> None:
    with pytest.raises(ConfigError, match="only traffic participants have patterns"):
        QD.check(example_spaces()["mixed"], replace(SMALL, share_pattern=0.1), budget=60)


def test_shares_that_are_all_zero_are_refused() -> None:
    config = replace(only(Operator.SMALL), share_small=0.0)
    with pytest.raises(ConfigError, match="at least one operator"):
        QD.check(SPACE, config, budget=100)


@pytest.mark.parametrize(
    "change",
    [
        {"niches": []},
        {"niches": "names"},
        {"niches": [["a"], ["b"], 3]},
        {"queue_origins": ["random"]},
        {"queue_origins": ["nobody"] * 20},
    ],
)
def test_corrupt_states_are_refused(change: dict[str, Any]) -> None:
    state = QD.start(SPACE, SMALL, seed=1, budget=60)
    state, _ = ask_all(QD, state)
    state = QD.tell(state, {one.number: behaved(one) for one in state.pending})
    stored = QD.dump(state)
    three = {"niches": stored.header["niches"][:3]}
    stored = replace(
        stored,
        header={**stored.header, **three},
        arrays={**stored.arrays, "elites": stored.arrays["elites"][:3]},
    )
    assert len(QD.load(SPACE, SMALL, stored, state.archive).elites) == 3
    broken = replace(stored, header={**stored.header, **change})
    with pytest.raises(DocumentError):
        QD.load(SPACE, SMALL, Document.from_bytes(broken.to_bytes()), state.archive)


def test_elites_that_were_never_archived_are_refused() -> None:
    state, _ = played(QD, SMALL, budget=40)
    stored = QD.dump(state)
    elites = stored.arrays["elites"].copy()
    elites[0, 2] = 3.0  # a solution that failed
    broken = replace(stored, arrays={**stored.arrays, "elites": elites})
    with pytest.raises(DocumentError, match="archived"):
        QD.load(SPACE, SMALL, broken, state.archive)


def test_elites_only_improve() -> None:
    state = QD.start(SPACE, SMALL, seed=2, budget=150)
    while not QD.finished(state):
        state, _ = ask_all(QD, state)
        before = {one.niche.name: (one.niche.rank, one.niche.value) for one in state.elites}
        state = QD.tell(state, {one.number: behaved(one) for one in state.pending})
        after = {one.niche.name: (one.niche.rank, one.niche.value) for one in state.elites}
        assert all(after[name] <= value for name, value in before.items())


@pytest.mark.parametrize("budget", [1, 7, 33])
def test_budget_is_spent_and_not_exceeded(budget: int) -> None:
    assert len(played(QD, SMALL, budget=budget)[1]) == budget


def test_major_changes_apply_to_one_participant_of_an_elite() -> None:
    for child, state in children_of(only(Operator.MAJOR)):
        rows = [state.archive.vectors[state.archive.numbers == elite.number][0] for elite in state.elites]
        parents = [parent for row in rows if len(parent := GENOME.solution(row)) == len(child)]
        assert 1 in {differing(parent, child) for parent in parents}


def children_of(config: QdConfig) -> list[tuple[Solution, QdState]]:
    """Return the first variants of elites, each with the state that it was bred from."""
    state = QD.start(SPACE, replace(config, in_flight=1), seed=3, budget=60)
    children: list[tuple[Solution, QdState]] = []
    while not QD.finished(state):
        bred_from = state
        state, candidates = QD.ask(state)
        if candidates[0].number >= config.initial:
            new = [one for one in candidates if one.number not in bred_from.again]
            children += [(solution_of(one), bred_from) for one in new]
        state = QD.tell(state, {one.number: behaved(one) for one in candidates})
    return children


def differing(parent: Solution, child: Solution) -> int:
    return sum(one != other for one, other in zip(parent, child, strict=True))
