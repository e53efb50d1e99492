"""A finished campaign over the API: progress, solutions, boundary, archive, neighbours, scores."""

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import httpx
import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families
from sqlalchemy import insert, select
from support.api import FakeWorker, ball, coordinator, expect, progress, submit
from support.databases import Databases, module_sqlite_then_postgres
from support.problems import small_problems

from brink.search.analysis.paper import D_THS, PAPER_FRACTIONS, PAPER_T_BS
from brink.search.fitness import wilson_interval
from brink.server.db.engine import Engines
from brink.server.db.models import CampaignRow


@dataclass(frozen=True, slots=True, kw_only=True)
class Finished:
    """A coordinator with a finished campaign."""

    client: httpx.Client
    id: str

    def get(self, path: str, **params: Any) -> Any:
        """Return the answer to a GET below the campaign."""
        return expect(self.client.get(f"/api/v1/campaigns/{self.id}{path}", params=params))


@pytest.fixture(scope="module")
def finished(module_databases: Databases) -> Iterator[Finished]:
    with small_problems(), module_databases.database() as url, coordinator(url) as client:
        campaign = submit(client, ball(simulations=200))
        assert FakeWorker(client).work(campaign)["status"] == "finished"
        yield Finished(client=client, id=campaign)


def test_progress_has_counts_and_digest(finished: Finished) -> None:
    done = progress(finished.client, finished.id)
    assert done["status"] == "finished"
    assert done["simulations"] == done["evaluated"] >= 200
    assert 0 < done["unsafe"] < done["evaluated"]
    assert (done["queued"], done["leased"], done["failed"], done["remaining_s"]) == (0, 0, 0, None)
    assert len(done["digest"]) == 64
    last = done["generations"][-1]
    assert (last["evaluated"], last["unsafe"]) == (done["evaluated"], done["unsafe"])
    assert [g["number"] for g in done["generations"]] == list(range(done["generation"]))


def test_ambiguous_prefix_names_what_it_could_be(client: httpx.Client, engines: Engines) -> None:
    campaign = submit(client, ball())
    prefix = next(two for two in ("ab", "cd") if not campaign.startswith(two))
    ids = [f"{prefix}{letter}00000" for letter in "cdefgh"]
    with engines.writer.begin() as connection:
        row = (
            connection.execute(select(CampaignRow.__table__).where(CampaignRow.id == campaign))
            .mappings()
            .one()
        )
        connection.execute(insert(CampaignRow), [{**row, "id": one} for one in ids])
    detail = expect(client.get(f"/api/v1/campaigns/{prefix}"), 404)["detail"]
    assert detail == (
        f"campaign '{prefix}': more than one campaign has an id with this prefix: "
        f"{', '.join(ids[:5])} and more; give more characters"
    )
    assert "at least 2 characters" in expect(client.get(f"/api/v1/campaigns/{prefix[0]}"), 404)["detail"]


def test_campaign_is_found_by_a_prefix_of_its_id(finished: Finished) -> None:
    found = expect(finished.client.get(f"/api/v1/campaigns/{finished.id[:4]}"))
    assert found["id"] == finished.id
    assert found["body"]["problem"]["id"] == "ball@1"


@pytest.mark.parametrize(
    "path", ["", "/progress", "/solutions", "/boundary", "/archive.npz", "/distances?numbers=0"]
)
def test_unknown_campaign_is_not_found(finished: Finished, path: str) -> None:
    document = expect(finished.client.get(f"/api/v1/campaigns/zzzz{path}"), 404)
    assert "zzzz" in document["detail"]


def test_solutions_come_in_pages(finished: Finished) -> None:
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


def test_solution_has_parameters_verdict_and_neighbourhood(finished: Finished) -> None:
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


def test_single_solution_has_its_episode(finished: Finished) -> None:
    solution = finished.get("/solutions/3")
    assert solution["spec"]["simulator"] == "faulty@1"
    assert solution["spec"]["seed"] == solution["seed"]
    assert solution["spec"]["scenario"]["x"] == solution["parameters"]["where"]["x"]
    assert solution["verdicts"]["distance@1"]["robustness"] == solution["robustness"]
    expect(finished.client.get(f"/api/v1/campaigns/{finished.id}/solutions/99999"), 404)


def test_boundary_is_the_same_as_json_and_as_csv(finished: Finished) -> None:
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


def test_boundary_names_the_figure_that_comparisons_use(finished: Finished) -> None:
    t_bs, d_ths = PAPER_T_BS, D_THS
    i, j = len(t_bs) - 1, 0
    done = progress(finished.client, finished.id)
    boundary = finished.get("/boundary", t_b=t_bs[i], d_th=d_ths[j])
    within, scores = boundary["within_budget"], finished.get("/scores")
    assert (within["simulations"], within["beyond"]) == (200, done["evaluated"] - 200)
    assert within["beyond"] > 0
    assert within["dbs"] == scores["dbs"][-1][i][j]
    assert within["strict_dbs"] == scores["strict"][-1][i][j]
    assert f"comparisons: {within['dbs']} distinct, {within['strict_dbs']} strict." in boundary["note"]


@pytest.mark.parametrize(("numbers", "status"), [("1,x", 422), ("0,99999", 404), ("", 422)])
def test_distances_of_unknown_solutions_are_rejected(finished: Finished, numbers: str, status: int) -> None:
    path = f"/api/v1/campaigns/{finished.id}/distances"
    expect(finished.client.get(path, params={"numbers": numbers}), status)


@module_sqlite_then_postgres
def test_archive_has_all_solutions(finished: Finished) -> None:
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


@module_sqlite_then_postgres
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


def test_catalogue_describes_parameters_as_json_schemas(finished: Finished) -> None:
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
    done = finished.get("/progress")
    # Equal simulations run once; replays run again.
    assert samples["brink_results_total", "accepted"] >= done["simulations"] // 2
    assert samples[("brink_step_seconds_count",)] == done["generation"]
    assert samples[("brink_commit_seconds_count",)] >= done["generation"]
    assert samples["brink_request_seconds_count", "/jobs/results", "2xx", "POST"] >= 1
    assert finished.id not in metrics, "a campaign id as a label would have too many values"


def test_unknown_path_is_answered_with_problem_json(finished: Finished) -> None:
    answer = finished.client.get("/api/v1/nothing")
    assert answer.status_code == 404
    assert answer.headers["content-type"] == "application/problem+json"


def test_ended_campaign_cannot_be_controlled(finished: Finished) -> None:
    for verb in ("pause", "resume", "cancel"):
        document = expect(finished.client.post(f"/api/v1/campaigns/{finished.id}/{verb}"), 409)
        assert "finished" in document["detail"]


def test_nearest_neighbours_agree_with_the_distance_matrix(finished: Finished) -> None:
    solutions = finished.get("/solutions", limit=1000)["solutions"]
    numbers = [solution["number"] for solution in solutions if solution["fitness"] is not None]
    block = finished.get("/distances", numbers=",".join(map(str, numbers)))
    by_number = {solution["number"]: solution for solution in solutions}
    for place in (0, 7, len(numbers) - 1):
        number = numbers[place]
        found = finished.get(f"/solutions/{number}/neighbours", most=5)
        row = block["distances"][place]
        order = sorted((d, n) for d, n in zip(row, numbers, strict=True) if n != number)[:5]
        assert [(one["distance"], one["number"]) for one in found["nearest"]] == [
            (pytest.approx(distance, abs=1e-6), other) for distance, other in order
        ]
        for one in found["nearest"]:
            other = by_number[one["number"]]
            assert one["unsafe"] == (other["verdict"] == "unsafe")
            assert (one["robustness"], one["fitness"]) == (other["robustness"], other["fitness"])
            assert one["within"] == (one["distance"] <= found["radius"])
        itself = by_number[number]
        assert (found["neighbours"], found["unsafe_neighbours"]) == (
            itself["neighbours"],
            itself["unsafe_neighbours"],
        )
        low, high = wilson_interval(found["unsafe_neighbours"], found["neighbours"], 1.96)
        assert found["interval"] == pytest.approx((float(low), float(high)))
        assert (found["evaluated"], found["p_th"]) == (len(numbers), 0.1)
        assert found["confidence"] == pytest.approx(0.95, abs=1e-4)
        assert found["rated"]


def scores(client: httpx.Client, campaign: str) -> dict[str, Any]:
    found: dict[str, Any] = expect(
        client.get(f"/api/v1/campaigns/{campaign}/scores", params={"wait_s": 60}), 200
    )
    return found


def test_scores_are_available_once_the_campaign_has_ended(client: httpx.Client) -> None:
    campaign = submit(client, ball(simulations=60))
    assert "once it has ended" in expect(client.get(f"/api/v1/campaigns/{campaign}/scores"), 409)["detail"]
    assert FakeWorker(client).work(campaign)["status"] == "finished"
    found = scores(client, campaign)
    assert (found["id"], found["name"], found["status"]) == (campaign, "ball", "finished")
    assert (found["fractions"], found["t_bs"], found["d_ths"]) == (
        list(PAPER_FRACTIONS),
        list(PAPER_T_BS),
        list(D_THS),
    )
    assert found["evaluated"] == 60
    assert found["unsafe_share"] == pytest.approx(found["unsafe"] / 60)
    assert (found["control"], found["says"]) == (None, []), "the ball has no component called scenario"
    if progress(client, campaign)["simulations"] == 60:
        grid = expect(client.get(f"/api/v1/campaigns/{campaign}/boundary"))["grid"]
        assert [cell["dbs"] for cell in grid] == [figure for row in found["dbs"][-1] for figure in row]
        assert [cell["strict_dbs"] for cell in grid] == [f for row in found["strict"][-1] for f in row]
    expect(client.get("/api/v1/campaigns/nosuch/scores"), 404)
