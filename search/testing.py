"""Contract tests for search algorithms, to be run on every plug-in.

`check_algorithm` plays whole campaigns against synthetic verdicts, some of them failures. It raises `ContractBroken`
at the first clause that does not hold.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from brink.search.algorithm import (
    AnyAlgorithm,
    Candidate,
    Evaluation,
    Failed,
    Known,
    Measured,
    Niche,
    Overlapping,
    Question,
    Scored,
    WarmStarts,
    ask_all,
)
from brink.search.archive import ARRAYS, Archive, archive_digest
from brink.search.document import Document
from brink.search.errors import OrderError, SearchError
from brink.search.slots import Slots
from brink.search.space import Categorical, Component, Dormant, Duration, Extent, Integer, Real, SearchSpace
from brink.search.streams import Stream, generator
from brink.search.traffic.constraint import participants_component
from brink.search.traffic.participants import RoadLimits

Evaluate = Callable[[Candidate], Evaluation]

_MAX_GENERATIONS = 100_000


def example_spaces() -> dict[str, SearchSpace]:
    """Return spaces of two components that together cover every kind of parameter and constraint."""
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
    declared = SearchSpace(
        (
            Component(
                "scenario",
                (
                    Real("gap", 0.0, 10.0, "m", step=0.1),
                    Integer("cars", 0, 30, step=3),
                    Categorical("road", ("a", "b")),
                ),
            ),
            Component(
                "behaviour",
                (
                    Categorical("type", ("late", "lost", "none")),
                    Real("rate", 1e-6, 1.0, "1/s", log=True, when=(("type", ("late", "lost")),)),
                    Categorical("how", ("once", "often"), when=(("type", ("lost",)),)),
                    Integer("times", 2, 9, when=(("how", ("often",)),)),
                    Real("noise", 0.0, 1.0),
                ),
            ),
        )
    ).constrained(["gap > cars / 5", "road == 'a' or noise < 0.8"])
    return {
        "mixed": mixed,
        "numeric": numeric,
        "categorical": categorical,
        "slots": slots,
        "traffic": traffic,
        "declared": declared,
    }


class ContractBroken(SearchError, AssertionError):
    """An algorithm violates its contract."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """A campaign run to its end.

    Attributes:
        generations: Candidates of each generation, in the order of asking.
        archive: The final archive.
        documents: The state after each `tell`, as bytes.
    """

    generations: tuple[tuple[Candidate, ...], ...]
    archive: Archive
    documents: tuple[bytes, ...]

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """All candidates, in the order of asking."""
        return tuple(candidate for generation in self.generations for candidate in generation)


def synthetic_verdicts(space: SearchSpace, failing: float = 0.1, seed: int = 0) -> Evaluate:
    """Return a function that evaluates candidates of any space: unsafe on one side of a random plane.

    Data-set evaluations have the objective ``alpha``; episodes have ``alpha``, ``robustness`` and ``criticality_m``,
    and a niche for each layer of space along the plane.

    Args:
        space: Space of the candidates.
        failing: Share of candidates that fail, in [0, 1].
        seed: Determines the plane and the failures.
    """
    rng = generator(seed, Stream.CONTRACT)
    normal = rng.standard_normal(space.dimension) / space.ranges
    heights = [float((space.join(space.sample(rng)) * normal).sum()) for _ in range(100)]
    threshold = float(np.quantile(heights, 0.4))

    def evaluate(candidate: Candidate) -> Evaluation:
        if generator(seed, Stream.CONTRACT, candidate.number).random() < failing:
            return Failed(reason="synthetic")
        robustness = float((space.join(candidate.vectors) * normal).sum()) - threshold
        alpha = float(1 / (1 + np.exp(-robustness)))
        if candidate.question is Question.DATASET:
            return Measured(objectives={"alpha": alpha})
        objectives = {"robustness": robustness, "alpha": alpha, "criticality_m": robustness}
        niche = Niche(name=(f"layer {round(robustness)}",), rank=int(robustness >= 0), value=abs(robustness))
        return Scored(unsafe=robustness < 0, robustness=robustness, objectives=objectives, niches=(niche,))

    return evaluate


def check_algorithm(
    algorithm: AnyAlgorithm,
    space: SearchSpace,
    *,
    budget: int,
    config: Any = None,
    evaluate: Evaluate | None = None,
    seed: int = 1,
    ends_itself: bool = False,
    repeats: bool = False,
    known: Known | None = None,
) -> Run:
    """Check that an algorithm fulfils its contract on a space; return the campaign that was run.

    Args:
        algorithm: The algorithm to check.
        space: A space that it supports.
        budget: Simulations per campaign; enough for a few generations.
        config: Its settings; None for the defaults.
        evaluate: Evaluates a candidate, deterministically; None for synthetic verdicts.
        seed: The campaign's seed.
        ends_itself: Whether the algorithm may finish before the budget is spent.
        repeats: Whether the algorithm may ask for the same solution repeatedly.
        known: What the search starts from, for algorithms that support it; None for nothing.

    Raises:
        ContractBroken: A clause of the contract does not hold.
    """
    settings = algorithm.config_type() if config is None else config
    verdicts = synthetic_verdicts(space) if evaluate is None else evaluate
    _expect(isinstance(algorithm.id, str) and "@" in algorithm.id, "id: expected a versioned id, name@1")
    _expect(bool(algorithm.summary), "summary: expected one line")
    algorithm.check(space, settings, budget=budget)

    def start() -> Any:
        return started(algorithm, space, settings, seed=seed, budget=budget, known=known)

    def campaign(order: int = 1) -> Run:
        return _played(algorithm, start(), verdicts, order)

    run = campaign()
    _check_candidates(space, run, repeats=repeats)
    if known is not None:
        _check_known(space, run, known, repeats=repeats)
    _check_archive(run, verdicts)
    spent = len(run.candidates) >= budget or budget > space.size / 10 or ends_itself
    _expect(spent, "budget: expected the whole budget to be spent on a space with enough solutions")
    if not _same(run, campaign(order=-1)):
        _expect(_same(run, campaign()), "the same seed must give the same campaign")
        raise ContractBroken("the order in which evaluations arrive must not matter")
    _check_order_errors(algorithm, start(), verdicts)
    _check_reload(algorithm, space, settings, verdicts, run, start())
    return run


def started(
    algorithm: AnyAlgorithm,
    space: SearchSpace,
    config: Any,
    *,
    seed: int,
    budget: int,
    known: Known | None = None,
) -> Any:
    """Return the initial state of a search.

    Args:
        algorithm: The algorithm.
        space: The search space.
        config: The algorithm's settings.
        seed: The campaign's seed.
        budget: Number of simulations.
        known: What the search starts from; None for nothing.

    Raises:
        ContractBroken: Something is known, and the algorithm does not support that.
    """
    if known is None:
        return algorithm.start(space, config, seed=seed, budget=budget)
    if not isinstance(algorithm, WarmStarts):
        raise ContractBroken(f"{algorithm.id}: expected start_with, to start from what is known")
    return algorithm.start_with(space, config, seed=seed, budget=budget, known=known)


def play(
    algorithm: AnyAlgorithm,
    space: SearchSpace,
    config: Any,
    evaluate: Evaluate,
    *,
    seed: int,
    budget: int,
    order: int = 1,
    known: Known | None = None,
) -> Run:
    """Run a campaign to its end.

    Args:
        algorithm: The algorithm.
        space: The search space.
        config: The algorithm's settings.
        evaluate: Evaluates a candidate.
        seed: The campaign's seed.
        budget: Number of simulations.
        order: 1 to tell evaluations in the order of asking, -1 in reverse.
        known: What the search starts from; None for nothing.

    Raises:
        ContractBroken: The campaign does not end, or its states are inconsistent.
    """
    state = started(algorithm, space, config, seed=seed, budget=budget, known=known)
    return _played(algorithm, state, evaluate, order)


def _played(algorithm: AnyAlgorithm, state: Any, evaluate: Evaluate, order: int) -> Run:
    _expect(not state.pending and state.generation == 0, "start: expected nothing asked yet")
    generations: list[tuple[Candidate, ...]] = []
    documents: list[bytes] = []
    while not algorithm.finished(state):
        _expect(len(generations) < _MAX_GENERATIONS, "finished: expected the search to end")
        state, asked = ask_all(algorithm, state)
        _expect(all(asked), "ask: expected candidates, as the search was not finished")
        generations += asked
        _expect(len(documents) < len(generations), "ask: expected candidates, as the search was not finished")
        candidates = generations[len(documents)]
        _expect(state.pending == candidates, "ask: expected the oldest generation in flight to be pending")
        state = algorithm.tell(state, _evaluations(candidates, evaluate, order))
        documents.append(algorithm.dump(state).to_bytes())
        _expect(state.generation == len(documents), "tell: expected the generation to increase by one")
        flying = generations[len(documents)] if len(documents) < len(generations) else ()
        _expect(state.pending == flying, "tell: expected the next generation in flight to be pending, if any")
    _expect(len(documents) == len(generations), "finished: expected False while evaluations are pending")
    return Run(generations=tuple(generations), archive=state.archive, documents=tuple(documents))


def _expect(holds: bool, clause: str) -> None:
    if not holds:
        raise ContractBroken(clause)


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
    unique = repeats or len(asked) == len(numbers)
    _expect(unique, "duplicates: expected no solution to be evaluated twice in the same way")


def _check_known(space: SearchSpace, run: Run, known: Known, *, repeats: bool) -> None:
    """Check that a search simulates the known points first, and known solutions only if it repeats any."""
    asked = [space.join(candidate.vectors).tobytes() for candidate in run.candidates]
    points = [point.tobytes() for point in known.points]
    _expect(
        asked[: len(points)] == points,
        "known: expected the points to be the first candidates, in their order",
    )
    rows = {row.tobytes() for row in known.rows}
    _expect(
        repeats or not rows & set(asked), "known: expected no solution whose result is known to be simulated"
    )


def _check_archive(run: Run, evaluate: Evaluate) -> None:
    scored = {c.number: (c, e) for c in run.candidates if isinstance(e := evaluate(c), Scored)}
    archive = run.archive
    _expect(
        archive.numbers.tolist() == sorted(scored),
        "archive: expected every solution that did not fail, and no others, ascending by number",
    )
    for position, number in enumerate(archive.numbers.tolist()):
        candidate, evaluation = scored[number]
        same = np.array_equal(archive.vectors[position], np.concatenate(candidate.vectors))
        _expect(same, f"archive: expected the vectors of candidate {number} unchanged")
        _expect(
            bool(archive.unsafe[position]) == evaluation.unsafe,
            f"archive: wrong verdict of candidate {number}",
        )
    again = archive.with_verdicts(archive.unsafe, archive.robustness)
    counted = np.array_equal(archive.neighbours, again.neighbours)
    counted &= np.array_equal(archive.unsafe_neighbours, again.unsafe_neighbours)
    _expect(counted, "archive: expected the same counts as computed from scratch")


def _same(run: Run, other: Run) -> bool:
    return archive_digest(run.archive) == archive_digest(other.archive) and run.documents == other.documents


def _check_order_errors(algorithm: AnyAlgorithm, state: Any, evaluate: Evaluate) -> None:
    _expect(_refuses(lambda: algorithm.tell(state, {})), "tell before ask: expected OrderError")
    once, candidates = algorithm.ask(state)
    evaluations = dict(_evaluations(candidates, evaluate))
    if isinstance(algorithm, Overlapping) and algorithm.can_ask(once):
        _expect(
            _refuses(lambda: algorithm.tell(once, evaluations)),
            "tell before every generation was asked for: expected OrderError",
        )
    asked, _ = ask_all(algorithm, once)
    _expect(_refuses(lambda: algorithm.ask(asked)), "ask before tell: expected OrderError")
    _expect(not algorithm.finished(asked), "finished: expected False while evaluations are pending")
    incomplete = dict(list(evaluations.items())[1:])
    _expect(_refuses(lambda: algorithm.tell(asked, incomplete)), "incomplete tell: expected OrderError")
    foreign = evaluations | {candidates[-1].number + 1: Failed(reason="synthetic")}
    _expect(
        _refuses(lambda: algorithm.tell(asked, foreign)), "tell of an unknown candidate: expected OrderError"
    )
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
    algorithm: AnyAlgorithm, space: SearchSpace, config: Any, evaluate: Evaluate, run: Run, state: Any
) -> None:
    """Check that a search resumed from the stored state of any generation continues with the same next generation."""
    archive = run.archive
    asked, _ = ask_all(algorithm, state)
    waiting = algorithm.load(
        space, config, Document.from_bytes(algorithm.dump(asked).to_bytes()), asked.archive
    )
    _expect(
        _same_candidates(waiting.pending, run.generations[0]),
        "load: expected the pending candidates of a stored state",
    )
    archived = 0
    for position, stored in enumerate(run.documents, start=1):
        archived += sum(isinstance(evaluate(c), Scored) for c in run.generations[position - 1])
        state = algorithm.load(
            space, config, Document.from_bytes(stored), stored_and_restored(archive.first(archived))
        )
        same = algorithm.dump(state).to_bytes() == stored
        _expect(same, f"load: expected the same state as stored after generation {position}")
        if position == len(run.documents):
            _expect(algorithm.finished(state), "load: expected a finished search to stay finished")
            continue
        state, _ = ask_all(algorithm, state)
        candidates = run.generations[position]
        same = _same_candidates(state.pending, candidates)
        _expect(
            same, f"load: expected the same candidates in generation {position + 1} as without the restart"
        )
        state = algorithm.tell(state, _evaluations(candidates, evaluate))
        same = algorithm.dump(state).to_bytes() == run.documents[position]
        _expect(same, f"load: expected the same state after generation {position + 1} as without the restart")


def _same_candidates(first: Sequence[Candidate], second: Sequence[Candidate]) -> bool:
    def content(candidate: Candidate) -> tuple[int, Question, int | None, list[bytes]]:
        return (
            candidate.number,
            candidate.question,
            candidate.seed_number,
            [vector.tobytes() for vector in candidate.vectors],
        )

    return [content(candidate) for candidate in first] == [content(candidate) for candidate in second]


def stored_and_restored(archive: Archive) -> Archive:
    """Return an archive restored from its own arrays."""
    arrays = {name: getattr(archive, name) for name in ARRAYS}
    return Archive.restore(archive.metric, archive.neighbourhood, **arrays)
