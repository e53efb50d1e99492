"""Campaigns that a language model seeds: what is asked and stored, what faults do, what a restart asks again."""

import json
import threading
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
import yaml
from fastapi.responses import JSONResponse, Response
from sqlalchemy import select
from support.api import coordinator, eventually, expect, progress, submit
from support.llm_endpoint import (
    MODEL,
    Asked,
    Endpoint,
    completion,
    item,
    items,
    refuses,
    reply_text,
    says,
)
from support.traffic import POPULATION, calls, origins, others, seeded, traffic_worker
from typer.testing import CliRunner

import brink.server.llm.seeds
from brink.cli.commands import app
from brink.search.algorithm import SeedRequest
from brink.server.campaigns.body import CampaignBody
from brink.server.db.engine import Engines
from brink.server.db.models import SeedClaimRow
from brink.server.db.writer import Writer
from brink.server.errors import InvalidInput, Unavailable
from brink.server.llm.calls import CallKey, Outcome, StoredCall
from brink.server.llm.seeds import LlmSeeds
from brink.server.llm.store import CampaignCalls
from brink.server.llm.wire import Mode
from brink.server.problems.npc_actions import NpcActions, NpcActionsParams

pytestmark = pytest.mark.timeout(120)


def many(asked: Asked) -> Response:
    """Answer the first question with cars ahead, and later ones with others each time, decided by the question."""
    if "Rule 1" not in asked.prompt:
        return JSONResponse(completion(reply_text(items(POPULATION))))
    return others(asked)


def test_the_first_population_is_the_models(client: httpx.Client, endpoint: Endpoint) -> None:
    endpoint.then(says(reply_text(items(POPULATION))))
    campaign = submit(client, seeded(endpoint, differential="never"))
    stands = traffic_worker(client).work(campaign)
    assert (stands["status"], stands["failed"], stands["asking"]) == ("finished", 0, None)
    assert origins(client, campaign)[:POPULATION] == ["llm"] * POPULATION
    (call,) = calls(client, campaign)["calls"]
    assert (call["request"], call["turn"], call["outcome"], call["cost"]) == (0, 0, "ok", None)
    assert (call["prompt_tokens"], call["completion_tokens"], call["estimated"]) == (900, 100, False)
    assert len(endpoint.asked) == 1


def test_what_is_missing_comes_from_repair_and_from_patterns(
    client: httpx.Client, endpoint: Endpoint
) -> None:
    wrong = item(speed_mps=900.0)
    endpoint.then(says(reply_text([*items(4), wrong, wrong])), says(reply_text(items(2, first=10))))
    campaign = submit(client, seeded(endpoint, differential="never"))
    traffic_worker(client).work(campaign)
    found = origins(client, campaign)
    assert found[:POPULATION] == ["llm"] * 4 + ["llm_repair"] * 2 + ["heuristic"] * 2
    assert progress(client, campaign)["origins"] == {origin: found.count(origin) for origin in set(found)}
    assert [call["turn"] for call in calls(client, campaign)["calls"]] == [0, 1]


@pytest.mark.parametrize("fault", ["refused", "away", "rubbish", "stalled"])
def test_an_endpoint_that_fails_delays_seeds_and_nothing_else(
    client: httpx.Client, endpoint: Endpoint, fault: str
) -> None:
    llm: dict[str, Any] = {}
    if fault == "refused":
        endpoint.then(refuses(401))
    elif fault == "away":
        endpoint.then(*[refuses(503)] * 2)
    elif fault == "rubbish":
        endpoint.then(says("I'd rather not."), says("Still not."))
    else:
        endpoint.then(*[endpoint.stalls()] * 2)
        llm = {"timeout_s": 0.2}
    campaign = submit(client, seeded(endpoint, llm, differential="never"))
    stands = traffic_worker(client).work(campaign)
    assert (stands["status"], stands["failed"]) == ("finished", 0)
    assert origins(client, campaign)[:POPULATION] == ["heuristic"] * POPULATION
    outcome = {"refused": "refused", "away": "unavailable", "rubbish": "invalid", "stalled": "unavailable"}
    assert calls(client, campaign)["calls"][0]["outcome"] == outcome[fault]


def test_a_search_that_is_stuck_asks_for_others_until_the_budget_is_spent(
    client: httpx.Client, endpoint: Endpoint
) -> None:
    endpoint.then(*[many] * 40)
    campaign = submit(client, seeded(endpoint, {"max_calls": 3}, differential="always"))
    stands = traffic_worker(client).work(campaign)
    assert stands["status"] == "finished"
    assert len(endpoint.asked) == 3
    told = calls(client, campaign)
    assert told["total_calls"] == 3
    assert told["calls"][-1]["outcome"] == "over_budget"
    later = json.dumps([asked.body["messages"] for asked in endpoint.asked[1:]])
    assert "SE exposed" in later or "SN exposed" in later


def test_while_it_is_asked_the_campaign_waits_and_says_so(client: httpx.Client, endpoint: Endpoint) -> None:
    endpoint.then(endpoint.stalls(), says(reply_text(items(POPULATION))))
    campaign = submit(client, seeded(endpoint, {"timeout_s": 0.6}, differential="never"))
    eventually(lambda: progress(client, campaign)["asking"] is not None, "it says what it asks")
    assert f"asking {MODEL} for {POPULATION} solutions" in progress(client, campaign)["asking"]
    assert traffic_worker(client).lease() == []
    assert traffic_worker(client).work(campaign)["status"] == "finished"
    assert origins(client, campaign)[:POPULATION] == ["llm"] * POPULATION


def test_a_restart_asks_nothing_twice_and_finds_the_same(database_url: str, endpoint: Endpoint) -> None:
    asks = seeded(endpoint, differential="always")
    endpoint.then(*[many] * 60)
    with coordinator(database_url) as client:
        whole = submit(client, asks)
        digest = traffic_worker(client).work(whole)["digest"]
        expected = origins(client, whole)
        times = len(endpoint.asked)
        assert "llm" in expected[POPULATION:], "differential seeds came, too"
    campaign, first = "", len(endpoint.asked)
    for wanted in (3, 10, 19, 1000):
        with coordinator(database_url) as client:
            campaign = campaign or submit(client, asks)
            stands = traffic_worker(client).work(campaign, until=partial(_reached, wanted))
    assert stands["status"] == "finished"
    with coordinator(database_url) as client:
        assert origins(client, campaign) == expected
        assert progress(client, campaign)["digest"] == digest
    assert len(endpoint.asked) - first == times


def _reached(wanted: int, stands: dict[str, Any]) -> bool:
    return bool(stands["simulations"] >= wanted)


def test_who_stops_before_an_answer_has_sent_the_request_all_the_same(
    database_url: str, endpoint: Endpoint, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(brink.server.llm.seeds, "LAST_ANSWERS_S", 0.1)
    endpoint.then(*[endpoint.stalls()] * 3)
    asks = seeded(endpoint, {"max_calls": 2}, differential="never")
    campaign = ""
    for sent in (1, 2):
        with coordinator(database_url) as client:
            campaign = campaign or submit(client, asks)
            eventually(lambda sent=sent: len(endpoint.asked) == sent, "it asks again")  # type: ignore[misc]
            told = calls(client, campaign)
            assert (told["total_calls"], told["calls"][0]["outcome"]) == (sent, "sent")
    with coordinator(database_url) as client:
        assert traffic_worker(client).work(campaign)["status"] == "finished"
        assert origins(client, campaign)[:POPULATION] == ["heuristic"] * POPULATION
        told = calls(client, campaign)
    assert (told["total_calls"], told["calls"][0]["outcome"]) == (2, "over_budget")
    assert len(endpoint.asked) == 2


def test_a_campaign_that_is_paused_meanwhile_is_asked_for_once(
    database_url: str, endpoint: Endpoint, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(brink.server.llm.seeds, "HOLD_S", 0.6)
    endpoint.then(endpoint.stalls(), *[many] * 3)
    with coordinator(database_url) as first, coordinator(database_url) as second:
        campaign = submit(first, seeded(endpoint, differential="never"))
        eventually(lambda: len(endpoint.asked) == 1, "it asks")
        expect(first.post(f"/api/v1/campaigns/{campaign}/pause"))
        begun = time.monotonic()
        eventually(lambda: time.monotonic() - begun > 1.5, "the claim would have run out")
        expect(second.post(f"/api/v1/campaigns/{campaign}/resume"))
        begun = time.monotonic()
        eventually(lambda: time.monotonic() - begun > 1.5, "the other one would have asked")
        assert len(endpoint.asked) == 1
        endpoint.release()
        assert traffic_worker(second).work(campaign)["status"] == "finished"
        assert len(calls(second, campaign)["calls"]) == len(endpoint.asked)


def test_what_does_not_go_together_is_refused_at_submission(client: httpx.Client, endpoint: Endpoint) -> None:
    asks = seeded(endpoint)
    for change, pointer in (
        ({"llm": None}, "/llm"),
        ({"algorithm": {"id": "mumoea@1"}}, "/llm"),
        ({"llm": {"endpoint": "ftp://x", "model": "m"}}, "/llm/endpoint"),
        ({"llm": {"endpoint": endpoint.url, "model": "m", "api_key": "sk-1234567890"}}, "/llm"),
        ({"llm": {"endpoint": endpoint.url, "model": "m", "max_cost": 1.0}}, "/llm"),
    ):
        told = expect(client.post("/api/v1/campaigns", json={**asks, **change}), 422)
        assert any(error["pointer"].startswith(pointer) for error in told["errors"]), told
        assert "sk-1234567890" not in json.dumps(told)
    assert endpoint.asked == []


def test_a_coordinator_asks_only_where_it_may_and_sends_keys_only_there(
    database_url: str, endpoint: Endpoint
) -> None:
    keyed = seeded(endpoint, {"api_key_env": "PATH"})
    foreign = seeded(endpoint, {"endpoint": "http://models.example/v1"})
    with coordinator(database_url) as client:
        for asks in (keyed, foreign):
            told = expect(client.post("/api/v1/campaigns", json=asks), 422)
            assert "BRINK_LLM_ENDPOINTS" in told["errors"][0]["message"]
    with coordinator(database_url, llm_endpoints="http://models.example") as client:
        expect(client.post("/api/v1/campaigns", json=keyed), 422)
        expect(client.post("/api/v1/campaigns", json=foreign), 201)
        near = seeded(endpoint, {"endpoint": "http://models.example.evil/v1"})
        expect(client.post("/api/v1/campaigns", json=near), 422)
    assert endpoint.asked == []


def test_two_coordinators_ask_once_between_them(database_url: str, endpoint: Endpoint) -> None:
    endpoint.then(*[many] * 40)
    with coordinator(database_url) as first, coordinator(database_url) as second:
        campaign = submit(first, seeded(endpoint, differential="always"))
        stands = traffic_worker(second).work(campaign)
        assert (stands["status"], stands["failed"]) == ("finished", 0)
        told = calls(second, campaign)
    assert len(told["calls"]) >= 3
    assert len(endpoint.asked) == len(told["calls"]) == told["total_calls"]


def test_an_answer_that_cannot_be_stored_waits_until_the_coordinator_stops(
    engines: Engines, caplog: pytest.LogCaptureFixture
) -> None:
    writer, stopping = Writer(engines.writer), threading.Event()
    writer.close()
    log = CampaignCalls(engines, writer, "nobody", stopping)
    call = StoredCall(
        key=CallKey(0, 0), prompt_hash="0" * 64, mode=Mode.PLAIN, raw="{}", outcome=Outcome.OK, calls=1,
        usage=None, cost=None, latency_s=0.1, error=None,
    )  # fmt: skip
    refused: list[BaseException] = []

    def store() -> None:
        try:
            log.store(call)
        except Unavailable as error:
            refused.append(error)

    storing = threading.Thread(target=store)
    storing.start()
    eventually(lambda: "cannot be stored yet" in caplog.text, "it says so")
    assert storing.is_alive(), "what was paid for is not given up"
    stopping.set()
    storing.join(1.0)
    assert refused


@pytest.mark.parametrize("when", ["claims", "releases"])
def test_whoever_stops_leaves_no_claim_behind(
    client: httpx.Client, endpoint: Endpoint, engines: Engines, monkeypatch: pytest.MonkeyPatch, when: str
) -> None:
    """Others would wait a minute for it; it stops in the moment that a claim is taken, or given back."""
    endpoint.then(says(reply_text(items(POPULATION))))
    asks = seeded(endpoint)
    plain = {
        **asks,
        "llm": None,
        "algorithm": {"id": "mumoea@1", "params": {"population_size": 8, "seeds": 3}},
    }
    body = CampaignBody.model_validate({**asks, "seed": 1})
    campaign: Any = SimpleNamespace(id=submit(client, plain), body=body)
    writer = Writer(engines.writer)
    seeds = LlmSeeds(engines, writer, lambda campaign_id: None)
    stopper = threading.Thread(target=seeds.close)
    original: Any = getattr(brink.server.llm.seeds, when.removesuffix("s"))

    remembered = []

    def meanwhile(*given: Any) -> Any:
        remembered.append(seeds.doing(campaign.id) is not None)
        if stopper.ident is not None:
            return original(*given)
        stopper.start()
        eventually(lambda: seeds._stopping.is_set(), "it is stopping")
        return original(*given)

    monkeypatch.setattr(brink.server.llm.seeds, when.removesuffix("s"), meanwhile)
    assert (
        seeds.proposals(
            campaign.id, campaign.body.llm, NpcActions(NpcActionsParams()), SeedRequest(number=0, count=8)
        )
        is None
    )
    eventually(lambda: bool(stopper.ident), "it was stopped")
    stopper.join()
    writer.close()
    with engines.reader.connect() as connection:
        assert connection.execute(select(SeedClaimRow.campaign_id)).all() == []
    assert remembered[0] is (when == "releases"), "who stops waits for what is remembered"


def test_the_command_line_tries_shows_and_tells(
    client: httpx.Client, endpoint: Endpoint, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    file = tmp_path / "seeded.yaml"
    file.write_text(yaml.safe_dump(seeded(endpoint, differential="never")))
    run = CliRunner().invoke
    shown = run(app, ["llm", "dry-run", str(file)])
    assert shown.exit_code == 0, shown.output
    assert "cut_in" in shown.stdout
    assert "Rule 1" not in shown.stdout, "it never asks for differential seeds"
    file.write_text(yaml.safe_dump(seeded(endpoint, seeds=POPULATION + 1)))
    refused = run(app, ["llm", "dry-run", str(file)])
    assert isinstance(refused.exception, InvalidInput)
    assert "/algorithm/params/seeds: expected at most population_size" in str(refused.exception)
    file.write_text(yaml.safe_dump(seeded(endpoint)))
    assert "Rule 1" in run(app, ["llm", "dry-run", str(file)]).stdout
    assert "cost unknown" in shown.stdout
    assert endpoint.asked == []
    endpoint.models = {"data": [{"id": MODEL}]}
    endpoint.then(*[says(reply_text(items(1)))] * len(Mode))
    tried = run(app, ["llm", "check", str(file)])
    assert tried.exit_code == 0, tried.output
    assert "reply format: json_schema" in tried.stdout
    endpoint.then(*[says("no")] * len(Mode))
    assert run(app, ["llm", "check", str(file)]).exit_code == 1
    endpoint.reset()
    endpoint.then(says(reply_text(items(POPULATION))))
    campaign = submit(client, seeded(endpoint, differential="never"))
    traffic_worker(client).work(campaign)
    told = run(app, ["llm", "log", campaign, "--server", str(client.base_url), "--out", str(tmp_path / "r")])
    assert told.exit_code == 0, told.output
    assert "1 calls, 1000 tokens" in told.stdout
    assert json.loads((tmp_path / "r" / "reply-0-0.json").read_text())["choices"]
