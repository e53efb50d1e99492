"""What a finished campaign shows over the REST API: read-only looks at one campaign a database."""

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import httpx
import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families
from support.api import FakeWorker, ball, coordinator, expect, progress, submit
from support.databases import Databases
from support.problems import small_problems

OPENAPI_PATHS = ("/api/v1/campaigns", "/api/v1/jobs/lease", "/api/v1/jobs/heartbeat", "/api/v1/jobs/results")


@dataclass(frozen=True, slots=True, kw_only=True)
class Finished:
    """A coordinator with one finished campaign."""

    client: httpx.Client
    id: str

    def get(self, path: str, **params: Any) -> Any:
        """Return what a GET below the campaign answers."""
        return expect(self.client.get(f"/api/v1/campaigns/{self.id}{path}", params=params))


@pytest.fixture(scope="module")
def finished(databases_of_file: Databases) -> Iterator[Finished]:
    with small_problems(), databases_of_file.database() as url, coordinator(url) as client:
        campaign = submit(client, ball(simulations=200))
        assert FakeWorker(client).work(campaign)["status"] == "finished"
        yield Finished(client=client, id=campaign)


def test_a_finished_campaign_tells_its_counts_and_its_digest(finished: Finished) -> None:
    done = progress(finished.client, finished.id)
    assert done["status"] == "finished"
    assert done["simulations"] == done["evaluated"] >= 200
    assert 0 < done["unsafe"] < done["evaluated"]
    assert (done["queued"], done["leased"], done["failed"], done["remaining_s"]) == (0, 0, 0, None)
    assert len(done["digest"]) == 64
    last = done["generations"][-1]
    assert (last["evaluated"], last["unsafe"]) == (done["evaluated"], done["unsafe"])
    assert [g["number"] for g in done["generations"]] == list(range(done["generation"]))


def test_progress_since_a_generation_returns_the_later_ones(finished: Finished) -> None:
    done = progress(finished.client, finished.id)
    later = progress(finished.client, finished.id, since=done["generation"] - 2)
    assert later["generations"] == done["generations"][-2:]
    assert progress(finished.client, finished.id, since=10**6)["generations"] == []


def test_a_known_etag_is_answered_without_a_body(finished: Finished) -> None:
    path = f"/api/v1/campaigns/{finished.id}/progress"
    first = finished.client.get(path)
    again = finished.client.get(path, headers={"If-None-Match": first.headers["ETag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert again.headers["ETag"] == first.headers["ETag"]
    other = finished.client.get(path, params={"since": 1}, headers={"If-None-Match": first.headers["ETag"]})
    assert other.status_code == 200


def test_a_campaign_is_found_by_the_beginning_of_its_id(finished: Finished) -> None:
    found = expect(finished.client.get(f"/api/v1/campaigns/{finished.id[:4]}"))
    assert found["id"] == finished.id
    assert found["body"]["problem"]["id"] == "ball@1"


def test_a_campaign_names_every_parameter_that_it_ran_with(finished: Finished) -> None:
    body = expect(finished.client.get(f"/api/v1/campaigns/{finished.id}"))["body"]
    assert body["problem"]["params"]["limit"] == 1.0
    assert body["algorithm"]["params"]


@pytest.mark.parametrize(
    "path", ["", "/progress", "/solutions", "/boundary", "/archive.npz", "/distances?numbers=0"]
)
def test_an_unknown_campaign_is_not_found(finished: Finished, path: str) -> None:
    document = expect(finished.client.get(f"/api/v1/campaigns/zzzz{path}"), 404)
    assert "zzzz" in document["detail"]


def test_solutions_come_page_by_page(finished: Finished) -> None:
    everything = finished.get("/solutions", limit=1000)
    assert everything["next"] is None
    paged: list[Any] = []
    after: int | None = -1
    while after is not None:
        page = finished.get("/solutions", after=after, limit=70)
        paged += page["solutions"]
        after = page["next"]
    assert paged == everything["solutions"]
    assert [s["number"] for s in paged] == list(range(len(paged)))


def test_a_solution_shows_its_parameters_verdict_and_place(finished: Finished) -> None:
    for solution in finished.get("/solutions", limit=20)["solutions"]:
        x, y = solution["parameters"]["where"]["x"], solution["parameters"]["what"]["y"]
        assert solution["robustness"] == pytest.approx(np.hypot(x, y) - 1.0)
        assert solution["verdict"] == ("unsafe" if solution["robustness"] < 0 else "safe")
        assert solution["objectives"]["distance"] == pytest.approx(np.hypot(x, y))
        assert solution["neighbours"] >= 1
        assert 0 <= solution["unsafe_neighbours"] <= solution["neighbours"]
        assert 0 <= solution["fitness"] <= 1


def test_solutions_are_filtered_by_verdict_and_fitness(finished: Finished) -> None:
    everything = finished.get("/solutions", limit=1000)["solutions"]
    bound = float(np.median([s["fitness"] for s in everything]))
    for unsafe in (True, False):
        chosen = finished.get("/solutions", limit=1000, unsafe=unsafe, max_fitness=bound)["solutions"]
        verdict = "unsafe" if unsafe else "safe"
        assert chosen == [s for s in everything if s["verdict"] == verdict and s["fitness"] <= bound]
        assert finished.get("/solutions", limit=1000, unsafe=unsafe)["solutions"] == [
            s for s in everything if s["verdict"] == verdict
        ]


def test_one_solution_shows_its_episode(finished: Finished) -> None:
    solution = finished.get("/solutions/3")
    assert solution["spec"]["simulator"] == "faulty@1"
    assert solution["spec"]["seed"] == solution["seed"]
    assert solution["spec"]["scenario"]["x"] == solution["parameters"]["where"]["x"]
    assert solution["verdicts"]["distance@1"]["robustness"] == solution["robustness"]
    expect(finished.client.get(f"/api/v1/campaigns/{finished.id}/solutions/99999"), 404)


def test_the_boundary_is_the_same_as_json_and_as_csv(finished: Finished) -> None:
    boundary = finished.get("/boundary", t_b=0.3, d_th=0.05)
    assert boundary["dbs"] == len(boundary["solutions"]) >= 1
    assert boundary["strict_dbs"] == len(boundary["strict"])
    assert all(solution["fitness"] <= 0.3 for solution in boundary["solutions"])
    answer = finished.client.get(
        f"/api/v1/campaigns/{finished.id}/boundary", params={"t_b": 0.3, "d_th": 0.05, "format": "csv"}
    )
    assert answer.headers["content-type"].startswith("text/csv")
    rows = list(csv.DictReader(io.StringIO(answer.text)))
    assert [int(row["number"]) for row in rows] == [s["number"] for s in boundary["solutions"]]
    assert [float(row["where.x"]) for row in rows] == [
        s["parameters"]["where"]["x"] for s in boundary["solutions"]
    ]
    assert [row["strict"] == "True" for row in rows] == [
        s["number"] in boundary["strict"] for s in boundary["solutions"]
    ]


def test_boundary_solutions_lie_apart(finished: Finished) -> None:
    boundary = finished.get("/boundary", t_b=0.5, d_th=0.1)
    numbers = [s["number"] for s in boundary["solutions"]]
    block = finished.get("/distances", numbers=",".join(map(str, numbers)))
    distances = np.array(block["distances"])
    assert block["numbers"] == numbers
    assert np.array_equal(distances, distances.T)
    assert np.all(np.diag(distances) == 0)
    assert np.all(distances[~np.eye(len(numbers), dtype=bool)] >= 0.1)


@pytest.mark.parametrize(("numbers", "status"), [("1,x", 422), ("0,99999", 404), ("", 422)])
def test_distances_of_nothing_are_refused(finished: Finished, numbers: str, status: int) -> None:
    path = f"/api/v1/campaigns/{finished.id}/distances"
    expect(finished.client.get(path, params={"numbers": numbers}), status)


def test_the_archive_holds_all_solutions(finished: Finished) -> None:
    answer = finished.client.get(f"/api/v1/campaigns/{finished.id}/archive.npz")
    with np.load(io.BytesIO(answer.content), allow_pickle=False) as npz:
        arrays = {name: npz[name] for name in npz.files}
    everything = finished.get("/solutions", limit=1000)["solutions"]
    assert arrays["numbers"].tolist() == [s["number"] for s in everything]
    assert arrays["unsafe"].tolist() == [s["verdict"] == "unsafe" for s in everything]
    assert arrays["fitness"].tolist() == [s["fitness"] for s in everything]
    assert arrays["neighbours"].tolist() == [s["neighbours"] for s in everything]
    assert arrays["vectors"].shape == (len(everything), 2)
    assert arrays["columns"].tolist() == ["where.x", "what.y"]
    assert arrays["choices"].tolist() == ["", ""]


def test_jobs_and_workers_are_listed(finished: Finished) -> None:
    jobs = expect(finished.client.get("/api/v1/jobs", params={"status": "done", "limit": 3}))
    assert [job["status"] for job in jobs["jobs"]] == ["done"] * 3
    more = expect(finished.client.get("/api/v1/jobs", params={"after": jobs["next"], "limit": 1000}))
    assert min(job["id"] for job in more["jobs"]) > jobs["next"]
    assert expect(finished.client.get("/api/v1/jobs", params={"campaign": "zzzz"}))["jobs"] == []
    (worker,) = expect(finished.client.get("/api/v1/workers"))
    assert worker["id"] == "worker-1"
    assert worker["live"]
    assert worker["capabilities"] == ["faulty@1"]
    assert worker["jobs_failed"] == 0


def test_the_catalogue_describes_parameters_as_json_schemas(finished: Finished) -> None:
    problems = {item["id"]: item for item in expect(finished.client.get("/api/v1/problems"))}
    assert {"ball@1", "line@1", "mtq@1", "onemax@1", "urban-injected@1"} <= set(problems)
    limit = problems["ball@1"]["params"]["properties"]["limit"]
    assert (limit["type"], limit["default"], limit["exclusiveMinimum"], limit["unit"]) == (
        "number",
        1.0,
        0.0,
        "m",
    )
    assert problems["ball@1"]["simulator"] == "faulty@1"
    assert problems["mtq@1"]["simulator"] is None
    assert [c["name"] for c in problems["ball@1"]["space"]["components"]] == ["where", "what"]
    algorithms = {item["id"]: item for item in expect(finished.client.get("/api/v1/algorithms"))}
    assert {"mlcshe@1", "ga@1", "random@1"} <= set(algorithms)
    assert algorithms["mlcshe@1"]["params"]["properties"]["population_size"]["minimum"] == 2


def test_health_readiness_and_metrics_are_at_the_root(finished: Finished) -> None:
    assert finished.client.get("/healthz").text == "ok\n"
    assert finished.client.get("/readyz").text == "ready\n"
    metrics = finished.client.get("/metrics").text
    assert 'brink_campaigns{status="finished"} 1.0' in metrics
    assert "brink_workers_live 1.0" in metrics
    samples = {
        (sample.name, *sorted(sample.labels.values())): sample.value
        for family in text_string_to_metric_families(metrics)
        for sample in family.samples
    }
    stands = finished.get("/progress")
    # Equal simulations run once; pictures run again.
    assert samples["brink_results_total", "accepted"] >= stands["simulations"] // 2
    assert samples[("brink_step_seconds_count",)] == stands["generation"]
    assert samples[("brink_commit_seconds_count",)] >= stands["generation"]
    assert samples["brink_request_seconds_count", "/jobs/results", "2xx", "POST"] >= 1
    assert finished.id not in metrics, "labels have few values"


def test_the_api_describes_itself(finished: Finished) -> None:
    document = expect(finished.client.get("/openapi.json"))
    assert set(OPENAPI_PATHS) <= set(document["paths"])


def test_an_unknown_path_is_answered_in_problem_json(finished: Finished) -> None:
    answer = finished.client.get("/api/v1/nothing")
    assert answer.status_code == 404
    assert answer.headers["content-type"] == "application/problem+json"


def test_an_ended_campaign_cannot_be_controlled(finished: Finished) -> None:
    for verb in ("pause", "resume", "cancel"):
        document = expect(finished.client.post(f"/api/v1/campaigns/{finished.id}/{verb}"), 409)
        assert "finished" in document["detail"]
