"""Decides which worker gets which jobs. Contains no SQL: it sees the queue through `QueueView` and changes nothing.

- Traces come first, because someone is waiting for a replay. Evaluations are taken from the running campaigns by
  priority, then in turns.
- A turn is a number of jobs for each live worker. If campaigns took turns job by job, their generations would end
  together, and workers would wait for the last jobs of all of them.
- A worker gets at most two thirds of an equal share of the queue. Grants are large at first and single jobs at
  the end, so that a generation's last jobs spread over all workers. Half of a share would take a fifth more requests
  and gain nothing; a full share lets the slowest worker hold up the others.
- A job that was tried before is granted alone, to a worker that holds nothing else: if it kills its worker, no other
  job is lost with it. It is not granted to the worker that failed it last while another one can run it.
- A due retry goes before fresh jobs (never attempted) of the same and of lower priorities. Workers fetch ahead and
  would hardly ever be idle, so a worker that could take the retry but holds jobs gets no fresh ones: soon one of them
  holds none.
- Of identical simulations that share results, one runs at a time.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol

from brink.server.states import JobKind

TURN: Final = 4
"""Jobs for each live worker that a campaign hands out in one turn."""
NEW_TURN: Final = 2**62
"""Turns from this number on are new, and come after all turns in the database."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LeaseTerms:
    """The terms on which leases are granted.

    Attributes:
        lease_s: How long a lease lasts.
        retry_backoff_s: Delay before the first retry; doubles with each attempt.
        live_workers: Number of workers that share the queue, at least 1.
        elsewhere: Capabilities that other live workers offer.
    """

    lease_s: float
    retry_backoff_s: float
    live_workers: int
    elsewhere: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True, kw_only=True)
class LeaseDemand:
    """A worker's request for jobs.

    Attributes:
        worker: Id of the worker.
        capabilities: What the worker can run.
        max_jobs: Maximum number of jobs.
        terms: The terms for this worker.
    """

    worker: str
    capabilities: tuple[str, ...]
    max_jobs: int
    terms: LeaseTerms


class QueuedJob(Protocol):
    """The fields of a queued job that the policy reads."""

    id: int
    campaign_id: str
    kind: str
    spec_hash: str
    cache: bool


class Retry(QueuedJob, Protocol):
    """A queued job that was tried before.

    Attributes:
        priority: Priority of its campaign.
    """

    priority: int


@dataclass(frozen=True, slots=True)
class CampaignTurn:
    """A running campaign's place in the order of service.

    Attributes:
        turn: Campaigns of one priority are served in ascending order of their turns.
        served: Jobs handed out in this turn.
        generation_end: First number of its candidates after the current generation; None if there is only that one.
    """

    campaign: str
    priority: int
    turn: int
    served: int
    generation_end: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Backlog:
    """A summary of the queue.

    Attributes:
        jobs: Evaluations of running campaigns, counted up to `enough_jobs`.
        traces: Whether traces are queued that one of the workers can record.
        retries: Whether retries are due that one of the workers can run.
    """

    jobs: int
    traces: bool
    retries: bool


class QueueView(Protocol):
    """Reads the queue, within one transaction."""

    def first_retry(self, demand: LeaseDemand) -> Retry | None:
        """Return the due retry that a worker should run first, or None."""

    def has_trace(self, capabilities: tuple[str, ...]) -> bool:
        """Return whether a fresh trace is queued."""

    def top_priority(self, capabilities: tuple[str, ...]) -> int | None:
        """Return the highest priority of the running campaigns with fresh jobs; None if there are none."""

    def lock_retry(self, demand: LeaseDemand) -> Sequence[QueuedJob]:
        """Lock and return the first retry; nothing if another coordinator is granting it."""

    def lock_traces(self, capabilities: tuple[str, ...], limit: int) -> Sequence[QueuedJob]:
        """Lock and return up to `limit` fresh traces."""

    def turns(self, capabilities: tuple[str, ...]) -> Sequence[CampaignTurn]:
        """Return the running campaigns with fresh jobs, in the order of service."""

    def lock_fresh(
        self, campaign: str, capabilities: tuple[str, ...], *, after: int, limit: int
    ) -> Sequence[QueuedJob]:
        """Lock and return up to `limit` fresh jobs of a campaign with ids above `after`, ascending by id."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Assignment:
    """The result of `assign_jobs`.

    Attributes:
        jobs: The jobs for each demand.
        turns: The new turn and served jobs of each campaign that was served; turns above `NEW_TURN` are new ones.
    """

    jobs: Sequence[Sequence[QueuedJob]]
    turns: Mapping[str, tuple[int, int]]


def assign_jobs(
    demands: Sequence[LeaseDemand], backlog: Backlog, held: Mapping[str, Sequence[int]], view: QueueView
) -> Assignment:
    """Assign jobs to workers, in the order of their demands.

    Args:
        demands: The demands; only one if retries or traces are queued.
        backlog: A summary of the queue.
        held: The attempt numbers of the jobs that each worker holds.
        view: The queue.
    """
    # Jobs read ahead are locked, and hidden from other coordinators: read no more than will be granted.
    ahead = sum(grant_limit(demand, backlog.jobs) for demand in demands[1:])
    dealer = _Dealer(view, ahead)
    granted: list[Sequence[QueuedJob]] = []
    for demand in demands:
        limit = grant_limit(demand, backlog.jobs - sum(map(len, granted)))
        jobs = _choose(demand, limit, backlog, held.get(demand.worker, ()), dealer, view)
        dealer.note_granted(jobs)
        granted.append(jobs)
    return Assignment(jobs=granted, turns=dealer.changed)


def enough_jobs(demand: LeaseDemand) -> int:
    """Return how many queued jobs are enough for the largest possible grant."""
    return demand.terms.live_workers * (demand.max_jobs + 1) * 3 // 2


def grant_limit(demand: LeaseDemand, queued: int) -> int:
    """Return the maximum size of a grant: two thirds of an equal share of the queued jobs, at least 1."""
    share = -(-2 * min(queued, enough_jobs(demand)) // (3 * demand.terms.live_workers))
    return min(demand.max_jobs, max(1, share))


def _choose(
    demand: LeaseDemand,
    limit: int,
    backlog: Backlog,
    attempts: Sequence[int],
    dealer: "_Dealer",
    view: QueueView,
) -> Sequence[QueuedJob]:
    """Return the jobs for one worker, which holds jobs with these attempt numbers."""
    if any(attempt > 1 for attempt in attempts):
        return []
    if backlog.retries:
        retry = view.first_retry(demand)
        if retry is not None and _retry_goes_first(retry, demand, backlog, view):
            if attempts:
                return []
            if jobs := view.lock_retry(demand):
                return jobs
    traces = view.lock_traces(demand.capabilities, limit) if backlog.traces else ()
    fresh = dealer.deal(demand.capabilities, limit - len(traces), demand.terms.live_workers)
    return _without_twins([*traces, *fresh])


def _retry_goes_first(retry: Retry, demand: LeaseDemand, backlog: Backlog, view: QueueView) -> bool:
    """Return whether a retry goes before all fresh jobs that the worker could have."""
    if retry.kind == JobKind.TRACE:
        return True
    if backlog.traces and view.has_trace(demand.capabilities):
        return False
    best = view.top_priority(demand.capabilities)
    return best is None or retry.priority >= best


def _without_twins(jobs: Iterable[QueuedJob]) -> list[QueuedJob]:
    """Keep one job of each simulation: the others will take over its result."""
    seen: set[str] = set()
    kept = []
    for job in jobs:
        if job.cache and job.spec_hash in seen:
            continue
        seen.add(job.spec_hash)
        kept.append(job)
    return kept


@dataclass(slots=True)
class _Line:
    """A campaign's fresh jobs for the given capabilities, in ascending order of id, loaded lazily."""

    campaign: str
    priority: int
    jobs: list[QueuedJob] = field(default_factory=list)
    last: int = -1
    ended: bool = False

    @property
    def is_unread(self) -> bool:
        """Whether no job has been read yet. At least one exists, since the campaign is listed."""
        return self.last < 0 and not self.ended


class _Dealer:
    """Deals fresh jobs to one worker after another, as if each had asked alone.

    Args:
        view: The queue.
        ahead: How many jobs the workers after the first may get in total.

    Attributes:
        changed: The new turn and served jobs of each campaign that was served.
    """

    def __init__(self, view: QueueView, ahead: int) -> None:
        self._view = view
        self._ahead = ahead
        self._lines: dict[tuple[str, ...], list[_Line]] = {}
        self._granted: set[int] = set()
        self._running: set[tuple[str, str]] = set()
        self._turns: dict[str, tuple[int, int]] = {}
        self._turns_ended = 0
        self.changed: dict[str, tuple[int, int]] = {}

    def deal(self, capabilities: tuple[str, ...], limit: int, live_workers: int) -> list[QueuedJob]:
        """Return up to `limit` fresh jobs, from the running campaigns by priority, then in turns."""
        if limit <= 0:  # traces were enough
            return []
        lines = [
            line
            for line in self._campaigns(capabilities)
            if line.is_unread or self._first(line, 1, capabilities)
        ]
        lines.sort(key=lambda line: (-line.priority, self._turns[line.campaign][0], line.campaign))
        jobs: list[QueuedJob] = []
        for line in lines:
            more = self._first(line, limit - len(jobs), capabilities, ahead=self._ahead)
            if not more:
                continue
            jobs += more
            turn, served = self._turns[line.campaign]
            served += len(more)
            if served >= TURN * live_workers:
                self._turns_ended += 1
                turn, served = NEW_TURN + self._turns_ended, 0
            self._turns[line.campaign] = self.changed[line.campaign] = (turn, served)
            if len(jobs) == limit:
                break
        return jobs

    def note_granted(self, jobs: Sequence[QueuedJob]) -> None:
        """Withhold granted jobs, and jobs with an identical simulation, from the other workers."""
        self._granted |= {job.id for job in jobs}
        self._running |= {(job.spec_hash, job.kind) for job in jobs}

    def _campaigns(self, capabilities: tuple[str, ...]) -> list[_Line]:
        if capabilities not in self._lines:
            found = self._view.turns(capabilities)
            self._lines[capabilities] = [_Line(one.campaign, one.priority) for one in found]
            for one in found:
                self._turns.setdefault(one.campaign, (one.turn, one.served))
        return self._lines[capabilities]

    def _first(
        self, line: _Line, count: int, capabilities: tuple[str, ...], *, ahead: int = 0
    ) -> list[QueuedJob]:
        """Return the first available jobs of a campaign, without removing them."""
        line.jobs = [job for job in line.jobs if self._is_available(job)]
        while len(line.jobs) < count and not line.ended:
            limit = count - len(line.jobs) + ahead
            more = self._view.lock_fresh(line.campaign, capabilities, after=line.last, limit=limit)
            line.ended = len(more) < limit
            line.last = more[-1].id if more else line.last
            line.jobs += [job for job in more if self._is_available(job)]
        return line.jobs[:count]

    def _is_available(self, job: QueuedJob) -> bool:
        return job.id not in self._granted and not (job.cache and (job.spec_hash, job.kind) in self._running)
