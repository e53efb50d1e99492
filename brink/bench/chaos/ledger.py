"""What coordinators said of results, against what the database has in the end."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy import Connection, func, select

from brink.server.db.models import CampaignRow, JobRow, SolutionRow
from brink.server.states import JobKind, JobStatus, SolutionVerdict
from brink.worker.wire import Completed


@dataclass(slots=True)
class Ledger:
    """Every verdict that a coordinator said it took, whether or not the worker heard so.

    Attributes:
        taken: For each job the results that were answered `accepted`, as they are stored.
        statuses: How often each answer was given.
    """

    taken: dict[int, list[str]] = field(default_factory=dict)
    statuses: Counter[str] = field(default_factory=Counter)

    def note(self, request: bytes, reply: bytes) -> None:
        """Note the statuses of one report."""
        results: Sequence[Mapping[str, Any]] = json.loads(request)["results"]
        statuses: Sequence[Mapping[str, Any]] = json.loads(reply)["statuses"]
        for result, said in zip(results, statuses, strict=True):
            self.statuses[said["status"]] += 1
            if said["status"] == "accepted" and result["outcome"]["kind"] == "completed":
                stored = Completed.model_validate(result["outcome"]).model_dump_json(exclude={"trace"})
                self.taken.setdefault(result["job"], []).append(stored)


@dataclass(frozen=True, slots=True, kw_only=True)
class Findings:
    """What is wrong in the end; nothing, if all is well.

    Attributes:
        lost: Verdicts that were taken and are not stored, and solutions without one.
        doubled: Verdicts that were taken twice, campaigns that count more verdicts than their solutions have, and
            campaigns that are there twice.
        stuck: Jobs and campaigns that did not come to their end.
    """

    lost: tuple[str, ...] = ()
    doubled: tuple[str, ...] = ()
    stuck: tuple[str, ...] = ()


def audit(connection: Connection, ledger: Ledger, campaigns: Mapping[str, int]) -> Findings:
    """Compare what was said with what is stored.

    Args:
        connection: To the database, in which nobody writes any more.
        ledger: What coordinators said.
        campaigns: The simulations of each campaign that was submitted.
    """
    lost: list[str] = []
    doubled = [
        f"job {job}: taken {len(taken)} times" for job, taken in ledger.taken.items() if len(taken) > 1
    ]
    stuck: list[str] = []
    stored = {
        row.id: row
        for row in connection.execute(select(JobRow.id, JobRow.status, JobRow.result, JobRow.kind))
    }
    for job, taken in ledger.taken.items():
        row = stored.get(job)
        if row is None or row.status != JobStatus.DONE or row.result not in taken:
            lost.append(f"job {job}: taken, but it is {row.status if row is not None else 'gone'}")
    for row in stored.values():
        if row.status in (JobStatus.QUEUED, JobStatus.LEASED) and row.kind != JobKind.TRACE:
            stuck.append(f"job {row.id} is {row.status}")
        elif row.status != JobStatus.DONE and row.kind != JobKind.TRACE:
            lost.append(f"job {row.id} is {row.status}")
    told = connection.execute(select(CampaignRow.id, CampaignRow.status, CampaignRow.evaluated)).all()
    found = {row.id: row.status for row in told}
    counted = {row.id: row.evaluated for row in told}
    doubled += [f"campaign {campaign}: nobody submitted it" for campaign in found.keys() - campaigns.keys()]
    stuck += [
        f"campaign {campaign} is {status}" for campaign, status in found.items() if status != "finished"
    ]
    for campaign, simulations in campaigns.items():
        judged = connection.execute(
            select(func.count()).where(
                SolutionRow.campaign_id == campaign,
                SolutionRow.verdict.in_([SolutionVerdict.SAFE, SolutionVerdict.UNSAFE]),
            )
        ).scalar_one()
        if judged < simulations:
            lost.append(f"campaign {campaign}: {judged} verdicts of {simulations} simulations")
        if counted.get(campaign, 0) > judged:
            doubled.append(
                f"campaign {campaign}: counts {counted[campaign]} solutions, {judged} have a verdict"
            )
    return Findings(lost=tuple(lost), doubled=tuple(doubled), stuck=tuple(stuck))
