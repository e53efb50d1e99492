"""Where campaigns stand: how much is done, how fast it goes, how long it will take."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final, Protocol

from sqlalchemy import Connection

from brink.server.campaigns import view_store
from brink.server.campaigns.values import GenerationSummary
from brink.server.states import CampaignStatus, JobStatus

RATE_WINDOW: Final = 5
"""Generations over which the rate is taken."""


class Stands(Protocol):
    """What must be known of a campaign."""

    @property
    def id(self) -> str: ...  # noqa: D102  (see Campaign)
    @property
    def status(self) -> CampaignStatus: ...  # noqa: D102
    @property
    def generation(self) -> int: ...  # noqa: D102
    @property
    def told(self) -> int: ...  # noqa: D102
    @property
    def budget(self) -> int: ...  # noqa: D102
    @property
    def created_at(self) -> datetime: ...  # noqa: D102
    @property
    def finished_at(self) -> datetime | None: ...  # noqa: D102


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """Where a campaign stands.

    Attributes:
        done: Candidates of which all is known that was asked, those of the generation under way included.
        queued: Jobs that wait.
        leased: Jobs that workers have.
        quarantined: Jobs that were given up.
        rate_per_s: Candidates a second over the last generations, or since the start; None if none came.
        remaining_s: How long the rest of the budget takes at this rate.
        elapsed_s: Since it was submitted, until it ended.
    """

    done: int
    queued: int
    leased: int
    quarantined: int
    rate_per_s: float | None
    remaining_s: float | None
    elapsed_s: float


def read_standing(connection: Connection, campaign: Stands) -> Standing:
    """Return where a campaign stands."""
    jobs = view_store.count_open_jobs(connection, campaign.id)
    queued, leased = jobs.get(JobStatus.QUEUED, 0), jobs.get(JobStatus.LEASED, 0)
    ended = campaign.finished_at is not None
    asked = 0 if ended else view_store.count_pending(connection, campaign.id, campaign.generation)
    done = campaign.told + max(0, asked - queued - leased)
    latest = view_store.list_generations(
        connection, campaign.id, max(0, campaign.generation - RATE_WINDOW - 1)
    )
    end = campaign.finished_at or datetime.now(UTC)
    rate = _rate(campaign, latest, done, end)
    remaining = max(0, campaign.budget - done)
    return Standing(
        done=done, queued=queued, leased=leased, quarantined=jobs.get(JobStatus.QUARANTINED, 0),
        rate_per_s=rate, remaining_s=remaining / rate if rate and not ended else None,
        elapsed_s=max(0.0, (end - campaign.created_at).total_seconds()),
    )  # fmt: skip


def _rate(campaign: Stands, latest: Sequence[GenerationSummary], done: int, end: datetime) -> float | None:
    start, before = campaign.created_at, 0
    if campaign.status is CampaignStatus.RUNNING and len(latest) > RATE_WINDOW:
        base = latest[-RATE_WINDOW - 1]
        assert base.told_at is not None
        start, before = base.told_at, base.told
    elapsed = (end - start).total_seconds()
    return (done - before) / elapsed if elapsed > 0 and done > before else None
