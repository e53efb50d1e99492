"""The same campaign and seed give the same archive, bit for bit, whatever happens to the processes."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.api import ball, undisturbed_digest
from support.databases import Databases, few_on_postgres, sqlite_then_postgres
from support.processes import TOY, Site, site

THRESHOLDS = {"id": "edge@2", "params": {"generation_size": 6, "in_flight": 3, "trials": 18}}
BALL = {
    "mlcshe@1": {"id": "mlcshe@1", "params": {"population_size": 6, "archive_size": 2}},
    "edge@2": THRESHOLDS,
    "suite@1": {
        "id": "suite@1",
        "params": {
            "solutions": [[0.06 * place, 0.0] for place in range(30)],
            "seeds": list(range(0, 600, 20)),
        },
    },
}
"""Searches on the ball."""


ON_THE_ROAD = {
    "name": "determinism",
    "problem": {"id": "urban-injected@1", "params": {"duration_s": 5.0}},
    "algorithm": THRESHOLDS,
    "budget": {"simulations": 60},
    "seed": 11,
    "execution": {"cache": False, "keep_traces": 0},
}


QUICK = {"BRINK_LEASE_S": "2", "BRINK_RETRY_BACKOFF_S": "0.1", "BRINK_SWEEP_S": "0.1"}


@contextmanager
def on(databases: Databases, folder: Path, **env: str) -> Iterator[Site]:
    with databases.database() as url, site(folder, url, {**TOY, **QUICK, **env}) as running:
        yield running


@pytest.fixture(scope="module")
def urban_digests() -> dict[str, str]:
    """What the campaign on the road gave in each of the ways in which it was run."""
    return {}


@sqlite_then_postgres
@pytest.mark.long("runs a campaign several times")
def test_worker_count_and_database(
    databases: Databases, tmp_path: Path, urban_digests: dict[str, str]
) -> None:
    with on(databases, tmp_path, BRINK_PLUGINS="") as running:
        for workers in (1, 4) if databases.backend == "sqlite" else (4,):
            running.start_workers(workers - len(running.workers))
            done = running.await_end(running.submit(ON_THE_ROAD))
            assert done["status"] == "finished", done["status_reason"]
            assert done["failed"] == 0
            urban_digests[f"{databases.backend}, {workers} workers"] = done["digest"]
    assert len(set(urban_digests.values())) == 1, urban_digests


@few_on_postgres("name", BALL, ["edge@2"], "restarts other searches")
@pytest.mark.long("kills and restarts processes")
def test_everything_killed_and_restarted(
    databases: Databases, tmp_path: Path, small_problems: None, name: str
) -> None:
    body = ball(
        seed=7, simulations=120, problem={"id": "ball@1", "params": {"slow_s": 0.02}}, algorithm=BALL[name]
    )
    with on(databases, tmp_path) as running:
        running.start_workers(2)
        campaign = running.submit(body)

        stands = running.await_progress(campaign, simulations=15)
        running.workers.pop().kill()
        running.start_workers(1)

        stands = running.await_progress(campaign, simulations=40)
        assert running.coordinator is not None
        running.coordinator.kill()
        running.start_coordinator()
        assert running.progress(campaign)["simulations"] >= stands["simulations"]

        stands = running.await_progress(campaign, simulations=70)
        assert {worker.process.poll() for worker in running.workers} == {None}  # they waited for it
        assert stands["status"] == "running"
        running.kill_everything()
        running.start_coordinator()
        assert running.progress(campaign)["simulations"] >= stands["simulations"]
        running.start_workers(2)

        done = running.await_end(campaign)
    assert done["status"] == "finished", done["status_reason"]
    assert done["failed"] == 0
    assert done["digest"] == undisturbed_digest(body)
