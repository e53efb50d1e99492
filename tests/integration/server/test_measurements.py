"""Candidates that are measured on a data set: jobs like others, but no verdict and no place in the archive."""

import io
import math
from typing import Any

import httpx
import numpy as np
import pytest
from support.api import FakeWorker, coordinator, expect, progress, submit
from support.problems import Slotted

from brink.search.algorithm import Candidate, Evaluation, Question
from brink.search.archive import archive_digest
from brink.server.campaigns.body import parse_body
from brink.server.campaigns.plan import make_plan
from brink.worker.wire import Completed, JobFailed, LeasedJob, WireVerdict

SIMOOD = {
    "name": "slots", "problem": {"id": "slotted@1"},
    "algorithm": {"id": "simood-ga@1", "params": {"finalists": 4, "repeats": 3}},
    "budget": {"simulations": 200}, "seed": 5,
}  # fmt: skip


def judged(spec: dict[str, Any]) -> Completed:
    numbers = [*spec["behaviour"].values(), *(v for k, v in spec["scenario"].items() if k != "limit")]
    distance = math.hypot(*numbers)
    robustness = distance - spec["scenario"].get("limit", 1.0)
    return Completed(
        verdicts={
            name: WireVerdict(robustness=robustness, unit="m", violated_at_s=None)
            for name in spec["requirements"]
        },
        objectives={"distance": distance},
    )


def judge(job: LeasedJob) -> Completed | JobFailed:
    return judged(job.spec)


def undisturbed() -> tuple[str, list[Candidate]]:
    """Return the digest of the search run on its own, and all that it asked."""
    body = parse_body(SIMOOD)
    plan = make_plan(body)
    problem, algorithm, asked = plan.problem, plan.algorithm, list[Candidate]()
    assert isinstance(problem, Slotted)

    def answer(candidate: Candidate) -> Evaluation:
        if candidate.question is Question.DATASET:
            return problem.measurement(judged(problem.dataset_evaluation(candidate.vectors).to_json()))
        return problem.evaluation(judged(problem.episode(candidate.vectors, 1).to_json()))

    state = algorithm.start(problem.space, plan.config, seed=body.seed, budget=body.budget.simulations)
    while not algorithm.finished(state):
        state, candidates = algorithm.ask(state)
        asked += candidates
        state = algorithm.tell(state, {c.number: answer(c) for c in candidates})
    return archive_digest(state.archive), asked


def test_a_campaign_is_measured_on_data_and_its_finalists_are_simulated(client: httpx.Client) -> None:
    campaign = submit(client, SIMOOD)
    done = FakeWorker(client, judge=judge).work(campaign)
    digest, asked = undisturbed()
    measured = sum(candidate.question is Question.DATASET for candidate in asked)
    assert done["status"] == "finished", done["status_reason"]
    simulated = len(asked) - measured
    assert simulated > 12, "the hazardous ones of 4 finalists at 3 repeats are explained"
    assert (done["measured"], done["evaluated"], done["failed"]) == (measured, simulated, 0)
    assert done["simulations"] == len(asked)
    assert done["digest"] == digest
    best = [generation["best_fitness"] for generation in done["generations"]]
    assert best == sorted(best, reverse=True)
    assert [generation["measured"] for generation in done["generations"]][-1] == measured
    found = expect(client.get(f"/api/v1/campaigns/{campaign}/solutions", params={"limit": 1000}))["solutions"]
    seeds: dict[str, set[int]] = {}
    for solution in found:
        if solution["verdict"] in ("safe", "unsafe"):
            seeds.setdefault(str(solution["parameters"]["scenario"]), set()).add(solution["seed"])
    assert len(seeds) == 3
    assert all(len(of_scenario) == 1 for of_scenario in seeds.values()), (
        "the same chance in the same scenario"
    )


def test_what_was_measured_is_told_but_not_archived(client: httpx.Client) -> None:
    campaign = submit(client, SIMOOD)
    done = FakeWorker(client, judge=judge).work(campaign)
    found = expect(client.get(f"/api/v1/campaigns/{campaign}/solutions", params={"limit": 1000}))["solutions"]
    measured = [solution for solution in found if solution["verdict"] == "measured"]
    assert len(measured) == done["measured"]
    for solution in measured:
        assert 0 < solution["objectives"]["alpha"] <= 1
        assert solution["robustness"] is None
        assert solution["fitness"] is None
    archive = client.get(f"/api/v1/campaigns/{campaign}/archive.npz")
    with np.load(io.BytesIO(archive.content), allow_pickle=False) as npz:
        assert len(npz["numbers"]) == done["evaluated"]
    jobs = expect(client.get("/api/v1/jobs", params={"campaign": campaign, "limit": 1000}))["jobs"]
    assert [job["kind"] for job in jobs].count("dataset-evaluation") == done["measured"]
    path = f"/api/v1/campaigns/{campaign}/solutions/{measured[0]['number']}/trace"
    assert "no simulated solution" in expect(client.get(path), 404)["detail"]


def test_a_measurement_is_made_once(client: httpx.Client) -> None:
    worker = FakeWorker(client, judge=judge)
    first = worker.work(submit(client, SIMOOD))
    ran = len(worker.statuses)
    again = worker.work(submit(client, SIMOOD))
    assert again["digest"] == first["digest"]
    assert len(worker.statuses) == ran


def test_a_search_on_data_goes_on_after_a_restart(database_url: str, small_problems: None) -> None:
    with coordinator(database_url) as client:
        campaign = submit(client, SIMOOD)
        FakeWorker(client, judge=judge).work(campaign, until=lambda stands: stands["generation"] >= 3)
    with coordinator(database_url) as client:
        done = FakeWorker(client, judge=judge).work(campaign)
    assert done["digest"] == undisturbed()[0]


def test_a_measurement_that_cannot_be_had_is_a_failure(client: httpx.Client) -> None:
    def sometimes(job: LeasedJob) -> Completed | JobFailed:
        if not job.spec["requirements"] and job.spec["behaviour"]["first"] == 2:
            return Completed(verdicts={}, objectives={})
        return judged(job.spec)

    relaxed = {**SIMOOD, "execution": {"max_failed_share": 1.0}}
    done = FakeWorker(client, judge=sometimes).work(submit(client, relaxed))
    assert done["status"] == "finished"
    assert done["failed"] > 0
    assert done["evaluated"] >= 12


def test_data_that_a_problem_does_not_have_is_told_at_submission(client: httpx.Client) -> None:
    body = {**SIMOOD, "problem": {"id": "slotted-blind@1"}}
    (error,) = expect(client.post("/api/v1/campaigns", json=body), 422)["errors"]
    assert error["pointer"] == "/algorithm/id"
    assert "data set" in error["message"]
    simulated = {**body, "algorithm": {"id": "simood-ga@1", "params": {"evaluate": "episode"}}}
    assert submit(client, simulated)


@pytest.mark.parametrize("algorithm", ["mlcshe@1", "ga@1", "random@1"])
def test_every_algorithm_searches_perturbations(client: httpx.Client, algorithm: str) -> None:
    body = {**SIMOOD, "algorithm": {"id": algorithm}}
    done = progress(client, submit(client, body))
    assert done["status"] == "running"
    assert FakeWorker(client, judge=judge).work(done["id"])["evaluated"] >= 200


def test_progress_lists_what_was_measured(client: httpx.Client) -> None:
    campaign = submit(client, SIMOOD)
    listed = expect(client.get(f"/api/v1/campaigns/{campaign}"))
    assert listed["measured"] == 0
