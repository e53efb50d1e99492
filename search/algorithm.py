"""The contract of a search algorithm: pure functions over a frozen state.

`start` creates a state, `ask` proposes a generation, `tell` takes its evaluations. Nothing is changed in place,
nothing is global, and every random draw comes from a generator addressed by position (`brink.search.streams`): equal
calls give equal states, bit for bit. Between `tell` and the next `ask` the coordinator stores the state as a
`Document`, and evaluated complete solutions separately, as an `Archive`.

Several generations may be *in flight*, asked for but not yet told (`Overlapping`), so that no worker waits for the
slowest simulation of one. They are told in the order of asking, and each `tell` is preceded by every `ask` that the
algorithm allows. What is asked for therefore never depends on which simulation was fast.

An algorithm may also request seeds from outside, for example from a language model (`Seeded`). The coordinator then
calls `Seeded.wanted` before every `ask`; as long as that returns a request, no generation can be asked for, and
`Seeded.seeded` passes in the proposals, possibly none. Proposals are never trusted: the constraints of the space
repair them, and the algorithm decides which to accept.

And it may start from what is known already (`WarmStarts`): results of earlier simulations guide the search, but they
are not candidates, have no number, and are neither in the archive nor part of the budget.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from typing import Any, ClassVar, Final, Protocol, Self, TypeAlias, TypeVar, runtime_checkable

import numpy as np

from brink.search.archive import Archive
from brink.search.document import Document
from brink.search.rates import Terms
from brink.search.space import BoolArray, FloatArray, IntArray, SearchSpace, frozen_array
from brink.search.traffic.participants import Solution


class Question(StrEnum):
    """How a candidate is evaluated."""

    EPISODE = "episode"
    """Simulate it for a verdict; the evaluation is `Scored`."""
    DATASET = "dataset-evaluation"
    """Measure it on a data set, without a simulation or a verdict; the evaluation is `Measured`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidate:
    """A complete solution to evaluate.

    Attributes:
        number: Unique and stable in its campaign, counted from 0 in the order of asking.
        vectors: One read-only float64 vector per component, in the space's order.
        question: How to evaluate it.
        seed_number: Number of the candidate whose episode seed it shares; None for its own seed.
    """

    number: int
    vectors: tuple[FloatArray, ...]
    question: Question = Question.EPISODE
    seed_number: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Measure:
    """What a number says about a simulated candidate; a problem declares its measures.

    Attributes:
        name: Its name, such as ``least_front_gap_m``.
        low: Usual smallest value.
        high: Usual largest value; values beyond the two are possible.
        unit: Its unit, such as ``m``; empty for a plain number.
    """

    name: str
    low: float
    high: float
    unit: str = ""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise ValueError(f"{self.name}: expected a range with low < high, got {self.low} to {self.high}")

    def cell(self, value: float, cells: int) -> str:
        """Return in words in which of `cells` equal parts of the range a value lies, or is nearest to."""
        width = (self.high - self.low) / cells
        place = min(max(math.floor((value - self.low) / width), 0), cells - 1)
        low = self.low + place * width
        return f"{self.name} {low:g} to {low + width:g} {self.unit}".rstrip()


@dataclass(frozen=True, slots=True, kw_only=True)
class Niche:
    """What a candidate did, and how well, for searches that look for the best candidate of each kind of behaviour.

    Attributes:
        name: The kind of behaviour, in words.
        rank: The lower the better, whatever the value.
        value: Minimised among candidates of equal rank.
    """

    name: tuple[str, ...]
    rank: int
    value: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Scored:
    """Evaluation of a simulated candidate.

    Attributes:
        unsafe: Whether the campaign's requirement is violated.
        counts: Whether a violation is of the kind that the search looks for.
        robustness: Distance to violation, negative if violated.
        objectives: Values to optimise, all minimised, by name.
        measures: Values of the problem's measures, without those that this episode does not have.
        kinds: Kinds of failure that it exposed, for problems that classify them.
        niches: What it did, for problems that describe that.
    """

    unsafe: bool
    robustness: float
    objectives: Mapping[str, float] = field(default_factory=dict)
    measures: Mapping[Measure, float] = field(default_factory=dict)
    kinds: frozenset[str] = frozenset()
    niches: tuple[Niche, ...] = ()
    counts: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """Evaluation of a candidate on a data set: neither safe nor unsafe, so it is not archived.

    Attributes:
        objectives: Values to optimise, all minimised, by name.
    """

    objectives: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Failed:
    """Evaluation of a candidate without a verdict: neither safe nor unsafe."""

    reason: str


Evaluation: TypeAlias = Scored | Measured | Failed


class State(Protocol):
    """The properties that the state of every algorithm has."""

    @property
    def generation(self) -> int:
        """Number of generations told so far."""

    @property
    def archive(self) -> Archive:
        """All complete solutions with a verdict."""

    @property
    def fitness(self) -> FloatArray:
        """Values that the search currently minimises, shape ``(n,)``; shown as progress."""

    @property
    def pending(self) -> tuple[Candidate, ...]:
        """The oldest generation that was asked for but not yet told, ascending by number; empty if there is none."""


C = TypeVar("C")
"""The settings of an algorithm."""
S = TypeVar("S", bound=State)
"""The state of an algorithm."""
C_contra = TypeVar("C_contra", contravariant=True)
S_contra = TypeVar("S_contra", bound=State, contravariant=True)
S_co = TypeVar("S_co", bound=State, covariant=True)


class Algorithm(Protocol[C, S]):
    """A search algorithm. Instances hold no state and are cheap to create.

    Findings are read from the archive, never from the state. What each kind needs of an algorithm that is for it:

    - ``boundary``: nothing. With each generation, neighbours are counted in its archive, by its settings ``radius``,
      ``p_th`` and ``z`` if it has them.
    - ``pairs``: safe and unsafe solutions that are near each other, best with one episode seed
      (`Candidate.seed_number`): differences of a pair with two seeds cannot be reverted one by one. They are shown at
      its settings ``eps`` and ``d_th`` if it has them. Repeated solutions with other seeds count as checks of a pair.
    - ``thresholds``: lines, which are solutions that differ in one unit and in nothing else. At least eight of a line
      have an episode seed of their own, which no other candidate shares; those that share one only show where to
      expect the change. Without chance, a safe and an unsafe solution within two resolutions are enough.

    Attributes:
        id: Versioned plug-in id, such as ``mlcshe@1``.
        summary: One line for catalogues.
        config_type: Frozen dataclass whose fields are declared with `brink.search.settings.setting`.
        finds: Optional. The kinds of findings that it finds, the main one first, such as ``("pairs",)``; by
            default, ``("boundary",)``. See below.
        minimises: Optional. What the state's `fitness` is called: ``fitness`` by default, or ``criticality``; empty
            if the search minimises nothing that says how it goes on.
        suggested: Optional. Place among the algorithms that a new campaign may begin with, the lowest first.
        former: Optional. For settings that were added later, what their value was before, by name.
        is_baseline: Optional. Whether it draws solutions at random, without a search.
        honours_distribution: Optional. Whether it draws by the space's operational distribution (`SearchSpace.draw`);
            campaigns of any other say that they ignored it.
        needs_measures: Optional. Whether it cannot search without measures (`Measure`) or niches of candidates.
        internal: Optional. Whether only Brink itself starts campaigns with it.
    """

    id: str
    summary: str
    config_type: type[C]

    def check(self, space: SearchSpace, config: C, *, budget: int) -> None:
        """Check that the algorithm can run with these arguments.

        Args:
            space: The search space.
            config: Settings, of type `config_type`.
            budget: Number of simulations.

        Raises:
            UnsupportedSpace: The algorithm does not support the space.
            ConfigError: A setting does not fit the space, the other settings or the budget.
        """

    def start(self, space: SearchSpace, config: C, *, seed: int, budget: int) -> S:
        """Return the initial state, with nothing asked for yet.

        Args:
            space: The search space.
            config: Settings, of type `config_type`.
            seed: The campaign's seed.
            budget: Number of simulations.
        """

    def ask(self, state: S) -> tuple[S, tuple[Candidate, ...]]:
        """Return the state with one more generation in flight, and that generation.

        Raises:
            OrderError: No further generation may be in flight, or none is left to ask for.
        """

    def tell(self, state: S, evaluations: Mapping[int, Evaluation]) -> S:
        """Return the state after the oldest generation in flight was evaluated.

        Args:
            state: The state that the last `ask` returned.
            evaluations: One for each pending candidate, by number, in any order.

        Raises:
            OrderError: Nothing is pending, a generation has to be asked for first, or the numbers are not those of
                the pending candidates.
        """

    def finished(self, state: S) -> bool:
        """Return whether the search is over: nothing is in flight, and the budget is spent or nothing new is left."""

    def dump(self, state: S) -> Document:
        """Return the state, without its archive, as a versioned document."""

    def load(self, space: SearchSpace, config: C, document: Document, archive: Archive) -> S:
        """Return the state that `dump` stored.

        Args:
            space: The search space.
            config: Settings, of type `config_type`.
            document: The document that `dump` returned.
            archive: The archive of the state at that time.

        Raises:
            DocumentError: The document is corrupt, of another algorithm, or of an unknown version.
        """


AnyAlgorithm: TypeAlias = Algorithm[Any, Any]
"""Any algorithm, for functions that make its settings and states themselves."""
OpaqueAlgorithm: TypeAlias = Algorithm[object, State]
"""An algorithm that was found by its id: only the algorithm itself knows what its settings and states have."""

UNDECLARED: Final = ("boundary",)
"""What an algorithm finds that does not say so."""


def declared_minimises(algorithm: object) -> str:
    """Return the name of what an algorithm minimises; empty for nothing."""
    return str(getattr(algorithm, "minimises", "fitness"))


def declared_finds(algorithm: object) -> tuple[str, ...]:
    """Return the kinds of findings that an algorithm declares in `finds`, the main one first."""
    return tuple(getattr(algorithm, "finds", UNDECLARED))


@runtime_checkable
class NeedsObjectives(Protocol):
    """An algorithm that cannot be told evaluations without certain objectives.

    Attributes:
        needed_objectives: Names of the objectives.
    """

    needed_objectives: ClassVar[tuple[str, ...]]


@runtime_checkable
class Overlapping(Protocol[S_contra]):
    """An algorithm that may have several generations in flight; any other has one."""

    def can_ask(self, state: S_contra) -> bool:
        """Return whether a further generation is to be asked for before the pending one is told."""


@runtime_checkable
class KnowsFlight(Protocol[C_contra]):
    """An algorithm that knows how many candidates it keeps in flight."""

    def flight(self, config: C_contra) -> tuple[int, int]:
        """Return the most candidates of one generation, and the most generations in flight at a time.

        Args:
            config: Settings, of type `config_type`.
        """


def ask_each(algorithm: Algorithm[C, S], state: S) -> Iterator[tuple[S, tuple[Candidate, ...]]]:
    """Ask for every generation that may be in flight now, one after another.

    Args:
        algorithm: The algorithm; it must not be waiting for seeds.
        state: Its state.

    Yields:
        The state after each generation, and that generation.
    """
    while _can_ask(algorithm, state):
        state, candidates = algorithm.ask(state)
        yield state, candidates


def ask_all(algorithm: Algorithm[C, S], state: S) -> tuple[S, list[tuple[Candidate, ...]]]:
    """Ask for every generation that may be in flight now.

    Args:
        algorithm: The algorithm; it must not be waiting for seeds.
        state: Its state.

    Returns:
        The state, and the generations in the order of asking; possibly none.
    """
    asked = list(ask_each(algorithm, state))
    return asked[-1][0] if asked else state, [candidates for _, candidates in asked]


def _can_ask(algorithm: Algorithm[C, S], state: S) -> bool:
    if isinstance(algorithm, Overlapping):
        return algorithm.can_ask(state)
    return not state.pending and not algorithm.finished(state)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Known:
    """Prior knowledge of a search; all arrays are read-only.

    Attributes:
        rows: Solutions with a known result, shape ``(k, d)``; one that was simulated several times appears as often.
        unsafe: Their verdicts, shape ``(k,)``.
        robustness: Their distances to violation, shape ``(k,)``.
        points: Solutions without a result, to be simulated first, in this order, shape ``(p, d)``.
    """

    rows: FloatArray
    unsafe: BoolArray
    robustness: FloatArray
    points: FloatArray

    def __post_init__(self) -> None:
        for name, dtype in (("rows", np.float64), ("unsafe", np.bool_), ("robustness", np.float64)):
            object.__setattr__(self, name, frozen_array(getattr(self, name), dtype))
        object.__setattr__(self, "points", frozen_array(self.points))
        shapes = (self.rows.shape[:1], self.unsafe.shape, self.robustness.shape)
        if len(set(shapes)) > 1 or self.points.shape[1:] != self.rows.shape[1:]:
            raise ValueError(
                f"expected one verdict and robustness for each known result, and points of the same width; got "
                f"{self.rows.shape}, {self.unsafe.shape}, {self.robustness.shape} and {self.points.shape}"
            )

    @classmethod
    def nothing(cls, dimension: int) -> Self:
        """Return empty prior knowledge, for solutions of `dimension` numbers."""
        none, empty = np.empty((0, dimension)), np.empty(0)
        return cls(rows=none, unsafe=empty.astype(np.bool_), robustness=empty, points=none)

    def __len__(self) -> int:
        """Return the number of known results."""
        return len(self.rows)

    def nearest(self) -> IntArray:
        """Return the positions of the results, those nearest to the boundary first; see `nearest_to_boundary`."""
        return nearest_to_boundary(self.unsafe, self.robustness)


def nearest_to_boundary(unsafe: BoolArray, robustness: FloatArray) -> IntArray:
    """Return the positions of results by absolute robustness, alternating between verdicts, shape ``(n,)``.

    In turn, because few results of one verdict may all be further away than many of the other.

    Args:
        unsafe: Verdicts, shape ``(n,)``.
        robustness: Distances to violation, shape ``(n,)``.
    """
    rank = np.empty(len(unsafe), np.int64)
    for verdict in (False, True):
        mine = np.flatnonzero(unsafe == verdict)
        rank[mine[np.argsort(np.abs(robustness[mine]), kind="stable")]] = np.arange(len(mine))
    order: IntArray = np.lexsort((~unsafe, rank))
    return order


@runtime_checkable
class WarmStarts(Protocol[C_contra, S_co]):
    """An algorithm that can start from prior knowledge."""

    def start_with(
        self, space: SearchSpace, config: C_contra, *, seed: int, budget: int, known: Known
    ) -> S_co:
        """Return the initial state, as `Algorithm.start` does, of a search with prior knowledge.

        Its first candidates are the known points. The known results may guide the search, but do not count against
        the budget. Its documents contain what is known, so that `Algorithm.load` restores the state as usual.

        Args:
            space: The search space.
            config: Settings, of type `config_type`.
            seed: The campaign's seed.
            budget: Number of simulations; at least one for each point.
            known: Known results and points, all of them valid solutions.

        Raises:
            ConfigError: The budget does not suffice for the points.
        """


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Draws:
    """Simulations whose terms have the rate of unsafe solutions in operation as their mean.

    The term of a simulation is its `base`, and its weight on top of that if it is unsafe.

    Attributes:
        numbers: Numbers of the candidates, ascending, shape ``(n,)``.
        weights: Importance weights, shape ``(n,)``.
        bounds: The largest weight that each could have had, fixed before it was drawn, >= 1, shape ``(n,)``.
        unsafe: Whether each is unsafe, shape ``(n,)``.
        failed: Whether each has no verdict, shape ``(n,)``.
        base: The term of a safe simulation: 0, or that of a control variate, with expectation 0, shape ``(n,)``.
        reach: How far base may be from 0, fixed before the simulation was drawn, shape ``(n,)``.
        pace: How many times as much each counts as a plain simulation, because it is expected to vary less; fixed
            before it was drawn, shape ``(n,)``.
    """

    numbers: IntArray
    weights: FloatArray
    bounds: FloatArray
    unsafe: BoolArray
    failed: BoolArray
    base: FloatArray
    reach: FloatArray
    pace: FloatArray

    @classmethod
    def plain(
        cls,
        numbers: IntArray,
        unsafe: BoolArray,
        failed: BoolArray,
        *,
        weights: FloatArray | None = None,
        bounds: FloatArray | None = None,
    ) -> Self:
        """Return draws without a control variate; with weights of 1 if none are given."""
        ones, none = np.ones(len(numbers)), np.zeros(len(numbers))
        return cls(
            numbers=numbers,
            weights=ones if weights is None else weights,
            bounds=ones if bounds is None else bounds,
            unsafe=unsafe,
            failed=failed,
            base=none,
            reach=none,
            pace=ones,
        )

    def some(self, which: BoolArray | slice) -> Self:
        """Return some of the draws."""
        return replace(self, **{one.name: getattr(self, one.name)[which] for one in fields(self)})

    def unsafe_values(self) -> FloatArray:
        """Return the weights of unsafe simulations, and 0 for all others, shape ``(n,)``."""
        return np.where(self.unsafe, self.weights, 0.0)

    def terms(self, *, failed: bool = False) -> Terms:
        """Return the terms, whose mean is the rate.

        Args:
            failed: Whether simulations without a verdict count as unsafe.
        """
        counted = self.unsafe | (self.failed & failed)
        return Terms(
            values=self.base + np.where(counted, self.weights, 0.0),
            low=-self.reach,
            high=self.bounds + self.reach,
            pace=self.pace,
        )


@runtime_checkable
class EstimatesRate(Protocol):
    """An algorithm whose simulations say how often solutions are unsafe in operation."""

    def draws(self, document: Document, archive: Archive) -> Draws:
        """Return the draws among the simulations told so far.

        Args:
            document: The document that `Algorithm.dump` returned.
            archive: The archive of the state at that time.
        """


@dataclass(frozen=True, slots=True, kw_only=True)
class RareLevel:
    """What one level of subset simulation gave.

    Attributes:
        threshold: The robustness that defines the next level; 0 at the last, which is that of unsafe samples.
        share: Share of its samples that belong to the next level.
        variation: Estimated coefficient of variation of the share; None if it is 0.
        samples: Its samples.
        simulations: Those that were simulated in it.
        accepted: Moves that were accepted.
    """

    threshold: float
    share: float
    variation: float | None
    samples: int
    simulations: int
    accepted: int


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelEstimate:
    """A small rate as a product of shares.

    Attributes:
        levels: The finished levels.
        ended: Why the search has ended.
        rate: The estimate; None until unsafe samples are reached, as are all others.
        low: Lower end of an approximate interval.
        high: Its upper end.
        variation: Estimated coefficient of variation if levels are independent.
        most_variation: The same if they depend on each other as much as possible, on which the interval rests.
        bias: The largest bias that this allows for, as a share of the rate.
    """

    levels: tuple[RareLevel, ...]
    ended: str
    rate: float | None
    low: float | None
    high: float | None
    variation: float | None
    most_variation: float | None
    bias: float | None


@runtime_checkable
class EstimatesByLevels(Protocol):
    """An algorithm that estimates a small rate as a product of shares."""

    def level_estimate(self, document: Document, confidence: float) -> LevelEstimate:
        """Return the rate that the finished levels give.

        Args:
            document: The document that `Algorithm.dump` returned.
            confidence: Confidence of the interval, in (0, 1).
        """
        ...


class Origin(StrEnum):
    """The source of a solution. Stored states refer to their order: new ones come last."""

    RANDOM = "random"
    HEURISTIC = "heuristic"
    MUTATION = "mutation"
    CROSSOVER = "crossover"
    LLM = "llm"
    LLM_REPAIR = "llm_repair"
    IMMIGRANT = "immigrant"
    """A random solution in place of children that were known already."""
    AGAIN = "again"
    """A known solution, simulated once more under another seed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SeedRequest:
    """A request for seeds.

    Attributes:
        number: Counts the requests of a campaign from 0; identifies the request when it is repeated.
        count: Number of solutions wanted.
        exposed: Solutions that exposed a violation, latest first; none at the start of a search.
        silent: Solutions that exposed none, latest first.
        rejected: Proposals of the previous round that were not different enough.
        round: How many times the request has been sent back; 0 for a new one.
    """

    number: int
    count: int
    exposed: tuple[Solution, ...] = ()
    silent: tuple[Solution, ...] = ()
    rejected: tuple[Solution, ...] = ()
    round: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Proposal:
    """A proposed solution.

    Attributes:
        solution: The participants.
        origin: Who proposed it, and whether it had to be repaired.
    """

    solution: Solution
    origin: Origin


@runtime_checkable
class Seeded(Protocol[S]):
    """An algorithm that may request seeds from outside."""

    def wanted(self, state: S) -> SeedRequest | None:
        """Return the seeds needed before the next generation can be asked for, or None."""

    def seeded(self, state: S, proposals: Sequence[Proposal]) -> S:
        """Return the state after receiving the requested proposals, possibly none.

        Raises:
            OrderError: No seeds were requested.
        """
