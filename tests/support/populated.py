"""A coordinator that has something of everything: campaigns of all kinds, experiments, jobs in all states, traces."""

import base64
from collections.abc import Mapping
from typing import Any

import httpx

from brink.sim.encounter.simulator import BrinkEncounter
from brink.sim.episode import EpisodeSpec
from brink.sim.trace import Trace
from brink.worker.wire import Completed, JobFailed, LeasedJob, WireVerdict
from support.api import FakeWorker, ball, expect, submit
from support.problems import REQUIREMENT, SIMULATOR
from support.tolerance import body, camera
from support.tolerance import finished as finished_drives
from support.traces import filmed
from support.traffic import traffic_worker

SPARES = 16
TRAFFIC: dict[str, Any] = {
    "name": "traffic",
    "problem": {"id": "npc-actions@1", "params": {"participants": 3, "duration_s": 8.0}},
    "algorithm": {"id": "random@1", "params": {"generation_size": 40}},
    "budget": {"simulations": 40},
    "execution": {"keep_traces": 0},
}
SLOTS: dict[str, Any] = {**TRAFFIC, "name": "slots", "problem": {"id": "slotted@1"}}
SUITE: dict[str, Any] = {
    "id": "suite@1",
    "params": {"solutions": [[0.0, 0.0], [0.9, 0.0], [1.8, 0.0]], "seeds": [0, 20, 40]},
}


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
    lines: dict[str, Any] = {"algorithm": {"id": "edge@2"}, "execution": {"keep_traces": 0}}
    thresholds = submit(client, ball(simulations=200, **lines))
    assert FakeWorker(client).work(thresholds)["status"] == "finished"
    suite = submit(client, ball(simulations=60, algorithm=SUITE))
    assert FakeWorker(client).work(suite)["status"] == "finished"
    running = submit(client, ball(seed=2, execution={"cache": False}))
    leases, retried = _worked_on(client)
    nobodys: dict[str, Any] = {"problem": {"id": "ball@1", "params": {"needs": "nobody-has-it@1"}}}
    unrunnable = submit(client, ball(seed=3, **nobodys))
    spares = [submit(client, ball(seed=9, simulations=20, **nobodys)) for _ in range(SPARES)]
    for spare in spares[::2]:
        expect(client.post(f"/api/v1/campaigns/{spare}/cancel"))
    tiny: dict[str, Any] = {
        "name": "tiny",
        "problems": [{"id": "ball@1"}],
        "algorithms": [{"id": "random@1"}],
        "seeds": [1],
        "budget": {"simulations": 20},
    }
    experiments = [expect(client.post("/api/v1/experiments", json=tiny), 201)["id"] for _ in range(SPARES)]
    return {
        "experiments": experiments[:1],
        "spare_experiments": experiments[1:],
        "solutions": [{"where": {"x": 0.0}, "what": {"y": 0.5}}],
        "campaigns": [finished, slots, traffic, running, unrunnable, suite],
        "spares": spares,
        "numbers": [0, 1, 2, 3, 19],
        "jobs": [*retried, *(lease["job"] for lease in leases)],
        "leases": leases,
        "thresholds": [thresholds],
        "tolerances": [{"campaign": tolerances, "fresh": fresh, "episodes": drives}],
        "violations": [_place(one, traffic) for one in violations],
        "traced": [{"campaign_id": traffic, "number": drawn}, {"campaign_id": unrunnable, "number": 1}],
    }


def _place(violation: Mapping[str, Any], campaign: str) -> dict[str, Any]:
    return {"campaign_id": campaign, "number": violation["number"], "requirement": violation["requirement"]}


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
    assert client.post(path).status_code == 202

    def with_trace(job: LeasedJob) -> Completed | JobFailed:
        trace = BrinkEncounter().run(EpisodeSpec.from_json(job.spec), record=True).trace
        assert trace is not None
        seen = filmed(Trace.from_bytes(trace)).to_bytes()
        return Completed(verdicts={}, trace=base64.b64encode(seen).decode())

    worker = FakeWorker(client, capabilities=("brink-encounter@2",), judge=with_trace)
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
