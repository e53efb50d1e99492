"""Search on a data set: candidates that are measured rather than simulated, and hazardous chains of perturbations."""

import io
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import httpx
import numpy as np
import pytest
from support.api import FakeWorker, coordinator, expect, finish, listening_coordinator, progress, submit
from support.databases import Databases
from support.problems import Slotted, small_problems

from brink.search.algorithm import Candidate, Evaluation, Question
from brink.search.archive import archive_digest
from brink.search.space import Categorical
from brink.server.campaigns.body import parse_body
from brink.server.campaigns.plan import make_plan
from brink.server.problems.base import NoParams
from brink.worker.wire import Completed, JobFailed, LeasedJob, WireVerdict

SIMOOD = {
    "name": "slots",
    "problem": {"id": "slotted@1"},
    "algorithm": {"id": "simood-ga@1", "params": {"finalists": 4, "repeats": 3}},
    "budget": {"simulations": 200},
    "seed": 5,
}


SMALL = {**SIMOOD, "budget": {"simulations": 130}}


def outcome_of(spec: dict[str, Any]) -> Completed:
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


def simulate(job: LeasedJob) -> Completed | JobFailed:
    return outcome_of(job.spec)


def search_without_coordinator() -> tuple[str, list[Candidate]]:
    """Run the search without a coordinator; return its archive digest and all candidates that it proposed."""
    body = parse_body(SIMOOD)
    plan = make_plan(body)
    problem, algorithm, asked = plan.problem, plan.algorithm, list[Candidate]()
    assert isinstance(problem, Slotted)

    def answer(candidate: Candidate) -> Evaluation:
        if candidate.question is Question.DATASET:
            return problem.measurement(outcome_of(problem.dataset_evaluation(candidate.vectors).to_json()))
        return problem.evaluation(outcome_of(problem.episode(candidate.vectors, 1).to_json()))

    state = algorithm.start(problem.space, plan.config, seed=body.seed, budget=body.budget.simulations)
    while not algorithm.finished(state):
        state, candidates = algorithm.ask(state)
        asked += candidates
        state = algorithm.tell(state, {c.number: answer(c) for c in candidates})
    return archive_digest(state.archive), asked


def test_a_measurement_is_retried_only_while_its_result_counts(client: httpx.Client) -> None:
    """Otherwise the campaign would wait for the job, and for ever if it has ended or no worker can run it."""

    def fails_first(job: LeasedJob) -> Completed | JobFailed:
        return JobFailed(reason="invalid", message="no picture") if job.job == 1 else outcome_of(job.spec)

    worker, campaign = FakeWorker(client, judge=fails_first), submit(client, SMALL)
    worker.work(campaign, until=lambda now: now["generation"] >= 1)
    (job,) = expect(client.get("/api/v1/jobs", params={"status": "quarantined"}))["jobs"]
    assert job["kind"] == "dataset-evaluation"
    early = expect(client.post(f"/api/v1/jobs/{job['id']}/retry"), 409)
    assert f"the campaign continued without solution {job['number']}" in early["detail"]
    assert worker.work(campaign)["status"] == "finished"
    late = expect(client.post(f"/api/v1/jobs/{job['id']}/retry"), 409)
    assert f"campaign {campaign} is finished; nothing waits for the job" in late["detail"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Finished:
    """A coordinator with a finished campaign that searched on data."""

    client: httpx.Client
    id: str

    def get(self, path: str, status: int = 200, **params: Any) -> Any:
        """Send a GET request to a path below the campaign and return the answer."""
        return expect(self.client.get(f"/api/v1/campaigns/{self.id}{path}", params=params), status)


@pytest.fixture(scope="module")
def finished(module_databases: Databases) -> Iterator[Finished]:
    """One finished campaign, shared by the tests that only read it."""
    with small_problems(), module_databases.database() as url, listening_coordinator(url) as client:
        yield Finished(client=client, id=finish(client, SIMOOD, simulate))


def test_search_on_data_simulates_its_finalists(finished: Finished) -> None:
    done = progress(finished.client, finished.id)
    digest, asked = search_without_coordinator()
    measured = sum(candidate.question is Question.DATASET for candidate in asked)
    simulated = len(asked) - measured
    assert simulated > 12, "4 finalists with 3 repeats, and the parts of those that are hazardous"
    assert (done["measured"], done["evaluated"], done["failed"]) == (measured, simulated, 0)
    assert done["simulations"] == len(asked)
    assert done["digest"] == digest
    best = [generation["best_fitness"] for generation in done["generations"]]
    assert best == sorted(best, reverse=True)
    assert done["generations"][-1]["measured"] == measured
    seeds: dict[str, set[int]] = {}
    for solution in finished.get("/solutions", limit=1000)["solutions"]:
        if solution["verdict"] in ("safe", "unsafe"):
            seeds.setdefault(str(solution["parameters"]["scenario"]), set()).add(solution["seed"])
    assert len(seeds) == 3
    assert all(len(of_scenario) == 1 for of_scenario in seeds.values()), "one seed for each scenario"


def test_measured_solutions_are_listed_but_not_archived(finished: Finished) -> None:
    done = progress(finished.client, finished.id)
    solutions = finished.get("/solutions", limit=1000)["solutions"]
    measured = [solution for solution in solutions if solution["verdict"] == "measured"]
    assert len(measured) == done["measured"]
    for solution in measured:
        assert 0 < solution["objectives"]["alpha"] <= 1
        assert solution["robustness"] is None
        assert solution["fitness"] is None
    archive = finished.client.get(f"/api/v1/campaigns/{finished.id}/archive.npz")
    with np.load(io.BytesIO(archive.content), allow_pickle=False) as npz:
        assert len(npz["numbers"]) == done["evaluated"]
    jobs = expect(finished.client.get("/api/v1/jobs", params={"campaign": finished.id, "limit": 1000}))[
        "jobs"
    ]
    assert [job["kind"] for job in jobs].count("dataset-evaluation") == done["measured"]
    refused = finished.get(f"/solutions/{measured[0]['number']}/trace", 404)
    assert "no simulated solution" in refused["detail"]


def test_search_on_data_continues_after_a_restart(database_url: str, small_problems: None) -> None:
    with coordinator(database_url) as client:
        campaign = submit(client, SIMOOD)
        FakeWorker(client, judge=simulate).work(campaign, until=lambda current: current["generation"] >= 3)
    with coordinator(database_url) as client:
        done = FakeWorker(client, judge=simulate).work(campaign)
    assert done["digest"] == search_without_coordinator()[0]


def test_search_on_data_is_rejected_for_a_problem_without_a_data_set(client: httpx.Client) -> None:
    body = {**SIMOOD, "problem": {"id": "slotted-blind@1"}}
    (error,) = expect(client.post("/api/v1/campaigns", json=body), 422)["errors"]
    assert error["pointer"] == "/algorithm/id"
    assert "data set" in error["message"]
    simulated = {**body, "algorithm": {"id": "simood-ga@1", "params": {"evaluate": "episode"}}}
    assert submit(client, simulated)


def test_every_simulated_chain_is_listed_with_its_parts(finished: Finished) -> None:
    found = finished.get("/combinations")
    chains = found["combinations"]
    hazardous = [one for one in chains if one["hazardous"]]
    assert hazardous, "a strong technique in the first place is unsafe"
    for one in chains:
        assert 1 <= one["trials"] <= 3
        assert one["words"] == ", then ".join(
            f"{step['technique']} {step['level']}/{step['levels']}" for step in one["chain"]
        )
    explained = [one for one in hazardous if one["parts"]]
    assert all({len(part["chain"]) for part in one["parts"]} == {0, 1} for one in explained)
    alone = {step["words"]: (step["alone_unsafe"], step["alone_trials"]) for step in found["steps"]}
    singles = [part for one in explained for part in one["parts"] if len(part["chain"]) == 1]
    assert all(alone[part["words"]] == (part["unsafe"], part["trials"]) for part in singles)


def slotted_alpha(chain: list[tuple[int, float]]) -> float:
    """Return the alpha of a chain of techniques with their intensities, as `Slotted` measures it."""
    (first, strong), (_, weak) = (*chain, (0, 0.0))[:2]
    return 1.0 / (1.0 + math.hypot(first, strong, weak))


def test_added_harm_of_a_chain_is_how_much_worse_it_is_than_its_worst_part(finished: Finished) -> None:
    genes = [
        parameter
        for parameter in Slotted(NoParams()).space.components[1].parameters
        if isinstance(parameter, Categorical) and parameter.name == "gene_1"
    ]
    names = [gene.choices for gene in genes]
    chains = finished.get("/combinations")["combinations"]
    assert finished.get("/combinations")["margin"] == 0.05
    explained = [one for one in chains if one["added_harm"] is not None]
    assert len(explained) >= 4, "every finalist was measured, and so was each of its techniques alone"
    for one in explained:
        chain = [(names[0].index(step["technique"]), step["level"] / step["levels"]) for step in one["chain"]]
        assert one["alpha"] == pytest.approx(slotted_alpha(chain))
        parts = [slotted_alpha([step]) for step in chain]
        assert one["added_harm"] == pytest.approx(min(parts) - one["alpha"])
        assert one["interacts"] == (min(parts) - one["alpha"] >= 0.05 - 1e-9)
    never_measured = [one for one in chains if one["alpha"] is None]
    assert all(one["added_harm"] is None and one["interacts"] is None for one in never_measured)


def test_problem_without_ordered_techniques_has_no_combinations(client: httpx.Client) -> None:
    body = {
        "name": "m",
        "problem": {"id": "mtq@1"},
        "algorithm": {"id": "random@1"},
        "budget": {"simulations": 60},
    }
    campaign = submit(client, body)
    for path in ("combinations", "solutions/0/variants"):
        detail = expect(client.get(f"/api/v1/campaigns/{campaign}/{path}"), 404)["detail"]
        assert "mtq@1 has no ordered techniques" in detail


def test_measurement_without_its_value_is_a_failure(client: httpx.Client) -> None:
    def omit_some_measurements(job: LeasedJob) -> Completed | JobFailed:
        if not job.spec["requirements"] and job.spec["behaviour"]["first"] == 2:
            return Completed(verdicts={}, objectives={})
        return outcome_of(job.spec)

    relaxed = {**SMALL, "execution": {"max_failed_share": 1.0}}
    done = FakeWorker(client, judge=omit_some_measurements).work(submit(client, relaxed))
    assert done["status"] == "finished"
    assert done["failed"] > 0
    assert done["evaluated"] >= 12
