"""Faults put into the queue's SQL on purpose: the queue's model must notice each of them.

``python -m support.queue_faults`` in tests/ searches for a history that reveals each fault, and records it.
"""

import inspect
import json
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Final

from sqlalchemy.exc import IntegrityError

from brink.server.db.engine import Engines, open_engines
from brink.server.queue import job_store, lease_policy, lease_store, outages, report_store
from support.databases import sqlite_template
from support.queue_machine import QueueMachine, Step, replay, search

RECORDED: Final = Path(__file__).resolve().parents[1] / "data" / "queue_faults.json"
"""A history for each fault, by its name, that tells the queue with the fault from its model."""
HISTORIES: Final = 500
"""Histories that a search tries at most for one fault."""
RARE: Final = (
    "who comes second finds the same turn",
    "paused campaigns hand out retries",
    "priorities are ignored",
    "retries overtake work of a higher priority",
    "campaigns do not take turns",
    "turns begin anew with each grant",
    "a retry goes back to the worker that failed it",
    "equal simulations without a cache are dealt out to one",
    "who comes second sees the queue as it was",
    "a job that can never run is tried again",
    "a result is not shared",
    "a retry by hand has no attempts",
    "a retry by hand has no losses",
)
"""Faults that a search of so many histories reveals late, or by luck alone, so that their recorded histories have to
do. A search for one of these takes 5 to 60 seconds, for one of the others 1 to 4."""
NOTICED: Final = (AssertionError, IntegrityError)
"""What it raises when the model notices a fault; any other error means that the fault does not run."""


@dataclass(frozen=True)
class Fault:
    """A change to the source of a module.

    Attributes:
        module: The module.
        right: A piece of its source that occurs once, however it is laid out there.
        wrong: The piece that takes its place.
    """

    module: ModuleType
    right: str
    wrong: str


FAULTS = {
    "a leased job is granted again": Fault(
        lease_store,
        "_IS_QUEUED = JobRow.status == constant(JobStatus.QUEUED)",
        "_IS_QUEUED = JobRow.status != constant(JobStatus.DONE)",
    ),
    "jobs go to workers that cannot run them": Fault(
        lease_store, 'in_list(JobRow.needs, "capabilities"), _DUE,', "_DUE,"
    ),
    "backoffs are not waited for": Fault(
        lease_store, "or_(JobRow.not_before.is_(None), JobRow.not_before <= _NOW)", "JobRow.id.is_not(None)"
    ),
    "equal simulations run at once": Fault(lease_store, "~(JobRow.cache & _TWIN_RUNS),", ""),
    "equal simulations are granted together": Fault(
        lease_policy, "if job.cache and job.spec_hash in seen: continue", ""
    ),
    "equal simulations without a cache wait for each other": Fault(
        lease_store, "~(JobRow.cache & _TWIN_RUNS)", "~_TWIN_RUNS"
    ),
    "paused campaigns hand out work": Fault(
        lease_store, "_IS_RUNNING, exists( select(JobRow.id)", "exists( select(JobRow.id)"
    ),
    "paused campaigns hand out retries": Fault(
        lease_store, "or_(_IS_TRACE, _IS_RUNNING)", "or_(_IS_TRACE, CampaignRow.id.is_not(None))"
    ),
    "priorities are ignored": Fault(
        lease_store,
        ".order_by(CampaignRow.priority.desc(), CampaignRow.turn, CampaignRow.id)",
        ".order_by(CampaignRow.turn, CampaignRow.id)",
    ),
    "retries overtake work of a higher priority": Fault(
        lease_policy, "return best is None or retry.priority >= best", "return True"
    ),
    "campaigns do not take turns": Fault(
        lease_store, "statement = _END_TURN if turn > NEW_TURN else _SERVE", "statement = _SERVE"
    ),
    "turns begin anew with each grant": Fault(lease_store, "_write_turns(connection, assignment.turns)", ""),
    "a turn has no end": Fault(lease_policy, "if served >= TURN * live_workers:", "if live_workers == 0:"),
    "a turn is a grant": Fault(lease_policy, "if served >= TURN * live_workers:", "if live_workers > 0:"),
    "the end of the queue goes to one worker": Fault(
        lease_policy, "return min(demand.max_jobs, max(1, share))", "return demand.max_jobs"
    ),
    "attempts are not charged": Fault(lease_store, "attempt=JobRow.attempt + 1,", ""),
    "retries are granted in company": Fault(
        lease_store, "JobRow.not_before, JobRow.id).limit(1)", "JobRow.not_before, JobRow.id).limit(3)"
    ),
    "who holds a retry gets more": Fault(
        lease_policy, "if any(attempt > 1 for attempt in attempts): return []", ""
    ),
    "a retry goes to a worker that holds jobs": Fault(lease_policy, "if attempts: return []", ""),
    "a retry goes back to the worker that failed it": Fault(
        lease_store, 'JobRow.failed_worker != bindparam("worker"),', "JobRow.id.is_not(None),"
    ),
    "a job is dealt out twice": Fault(lease_policy, "job.id not in self._granted and not (", "not ("),
    "equal simulations are dealt out to two": Fault(
        lease_policy, "not (job.cache and (job.spec_hash, job.kind) in self._running)", "True"
    ),
    "equal simulations without a cache are dealt out to one": Fault(
        lease_policy, "not (job.cache and (job.spec_hash", "not ((job.spec_hash"
    ),
    "who comes second finds the same turn": Fault(
        lease_policy,
        "self._turns[line.campaign] = self.changed[line.campaign] = (turn, served)",
        "self.changed[line.campaign] = (turn, served)",
    ),
    "who comes second sees the queue as it was": Fault(
        lease_policy,
        "limit = grant_limit(demand, backlog.jobs - sum(map(len, granted)))",
        "limit = grant_limit(demand, backlog.jobs)",
    ),
    "a retry is dealt out with the rest": Fault(
        lease_store,
        "if len(demands) > 1 and (look.backlog.retries or look.backlog.traces):",
        "if look.backlog.traces:",
    ),
    "anybody renews a lease": Fault(
        lease_store, "secrets.compare_digest(row.lease_token, wanted[row.id])", "True"
    ),
    "anybody gives a lease back": Fault(
        lease_store,
        "JobRow.lease_token == held.token) .values( status",
        "JobRow.id.is_not(None)) .values( status",
    ),
    "a lease given back is charged": Fault(lease_store, "attempt=JobRow.attempt - 1,", ""),
    "anybody reports a job": Fault(
        report_store, 'if not secrets.compare_digest(row.lease_token, outcome.token): return "stale"', ""
    ),
    "a report counts twice": Fault(
        report_store, "if row.status == JobStatus.LEASED and not reported_before:", "if not reported_before:"
    ),
    "a report that was stored is called stale": Fault(report_store, 'return "duplicate"', 'return "stale"'),
    "a failed job is lost": Fault(
        report_store, "retry = not outcome.final and times < row.max_attempts", "retry = False"
    ),
    "a failed job is tried for ever": Fault(
        report_store, "retry = not outcome.final and times < row.max_attempts", "retry = not outcome.final"
    ),
    "a job that can never run is tried again": Fault(
        report_store,
        "retry = not outcome.final and times < row.max_attempts",
        "retry = times < row.max_attempts",
    ),
    "failed jobs do not back off": Fault(
        report_store, '"wait_until": now + timedelta(seconds=wait_s) if retry else None', '"wait_until": None'
    ),
    "leases never run out": Fault(
        report_store,
        'JobRow.lease_expires_at < transaction_time("now"))',
        'JobRow.lease_expires_at < datetime.fromisoformat("2000-01-01T00:00:00+00:00"))',
    ),
    "leases run out at once": Fault(
        report_store,
        '.where(IS_LEASED, JobRow.lease_expires_at < transaction_time("now"))',
        ".where(IS_LEASED)",
    ),
    "a late report is called stored": Fault(
        report_store,
        "losses=JobRow.losses + 1, lost_token=JobRow.lease_token, lease_token=None",
        "losses=JobRow.losses + 1",
    ),
    "a result is not shared": Fault(
        report_store,
        "_finish(connection, {twin.id: results[twin.spec_hash, twin.kind] for twin in twins}, now)",
        "",
    ),
    "a result is shared without a cache": Fault(
        report_store,
        "JobRow.status == JobStatus.QUEUED, JobRow.cache,).order_by",
        "JobRow.status == JobStatus.QUEUED).order_by",
    ),
    "cancelling leaves jobs with workers": Fault(
        job_store,
        "JobRow.status.in_([JobStatus.QUEUED, JobStatus.LEASED]), ) .values(",
        "JobRow.status == JobStatus.QUEUED, ) .values(",
    ),
    "a cancelled job keeps its lease": Fault(
        job_store, "status=JobStatus.CANCELLED, lease_token=None,", "status=JobStatus.CANCELLED,"
    ),
    "a retry by hand has no attempts": Fault(
        job_store,
        "max_attempts=JobRow.attempt - JobRow.losses + more_attempts",
        "max_attempts=JobRow.attempt - JobRow.losses",
    ),
    "a retry by hand has no losses": Fault(job_store, "max_losses=JobRow.losses + more_losses,", ""),
    "a late result is not taken": Fault(
        report_store, "restored = _restore_lost(connection, rows, outcomes, now)", "restored = {}"
    ),
    "a late result is taken after quarantine": Fault(
        report_store,
        "and row.status == JobStatus.QUEUED and row.lost_token",
        "and row.status != JobStatus.LEASED and row.lost_token",
    ),
    "a lost lease stays lost after its failure is reported": Fault(
        report_store, "losses=JobRow.losses - case((JobRow.interrupted, 0), else_=1)", "losses=JobRow.losses"
    ),
    "a lost lease counts as a failed attempt": Fault(
        report_store, "times = row.attempt - row.losses", "times = row.attempt"
    ),
    "a job loses its workers for ever": Fault(report_store, "retry = times < row.max_losses", "retry = True"),
    "leases run out in an outage": Fault(outages, "if is_gap or resuming: extended", "if resuming: extended"),
    "leases run out while a coordinator restarts": Fault(
        outages, "if is_gap or resuming: extended", "if is_gap: extended"
    ),
    "a coordinator that restarts keeps leases for ever": Fault(
        outages, "_SHORT if again else _NOT_YET_EXTENDED", "_SHORT"
    ),
    "an outage counts as a loss": Fault(outages, "interrupted=True", "interrupted=False"),
    "a late result after an outage is a loss less": Fault(
        report_store,
        "attempt=JobRow.attempt + case((JobRow.interrupted, 1), else_=0)",
        "attempt=JobRow.attempt",
    ),
    "a renewed lease is interrupted for ever": Fault(
        lease_store,
        'lease_expires_at=bindparam("until"), interrupted=False',
        'lease_expires_at=bindparam("until")',
    ),
    "a new lease is interrupted from the start": Fault(
        lease_store, "interrupted=False, not_before=None", "not_before=None"
    ),
}
"""The faults, by what goes wrong."""


@contextmanager
def injected(fault: Fault) -> Iterator[None]:
    """Run a module with a fault in it until the end of the block."""
    source, times = _in_any_layout(fault.right).subn(lambda _: fault.wrong, inspect.getsource(fault.module))
    if times != 1:
        raise AssertionError(
            f"{fault.module.__name__}: expected this once, found it {times} times:\n{fault.right}"
        )
    right = dict(vars(fault.module))
    exec(compile(source, f"{fault.module.__name__} with a fault", "exec"), vars(fault.module))
    try:
        yield
    finally:
        vars(fault.module).clear()
        vars(fault.module).update(right)


def _in_any_layout(code: str) -> re.Pattern[str]:
    """Return a pattern for a piece of code, whatever its line breaks and trailing commas."""
    tokens = re.findall(r"\w+|[^\w\s]", code)
    return re.compile(r"\s*".join(",?" if token == "," else re.escape(token) for token in tokens))


def recorded() -> dict[str, list[Step]]:
    """Return the recorded history of each fault."""
    found: dict[str, list[Step]] = json.loads(RECORDED.read_text(encoding="utf-8"))
    return found


def record() -> None:
    """Search for a history that reveals each fault, and write the shortest ones down, a fault a line."""
    lines = []
    with tempfile.TemporaryDirectory() as folder:
        engines = open_engines(f"sqlite:///{sqlite_template(Path(folder))}")
        for name, fault in FAULTS.items():
            with injected(fault):
                history = _shortened(engines, _revealing(engines, name))
            lines.append(f"{json.dumps(name)}: {json.dumps(history)}")
            print(f"{name}: {len(history)} steps", flush=True)
        engines.dispose()
    RECORDED.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def _revealing(engines: Engines, name: str) -> list[Step]:
    """Return a history that reveals the injected fault, a short one if there is any."""
    for steps in (8, 16, 30, 60):
        try:
            search(engines, histories=HISTORIES, steps=steps, shrink=False)
        except NOTICED:
            return list(QueueMachine.latest)
    raise SystemExit(f"{name}: no history reveals it")


def _shortened(engines: Engines, history: list[Step]) -> list[Step]:
    """Return a history without the steps that it does not need to reveal the injected fault."""
    for place in reversed(range(len(history))):
        without = history[:place] + history[place + 1 :]
        try:
            replay(engines, without)
        except NOTICED:
            history = without
        except (ZeroDivisionError, KeyError):  # a later step has nothing to choose from
            continue
    return history


if __name__ == "__main__":
    record()
