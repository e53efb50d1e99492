"""What each campaign found, in a few words for a list: pairs, violations, tolerances, combinations or a boundary.

A list of campaigns polls, and what a campaign found takes its whole archive. So words are worked out once a campaign
has ended, in a thread of their own, and kept until the campaign or one of its follow-ups changes. Until then a list
does without. Archives are read past the cache of archives, which holds those that people look at.
"""

import logging
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial
from threading import RLock
from typing import Final

from sqlalchemy import Connection, select

from brink.search.algorithms.tolerance import Layout, ToleranceConfig
from brink.search.analysis.avoidable import Avoidable
from brink.search.analysis.combinations import combinations, verdicts_by_chain
from brink.search.analysis.confirmation import Confirmation
from brink.search.analysis.violations import FoundViolation, by_type
from brink.search.errors import TooManyPairs, UnsupportedSpace
from brink.search.slots import slots_of
from brink.server.campaigns.archives import Archives
from brink.server.campaigns.pairs import PairSettings, Repeated, find_stored_pairs, searches_for_pairs
from brink.server.campaigns.plan import Plan, looks_for_boundary, make_plan
from brink.server.campaigns.repeats import SINGLE, read_follow_ups
from brink.server.campaigns.store import CAMPAIGNS, ENDED, Campaign
from brink.server.campaigns.violations import read_violations
from brink.server.dashboard.overview import Outline
from brink.server.db.models import GenerationRow
from brink.server.errors import InvalidInput, NotFound, TooCostly, Unavailable
from brink.server.problems.base import ReportsViolations
from brink.server.read_threads import ReadThreads

log = logging.getLogger(__name__)

KEPT: Final = 2_000
"""Maximum number of campaigns whose words are in memory."""
LIMIT_S: Final = 60.0
"""Time limit for what one campaign found."""
MOST_SOLUTIONS: Final = 20_000
"""Largest archive that is searched for pairs or combinations for a list; a campaign's page has those of others."""

Sides = tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """What a campaign found.

    Attributes:
        words: In a few words; empty if there is nothing to say.
        about_boundary: Whether these are about boundary solutions.
    """

    words: str = ""
    about_boundary: bool = False


@dataclass(slots=True)
class FoundWords:
    """A cache of what campaigns found, in a few words each.

    Attributes:
        archives: Where campaigns are read.
    """

    archives: Archives
    _found: OrderedDict[str, tuple[object, Found]] = field(default_factory=OrderedDict)
    _pairs: OrderedDict[str, tuple[int, Sides | None]] = field(default_factory=OrderedDict)
    _pending: set[str] = field(default_factory=set)
    _lock: RLock = field(default_factory=RLock)  # what is done at once is taken while it is held
    _thread: ReadThreads = field(
        default_factory=lambda: ReadThreads(1, "brink-found", limit_s=LIMIT_S, patient=True)
    )

    def of(self, outlines: Sequence[Outline]) -> Mapping[str, Found | None]:
        """Return what each campaign found that has ended, without waiting for what is being worked out.

        Args:
            outlines: Any campaigns; those that have not ended are left out.

        Returns:
            By id: None where they are not known yet, earlier ones while something changes.
        """
        ended = [one for one in outlines if one.status in ENDED]
        with self._lock:
            for one in ended:
                if one.id in self._found:
                    self._found.move_to_end(one.id)
                if one.id not in self._pending and self._found.get(one.id, (None,))[0] != _version(one):
                    self._start(one)
            return {one.id: self._found[one.id][1] if one.id in self._found else None for one in ended}

    def _start(self, one: Outline) -> None:
        try:
            work = self._thread.submit(self._work_out, one)
        except Unavailable:
            return  # the line is full; whoever asks again later starts it
        self._pending.add(one.id)
        work.add_done_callback(partial(self._take, one))

    def _take(self, one: Outline, work: "Future[Found]") -> None:
        if work.cancelled():
            return
        error = work.exception()
        if isinstance(error, TooCostly):
            log.warning("campaign %s: what it found takes too long to tell", one.id)
        elif error is not None and not isinstance(error, Unavailable):
            log.error("campaign %s: what it found cannot be told", one.id, exc_info=error)
        with self._lock:
            self._pending.discard(one.id)
            if isinstance(error, Unavailable) and not isinstance(error, TooCostly):
                return  # now, but perhaps not later
            self._found[one.id] = _version(one), Found() if error is not None else work.result()
            while len(self._found) > KEPT:
                self._pairs.pop(self._found.popitem(last=False)[0], None)

    def _work_out(self, one: Outline) -> Found:
        if one.repeats_of is not None:
            return _found_by_follow_up(one)
        with self.archives.engines.reader.connect() as connection:
            campaign = CAMPAIGNS.find(connection, one.id)
        if campaign is None:
            return Found()  # it was deleted meanwhile
        try:
            return self._found_by(campaign, make_plan(campaign.body))
        except (InvalidInput, NotFound):  # a plug-in that is not installed here; or it was deleted
            return Found()

    def _found_by(self, campaign: Campaign, plan: Plan) -> Found:
        problem = plan.problem
        if searches_for_pairs(campaign.body.algorithm.id):
            return Found(words=self._pairs_words(campaign, plan))
        if isinstance(plan.config, ToleranceConfig):
            return Found(words=_plural(len(Layout(problem.space, plan.config).cells), "tolerance"))
        with self.archives.engines.reader.connect() as connection:
            if isinstance(problem, ReportsViolations):
                return Found(words=_violations_words(read_violations(connection, campaign.id, problem)))
            solutions = _boundary_solutions(connection, campaign.id)
        if (words := self._combinations_words(campaign, plan)) is not None:
            return Found(words=words)
        if looks_for_boundary(campaign.body.algorithm.id):
            return boundary_found(solutions)
        return Found(words=f"{campaign.unsafe:,} unsafe")

    def _pairs_words(self, campaign: Campaign, plan: Plan) -> str:
        pairs = self._sides(campaign, plan)
        if not pairs:
            return "" if pairs is None else "no pair"
        with self.archives.engines.reader.connect() as connection:
            repeated = Repeated.of(read_follow_ups(connection, campaign.id))
        states = [repeated.state(*sides) for sides in pairs]
        tried = sum(state not in (Confirmation.NOT_TRIED, Confirmation.PENDING) for state in states)
        confirmed = states.count(Confirmation.CONFIRMED)
        if not tried:
            return _plural(len(pairs), "pair")
        if tried == len(pairs):
            return f"{confirmed:,} of {_plural(tried, 'pair')} {'holds' if tried == 1 else 'hold'}"
        return f"{_plural(len(pairs), 'pair')}; {confirmed:,} of {tried:,} simulated again hold"

    def _sides(self, campaign: Campaign, plan: Plan) -> Sides | None:
        """Return the sides of the distinct pairs, found once; None if there are too many to tell."""
        with self._lock:
            known = self._pairs.get(campaign.id)
        if known is not None and known[0] == campaign.generation:
            return known[1]
        sides: Sides | None = None
        if campaign.evaluated <= MOST_SOLUTIONS:
            _, _, archive = self.archives.stored(campaign)
            try:
                found = find_stored_pairs(
                    self.archives.engines, campaign.id, plan, archive, PairSettings.of(plan)
                )
                sides = tuple((pair.safe.number, pair.unsafe.number) for pair in found.pairs)
            except TooManyPairs:
                pass
        with self._lock:
            self._pairs[campaign.id] = campaign.generation, sides
        return sides

    def _combinations_words(self, campaign: Campaign, plan: Plan) -> str | None:
        """Return how many chains of techniques are hazardous; None if the problem has no techniques."""
        try:
            slots_of(plan.problem.space)
        except UnsupportedSpace:
            return None
        if campaign.evaluated > MOST_SOLUTIONS:
            return ""
        _, _, archive = self.archives.stored(campaign)
        chains = combinations(verdicts_by_chain(plan.problem.space, archive))
        hazardous, together = sum(one.hazardous for one in chains), sum(one.only_together for one in chains)
        return _plural(hazardous, "hazardous chain") + (f", {together} only together" if together else "")

    def close(self) -> None:
        """End what is being worked out, and cancel the rest."""
        self._thread.close()


def found_so_far(algorithm: str, boundary: Sequence[int]) -> Found:
    """Return what a campaign that has not ended found, which only a search for the boundary tells at no cost.

    Args:
        algorithm: Id of its algorithm.
        boundary: Distinct boundary solutions so far, at some generations.
    """
    if not boundary or not looks_for_boundary(algorithm) or searches_for_pairs(algorithm):
        return Found()
    return boundary_found(boundary[-1])


def boundary_found(solutions: int) -> Found:
    """Return a number of distinct boundary solutions in words."""
    return Found(words=_plural(solutions, "boundary solution"), about_boundary=True)


def _version(one: Outline) -> object:
    """Return what changes whenever the words may change."""
    return one.sequence, one.follow_ups.sequence


def _found_by_follow_up(one: Outline) -> Found:
    """Return what a follow-up showed; nothing for those whose answers the campaign that they belong to tells."""
    if one.repeats != SINGLE:
        return Found()
    return Found(words=f"{one.evaluated - one.unsafe:,} of {one.evaluated:,} safe with ground truth")


def _boundary_solutions(connection: Connection, campaign_id: str) -> int:
    """Return the number of distinct boundary solutions at the default thresholds, as of the last generation."""
    row = GenerationRow
    query = select(row.dbs).where(row.campaign_id == campaign_id).order_by(row.number.desc()).limit(1)
    return connection.execute(query).scalar() or 0


def _violations_words(found: Sequence[FoundViolation]) -> str:
    """Return how many types of violations there are, and how many of them a careful driver would have avoided."""
    types = by_type(found)
    if not types:
        return "no violation"
    told = _plural(len(types), "type of violations", "types of violations")
    kinds = [one.avoidable for one in types]
    if not any(kinds):
        return told
    return f"{kinds.count(Avoidable.CAREFUL) or 'none'} of {told} avoidable"


def _plural(count: int, noun: str, nouns: str = "") -> str:
    if not count:
        return f"no {noun}"
    return f"{count:,} {noun if count == 1 else nouns or f'{noun}s'}"
