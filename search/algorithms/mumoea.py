"""muMOEA: an adaptive multi-objective search that takes seeds from outside, at the start and whenever it is stuck.

The population starts from seeds: proposals of a language model, or hand-written patterns. Crossover and mutation
apply where adaptive rates reach a threshold that falls as the population converges; what they change depends on the
quality of each participant. The search is stuck when no new kind of violation was found for some generations (or,
as in the paper, when the first front did not change). It then requests differential seeds: solutions that expose
violations and differ from the known ones. Proposals that do not differ enough are sent back, a few times; major
mutations make up for those still missing.

The search never calls a language model itself; it only states what it needs (`brink.search.algorithm.Seeded`).

Source: Tian et al., "An LLM-Empowered Adaptive Evolutionary Algorithm for Multi-Component Deep Learning Systems";
Srinivas and Patnaik, "Adaptive probabilities of crossover and mutation in genetic algorithms", 1994.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from types import MappingProxyType
from typing import Any, Final, assert_never

import numpy as np

from brink.search.algorithm import Candidate, Evaluation, Origin, Proposal, Scored, SeedRequest
from brink.search.algorithms.ledger import Ledger, LedgerAlgorithm, stored_rows
from brink.search.algorithms.multi_objective import (
    CRITICALITY,
    Child,
    MultiObjectiveConfig,
    MultiObjectiveState,
    breeding_rng,
    child_of,
    empty_state,
    plan_generation,
    random_children,
    restored_state,
    select_survivors,
    state_content,
)
from brink.search.document import Document
from brink.search.errors import ConfigError, DocumentError, OrderError
from brink.search.settings import setting
from brink.search.space import FloatArray, SearchSpace
from brink.search.streams import Stream, generator
from brink.search.traffic.motion import matched_distances, participant_distances
from brink.search.traffic.participants import Participant, Solution
from brink.search.traffic.variation import (
    TrafficGenome,
    crossed_genes,
    hostile_solution,
    major_change,
    prolonged,
    small_change,
)

_BEST_SHARE: Final = 0.25
"""Participants in the best quarter of the population, on either objective, get small instead of major changes."""
_COMPARED: Final = 12
"""A proposal is compared with this many of the latest solutions with a violation, and as many without."""
_SHOWN: Final = 3
"""A request shows this many of the latest solutions with a violation, and as many without."""


class Want(StrEnum):
    """The kind of seeds that the search needs next."""

    NOTHING = "nothing"
    INITIAL = "initial"
    DIFFERENTIAL = "differential"


class Crossover(StrEnum):
    """Form of the adaptive crossover rate.

    The paper prints the mutation rate a second time in its place; its prose asks for a rate that grows as the better
    parent approaches the best fitness.
    """

    MIRROR = "mirror"
    RECIPROCAL = "reciprocal"
    SRINIVAS = "srinivas"
    """The classical form, which falls as the better parent approaches the best fitness."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MumoeaConfig(MultiObjectiveConfig):
    """Settings of muMOEA; `initial: random` and `differential: never` give the paper's ablations."""

    seeder: str = setting(
        "heuristic",
        help="Source of seeds: hand-written patterns, or a language model.",
        choices=("heuristic", "llm"),
    )
    initial: str = setting("seeds", help="Source of the first population.", choices=("seeds", "random"))
    differential: str = setting(
        "stuck", help="When to request differential seeds.", choices=("stuck", "never", "always")
    )
    stuck_by: str = setting(
        "kinds",
        choices=("kinds", "front"),
        help="What counts as progress: a new kind of violation, or a change of the first front.",
    )
    stuck_after: int = setting(
        3, help="Consecutive generations without progress that count as stuck (t).", ge=1, le=1_000
    )
    seeds: int = setting(10, help="Differential seeds per request.", ge=1, le=200)
    rounds: int = setting(
        3, help="How many times seeds that do not differ enough are sent back.", ge=0, le=10
    )
    least_share: float = setting(
        0.5,
        ge=0,
        le=1,
        help="Minimum distance of a seed to violating solutions, relative to the median among known solutions.",
    )
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


@dataclass(frozen=True, slots=True, kw_only=True)
class FitnessRange:
    """Fitness of a population, which the adaptive rates depend on.

    Attributes:
        low: Smallest fitness (f_min).
        mean: Mean fitness (f_mean).
        high: Largest fitness (f_max).
    """

    low: float
    mean: float
    high: float

    @classmethod
    def of(cls, fitness: FloatArray) -> "FitnessRange":
        """Return the range of a population's fitness, shape ``(n,)``, n >= 1."""
        return cls(low=float(fitness.min()), mean=float(fitness.mean()), high=float(fitness.max()))

    @property
    def degenerate(self) -> bool:
        """Whether no solution is better than the mean; all rates are then at their caps."""
        return not self.low < self.mean < self.high

    def threshold(self, c1: float = 0.5, m1: float = 0.5) -> float:
        """Return the smallest rate at which an operator is applied."""
        return c1 * (self.high - self.mean) + m1 * (self.mean - self.low)


def scalar_fitness(criticality: FloatArray, diversity: FloatArray, weight: float = 0.5) -> FloatArray:
    """Return the fitness w (1 - F_c) + (1 - w) F_d, maximised, in [0, 1].

    Both objectives are scaled by their bounds over the whole history. The bounds of the generation alone would fix
    the range of the fitness at 1, and the threshold could not fall as the population converges.

    Args:
        criticality: F_c, 0 for the most critical solution so far and 1 for the least, shape ``(n,)``.
        diversity: F_d, 1 for the most diverse solution so far and 0 for the least, shape ``(n,)``.
        weight: Weight of criticality, in [0, 1] (w).
    """
    return np.asarray(weight * (1.0 - criticality) + (1.0 - weight) * diversity)


def scaled(values: FloatArray, low: float, high: float) -> FloatArray:
    """Return values scaled from [low, high] to [0, 1] and clipped.

    Args:
        values: Shape ``(n,)``.
        low: Value that becomes 0.
        high: Value that becomes 1; if it is not above `low`, all values become 0.
    """
    if not high > low:
        return np.zeros(len(values))
    return np.asarray(np.clip((values - low) / (high - low), 0.0, 1.0))


def mutation_probability(fitness: FloatArray, k2: float = 0.6, k4: float = 1.0) -> FloatArray:
    """Return the mutation probability (PM) of each solution: 0 for the best, the cap for the worst.

    Args:
        fitness: Fitness of the population, maximised, shape ``(n,)``.
        k2: Rate of a solution with the mean fitness.
        k4: The cap.
    """
    limits = FitnessRange.of(fitness)
    if limits.degenerate:
        return np.full(len(fitness), k4)
    return np.asarray(np.minimum(k2 * (limits.high - fitness) / (limits.high - limits.mean), k4))


def crossover_probability(
    better: FloatArray,
    limits: FitnessRange,
    form: Crossover = Crossover.MIRROR,
    k1: float = 0.6,
    k3: float = 1.0,
) -> FloatArray:
    """Return the crossover probability (PC) of each pair.

    Args:
        better: Fitness of the better parent of each pair (f'), any shape.
        limits: Fitness range of the population.
        form: Form of the rate.
        k1: Rate of a pair whose better parent has the mean fitness.
        k3: The cap.
    """
    low, mean, high = limits.low, limits.mean, limits.high
    if limits.degenerate:
        return np.full(np.shape(better), k3)
    match form:
        case Crossover.MIRROR:
            rate = k1 * (better - low) / (mean - low)
        case Crossover.RECIPROCAL:
            with np.errstate(divide="ignore"):  # the best parent: infinite, so the cap applies
                rate = k1 * (high - mean) / (high - better)
        case Crossover.SRINIVAS:
            rate = np.where(better >= mean, k1 * (high - better) / (high - mean), k3)
        case _:
            assert_never(form)
    return np.asarray(np.minimum(rate, k3))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MumoeaState(MultiObjectiveState):
    """State of muMOEA.

    Attributes:
        want: Seeds needed before the next generation.
        requests: Number of requests answered so far.
        round: Round of the current request.
        taken: Seeds accepted in the current request.
        rejected: Proposals of the last round that were not different enough, as rows.
        kinds: Kinds of violations found so far.
        stuck: Number of generations since the last progress.
    """

    config: MumoeaConfig
    want: Want
    requests: int
    round: int
    taken: tuple[Child, ...]
    rejected: tuple[FloatArray, ...]
    kinds: frozenset[str]
    stuck: int


_BASE_FIELDS: Final = tuple(field.name for field in fields(MultiObjectiveState))


class Mumoea(LedgerAlgorithm[MumoeaConfig, MumoeaState]):
    """muMOEA, the adaptive multi-objective search with seeds."""

    id = "mumoea@1"
    suggested = 4
    former = MappingProxyType({"distance": "paper"})
    finds = ("violations",)
    minimises = "criticality"
    summary = "muMOEA: adaptive multi-objective search, seeded by patterns or a language model."
    config_type: type[Any] = MumoeaConfig
    needed_objectives = (CRITICALITY,)
    layout = 3

    def _min_budget(self, space: SearchSpace, config: MumoeaConfig) -> int:
        TrafficGenome.of(space)
        if config.seeds > config.population_size:
            raise ConfigError("seeds", f"expected at most population_size, got {config.seeds}")
        if config.seeder == "llm" and config.initial == "random" and config.differential == "never":
            raise ConfigError(
                "seeder", "llm would never be used: expected initial: seeds, or differential other than never"
            )
        return config.population_size

    def _first_state(self, ledger: Ledger, config: MumoeaConfig) -> MumoeaState:
        genome = TrafficGenome.of(ledger.space)
        base = empty_state(ledger, config)
        state = MumoeaState(
            **{name: getattr(base, name) for name in _BASE_FIELDS},
            want=Want.NOTHING,
            requests=0,
            round=0,
            taken=(),
            rejected=(),
            kinds=frozenset(),
            stuck=0,
        )
        rng = generator(ledger.seed, Stream.START)
        if config.initial == "random":
            return plan_generation(state, random_children(genome, config.population_size, rng), genome, rng)
        if config.seeder == "llm":
            return replace(state, want=Want.INITIAL)
        return plan_generation(state, _pattern_seeds(genome, config.population_size, rng), genome, rng)

    def ask(self, state: MumoeaState) -> tuple[MumoeaState, tuple[Candidate, ...]]:
        """Return the state with a pending generation, and that generation.

        Raises:
            OrderError: The last generation has not been told yet, seeds are needed, or the search is finished.
        """
        if state.want is not Want.NOTHING:
            raise OrderError("ask: pass the wanted seeds to `seeded` first")
        return super().ask(state)

    def tell(self, state: MumoeaState, evaluations: Mapping[int, Evaluation]) -> MumoeaState:
        """Return the state after the pending generation was evaluated.

        Raises:
            OrderError: Nothing is pending, or the numbers are not those of the pending candidates.
            KeyError: An evaluation lacks the criticality.
        """
        genome = TrafficGenome.of(state.ledger.space)
        survived = _with_progress(state, select_survivors(state, evaluations, genome), evaluations)
        config = survived.config
        stuck = config.differential == "always" or (
            config.differential == "stuck" and survived.stuck >= config.stuck_after
        )
        if not stuck or survived.ledger.left <= 0 or not survived.population:
            return _bred(survived, genome)
        wanting = replace(survived, want=Want.DIFFERENTIAL, stuck=0)
        if config.seeder == "llm":
            return wanting
        rng = generator(survived.ledger.seed, Stream.SEEDS, survived.ledger.generation)
        while wanting.want is Want.DIFFERENTIAL:
            wanting = _with_seeds(wanting, self.heuristic_seeds(genome, config.seeds, rng), genome)
        return wanting

    def finished(self, state: MumoeaState) -> bool:
        """Return whether no further generation is planned and no seeds are needed."""
        return super().finished(state) and state.want is Want.NOTHING

    def wanted(self, state: MumoeaState) -> SeedRequest | None:
        """Return the seeds needed before the next generation can be asked for, or None."""
        if state.want is Want.NOTHING:
            return None
        genome, config = TrafficGenome.of(state.ledger.space), state.config
        if state.want is Want.INITIAL:
            return SeedRequest(number=state.requests, count=config.population_size)
        exposed, silent = _known(state)
        rows = state.history.rows
        return SeedRequest(
            number=state.requests,
            count=config.seeds - len(state.taken),
            exposed=tuple(genome.solution(rows[number]) for number in exposed[:_SHOWN]),
            silent=tuple(genome.solution(rows[number]) for number in silent[:_SHOWN]),
            rejected=tuple(genome.solution(row) for row in state.rejected),
            round=state.round,
        )

    def seeded(self, state: MumoeaState, proposals: Sequence[Proposal]) -> MumoeaState:
        """Return the state after receiving the requested proposals, possibly none.

        Raises:
            OrderError: No seeds were requested.
        """
        if state.want is Want.NOTHING:
            raise OrderError("seeded: no seeds were requested")
        genome = TrafficGenome.of(state.ledger.space)
        rng = generator(state.ledger.seed, Stream.SEEDS, state.ledger.generation, state.requests)
        # The other components of a seed come from the best solution.
        best = state.history.rows[state.population[0]] if state.population else None
        children: list[Child] = [
            (genome.row(proposal.solution, best, rng), proposal.origin) for proposal in proposals
        ]
        state = replace(state, requests=state.requests + 1)
        if state.want is Want.INITIAL:
            missing = max(0, state.config.population_size - len(children))
            seeds = [*children, *_pattern_seeds(genome, missing, rng)]
            return plan_generation(replace(state, want=Want.NOTHING), seeds, genome, rng)
        if not children:
            # No proposals came back: use patterns, and start no further round.
            state = replace(state, round=state.config.rounds)
            children = self.heuristic_seeds(genome, state.config.seeds, rng)
        return _with_seeds(state, children, genome)

    def heuristic_seeds(self, genome: TrafficGenome, count: int, rng: np.random.Generator) -> list[Child]:
        """Draw differential seeds: patterns prolonged by random actions, since short ones hardly differ.

        Args:
            genome: Genome of the space.
            count: Number of seeds.
            rng: Source of all randomness.
        """
        drawn = [hostile_solution(genome.road, genome.max_participants, rng) for _ in range(count)]
        return [
            (
                genome.row(tuple(prolonged(participant, rng) for participant in solution), None, rng),
                Origin.HEURISTIC,
            )
            for solution in drawn
        ]

    def _content(self, state: MumoeaState) -> tuple[dict[str, Any], dict[str, Any]]:
        header, arrays = state_content(state)
        width = state.ledger.space.dimension
        tables = {"taken": [row for row, _ in state.taken], "rejected": list(state.rejected)}
        return (
            {
                **header,
                "want": state.want.value,
                "requests": state.requests,
                "round": state.round,
                "stuck": state.stuck,
                "kinds": sorted(state.kinds),
                "taken_origins": [origin.value for _, origin in state.taken],
            },
            {
                **arrays,
                **{name: np.reshape(rows, (len(rows), width)).astype(float) for name, rows in tables.items()},
            },
        )

    def _restored(self, ledger: Ledger, config: MumoeaConfig, document: Document) -> MumoeaState:
        base, header = restored_state(ledger, config, document), document.header
        origins, want = header.get("taken_origins"), header.get("want")
        taken = stored_rows(document, "taken", ledger.space.dimension)
        if not isinstance(origins, list) or not set(origins) <= set(Origin) or len(origins) != len(taken):
            raise DocumentError(f"taken_origins: expected one for each seed taken, got {origins!r}")
        if want not in set(Want):
            raise DocumentError(f"want: expected one of {', '.join(Want)}, got {want!r}")
        counts = [header.get(name) for name in ("requests", "round", "stuck")]
        if not all(isinstance(count, int) for count in counts):
            raise DocumentError(f"requests, round, stuck: expected whole numbers, got {counts!r}")
        kinds = header.get("kinds")
        if not isinstance(kinds, list) or not all(isinstance(kind, str) for kind in kinds):
            raise DocumentError(f"kinds: expected a list of strings, got {kinds!r}")
        return MumoeaState(
            **{name: getattr(base, name) for name in _BASE_FIELDS},
            want=Want(str(want)),
            requests=int(str(counts[0])),
            round=int(str(counts[1])),
            taken=tuple(zip(taken, (Origin(origin) for origin in origins), strict=True)),
            rejected=tuple(stored_rows(document, "rejected", ledger.space.dimension)),
            kinds=frozenset(kinds),
            stuck=int(str(counts[2])),
        )


def _with_progress(
    before: MumoeaState, told: MumoeaState, evaluations: Mapping[int, Evaluation]
) -> MumoeaState:
    """Return the new state with all kinds of violations so far and the number of generations without progress."""
    kinds = before.kinds.union(
        *(evaluation.kinds for evaluation in evaluations.values() if isinstance(evaluation, Scored))
    )
    by_kinds = told.config.stuck_by == "kinds"
    progress = kinds != before.kinds if by_kinds else _front_rows(before) != _front_rows(told)
    return replace(told, kinds=kinds, stuck=0 if progress else before.stuck + 1)


def _front_rows(state: MumoeaState) -> set[bytes]:
    return {state.history.rows[number].tobytes() for number in state.front}


def _pattern_seeds(genome: TrafficGenome, count: int, rng: np.random.Generator) -> list[Child]:
    """Draw seeds from the hand-written patterns."""
    road, most = genome.road, genome.max_participants
    return [
        (genome.row(hostile_solution(road, most, rng), None, rng), Origin.HEURISTIC) for _ in range(count)
    ]


def _known(state: MumoeaState) -> tuple[list[int], list[int]]:
    """Return the recent solutions that exposed a violation and those that did not, latest first."""
    recent = state.history.recent(state.config.lately)[::-1]
    exposed = [number for number in recent if state.history.unsafe[number]]
    return exposed, [number for number in recent if not state.history.unsafe[number]]


def _with_seeds(state: MumoeaState, children: Sequence[Child], genome: TrafficGenome) -> MumoeaState:
    """Take the seeds that differ enough, then start another round or plan the next generation."""
    config = state.config
    accepted = different_enough(state, [row for row, _ in children], genome)
    taken = [child for child, fine in zip(children, accepted, strict=True) if fine]
    state = replace(state, taken=(*state.taken, *taken)[: config.seeds])
    missing = config.seeds - len(state.taken)
    if missing and state.round < config.rounds:
        rejected = tuple(row for (row, _), fine in zip(children, accepted, strict=True) if not fine)
        return replace(state, round=state.round + 1, rejected=rejected)
    rng = generator(state.ledger.seed, Stream.SEEDS, state.ledger.generation, state.requests, 1)
    seeds = [*state.taken, *(_major_mutant(state, genome, rng) for _ in range(missing))]
    return _bred(replace(state, want=Want.NOTHING, round=0, taken=(), rejected=()), genome, seeds)


def different_enough(state: MumoeaState, rows: Sequence[FloatArray], genome: TrafficGenome) -> list[bool]:
    """Return which seeds differ enough from the known solutions.

    The mean distance of a seed to the known solutions must reach the median distance among these. Its distance to
    every solution that exposed a violation, every seed taken, and every earlier accepted seed must reach a share of
    that median.

    Args:
        state: The current state.
        rows: The proposed seeds, each of shape ``(d,)``.
        genome: Genome of the space.
    """
    if not rows:
        return []
    exposed, silent = (numbers[:_COMPARED] for numbers in _known(state))
    numbers = [*exposed, *silent]
    measure = state.config.measure
    known = genome.roll_out_rows((state.history.rows[number] for number in numbers), measure)
    among = matched_distances(known, known)[np.triu_indices(len(numbers), 1)]
    median_m = float(np.median(among)) if among.size else 0.0
    proposed = genome.roll_out_rows(rows, measure)
    apart = matched_distances(proposed, known)
    mean_m = apart.mean(axis=1) if numbers else np.full(len(rows), np.inf)
    least_m = apart[:, : len(exposed)].min(axis=1, initial=np.inf)
    taken = genome.roll_out_rows((row for row, _ in state.taken), measure)
    least_m = np.minimum(least_m, matched_distances(proposed, taken).min(axis=1, initial=np.inf))
    between = matched_distances(proposed, proposed)
    enough_m = state.config.least_share * median_m
    accepted: list[bool] = []
    for place in range(len(rows)):
        nearest_m = min(
            (float(between[place, other]) for other in range(place) if accepted[other]), default=np.inf
        )
        accepted.append(bool(mean_m[place] >= median_m and min(least_m[place], nearest_m) >= enough_m))
    return accepted


def _major_mutant(state: MumoeaState, genome: TrafficGenome, rng: np.random.Generator) -> Child:
    """Return a mutant of a random solution of the population with a major change to every participant."""
    parent = state.population[int(rng.integers(len(state.population)))]
    solution = genome.solution(state.history.rows[parent])
    changed = tuple(major_change(participant, rng) for participant in solution)
    return child_of(state, genome, changed, parent, Origin.MUTATION, rng)


def _bred(state: MumoeaState, genome: TrafficGenome, seeds: Sequence[Child] = ()) -> MumoeaState:
    """Return the state with the next generation queued: seeds, mutants and children of pairs."""
    rng = breeding_rng(state)
    if not state.population or state.ledger.left <= 0:
        return plan_generation(state, seeds, genome, rng)
    breeding = _Breeding(state, genome)
    children = [*seeds, *breeding.mutants(rng)]
    wanted = state.config.population_size - len(children)
    children += breeding.crossed(max(0, wanted), rng)

    def mutants(count: int) -> list[Child]:
        return [_major_mutant(state, genome, rng) for _ in range(count)]

    return plan_generation(state, children, genome, rng, [mutants])


class _Breeding:
    """Adaptive variation of one population."""

    def __init__(self, state: MumoeaState, genome: TrafficGenome) -> None:
        self._state = state
        self._genome = genome
        config, history = state.config, state.history
        criticality, diversity = state.criticality_bounds, state.diversity_bounds
        self._fitness = scalar_fitness(
            scaled(state.fitness, criticality.low, criticality.high),
            scaled(state.diversity, diversity.low, diversity.high),
            config.weight,
        )
        self._range = FitnessRange.of(self._fitness)
        self._threshold = self._range.threshold(config.c1, config.m1)
        self._solutions = [genome.solution(history.rows[number]) for number in state.population]
        self._gaps = history.gaps[list(state.population)]
        self._novelty = participant_distances(
            genome.roll_out(self._solutions, config.measure),
            genome.roll_out_rows((history.rows[n] for n in history.recent(config.lately)), config.measure),
        )

    def mutants(self, rng: np.random.Generator) -> list[Child]:
        """Return a mutant of each solution whose mutation rate reaches the threshold, worst solution first."""
        config = self._state.config
        rates = mutation_probability(self._fitness, config.k2, config.k4)
        order = sorted(range(len(rates)), key=lambda place: -rates[place])
        chosen = [place for place in order if rates[place] >= self._threshold]
        # Half of a generation is reserved for crossover; a widely spread population would otherwise only mutate.
        return [self._mutant(place, rng) for place in chosen[: config.population_size // 2]]

    def _mutant(self, place: int, rng: np.random.Generator) -> Child:
        gaps = self._gaps[np.isfinite(self._gaps)]
        near_m = np.quantile(gaps, _BEST_SHARE) if gaps.size else -np.inf
        novelty = self._novelty[np.isfinite(self._novelty)]
        far_m = np.quantile(novelty, 1.0 - _BEST_SHARE) if novelty.size else np.inf
        changed: list[Participant] = []
        for index, solution in enumerate(self._solutions[place]):
            good = self._gaps[place, index] <= near_m or self._novelty[place, index] >= far_m
            changed.append(small_change(solution, rng) if good else major_change(solution, rng))
        return self._child(tuple(changed), place, Origin.MUTATION, rng)

    def crossed(self, count: int, rng: np.random.Generator) -> list[Child]:
        """Return up to `count` children of the pairs with the highest crossover rates that reach the threshold."""
        config = self._state.config
        firsts, seconds = np.triu_indices(len(self._fitness), 1)
        better = np.maximum(self._fitness[firsts], self._fitness[seconds])
        rates = crossover_probability(better, self._range, Crossover(config.crossover), config.k1, config.k3)
        order = np.lexsort((rng.random(len(rates)), -rates))
        children: list[Child] = []
        for pair in order.tolist():
            if len(children) >= count or rates[pair] < self._threshold:
                break
            children += self._children(int(firsts[pair]), int(seconds[pair]), rng)
        return children[:count]

    def _children(self, first: int, second: int, rng: np.random.Generator) -> list[Child]:
        """Return two children: the better parent's best participant crossed with a random one of the other parent's.

        The other participant is of like kind if there is one: on foot, or a vehicle.
        """
        if self._fitness[second] > self._fitness[first]:
            first, second = second, first
        mother, father = self._solutions[first], self._solutions[second]
        mine = self._best_participant(first)
        # Someone on foot and a vehicle have few actions in common: repair would replace the others.
        alike = [
            place for place, participant in enumerate(father) if participant.on_foot == mother[mine].on_foot
        ]
        yours = int(rng.choice(alike)) if alike else int(rng.integers(len(father)))
        crossed = crossed_genes(mother[mine], father[yours], rng)
        return [
            self._child(_with(mother, mine, crossed[0]), first, Origin.CROSSOVER, rng),
            self._child(_with(father, yours, crossed[1]), second, Origin.CROSSOVER, rng),
        ]

    def _best_participant(self, place: int) -> int:
        """Return a solution's best participant on the objective on which the solution itself ranks best."""
        objectives = self._state.objectives
        ranks = (objectives < objectives[place]).sum(axis=0)
        count = len(self._solutions[place])
        if ranks[0] <= ranks[1]:
            return int(np.argmin(self._gaps[place, :count]))
        return int(np.argmax(np.nan_to_num(self._novelty[place, :count], nan=0.0)))

    def _child(self, solution: Solution, place: int, origin: Origin, rng: np.random.Generator) -> Child:
        parent = self._state.population[place]
        return child_of(self._state, self._genome, solution, parent, origin, rng)


def _with(solution: Solution, place: int, participant: Participant) -> Solution:
    return (*solution[:place], participant, *solution[place + 1 :])
