"""The API against its OpenAPI description: made-up requests never cause a server error or an undescribed answer.

The fuzzer is told the ids of campaigns, jobs, leases and solutions that exist (`fill`). With made-up ids alone it
would hardly see anything but "no such campaign".
"""

import base64
import json
import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import httpx
import pytest
from support.api import FakeWorker, ball, expect, listening_coordinator, progress, submit
from support.databases import on_sqlite
from support.problems import REQUIREMENT, SIMULATOR
from support.tolerance import body, camera
from support.tolerance import finished as finished_drives
from support.traces import filmed
from support.traffic import traffic_worker

from brink.sim.encounter.simulator import BrinkEncounter
from brink.sim.episode import EpisodeSpec
from brink.sim.trace import Trace
from brink.worker.wire import Completed, JobFailed, LeasedJob, WireVerdict

FUZZER = Path(sys.executable).with_name("schemathesis")
HOOKS = Path(__file__).parents[2] / "fuzzing"
CHECKS = "not_a_server_error,status_code_conformance,content_type_conformance,response_schema_conformance"
METHODS = {"get", "post", "put", "patch", "delete"}
PICTURES = {
    "/campaigns/{campaign_id}/pairs/{safe}-{unsafe}/{side}.png",
    "/campaigns/{campaign_id}/solutions/{number}/compared/{side}.png",
}
"""Pictures of drives that a worker has to record first, which the workers of this test cannot."""
MAY_BE_UNAVAILABLE = PICTURES | {
    "/campaigns/{campaign_id}/solutions/{number}/episode",
    "/campaigns/{campaign_id}/solutions/{number}/trace",
    "/campaigns/{campaign_id}/solutions/{number}/replay.{extension}",
}


@pytest.mark.timeout(400)
@on_sqlite
@pytest.mark.usefixtures("small_problems")
@pytest.mark.long("tries many requests")
def test_generated_requests_are_answered(database_url: str, tmp_path: Path) -> None:
    with listening_coordinator(database_url, lease_s=3600) as client:
        known = fill(client)
        paths = client.get("/openapi.json").json()["paths"]
        operations = sum(len(METHODS & of_path.keys()) for of_path in paths.values())
        before = {campaign: digest(client, campaign) for campaign in known["campaigns"][:3]}
        environment = {
            **os.environ, "SCHEMATHESIS_HOOKS": "schemathesis_hooks", "PYTHONPATH": str(HOOKS),
            "BRINK_FUZZ_KNOWN": json.dumps(known),
        }  # fmt: skip
        command = [
            str(FUZZER), "--config-file", str(HOOKS / "schemathesis.toml"), "run",
            f"{client.base_url}/openapi.json", "--checks", CHECKS, "--phases", "examples,coverage,fuzzing",
            "--max-examples", "30", "--seed", "1", "--request-timeout", "30",
        ]  # fmt: skip
        fuzzer = subprocess.run(
            command, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False
        )
        answered = answers(client)
        after = {campaign: digest(client, campaign) for campaign in before}
        ready = client.get("/readyz").status_code
    assert fuzzer.returncode == 0, fuzzer.stdout[-6000:] + fuzzer.stderr[-2000:]
    assert f"Tested: {operations}" in fuzzer.stdout, fuzzer.stdout[-1000:]
    assert after == before, "a finished campaign changed"
    assert ready == 200
    assert {route for route, status in answered if status == "5xx"} <= MAY_BE_UNAVAILABLE
    with_ids = {route for route, _ in answered if "{" in route}
    found = {route for route, status in answered if status == "2xx"}
    assert len(with_ids) >= 18
    assert with_ids - PICTURES <= found, "some requests were made with made-up ids alone"


def digest(client: httpx.Client, campaign: str) -> str:
    """Return the archive digest of a finished campaign."""
    return str(progress(client, campaign)["digest"])


def answers(client: httpx.Client) -> set[tuple[str, str]]:
    """Return the pairs of route and class of status that were answered so far."""
    counted = r'^brink_request_seconds_count{method="[A-Z]+",route="([^"]+)",status="(\dxx)"}'
    return set(re.findall(counted, client.get("/metrics").text, re.MULTILINE))


SPARES = 16
TRAFFIC: dict[str, Any] = {
    "name": "traffic",
    "problem": {"id": "npc-actions@1", "params": {"participants": 3, "duration_s": 8.0}},
    "algorithm": {"id": "random@1", "params": {"generation_size": 40}},
    "budget": {"simulations": 40},
    "execution": {"keep_traces": 0},
}
SLOTS: dict[str, Any] = {**TRAFFIC, "name": "slots", "problem": {"id": "slotted@1"}}


def fill(client: httpx.Client) -> dict[str, list[Any]]:
    """Fill a coordinator, and return its ids and leases as `tests/fuzzing/schemathesis_hooks.py` reads them."""
    finished = submit(client, ball(simulations=20, execution={"keep_traces": 0}))
    assert FakeWorker(client).work(finished)["status"] == "finished"
    doubtful: dict[str, Any] = {"t_b": 1.0, "repeats": 2}
    again = expect(client.post(f"/api/v1/campaigns/{finished}/repeats", json=doubtful), 201)
    assert FakeWorker(client).work(again["campaign"])["status"] == "finished"
    slots = submit(client, SLOTS)
    assert FakeWorker(client, judge=_strong).work(slots)["status"] == "finished"
    traffic = submit(client, TRAFFIC)
    assert traffic_worker(client).work(traffic)["status"] == "finished"
    violations = expect(client.get(f"/api/v1/campaigns/{traffic}/violations"))["violations"]
    assert violations
    drawn = _traced(client, traffic)
    cells: dict[str, Any] = {"cells": {"type": ["miss"], "target": ["lead"]}, "conditions": [{"name": "all"}]}
    tolerances = finished_drives(client, body(1, 100, **cells))
    fresh = finished_drives(client, body(2, 60, **cells, design="random"))
    drives = finished_drives(client, camera())
    running = submit(client, ball(seed=2, execution={"cache": False}))
    leases, retried = _worked_on(client)
    nobodys: dict[str, Any] = {"problem": {"id": "ball@1", "params": {"needs": "nobody-has-it@1"}}}
    unrunnable = submit(client, ball(seed=3, **nobodys))
    spares = [submit(client, ball(seed=9, simulations=20, **nobodys)) for _ in range(SPARES)]
    for spare in spares[::2]:
        expect(client.post(f"/api/v1/campaigns/{spare}/cancel"))
    tiny: dict[str, Any] = {
        "name": "tiny", "problems": [{"id": "ball@1"}], "algorithms": [{"id": "random@1"}], "seeds": [1],
        "budget": {"simulations": 20},
    }  # fmt: skip
    experiments = [expect(client.post("/api/v1/experiments", json=tiny), 201)["id"] for _ in range(SPARES)]
    return {
        "experiments": experiments[:1],
        "spare_experiments": experiments[1:],
        "solutions": [{"where": {"x": 0.0}, "what": {"y": 0.5}}],
        "campaigns": [finished, slots, traffic, running, unrunnable],
        "spares": spares,
        "numbers": [0, 1, 2, 3, 19],
        "jobs": [*retried, *(lease["job"] for lease in leases)],
        "leases": leases,
        "tolerances": [{"campaign": tolerances, "fresh": fresh, "episodes": drives}],
        "violations": [_place(one, traffic) for one in violations],
        "traced": [{"campaign_id": traffic, "number": drawn}, {"campaign_id": unrunnable, "number": 1}],
    }


def _place(violation: Mapping[str, Any], campaign: str) -> dict[str, Any]:
    return {
        "campaign_id": campaign, "number": violation["number"], "requirement": violation["requirement"],
    }  # fmt: skip


def _strong(job: LeasedJob) -> Completed:
    """Return an outcome that is unsafe if the first perturbation is strong."""
    robustness = 0.5 - float(job.spec["behaviour"]["strong"])
    return Completed(
        verdicts={REQUIREMENT: WireVerdict(robustness=robustness, unit="m", violated_at_s=None)},
        objectives={"distance": robustness},
    )


def _traced(client: httpx.Client, campaign: str) -> int:
    """Store a trace with a film for a solution, and return the number of the solution."""
    number = 0
    path = f"/api/v1/campaigns/{campaign}/solutions/{number}/trace"
    assert client.get(path, params={"wait_s": 0}).status_code == 202

    def with_trace(job: LeasedJob) -> Completed | JobFailed:
        trace = BrinkEncounter().run(EpisodeSpec.from_json(job.spec), record=True).trace
        assert trace is not None
        seen = filmed(Trace.from_bytes(trace)).to_bytes()
        return Completed(verdicts={}, trace=base64.b64encode(seen).decode())

    worker = FakeWorker(client, capabilities=("brink-encounter@1",), judge=with_trace)
    assert worker.report(worker.lease()) == ["accepted"]
    assert client.get(path).status_code == 200
    return number


def _worked_on(client: httpx.Client) -> tuple[list[dict[str, Any]], list[int]]:
    """Lease some jobs and put others into quarantine; return the leases and the quarantined jobs."""
    failing = FakeWorker(
        client, id="failing", judge=lambda _: JobFailed(reason="invalid", message="no such road")
    )
    failed = failing.lease(max_jobs=3)
    failing.report(failed)
    held = FakeWorker(client, id="holding", capabilities=(SIMULATOR,)).lease(max_jobs=8)
    assert failed
    assert held
    return [{"job": job.job, "token": job.token} for job in held], [job.job for job in failed]
