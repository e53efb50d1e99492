"""An endpoint that keeps failing: requests are counted, the delay is bounded, patterns seed the campaign, and why."""

import logging
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import httpx
import pytest
from support.api import coordinator, progress, reached, submit
from support.llm_endpoint import Endpoint, Step, item, refuses, reply_text, says
from support.marks import mostly_long
from support.traffic import POPULATION, calls, origins, seeded, traffic_worker

import brink.server.llm.calls
from brink.server.llm.settings import LlmSettings

# Calls of a model are stored on both databases by test_language_models.py.
pytestmark = pytest.mark.timeout(120)

STALLS = "stalls"
SLACK_S = 1.5
"""For the database and the search, which a request for seeds waits for, too."""


@dataclass(frozen=True)
class Failure:
    """An endpoint that always fails in the same way, and what the campaign makes of it.

    Attributes:
        step: The answer to each request.
        outcomes: Outcomes of the first calls; later ones have the last of these.
        requests: HTTP requests of the first calls; later calls make none.
        words: What the log says about the first call.
        llm: Changes to the settings of the language model.
    """

    step: Step | str
    outcomes: tuple[str, ...]
    requests: tuple[int, ...]
    words: str
    llm: Mapping[str, Any] = field(default_factory=dict)


FAILED = ("unavailable", "unavailable", "circuit_open")
RUBBISH = ("invalid", "invalid", "circuit_open")
SPENT = "no other try: all 4 requests of max_calls are used up"
FAILURES = {
    "HTTP 500": Failure(
        refuses(500, "no"), FAILED, (5, 5), "HTTP 500 (5 tries): no", {"retries": 4, "max_wait_s": 0.05}
    ),
    "HTTP 500 with a small budget": Failure(
        refuses(500, "no"),
        ("unavailable", "over_budget"),
        (4,),
        f"HTTP 500 (4 tries): no; {SPENT}",
        {"retries": 4, "max_wait_s": 0.05, "max_calls": 4},
    ),
    "slow, with many retries": Failure(
        STALLS,
        FAILED,
        (2, 2),
        "timed out after 0.5 s (2 tries); the time for this request is up (max_delay_s, 1.2 s)",
        {"timeout_s": 0.5, "retries": 20, "max_wait_s": 0.05, "max_delay_s": 1.2},
    ),
    "never JSON": Failure(
        says("I'd rather not."),
        RUBBISH,
        (1, 1),
        '/: expected one JSON object {"solutions": [...]}, found none',
    ),
}
EVERY_TIME = ("HTTP 500",)


def asking_often(endpoint: Endpoint, llm: Mapping[str, Any]) -> dict[str, Any]:
    """Return the body of a campaign that requests seeds in each of its five generations."""
    return {**seeded(endpoint, dict(llm), differential="always"), "budget": {"simulations": 40}}


def fails(endpoint: Endpoint, failure: Failure) -> None:
    endpoint.always = endpoint.stalls() if isinstance(failure.step, str) else failure.step


@pytest.mark.parametrize("name", mostly_long(FAILURES, EVERY_TIME, "runs a campaign"))
def test_a_failing_endpoint_delays_a_campaign_a_little(
    client: httpx.Client, endpoint: Endpoint, caplog: pytest.LogCaptureFixture, name: str
) -> None:
    failure = FAILURES[name]
    fails(endpoint, failure)
    body = asking_often(endpoint, failure.llm)
    worker, begun = traffic_worker(client), time.monotonic()
    with caplog.at_level(logging.INFO):
        campaign = submit(client, body)
        while not (jobs := worker.lease(wait_s=1.0)):
            assert progress(client, campaign)["status"] == "running"
        delay_s = time.monotonic() - begun
        worker.report(jobs)
        current = worker.work(campaign)
    assert delay_s < LlmSettings.model_validate(body["llm"]).delay_limit_s + SLACK_S

    assert (current["status"], current["failed"]) == ("finished", 0)
    found = origins(client, campaign)
    assert found[:POPULATION] == ["heuristic"] * POPULATION
    assert not any(origin.startswith("llm") for origin in current["origins"])

    document = calls(client, campaign)
    stored = document["calls"]
    assert [call["calls"] for call in stored] == [
        *failure.requests,
        *[0] * (len(stored) - len(failure.requests)),
    ]
    assert document["total_calls"] == len(endpoint.asked) == sum(failure.requests)
    assert document["max_calls"] == failure.llm.get("max_calls", 50)
    outcomes = [call["outcome"] for call in stored]
    assert len(outcomes) > len(failure.outcomes), "the campaign asked again and again"
    assert outcomes == [*failure.outcomes, *[failure.outcomes[-1]] * (len(outcomes) - len(failure.outcomes))]
    assert failure.words in stored[0]["error"]
    if "circuit_open" in outcomes:
        error = stored[-1]["error"]
        assert "the circuit breaker is open: 2 failed calls in a row; no call for " in error
        assert error.endswith(stored[1]["error"])
    if "over_budget" in outcomes:
        assert stored[-1]["error"].startswith(
            "all 4 requests of max_calls are used up; the last call failed: "
        )
        assert stored[-1]["error"].endswith(stored[0]["error"])
    told = [record.message for record in caplog.records if record.name == "brink.server.llm.seeds"]
    assert sum("hand-written patterns take their place" in line for line in told) == len(
        {call["request"] for call in stored}
    )
    assert any(failure.words in line for line in told)


def test_a_restart_does_not_close_the_circuit_breaker(database_url: str, endpoint: Endpoint) -> None:
    endpoint.always = refuses(500, "no")
    asks = asking_often(endpoint, {"max_wait_s": 0.05})
    with coordinator(database_url) as client:
        whole = submit(client, asks)
        digest = traffic_worker(client).work(whole)["digest"]
    assert len(endpoint.asked) == 4, "two calls of two tries"
    campaign = ""
    for simulations in (1, 9, 17):
        with coordinator(database_url) as client:
            campaign = campaign or submit(client, asks)
            traffic_worker(client).work(campaign, until=reached(simulations))
    with coordinator(database_url) as client:
        current = traffic_worker(client).work(campaign)
    assert (current["status"], current["digest"]) == ("finished", digest)
    assert len(endpoint.asked) == 8


@pytest.mark.long("runs a campaign")
def test_a_trial_closes_the_circuit_breaker_when_the_endpoint_is_back(
    client: httpx.Client, endpoint: Endpoint, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(brink.server.llm.calls, "FIRST_COOL_DOWN_S", 0.0)
    endpoint.then(*[refuses(500, "no")] * 5)
    endpoint.always = says(reply_text([item(ds_m=20.0 + 2 * n) for n in range(8)]))
    campaign = submit(client, asking_often(endpoint, {"max_wait_s": 0.05}))
    assert traffic_worker(client).work(campaign)["status"] == "finished"
    stored = calls(client, campaign)["calls"]
    assert [(call["outcome"], call["calls"]) for call in stored[:4]] == [
        ("unavailable", 2),
        ("unavailable", 2),
        ("unavailable", 1),  # a trial is a single try
        ("ok", 1),
    ]
    assert "circuit_open" not in {call["outcome"] for call in stored}
