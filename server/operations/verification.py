"""Verifies the stored verdicts of campaigns against the stored results of their jobs.

A verdict stands in the solution's row, and what it was made from in the job's: the specification of the episode with
its SHA-256, and the result. So an altered verdict, robustness, objective or specification is found by evaluating the
result again, and an altered result too, as far as it decides any of these. Features that decide nothing have no copy.
"""

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias

from sqlalchemy import Connection, Row, and_, func, select, true

from brink.search.algorithm import Evaluation, Measured, Scored
from brink.server.campaigns.plan import make_plan
from brink.server.campaigns.result_check import UNREADABLE, evaluate
from brink.server.campaigns.store import Campaign
from brink.server.db.models import CampaignRow, JobRow, SolutionRow
from brink.server.problems.base import InProcessProblem, SimulatedProblem
from brink.server.queue.job_store import IS_EVALUATION, JobSettings
from brink.server.states import JobKind, SolutionVerdict
from brink.worker.wire import Completed

NAMED: Final = 3
"""How many damaged solutions of a campaign are described."""
_ROWS_AT_ONCE: Final = 1_000

_Stored: TypeAlias = Row[*tuple[Any, ...]]

_ITS_JOB: Final = and_(
    JobRow.campaign_id == SolutionRow.campaign_id, JobRow.number == SolutionRow.number, IS_EVALUATION
)


@dataclass(slots=True)
class Verification:
    """The result of verifying a campaign.

    Attributes:
        verified: Number of solutions.
        late: Number of those that count as failed although their jobs, retried by hand, had a result later.
        damaged: Number of those that are damaged.
        words: What is wrong with the first of them.
    """

    verified: int = 0
    late: int = 0
    damaged: int = 0
    words: list[str] = field(default_factory=list)

    def note(self, words: str) -> None:
        """Count a damaged solution, and keep the description of the first few."""
        self.damaged += 1
        if len(self.words) < NAMED:
            self.words.append(words)

    def __str__(self) -> str:
        more = self.damaged - len(self.words)
        return "; ".join(self.words) + (f"; and {more} more" if more else "")


def verify_counts(connection: Connection, campaign: Campaign) -> str | None:
    """Return how a campaign's counts differ from its solutions, or None if they agree.

    Args:
        connection: Sees one snapshot.
        campaign: The campaign.
    """
    query = (
        select(SolutionRow.verdict, func.count())
        .where(SolutionRow.campaign_id == campaign.id, SolutionRow.generation < campaign.generation)
        .group_by(SolutionRow.verdict)
    )
    counts: Mapping[str, int] = {row[0]: row[1] for row in connection.execute(query)}
    unsafe = counts.get(SolutionVerdict.UNSAFE, 0)
    for what, counted, stored in (
        ("evaluated", counts.get(SolutionVerdict.SAFE, 0) + unsafe, campaign.evaluated),
        ("unsafe", unsafe, campaign.unsafe),
        ("failed", counts.get(SolutionVerdict.FAILED, 0), campaign.failed),
        ("measured", counts.get(SolutionVerdict.MEASURED, 0), campaign.measured),
    ):
        if counted != stored:
            return f"{stored} solutions {what}, but {counted} such rows"
    return None


def count_missing_jobs(
    connection: Connection, campaign_id: str | None = None
) -> Iterator[tuple[str, int, int]]:
    """Yield each campaign with solutions that have lost their jobs: its id, their number, and the first of them.

    Args:
        connection: Sees one snapshot.
        campaign_id: The only campaign to look at; None for all.
    """
    query = (
        select(SolutionRow.campaign_id, func.count(), func.min(SolutionRow.number))
        .join(CampaignRow, CampaignRow.id == SolutionRow.campaign_id)
        .where(CampaignRow.deleted_at.is_(None))
        .where(true() if campaign_id is None else SolutionRow.campaign_id == campaign_id)
        .where(SolutionRow.spec_hash.is_not(None), ~select(JobRow.id).where(_ITS_JOB).exists())
        .group_by(SolutionRow.campaign_id)
        .order_by(SolutionRow.campaign_id)
    )
    for row in connection.execute(query):
        yield row[0], row[1], row[2]


def verify_results(connection: Connection, campaign: Campaign, limit: int | None) -> Verification:
    """Verify the verdicts of a campaign's solutions, newest first.

    Args:
        connection: Sees one snapshot.
        campaign: The campaign.
        limit: Maximum number of solutions to verify; None for all.

    Raises:
        InvalidInput: Its problem or its algorithm cannot be made here.
    """
    problem = make_plan(campaign.body).problem
    done = Verification()
    if isinstance(problem, InProcessProblem):
        return done
    query = (
        select(
            SolutionRow.number,
            SolutionRow.verdict,
            SolutionRow.robustness,
            SolutionRow.objectives,
            SolutionRow.spec_hash,
            SolutionRow.failure,
            JobRow.kind,
            JobRow.spec,
            JobRow.spec_hash.label("job_hash"),
            JobRow.result,
            JobRow.max_attempts,
            JobRow.max_losses,
        )
        .join(JobRow, _ITS_JOB)
        .where(SolutionRow.campaign_id == campaign.id, SolutionRow.generation < campaign.generation)
        .order_by(SolutionRow.number.desc())
        .limit(limit)
    )
    streamed = {"stream_results": True, "yield_per": _ROWS_AT_ONCE}  # not of the connection, which may write
    with connection.execute(query, execution_options=streamed) as rows:
        for row in rows:
            done.verified += 1
            if _is_late(row, campaign.job_settings):
                done.late += 1
                continue
            wrong = _wrong(problem, row)
            if wrong is not None:
                done.note(f"solution {row.number}: {wrong}")
    return done


def _is_late(row: _Stored, settings: JobSettings) -> bool:
    """Return whether a solution counts as failed because its job had no result when its generation was completed.

    Earlier versions accepted a retry even then. Only a retry by hand raises the limits of a job.
    """
    retried = row.max_attempts > settings.max_attempts or row.max_losses > settings.max_losses
    failed = row.verdict == SolutionVerdict.FAILED and row.failure is not None
    return retried and failed and row.result is not None and _spec_matches(row)


def _spec_matches(row: _Stored) -> bool:
    digest = hashlib.sha256(row.spec.encode()).hexdigest()
    return bool(digest == row.job_hash == row.spec_hash)


def _wrong(problem: SimulatedProblem, row: _Stored) -> str | None:
    """Describe what is wrong with a solution; None if nothing is."""
    if not _spec_matches(row):
        return "the specification of its job does not match its hash"
    if row.result is None:
        return None if row.verdict == SolutionVerdict.FAILED else f"{row.verdict}, but its job has no result"
    try:
        again = evaluate(problem, JobKind(row.kind), Completed.model_validate_json(row.result))
    except UNREADABLE:
        again = None
    verdict = _verdict(again)
    if verdict != row.verdict:
        return f"{row.verdict}, but its result says {verdict}"
    if isinstance(again, Scored) and again.robustness != row.robustness:
        return f"robustness {row.robustness:g}, but its result says {again.robustness:g}"
    if isinstance(again, Scored | Measured) and dict(again.objectives) != (row.objectives or {}):
        return "its objectives differ from those of its result"
    return None


def _verdict(evaluation: Evaluation | None) -> SolutionVerdict:
    if isinstance(evaluation, Scored):
        return SolutionVerdict.UNSAFE if evaluation.unsafe else SolutionVerdict.SAFE
    return SolutionVerdict.MEASURED if isinstance(evaluation, Measured) else SolutionVerdict.FAILED
