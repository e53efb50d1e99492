"""A check of an endpoint says what works and what does not."""

import asyncio
from typing import Any

import pytest
from support.llm_endpoint import (
    MODEL,
    Endpoint,
    Server,
    gives,
    items,
    llm_settings,
    refuses,
    reply_text,
    says,
)

from brink.server.llm.check import EndpointReport, check_endpoint
from brink.server.llm.wire import Mode

pytestmark = pytest.mark.timeout(30)

GOOD = says(reply_text(items(1)))


def checked(endpoint: Endpoint, **changes: Any) -> EndpointReport:
    return asyncio.run(check_endpoint(llm_settings(endpoint, **changes), environ={}))


def test_an_endpoint_that_takes_everything(endpoint: Endpoint) -> None:
    endpoint.models = {"object": "list", "data": [{"id": MODEL}]}
    endpoint.then(*[GOOD] * len(Mode))
    report = checked(endpoint)
    assert (report.reachable, report.models, report.model_listed) == (True, (MODEL,), True)
    assert [one.mode for one in report.modes] == list(Mode)
    assert all(
        one.accepted and one.usable and one.usage_stated and one.trouble is None for one in report.modes
    )
    assert {one.finish_reason for one in report.modes} == {"stop"}
    assert all(one.latency_s is not None and one.latency_s > 0 for one in report.modes)
    assert report.mode is Mode.JSON_SCHEMA
    assert report.works
    assert [asked.form for asked in endpoint.asked] == [mode.value for mode in Mode]


def test_an_endpoint_that_takes_text_alone(endpoint: Endpoint) -> None:
    endpoint.forms = ("plain",)
    endpoint.then(says(reply_text(items(1)), server=Server.OLLAMA, finish=None))
    report = checked(endpoint)
    assert (report.models, report.model_listed, report.mode) == (None, None, Mode.PLAIN)
    assert [one.accepted for one in report.modes] == [False, False, False, True]
    assert "answered 400" in str(report.modes[0].trouble)
    assert not report.modes[-1].usage_stated
    assert report.modes[-1].finish_reason is None
    assert len(endpoint.asked) == len(Mode)


def test_a_model_that_answers_rubbish(endpoint: Endpoint) -> None:
    endpoint.then(says("no"), gives({"choices": []}), says(reply_text([{}])), says("no"))
    report = checked(endpoint)
    assert not report.works
    assert [one.accepted for one in report.modes] == [True, False, True, True]
    assert "expected one JSON object" in str(report.modes[0].trouble)
    assert "/solutions/0/participants: missing" in str(report.modes[2].trouble)


@pytest.mark.parametrize(
    ("listed", "model", "expected"),
    [
        ({"models": [{"name": "llama3.2:latest"}]}, "llama3.2", True),
        ({"data": [{"id": "llama3.2:latest"}]}, "llama3.2:latest", True),
        ({"data": [{"id": "other"}]}, "llama3.2", False),
    ],
)
def test_a_model_is_looked_for_in_the_list(
    endpoint: Endpoint, listed: Any, model: str, expected: bool
) -> None:
    endpoint.models = listed
    endpoint.then(*[GOOD] * len(Mode))
    assert checked(endpoint, model=model).model_listed is expected


def test_a_wrong_key_stops_the_check(endpoint: Endpoint) -> None:
    endpoint.key = "another"
    report = checked(endpoint)
    assert report.reachable
    assert not report.works
    assert "answered 401" in str(report.trouble)
    assert endpoint.asked == []


def test_a_missing_key_stops_the_check(endpoint: Endpoint) -> None:
    report = checked(endpoint, api_key_env="MY_KEY")
    assert not report.works
    assert "MY_KEY is not set" in str(report.trouble)


def test_nobody_there(endpoint: Endpoint) -> None:
    settings = llm_settings(Endpoint("http://127.0.0.1:1/v1"))
    report = asyncio.run(check_endpoint(settings, environ={}))
    assert (report.reachable, report.modes) == (False, ())
    assert "no answer" in str(report.trouble)


def test_each_question_is_tried_once(endpoint: Endpoint) -> None:
    endpoint.then(*[refuses(503, "busy")] * len(Mode))
    report = checked(endpoint, retries=5)
    assert len(endpoint.asked) == len(Mode)
    assert all("busy" in str(one.trouble) for one in report.modes)
