"""muMOEA: an adaptive multi-objective search, seeded and, when it is stuck, unstuck from outside.

The population starts from seeds: those of a language model, or hand-written patterns. Crossover and mutation apply
where adaptive rates reach a threshold that falls as the population converges; what they change depends on how good
each participant is. Once no new kind of violation was found for some generations (or, as the paper has it, the first
front was the same), differential seeds are wanted: solutions that expose violations and differ from those known.
Those that do not differ enough go back, a few times; what is then missing is made by major mutation.

Where the seeds come from a model, the search does not ask it itself: it says what it wants (`brink.search.seeding`).

Source: Tian et al., "An LLM-Empowered Adaptive Evolutionary Algorithm for Multi-Component Deep Learning Systems".
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Any, Final

import numpy as np

from brink.search.actions.distance import matched_distances, participant_distances
from brink.search.actions.genome import Genome
from brink.search.actions.patterns import hostile_solution
from brink.search.actions.variation import Solution, crossed_genes, major_change, prolonged, small_change
from brink.search.adaptive_rates import (
    Crossover,
    Population,
    crossover_probability,
    mutation_probability,
    scalar_fitness,
    scaled,
)
from brink.search.algorithm import Candidate, Evaluation, Scored
from brink.search.algorithms.ledger import check_budget, stored_rows
from brink.search.algorithms.multi_objective import (
    Child,
    MultiObjectiveConfig,
    MultiObjectiveState,
    breeding_rng,
    child_of,
    dump_state,
    load_state,
    opened,
    queued,
    random_children,
    survived,
)
from brink.search.archive import Archive
from brink.search.component import FloatArray
from brink.search.document import Document
from brink.search.errors import ConfigError, DocumentError, OrderError
from brink.search.seeding import Origin, Proposal, SeedRequest
from brink.search.settings import setting
from brink.search.space import SearchSpace
from brink.search.streams import Stream, generator

_VERSION: Final = 2
_BEST_SHARE: Final = 0.25
"""Participants in this share of the population, by any objective, change a little rather than a lot."""
_COMPARED: Final = 12
"""Known solutions of either kind that proposals are compared with, the latest."""
_SHOWN: Final = 3
"""Known solutions of either kind that a request shows."""


class Want(StrEnum):
    """What is wanted from outside."""

    NOTHING = "nothing"
    INITIAL = "initial"
    DIFFERENTIAL = "differential"


@dataclass(frozen=True, slots=True, kw_only=True)
class MumoeaConfig(MultiObjectiveConfig):
    """Settings of muMOEA; `initial: random` and `differential: never` are its ablations."""

    seeder: str = setting(
        "heuristic", help="Who makes seeds: hand-written patterns, or a language model.",
        choices=("heuristic", "llm"),
    )  # fmt: skip
    initial: str = setting("seeds", help="What the first population is made of.", choices=("seeds", "random"))
    differential: str = setting(
        "stuck", help="When differential seeds are asked for.", choices=("stuck", "never", "always")
    )
    stuck_by: str = setting(
        "kinds", choices=("kinds", "front"),
        help="A generation gets nowhere if it finds no new kind of violation, or does not change the first front.",
    )  # fmt: skip
    stuck_after: int = setting(
        3, help="Generations in a row that get nowhere and so mean stuck (t).", ge=1, le=1_000
    )
    seeds: int = setting(10, help="Differential seeds that are wanted at a time.", ge=1, le=200)
    rounds: int = setting(3, help="How often seeds that do not differ enough go back.", ge=0, le=10)
    least_share: float = setting(
        0.5, help="A seed's least distance to a violation, as a share of the known solutions' median.", ge=0, le=1
    )  # fmt: skip
    weight: float = setting(0.5, help="Weight of criticality in the scalar fitness (w).", ge=0, le=1)
    crossover: str = setting(
        "mirror", help="Form of the adaptive crossover rate.", choices=tuple(str(form) for form in Crossover)
    )
    k1: float = setting(0.6, help="Crossover rate at the mean fitness.", ge=0, le=10)
    k2: float = setting(0.6, help="Mutation rate at the mean fitness.", ge=0, le=10)
    k3: float = setting(1.0, help="Cap of the crossover rate.", ge=0, le=1)
    k4: float = setting(1.0, help="Cap of the mutation rate.", ge=0, le=1)
    c1: float = setting(0.5, help="Weight of the upper half of the fitness in the threshold.", ge=0, le=1)
    m1: float = setting(0.5, help="Weight of the lower half of the fitness in the threshold.", ge=0, le=1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MumoeaState(MultiObjectiveState):
    """State of muMOEA.

    Attributes:
        want: What is wanted before the next generation.
        requests: How many requests were made before this one.
        round: Of the request that is wanted.
        taken: Accepted seeds so far, as rows, and where each comes from.
        rejected: Proposals of the last round that were not different enough, as rows.
        kinds: Of violations found so far.
        stuck: For how many generations it has been getting nowhere.
    """

    config: MumoeaConfig
    want: Want
    requests: int
    round: int
    taken: tuple[Child, ...]
    rejected: tuple[FloatArray, ...]
    kinds: frozenset[str]
    stuck: int


class Mumoea:
    """The adaptive search with seeds."""

    id = "mumoea@1"
    summary = "muMOEA: adaptive multi-objective search, seeded by patterns or a language model."
    config_type: type[Any] = MumoeaConfig

    def check(self, space: SearchSpace, config: MumoeaConfig, *, budget: int) -> None:
        """Raise UnsupportedSpace without participants, ConfigError if budget or settings do not fit."""
        Genome.of(space)
        check_budget(budget, config.population_size)
        if config.seeds > config.population_size:
            raise ConfigError("seeds", f"expected at most population_size, got {config.seeds}")
        if config.seeder == "llm" and config.initial == "random" and config.differential == "never":
            raise ConfigError(
                "seeder", "expected initial: seeds or differential seeds with llm; it is never asked"
            )

    def start(self, space: SearchSpace, config: MumoeaConfig, *, seed: int, budget: int) -> MumoeaState:
        """Return the first state, with nothing asked yet."""
        self.check(space, config, budget=budget)
        genome = Genome.of(space)
        base = opened(space, config, seed=seed, budget=budget)
        state = MumoeaState(
            **{name: getattr(base, name) for name in _FIELDS},
            want=Want.NOTHING, requests=0, round=0, taken=(), rejected=(), kinds=frozenset(), stuck=0,
        )  # fmt: skip
        rng = generator(seed, Stream.START)
        if config.initial == "random":
            return queued(state, random_children(genome, config.population_size, rng), genome, rng)
        if config.seeder == "llm":
            return replace(state, want=Want.INITIAL)
        return queued(state, _patterns(genome, config.population_size, rng), genome, rng)

    def ask(self, state: MumoeaState) -> tuple[MumoeaState, tuple[Candidate, ...]]:
        """Return a state with a pending generation, and that generation."""
        if state.want is not Want.NOTHING:
            raise OrderError("ask: give the seeds that are wanted first")
        ledger = state.ledger.handed_out()
        return replace(state, ledger=ledger), ledger.pending

    def tell(self, state: MumoeaState, evaluations: Mapping[int, Evaluation]) -> MumoeaState:
        """Return the state after the pending generation was evaluated.

        Raises:
            OrderError: Nothing is pending, or the numbers are not the pending ones.
            KeyError: An evaluation lacks the objective of criticality.
        """
        genome = Genome.of(state.ledger.space)
        told = _moved(state, survived(state, evaluations, genome), evaluations)
        config = told.config
        stuck = config.differential == "always" or (
            config.differential == "stuck" and told.stuck >= config.stuck_after
        )
        if not stuck or told.ledger.left <= 0 or not told.population:
            return _bred(told, genome)
        if config.seeder == "llm":
            return replace(told, want=Want.DIFFERENTIAL, stuck=0)
        rng = generator(told.ledger.seed, Stream.SEEDS, told.ledger.generation)
        wanted = replace(told, want=Want.DIFFERENTIAL, stuck=0)
        for _ in range(config.rounds + 1):
            rows = self.own_seeds(genome, config.seeds, rng)
            wanted = _received(wanted, rows, genome)
            if wanted.want is Want.NOTHING:
                break
        return wanted

    def finished(self, state: MumoeaState) -> bool:
        """Return whether the budget is spent, or nothing new was found."""
        return not state.ledger.queue and state.want is Want.NOTHING

    def wanted(self, state: MumoeaState) -> SeedRequest | None:
        """Return what is wanted from outside before the next generation can be asked, or None."""
        if state.want is Want.NOTHING:
            return None
        genome, config = Genome.of(state.ledger.space), state.config
        if state.want is Want.INITIAL:
            return SeedRequest(number=state.requests, count=config.population_size)
        exposed, silent = _known(state)
        return SeedRequest(
            number=state.requests,
            count=config.seeds - len(state.taken),
            exposed=tuple(genome.solution(state.book.rows[number]) for number in exposed[:_SHOWN]),
            silent=tuple(genome.solution(state.book.rows[number]) for number in silent[:_SHOWN]),
            rejected=tuple(genome.solution(row) for row in state.rejected),
            round=state.round,
        )

    def seeded(self, state: MumoeaState, proposals: Sequence[Proposal]) -> MumoeaState:
        """Return the state after proposals came, perhaps none.

        Raises:
            OrderError: Nothing is wanted.
        """
        if state.want is Want.NOTHING:
            raise OrderError("seeded: nothing is wanted")
        genome = Genome.of(state.ledger.space)
        rng = generator(state.ledger.seed, Stream.SEEDS, state.ledger.generation, state.requests)
        rows: list[Child] = [
            (genome.row(proposal.solution, _like(state), rng), proposal.origin) for proposal in proposals
        ]
        state = replace(state, requests=state.requests + 1)
        if state.want is Want.INITIAL:
            missing = max(0, state.config.population_size - len(rows))
            seeds = [*rows, *_patterns(genome, missing, rng)]
            return queued(replace(state, want=Want.NOTHING), seeds, genome, rng)
        if not rows:
            # Nobody answers: patterns once, and no further round.
            state = replace(state, round=state.config.rounds)
            rows = self.own_seeds(genome, state.config.seeds, rng)
        return _received(state, rows, genome)

    def own_seeds(self, genome: Genome, count: int, rng: np.random.Generator) -> list[Child]:
        """Return differential seeds: patterns that go on with random actions, since short ones hardly differ."""
        drawn = [hostile_solution(genome.road, genome.most, rng) for _ in range(count)]
        return [
            (genome.row(tuple(prolonged(one, rng) for one in solution), None, rng), Origin.HEURISTIC)
            for solution in drawn
        ]

    def dump(self, state: MumoeaState) -> Document:
        """Return the state without its archive, as a versioned document."""
        document = dump_state(
            state,
            self.id,
            _VERSION,
            {
                "want": state.want.value,
                "requests": state.requests,
                "round": state.round,
                "stuck": state.stuck,
                "kinds": sorted(state.kinds),
                "taken_origins": [origin.value for _, origin in state.taken],
            },
        )
        width = state.ledger.space.dimension
        tables = {
            "taken": np.reshape([row for row, _ in state.taken], (len(state.taken), width)),
            "rejected": np.reshape(list(state.rejected), (len(state.rejected), width)),
        }
        arrays = {name: table.astype(np.float64) for name, table in tables.items()}
        return replace(document, arrays={**document.arrays, **arrays})

    def load(
        self, space: SearchSpace, config: MumoeaConfig, document: Document, archive: Archive
    ) -> MumoeaState:
        """Return the state that `dump` wrote, with the archive that it had then."""
        base = load_state(space, config, document.expect(self.id, _VERSION), archive)
        header = document.header
        origins, want = header.get("taken_origins"), header.get("want")
        taken = _stored_table(document, "taken", space.dimension)
        if not isinstance(origins, list) or not set(origins) <= set(Origin) or len(origins) != len(taken):
            raise DocumentError(f"taken_origins: expected one of each seed taken, got {origins!r}")
        if want not in set(Want):
            raise DocumentError(f"want: expected one of {', '.join(Want)}, got {want!r}")
        counts = [header.get(name) for name in ("requests", "round", "stuck")]
        if not all(isinstance(count, int) for count in counts):
            raise DocumentError(f"requests, round, stuck: expected whole numbers, got {counts!r}")
        kinds = header.get("kinds")
        if not isinstance(kinds, list) or not all(isinstance(kind, str) for kind in kinds):
            raise DocumentError(f"kinds: expected words, got {kinds!r}")
        return MumoeaState(
            **{name: getattr(base, name) for name in _FIELDS},
            want=Want(str(want)), requests=int(str(counts[0])), round=int(str(counts[1])),
            taken=tuple(zip(taken, (Origin(origin) for origin in origins), strict=True)),
            rejected=_stored_table(document, "rejected", space.dimension),
            kinds=frozenset(kinds), stuck=int(str(counts[2])),
        )  # fmt: skip


_FIELDS: Final = tuple(field.name for field in fields(MultiObjectiveState))


def _moved(before: MumoeaState, told: MumoeaState, evaluations: Mapping[int, Evaluation]) -> MumoeaState:
    """Return the state with the kinds that a generation found, and for how long it has been getting nowhere."""
    kinds = before.kinds.union(
        *(evaluation.kinds for evaluation in evaluations.values() if isinstance(evaluation, Scored))
    )
    if told.config.stuck_by == "kinds":
        nowhere = kinds == before.kinds
    else:
        nowhere = _rows_of_front(before) == _rows_of_front(told)
    return replace(told, kinds=kinds, stuck=before.stuck + 1 if nowhere else 0)


def _rows_of_front(state: MumoeaState) -> set[bytes]:
    return {state.book.rows[number].tobytes() for number in state.front}


def _patterns(genome: Genome, count: int, rng: np.random.Generator) -> list[Child]:
    """Return seeds from hand-written patterns."""
    return [
        (genome.row(hostile_solution(genome.road, genome.most, rng), None, rng), Origin.HEURISTIC)
        for _ in range(count)
    ]


def _like(state: MumoeaState) -> FloatArray | None:
    """Return the row whose other components seeds take over: the best one's."""
    return state.book.rows[state.population[0]] if state.population else None


def _known(state: MumoeaState) -> tuple[list[int], list[int]]:
    """Return the solutions that exposed a violation and those that did not, the latest first."""
    lately = state.book.lately(state.config.lately)[::-1]
    exposed = [number for number in lately if state.book.unsafe[number]]
    return exposed, [number for number in lately if not state.book.unsafe[number]]


def _received(state: MumoeaState, rows: Sequence[Child], genome: Genome) -> MumoeaState:
    """Return the state with those seeds taken that differ enough; it may want another round."""
    config = state.config
    differ = different_enough(state, [row for row, _ in rows], genome)
    taken = [child for child, fine in zip(rows, differ, strict=True) if fine]
    state = replace(state, taken=(*state.taken, *taken)[: config.seeds])
    missing = config.seeds - len(state.taken)
    if missing and state.round < config.rounds:
        rejected = tuple(row for (row, _), fine in zip(rows, differ, strict=True) if not fine)
        return replace(state, round=state.round + 1, rejected=rejected)
    rng = generator(state.ledger.seed, Stream.SEEDS, state.ledger.generation, state.requests, 1)
    seeds = [*state.taken, *(_majorly_mutated(state, genome, rng) for _ in range(missing))]
    return _bred(replace(state, want=Want.NOTHING, round=0, taken=(), rejected=()), genome, seeds)


def different_enough(state: MumoeaState, rows: Sequence[FloatArray], genome: Genome) -> list[bool]:
    """Return which seeds differ from what is known: on the mean as much as known ones do among themselves.

    No seed may lie nearer than a share of that to a solution that exposed a violation, to a seed that was taken, or
    to an earlier one of these that is taken.
    """
    if not rows:
        return []
    exposed, silent = (numbers[:_COMPARED] for numbers in _known(state))
    numbers = [*exposed, *silent]
    known = genome.rolled_out(genome.solution(state.book.rows[number]) for number in numbers)
    among = matched_distances(known, known)[np.triu_indices(len(numbers), 1)]
    median_m = float(np.median(among)) if among.size else 0.0
    proposed = genome.rolled_out(genome.solution(row) for row in rows)
    apart = matched_distances(proposed, known)
    mean_m = apart.mean(axis=1) if numbers else np.full(len(rows), np.inf)
    least_m = apart[:, : len(exposed)].min(axis=1, initial=np.inf)
    taken = genome.rolled_out(genome.solution(row) for row, _ in state.taken)
    least_m = np.minimum(least_m, matched_distances(proposed, taken).min(axis=1, initial=np.inf))
    between = matched_distances(proposed, proposed)
    enough_m = state.config.least_share * median_m
    fine: list[bool] = []
    for place in range(len(rows)):
        nearest_m = min(
            (float(between[place, other]) for other in range(place) if fine[other]), default=np.inf
        )
        fine.append(bool(mean_m[place] >= median_m and min(least_m[place], nearest_m) >= enough_m))
    return fine


def _majorly_mutated(state: MumoeaState, genome: Genome, rng: np.random.Generator) -> Child:
    """Return a child of a random solution of the population, all of whose participants have changed a lot."""
    parent = state.population[int(rng.integers(len(state.population)))]
    solution = genome.solution(state.book.rows[parent])
    changed = tuple(major_change(one, rng) for one in solution)
    return child_of(state, genome, changed, parent, Origin.MUTATION, rng)


def _bred(state: MumoeaState, genome: Genome, seeds: Sequence[Child] = ()) -> MumoeaState:
    """Return the state with the next generation queued: seeds, mutants, and children of pairs."""
    rng = breeding_rng(state)
    if not state.population or state.ledger.left <= 0:
        return queued(state, seeds, genome, rng)
    breeding = _Breeding(state, genome)
    children = [*seeds, *breeding.mutants(rng)]
    wanted = state.config.population_size - len(children)
    children += breeding.crossed(max(0, wanted), rng)
    while len(children) < state.config.population_size:
        children.append(_majorly_mutated(state, genome, rng))
    return queued(state, children, genome, rng)


class _Breeding:
    """Adaptive variation of one population."""

    def __init__(self, state: MumoeaState, genome: Genome) -> None:
        self._state = state
        self._genome = genome
        config = state.config
        bounds = state.criticality_bounds, state.diversity_bounds
        self._fitness = scalar_fitness(
            scaled(state.fitness, bounds[0].low, bounds[0].high),
            scaled(state.diversity, bounds[1].low, bounds[1].high),
            config.weight,
        )
        self._population = Population.of(self._fitness)
        self._threshold = self._population.threshold(config.c1, config.m1)
        self._solutions = [genome.solution(state.book.rows[number]) for number in state.population]
        lately = state.book.lately(config.lately)
        self._gaps = state.book.gaps[list(state.population)]
        self._unlike = participant_distances(
            genome.rolled_out(self._solutions),
            genome.rolled_out(genome.solution(state.book.rows[number]) for number in lately),
        )

    def mutants(self, rng: np.random.Generator) -> list[Child]:
        """Return a mutant of each solution whose mutation rate reaches the threshold, the worst first."""
        config = self._state.config
        rates = mutation_probability(self._fitness, config.k2, config.k4)
        order = sorted(range(len(rates)), key=lambda place: -rates[place])
        chosen = [place for place in order if rates[place] >= self._threshold]
        # At least half of a generation is left to crossover, or a spread population would only mutate.
        return [self._mutant(place, rng) for place in chosen[: config.population_size // 2]]

    def _mutant(self, place: int, rng: np.random.Generator) -> Child:
        known_gaps = self._gaps[np.isfinite(self._gaps)]
        near_m = np.quantile(known_gaps, _BEST_SHARE) if known_gaps.size else -np.inf
        known = self._unlike[np.isfinite(self._unlike)]
        far_m = np.quantile(known, 1.0 - _BEST_SHARE) if known.size else np.inf
        changed: list[Any] = []
        for index, one in enumerate(self._solutions[place]):
            good = self._gaps[place, index] <= near_m or self._unlike[place, index] >= far_m
            changed.append(small_change(one, rng) if good else major_change(one, rng))
        return self._child(tuple(changed), place, Origin.MUTATION, rng)

    def crossed(self, count: int, rng: np.random.Generator) -> list[Child]:
        """Return children of the pairs with the highest crossover rates, if these reach the threshold."""
        config = self._state.config
        firsts, seconds = np.triu_indices(len(self._fitness), 1)
        better = np.maximum(self._fitness[firsts], self._fitness[seconds])
        rates = crossover_probability(
            better, self._population, Crossover(config.crossover), config.k1, config.k3
        )
        order = np.lexsort((rng.random(len(rates)), -rates))
        children: list[Child] = []
        for pair in order.tolist():
            if len(children) >= count or rates[pair] < self._threshold:
                break
            children += self._children(int(firsts[pair]), int(seconds[pair]), rng)
        return children[:count]

    def _children(self, first: int, second: int, rng: np.random.Generator) -> list[Child]:
        """Cross the best participant of the better parent with a random one of the other."""
        if self._fitness[second] > self._fitness[first]:
            first, second = second, first
        mother, father = self._solutions[first], self._solutions[second]
        mine, yours = self._best_participant(first), int(rng.integers(len(father)))
        crossed = crossed_genes(mother[mine], father[yours], rng)
        return [
            self._child(_with(mother, mine, crossed[0]), first, Origin.CROSSOVER, rng),
            self._child(_with(father, yours, crossed[1]), second, Origin.CROSSOVER, rng),
        ]

    def _best_participant(self, place: int) -> int:
        """Return the best participant of a solution on the objective on which the solution ranks best."""
        objectives = self._state.objectives
        placings = (objectives < objectives[place]).sum(axis=0)
        count = len(self._solutions[place])
        if placings[0] <= placings[1]:
            return int(np.argmin(self._gaps[place, :count]))
        return int(np.argmax(np.nan_to_num(self._unlike[place, :count], nan=0.0)))

    def _child(self, solution: Solution, place: int, origin: Origin, rng: np.random.Generator) -> Child:
        parent = self._state.population[place]
        return child_of(self._state, self._genome, solution, parent, origin, rng)


def _with(solution: Solution, place: int, participant: Any) -> Solution:
    return (*solution[:place], participant, *solution[place + 1 :])


def _stored_table(document: Document, name: str, width: int) -> tuple[FloatArray, ...]:
    """Return the rows of a table of a document."""
    return tuple(stored_rows(document, name, width))
