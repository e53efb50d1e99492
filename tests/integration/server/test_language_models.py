"""Campaigns that a language model seeds: requests and stored replies, faults of the endpoint, restarts."""

import json
import re
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
import yaml
from fastapi.responses import JSONResponse, Response
from sqlalchemy import Connection, select, update
from support.api import coordinator, eventually, expect, progress, reached, submit
from support.databases import sqlite_then_postgres
from support.llm_endpoint import MODEL, Asked, Endpoint, Step, completion, cut, items, reply_text, says
from support.marks import mostly_long
from support.traffic import (
    POPULATION,
    calls,
    descriptions,
    differential_seeds,
    origins,
    seeded,
    traffic_worker,
)
from typer.testing import CliRunner

import brink.server.llm.seeds
from brink.cli.commands import app
from brink.search.algorithm import Origin, Proposal, SeedRequest
from brink.server.campaigns.body import CampaignBody
from brink.server.db.engine import Engines
from brink.server.db.models import CampaignRow, SeedClaimRow
from brink.server.db.writer import Writer
from brink.server.errors import InvalidInput, Unavailable
from brink.server.llm.access import LlmAccess
from brink.server.llm.calls import CampaignCalls, claim
from brink.server.llm.replies import RoadChecker, parse
from brink.server.llm.seeder import LanguageModels
from brink.server.llm.seeds import LlmSeeds
from brink.server.problems.npc_actions import NpcActions, NpcActionsParams
from brink.server.seeding import LlmCall, Mode, Outcome

pytestmark = pytest.mark.timeout(180)

KEY = "sk-secret/0123456789"


def scripted(asked: Asked) -> Response:
    """Answer the first request with cars ahead, and later ones with differential seeds."""
    if "Rule 1" not in asked.prompt:
        return JSONResponse(completion(reply_text(items(POPULATION))))
    return differential_seeds(asked)


def test_model_provides_the_first_population(client: httpx.Client, endpoint: Endpoint) -> None:
    endpoint.then(says(reply_text(items(POPULATION))))
    campaign = submit(client, seeded(endpoint, differential="never"))
    current = traffic_worker(client).work(campaign)
    assert (current["status"], current["failed"], current["asking"]) == ("finished", 0, None)
    assert origins(client, campaign)[:POPULATION] == ["llm"] * POPULATION
    (call,) = calls(client, campaign)["calls"]
    assert (call["request"], call["turn"], call["outcome"], call["cost"]) == (0, 0, "ok", None)
    assert (call["prompt_tokens"], call["completion_tokens"], call["estimated"]) == (900, 100, False)
    assert len(endpoint.asked) == 1


class Canned:
    """A source of seeds that calls nobody."""

    def __init__(self, *given: object) -> None:
        self.closed = False

    def proposals(
        self, campaign_id: str, settings: Any, problem: NpcActions, request: SeedRequest
    ) -> Sequence[Proposal]:
        road = RoadChecker(problem.road, problem.max_participants)
        solutions = parse(reply_text(items(POPULATION)), road, request.count).solutions
        return [Proposal(solution=solution, origin=Origin.LLM_REPAIR) for solution in solutions]

    def doing(self, campaign_id: str) -> str | None:
        return "thinking"

    def calls(self, connection: Connection, campaign_id: str) -> list[LlmCall]:
        return [LlmCall(request=0, turn=0, prompt_hash="0" * 64, mode=Mode.PLAIN, calls=2, reply="{}")]

    def close(self) -> None:
        self.closed = True


def test_another_source_of_seeds_takes_the_place_of_language_models(
    database_url: str, endpoint: Endpoint, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = Canned()
    monkeypatch.setattr(LanguageModels, "source", lambda *given: source)
    with coordinator(database_url) as client:
        campaign = submit(client, seeded(endpoint, differential="never"))
        assert progress(client, campaign)["asking"] == "thinking"
        assert traffic_worker(client).work(campaign)["status"] == "finished"
        assert origins(client, campaign)[:POPULATION] == ["llm_repair"] * POPULATION
        stored = calls(client, campaign)
    assert (stored["total_calls"], stored["max_calls"], stored["calls"][0]["reply"]) == (2, 50, None)
    assert endpoint.asked == []
    assert source.closed


@pytest.mark.long("runs a campaign")
def test_stuck_search_requests_new_seeds_within_budget(client: httpx.Client, endpoint: Endpoint) -> None:
    endpoint.then(*[scripted] * 40)
    campaign = submit(client, seeded(endpoint, {"max_calls": 3}, differential="always"))
    current = traffic_worker(client).work(campaign)
    assert current["status"] == "finished"
    assert len(endpoint.asked) == 3
    found_calls = calls(client, campaign)
    assert found_calls["total_calls"] == 3
    assert found_calls["calls"][-1]["outcome"] == "over_budget"
    later = json.dumps([asked.body["messages"] for asked in endpoint.asked[1:]])
    assert "SE exposed" in later or "SN exposed" in later


@pytest.mark.long("runs a campaign")
def test_campaign_waits_for_the_model_and_reports_it(client: httpx.Client, endpoint: Endpoint) -> None:
    endpoint.then(endpoint.stalls(), says(reply_text(items(POPULATION))))
    campaign = submit(client, seeded(endpoint, {"timeout_s": 0.6}, differential="never"))
    eventually(
        lambda: progress(client, campaign)["asking"] is not None, "the progress says what is being asked"
    )
    assert f"asking {MODEL} for {POPULATION} solutions" in progress(client, campaign)["asking"]
    assert traffic_worker(client).lease() == []
    assert traffic_worker(client).work(campaign)["status"] == "finished"
    assert origins(client, campaign)[:POPULATION] == ["llm"] * POPULATION


def test_restart_repeats_no_request_and_finds_the_same_archive(database_url: str, endpoint: Endpoint) -> None:
    asks = seeded(endpoint, differential="always")
    endpoint.then(*[scripted] * 60)
    with coordinator(database_url) as client:
        whole = submit(client, asks)
        digest = traffic_worker(client).work(whole)["digest"]
        expected = origins(client, whole)
        times = len(endpoint.asked)
        assert "llm" in expected[POPULATION:], "there were differential seeds"
    campaign, first = "", len(endpoint.asked)
    for wanted in (3, 10, 19, 1000):
        with coordinator(database_url) as client:
            campaign = campaign or submit(client, asks)
            current = traffic_worker(client).work(campaign, until=reached(wanted))
    assert current["status"] == "finished"
    with coordinator(database_url) as client:
        assert origins(client, campaign) == expected
        assert progress(client, campaign)["digest"] == digest
    assert len(endpoint.asked) - first == times


@pytest.mark.long("runs a campaign")
def test_request_without_a_reply_counts_against_the_budget(
    database_url: str, endpoint: Endpoint, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(brink.server.llm.seeds, "LAST_ANSWERS_S", 0.1)
    endpoint.then(*[endpoint.stalls()] * 3)
    asks = seeded(endpoint, {"max_calls": 2}, differential="never")
    campaign = ""
    for sent in (1, 2):
        with coordinator(database_url) as client:
            campaign = campaign or submit(client, asks)
            eventually(lambda sent=sent: len(endpoint.asked) == sent, "the request is sent again")  # type: ignore[misc]
            found_calls = calls(client, campaign)
            assert (found_calls["total_calls"], found_calls["calls"][0]["outcome"]) == (sent, "sent")
    with coordinator(database_url) as client:
        assert traffic_worker(client).work(campaign)["status"] == "finished"
        assert origins(client, campaign)[:POPULATION] == ["heuristic"] * POPULATION
        found_calls = calls(client, campaign)
    assert (found_calls["total_calls"], found_calls["calls"][0]["outcome"]) == (2, "over_budget")
    assert len(endpoint.asked) == 2


@sqlite_then_postgres
@pytest.mark.long("runs a campaign")
def test_pausing_repeats_no_request(
    database_url: str, endpoint: Endpoint, monkeypatch: pytest.MonkeyPatch
) -> None:
    claims: list[bool] = []

    def noted(*given: Any) -> bool:
        claims.append(claim(*given))
        return claims[-1]

    monkeypatch.setattr(brink.server.llm.seeds, "claim", noted)
    monkeypatch.setattr(brink.server.llm.seeds, "HOLD_S", 3.0)
    endpoint.then(endpoint.stalls(), *[scripted] * 3)
    with coordinator(database_url) as first, coordinator(database_url) as second:
        campaign = submit(first, seeded(endpoint, differential="never"))
        eventually(lambda: len(endpoint.asked) == 1, "a request is sent")
        expect(first.post(f"/api/v1/campaigns/{campaign}/pause"))
        # It is renewed at thirds of its time, so it would have expired by now.
        eventually(lambda: len(claims) >= 5, "the claim of the first coordinator is renewed")
        expect(second.post(f"/api/v1/campaigns/{campaign}/resume"))
        eventually(lambda: claims.count(False) >= 2, "the other one may not ask")
        assert len(endpoint.asked) == 1
        endpoint.release()
        assert traffic_worker(second).work(campaign)["status"] == "finished"
        assert len(calls(second, campaign)["calls"]) == len(endpoint.asked)


def test_contradictory_settings_are_rejected_at_submission(client: httpx.Client, endpoint: Endpoint) -> None:
    asks = seeded(endpoint)
    for change, pointer in (
        ({"llm": None}, "/llm"),
        ({"algorithm": {"id": "mumoea@1"}}, "/llm"),
        ({"llm": {"endpoint": "ftp://x", "model": "m"}}, "/llm/endpoint"),
        ({"llm": {"endpoint": endpoint.url, "model": "m", "api_key": "sk-1234567890"}}, "/llm"),
        ({"llm": {"endpoint": endpoint.url, "model": "m", "max_cost": 1.0}}, "/llm"),
    ):
        found_calls = expect(client.post("/api/v1/campaigns", json={**asks, **change}), 422)
        assert any(error["pointer"].startswith(pointer) for error in found_calls["errors"]), found_calls
        assert "sk-1234567890" not in json.dumps(found_calls)
    assert endpoint.asked == []


def test_requests_and_keys_go_only_to_allowed_endpoints(database_url: str, endpoint: Endpoint) -> None:
    keyed = seeded(endpoint, {"api_key_env": "PATH"})
    foreign = seeded(endpoint, {"endpoint": "http://models.example/v1"})
    with coordinator(database_url) as client:
        for asks in (keyed, foreign):
            found_calls = expect(client.post("/api/v1/campaigns", json=asks), 422)
            assert "BRINK_LLM_ENDPOINTS" in found_calls["errors"][0]["message"]
    with coordinator(database_url, llm_endpoints="http://models.example") as client:
        expect(client.post("/api/v1/campaigns", json=keyed), 422)
        expect(client.post("/api/v1/campaigns", json=foreign), 201)
        near = seeded(endpoint, {"endpoint": "http://models.example.evil/v1"})
        expect(client.post("/api/v1/campaigns", json=near), 422)
    assert endpoint.asked == []


def test_a_key_goes_only_where_the_operator_pairs_it_with_the_endpoint(
    database_url: str, endpoint: Endpoint, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MODEL_KEY", KEY)
    monkeypatch.setenv("OTHER_SECRET", "sk-another-0123456789")
    endpoint.key = KEY
    endpoint.then(says(reply_text(items(POPULATION))))
    with coordinator(
        database_url, llm_endpoints=f"http://10.0.0.5 OTHER_SECRET, {endpoint.url} MODEL_KEY"
    ) as client:
        other = client.post("/api/v1/campaigns", json=seeded(endpoint, {"api_key_env": "OTHER_SECRET"}))
        [error] = expect(other, 422)["errors"]
        assert error["pointer"] == "/llm/api_key_env"
        assert "may not send the key in OTHER_SECRET" in error["message"]
        campaign = submit(client, seeded(endpoint, {"api_key_env": "MODEL_KEY"}, differential="never"))
        traffic_worker(client).work(campaign)
        assert origins(client, campaign)[:POPULATION] == ["llm"] * POPULATION


def test_a_stored_campaign_gets_no_key_that_the_operator_did_not_name(
    database_url: str, engines: Engines, endpoint: Endpoint, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever filled the database, and whatever was allowed then: each request is checked."""
    monkeypatch.setenv("OTHER_SECRET", KEY)
    endpoint.then(*[scripted] * 40)
    with coordinator(database_url) as client:
        campaign = submit(client, seeded(endpoint, differential="always"))
        worker = traffic_worker(client)
        worker.report(worker.lease(max_jobs=2, wait_s=10))
        expect(client.post(f"/api/v1/campaigns/{campaign}/pause"))
    assert len(endpoint.asked) == 1
    with engines.writer.begin() as connection:
        document = connection.execute(select(CampaignRow.document)).scalar_one()
        document["llm"]["api_key_env"] = "OTHER_SECRET"
        connection.execute(update(CampaignRow).values(document=document))
    with coordinator(database_url) as client:
        expect(client.post(f"/api/v1/campaigns/{campaign}/resume"))
        assert traffic_worker(client).work(campaign)["status"] == "finished"
        refused = calls(client, campaign)["calls"][1]
    assert len(endpoint.asked) == 1
    assert refused["outcome"] == "refused"
    assert "may not send the key in OTHER_SECRET" in refused["error"]


@pytest.mark.parametrize("command", ["run", "llm check"])
def test_commands_send_no_key_that_only_the_file_names(
    endpoint: Endpoint, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.setenv("OTHER_SECRET", KEY)
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "theirs.yaml"
    file.write_text(yaml.safe_dump(seeded(endpoint, {"api_key_env": "OTHER_SECRET"})))
    done = CliRunner().invoke(app, [*command.split(), str(file)])
    said = f"{done.output} {done.exception}"
    assert done.exit_code != 0
    assert f"BRINK_LLM_ENDPOINTS='{endpoint.url} OTHER_SECRET'" in " ".join(said.split())
    assert endpoint.asked == []
    if command == "llm check":
        monkeypatch.setenv("BRINK_LLM_ENDPOINTS", f"{endpoint.url} OTHER_SECRET")
        endpoint.key = KEY
        endpoint.then(*[says(reply_text(items(1)))] * len(Mode))
        assert CliRunner().invoke(app, ["llm", "check", str(file)]).exit_code == 0


@sqlite_then_postgres
@pytest.mark.long("runs a campaign")
def test_two_coordinators_send_each_request_once(database_url: str, endpoint: Endpoint) -> None:
    endpoint.then(*[scripted] * 40)
    with coordinator(database_url) as first, coordinator(database_url) as second:
        campaign = submit(first, seeded(endpoint, differential="always"))
        current = traffic_worker(second).work(campaign)
        assert (current["status"], current["failed"]) == ("finished", 0)
        found_calls = calls(second, campaign)
    assert len(found_calls["calls"]) >= 3
    assert len(endpoint.asked) == len(found_calls["calls"]) == found_calls["total_calls"]


def test_storing_a_reply_is_retried_until_shutdown(
    engines: Engines, caplog: pytest.LogCaptureFixture
) -> None:
    writer, stopping = Writer(engines.writer), threading.Event()
    writer.close()
    log = CampaignCalls(engines, writer, "nobody", stopping)
    call = LlmCall(
        request=0, turn=0, prompt_hash="0" * 64, mode=Mode.PLAIN, outcome=Outcome.OK, calls=1, reply="{}"
    )
    refused: list[BaseException] = []

    def store() -> None:
        try:
            log.store(call)
        except Unavailable as error:
            refused.append(error)

    storing = threading.Thread(target=store)
    storing.start()
    eventually(lambda: "cannot be stored yet" in caplog.text, "the failure is logged")
    assert storing.is_alive(), "a reply that was paid for is not dropped"
    stopping.set()
    storing.join(1.0)
    assert refused


@sqlite_then_postgres
@pytest.mark.long("runs a campaign")
@pytest.mark.parametrize("when", ["claims", "releases"])
def test_stopping_coordinator_leaves_no_claim_behind(
    client: httpx.Client, endpoint: Endpoint, engines: Engines, monkeypatch: pytest.MonkeyPatch, when: str
) -> None:
    """A remaining claim would delay other coordinators; here it stops while taking or releasing a claim."""
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
    seeds = LlmSeeds(engines, writer, lambda campaign_id: None, LlmAccess())
    stopper = threading.Thread(target=seeds.close)
    original: Any = getattr(brink.server.llm.seeds, when.removesuffix("s"))

    remembered = []

    def meanwhile(*given: Any) -> Any:
        remembered.append(seeds.doing(campaign.id) is not None)
        if stopper.ident is not None:
            return original(*given)
        stopper.start()
        eventually(lambda: seeds._stopping.is_set(), "the stop has begun")
        return original(*given)

    monkeypatch.setattr(brink.server.llm.seeds, when.removesuffix("s"), meanwhile)
    assert (
        seeds.proposals(
            campaign.id, campaign.body.llm, NpcActions(NpcActionsParams()), SeedRequest(number=0, count=8)
        )
        is None
    )
    eventually(lambda: bool(stopper.ident), "it was told to stop")
    stopper.join()
    writer.close()
    with engines.reader.connect() as connection:
        assert connection.execute(select(SeedClaimRow.campaign_id)).all() == []
    assert remembered[0] is (when == "releases"), "stopping waits for the pending request"


@pytest.mark.long("runs a campaign")
def test_commands_check_preview_and_log_requests(
    listening_client: httpx.Client, endpoint: Endpoint, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    file = tmp_path / "seeded.yaml"
    file.write_text(yaml.safe_dump(seeded(endpoint, differential="never")))
    run = CliRunner().invoke
    shown = run(app, ["llm", "dry-run", str(file)])
    assert shown.exit_code == 0, shown.output
    assert "cut_in" in shown.stdout
    assert "Rule 1" not in shown.stdout, "this campaign asks for no differential seeds"
    file.write_text(yaml.safe_dump(seeded(endpoint, seeds=POPULATION + 1)))
    refused = run(app, ["llm", "dry-run", str(file)])
    assert isinstance(refused.exception, InvalidInput)
    assert "line 7: algorithm.params.seeds: expected at most population_size" in str(refused.exception)
    file.write_text(yaml.safe_dump(seeded(endpoint)))
    assert "Rule 1" in run(app, ["llm", "dry-run", str(file)]).stdout
    assert "cost unknown" in shown.stdout
    assert "delays the campaign by at most 240 s (max_delay_s)" in shown.stdout
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
    campaign = submit(listening_client, seeded(endpoint, differential="never"))
    traffic_worker(listening_client).work(campaign)
    found_calls = run(
        app,
        ["llm", "log", campaign, "--server", str(listening_client.base_url), "--out", str(tmp_path / "r")],
    )
    assert found_calls.exit_code == 0, found_calls.output
    assert "1 HTTP requests of at most 50 (max_calls), 1000 tokens" in found_calls.stdout
    assert json.loads((tmp_path / "r" / "reply-0-0.json").read_text())["choices"]


BUDGET = 5
GOOD = says(reply_text(items(POPULATION)))
MORE = says(reply_text(items(3, first=20)))
TRUNCATED = reply_text(items(8))[: len(reply_text(items(5))) + 60]
STALLS = "stalls"
FIRST = re.compile(r"car \d+ m ahead.*brakes.*")
DIFFERENTIAL = re.compile(r"pedestrian [^;]* crosses the road")
"""Descriptions of the solutions that the endpoint proposes in its first reply, and in later ones."""


@dataclass(frozen=True)
class Fault:
    """A fault of the endpoint in its first replies, and its effect on the first population.

    Attributes:
        steps: The replies to the first requests.
        llm: Solutions of the first population that come from the first valid reply.
        repaired: Solutions that come from a repair request.
        sent: Requests for the first population.
        forms: Forms of a reply that the endpoint supports.
        settings: Changes to the settings of the language model.
    """

    steps: tuple[Step | str, ...]
    llm: int = 0
    repaired: int = 0
    sent: int = 1
    forms: tuple[str, ...] = tuple(Mode)
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def population(self) -> list[str]:
        """The origins of the first population."""
        patterns = POPULATION - self.llm - self.repaired
        return ["llm"] * self.llm + ["llm_repair"] * self.repaired + ["heuristic"] * patterns


FAULTS = {
    "vLLM rejects json_schema": Fault((GOOD,), llm=8, sent=3, forms=("json_object", "plain")),
    "truncated": Fault((says(TRUNCATED, finish="length"), MORE), llm=5, repaired=3, sent=2),
    "permanently stalled": Fault((STALLS, STALLS), sent=2, settings={"timeout_s": 0.5}),
    "connection cut once": Fault((cut("x"), GOOD), llm=8, sent=2),
}
"""A kind of fault each; `tests/unit/server/test_server_llm_seeds.py` has all that an endpoint may do."""


def prepare(endpoint: Endpoint, fault: Fault) -> None:
    endpoint.reset()
    endpoint.forms = fault.forms
    endpoint.then(*[endpoint.stalls() if isinstance(step, str) else step for step in fault.steps])
    endpoint.then(*[differential_seeds] * 40)


def sent(endpoint: Endpoint) -> list[str]:
    return [json.dumps(asked.body, sort_keys=True) for asked in endpoint.asked]


EVERY_TIME = ("connection cut once",)


@pytest.mark.parametrize("name", mostly_long(FAULTS, EVERY_TIME, "one fault runs every time"))
def test_interrupted_campaign_survives_endpoint_faults(
    database_url: str, endpoint: Endpoint, name: str
) -> None:
    fault = FAULTS[name]
    asks = seeded(endpoint, {"max_calls": BUDGET, **fault.settings}, differential="always")
    prepare(endpoint, fault)
    with coordinator(database_url) as client:
        whole = submit(client, asks)
        current = traffic_worker(client).work(whole)
        assert (current["status"], current["simulations"], current["failed"]) == ("finished", 24, 0)
        found, found_calls = origins(client, whole), calls(client, whole)
        words = descriptions(client, whole)
    assert found[:POPULATION] == fault.population
    from_model = [text for text, origin in zip(words, found, strict=True) if origin.startswith("llm")]
    for number, text in enumerate(from_model):
        first_ones = number < fault.llm + fault.repaired
        assert FIRST.fullmatch(text) if first_ones else DIFFERENTIAL.fullmatch(text), text
    assert current["origins"] == {origin: found.count(origin) for origin in set(found)}
    first = [asked for asked in endpoint.asked if "Rule 1" not in asked.prompt]
    assert len(first) == fault.sent
    assert found_calls["total_calls"] <= BUDGET
    keys = [(call["request"], call["turn"]) for call in found_calls["calls"]]
    assert len(keys) == len(set(keys))

    times = sent(endpoint)
    prepare(endpoint, fault)
    again = ""
    for wanted in (1, 11, 19, 1000):
        with coordinator(database_url) as client:
            again = again or submit(client, asks)
            current = traffic_worker(client).work(again, until=reached(wanted))
    assert (current["status"], current["failed"]) == ("finished", 0)
    with coordinator(database_url) as client:
        assert origins(client, again) == found
        assert progress(client, again)["digest"] == progress(client, whole)["digest"]
    assert sent(endpoint) == times, "an interruption repeated a request"
