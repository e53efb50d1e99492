"""Read-only SQL for views of campaigns: progress, series, solutions."""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from typing import Any, Final, NamedTuple, Protocol

from sqlalchemy import Connection, Row, Select, bindparam, func, select

from brink.server.campaigns.step_store import GenerationSummary
from brink.server.db.models import CampaignRow, GenerationRow, JobRow, SolutionRow
from brink.server.queue.job_store import (
    EVALUATIONS,
    IS_EVALUATION,
    MAX_NAMED,
    count_unfinished,
    first_line,
    is_told,
)
from brink.server.states import CampaignStatus, JobStatus, SolutionVerdict

RATE_WINDOW: Final = 5
"""Generations over which the rate of a running campaign is measured."""
LATEST_JOBS: Final = 2_000
"""Jobs, those with the highest numbers, among which a break is looked for."""
SHORTEST_BREAK_S: Final = 300.0
BREAK_IN_GAPS: Final = 5
"""A time without results is a break if it is this many times the next longest one: results may come in bursts."""

# Every open page runs this every few seconds, and SQLAlchemy takes longer to build it than the database to run it.
_VERSION = select(CampaignRow.sequence, CampaignRow.finished_at).where(
    CampaignRow.id == bindparam("campaign"), CampaignRow.deleted_at.is_(None)
)


class CampaignSummary(Protocol):
    """The attributes of a campaign from which its progress is computed; see `Campaign`."""

    @property
    def id(self) -> str: ...  # noqa: D102
    @property
    def status(self) -> CampaignStatus: ...  # noqa: D102
    @property
    def generation(self) -> int: ...  # noqa: D102
    @property
    def completed(self) -> int: ...  # noqa: D102
    @property
    def budget(self) -> int: ...  # noqa: D102
    @property
    def created_at(self) -> datetime: ...  # noqa: D102
    @property
    def finished_at(self) -> datetime | None: ...  # noqa: D102


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignProgress:
    """The progress of a campaign.

    Attributes:
        done: Completed candidates, including those of the current generation.
        queued: Queued jobs.
        leased: Leased jobs.
        quarantined: Jobs in quarantine.
        rate_per_s: Candidates per second over the last generations, or since the first one was simulated, without
            those from the cache. While the campaign runs, only what came after a break counts, as when it was paused
            for a night. None if there are none yet.
        cached: Candidates in the same time whose results came from the cache: no worker simulated them.
        remaining_s: Time for the rest of the budget at this rate; None while the campaign waits.
        elapsed_s: Time since the submission, or between submission and end.
    """

    done: int
    queued: int
    leased: int
    quarantined: int
    rate_per_s: float | None
    cached: int
    remaining_s: float | None
    elapsed_s: float


def read_campaign_progress(
    connection: Connection, campaign: CampaignSummary, *, workers: int
) -> CampaignProgress:
    """Return the progress of a campaign, with an estimate of the remaining time.

    Args:
        connection: Sees one snapshot.
        campaign: The campaign.
        workers: Number of live workers.
    """
    jobs = count_unfinished(connection, campaign.id)
    queued, leased = jobs.get(JobStatus.QUEUED, 0), jobs.get(JobStatus.LEASED, 0)
    ended = campaign.finished_at is not None
    pending = 0 if ended else count_in_flight(connection, campaign.id, campaign.generation)
    done = campaign.completed + max(0, pending - queued - leased)
    latest = list_generations(connection, campaign.id, max(0, campaign.generation - RATE_WINDOW - 1))
    end = campaign.finished_at or datetime.now(UTC)
    rate, cached = _rate(connection, campaign, latest, done, end)
    remaining = max(0, campaign.budget - done)
    waiting = campaign.status is not CampaignStatus.RUNNING or (queued > 0 and leased == 0 and workers == 0)
    return CampaignProgress(
        done=done,
        queued=queued,
        leased=leased,
        quarantined=jobs.get(JobStatus.QUARANTINED, 0),
        rate_per_s=rate,
        cached=cached,
        remaining_s=remaining / rate if rate and not waiting else None,
        elapsed_s=max(0.0, (end - campaign.created_at).total_seconds()),
    )


def _rate(
    connection: Connection,
    campaign: CampaignSummary,
    latest: Sequence[GenerationSummary],
    done: int,
    end: datetime,
) -> tuple[float | None, int]:
    """Return the simulated candidates per second, and how many others came from the cache in the same time."""
    running = campaign.status is CampaignStatus.RUNNING
    start, before, generation = campaign.created_at, 0, 0
    if running and len(latest) > RATE_WINDOW:
        base = latest[-RATE_WINDOW - 1]
        assert base.told_at is not None
        start, before, generation = base.told_at, base.completed, base.number + 1
    elif (first := _first_simulated(connection, campaign.id)) is not None:
        # Until then, the campaign may have waited for a worker.
        start, before = max(start, first), 1
    resumed = _latest_since_break(connection, campaign.id, end) if running else None
    if resumed is not None and resumed.at > start:
        start, simulated, cached = resumed
    else:
        cached = _count_cached(connection, campaign.id, generation)
        simulated = done - before - cached
    elapsed = (end - start).total_seconds()
    return (simulated / elapsed if elapsed > 0 and simulated > 0 else None), cached


class _SinceBreak(NamedTuple):
    """When the first simulation after a break ended, and how many results there are since, cached ones apart."""

    at: datetime
    simulated: int
    cached: int


def _latest_since_break(connection: Connection, campaign_id: str, end: datetime) -> _SinceBreak | None:
    """Return the results since the last break; None if there is none among the latest jobs."""
    query = (
        select(JobRow.finished_at, JobRow.attempt)
        .where(JobRow.campaign_id == campaign_id, IS_EVALUATION, JobRow.status == JobStatus.DONE)
        .order_by(JobRow.number.desc())
        .limit(LATEST_JOBS)
    )
    ended = connection.execute(query).all()
    times = sorted(row.finished_at for row in ended if row.attempt > 0)
    first = first_after_break(times, end)
    if first is None:
        return None
    at = [*times, end][first]
    cached = sum(row.attempt == 0 and row.finished_at > at for row in ended)
    return _SinceBreak(at, max(0, len(times) - first - 1), cached)


def first_after_break(times: Sequence[datetime], end: datetime) -> int | None:
    """Return the index of the first result after a break, by far the longest time without results.

    Args:
        times: When results came, ascending.
        end: Until when none has come since.

    Returns:
        The place; the number of times if none has come since the break; None if there was no break.
    """
    gaps_s = [(after - before).total_seconds() for before, after in itertools.pairwise([*times, end])]
    if not gaps_s:
        return None
    second_s, longest_s = sorted([0.0, *gaps_s])[-2:]
    if longest_s < max(SHORTEST_BREAK_S, BREAK_IN_GAPS * second_s):
        return None
    return gaps_s.index(longest_s) + 1


_NEVER_LEASED: Final = (IS_EVALUATION, JobRow.status == JobStatus.DONE, JobRow.attempt == 0)
"""Conditions on a job whose result came from another job: no worker has ever attempted it."""
FIRST_JOBS: Final = 100
"""Jobs among which the first simulated one is looked for: workers take them in the order of their numbers."""


def _first_simulated(connection: Connection, campaign_id: str) -> datetime | None:
    """Return when the first simulation of a campaign ended; None if none of its first jobs was simulated."""
    first = (
        select(JobRow.finished_at, JobRow.attempt, JobRow.status)
        .where(JobRow.campaign_id == campaign_id, IS_EVALUATION)
        .order_by(JobRow.number)
        .limit(FIRST_JOBS)
        .subquery()
    )
    query = select(func.min(first.c.finished_at)).where(first.c.attempt > 0, first.c.status == JobStatus.DONE)
    ended: datetime | None = connection.execute(query).scalar_one()
    return ended


def _count_cached(connection: Connection, campaign_id: str, generation: int) -> int:
    """Return the number of candidates from a generation on whose results came from the cache."""
    # By number, for which there is an index: a condition on the generation would read all jobs of the campaign.
    number = select(func.min(SolutionRow.number)).where(
        SolutionRow.campaign_id == campaign_id, SolutionRow.generation >= generation
    )
    since: int | None = connection.execute(number).scalar_one_or_none()
    if since is None:
        return 0
    query = select(func.count()).where(
        JobRow.campaign_id == campaign_id, JobRow.number >= since, *_NEVER_LEASED
    )
    return connection.execute(query).scalar_one()


class CampaignVersion(NamedTuple):
    """A version that changes whenever a campaign or its jobs change.

    Attributes:
        ended: Whether the campaign has ended; its jobs then no longer change.
        parts: The values that make up the version.
    """

    ended: bool
    parts: tuple[object, ...]


def read_version(connection: Connection, campaign_id: str) -> CampaignVersion | None:
    """Return the version of a campaign; None if there is no such campaign.

    Args:
        connection: Sees one snapshot.
        campaign_id: The full id.
    """
    row = connection.execute(_VERSION, {"campaign": campaign_id}).one_or_none()
    if row is None:
        return None
    ended = row.finished_at is not None
    jobs = () if ended else sorted(count_unfinished(connection, campaign_id).items())
    return CampaignVersion(ended, (campaign_id, row.sequence, *jobs))


def list_generations(connection: Connection, campaign_id: str, since: int) -> list[GenerationSummary]:
    """Return the completed generations from number `since` on."""
    query = (
        select(*(getattr(GenerationRow, one.name) for one in fields(GenerationSummary)))
        .where(GenerationRow.campaign_id == campaign_id, GenerationRow.number >= since)
        .order_by(GenerationRow.number)
    )
    return [GenerationSummary(**row) for row in connection.execute(query).mappings()]


def count_in_flight(connection: Connection, campaign_id: str, generation: int) -> int:
    """Return the number of solutions in flight: those of a generation and of later ones."""
    return connection.execute(
        select(func.count()).where(
            SolutionRow.campaign_id == campaign_id, SolutionRow.generation >= generation
        )
    ).scalar_one()


def read_failures(connection: Connection, campaign_id: str, generation: int) -> tuple[int, str]:
    """Return how many simulations of a generation and later ones have failed, and the first error of the campaign.

    Args:
        connection: Sees one snapshot.
        campaign_id: A campaign with quarantined jobs.
        generation: The generation.
    """
    its_jobs = (JobRow.campaign_id == campaign_id, JobRow.status == JobStatus.QUARANTINED, IS_EVALUATION)
    same = (SolutionRow.campaign_id == JobRow.campaign_id) & (SolutionRow.number == JobRow.number)
    failed = (
        select(func.count())
        .select_from(JobRow)
        .join(SolutionRow, same)
        .where(*its_jobs, SolutionRow.generation >= generation)
    )
    first = select(JobRow.last_error).where(*its_jobs).order_by(JobRow.number).limit(1)
    error: str | None = connection.execute(first).scalar_one_or_none()
    return connection.execute(failed).scalar_one(), first_line(error or "")


def count_origins(connection: Connection, campaign_id: str) -> dict[str, int]:
    """Return the number of solutions from each origin, most frequent first; empty if the algorithm names none."""
    query = (
        select(SolutionRow.origin, func.count())
        .where(SolutionRow.campaign_id == campaign_id, SolutionRow.origin.is_not(None))
        .group_by(SolutionRow.origin)
        .order_by(func.count().desc(), SolutionRow.origin)
    )
    return {str(row[0]): int(row[1]) for row in connection.execute(query)}


def read_solutions(
    connection: Connection, campaign_id: str, numbers: Iterable[int]
) -> list[Row[*tuple[Any, ...]]]:
    """Return solutions by number, ascending, each with the specification, result and attempts of its job."""
    wanted = sorted(numbers)
    rows: list[Row[*tuple[Any, ...]]] = []
    for start in range(0, len(wanted), MAX_NAMED):
        some = wanted[start : start + MAX_NAMED]
        rows += connection.execute(_solutions(campaign_id).where(SolutionRow.number.in_(some))).all()
    return rows


def read_results(
    connection: Connection, campaign_id: str, numbers: Iterable[int] | None = None
) -> dict[int, str | None]:
    """Return the stored results of simulated solutions of a campaign, as JSON, by number.

    Args:
        connection: Read connection.
        campaign_id: The campaign.
        numbers: Numbers of the solutions; None for all.
    """
    query = select(EVALUATIONS.c.number, EVALUATIONS.c.result).where(EVALUATIONS.c.campaign_id == campaign_id)
    if numbers is None:
        return {row.number: row.result for row in connection.execute(query)}
    wanted = sorted(numbers)
    results: dict[int, str | None] = {}
    for start in range(0, len(wanted), MAX_NAMED):
        some = query.where(EVALUATIONS.c.number.in_(wanted[start : start + MAX_NAMED]))
        results |= {row.number: row.result for row in connection.execute(some)}
    return results


def read_seeds(connection: Connection, campaign_id: str) -> dict[int, int]:
    """Return the episode seeds of all solutions of a campaign, by number."""
    query = select(SolutionRow.number, SolutionRow.seed).where(SolutionRow.campaign_id == campaign_id)
    return {row.number: row.seed for row in connection.execute(query)}


def read_episodes(connection: Connection, campaign_id: str) -> dict[int, tuple[int, str | None]]:
    """Return the episode seed and the digest of the episode of all solutions of a campaign, by number.

    A solution that was evaluated without an episode has no digest.
    """
    query = select(SolutionRow.number, SolutionRow.seed, SolutionRow.spec_hash).where(
        SolutionRow.campaign_id == campaign_id
    )
    return {row.number: (row.seed, row.spec_hash) for row in connection.execute(query)}


def read_measured(connection: Connection, campaign_id: str) -> list[tuple[bytes, Mapping[str, float]]]:
    """Return the vectors of the solutions that were measured on a data set, ascending, with their objectives."""
    query = (
        select(SolutionRow.vector, SolutionRow.objectives)
        .where(
            SolutionRow.campaign_id == campaign_id,
            SolutionRow.verdict == SolutionVerdict.MEASURED,
            is_told(campaign_id),
        )
        .order_by(SolutionRow.number)
    )
    return [(row.vector, row.objectives or {}) for row in connection.execute(query)]


def page_solutions(
    connection: Connection, campaign_id: str, *, after: int, limit: int, unsafe: bool | None
) -> list[Row[*tuple[Any, ...]]]:
    """Return one page of solutions, ascending by number, as `read_solutions` does.

    Args:
        connection: Sees one snapshot.
        campaign_id: The campaign.
        after: The last number of the previous page.
        limit: Maximum number of solutions.
        unsafe: Only unsafe or only safe solutions; None for all.
    """
    query = _solutions(campaign_id).where(SolutionRow.number > after).limit(limit)
    if unsafe is not None:
        wanted = SolutionVerdict.UNSAFE if unsafe else SolutionVerdict.SAFE
        query = query.where(SolutionRow.verdict == wanted, is_told(campaign_id))
    return list(connection.execute(query))


def _solutions(campaign_id: str) -> Select[*tuple[Any, ...]]:
    job = EVALUATIONS.c
    return (
        select(
            SolutionRow.number,
            SolutionRow.generation,
            SolutionRow.vector,
            SolutionRow.seed,
            SolutionRow.spec_hash,
            SolutionRow.verdict,
            SolutionRow.robustness,
            SolutionRow.objectives,
            SolutionRow.failure,
            SolutionRow.origin,
            job.spec,
            job.result,
            job.attempt,
            job.losses,
        )
        .outerjoin(
            EVALUATIONS, (job.campaign_id == SolutionRow.campaign_id) & (job.number == SolutionRow.number)
        )
        .where(SolutionRow.campaign_id == campaign_id)
        .order_by(SolutionRow.number)
    )
