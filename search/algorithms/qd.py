"""MAP-Elites: one best solution, an elite, for each kind of behaviour.

A solution belongs to the niches that its problem names (`Niche`), such as the sector in which it came close to the
ego and what both were doing. If the problem names none but declares measures, such as the smallest gap, its niche is
the cell of their values in a grid: unsafe solutions rank before safe ones, then by robustness.

Each niche keeps its best solution, by rank, then value. Children are variants of elites, crossings of two, patterns
of traffic written by hand, and random solutions. Kinds of behaviour are thus collected rather than optimised away:
what is best in one niche never displaces another niche's elite.

Parents are elites of the best rank, and now and then of the next one: near misses. Rare behaviour is preferred: an
elite's chance falls with the number of solutions that were in its niche. Otherwise one easily repeated mechanism,
which varies over many niches, would get most of the budget.

One drive may be luck, and a niche that keeps the best of many drives keeps lucky ones. So every unsafe elite of the
best rank, which is what is reported, is simulated once more under another seed. Its value is then the mean of both
drives. If it is not in its niche again, at that rank, the next solution there replaces it, whatever the values.
Elites get their second drive first. Children get the rest of a generation, and no more of the budget than leaves a
second drive for the elites that they are expected to give.

Several generations may be in flight. Solutions without niches and measures are searched at random.

Sources: Mouret and Clune, "Illuminating search spaces by mapping elites", 2015. Elites are simulated again as in
Justesen, Risi and Mouret, "MAP-Elites for noisy domains by adaptive sampling", 2019, in its simplest form.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from types import MappingProxyType
from typing import Any, ClassVar, Final

import numpy as np

from brink.search.algorithm import Candidate, Evaluation, Niche, Origin, Scored
from brink.search.algorithms.ledger import Ledger, LedgerAlgorithm, LedgerConfig, LedgerState, stored_rows
from brink.search.algorithms.multi_objective import Child, stored_origins
from brink.search.document import Document
from brink.search.errors import ConfigError, DocumentError
from brink.search.operators import crossed, mutated
from brink.search.settings import setting
from brink.search.space import FloatArray, SearchSpace
from brink.search.streams import Stream, generator
from brink.search.traffic.constraint import has_participants
from brink.search.traffic.participants import Participant, Solution
from brink.search.traffic.variation import (
    TrafficGenome,
    crossed_uniformly,
    hostile_solution,
    major_change,
    motif,
    mutated_randomly,
    small_change,
)

_MAX_FILLS: Final = 30
"""Maximum rounds of breeding to fill a generation with new solutions."""
_NEAR_SHARE: Final = 0.25
"""Share of the elites of the second-best rank, those with the lowest values, that may become parents."""
_MOTIF_SHARE: Final = 0.5
"""Share of the participants added by edits that follow a motif; the others are random."""
_NUDGED_SHARE: Final = 0.5
"""Share of the numbers that a small change modifies, where there are no participants."""
_REDRAWN_SHARE: Final = 0.25
"""Share of the parameters that a major change draws again, where there are no participants."""


class Operator(StrEnum):
    """How a child is made."""

    RANDOM = "random"
    """Drawn from the space."""
    PATTERN = "pattern"
    """Hand-written patterns with random numbers."""
    SMALL = "small"
    """Some numbers (of all participants) of an elite change a little."""
    MAJOR = "major"
    """One participant of an elite starts elsewhere and acts differently, or some parameters are drawn again."""
    EDIT = "edit"
    """One participant of an elite is changed, removed or replaced, another is added, or one parameter drawn again."""
    CROSSOVER = "crossover"
    """Participants and actions, or parameters, of two elites are swapped."""


_ORIGINS: Final[Mapping[Operator, Origin]] = {
    Operator.RANDOM: Origin.RANDOM,
    Operator.PATTERN: Origin.HEURISTIC,
    Operator.SMALL: Origin.MUTATION,
    Operator.MAJOR: Origin.MUTATION,
    Operator.EDIT: Origin.MUTATION,
    Operator.CROSSOVER: Origin.CROSSOVER,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class QdConfig(LedgerConfig):
    """Settings of MAP-Elites; the shares are relative to each other."""

    by_criticality: ClassVar[bool] = True

    generation_size: int = setting(30, help="Solutions per generation.", ge=1, le=1_000)
    in_flight: int = setting(
        2,
        help="Generations in flight at a time. With more, more workers are busy; with fewer, each choice is "
        "based on more results.",
        ge=1,
        le=100,
    )
    initial: int = setting(60, help="Random solutions before the first variants of elites.", ge=1, le=10_000)
    share_random: float = setting(0.1, help="Share of random solutions.", ge=0, le=1)
    share_pattern: float = setting(0.0, help="Share of hand-written hostile patterns.", ge=0, le=1)
    share_small: float = setting(
        0.3, help="Share of elites with all participants, or many numbers, changed a little.", ge=0, le=1
    )
    share_major: float = setting(
        0.2,
        help="Share of elites with one participant changed a lot, or some parameters drawn again.",
        ge=0,
        le=1,
    )
    share_edit: float = setting(
        0.2,
        help="Share of elites with a participant changed, added, removed or replaced, or one parameter drawn again.",
        ge=0,
        le=1,
    )
    share_crossover: float = setting(0.2, help="Share of crossings of two elites.", ge=0, le=1)
    cells: int = setting(
        5,
        help="Parts that the range of each measure is divided into, for problems that declare measures.",
        ge=1,
        le=100,
    )
    near: float = setting(
        0.1,
        ge=0,
        le=1,
        help="Share of parents of the second-best rank, such as near misses, once there is a better one.",
    )

    @property
    def shares(self) -> tuple[float, ...]:
        """The share of each operator, in the order of `Operator`."""
        return tuple(float(getattr(self, f"share_{operator}")) for operator in Operator)


@dataclass(frozen=True, slots=True, kw_only=True)
class Elite:
    """The best solution of a niche so far.

    Attributes:
        niche: Name, rank and value; the mean value of the drives that were in the niche.
        number: Number of the solution.
        hits: Number of solutions that were in the niche so far.
        evaluations: Drives of the solution with a verdict: one, or two once it was simulated again.
        seen: Those of them that were in the niche, at its rank.
    """

    niche: Niche
    number: int
    hits: int
    evaluations: int = 1
    seen: int = 1

    def after(self, niche: Niche, number: int) -> "Elite":
        """Return the elite after one more solution was in the niche: this one, unless the other is better."""
        mine = self.niche.rank, self.seen < self.evaluations, self.niche.value
        hits = self.hits + 1
        if (niche.rank, False, niche.value) < mine:
            return Elite(niche=niche, number=number, hits=hits)
        return replace(self, hits=hits)

    def again(self, niche: Niche | None) -> "Elite":
        """Return the elite after its second drive, which was in the niche, or not (None)."""
        if niche is None or niche.rank > self.niche.rank:
            return replace(self, evaluations=self.evaluations + 1)
        value = (self.seen * self.niche.value + niche.value) / (self.seen + 1)
        return replace(
            self, niche=replace(self.niche, value=value), evaluations=self.evaluations + 1, seen=self.seen + 1
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class QdState(LedgerState):
    """State of MAP-Elites.

    Attributes:
        config: Settings.
        elites: One for each niche, in the order in which the niches were discovered.
        queue_origins: The origin of each solution in flight or queued, ascending by number.
        again: Number of the solution that a candidate simulates once more, by the candidate's number.
    """

    config: QdConfig
    elites: tuple[Elite, ...]
    queue_origins: tuple[Origin, ...]
    again: Mapping[int, int] = field(default_factory=dict)

    @property
    def fitness(self) -> FloatArray:
        """Values of the elites, shape ``(n,)``."""
        return np.array([elite.niche.value for elite in self.elites])


class Qd(LedgerAlgorithm[QdConfig, QdState]):
    """MAP-Elites for scripted traffic, and for any problem that declares measures."""

    id = "qd@1"
    finds = ("violations",)
    minimises = "criticality"
    summary = "MAP-Elites: as many kinds of violations as possible, the most critical of each."
    config_type = QdConfig
    needs_measures = True
    layout = 2

    def _min_budget(self, space: SearchSpace, config: QdConfig) -> int:
        if config.share_pattern and not has_participants(space):
            raise ConfigError("share_pattern", "expected 0: only traffic participants have patterns")
        if not any(config.shares):
            raise ConfigError("share_random", "expected a positive share of at least one operator, got none")
        return 1

    def _first_state(self, ledger: Ledger, config: QdConfig) -> QdState:
        return _planned(QdState(config=config, ledger=ledger, elites=(), queue_origins=()))

    def tell(self, state: QdState, evaluations: Mapping[int, Evaluation]) -> QdState:
        """Return the state after the oldest generation in flight was evaluated.

        Raises:
            OrderError: Nothing is pending, or the numbers are not those of the pending candidates.
        """
        candidates = state.ledger.pending
        ledger = state.ledger.tell(evaluations)
        elites = with_elites(state.elites, candidates, evaluations, state.again, cells=state.config.cells)
        origins = state.queue_origins[len(candidates) :]
        return _planned(replace(state, ledger=ledger, elites=elites, queue_origins=origins))

    def _refilled(self, state: QdState) -> QdState:
        return _planned(state)

    def _content(self, state: QdState) -> tuple[dict[str, Any], dict[str, Any]]:
        columns = [
            (e.niche.rank, e.niche.value, e.number, e.hits, e.evaluations, e.seen) for e in state.elites
        ]
        return (
            {
                "niches": [list(elite.niche.name) for elite in state.elites],
                "queue_origins": [origin.value for origin in state.queue_origins],
            },
            {
                "elites": np.reshape(columns, (-1, 6)).astype(np.float64),
                "again": np.reshape(sorted(state.again.items()), (-1, 2)).astype(np.float64),
            },
        )

    def _restored(self, ledger: Ledger, config: QdConfig, document: Document) -> QdState:
        return QdState(
            config=config,
            ledger=ledger,
            elites=_stored_elites(ledger, document),
            again=_stored_again(ledger, document),
            queue_origins=stored_origins(document, ledger.in_flight + len(ledger.queue)),
        )


def with_elites(
    elites: Sequence[Elite],
    candidates: Sequence[Candidate],
    evaluations: Mapping[int, Evaluation],
    again: Mapping[int, int] = MappingProxyType({}),
    *,
    cells: int = 1,
) -> tuple[Elite, ...]:
    """Return the elites after a generation was evaluated. Solutions without a verdict never become elites.

    Args:
        elites: The elites so far.
        candidates: The generation.
        evaluations: Its evaluations, by number.
        again: Number of the solution that a candidate simulates once more, by the candidate's number.
        cells: Parts that the range of each measure is divided into.
    """
    best = {elite.niche.name: elite for elite in elites}
    for candidate in candidates:
        evaluation = evaluations[candidate.number]
        if not isinstance(evaluation, Scored):
            continue
        niches = {niche.name: niche for niche in _best_by_name(niches_of(evaluation, cells))}
        same = [name for name, elite in best.items() if elite.number == again.get(candidate.number)]
        best |= {name: best[name].again(niches.pop(name, None)) for name in same}
        for niche in niches.values():
            known = best.get(niche.name)
            best[niche.name] = (
                Elite(niche=niche, number=candidate.number, hits=1)
                if known is None
                else known.after(niche, candidate.number)
            )
    return tuple(best.values())


def niches_of(evaluation: Scored, cells: int) -> tuple[Niche, ...]:
    """Return the niches of a solution: those that its problem names, or else the cell of its measures, if any."""
    if evaluation.niches or not evaluation.measures:
        return evaluation.niches
    name = tuple(measure.cell(value, cells) for measure, value in evaluation.measures.items())
    return (Niche(name=name, rank=int(not evaluation.unsafe), value=evaluation.robustness),)


def _best_by_name(niches: Sequence[Niche]) -> Iterable[Niche]:
    """Return the niches of a solution, each name only once."""
    ranked = sorted(niches, key=lambda niche: (niche.rank, niche.value), reverse=True)
    return {niche.name: niche for niche in ranked}.values()


def _planned(state: QdState) -> QdState:
    """Return the state with the next generation queued if there is room in flight, as budget and space allow."""
    config, ledger = state.config, state.ledger
    if len(ledger.flight) >= config.in_flight or ledger.left <= 0:
        return replace(state, ledger=ledger.plan([]))
    waiting = _waiting(state)
    second = waiting[: min(config.generation_size, int(ledger.left))]
    chosen = _children(state, min(config.generation_size - len(second), _affordable(state, len(waiting))))
    first = ledger.spent + ledger.in_flight
    return replace(
        state,
        ledger=ledger.plan([*(_row(state, number) for number in second), *(row for row, _ in chosen)]),
        queue_origins=(
            *state.queue_origins,
            *[Origin.AGAIN] * len(second),
            *(origin for _, origin in chosen),
        ),
        again={**state.again, **dict(enumerate(second, first))},
    )


def _waiting(state: QdState) -> list[int]:
    """Return the numbers of the unsafe elites of the best rank that were not simulated again, oldest niche first."""
    asked = {*state.again, *state.again.values()}
    unsafe = set(state.archive.numbers[state.archive.unsafe].tolist())
    numbers = dict.fromkeys(elite.number for elite in parents_of(state.elites)[0])
    return [number for number in numbers if number in unsafe and number not in asked]


def _affordable(state: QdState, waiting: int) -> int:
    """Return how many children leave enough of the budget for second drives, expected ones included.

    Args:
        state: The state.
        waiting: Elites that wait for their second drive.
    """
    ledger = state.ledger
    elites = len(state.again) + waiting
    share = elites / max(1, ledger.spent + ledger.in_flight)
    left = ledger.left - waiting - share * ledger.in_flight
    if waiting or ledger.in_flight:
        return max(0, math.floor(left / (1 + share)))
    return max(1, math.floor(left / (1 + share)))  # else the last of the budget would be left


def _children(state: QdState, wanted: int) -> list[Child]:
    """Return new children of the elites, with their origins, as many as wanted unless the space is used up."""
    ledger, breeding = state.ledger, _Breeding(state)
    rng = generator(ledger.seed, Stream.BREEDING, ledger.planned_generation)
    chosen: dict[bytes, Child] = {}
    for _ in range(_MAX_FILLS):
        if len(chosen) >= wanted:
            break
        children = {
            row.tobytes(): (row, origin)
            for row, origin in (breeding.child(rng) for _ in range(wanted - len(chosen)))
        }
        fresh = ledger.unseen([row for row, _ in children.values()])
        chosen |= {key: children[key] for row in fresh if (key := row.tobytes()) not in chosen}
    return list(chosen.values())


def _row(state: QdState, number: int) -> FloatArray:
    """Return an archived solution."""
    archive = state.archive
    row: FloatArray = archive.vectors[int(np.searchsorted(archive.numbers, number))]
    return row


class _Breeding:
    """Makes children from the elites of a state, or from nothing."""

    def __init__(self, state: QdState) -> None:
        self._state = state
        space = state.ledger.space
        self._variation = _TrafficVariation(space) if has_participants(space) else _Variation(space)
        config = state.config
        shares = np.array(config.shares)
        self._operators = tuple(Operator), shares / shares.sum()
        self._leading, self._near = parents_of(state.elites)
        self._starting = state.ledger.spent + state.ledger.in_flight < config.initial or not self._leading

    def child(self, rng: np.random.Generator) -> Child:
        """Make one child, which may be known already.

        Args:
            rng: Source of all randomness.
        """
        operators, probabilities = self._operators
        operator = (
            Operator.RANDOM if self._starting else operators[rng.choice(len(operators), p=probabilities)]
        )
        origin = _ORIGINS[operator]
        if operator in (Operator.RANDOM, Operator.PATTERN):
            return self._variation.new(operator, rng), origin
        parent = self._parent(rng)
        if operator is Operator.CROSSOVER:
            return self._variation.crossed(parent, self._parent(rng), rng), origin
        return self._variation.varied(operator, parent, rng), origin

    def _parent(self, rng: np.random.Generator) -> FloatArray:
        near = self._near and rng.random() < self._state.config.near
        parents = self._near if near else self._leading
        rarity = np.array([1.0 / elite.hits for elite in parents])
        return _row(self._state, parents[int(rng.choice(len(parents), p=rarity / rarity.sum()))].number)


class _Variation:
    """Makes new solutions of any space, and variants of rows, shape ``(d,)``."""

    def __init__(self, space: SearchSpace) -> None:
        self._space = space

    def new(self, operator: Operator, rng: np.random.Generator) -> FloatArray:
        """Return a solution that has no parent."""
        return self._space.join(self._space.sample(rng))

    def varied(self, operator: Operator, row: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return a variant of an elite: many numbers changed a little, some parameters drawn again, or one."""
        space, parent = self._space, self._unset(row)
        if operator is Operator.SMALL:
            probability = np.where(space.categorical, 1 / space.dimension, _NUDGED_SHARE)
            parts = zip(space.components, space.slices, strict=True)
            return self._repaired(
                np.concatenate([mutated(each, parent[part], probability[part], rng) for each, part in parts]),
                rng,
            )
        chosen = np.arange(space.dimension) == rng.integers(space.dimension)
        drawn_again = (
            chosen if operator is Operator.EDIT else chosen | (rng.random(chosen.size) < _REDRAWN_SHARE)
        )
        return self._repaired(np.where(drawn_again, self._unset(self.new(operator, rng)), parent), rng)

    def crossed(self, row: FloatArray, other: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return a crossing of two elites."""
        return self._repaired(crossed(self._unset(row), self._unset(other), 0.5, rng)[0], rng)

    def _unset(self, row: FloatArray) -> FloatArray:
        space = self._space
        parts = zip(space.components, space.slices, strict=True)
        return np.concatenate([component.unset_dormant(row[part]) for component, part in parts])

    def _repaired(self, row: FloatArray, rng: np.random.Generator) -> FloatArray:
        return self._space.join(self._space.repair(self._space.split(row), rng))


class _TrafficVariation(_Variation):
    """Makes scripted traffic: participants are varied by what they do."""

    def __init__(self, space: SearchSpace) -> None:
        super().__init__(space)
        self._genome = TrafficGenome.of(space)

    def new(self, operator: Operator, rng: np.random.Generator) -> FloatArray:
        """Return random participants, or a pattern."""
        genome = self._genome
        if operator is Operator.PATTERN:
            return genome.row(hostile_solution(genome.road, genome.max_participants, rng), None, rng)
        return genome.row(genome.sample(rng), None, rng)

    def varied(self, operator: Operator, row: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return an elite with other participants."""
        return self._genome.row(self._changed(operator, self._genome.solution(row), rng), row, rng)

    def crossed(self, row: FloatArray, other: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return an elite whose participants are partly those of another."""
        pair = crossed_uniformly(self._genome.solution(row), self._genome.solution(other), rng)
        return self._genome.row(pair[int(rng.integers(2))], row, rng)

    def _changed(self, operator: Operator, solution: Solution, rng: np.random.Generator) -> Solution:
        match operator:
            case Operator.SMALL:
                return tuple(small_change(participant, rng) for participant in solution)
            case Operator.MAJOR:
                place = int(rng.integers(len(solution)))
                return (*solution[:place], major_change(solution[place], rng), *solution[place + 1 :])
            case Operator.EDIT:
                return mutated_randomly(solution, self._newcomer(rng), self._genome.max_participants, rng)
            case _:
                raise AssertionError(f"{operator} varies no participants")

    def _newcomer(self, rng: np.random.Generator) -> Participant:
        if rng.random() < _MOTIF_SHARE:
            return motif(self._genome.road, rng)
        drawn = self._genome.sample(rng)
        return drawn[int(rng.integers(len(drawn)))]


def parents_of(elites: Sequence[Elite]) -> tuple[list[Elite], list[Elite]]:
    """Return the elites of the best rank, and those of the second-best rank with the lowest values."""
    ranks = sorted({elite.niche.rank for elite in elites})
    leading = [elite for elite in elites if elite.niche.rank in ranks[:1]]
    second = sorted(
        (elite for elite in elites if elite.niche.rank in ranks[1:2]), key=lambda elite: elite.niche.value
    )
    return leading, second[: math.ceil(_NEAR_SHARE * len(second))]


def _stored_again(ledger: Ledger, document: Document) -> dict[int, int]:
    """Return which candidates simulate which solutions once more.

    Raises:
        DocumentError: A number is none of this campaign.
    """
    pairs = stored_rows(document, "again", 2).tolist()
    archived, asked = (
        set(ledger.archive.numbers.tolist()),
        ledger.spent + ledger.in_flight + len(ledger.queue),
    )
    for candidate, number in pairs:
        if candidate not in range(asked) or number not in archived:
            raise DocumentError(f"again: expected numbers of this campaign, got {candidate!r} and {number!r}")
    return {int(candidate): int(number) for candidate, number in pairs}


def _stored_elites(ledger: Ledger, document: Document) -> tuple[Elite, ...]:
    """Return the elites that `Qd._content` stored.

    Raises:
        DocumentError: They are corrupt.
    """
    names, columns = document.header.get("niches"), stored_rows(document, "elites", 6)
    if not isinstance(names, list) or len(names) != len(columns):
        raise DocumentError(f"niches: expected the names of {len(columns)} niches, got {names!r:.80}")
    archived = set(ledger.archive.numbers.tolist())
    elites = []
    for name, (rank, value, number, hits, evaluations, seen) in zip(names, columns.tolist(), strict=True):
        if not isinstance(name, list) or not all(isinstance(word, str) for word in name):
            raise DocumentError(f"niches: expected lists of words, got {name!r:.80}")
        if number not in archived:
            raise DocumentError(f"elites: expected numbers of archived solutions, got {number!r}")
        niche = Niche(name=tuple(name), rank=int(rank), value=value)
        elites.append(
            Elite(
                niche=niche, number=int(number), hits=int(hits), evaluations=int(evaluations), seen=int(seen)
            )
        )
    return tuple(elites)
