"""The contract of an algorithm as checks that ship with the project: run them on every plug-in.

`check_algorithm` plays whole campaigns against made-up verdicts, some of them failures, and raises
`ContractBroken` with what was expected at the first broken promise.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from brink.search.actions.road import RoadLimits
from brink.search.actions.rule import participants_component
from brink.search.algorithm import Algorithm, Candidate, Evaluation, Failed, Measured, Question, Scored
from brink.search.archive import Archive
from brink.search.digest import archive_digest
from brink.search.document import Document
from brink.search.errors import OrderError, SearchError
from brink.search.levels import Slots
from brink.search.space import Categorical, Component, Dormant, Duration, Extent, Integer, Real, SearchSpace
from brink.search.streams import Stream, generator

Evaluate = Callable[[Candidate], Evaluation]

_MOST_GENERATIONS = 100_000


def example_spaces() -> dict[str, SearchSpace]:
    """Return spaces of two components that between them hold every kind of parameter and constraint."""
    mixed = SearchSpace(
        (
            Component("scenario", (Categorical("weather", ("dry", "wet", "fog")), Integer("cars", 0, 4))),
            Component(
                "behaviour",
                (
                    Categorical("label", ("none", "car", "person")),
                    Integer("start", 0, 90, "step"),
                    Integer("end", 0, 90, "step"),
                    Real("left", 0.0, 800.0, "px", 40.0),
                    Real("right", 0.0, 800.0, "px", 40.0),
                    Real("delay", 0.0, 2.0, "s"),
                ),
                (
                    Extent("left", "right", 50.0, 800.0),
                    Duration("start", "end", 4.5, 90.0),
                    Dormant("label", "none", ("start", "end", "left", "right")),
                ),
            ),
        )
    )
    numeric = SearchSpace(
        (
            Component("scenario", (Real("gap", 1.0, 60.0, "m"), Real("speed", -3.0, 3.0, "m/s"))),
            Component("behaviour", (Real("noise", 0.0, 1.0), Integer("lag", 0, 20, "step"))),
        )
    )
    categorical = SearchSpace(
        (
            Component("scenario", tuple(Categorical(f"road-{i}", ("a", "b", "c")) for i in range(6))),
            Component("behaviour", tuple(Categorical(f"fault-{i}", ("off", "on")) for i in range(8))),
        )
    )
    techniques = ("noise", "blur", "rain", "dirt", "flare")
    slots = SearchSpace(
        (
            Component("scenario", (Categorical("weather", ("dry", "wet")), Real("gap", 1.0, 60.0, "m"))),
            Component(
                "perturbation",
                (
                    Categorical("gene_1", techniques),
                    Real("intensity_1", 0.0, 1.0),
                    Categorical("gene_2", techniques),
                    Real("intensity_2", 0.0, 1.0),
                ),
                (Slots((("gene_1", "intensity_1"), ("gene_2", "intensity_2")), (9, 24, 6, 11, 31)),),
            ),
        )
    )
    traffic = SearchSpace(
        (
            Component("scenario", (Categorical("weather", ("dry", "wet")),)),
            participants_component("participants", 4, RoadLimits(streets_m=(30.0,))),
        )
    )
    return {
        "mixed": mixed, "numeric": numeric, "categorical": categorical, "slots": slots, "traffic": traffic,
    }  # fmt: skip


class ContractBroken(SearchError, AssertionError):
    """An algorithm does not keep its contract."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """A campaign that was played.

    Attributes:
        generations: What was asked, generation by generation.
        archive: What was evaluated.
        documents: The state after each tell, as bytes.
    """

    generations: tuple[tuple[Candidate, ...], ...]
    archive: Archive
    documents: tuple[bytes, ...]

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """All candidates, in the order of asking."""
        return tuple(candidate for generation in self.generations for candidate in generation)


def made_up_verdicts(space: SearchSpace, failing: float = 0.1, seed: int = 0) -> Evaluate:
    """Return verdicts for any space, by candidate: unsafe below a plane through it; some fail.

    What is asked of a data set gets the objective ``alpha``; episodes have it, too, and how critical they are.

    Args:
        space: What the candidates come from.
        failing: Share of candidates that fail, in [0, 1].
        seed: Decides slant and failures.
    """
    rng = generator(seed, Stream.CONTRACT)
    slant = rng.standard_normal(space.dimension) / space.ranges
    heights = [float((space.join(space.sample(rng)) * slant).sum()) for _ in range(100)]
    threshold = float(np.quantile(heights, 0.4))

    def evaluate(candidate: Candidate) -> Evaluation:
        if generator(seed, Stream.CONTRACT, candidate.number).random() < failing:
            return Failed(reason="made up")
        robustness = float((space.join(candidate.vectors) * slant).sum()) - threshold
        alpha = float(1 / (1 + np.exp(-robustness)))
        if candidate.question is Question.DATASET:
            return Measured(objectives={"alpha": alpha})
        objectives = {"robustness": robustness, "alpha": alpha, "criticality_m": robustness}
        return Scored(unsafe=robustness < 0, robustness=robustness, objectives=objectives)

    return evaluate


def check_algorithm(
    algorithm: Algorithm,
    space: SearchSpace,
    *,
    budget: int,
    config: Any = None,
    evaluate: Evaluate | None = None,
    seed: int = 1,
    ends_itself: bool = False,
    repeats: bool = False,
) -> Run:
    """Check that an algorithm keeps its contract on a space; return the campaign that it played.

    Args:
        algorithm: What to check.
        space: One that it supports.
        budget: Simulations a campaign; large enough for a few generations.
        config: Its settings; the defaults if None.
        evaluate: Verdicts, a function of the candidate alone; made up if None.
        seed: The campaign's seed.
        ends_itself: Whether the algorithm has an end of its own before the budget is spent.
        repeats: Whether it asks the same solutions again on purpose.

    Raises:
        ContractBroken: It does not.
    """
    settings = algorithm.config_type() if config is None else config
    verdicts = made_up_verdicts(space) if evaluate is None else evaluate
    _expect(isinstance(algorithm.id, str) and "@" in algorithm.id, "id: expected a versioned id, name@1")
    _expect(bool(algorithm.summary), "summary: expected one line")
    algorithm.check(space, settings, budget=budget)

    def played(order: int = 1) -> Run:
        return play(algorithm, space, settings, verdicts, seed=seed, budget=budget, order=order)

    run = played()
    _check_candidates(space, run, repeats=repeats)
    _check_archive(run, verdicts)
    spent = len(run.candidates) >= budget or budget > space.size / 10 or ends_itself
    _expect(spent, "budget: expected all of it to be spent on a space with room for more")
    _check_same(run, played(), "the same seed must give the same campaign")
    _check_same(run, played(order=-1), "the order in which evaluations arrive must not matter")
    _check_order_errors(algorithm, space, settings, verdicts, seed, budget)
    _check_reload(algorithm, space, settings, verdicts, run, seed, budget)
    return run


def play(
    algorithm: Algorithm,
    space: SearchSpace,
    config: Any,
    evaluate: Evaluate,
    *,
    seed: int,
    budget: int,
    order: int = 1,
) -> Run:
    """Play a campaign to its end.

    Args:
        algorithm: What to play.
        space: What it searches.
        config: Its settings.
        evaluate: Gives the verdicts.
        seed: The campaign's seed.
        budget: Its simulations.
        order: 1 to tell evaluations in the order of asking, -1 to tell them backwards.

    Raises:
        ContractBroken: It does not end.
    """
    state = algorithm.start(space, config, seed=seed, budget=budget)
    _expect(not state.pending and state.generation == 0, "start: expected nothing asked yet")
    generations: list[tuple[Candidate, ...]] = []
    documents: list[bytes] = []
    while not algorithm.finished(state):
        _expect(len(generations) < _MOST_GENERATIONS, "finished: expected an end")
        state, candidates = algorithm.ask(state)
        _expect(bool(candidates), "ask: expected candidates, since the search was not finished")
        _expect(state.pending == candidates, "ask: expected what was asked to be pending")
        state = algorithm.tell(state, _evaluations(candidates, evaluate, order))
        generations.append(candidates)
        documents.append(algorithm.dump(state).to_bytes())
        _expect(state.generation == len(generations), "tell: expected one generation more")
        _expect(not state.pending, "tell: expected nothing pending")
    return Run(generations=tuple(generations), archive=state.archive, documents=tuple(documents))


def _expect(holds: bool, promise: str) -> None:
    if not holds:
        raise ContractBroken(promise)


def _evaluations(
    candidates: Sequence[Candidate], evaluate: Evaluate, order: int = 1
) -> Mapping[int, Evaluation]:
    return {candidate.number: evaluate(candidate) for candidate in candidates[::order]}


def _check_candidates(space: SearchSpace, run: Run, *, repeats: bool) -> None:
    numbers = [candidate.number for candidate in run.candidates]
    _expect(numbers == list(range(len(numbers))), "numbers: expected 0, 1, 2, … in the order of asking")
    for candidate in run.candidates:
        space.check(candidate.vectors)
        frozen = not any(vector.flags.writeable for vector in candidate.vectors)
        _expect(frozen, f"candidate {candidate.number}: expected read-only vectors")
    asked = {(candidate.question, space.join(candidate.vectors).tobytes()) for candidate in run.candidates}
    alone = repeats or len(asked) == len(numbers)
    _expect(alone, "duplicates: expected no solution to be asked the same thing twice")


def _check_archive(run: Run, evaluate: Evaluate) -> None:
    scored = {c.number: (c, e) for c in run.candidates if isinstance(e := evaluate(c), Scored)}
    archive = run.archive
    _expect(
        archive.numbers.tolist() == sorted(scored),
        "archive: expected every solution that did not fail, and no other, ascending by number",
    )
    for position, number in enumerate(archive.numbers.tolist()):
        candidate, evaluation = scored[number]
        same = np.array_equal(archive.vectors[position], np.concatenate(candidate.vectors))
        _expect(same, f"archive: expected the vectors of candidate {number} as they were asked")
        _expect(bool(archive.unsafe[position]) == evaluation.unsafe, f"archive: wrong verdict of {number}")
    again = archive.judged(archive.unsafe, archive.robustness)
    counted = np.array_equal(archive.neighbours, again.neighbours)
    counted &= np.array_equal(archive.unsafe_neighbours, again.unsafe_neighbours)
    _expect(counted, "archive: expected the counts that all distances at once give")


def _check_same(run: Run, other: Run, promise: str) -> None:
    _expect(archive_digest(run.archive) == archive_digest(other.archive), promise)
    _expect(run.documents == other.documents, promise)


def _check_order_errors(
    algorithm: Algorithm, space: SearchSpace, config: Any, evaluate: Evaluate, seed: int, budget: int
) -> None:
    state = algorithm.start(space, config, seed=seed, budget=budget)
    _expect(_refuses(lambda: algorithm.tell(state, {})), "tell before ask: expected OrderError")
    asked, candidates = algorithm.ask(state)
    evaluations = dict(_evaluations(candidates, evaluate))
    _expect(_refuses(lambda: algorithm.ask(asked)), "ask before tell: expected OrderError")
    _expect(not algorithm.finished(asked), "finished: expected False while evaluations are pending")
    incomplete = dict(list(evaluations.items())[1:])
    _expect(_refuses(lambda: algorithm.tell(asked, incomplete)), "incomplete tell: expected OrderError")
    foreign = evaluations | {candidates[-1].number + 1: Failed(reason="made up")}
    _expect(_refuses(lambda: algorithm.tell(asked, foreign)), "tell of a stranger: expected OrderError")
    first, second = algorithm.tell(asked, evaluations), algorithm.tell(asked, evaluations)
    same = algorithm.dump(first).to_bytes() == algorithm.dump(second).to_bytes()
    _expect(same, "purity: expected equal states from equal calls")


def _refuses(call: Callable[[], object]) -> bool:
    try:
        call()
    except OrderError:
        return True
    return False


def _check_reload(
    algorithm: Algorithm,
    space: SearchSpace,
    config: Any,
    evaluate: Evaluate,
    run: Run,
    seed: int,
    budget: int,
) -> None:
    """Go on from the stored state of every generation and expect the next one to be the same."""
    archive = run.archive
    asked, candidates = algorithm.ask(algorithm.start(space, config, seed=seed, budget=budget))
    waiting = algorithm.load(
        space, config, Document.from_bytes(algorithm.dump(asked).to_bytes()), asked.archive
    )
    _expect(_same_candidates(waiting.pending, candidates), "load: expected a waiting state to go on waiting")
    told = 0
    for position, stored in enumerate(run.documents):
        told += sum(isinstance(evaluate(c), Scored) for c in run.generations[position])
        state = algorithm.load(
            space, config, Document.from_bytes(stored), stored_and_restored(archive.first(told))
        )
        same = algorithm.dump(state).to_bytes() == stored
        _expect(same, f"load: expected the state after generation {position + 1} back")
        if position + 1 == len(run.documents):
            _expect(algorithm.finished(state), "load: expected a finished search to stay finished")
            continue
        state, candidates = algorithm.ask(state)
        same = _same_candidates(candidates, run.generations[position + 1])
        _expect(same, f"load: expected generation {position + 2} as it was without the break")
        state = algorithm.tell(state, _evaluations(candidates, evaluate))
        same = algorithm.dump(state).to_bytes() == run.documents[position + 1]
        _expect(same, f"load: expected generation {position + 2} told as it was without the break")


def _same_candidates(first: Sequence[Candidate], second: Sequence[Candidate]) -> bool:
    def content(candidate: Candidate) -> tuple[int, Question, list[bytes]]:
        return candidate.number, candidate.question, [vector.tobytes() for vector in candidate.vectors]

    return [content(candidate) for candidate in first] == [content(candidate) for candidate in second]


def stored_and_restored(archive: Archive) -> Archive:
    """Return an archive as it comes back from its stored arrays."""
    return Archive.restore(
        archive.metric,
        archive.neighbourhood,
        numbers=archive.numbers,
        vectors=archive.vectors,
        unsafe=archive.unsafe,
        robustness=archive.robustness,
        neighbours=archive.neighbours,
        unsafe_neighbours=archive.unsafe_neighbours,
    )
