"""The thresholds in a campaign's archive: its lines, and how likely a violation is along each."""

from concurrent.futures import Executor
from dataclasses import InitVar, dataclass, field
from typing import Final

import numpy as np

from brink.search.analysis.lines import FEWEST_PLACES, Line, find_lines
from brink.search.archive import Archive
from brink.search.conclusions import Outcome
from brink.search.deadline import check_time
from brink.search.space import BoolArray, FloatArray, IntArray
from brink.search.streams import Stream, episode_seed, generator
from brink.search.thresholds import CONFIDENCE, FEWEST, HIGH, MOST, CurvePrior, Estimate, Trials, estimate
from brink.server.campaigns import view_store
from brink.server.campaigns.archives import CACHED, ReadArchive
from brink.server.campaigns.plan import Plan
from brink.server.campaigns.store import Campaign
from brink.server.db.engine import Engines
from brink.server.errors import NotFound
from brink.server.single_flight import SingleFlightCache
from brink.server.states import ENDED

MOST_PENDING: Final = 4
"""Maximum number of archives whose lines are estimated at a time, queued ones included; each takes a while."""
MOST_LINES: Final = 200
"""Maximum number of lines of an archive that are estimated, those with most simulations first."""
_SHARP: Final = 2.0
"""Widest bracket of a threshold without chance, in resolutions."""
_GRID: Final = 25
_NEAR: Final = 41
"""Places of a curve: along the whole line, and further ones near its threshold."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shares:
    """How likely a violation is along a line; arrays have the shape ``(g,)``.

    Attributes:
        values: Values of the line's leading number, from its safe end on.
        median: Posterior median of the probability.
        low: Lower end of its 90% interval.
        high: Upper end of it.
    """

    values: FloatArray
    median: FloatArray
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Threshold:
    """A line and where it turns; values are those of the line's leading number.

    Attributes:
        line: The line.
        outcome: Whether it has a threshold.
        middle: Value with a probability of 50%; infinite if it is probably beyond the line.
        low: End of its 90% interval nearer to the safe end; infinite beyond the line.
        high: The other end.
        start: Value with a probability of 20%; infinite beyond the line.
        end: Value with a probability of 80%.
        end_interval: 90% interval of `end`, from the safe end on.
        stretch: Distance between these two; infinite if one is beyond the line.
        resolution: Resolution of the leading number.
        states_resolution: Whether the problem states it.
        range: Range of the leading number.
        chancy: Probability that there is no threshold.
        drives: Number of simulations that it rests on, each with a seed of its own.
        shares: The curve.
        safe_again: Value from which drives beyond the threshold are safe again; None if none are.
    """

    line: Line
    outcome: Outcome
    middle: float
    low: float
    high: float
    start: float
    end: float
    end_interval: tuple[float, float]
    stretch: float
    resolution: float
    states_resolution: bool
    range: float
    chancy: float
    drives: int
    shares: Shares
    safe_again: float | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CampaignThresholds:
    """The lines of a campaign's archive that were estimated.

    Attributes:
        all: Those with a threshold first, narrowest stretches first; then open ones, then chancy ones.
        left_out: Lines that were not estimated, because there are too many.
    """

    all: tuple[Threshold, ...]
    left_out: int

    def of(self, outcome: Outcome) -> list[Threshold]:
        """Return the lines with an outcome."""
        return [one for one in self.all if one.outcome is outcome]


def find_thresholds(
    archive: Archive, plan: Plan, own: BoolArray, seed: int, *, ended: bool
) -> CampaignThresholds:
    """Estimate the lines of an archive.

    Args:
        archive: Simulated solutions.
        plan: The plan of their campaign.
        own: Whether each had an episode seed of its own, shape ``(n,)``.
        seed: The campaign's seed.
        ended: Whether no more simulations will come, so that lines with enough of them are concluded on.
    """
    if plan.problem.ignores_seeds:
        lines = find_lines(archive, plan.problem.space, own, fewest=FEWEST_PLACES)
        bisected = [_bisected(archive, plan, part) for line in lines[:MOST_LINES] for part in line.parts()]
        found = [one for one in bisected if one.stretch <= _SHARP * one.resolution]
    else:
        lines = find_lines(archive, plan.problem.space, own)
        most = sorted(range(len(lines)), key=lambda place: (-int(lines[place].own.sum()), place))[:MOST_LINES]
        found = [_estimated(archive, plan, lines[place], seed, ended=ended) for place in sorted(most)]
    order = (Outcome.THRESHOLD, Outcome.OPEN, Outcome.CHANCY)
    found.sort(key=lambda one: (order.index(one.outcome), one.stretch / one.range))
    return CampaignThresholds(all=tuple(found), left_out=max(0, len(lines) - MOST_LINES))


def own_seeds(seeds: IntArray, numbers: IntArray, seed: int) -> BoolArray:
    """Return which solutions had an episode seed that no other one shares, shape ``(n,)``.

    A solution whose seed others share was chosen for its verdict, so it does not count as a draw.

    Args:
        seeds: Episode seeds, shape ``(n,)``.
        numbers: Numbers of the solutions, shape ``(n,)``.
        seed: The campaign's seed.
    """
    _, which, counts = np.unique(seeds, return_inverse=True, return_counts=True)
    given = np.array([episode_seed(seed, number) for number in numbers.tolist()], np.int64)
    return np.asarray((seeds == given) & (counts[which.reshape(-1)] == 1))


def _estimated(archive: Archive, plan: Plan, line: Line, seed: int, *, ended: bool) -> Threshold:
    check_time()
    space, row = plan.problem.space, archive.vectors[int(line.places[-1])]
    resolutions, stated = space.resolutions(row)
    resolution, width = float(resolutions[line.leading]), float(space.ranges[line.leading])
    back = line.turns_back()
    sign, (first, last) = 1.0 if line.rises else -1.0, line.ends
    within = line.own if back is None else line.own & (sign * line.values < sign * back)
    if back is not None:
        last = float(sign * (sign * line.values[within]).max())
    length = last - first
    safe, unsafe = ((value - first) / length for value in line.bracket())
    prior = CurvePrior(
        safe=safe if unsafe <= 1.0 else 0.0,
        unsafe=unsafe if unsafe <= 1.0 else 1.0,
        resolution=resolution / abs(length),
        range=width / abs(length),
    )
    trials = Trials(places=(line.values[within] - first) / length, unsafe=line.unsafe[within])
    rng = generator(seed, Stream.THRESHOLDS, int(archive.numbers[line.places].min()), *line.unit)
    most = min(MOST, max(FEWEST, len(trials))) if ended else MOST
    found = estimate(prior, trials, rng, most=most)

    tail = 0.5 * (1.0 - CONFIDENCE)
    (reached,) = prior.crossings(found.draws, (HIGH,))
    ends = np.quantile(reached, [tail, 1.0 - tail], method="inverted_cdf").tolist()

    def value(place: float) -> float:
        return first + place * length if np.isfinite(place) else place * sign

    return Threshold(
        line=line,
        outcome=found.outcome,
        middle=value(found.middle),
        low=value(found.low),
        high=value(found.high),
        start=value(found.start),
        end=value(found.end),
        end_interval=(value(ends[0]), value(ends[1])),
        stretch=found.stretch * abs(length),
        resolution=resolution,
        states_resolution=bool(stated[line.leading]),
        range=width,
        chancy=found.chancy,
        drives=len(trials),
        shares=_shares(prior, found, first, length),
        safe_again=back,
    )


def _bisected(archive: Archive, plan: Plan, line: Line) -> Threshold:
    """Return where a line with one turn turns if chance has no part in verdicts: between two of its solutions."""
    check_time()
    space, row = plan.problem.space, archive.vectors[int(line.places[-1])]
    resolutions, stated = space.resolutions(row)
    step = 1 if line.rises else -1
    values, unsafe = line.values[::step], line.unsafe[::step]
    turn = int(np.argmax(unsafe))
    safe, violating = float(values[turn - 1]), float(values[turn])
    shares = np.array([0.0, 0.0, 1.0, 1.0])
    return Threshold(
        line=line,
        outcome=Outcome.THRESHOLD,
        middle=0.5 * (safe + violating),
        low=safe,
        high=violating,
        start=safe,
        end=violating,
        end_interval=(safe, violating),
        stretch=abs(violating - safe),
        resolution=float(resolutions[line.leading]),
        states_resolution=bool(stated[line.leading]),
        range=float(space.ranges[line.leading]),
        chancy=0.0,
        drives=len(line.values),
        shares=Shares(
            values=np.array([values[0], safe, violating, values[-1]]), median=shares, low=shares, high=shares
        ),
        safe_again=line.safe_beyond,
    )


def _shares(prior: CurvePrior, found: Estimate, first: float, length: float) -> Shares:
    places = np.linspace(0.0, 1.0, _GRID)
    if np.isfinite(found.stretch):  # denser where it rises
        near = np.linspace(found.start - 2.0 * found.stretch, found.end + 2.0 * found.stretch, _NEAR)
        places = np.unique(np.clip(np.concatenate([places, near]), 0.0, 1.0))
    curves = prior.shares(found.draws, places)
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, median, high = np.quantile(curves, [tail, 0.5, 1.0 - tail], axis=0)
    return Shares(values=first + places * length, median=median, low=low, high=high)


def find_stored_thresholds(
    engines: Engines, campaign: Campaign, plan: Plan, archive: Archive
) -> CampaignThresholds:
    """Estimate the lines of a campaign, with the episode seeds of its simulations.

    Args:
        engines: The database.
        campaign: The campaign.
        plan: Its plan.
        archive: Its archive.

    Raises:
        NotFound: The campaign was deleted after its archive had been read.
    """
    with engines.reader.connect() as connection:
        seeds = view_store.read_seeds(connection, campaign.id)
    numbers = archive.numbers.tolist()
    if not seeds.keys() >= set(numbers):
        raise NotFound(f"campaign {campaign.id}: no such campaign")
    stored = np.array([seeds[number] for number in numbers], np.int64)
    own = np.ones(len(numbers), np.bool_)
    if not plan.problem.ignores_seeds:
        own = own_seeds(stored, archive.numbers, campaign.body.seed)
    ended = campaign.status in ENDED
    return find_thresholds(archive, plan, own, campaign.body.seed, ended=ended)


@dataclass(slots=True)
class Thresholds:
    """A cache of the thresholds of campaigns.

    Attributes:
        engines: The database.
        threads: Where thresholds are estimated, so that other requests do not wait.
    """

    engines: Engines
    threads: InitVar[Executor]
    _cache: SingleFlightCache[CampaignThresholds] = field(init=False)

    def __post_init__(self, threads: Executor) -> None:
        self._cache = SingleFlightCache(CACHED, threads, MOST_PENDING)

    async def get(self, campaign: Campaign, read: ReadArchive) -> CampaignThresholds:
        """Return the thresholds of a campaign.

        Args:
            campaign: The campaign.
            read: Its archive.

        Raises:
            NotFound: The campaign was deleted meanwhile.
            Unavailable: Too many archives are being worked on.
        """
        return await self._cache.get(
            (campaign.id, campaign.status in ENDED),
            read.generation,
            lambda: find_stored_thresholds(self.engines, campaign, read.plan, read.archive),
        )
