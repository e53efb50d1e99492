"""Repeats over the API: a campaign that simulates boundary solutions again with other seeds."""

import json
from collections import Counter, defaultdict
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx
import pytest
from PIL import Image
from sqlalchemy import update
from support.api import FakeWorker, await_erasure, ball, coordinator, expect, progress, row_counts, submit
from support.databases import sqlite_then_postgres
from support.problems import REQUIREMENT
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.search.fitness import wilson_interval
from brink.search.sequential import exact_interval
from brink.server.db.engine import Engines
from brink.server.db.models import CampaignRow
from brink.server.queue import service
from brink.worker.wire import Completed, JobFailed, LeasedJob, WireVerdict

API = "/api/v1/campaigns"
WIDE: dict[str, float] = {"t_b": 0.5, "d_th": 0.05}


def by_chance(job: LeasedJob) -> Completed | JobFailed:
    """Return an outcome that depends on the seed alone: a third of all seeds is unsafe."""
    robustness = -1.0 if job.spec["seed"] % 3 == 0 else 1.0
    return Completed(verdicts={REQUIREMENT: WireVerdict(robustness=robustness, unit="m", violated_at_s=None)})


def never(job: LeasedJob) -> Completed | JobFailed:
    """Return an outcome that is safe with every seed."""
    return Completed(verdicts={REQUIREMENT: WireVerdict(robustness=1.0, unit="m", violated_at_s=None)})


def body(simulations: int = 60, *, generation_size: int = 60, **changes: Any) -> dict[str, Any]:
    """Return the body of a campaign whose solutions all lie on its boundary, since p_th is a third."""
    params = {"generation_size": generation_size, "p_th": 0.35, "radius": 1.0}
    return ball(simulations=simulations, algorithm={"id": "random@1", "params": params}, **changes)


def finished(client: httpx.Client, **changes: Any) -> str:
    campaign = submit(client, body(**changes))
    assert FakeWorker(client, judge=by_chance).work(campaign)["status"] == "finished"
    return campaign


def solutions(client: httpx.Client, campaign: str) -> list[dict[str, Any]]:
    page = expect(client.get(f"{API}/{campaign}/solutions", params={"limit": 1000}))
    found: list[dict[str, Any]] = page["solutions"]
    return found


@sqlite_then_postgres
def test_boundary_solutions_are_simulated_again_with_seeds_of_their_own(client: httpx.Client) -> None:
    campaign = finished(client)
    answer = client.post(f"{API}/{campaign}/repeats", json={"repeats": 12, **WIDE})
    view = expect(answer, 201)
    again = view["campaign"]
    assert answer.headers["Location"] == f"{API}/{again}"
    boundary = expect(client.get(f"{API}/{campaign}/boundary", params=WIDE))
    numbers = [solution["number"] for solution in boundary["solutions"]]
    assert len(numbers) >= 2
    assert [one["number"] for one in view["solutions"]] == numbers
    assert view["budget"] == 12 * len(numbers)
    assert (view["evaluated"], view["holding"]) == (0, 0)
    assert {one["holds"] for one in view["solutions"]} == {None}

    assert FakeWorker(client, judge=by_chance).work(again)["status"] == "finished"
    [view] = expect(client.get(f"{API}/{campaign}/repeats"))
    before, after = solutions(client, campaign), solutions(client, again)
    where = {json.dumps(s["parameters"]): s["number"] for s in before}
    assert len({s["seed"] for s in [*before, *after]}) == len(before) + len(after)
    counts: dict[int, Counter[str]] = defaultdict(Counter)
    for solution in after:
        counts[where[json.dumps(solution["parameters"])]][solution["verdict"]] += 1
    assert list(counts) == numbers
    for one in view["solutions"]:
        count = counts[one["number"]]
        assert (one["evaluated"], one["unsafe"]) == (12, count["unsafe"])
        assert (one["low"], one["high"]) == pytest.approx(exact_interval(count["unsafe"], 12, 0.95), abs=1e-4)
        assert one["holds"] == (one["low"] <= 0.35 <= one["high"])
        assert one["around_low"] <= one["around"] <= one["around_high"]
    sides = [view["near"], view["inconclusive"], view["below"], view["above"]]
    assert sum(sides) == len(numbers)
    assert view["holding"] == sum(one["holds"] for one in view["solutions"])
    assert view["holding"] == view["near"] + view["inconclusive"]
    low, high = wilson_interval(view["unsafe"], view["evaluated"], 1.96)
    assert view["pooled"] == pytest.approx([float(low), float(high)])


def test_repeats_that_are_never_unsafe_do_not_confirm_the_boundary(client: httpx.Client) -> None:
    campaign = submit(client, body())
    assert FakeWorker(client, judge=by_chance).work(campaign)["status"] == "finished"
    view = expect(client.post(f"{API}/{campaign}/repeats", json={"repeats": 3, **WIDE}), 201)
    FakeWorker(client, judge=never).work(view["campaign"])
    [view] = expect(client.get(f"{API}/{campaign}/repeats"))
    count, simulations = len(view["solutions"]), view["evaluated"]
    assert (view["unsafe"], view["holding"], simulations) == (0, count, 3 * count)
    assert (view["near"], view["inconclusive"]) == (0, count)
    assert {one["conclusion"] for one in view["solutions"]} == {"inconclusive"}
    assert f"0 of {simulations} simulations were unsafe, 0.0% (interval 0.0% to " in view["words"]
    assert f"{count} inconclusive with 3 simulations each" in view["words"]
    assert "Even a solution that is never unsafe takes 9 to fall below p_th." in view["words"]


@sqlite_then_postgres
def test_the_same_repeats_are_not_run_twice_and_others_are(client: httpx.Client, engines: Engines) -> None:
    campaign = finished(client)
    first = expect(client.post(f"{API}/{campaign}/repeats", json={"repeats": 3, **WIDE}), 201)
    same = expect(client.post(f"{API}/{campaign}/repeats", json={"repeats": 3, **WIDE}), 200)
    assert same["campaign"] == first["campaign"]
    other = expect(client.post(f"{API}/{campaign}/repeats", json={"repeats": 4, **WIDE}), 201)
    assert [one["repeats"] for one in expect(client.get(f"{API}/{campaign}/repeats"))] == [3, 4]
    expect(client.post(f"{API}/{other['campaign']}/cancel"))
    expect(client.post(f"{API}/{campaign}/repeats", json={"repeats": 4, **WIDE}), 201)
    assert row_counts(engines)["follow_ups"] == 3


@sqlite_then_postgres
def test_a_campaign_may_ask_for_repeats_itself(client: httpx.Client) -> None:
    campaign = finished(client, simulations=240, repeats=5)
    [view] = expect(client.get(f"{API}/{campaign}/repeats"))
    assert (view["repeats"], view["t_b"], view["d_th"]) == (5, 0.1, 0.2)
    assert FakeWorker(client, judge=by_chance).work(view["campaign"])["status"] == "finished"
    [view] = expect(client.get(f"{API}/{campaign}/repeats"))
    assert {one["evaluated"] for one in view["solutions"]} == {5}


@sqlite_then_postgres
def test_named_solutions_are_simulated_again_in_place_of_the_boundary(client: httpx.Client) -> None:
    campaign = finished(client)
    by_fitness = sorted(solutions(client, campaign), key=lambda one: (one["fitness"], one["number"]))
    best_first = [one["number"] for one in by_fitness if one["number"] in (3, 17, 42)]
    answer = client.post(f"{API}/{campaign}/repeats", json={"repeats": 6, "numbers": [42, 3, 17]})
    view = expect(answer, 201)
    assert answer.headers["Location"] == f"{API}/{view['campaign']}"
    assert [one["number"] for one in view["solutions"]] == best_first
    assert (view["selection"], view["t_b"], view["d_th"], view["budget"]) == ("numbers", None, None, 18)
    again = expect(client.get(f"{API}/{view['campaign']}"))
    assert again["name"] == "ball: 3 solutions again"
    assert FakeWorker(client, judge=by_chance).work(view["campaign"])["status"] == "finished"
    [view] = expect(client.get(f"{API}/{campaign}/repeats"))
    where = {one["number"]: one["parameters"] for one in by_fitness}
    simulated = Counter(json.dumps(one["parameters"]) for one in solutions(client, view["campaign"]))
    assert simulated == {json.dumps(where[number]): 6 for number in best_first}
    for one in view["solutions"]:
        assert one["evaluated"] == 6
        assert (one["low"], one["high"]) == pytest.approx(exact_interval(one["unsafe"], 6, 0.95), abs=1e-4)


@sqlite_then_postgres
def test_the_same_named_solutions_are_not_simulated_twice_and_others_are(client: httpx.Client) -> None:
    campaign = finished(client)

    def ask(status: int, *numbers: int, repeats: int = 3) -> str:
        wanted = {"repeats": repeats, "numbers": list(numbers)}
        return str(expect(client.post(f"{API}/{campaign}/repeats", json=wanted), status)["campaign"])

    one = ask(201, 5)
    assert ask(200, 5) == one
    assert len({one, ask(201, 6), ask(201, 5, repeats=4), ask(201, 5, 6)}) == 4
    assert ask(200, 6, 5) == ask(200, 5, 6), "in whatever order"
    boundary = expect(client.post(f"{API}/{campaign}/repeats", json={"repeats": 3, **WIDE}), 201)
    assert boundary["selection"] == "boundary"
    views = expect(client.get(f"{API}/{campaign}/repeats"))
    assert sorted(view["selection"] for view in views) == ["boundary", *["numbers"] * 4]
    episodes = [solution["seed"] for view in views for solution in solutions(client, view["campaign"])]
    assert len(set(episodes)) == len(episodes), "each with seeds of its own"


@sqlite_then_postgres
def test_a_boundary_without_thresholds_is_not_taken_for_solutions_named_by_number(
    client: httpx.Client,
) -> None:
    campaign = finished(client)
    every: dict[str, Any] = {"repeats": 3, "t_b": 1.0, "d_th": 0.0}
    named = expect(client.post(f"{API}/{campaign}/repeats", json={"repeats": 3, "numbers": [3, 17]}), 201)
    boundary = expect(client.post(f"{API}/{campaign}/repeats", json=every), 201)
    count = len(boundary["solutions"])
    assert (boundary["selection"], boundary["t_b"], boundary["d_th"]) == ("boundary", 1.0, 0.0)
    assert boundary["distinct"] == count
    assert boundary["words"].startswith(f"{count} boundary solutions, none simulated")
    assert (
        expect(client.post(f"{API}/{campaign}/repeats", json=every), 200)["campaign"] == boundary["campaign"]
    )
    views = {one["campaign"]: one for one in expect(client.get(f"{API}/{campaign}/repeats"))}
    assert views[named["campaign"]]["selection"] == "numbers"


def test_solutions_that_cannot_be_named_are_refused(client: httpx.Client, engines: Engines) -> None:
    campaign = finished(client)
    refused: tuple[tuple[dict[str, Any], str, str], ...] = (
        ({"numbers": [1, 9999]}, "/numbers/1", "has no evaluated solution 9999"),
        ({"numbers": [1, 2, 1]}, "", "numbers: expected each once, got 1 more than once"),
        ({"numbers": []}, "/numbers", "at least 1"),
        ({"numbers": [-1]}, "/numbers/0", "greater than or equal to 0"),
        ({"numbers": [1], "t_b": 0.2}, "", "expected either numbers or t_b, not both"),
        ({"numbers": list(range(1001))}, "/numbers", "at most 1000"),
    )
    for wanted, pointer, message in refused:
        [error] = expect(client.post(f"{API}/{campaign}/repeats", json=wanted), 422)["errors"]
        assert error["pointer"] == pointer
        assert message in error["message"]
        assert row_counts(engines)["follow_ups"] == 0


def test_named_solutions_wait_until_their_campaign_has_ended(client: httpx.Client) -> None:
    campaign = submit(client, ball())
    answer = expect(client.post(f"{API}/{campaign}/repeats", json={"numbers": [1]}), 409)
    assert "is running: wait until it has ended" in answer["detail"]


def test_the_command_shows_the_boundary_and_not_what_was_named(listening_client: httpx.Client) -> None:
    campaign = finished(listening_client)
    named = expect(
        listening_client.post(f"{API}/{campaign}/repeats", json={"repeats": 12, "numbers": [5]}), 201
    )
    wanted = ["repeats", campaign, "--repeats", "12", "--t-b", "1", "--d-th", "0"]
    shown = CliRunner().invoke(app, [*wanted, "--server", str(listening_client.base_url), "--json"])
    assert shown.exit_code == 0, shown.output
    assert len(expect(listening_client.get(f"{API}/{campaign}/repeats"))) == 2
    assert f'"campaign": "{named["campaign"]}"' not in shown.stdout


@sqlite_then_postgres
def test_a_running_campaign_has_no_boundary_to_repeat(client: httpx.Client) -> None:
    campaign = submit(client, ball())
    answer = expect(client.post(f"{API}/{campaign}/repeats", json={}), 409)
    assert "is running: its boundary is not known yet" in answer["detail"]
    assert expect(client.get(f"{API}/{campaign}/repeats")) == []


@sqlite_then_postgres
def test_no_boundary_no_repeats(client: httpx.Client) -> None:
    campaign = finished(client)
    answer = expect(client.post(f"{API}/{campaign}/repeats", json={"t_b": 0.0}), 409)
    assert "has no boundary solutions at t_b 0, d_th 0.2" in answer["detail"]


@sqlite_then_postgres
def test_what_is_computed_is_not_repeated(client: httpx.Client) -> None:
    computed = ball(problem={"id": "mtq@1"}, repeats=5)
    answer = expect(client.post(API, json=computed), 422)
    assert [(e["pointer"], e["message"]) for e in answer["errors"]] == [
        ("/repeats", "mtq@1 is computed, not simulated: other seeds give the same verdicts")
    ]


@sqlite_then_postgres
def test_a_campaign_is_deleted_with_its_repeats_once_they_ended(
    client: httpx.Client, engines: Engines
) -> None:
    campaign = finished(client)
    view = expect(client.post(f"{API}/{campaign}/repeats", json={"repeats": 3, **WIDE}), 201)
    answer = expect(client.delete(f"{API}/{campaign}"), 409)
    assert f"campaign {view['campaign']}, a follow-up of {campaign}, is running" in answer["detail"]
    expect(client.post(f"{API}/{view['campaign']}/cancel"))
    expect(client.delete(f"{API}/{campaign}"), 204)
    await_erasure(engines)
    counts = row_counts(engines)
    assert (counts["campaigns"], counts["follow_ups"], counts["solutions"], counts["jobs"]) == (0, 0, 0, 0)


@sqlite_then_postgres
def test_a_worker_that_waits_is_woken(client: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    for pause in ("RECHECK_S", "SHARED_RECHECK_S"):  # a look now and then would find them, too
        monkeypatch.setattr(service, pause, 600.0)
    submit(client, body(600, repeats=5, generation_size=600))
    last, waiting = (FakeWorker(client, id=name, judge=by_chance) for name in ("last", "waiting"))
    jobs: list[LeasedJob] = []
    while batch := last.lease(max_jobs=128):
        jobs += batch
    for first in range(1, len(jobs), 200):
        last.report(jobs[first : first + 200])
    with ThreadPoolExecutor(1) as thread:
        leased = thread.submit(waiting.lease, 8, 60.0)
        last.report(jobs[:1])
        assert leased.result()


def test_repeats_go_on_after_the_coordinator_is_gone(database_url: str, small_problems: None) -> None:
    with coordinator(database_url) as client:
        campaign = submit(client, body(240, repeats=12))
        FakeWorker(client, judge=by_chance).work(campaign)
        [view] = expect(client.get(f"{API}/{campaign}/repeats"))
        worker = FakeWorker(client, judge=by_chance)
        worker.report(worker.lease())
    with coordinator(database_url) as client:
        assert FakeWorker(client, judge=by_chance).work(view["campaign"])["status"] == "finished"
        [view] = expect(client.get(f"{API}/{campaign}/repeats"))
        assert {one["evaluated"] for one in view["solutions"]} == {12}


def test_the_command_asks_then_shows_what_came(listening_client: httpx.Client, tmp_path: Path) -> None:
    campaign = finished(listening_client)
    picture = tmp_path / "repeats.png"
    wanted = ["repeats", campaign, "--repeats", "12", "--t-b", "0.5", "--d-th", "0.05"]
    server = ["--server", str(listening_client.base_url)]
    asked = CliRunner().invoke(app, [*wanted, *server])
    assert asked.exit_code == 0, asked.output
    assert "the same command shows its progress" in asked.output
    [view] = expect(listening_client.get(f"{API}/{campaign}/repeats"))
    FakeWorker(listening_client, judge=by_chance).work(view["campaign"])
    shown = CliRunner().invoke(app, [*wanted, *server, "--picture", str(picture)])
    assert shown.exit_code == 0, shown.output
    [view] = expect(listening_client.get(f"{API}/{campaign}/repeats"))
    count = len(view["solutions"])
    assert view["words"] in shown.output
    assert f"{count} boundary solutions" in view["words"]
    assert f"{view['inconclusive']} inconclusive with 12 simulations each" in view["words"]
    with Image.open(picture) as drawn:
        assert drawn.width == 1600


def test_unfinished_repeats_are_not_shown_as_a_verdict_nor_resumed(listening_client: httpx.Client) -> None:
    campaign = finished(listening_client)
    wanted = ["repeats", campaign, "--repeats", "12", "--t-b", "0.5", "--d-th", "0.05"]
    command = [*wanted, "--server", str(listening_client.base_url)]
    assert CliRunner().invoke(app, command).exit_code == 0
    [view] = expect(listening_client.get(f"{API}/{campaign}/repeats"))
    count = len(view["solutions"])
    worker = FakeWorker(listening_client, judge=by_chance)
    while (stands := progress(listening_client, view["campaign"]))["generation"] < 1:
        assert stands["status"] == "running"
        worker.report(worker.lease())
    expect(listening_client.post(f"{API}/{view['campaign']}/pause"))
    shown = CliRunner().invoke(app, command)
    assert shown.exit_code == 0, shown.output
    assert f"{count} boundary solutions" in shown.output
    assert "fewer than 12 repeats of each so far" in shown.output
    assert "paused" in shown.output
    assert "By solution" not in shown.output
    assert progress(listening_client, view["campaign"])["status"] == "paused", "whoever looks does not resume"


@sqlite_then_postgres
def test_retention_keeps_campaigns_with_young_repeats(
    client: httpx.Client, engines: Engines, database_url: str
) -> None:
    campaign = finished(client)
    view = expect(client.post(f"{API}/{campaign}/repeats", json={"repeats": 3, **WIDE}), 201)
    command = ["db", "prune", "--ended-days", "30", "--yes", "--database", database_url]
    with engines.writer.begin() as connection:
        ended = update(CampaignRow).where(CampaignRow.id == campaign)
        connection.execute(ended.values(finished_at=datetime(2020, 1, 1, tzinfo=UTC)))
    assert CliRunner().invoke(app, command).exit_code == 0
    assert row_counts(engines)["campaigns"] == 2, "they run"
    FakeWorker(client, judge=by_chance).work(view["campaign"])
    assert CliRunner().invoke(app, command).exit_code == 0
    assert row_counts(engines)["campaigns"] == 2, "they ended just now"
    with engines.writer.begin() as connection:
        connection.execute(update(CampaignRow).values(finished_at=datetime(2020, 1, 1, tzinfo=UTC)))
    assert CliRunner().invoke(app, command).exit_code == 0
    assert row_counts(engines)["campaigns"] == 0


def test_an_experiment_is_not_deleted_while_its_boundaries_are_repeated(client: httpx.Client) -> None:
    one = body()
    document = {
        "name": "small",
        "problems": [one["problem"]],
        "algorithms": [one["algorithm"]],
        "seeds": [1],
        "budget": one["budget"],
    }
    found = expect(client.post("/api/v1/experiments", json=document), 201)
    campaign = found["members"][0]["campaign"]
    FakeWorker(client, judge=by_chance).work(campaign)
    view = expect(client.post(f"{API}/{campaign}/repeats", json={"repeats": 3, **WIDE}), 201)
    answer = expect(client.delete(f"/api/v1/experiments/{found['id']}"), 409)
    assert view["campaign"] in answer["detail"]
    expect(client.post(f"{API}/{view['campaign']}/cancel"))
    expect(client.delete(f"/api/v1/experiments/{found['id']}"), 204)


def test_a_picture_of_another_kind_is_refused_before_anything_is_simulated() -> None:
    said = CliRunner().invoke(app, ["repeats", "3f2a", "--picture", "out.txt"])
    assert said.exit_code != 0
    assert "ends in .png, .svg or .pdf" in str(said.exception)
