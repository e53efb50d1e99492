"""Episodes that kill, hang or starve their process: retried, put into quarantine, and shown."""

import json
import re
from pathlib import Path
from typing import Any

import httpx
import pytest
from support.api import ball, eventually, undisturbed_digest
from support.databases import Databases
from support.processes import TOY, Program, Site, brink, site

QUICK = {**TOY, "BRINK_RETRY_BACKOFF_S": "0.05", "BRINK_SWEEP_S": "0.1"}
WORDS = {
    "segfault": ("crashed", "SIGSEGV"),
    "hang": ("timeout", "no verdict after"),
    "out-of-memory": ("out-of-memory", "MemoryError"),
    "exit": ("crashed", "exited with status 3"),
}


def campaign(fault: str, **params: Any) -> dict[str, Any]:
    """Return a campaign of which about one candidate in ten breaks down."""
    return ball(
        simulations=20,
        problem={"id": "ball@1", "params": {"fault": fault, "fault_from": 1.6, **params}},
        algorithm={"id": "random@1", "params": {"generation_size": 20}},
        execution={"max_attempts": 2, "max_failed_share": 1.0},
    )


def seen_workers(running: Site) -> int:
    return len(httpx.get(f"{running.url}/api/v1/workers").json())


def failed_attempts(worker: Program) -> dict[int, int]:
    """Return which attempt at which job a worker says it saw fail."""
    told = re.findall(r"job failed: .* job=(\d+) attempt=(\d+)", worker.output)
    return {int(job): int(attempt) for job, attempt in told}


@pytest.mark.long("waits for jobs to be retried")
def test_guilty_jobs_are_retried_quarantined_and_shown(databases: Databases, tmp_path: Path) -> None:
    with databases.database() as url, site(tmp_path, url, QUICK) as running:
        running.start_workers(2)
        eventually(lambda: seen_workers(running) == 2, "both workers asked for jobs")
        submitted = {
            fault: running.submit(campaign(fault, timeout_s=0.5 if fault == "hang" else 20.0))
            for fault in WORDS
        }
        for fault, campaign_id in submitted.items():
            done = running.await_end(campaign_id)
            assert done["status"] == "finished", (fault, done["status_reason"])
        assert [worker.process.poll() for worker in running.workers] == [None, None]
        attempts = [failed_attempts(worker) for worker in running.workers]
        said = {
            fault: brink("status", campaign_id, "--database", url, "--json", cwd=tmp_path)
            for fault, campaign_id in submitted.items()
        }
    guilty_jobs = set[int]()
    for fault, (reason, words) in WORDS.items():
        assert said[fault].returncode == 0, said[fault].stderr
        document = json.loads(said[fault].stdout)
        guilty = document["quarantined_jobs"]
        assert 1 <= len(guilty) < 20
        assert document["failed"] == document["quarantined"] == len(guilty)
        assert document["evaluated"] == 20 - len(guilty)
        for job in guilty:
            assert job["attempt"] == 2
            assert job["last_error"].startswith(f"{reason}: ")
            assert words in job["last_error"]
            guilty_jobs.add(job["id"])
    for job_id in guilty_jobs:  # once here, once there
        assert sorted(seen[job_id] for seen in attempts) == [1, 2]


@pytest.mark.long("starts processes again and again")
def test_a_passing_fault_leaves_no_trace(databases: Databases, tmp_path: Path, small_problems: None) -> None:
    once = tmp_path / "once"
    once.mkdir()
    body = campaign("segfault", once_in=str(once))
    with databases.database() as url, site(tmp_path, url, QUICK) as running:
        running.start_workers(2)
        done = running.await_end(running.submit(body))
    assert list(once.iterdir())
    assert (done["status"], done["failed"], done["quarantined"]) == ("finished", 0, 0)
    assert done["digest"] == undisturbed_digest(body)
