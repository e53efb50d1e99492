"""Plug-ins that were edited under the same id: their results are neither shared nor mixed, and that is said."""

import asyncio
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest
from support.api import FakeWorker, ball, coordinator, eventually, expect, progress, submit
from support.databases import Databases
from support.problems import SIMULATOR
from typer.testing import CliRunner

from brink.api.client import Api
from brink.api.runs import CampaignRun, ExperimentRun
from brink.cli.commands import app
from brink.server.campaigns.body import parse_body
from brink.server.db.engine import Engines
from brink.server.experiments.body import parse_experiment
from brink.server.states import CampaignStatus
from brink.sim import catalogue
from brink.sim.catalogue import SIMULATORS, register

API = "/api/v1/campaigns"
Edit = Callable[[], None]


class Faulty:
    """Stands for the simulator, which only its id and its source matter of here."""


@pytest.fixture
def edit(monkeypatch: pytest.MonkeyPatch, small_problems: None) -> Edit:
    """Registers the simulator on the coordinator; pretends that problem and simulator were edited, and reloaded."""
    registered = {group: dict(plugins) for group, plugins in catalogue._registered.items()}
    monkeypatch.setattr(catalogue, "_registered", registered)
    register(SIMULATORS, SIMULATOR, Faulty)
    return lambda: monkeypatch.setattr(f"{catalogue.__name__}.modules_digest", lambda _: "e" * 64)


def finished(client: httpx.Client, name: str) -> str:
    campaign = submit(client, {**ball(), "name": name})
    assert FakeWorker(client).work(campaign)["status"] == "finished"
    return campaign


def test_results_of_other_code_are_not_in_the_cache(engines: Engines, database_url: str, edit: Edit) -> None:
    with coordinator(database_url) as client:
        finished(client, "before")
        same = progress(client, finished(client, "same"))
        assert same["cached"] == same["simulations"] >= 60
    edit()
    with coordinator(database_url) as client:
        assert progress(client, finished(client, "after"))["cached"] == 0
        assert progress(client, finished(client, "after again"))["cached"] == same["simulations"]


def test_a_campaign_is_not_continued_with_other_code(engines: Engines, database_url: str, edit: Edit) -> None:
    with coordinator(database_url) as client:
        campaign = submit(client, ball())
        FakeWorker(client).lease(max_jobs=3)
    edit()
    with coordinator(database_url) as client:
        eventually(lambda: progress(client, campaign)["status"] == "paused", "the first sweep pauses it")
        reason = progress(client, campaign)["status_reason"]
        assert "simulated with different code of ball@1 (source " in reason
        assert f"{SIMULATOR} (source " in reason
        assert "here eeeeeeee" in reason
        assert "submit it again" in reason


def test_a_coordinator_without_the_simulator_does_not_pause_the_campaign_of_one_that_has_it(
    engines: Engines, database_url: str, edit: Edit, monkeypatch: pytest.MonkeyPatch
) -> None:
    with coordinator(database_url) as client:
        campaign = submit(client, ball())
        FakeWorker(client).lease(max_jobs=3)
    without = {group: dict(plugins) for group, plugins in catalogue._registered.items()}
    del without[SIMULATORS][SIMULATOR]
    monkeypatch.setattr(catalogue, "_registered", without)
    with coordinator(database_url) as client:
        assert FakeWorker(client).work(campaign)["status"] == "finished"


@pytest.mark.long("runs campaigns")
def test_a_finished_campaign_is_shown_but_not_repeated_with_other_code(
    engines: Engines, database_url: str, edit: Edit
) -> None:
    wide = {"t_b": 1.0, "d_th": 0.05}
    with coordinator(database_url) as client:
        campaign = finished(client, "before")
        before = expect(client.get(f"{API}/{campaign}/boundary", params=wide))
        sources = expect(client.get(f"{API}/{campaign}"))["body"]["sources"]
        assert set(sources) == {"problems/ball@1", f"simulators/{SIMULATOR}"}
    edit()
    with coordinator(database_url) as client:
        assert expect(client.get(f"{API}/{campaign}/boundary", params=wide)) == before
        answer = expect(client.post(f"{API}/{campaign}/repeats", json={"repeats": 3, **wide}), 409)
        assert "simulated with different code of ball@1" in answer["detail"]
        warm = {**ball(), "start_from": {"campaign": campaign}, "algorithm": {"id": "edge@1"}}
        answer = expect(client.post(API, json=warm), 422)
        assert "simulated with different code of ball@1" in answer["detail"]


def test_what_a_submission_says_of_sources_is_replaced(client: httpx.Client, edit: Edit) -> None:
    campaign = submit(client, {**ball(), "sources": {"problems/ball@1": "0" * 64}})
    body = expect(client.get(f"{API}/{campaign}"))["body"]
    assert body["sources"]["problems/ball@1"] != "0" * 64
    expect(client.post(API, json={**ball(), "sources": {"x": "short"}}), 422)


@pytest.mark.long("runs campaigns")
def test_runs_with_other_code_are_no_earlier_runs(listening_client: httpx.Client, edit: Edit) -> None:
    document = {
        "name": "x",
        "problems": [{"id": "ball@1"}],
        "algorithms": [{"id": "random@1"}],
        "seeds": [1],
        "budget": {"simulations": 20},
    }
    experiment = ExperimentRun(parse_experiment(document))
    campaign = CampaignRun(parse_body({**ball(), "algorithm": {"id": "random@1"}}), pictures=True)

    async def latest(*, submit: bool) -> tuple[list[bool], str]:
        url = str(listening_client.base_url)
        async with httpx.AsyncClient(base_url=url) as client:
            api = Api(client, url)
            said = [(await run.submit(api))[1] for run in (campaign, experiment) if submit]
            found = [await run.latest(api, [CampaignStatus.RUNNING]) for run in (campaign, experiment)]
            return [one is not None for one in found], " ".join(said)

    assert asyncio.run(latest(submit=True))[0] == [True, True]
    edit()
    assert asyncio.run(latest(submit=False))[0] == [False, False]
    found, said = asyncio.run(latest(submit=True))
    assert found == [True, True]
    assert said.count("was simulated with different code of ball@1 (source ") == 2


@pytest.mark.long("runs campaigns")
@pytest.mark.parametrize("edited", [False, True])
def test_a_campaign_that_may_run_is_imported_and_only_continued_with_the_same_code(
    databases: Databases, engines: Engines, database_url: str, tmp_path: Path, edit: Edit, *, edited: bool
) -> None:
    file = str(tmp_path / "half.brink")
    with coordinator(database_url) as client:
        half = submit(client, ball())
        FakeWorker(client).lease(max_jobs=3)
        expect(client.post(f"{API}/{half}/pause"))
    run = CliRunner()
    assert run.invoke(app, ["export", half, "--out", file, "--database", database_url]).exit_code == 0
    if edited:
        edit()
    with databases.database("other") as elsewhere:
        told = run.invoke(app, ["import", file, "--database", elsewhere])
        assert told.exit_code == 0, told.output or told.exception
        with coordinator(elsewhere) as client:
            expect(client.post(f"{API}/{half}/resume"))
            if not edited:
                assert FakeWorker(client).work(half)["status"] == "finished"
                return
            eventually(lambda: progress(client, half)["status"] == "paused", "its step pauses it")
            assert "simulated with different code of ball@1" in progress(client, half)["status_reason"]
