"""`sharpen@1`: brings pairs to thresholds, whichever search found them.

Each pair is *prepared* under a fresh episode seed:

1. Both sides are simulated. If the seed does not keep them apart, another one is tried, at most `TRIES` in all.
2. Where several units differ, the unsafe side takes over the values of the safe one, one unit after the other, the
   largest difference first, until it is safe. Along that unit the drive turns.
3. The line is prolonged beyond both ends as far as they keep their verdicts, because a pair may be narrower than the
   stretch. Without chance, it is bisected to the resolution instead, and that is all.

Then the probability of a violation along each line is estimated under fresh seeds (`brink.search.thresholds`).

Preparations ask for batches of simulations and draw nothing at random, so that they are replayed from the archive.

Source: ours; docs/explanation/thresholds.md.
"""

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, TypeAlias

import numpy as np

from brink.search.algorithm import Evaluation, Scored
from brink.search.algorithms.ledger import (
    Ledger,
    LedgerAlgorithm,
    LedgerConfig,
    LedgerState,
    check_given_rows,
)
from brink.search.conclusions import Outcome
from brink.search.document import Document
from brink.search.errors import ConfigError, DocumentError, UnsupportedSpace
from brink.search.features import units_of
from brink.search.pairs import Steps
from brink.search.parameters import Number
from brink.search.settings import setting
from brink.search.space import FloatArray, SearchSpace
from brink.search.streams import Stream, generator
from brink.search.thresholds import MOST, CurvePrior, Estimate, Trials, estimate, next_places
from brink.search.thresholds.line import Line, valid_change

TRIES: Final = 3
"""Fresh seeds under which a pair may turn out to be one."""
PROLONGED: Final = (0.125, 0.25, 0.5, 1.0)
"""How far beyond the ends of a line solutions are simulated, as shares of the way to the end of the range."""
HALVINGS: Final = 12
"""Most bisections of a line without chance."""
FIRST_BATCH: Final = 8
BATCH: Final = 6
"""Simulations of an estimation in flight at a time, at its beginning and later."""
MAX_FAILURES: Final = 20
"""Simulations of an estimation that may fail before it is given up."""
_ESTIMATE: Final = 100
_PLACES: Final = 101
"""First indices of the stream."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SharpenConfig(LedgerConfig):
    """Settings of the search for thresholds near pairs."""

    safe: list[list[float]] = field(
        default_factory=list, metadata={"help": "Safe sides of the pairs, each as a row of its numbers."}
    )
    unsafe: list[list[float]] = field(
        default_factory=list, metadata={"help": "Unsafe sides of the pairs, in the same order."}
    )
    trials: int = setting(
        MOST,
        help="Most simulations with fresh seeds along a unit; 0 for problems without chance.",
        ge=0,
        le=1000,
    )
    generation_size: int = setting(24, help="Candidates per generation.", ge=1, le=10_000)
    in_flight: int = setting(3, help="Generations in flight at a time.", ge=1, le=1000)


def moved_units(space: SearchSpace, safe: FloatArray, unsafe: FloatArray) -> list[int]:
    """Return the indices of the numbers in which the sides of a pair differ."""
    return [
        index
        for index, unit in enumerate(units_of(space))
        if not space.categorical[list(unit)].any() and (safe[list(unit)] != unsafe[list(unit)]).any()
    ]


def most_simulations(pairs: int, units: int, trials: int) -> int:
    """Return the largest number of simulations that pairs take.

    Args:
        pairs: Number of pairs.
        units: Units in which the sides differ, over all pairs.
        trials: Most simulations with fresh seeds along a unit.
    """
    return 2 * TRIES * pairs + units + (max(2 * len(PROLONGED), HALVINGS) + trials) * pairs


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SharpenState(LedgerState):
    """State of the search for thresholds near pairs.

    Attributes:
        config: Settings.
        lines: The lines of the prepared pairs; None before they are prepared.
        jobs: The line of each candidate in flight or queued, in the order of asking; -1 while pairs are prepared.
        trials: Numbers of the simulations along each line with seeds of their own that have a verdict.
        failures: How many of each line have none.
        outcomes: The conclusion on each line so far.
        estimates: The estimates of lines, by index, as far as computed.
    """

    config: SharpenConfig
    lines: "tuple[PreparedLine, ...] | None" = None
    jobs: tuple[int, ...] = ()
    trials: tuple[tuple[int, ...], ...] = ()
    failures: tuple[int, ...] = ()
    outcomes: tuple[Outcome, ...] = ()
    estimates: Mapping[int, Estimate] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PreparedLine:
    """The line of a prepared pair.

    Attributes:
        line: The line.
        safe: Place of its last safe solution under the seed.
        unsafe: Place of the first unsafe one beyond that.
    """

    line: Line
    safe: float
    unsafe: float

    @property
    def prior(self) -> CurvePrior:
        """The prior of the curve."""
        return CurvePrior(
            safe=self.safe, unsafe=self.unsafe, resolution=self.line.resolution, range=self.line.range
        )


class Sharpen(LedgerAlgorithm[SharpenConfig, SharpenState]):
    """The search for thresholds near given pairs."""

    id = "sharpen@1"
    finds = ("thresholds",)
    minimises = ""
    internal = True
    summary = "No search: brings given pairs to thresholds along the unit in which they differ."
    config_type = SharpenConfig

    def _min_budget(self, space: SearchSpace, config: SharpenConfig) -> int:
        if space.categorical.all():
            raise UnsupportedSpace(
                "sharpen@1 needs pairs that differ in a number: this space has categories alone"
            )
        if not config.safe or len(config.safe) != len(config.unsafe):
            raise ConfigError(
                "unsafe",
                f"expected as many as safe ones and at least one, got {len(config.unsafe)} for {len(config.safe)}",
            )
        check_given_rows(space, "safe", config.safe)
        check_given_rows(space, "unsafe", config.unsafe)
        for place, (safe, unsafe) in enumerate(zip(*_rows(config), strict=True)):
            if not moved_units(space, safe, unsafe):
                raise ConfigError(
                    "unsafe", f"expected pairs that differ in a number; pair {place + 1} does not"
                )
        return 1

    def _first_state(self, ledger: Ledger, config: SharpenConfig) -> SharpenState:
        return _planned(SharpenState(config=config, ledger=ledger))

    def _refilled(self, state: SharpenState) -> SharpenState:
        return _planned(state)

    def tell(self, state: SharpenState, evaluations: Mapping[int, Evaluation]) -> SharpenState:
        """Return the state after the pending generation was evaluated."""
        pending = state.ledger.pending
        jobs, left = state.jobs[: len(pending)], state.jobs[len(pending) :]
        trials, failures = [list(numbers) for numbers in state.trials], list(state.failures)
        for candidate, index in zip(pending, jobs, strict=True):
            if index >= 0 and isinstance(evaluations[candidate.number], Scored):
                trials[index].append(candidate.number)
            elif index >= 0:
                failures[index] += 1
        told = replace(
            state,
            ledger=state.ledger.tell(evaluations),
            jobs=left,
            trials=tuple(map(tuple, trials)),
            failures=tuple(failures),
        )
        ready = sorted(set(jobs) - set(left) - {-1})
        return _planned(_concluded(told, ready))

    def _content(self, state: SharpenState) -> tuple[dict[str, Any], dict[str, Any]]:
        return {
            "jobs": list(state.jobs),
            "trials": [list(numbers) for numbers in state.trials],
            "failures": list(state.failures),
            "outcomes": [outcome.value for outcome in state.outcomes],
        }, {}

    def _restored(self, ledger: Ledger, config: SharpenConfig, document: Document) -> SharpenState:
        try:
            header = document.header
            jobs = tuple(int(index) for index in header["jobs"])
            trials = tuple(tuple(int(number) for number in numbers) for numbers in header["trials"])
            failures = tuple(int(count) for count in header["failures"])
            outcomes = tuple(Outcome(value) for value in header["outcomes"])
        except (KeyError, TypeError, ValueError) as error:
            raise DocumentError(
                f"jobs, trials, failures, outcomes: {type(error).__name__}: {error}"
            ) from None
        prepared = _prepared(ledger, config)
        lines = None if isinstance(prepared, _Wanted) else prepared
        count = len(lines or ())
        if not len(trials) == len(failures) == len(outcomes) == count:
            raise DocumentError(f"trials, failures, outcomes: expected one for each of {count} lines")
        if len(jobs) != ledger.in_flight + len(ledger.queue) or not set(jobs) <= {*range(count), -1}:
            raise DocumentError("jobs: expected the line of each candidate in flight or queued")
        if not {number for numbers in trials for number in numbers} <= set(ledger.archive.numbers.tolist()):
            raise DocumentError("trials: expected numbers of this campaign's solutions")
        return SharpenState(
            config=config,
            ledger=ledger,
            lines=lines,
            jobs=jobs,
            trials=trials,
            failures=failures,
            outcomes=outcomes,
        )


Batch: TypeAlias = list[tuple[FloatArray, int | None]]
"""Solutions to simulate, each with the number of the candidate whose seed it shares; None for its own seed."""
Verdicts: TypeAlias = Sequence[bool | None]
"""Whether each solution of a batch was unsafe; None without a verdict."""


@dataclass(slots=True, kw_only=True)
class _Pair:
    """A pair while it is prepared.

    Attributes:
        safe: The safe side, shape ``(d,)``.
        unsafe: The unsafe side as changed so far, shape ``(d,)``.
        left: Units that differ, as indices, those to be taken over next first.
        unit: Index of the unit along which it turns; -1 before it is known.
        anchor: Number of the unsafe side, whose seed all share; -1 before a seed keeps the sides apart.
        start: Safe end of the line, shape ``(d,)``.
        end: Unsafe end of the line, shape ``(d,)``.
    """

    safe: FloatArray
    unsafe: FloatArray
    left: list[int]
    unit: int = -1
    anchor: int = -1
    start: FloatArray = field(init=False)
    end: FloatArray = field(init=False)

    def ends_here(self) -> None:
        """Let the line end at its safe and unsafe side."""
        self.start, self.end = self.safe, self.unsafe


def _preparation(
    space: SearchSpace, config: SharpenConfig
) -> Generator[Batch, Verdicts, tuple[PreparedLine, ...]]:
    """Prepare all pairs at once; yields batches of simulations, is sent their verdicts, and returns the lines."""
    steps = Steps(space)
    pairs = [
        _Pair(safe=safe, unsafe=unsafe, left=_by_length(steps, safe, unsafe))
        for safe, unsafe in zip(*_rows(config), strict=True)
    ]
    yield from _apart(pairs)
    pairs = [pair for pair in pairs if pair.anchor >= 0]
    yield from _reduced(pairs, steps)
    pairs = [pair for pair in pairs if pair.unit >= 0]
    for pair in pairs:
        pair.ends_here()
    yield from (_prolonged(pairs, steps) if config.trials else _bisected(pairs, steps))
    return tuple(_line_of(pair, steps) for pair in pairs)


def _line_of(pair: _Pair, steps: Steps) -> PreparedLine:
    line = Line(steps.space, steps.units[pair.unit], pair.start, pair.end)
    safe, unsafe = (min(max(line.place_of(row), 0.0), 1.0) for row in (pair.safe, pair.unsafe))
    return PreparedLine(line=line, safe=safe, unsafe=unsafe)


def _by_length(steps: Steps, safe: FloatArray, unsafe: FloatArray) -> list[int]:
    """Return the numeric units in which two rows differ, as indices, the largest difference first."""
    units = moved_units(steps.space, safe, unsafe)
    lengths = steps.lengths(safe, unsafe, [steps.units[unit] for unit in units])
    return [units[place] for place in np.argsort(-lengths, kind="stable").tolist()]


def _apart(pairs: Sequence[_Pair]) -> Generator[Batch, Verdicts, None]:
    """Simulate both sides of each pair under one seed that keeps them apart."""
    number, left = 0, list(pairs)
    for _ in range(TRIES):
        if not left:
            break
        batch: Batch = []
        for pair in left:
            batch += [(pair.unsafe, None), (pair.safe, number + len(batch))]
        verdicts = yield batch
        for place, pair in enumerate(left):
            if verdicts[2 * place] is True and verdicts[2 * place + 1] is False:
                pair.anchor = number + 2 * place
        left = [pair for pair in left if pair.anchor < 0]
        number += len(batch)


def _reduced(pairs: Sequence[_Pair], steps: Steps) -> Generator[Batch, Verdicts, None]:
    """Find the unit along which each pair turns."""
    for pair in pairs:
        if len(steps.differing(pair.safe, pair.unsafe)) == 1:
            pair.unit = pair.left.pop()
    while asked := [(pair, *one) for pair in pairs if (one := _next_change(pair, steps)) is not None]:
        verdicts = yield [(row, pair.anchor) for pair, _, row in asked]
        for (pair, unit, row), unsafe in zip(asked, verdicts, strict=True):
            if unsafe is False:
                pair.unit, pair.safe = unit, row
            elif unsafe:
                pair.unsafe = row


def _next_change(pair: _Pair, steps: Steps) -> tuple[int, FloatArray] | None:
    """Return the next unit of a pair and the unsafe side with its safe value; None if there is none."""
    while pair.unit < 0 and pair.left:
        unit = pair.left.pop(0)
        columns = steps.units[unit]
        row = np.array(pair.unsafe)
        row[list(columns)] = pair.safe[list(columns)]
        changed = valid_change(steps.space, pair.unsafe, row, columns)
        if changed is not None and not np.array_equal(changed, pair.unsafe):
            return unit, changed
    return None


def _prolonged(pairs: Sequence[_Pair], steps: Steps) -> Generator[Batch, Verdicts, None]:
    """Move both ends of each line out as far as they keep their verdicts.

    Where the verdict changes on the way to the end of the range, an end stays one step before the last that kept it.
    """
    asked = [
        (pair, is_end, row)
        for pair in pairs
        for is_end in (False, True)
        for row in _beyond(pair, steps, is_end=is_end)
    ]
    verdicts = (yield [(row, pair.anchor) for pair, _, row in asked]) if asked else []
    ways: dict[tuple[int, bool], list[tuple[FloatArray, bool]]] = {}
    for (pair, is_end, row), unsafe in zip(asked, verdicts, strict=True):
        ways.setdefault((pair.anchor, is_end), []).append((row, unsafe is is_end))
    for pair in pairs:
        for is_end in (False, True):
            way = ways.get((pair.anchor, is_end), [])
            kept = [row for place, (row, _) in enumerate(way) if all(keeps for _, keeps in way[: place + 1])]
            if len(kept) < len(way):
                kept = kept[:-1]
            if kept and is_end:
                pair.end = kept[-1]
            elif kept:
                pair.start = kept[-1]


def _bisected(pairs: Sequence[_Pair], steps: Steps) -> Generator[Batch, Verdicts, None]:
    """Halve each line until it is as narrow as the resolution."""
    for _ in range(HALVINGS):
        asked = []
        for pair in pairs:
            line = Line(steps.space, steps.units[pair.unit], pair.safe, pair.unsafe)
            row = line.at(0.5) if line.resolution < 1.0 else None
            if row is not None and 0.0 < line.place_of(row) < 1.0:
                asked.append((pair, row))
        if not asked:
            return
        verdicts = yield [(row, pair.anchor) for pair, row in asked]
        for (pair, row), unsafe in zip(asked, verdicts, strict=True):
            if unsafe:
                pair.unsafe = row
            elif unsafe is False:
                pair.safe = row


def _beyond(pair: _Pair, steps: Steps, *, is_end: bool) -> list[FloatArray]:
    """Return solutions beyond the safe or the unsafe end of a pair's line, the nearest first."""
    space, unit = steps.space, steps.units[pair.unit]
    line = Line(space, unit, pair.safe, pair.unsafe)
    columns = [column for column in unit if pair.safe[column] != pair.unsafe[column]]
    border, other = (pair.unsafe, pair.safe) if is_end else (pair.safe, pair.unsafe)
    away = border[columns] - other[columns]
    ends = [
        parameter.most if step > 0 else parameter.least
        for parameter, step in zip((space.parameters[column] for column in columns), away, strict=True)
        if isinstance(parameter, Number)
    ]
    room = float(((np.array(ends) - border[columns]) / away).min())
    lengths = [share * room for share in PROLONGED if share * room > line.resolution]
    rows = [line.at(1.0 + length if is_end else -length) for length in lengths]
    return [row for row in rows if row is not None and not 0.0 <= line.place_of(row) <= 1.0]


def _rows(config: SharpenConfig) -> tuple[FloatArray, FloatArray]:
    return np.asarray(config.safe, np.float64), np.asarray(config.unsafe, np.float64)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Wanted:
    """Simulations that prepare pairs.

    Attributes:
        batch: What to simulate.
        first: Number of the first of these candidates.
    """

    batch: Batch
    first: int


def _prepared(ledger: Ledger, config: SharpenConfig) -> _Wanted | tuple[PreparedLine, ...]:
    """Return the lines of the pairs if they are prepared, or what to simulate for that."""
    archive = ledger.archive
    verdicts = dict(zip(archive.numbers.tolist(), archive.unsafe.tolist(), strict=True))
    preparation, first = _preparation(ledger.space, config), 0
    try:
        batch = next(preparation)
        while first + len(batch) <= ledger.spent:
            told = [verdicts.get(number) for number in range(first, first + len(batch))]
            first += len(batch)
            batch = preparation.send(told)
    except StopIteration as ended:
        lines: tuple[PreparedLine, ...] = ended.value
        return lines
    return _Wanted(batch=batch, first=first)


def _planned(state: SharpenState) -> SharpenState:
    """Return the state with the next generation queued: the preparation of pairs, then estimations."""
    ledger, config = state.ledger, state.config
    if ledger.queue or ledger.left <= 0 or len(ledger.flight) >= config.in_flight:
        return state
    size = int(min(config.generation_size, ledger.left))
    if state.lines is None:
        prepared = _prepared(ledger, config)
        if isinstance(prepared, _Wanted):
            batch = prepared.batch[ledger.spent + ledger.in_flight - prepared.first :][:size]
            planned = ledger.plan([row for row, _ in batch], seed_numbers=[seed for _, seed in batch])
            return replace(state, ledger=planned, jobs=(*state.jobs, *(-1 for _ in batch)))
        count = len(prepared)
        concluded = Outcome.OPEN if config.trials else Outcome.THRESHOLD
        state = replace(
            state, lines=prepared, trials=((),) * count, failures=(0,) * count, outcomes=(concluded,) * count
        )
    prepared_lines = state.lines or ()
    rows: list[FloatArray] = []
    jobs: list[int] = []
    for index, outcome in enumerate(state.outcomes):
        if outcome is Outcome.OPEN and index not in state.jobs and len(rows) < size:
            state, places = _places(state, index)
            line = prepared_lines[index].line
            some = [line.end if (row := line.at(place)) is None else row for place in places]
            rows += some[: size - len(rows)]
            jobs += [index] * (len(rows) - len(jobs))
    return replace(state, ledger=ledger.plan(rows), jobs=(*state.jobs, *jobs))


def _places(state: SharpenState, index: int) -> tuple[SharpenState, list[float]]:
    """Return the next places of a line, and the state with its estimate."""
    state = _estimated(state, index)
    assert state.lines is not None
    told = len(state.trials[index])
    asked = told + state.failures[index]
    rng = generator(state.ledger.seed, Stream.THRESHOLDS, _PLACES, index, asked)
    count = min(BATCH if asked else FIRST_BATCH, state.config.trials - told)
    return state, next_places(state.lines[index].prior, state.estimates[index], count, rng)


def _estimated(state: SharpenState, index: int) -> SharpenState:
    """Return the state with the estimate of a line."""
    assert state.lines is not None
    numbers = state.trials[index]
    known = state.estimates.get(index)
    if known is not None and known.trials == len(numbers):
        return state
    archive, prepared = state.ledger.archive, state.lines[index]
    places = np.searchsorted(archive.numbers, np.array(numbers, np.int64))
    trials = Trials(
        places=np.array([prepared.line.place_of(archive.vectors[place]) for place in places.tolist()]),
        unsafe=archive.unsafe[places],
    )
    rng = generator(state.ledger.seed, Stream.THRESHOLDS, _ESTIMATE, index, len(numbers))
    found = estimate(prepared.prior, trials, rng, most=state.config.trials)
    return replace(state, estimates={**state.estimates, index: found})


def _concluded(state: SharpenState, ready: Sequence[int]) -> SharpenState:
    """Return the state with the conclusions on lines whose simulations were told."""
    outcomes = list(state.outcomes)
    for index in ready:
        state = _estimated(state, index)
        outcomes[index] = state.estimates[index].outcome
        if outcomes[index] is Outcome.OPEN and state.failures[index] >= MAX_FAILURES:
            outcomes[index] = Outcome.CHANCY
    return replace(state, outcomes=tuple(outcomes))
