"""The same campaign and seed give the same archive, bit for bit, whatever happens to the processes."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from support.api import ball, undisturbed_digest
from support.databases import Databases
from support.processes import TOY, Site, site

THRESHOLDS = {"id": "edge@2", "params": {"generation_size": 6, "in_flight": 3, "trials": 18}}
URBAN = {
    "mlcshe@1": {"id": "mlcshe@1", "params": {"population_size": 5, "archive_size": 2}},
    "edge@2": THRESHOLDS,
}
"""Searches on the road."""
BALL = {
    "mlcshe@1": {"id": "mlcshe@1", "params": {"population_size": 6, "archive_size": 2}},
    "edge@2": THRESHOLDS,
    "sharpen@1": {
        "id": "sharpen@1",
        "params": {
            "safe": [[1.6, 0.3], [0.2, -1.5], [1.2, 1.2], [-1.9, 0.0], [0.0, 1.7]],
            "unsafe": [[0.4, 0.3], [0.2, 0.1], [-0.3, 0.5], [-0.5, 0.0], [0.4, 0.4]],
            "generation_size": 6,
        },
    },
    "suite@1": {
        "id": "suite@1",
        "params": {
            "solutions": [[0.06 * place, 0.0] for place in range(30)],
            "seeds": list(range(0, 600, 20)),
        },
    },
}
"""Searches on the ball."""


def on_the_road(algorithm: dict[str, Any]) -> dict[str, Any]:
    return {
        "name": "determinism",
        "problem": {"id": "urban-injected@1", "params": {"duration_s": 5.0}},
        "algorithm": algorithm,
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
def urban_digests() -> dict[str, dict[str, str]]:
    """What each campaign on the road gave in each of the ways in which it was run."""
    return {name: {} for name in URBAN}


@pytest.mark.long("runs a campaign several times")
@pytest.mark.parametrize("name", URBAN)
def test_worker_count_and_database(
    databases: Databases, tmp_path: Path, urban_digests: dict[str, dict[str, str]], name: str
) -> None:
    digests = urban_digests[name]
    with on(databases, tmp_path, BRINK_PLUGINS="") as running:
        for workers in (1, 4):
            running.start_workers(workers - len(running.workers))
            done = running.await_end(running.submit(on_the_road(URBAN[name])))
            assert done["status"] == "finished", done["status_reason"]
            assert done["failed"] == 0
            digests[f"{databases.backend}, {workers} workers"] = done["digest"]
    assert len(set(digests.values())) == 1, digests


@pytest.mark.long("kills and restarts processes")
@pytest.mark.parametrize("name", BALL)
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
