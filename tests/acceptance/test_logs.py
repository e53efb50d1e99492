"""The logs of real processes: one campaign followed through all of them, and no secret in any."""

import json
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy.engine import make_url
from support.api import ball
from support.databases import Databases, on_postgres
from support.processes import TOY, Program, Site, site

JSON_LOGS = {**TOY, "BRINK_LOG_FORMAT": "json", "BRINK_LOG_LEVEL": "debug", "BRINK_SWEEP_S": "0.1"}
TEXT_LOGS = {**TOY, "BRINK_LOG_LEVEL": "debug", "BRINK_SWEEP_S": "0.1"}

pytestmark = on_postgres


@pytest.fixture
def database(databases: Databases) -> Iterator[str]:
    with databases.database() as url:
        yield url


def records(program: Program) -> list[dict[str, Any]]:
    """Return what a program logged; each of its lines must be an object."""
    found: list[dict[str, Any]] = [json.loads(line) for line in program.lines]
    for record in found:
        assert {"time", "level", "logger", "message"} <= set(record), record
    return found


def about(found: list[dict[str, Any]], message: str) -> list[dict[str, Any]]:
    return [record for record in found if record["message"] == message]


def logged(running: Site) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Stop coordinator and worker; return what each logged."""
    assert running.coordinator is not None
    [worker] = running.workers
    for program in (worker, running.coordinator):
        program.process.terminate()
        program.wait()
    return records(running.coordinator), records(worker)


@pytest.mark.long("runs a campaign")
def test_a_campaign_is_traced_through_coordinator_and_worker_by_id(database: str, tmp_path: Path) -> None:
    with site(tmp_path, database, JSON_LOGS) as running:
        running.start_workers(1, "--id", "w-17")
        fault = {"id": "ball@1", "params": {"fault": "exit", "fault_from": 1.6}}
        campaign = running.submit(
            ball(problem=fault, simulations=20, execution={"max_attempts": 1, "max_failed_share": 1.0})
        )
        done = running.await_end(campaign)
        assert done["status"] == "finished"
        coordinator, worker = logged(running)

    [first] = about(coordinator, "worker first seen")
    assert first["worker"] == "w-17"
    [submitted] = about(coordinator, "campaign submitted")
    assert submitted["campaign"] == campaign
    assert submitted["request"], "it is known in which request that was"
    told = [record for record in about(coordinator, "generation told") if record["campaign"] == campaign]
    assert [record["generation"] for record in told] == list(range(done["generation"]))
    assert told[-1]["evaluated"] == done["evaluated"]
    [finished] = about(coordinator, "campaign finished")
    assert (finished["campaign"], finished["level"]) == (campaign, "info")

    quarantined = about(coordinator, "job in quarantine")
    assert len(quarantined) == done["failed"] > 0
    for record in quarantined:
        assert (record["campaign"], record["worker"], record["attempt"]) == (campaign, "w-17", 1)
        assert record["reason"].startswith("crashed: ")
    failed = {record["job"] for record in worker if record["message"].startswith("job failed: ")}
    assert {record["job"] for record in quarantined} == failed

    completed = about(worker, "job completed")
    assert {record["campaign"] for record in completed} == {campaign}
    assert {record["worker"] for record in worker} == {"w-17"}
    granted = {record["job"] for record in about(coordinator, "job granted")}
    accepted = {record["job"] for record in about(coordinator, "result accepted")}
    assert accepted <= granted
    assert accepted == failed | {record["job"] for record in completed}
    [request] = [
        r for r in about(coordinator, "request") if r["method"] == "POST" and r["route"] == "/campaigns"
    ]
    assert (request["status"], request["request"]) == (201, submitted["request"])
    assert request["duration_ms"] > 0
    assert "uvicorn.error" in {record["logger"] for record in coordinator}


@pytest.mark.long("runs a campaign")
def test_details_are_not_logged_unless_asked_for(database: str, tmp_path: Path) -> None:
    with site(tmp_path, database, {**JSON_LOGS, "BRINK_LOG_LEVEL": "info"}) as running:
        running.start_workers(1)
        campaign = running.submit(ball())
        assert running.await_end(campaign)["status"] == "finished"
        coordinator, worker = logged(running)
    for record in (*coordinator, *worker):
        assert record["level"] != "debug"
        assert "job" not in record
        assert record["message"] != "request"


@pytest.mark.parametrize(
    "environment", [pytest.param(JSON_LOGS, id="json"), pytest.param(TEXT_LOGS, id="text")]
)
@pytest.mark.long("runs a campaign")
def test_no_secret_is_logged_at_any_level(database: str, tmp_path: Path, environment: dict[str, str]) -> None:
    password, token, guess = (f"{name}-{secrets.token_hex(8)}" for name in ("word", "token", "guess"))
    url = make_url(database).set(password=password).render_as_string(hide_password=False)
    key = f"key-{secrets.token_hex(8)}"
    settings = {**environment, "BRINK_TOKEN": token, "BRINK_ACCESS_LOG": "true", "OPENAI_API_KEY": key}
    with site(tmp_path, url, settings) as running:
        running.start_workers(1)
        wrong = {"Authorization": f"Bearer {guess}"}
        assert httpx.get(f"{running.url}/api/v1/campaigns", headers=wrong).status_code == 401
        campaign = running.submit(ball())
        assert running.await_end(campaign)["status"] == "finished"
        assert running.coordinator is not None
        running.coordinator.kill()  # the worker tells that the coordinator is away
        running.workers[0].await_line("waiting for the coordinator")
        said = {"coordinator": running.coordinator.output, "worker": running.workers[0].output}
    for program, output in said.items():
        assert campaign in output, f"the {program} logs"
        for secret in (password, token, guess, key, "Bearer"):
            assert secret not in output, f"the {program} logged it"
    assert "***" in said["coordinator"], "the address of the database is shown without its password"
