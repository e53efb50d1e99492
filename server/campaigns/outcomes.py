"""The outcomes of a campaign's simulations for all recorded requirements, read from their results.

The archive knows one verdict for each solution, safe or unsafe, which is about the requirements of the campaign. The
stored results have the robustness of every requirement and the moment of its first violation. Texts for people are
made from these, so that no solution that violates any requirement is shown as safe without saying so.
"""

import json
from collections import Counter, OrderedDict
from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import InitVar, dataclass, field
from typing import Any, Final, Self

import numpy as np
from sqlalchemy import Connection, select

from brink.search.archive import Archive
from brink.search.deadline import check_time
from brink.search.odd import odd_sentence
from brink.search.space import IntArray
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.body import CampaignBody
from brink.server.db.engine import Engines
from brink.server.db.models import SolutionRow
from brink.server.errors import InvalidInput
from brink.server.problems.base import Problem
from brink.server.problems.catalogue import make_problem
from brink.server.queue.job_store import EVALUATIONS
from brink.server.single_flight import SingleFlightCache
from brink.server.states import OutcomeKind, SolutionVerdict
from brink.sim.episode import Verdict
from brink.sim.verdict import EpisodeVerdict, drives_held, held_words, unsafe_words

CACHED: Final = 8
_ROWS_AT_ONCE: Final = 1_000


@dataclass(frozen=True, slots=True, kw_only=True)
class SolutionOutcome:
    """The outcome of one simulation.

    Attributes:
        kind: Which requirements it violated.
        episode: Its verdict on all requirements; None if they were not recorded.
        verdict: The campaign's verdict in words, which stands where no recorded requirement explains it.
    """

    kind: OutcomeKind
    episode: EpisodeVerdict | None
    verdict: str

    def words(self, *, times: bool = True) -> str:
        """Return the outcome in words, such as ``front gap held; hit a pedestrian at 12.8 s``.

        Without named requirements, for example for a formula, the words are ``safe`` or ``unsafe``.

        Args:
            times: Whether to add the moments of violations.
        """
        words = "" if self.episode is None else self.episode.words(times=times)
        if self.episode is not None and self.episode.deciding:
            return words
        return "; ".join(filter(None, (self.verdict, words)))


def deciding_requirements(body: CampaignBody) -> tuple[str, ...]:
    """Return the requirements that decide the verdicts of a campaign; none if unknown, or if its plug-in is gone."""
    try:
        problem = make_problem(body.problem.id, body.problem.params)
    except InvalidInput:
        return ()
    return problem.requirements


def outcome_of(
    problem: Problem, result: Mapping[str, Any] | None, *, safe: bool, robustness: float | None
) -> SolutionOutcome:
    """Return the outcome of one simulation.

    Args:
        problem: The problem of its campaign.
        result: The stored result of the simulation; None if there is none.
        safe: The campaign's verdict.
        robustness: The campaign's robustness.
    """
    verdicts = {
        name: Verdict(robustness=one["robustness"], unit=one["unit"], violated_at_s=one.get("violated_at_s"))
        for name, one in ((result or {}).get("verdicts") or {}).items()
    }
    if not verdicts:
        kind = OutcomeKind.HELD if safe else OutcomeKind.VIOLATED
        return SolutionOutcome(kind=kind, episode=None, verdict=_unrecorded(problem, safe=safe))
    deciding = _deciding(problem, verdicts, robustness)
    features = (result or {}).get("features") or {}
    episode = EpisodeVerdict.of(verdicts, features, deciding)
    if deciding and episode.unsafe == safe:  # the problem does not decide by the sign
        episode = EpisodeVerdict.of(verdicts, features, ())
    kind = OutcomeKind.VIOLATED if not safe else OutcomeKind.OTHER if episode.violated else OutcomeKind.HELD
    return SolutionOutcome(kind=kind, episode=episode, verdict="safe" if safe else "unsafe")


def _unrecorded(problem: Problem, *, safe: bool) -> str:
    """Return the campaign's verdict in words if a result has no requirements."""
    if not problem.requirements:
        return "safe" if safe else "unsafe"
    words = held_words(problem.requirements) if safe else unsafe_words(problem.requirements)
    return f"{words}; other requirements not recorded"


def _deciding(problem: Problem, verdicts: Mapping[str, Verdict], robustness: float | None) -> tuple[str, ...]:
    """Return the deciding requirements or, for a problem that does not name them, the one with its robustness."""
    if problem.requirements:
        return problem.requirements if all(name in verdicts for name in problem.requirements) else ()
    same = [name for name, verdict in verdicts.items() if verdict.robustness == robustness]
    return tuple(same[:1])


@dataclass(frozen=True, slots=True, kw_only=True)
class OutcomeGroup:
    """Simulations with the same outcome.

    Attributes:
        words: Their outcome in words, without moments.
        kind: Which requirements they violated.
        others: What they did that violated a requirement that does not decide, such as ``hit a pedestrian``.
    """

    words: str
    kind: OutcomeKind
    others: tuple[str, ...]

    @classmethod
    def of(cls, outcome: SolutionOutcome) -> Self:
        """Return the group of one simulation."""
        others = () if outcome.episode is None else tuple(one.words for one in outcome.episode.others)
        return cls(words=outcome.words(times=False), kind=outcome.kind, others=others)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CampaignOutcomes:
    """The outcomes of all evaluated solutions of a campaign.

    Attributes:
        requirements: Ids of the requirements that decide the verdict; empty if they are unknown or differ.
        numbers: Numbers of the solutions, in the order of the archive, shape ``(n,)``.
        groups: The different outcomes, in order of first appearance.
        which: Index of each solution's outcome in `groups`, shape ``(n,)``.
        recorded: Number of solutions whose result has the requirements.
        odd: What the outcomes hold for, in sentences; empty without an ODD.
    """

    requirements: tuple[str, ...]
    numbers: IntArray
    groups: tuple[OutcomeGroup, ...]
    which: IntArray
    recorded: int
    odd: str = ""

    @property
    def counts(self) -> IntArray:
        """Number of solutions in each group, shape ``(len(groups),)``."""
        return np.bincount(self.which, minlength=len(self.groups))

    def count(self, kind: OutcomeKind) -> int:
        """Return the number of solutions of a kind."""
        return sum(
            number
            for group, number in zip(self.groups, self.counts.tolist(), strict=True)
            if group.kind is kind
        )

    def kind_words(self, kind: OutcomeKind) -> str:
        """Return the phrase for solutions of a kind, such as ``front gap held``."""
        held, violated = "safe", "unsafe"
        if self.requirements:
            held, violated = held_words(self.requirements), unsafe_words(self.requirements)
        if kind is OutcomeKind.VIOLATED:
            return violated
        return held if kind is OutcomeKind.HELD else f"{held}, another requirement violated"

    def sentence(self) -> str:
        """Return a sentence: how many drives held the requirements, what else these violated, and the ODD.

        Empty if no requirements are known and there is no ODD.
        """
        return " ".join(filter(None, (self._counts_in_words(), self.odd)))

    def _counts_in_words(self) -> str:
        if not self.requirements:
            return ""
        held = self.count(OutcomeKind.HELD) + self.count(OutcomeKind.OTHER)
        sentence = f"{held:,} of {len(self.numbers):,} drives {drives_held(self.requirements)}"
        also: Counter[str] = Counter()
        for group, number in zip(self.groups, self.counts.tolist(), strict=True):
            if group.kind is OutcomeKind.OTHER:
                also.update(dict.fromkeys(group.others, number))
        if also:
            sentence += "; of these, " + ", ".join(
                f"{number:,} {words}" for words, number in also.most_common()
            )
        elif held:
            sentence += "; none of these violated another recorded requirement"
        missing = len(self.numbers) - self.recorded
        return sentence + (f"; not recorded for {missing:,}" if missing else "") + "."


@dataclass(slots=True)
class Outcomes:
    """A cache of the outcomes of campaigns; as a campaign grows, only new solutions are read.

    Attributes:
        engines: The database.
        threads: Where results are read, so that short queries do not wait.
    """

    engines: Engines
    threads: InitVar[Executor]
    _latest: SingleFlightCache[CampaignOutcomes] = field(init=False)
    _before: OrderedDict[str, CampaignOutcomes] = field(default_factory=OrderedDict)

    def __post_init__(self, threads: Executor) -> None:
        self._latest = SingleFlightCache(CACHED, threads)

    async def get(self, campaign: str, read: ReadArchive) -> CampaignOutcomes:
        """Return the outcomes of a campaign.

        Args:
            campaign: Id of the campaign.
            read: Its archive.
        """
        found = await self._latest.get(campaign, read.generation, lambda: self._load(campaign, read))
        self._before[campaign] = found
        self._before.move_to_end(campaign)
        while len(self._before) > CACHED:
            self._before.popitem(last=False)
        return found

    def _load(self, campaign: str, read: ReadArchive) -> CampaignOutcomes:
        known = self._before.get(campaign)
        with self.engines.reader.connect() as connection:
            return read_outcomes(connection, campaign, read.plan.problem, read.archive, known)


def read_outcomes(
    connection: Connection,
    campaign_id: str,
    problem: Problem,
    archive: Archive,
    known: CampaignOutcomes | None = None,
) -> CampaignOutcomes:
    """Return the outcomes of the solutions of an archive.

    Args:
        connection: Sees one snapshot.
        campaign_id: The campaign.
        problem: Its problem.
        archive: Its archive.
        known: Outcomes of an earlier state of the archive, which are not read again.
    """
    before = 0 if known is None else len(known.numbers)
    if known is None or not np.array_equal(known.numbers, archive.numbers[:before]):
        known, before = None, 0
    new = archive.numbers[before:]
    which = np.empty(len(archive), np.int64)
    groups: dict[OutcomeGroup, int] = {}
    deciding: set[tuple[str, ...]] = set()
    recorded = 0
    if known is not None:
        which[:before] = known.which
        groups = {group: place for place, group in enumerate(known.groups)}
        recorded = known.recorded
        deciding = {known.requirements} if recorded else set()
    outcomes = _read_new(connection, campaign_id, problem, new) if len(new) else {}
    for place, number in enumerate(new.tolist(), start=before):
        outcome = outcomes.get(number)
        if outcome is None:  # without a stored solution, the verdict is all that is known
            outcome = outcome_of(problem, None, safe=not archive.unsafe[place], robustness=None)
        if outcome.episode is not None:
            deciding.add(outcome.episode.deciding)
            recorded += 1
        which[place] = groups.setdefault(OutcomeGroup.of(outcome), len(groups))
    if problem.requirements:
        deciding = {problem.requirements}
    return CampaignOutcomes(
        requirements=next(iter(deciding)) if len(deciding) == 1 else (),
        numbers=archive.numbers,
        groups=tuple(groups),
        which=which,
        recorded=recorded,
        odd=odd_sentence(problem.space),
    )


def _read_new(
    connection: Connection, campaign_id: str, problem: Problem, new: IntArray
) -> dict[int, SolutionOutcome]:
    """Return the outcomes of stored solutions by number: at least of those in `new`."""
    job = EVALUATIONS.c
    query = (
        select(SolutionRow.number, SolutionRow.verdict, SolutionRow.robustness, job.result)
        .outerjoin(
            EVALUATIONS, (job.campaign_id == SolutionRow.campaign_id) & (job.number == SolutionRow.number)
        )
        .where(
            SolutionRow.campaign_id == campaign_id,
            SolutionRow.number >= int(new.min()),
            SolutionRow.verdict.in_((SolutionVerdict.SAFE, SolutionVerdict.UNSAFE)),
        )
    )
    with connection.execution_options(stream_results=True, yield_per=_ROWS_AT_ONCE).execute(query) as rows:
        outcomes = {}
        for row in rows:
            check_time()
            outcomes[row.number] = outcome_of(
                problem,
                json.loads(row.result) if row.result else None,
                safe=row.verdict == SolutionVerdict.SAFE,
                robustness=row.robustness,
            )
        return outcomes
