"""`subset@1`: how often solutions are unsafe where that is very rare, by subset simulation on the robustness.

The rate is a product of conditional probabilities, each about 1 / length: that the robustness is at most b1, at most
b2 given b1, and so on, down to unsafe. The first level is drawn from the operational distribution. Each following one
is sampled by Markov chains that start from the samples below the threshold and stay there.

The state of a chain is a solution and the seed of its episode. A move changes the uniform numbers from which the
solution is drawn (`brink.search.replayed`), and in half of all moves takes a new seed; it is accepted if the
robustness is still at most the threshold. So chance is conditioned on as parameters are.

The estimate is biased, by a share of the order of 1 over the samples of a level, and its coefficient of variation is
itself an estimate from the chains. Neither comes with the guarantee of `rate@1`: this method is for rates that no
budget shows otherwise. Where robustness has few values, thresholds do not divide the samples, and the search ends.

Chains are divided into as many groups as generations may be in flight, which take turns; a level waits for all.

Source: Au and Beck 2001; Papaioannou, Betz, Zwirglmaier and Straub 2015.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from statistics import NormalDist
from typing import Any, Final

import numpy as np

from brink.search.algorithm import Evaluation, LevelEstimate, RareLevel, Scored
from brink.search.algorithms.ledger import Ledger, LedgerAlgorithm, LedgerConfig, LedgerState
from brink.search.document import Document
from brink.search.errors import DocumentError, UnsupportedSpace
from brink.search.replayed import draw_from, moved
from brink.search.settings import setting
from brink.search.space import BoolArray, FloatArray, IntArray, SearchSpace, frozen_array
from brink.search.streams import Stream, generator

_NEW_SEED: Final = 0.5
"""Share of moves that take a new seed."""
_MOST_TIED: Final = 2.0
"""How many times the intended share of samples may be below a threshold, because they tie."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SubsetConfig(LedgerConfig):
    """Settings of subset simulation."""

    chains: int = setting(
        50, main=True, help="Markov chains; each level has chains x length samples.", ge=5, le=2_000
    )
    length: int = setting(
        10, help="Samples of a chain; one in so many goes on to the next level.", ge=2, le=50
    )
    in_flight: int = setting(8, help="Groups of chains that are simulated at a time.", ge=1, le=100)


class Ended(StrEnum):
    """Why a search has ended."""

    NOT_YET = "not yet"
    REACHED = "reached"
    NOT_GRADED = "not graded"
    BUDGET = "budget"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SubsetState(LedgerState):
    """State of subset simulation.

    Attributes:
        config: Settings.
        threshold: The robustness that samples of this level do not exceed; infinite at the first.
        planned: Generations of this level that are planned, asked for or told.
        told: Those that are told.
        accepted: Moves of this level that were accepted.
        scores: Robustness of the samples of this level, NaN where not sampled yet, infinite for failures, shape
            ``(chains, length)``.
        seeds: The candidate whose own episode seed each sample has, -1 where not sampled yet, of the same shape.
        numbers: The uniform numbers of each sample, NaN beyond the last, shape ``(chains, length, k)``.
        proposed: Those of the candidates in flight and in the queue, in their order, shape ``(m, k)``.
        levels: The finished levels.
        ended: Why the search has ended.
    """

    config: SubsetConfig
    threshold: float
    planned: int
    told: int
    accepted: int
    scores: FloatArray
    seeds: FloatArray
    numbers: FloatArray
    proposed: FloatArray
    levels: tuple[RareLevel, ...] = ()
    ended: Ended = Ended.NOT_YET

    @property
    def first(self) -> int:
        """The first sample of a chain that is simulated: later levels start with a sample that was."""
        return 0 if math.isinf(self.threshold) else 1

    @property
    def turns(self) -> int:
        """Number of generations of this level."""
        return (self.config.length - self.first) * len(_groups(self.config))

    def turn(self, generation: int) -> tuple[IntArray, int]:
        """Return which chains a generation of this level moves, and to which sample."""
        groups = _groups(self.config)
        return groups[generation % len(groups)], self.first + generation // len(groups)


def _groups(config: SubsetConfig) -> list[IntArray]:
    return np.array_split(np.arange(config.chains), min(config.in_flight, config.chains))


class Subset(LedgerAlgorithm[SubsetConfig, SubsetState]):
    """Estimates small rates by subset simulation."""

    id = "subset@1"
    finds = ("levels",)
    minimises = ""
    summary = "How often solutions are unsafe where that is very rare, from the robustness of safe ones."
    config_type = SubsetConfig
    honours_distribution = True

    def _min_budget(self, space: SearchSpace, config: SubsetConfig) -> int:
        try:
            draw_from(space, np.empty(0), generator(0, Stream.SUBSET))
        except (AttributeError, NotImplementedError) as error:
            raise UnsupportedSpace(
                f"subset@1 cannot move solutions of a space whose draws are not made of uniform numbers: {error}"
            ) from None
        return config.chains * config.length

    def flight(self, config: SubsetConfig) -> tuple[int, int]:
        """Return the most candidates of one generation, and the most generations in flight at a time."""
        groups = _groups(config)
        return len(groups[0]), len(groups)

    def _first_state(self, ledger: Ledger, config: SubsetConfig) -> SubsetState:
        return _planned(
            _level(
                SubsetState(
                    config=config,
                    ledger=ledger,
                    threshold=math.inf,
                    planned=0,
                    told=0,
                    accepted=0,
                    scores=np.empty(0),
                    seeds=np.empty(0),
                    numbers=np.empty((0, 0, 0)),
                    proposed=frozen_array(np.empty((0, 0))),
                )
            )
        )

    def tell(self, state: SubsetState, evaluations: Mapping[int, Evaluation]) -> SubsetState:
        """Return the state after the pending generation was evaluated."""
        pending = state.ledger.pending
        chains, sample = state.turn(state.told)
        count = len(pending)
        ledger = state.ledger.tell(evaluations)
        scores, seeds, numbers = (
            state.scores.copy(),
            state.seeds.copy(),
            _widened(state.numbers, state.proposed),
        )
        found = np.array([_score(evaluations[one.number]) for one in pending])
        taken = found <= state.threshold
        own = np.array(
            [one.number if one.seed_number is None else one.seed_number for one in pending], np.float64
        )
        if sample > 0 and state.first:
            before = sample - 1
            scores[chains, sample] = np.where(taken, found, scores[chains, before])
            seeds[chains, sample] = np.where(taken, own, seeds[chains, before])
            numbers[chains, sample] = np.where(
                taken[:, None], _padded(state.proposed[:count], numbers.shape[2]), numbers[chains, before]
            )
        else:
            scores[chains, sample], seeds[chains, sample] = found, own
            numbers[chains, sample] = _padded(state.proposed[:count], numbers.shape[2])
        state = replace(
            state,
            ledger=ledger,
            told=state.told + 1,
            accepted=state.accepted + int(taken.sum()),
            scores=frozen_array(scores),
            seeds=frozen_array(seeds),
            numbers=frozen_array(numbers),
            proposed=frozen_array(state.proposed[count:]),
        )
        return _planned(_next_level(state) if state.told == state.turns else state)

    def _refilled(self, state: SubsetState) -> SubsetState:
        return _planned(state)

    def _content(self, state: SubsetState) -> tuple[dict[str, Any], dict[str, Any]]:
        header = {
            "threshold": None if math.isinf(state.threshold) else state.threshold,
            "planned": state.planned,
            "told": state.told,
            "accepted": state.accepted,
            "levels": [asdict(one) for one in state.levels],
            "ended": state.ended.value,
        }
        arrays = {
            "scores": state.scores,
            "seeds": state.seeds,
            "numbers": state.numbers.reshape(len(state.numbers) * state.config.length, -1),
            "proposed": state.proposed,
        }
        return header, arrays

    def _restored(self, ledger: Ledger, config: SubsetConfig, document: Document) -> SubsetState:
        header, arrays = document.header, document.arrays
        shape = (config.chains, config.length)
        scores, seeds = arrays.get("scores"), arrays.get("seeds")
        numbers, proposed = arrays.get("numbers"), arrays.get("proposed")
        if scores is None or seeds is None or scores.shape != shape or seeds.shape != shape:
            raise DocumentError(f"scores and seeds: expected arrays of shape {shape}")
        if numbers is None or numbers.ndim != 2 or len(numbers) != config.chains * config.length:
            raise DocumentError(
                f"numbers: expected a row for each of {config.chains * config.length} samples"
            )
        if proposed is None or proposed.ndim != 2 or len(proposed) != ledger.in_flight + len(ledger.queue):
            raise DocumentError("proposed: expected a row for each candidate in flight and in the queue")
        for name in ("planned", "told", "accepted"):
            if not isinstance(header.get(name), int) or header[name] < 0:
                raise DocumentError(f"{name}: expected a whole number >= 0, got {header.get(name)!r}")
        return SubsetState(
            config=config,
            ledger=ledger,
            threshold=_stored_threshold(header),
            planned=header["planned"],
            told=header["told"],
            accepted=header["accepted"],
            scores=frozen_array(scores),
            seeds=frozen_array(seeds),
            numbers=frozen_array(numbers.reshape(*shape, -1)),
            proposed=frozen_array(proposed),
            levels=_stored_levels(header),
            ended=_stored_end(header),
        )

    def level_estimate(self, document: Document, confidence: float) -> LevelEstimate:
        """Return the rate that the finished levels give; see `EstimatesByLevels`."""
        levels, ended = _stored_levels(document.header), _stored_end(document.header)
        return estimate_of(levels, ended.value, confidence, reached=ended is Ended.REACHED)


def _stored_threshold(header: Mapping[str, Any]) -> float:
    threshold = header.get("threshold")
    if threshold is not None and (isinstance(threshold, bool) or not isinstance(threshold, int | float)):
        raise DocumentError(f"threshold: expected a number or null, got {threshold!r}")
    return math.inf if threshold is None else float(threshold)


def _stored_levels(header: Mapping[str, Any]) -> tuple[RareLevel, ...]:
    try:
        return tuple(RareLevel(**one) for one in header["levels"])
    except (KeyError, TypeError) as error:
        raise DocumentError(f"levels: expected what finished levels gave: {error}") from None


def _stored_end(header: Mapping[str, Any]) -> Ended:
    try:
        return Ended(str(header.get("ended")))
    except ValueError:
        raise DocumentError(
            f"ended: expected one of {', '.join(Ended)}, got {header.get('ended')!r}"
        ) from None


def _score(evaluation: Evaluation) -> float:
    """Return the robustness, below 0 if and only if unsafe; infinite without a verdict."""
    if not isinstance(evaluation, Scored):
        return math.inf
    if evaluation.unsafe:
        return min(evaluation.robustness, -1e-12)
    return max(evaluation.robustness, 0.0)


def _padded(rows: FloatArray, width: int) -> FloatArray:
    """Return rows with NaN at their ends, shape ``(n, width)``."""
    padded = np.full((len(rows), width), np.nan)
    padded[:, : rows.shape[1]] = rows
    return padded


def _widened(numbers: FloatArray, proposed: FloatArray) -> FloatArray:
    width = max(numbers.shape[2], proposed.shape[1])
    wide = np.full((*numbers.shape[:2], width), np.nan)
    wide[:, :, : numbers.shape[2]] = numbers
    return wide


def _level(state: SubsetState, chosen: IntArray | None = None, threshold: float = math.inf) -> SubsetState:
    """Return the state at the beginning of a level, whose chains start with chosen samples of the one before."""
    shape = state.config.chains, state.config.length
    scores, seeds = np.full(shape, np.nan), np.full(shape, -1.0)
    numbers = np.full((*shape, state.numbers.shape[2]), np.nan)
    if chosen is not None:
        scores[:, 0], seeds[:, 0] = state.scores.ravel()[chosen], state.seeds.ravel()[chosen]
        numbers[:, 0] = state.numbers.reshape(-1, numbers.shape[2])[chosen]
    return replace(
        state,
        threshold=threshold,
        planned=0,
        told=0,
        accepted=0,
        scores=frozen_array(scores),
        seeds=frozen_array(seeds),
        numbers=frozen_array(numbers),
    )


def _next_level(state: SubsetState) -> SubsetState:
    """Return the state after a level, whose samples are complete."""
    config, scores = state.config, state.scores
    threshold = float(np.sort(scores, axis=None)[config.chains - 1])
    if threshold < 0:
        return _closed(state, 0.0, Ended.REACHED)
    below = int(np.count_nonzero(scores <= threshold))
    if math.isinf(threshold) or threshold >= state.threshold or below > _MOST_TIED * config.chains:
        return _closed(state, 0.0, Ended.NOT_GRADED)
    if state.ledger.unspent < config.chains * (config.length - 1):
        return _closed(state, 0.0, Ended.BUDGET)
    state = _closed(state, threshold, Ended.NOT_YET)
    rng = generator(state.ledger.seed, Stream.SUBSET, 1, len(state.levels))
    chosen = np.sort(rng.permutation(np.flatnonzero(scores.ravel() <= threshold))[: config.chains])
    return _level(state, chosen, threshold)


def _closed(state: SubsetState, threshold: float, ended: Ended) -> SubsetState:
    """Return the state with what its level gave: the share of samples at most `threshold`, or unsafe if that is 0."""
    inside = (state.scores < 0) if ended is not Ended.NOT_YET else state.scores <= threshold
    level = RareLevel(
        threshold=threshold,
        share=float(inside.mean()),
        variation=_variation(inside, is_chained=bool(state.first)),
        samples=inside.size,
        simulations=(state.config.length - state.first) * state.config.chains,
        accepted=state.accepted,
    )
    return replace(state, levels=(*state.levels, level), ended=ended)


def _variation(inside: BoolArray, *, is_chained: bool) -> float | None:
    """Return the coefficient of variation of a level's share; None if no sample is inside.

    Args:
        inside: Whether each sample is inside, shape ``(chains, length)``.
        is_chained: Whether the samples of a row are those of a Markov chain.

    References:
        Au and Beck 2001, eqs. 25-29.
    """
    share, length = float(inside.mean()), inside.shape[1]
    if share in (0.0, 1.0):
        return None if share == 0.0 else 0.0
    correlation = 0.0
    if is_chained:
        variance = share * (1 - share)
        for lag in range(1, length):
            product = float((inside[:, :-lag] & inside[:, lag:]).mean())
            correlation += 2 * (1 - lag / length) * (product - share**2) / variance
    return math.sqrt((1 - share) / (share * inside.size) * (1 + max(correlation, 0.0)))


def estimate_of(
    levels: tuple[RareLevel, ...], ended: str, confidence: float, *, reached: bool
) -> LevelEstimate:
    """Return the rate that levels give.

    Args:
        levels: The finished levels.
        ended: Why the search has ended.
        confidence: Confidence of the interval, in (0, 1).
        reached: Whether the last level is that of unsafe samples, with at least as many of them as chains.
    """
    rate = math.prod(one.share for one in levels) if levels else 0.0
    if not reached:
        return LevelEstimate(
            levels=levels,
            ended=ended,
            rate=None,
            low=None,
            high=None,
            variation=None,
            most_variation=None,
            bias=None,
        )
    each = [one.variation or 0.0 for one in levels]
    most = sum(each)
    # Levels are dependent, since chains start from samples of the level before: to add their deviations is the worst.
    spread = NormalDist().inv_cdf(0.5 + 0.5 * confidence) * math.sqrt(math.log1p(most**2))
    return LevelEstimate(
        levels=levels,
        ended=ended,
        rate=rate,
        low=rate * math.exp(-spread),
        high=min(rate * math.exp(spread), 1.0),
        variation=math.sqrt(sum(one**2 for one in each)),
        most_variation=most,
        bias=0.5 * (most**2 - sum(one**2 for one in each)),
    )


def _planned(state: SubsetState) -> SubsetState:
    """Return the state with the next generation queued, if its chains stand and there is room in flight."""
    ledger, groups = state.ledger, len(_groups(state.config))
    full = bool(ledger.queue) or len(ledger.flight) >= groups
    if full or state.ended is not Ended.NOT_YET or state.planned == state.turns:
        return state
    chains, sample = state.turn(state.planned)
    if sample > state.first and state.told <= state.planned - groups:
        return state
    rng = generator(ledger.seed, Stream.SUBSET, 0, ledger.planned_generation)
    rows, numbers, seeds = [], [], []
    for chain in chains.tolist():
        before = np.empty(0)
        seed = None
        if state.first:
            before = state.numbers[chain, sample - 1]
            before = moved(before[~np.isnan(before)], rng)
            seed = None if rng.random() < _NEW_SEED else int(state.seeds[chain, sample - 1])
        row, used = draw_from(ledger.space, before, rng)
        rows.append(frozen_array(row))
        numbers.append(used)
        seeds.append(seed)
    width = max(max(map(len, numbers)), state.proposed.shape[1])
    fresh = np.full((len(numbers), width), np.nan)
    for place, used in enumerate(numbers):
        fresh[place, : len(used)] = used
    return replace(
        state,
        ledger=ledger.plan(rows, seed_numbers=seeds),
        planned=state.planned + 1,
        proposed=frozen_array(np.concatenate([_padded(state.proposed, width), fresh])),
    )
