"""The life of a job, hop by hop, through real processes and the real simulator."""

import json
from pathlib import Path
from typing import Any

import httpx
from support.databases import Databases, sqlite_then_postgres
from support.processes import site
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.worker.wire import WIRE_VERSION

CAMPAIGN = {
    "name": "life of a job",
    "problem": {"id": "urban-injected@1", "params": {"duration_s": 5.0}},
    "algorithm": {"id": "random@1", "params": {"generation_size": 6, "in_flight": 1}},
    "budget": {"simulations": 12},
    "seed": 5,
    "execution": {"keep_traces": 0},
}


@sqlite_then_postgres
def test_the_life_of_a_job(databases: Databases, tmp_path: Path) -> None:
    assert WIRE_VERSION == 1
    with databases.database("brink", migrated=False) as url, site(tmp_path, url) as running:

        def ask(method: str, path: str, status: int = 200, **options: Any) -> Any:
            response = httpx.request(method, f"{running.url}/api/v1{path}", timeout=30, **options)
            assert response.status_code == status, response.text
            return response.json()

        # 1. A submission is validated and stored; its first generation is enqueued with it.
        ask("POST", "/campaigns", 422, json={**CAMPAIGN, "budget": {"simulations": 0}})
        campaign = ask("POST", "/campaigns", 201, json=CAMPAIGN)["id"]
        jobs = ask("GET", "/jobs", params={"campaign": campaign})["jobs"]
        assert [job["number"] for job in jobs] == list(range(6))
        assert {job["status"] for job in jobs} == {"queued"}
        assert {job["needs"] for job in jobs} == {"brink-drive@3"}
        assert running.progress(campaign)["unrunnable"] == {"brink-drive@3": 6}

        # 2. A worker leases jobs with tokens: this one by hand, and it does nothing more.
        identity = {"id": "by-hand", "host": "here", "pid": 1, "version": ""}
        lease = ask(
            "POST",
            "/jobs/lease",
            json={"worker": identity, "capabilities": ["brink-drive@3"], "max_jobs": 1, "wait_s": 0},
        )
        (held,) = lease["jobs"]
        assert held["spec"]["simulator"] == "brink-drive@3"

        # 3. A real worker runs the others in its child process, renews, and reports in batches.
        running.start_workers(1)
        running.await_progress(campaign, simulations=5)
        solution = ask("GET", f"/campaigns/{campaign}/solutions/{jobs[1]['number']}")
        assert running.progress(campaign)["generation"] == 0  # it waits for the job that is held by hand
        assert solution["verdict"] == "pending"

        # 4. A result without the token that holds the job changes nothing; one with it finishes the job.
        outcome = {"kind": "failed", "reason": "invalid", "message": "given up by hand"}
        forged = {"job": held["job"], "token": "forged", "outcome": outcome}
        mine = {**forged, "token": held["token"]}
        reply = ask("POST", "/jobs/results", json={"worker": identity, "results": [forged, mine, mine]})
        assert [item["status"] for item in reply["statuses"]] == ["stale", "accepted", "duplicate"]

        # 5. The last result of a generation has it told, and the next enqueued, until the budget is spent.
        done = running.await_end(campaign)
        assert done["status"] == "finished", done["status_reason"]
        assert (done["evaluated"], done["failed"], done["quarantined"]) == (11, 1, 1)
        assert [g["evaluated"] for g in done["generations"]] == [5, 11]
        assert done["digest"]

        # The evidence: what the episode was, what came out, and its trace, made again by the worker.
        solution = ask("GET", f"/campaigns/{campaign}/solutions/{jobs[1]['number']}")
        assert solution["verdict"] in ("safe", "unsafe")
        assert set(solution["verdicts"]) == set(solution["spec"]["requirements"])
        path = f"/campaigns/{campaign}/solutions/{jobs[1]['number']}/trace"
        ask("POST", path, 202)
        trace = httpx.get(f"{running.url}/api/v1{path}", params={"wait_s": 30}, timeout=60)
        assert trace.status_code == 200
        assert trace.content.startswith(b"PK")  # an npz archive
        said = CliRunner().invoke(app, ["status", campaign, "--server", running.url, "--json"])
        assert said.exit_code == 0, said.output
        assert json.loads(said.stdout)["digest"] == done["digest"]
