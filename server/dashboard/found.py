"""Short summaries of campaigns' findings for lists: of the first kind of finding.

A list of campaigns polls, and what a campaign found takes its whole archive. So words are computed once a campaign
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
from typing import Any, Final

from brink.server.campaigns.archives import Archives
from brink.server.campaigns.follow_ups.question import question_of
from brink.server.campaigns.plan import Plan, finds_of, make_plan
from brink.server.campaigns.store import CAMPAIGNS, Campaign
from brink.server.dashboard.overview import Outline
from brink.server.errors import InvalidInput, NotFound, TooCostly, Unavailable
from brink.server.findings.kind import Listed, kinds_of
from brink.server.findings.words import counted
from brink.server.read_threads import ReadThreads
from brink.server.states import ENDED

log = logging.getLogger(__name__)

KEPT: Final = 2_000
"""Maximum number of campaigns whose words are in memory."""
LIMIT_S: Final = 60.0
"""Time limit for what one campaign found."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """The short summary of a campaign's findings.

    Attributes:
        words: In a few words; empty if there is nothing to say.
        kind: Kind of the finding; empty if there is nothing to say.
    """

    words: str = ""
    kind: str = ""


@dataclass(slots=True)
class FoundWords:
    """A cache of short summaries of findings.

    Attributes:
        archives: Where campaigns are read.
    """

    archives: Archives
    _found: OrderedDict[str, tuple[object, Found]] = field(default_factory=OrderedDict)
    _kept: dict[str, Any] = field(default_factory=dict)
    _pending: set[str] = field(default_factory=set)
    _lock: RLock = field(default_factory=RLock)  # what is done at once is taken while it is held
    _thread: ReadThreads = field(
        default_factory=lambda: ReadThreads(1, "brink-found", limit_s=LIMIT_S, patient=True)
    )

    def of(self, outlines: Sequence[Outline]) -> Mapping[str, Found | None]:
        """Return the summaries of ended campaigns, without waiting for those being computed.

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
            log.warning("campaign %s: its finding takes too long to compute", one.id)
        elif error is not None and not isinstance(error, Unavailable):
            log.error("campaign %s: its finding cannot be computed", one.id, exc_info=error)
        with self._lock:
            self._pending.discard(one.id)
            if isinstance(error, Unavailable) and not isinstance(error, TooCostly):
                return  # now, but perhaps not later
            self._found[one.id] = _version(one), Found() if error is not None else work.result()
            while len(self._found) > KEPT:
                self._kept.pop(self._found.popitem(last=False)[0], None)

    def _work_out(self, one: Outline) -> Found:
        if one.kind is not None:  # a follow-up
            return Found(words=question_of(one.kind).brief(one.evaluated, one.unsafe))
        with self.archives.engines.reader.connect() as connection:
            campaign = CAMPAIGNS.find(connection, one.id)
        if campaign is None:
            return Found()  # it was deleted meanwhile
        try:
            return self._found_by(campaign, make_plan(campaign.body))
        except (InvalidInput, NotFound):  # a plug-in that is not installed here; or it was deleted
            return Found()

    def _found_by(self, campaign: Campaign, plan: Plan) -> Found:
        kind = next(iter(kinds_of(plan)))
        listed = Listed(archives=self.archives, campaign=campaign, plan=plan, kept=self._kept)
        return Found(words=kind.brief(listed), kind=kind.id)

    def close(self) -> None:
        """Stop the running computations, and cancel the rest."""
        self._thread.close()


def found_so_far(algorithm: str, boundary: Sequence[int]) -> Found:
    """Return the summary of a campaign that has not ended; only a search for the boundary has one at no cost.

    Args:
        algorithm: Id of its algorithm.
        boundary: Distinct boundary solutions so far, at some generations.
    """
    if not boundary or finds_of(algorithm)[:1] != ("boundary",):
        return Found()
    return Found(words=counted(boundary[-1], "boundary solution"), kind="boundary")


def _version(one: Outline) -> object:
    """Return a version that changes whenever the summary may change."""
    return one.sequence, one.follow_ups.sequence
