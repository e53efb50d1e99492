"""The client speaks to all the usual servers, tries again while that makes sense, and then says what to do."""

import asyncio
import json
import logging
import socket
from collections.abc import Awaitable, Callable
from datetime import UTC, datetime
from random import Random
from typing import Any, TypeVar

import pytest
from support.llm_endpoint import (
    MODEL,
    Endpoint,
    ErrorForm,
    Step,
    cut,
    gives,
    huge,
    llm_settings,
    refuses,
    says,
    unencrypted,
)

from brink.server.llm.client import MOST_REPLY_BYTES, Completion, LlmClient
from brink.server.llm.errors import (
    AccessRefused,
    EndpointAway,
    KeyMissing,
    LlmError,
    LlmFinal,
    ModelUnknown,
    OverBudget,
    RequestRefused,
    UnusableReply,
)
from brink.server.llm.form import SCHEMA
from brink.server.llm.settings import LlmSettings
from brink.server.llm.wire import Message, Mode
from brink.worker.backoff import Backoff

pytestmark = pytest.mark.timeout(30)

ASKED = (Message("system", "be brief"), Message("user", "what?"))
NOW = datetime(2026, 3, 1, 12, 0, 0, tzinfo=UTC)
KEY = "sk-secret/0123456789"
OK = says("yes")
R = TypeVar("R")


def using(
    settings: LlmSettings,
    task: Callable[[LlmClient], Awaitable[R]],
    pauses: list[float] | None = None,
    **options: Any,
) -> R:
    """Run a task with a client whose pauses take no time."""
    waits = pauses if pauses is not None else []

    async def pause(seconds: float) -> None:
        waits.append(seconds)

    async def run() -> R:
        given = {"environ": {}, "transport": unencrypted(), "rng": Random(1), "now": lambda: NOW, **options}
        async with LlmClient(settings, pause=pause, **given) as client:
            return await task(client)

    return asyncio.run(run())


def ask(client: LlmClient) -> Awaitable[Completion]:
    return client.complete(ASKED, SCHEMA)


def failing(endpoint: Endpoint, kind: type[LlmError], *steps: Step, **changes: Any) -> LlmError:
    """Return the error that a question ends with."""
    endpoint.then(*steps)
    with pytest.raises(kind) as caught:
        using(llm_settings(endpoint, **changes), ask)
    assert type(caught.value) is kind
    return caught.value


def test_a_question_carries_all_that_is_set(endpoint: Endpoint) -> None:
    endpoint.then(OK)
    changes: dict[str, Any] = {
        "temperature": 0.3, "top_p": 0.9, "seed": 7, "max_tokens": 512, "token_field": "max_completion_tokens",
        "api_key_env": "MY_KEY",
    }  # fmt: skip
    answer = using(llm_settings(endpoint, **changes), ask, environ={"MY_KEY": KEY})
    [asked] = endpoint.asked
    assert asked.path == "/v1/chat/completions"
    assert asked.headers["authorization"] == f"Bearer {KEY}"
    assert asked.body == {
        "model": MODEL,
        "messages": [{"role": "system", "content": "be brief"}, {"role": "user", "content": "what?"}],
        "temperature": 0.3,
        "top_p": 0.9,
        "seed": 7,
        "max_completion_tokens": 512,
        "stream": False,
        "response_format": {
            "type": "json_schema",
            "json_schema": {"name": "solutions", "strict": True, "schema": dict(SCHEMA)},
        },
    }
    assert (answer.text, answer.mode, answer.attempts, answer.lost) == ("yes", Mode.JSON_SCHEMA, 1, 0)
    assert json.loads(answer.raw)["choices"]
    assert answer.latency_s > 0


def test_what_is_not_set_is_not_sent(endpoint: Endpoint) -> None:
    endpoint.then(OK)
    using(llm_settings(endpoint), ask)
    [asked] = endpoint.asked
    assert "seed" not in asked.body
    assert "authorization" not in asked.headers
    assert asked.body["max_tokens"] == 4096


@pytest.mark.parametrize(
    "form_refusal",
    [
        refuses(400, "'response_format' of type json_schema is not supported"),
        refuses(400, "Bad request"),
        refuses(422, "Extra inputs are not permitted", ErrorForm.DETAILS),
        refuses(404, "json_schema is unsupported", ErrorForm.DETAIL),
        refuses(501, "structured output is not implemented", ErrorForm.WORD),
        refuses(500, "failed to parse grammar", ErrorForm.HTML),
    ],
)
def test_a_form_that_is_refused_is_replaced_by_a_looser_one_for_good(
    endpoint: Endpoint, form_refusal: Step
) -> None:
    endpoint.forms, endpoint.form_refusal = ("schema_in_object", "json_object", "plain"), form_refusal
    endpoint.then(OK, OK)

    async def twice(client: LlmClient) -> tuple[Completion, Completion, Mode]:
        return await ask(client), await ask(client), client.mode

    pauses: list[float] = []
    first, second, mode = using(llm_settings(endpoint), twice, pauses)
    assert [asked.form for asked in endpoint.asked] == ["json_schema", "schema_in_object", "schema_in_object"]
    assert endpoint.asked[1].body["response_format"] == {"type": "json_object", "schema": dict(SCHEMA)}
    assert (first.mode, first.attempts, first.lost) == (Mode.SCHEMA_IN_OBJECT, 2, 0)
    assert (second.mode, second.attempts, mode) == (Mode.SCHEMA_IN_OBJECT, 1, Mode.SCHEMA_IN_OBJECT)
    assert pauses == []


def test_the_last_form_is_plain(endpoint: Endpoint) -> None:
    endpoint.forms = ("plain",)
    endpoint.then(OK)
    assert using(llm_settings(endpoint), ask).mode is Mode.PLAIN
    assert [asked.form for asked in endpoint.asked] == [mode.value for mode in Mode]
    assert "response_format" not in endpoint.asked[-1].body


def test_a_form_that_was_found_before_is_taken_at_once(endpoint: Endpoint) -> None:
    endpoint.then(OK)
    assert using(llm_settings(endpoint), ask, mode=Mode.PLAIN).mode is Mode.PLAIN
    assert len(endpoint.asked) == 1


def test_a_form_that_worked_is_not_given_up_for_another_trouble(endpoint: Endpoint) -> None:
    endpoint.then(OK, refuses(400, "maximum context length is 2048 tokens"), OK)

    async def thrice(client: LlmClient) -> list[Mode]:
        modes = [(await ask(client)).mode]
        with pytest.raises(RequestRefused, match="context length"):
            await ask(client)
        return [*modes, (await ask(client)).mode]

    assert using(llm_settings(endpoint), thrice) == [Mode.JSON_SCHEMA] * 2


def test_a_form_is_not_given_up_if_no_other_works_either(endpoint: Endpoint) -> None:
    endpoint.then(*[refuses(400, "maximum context length is 2048 tokens")] * len(Mode), OK)

    async def twice(client: LlmClient) -> Mode:
        with pytest.raises(RequestRefused, match="context length"):
            await ask(client)
        return (await ask(client)).mode

    assert using(llm_settings(endpoint), twice) is Mode.JSON_SCHEMA


@pytest.mark.parametrize("status", [408, 409, 425, 429, 500, 502, 503, 504])
def test_a_short_disturbance_is_tried_again_with_growing_pauses(endpoint: Endpoint, status: int) -> None:
    pauses: list[float] = []
    endpoint.then(refuses(status, "busy"), refuses(status, "busy"), OK)
    answer = using(llm_settings(endpoint), ask, pauses, backoff=Backoff(first_s=1.0, cap_s=60.0))
    assert (answer.attempts, answer.lost) == (3, 0)
    assert 0.5 <= pauses[0] <= 1.0 <= pauses[1] <= 2.0


def test_an_error_inside_a_success_counts_as_what_it_is(endpoint: Endpoint) -> None:
    endpoint.then(gives({"error": {"message": "upstream overloaded", "code": 502}}), OK)
    assert using(llm_settings(endpoint), ask).attempts == 2


def test_a_longer_disturbance_ends_with_what_was_said(endpoint: Endpoint) -> None:
    error = failing(endpoint, EndpointAway, *[refuses(503, "loading model", ErrorForm.WORD)] * 3)
    assert str(error) == f"{endpoint.url} answered 503: loading model; gave up after 3 tries"
    assert (error.effort.requests, error.effort.lost) == (3, 0)


@pytest.mark.parametrize(
    ("stated", "waited"),
    [
        ("7", 7.0),
        ("0.5", 0.5),
        ("Sun, 01 Mar 2026 12:00:09 GMT", 9.0),
        ("Sun, 01 Mar 2026 13:00:09 +0100", 9.0),
    ],
)
def test_a_pause_that_the_endpoint_asks_for_is_kept(endpoint: Endpoint, stated: str, waited: float) -> None:
    pauses: list[float] = []
    endpoint.then(refuses(429, "slow down", Retry_After=stated), OK)
    using(llm_settings(endpoint), ask, pauses)
    assert pauses == [waited]


@pytest.mark.parametrize(
    "stated", ["soon", "-5", "nan", "inf", "0", "Sun, 01 Mar 2020 12:00:09 GMT", "1" * 400]
)
def test_a_pause_that_makes_no_sense_is_replaced_by_our_own(endpoint: Endpoint, stated: str) -> None:
    pauses: list[float] = []
    endpoint.then(refuses(429, "slow down", Retry_After=stated), OK)
    using(llm_settings(endpoint), ask, pauses)
    assert 0.5 <= pauses[0] <= 1.0


@pytest.mark.parametrize("stated", ["31", "1e9", "Sun, 01 Mar 2026 12:00:31 GMT"])
def test_nobody_waits_longer_than_allowed(endpoint: Endpoint, stated: str) -> None:
    pauses: list[float] = []
    endpoint.then(refuses(429, "slow down", Retry_After=stated))
    with pytest.raises(EndpointAway, match=r"longer than max_wait_s \(30 s\)"):
        using(llm_settings(endpoint, max_wait_s=30), ask, pauses)
    assert pauses == []
    assert len(endpoint.asked) == 1


def test_our_own_pauses_are_no_longer_than_allowed(endpoint: Endpoint) -> None:
    pauses: list[float] = []
    endpoint.then(*[refuses(503)] * 4, OK)
    using(llm_settings(endpoint, retries=4, max_wait_s=0.6), ask, pauses)
    assert len(pauses) == 4
    assert max(pauses) <= 0.6


def test_a_server_that_stalls_is_given_up_in_time(endpoint: Endpoint) -> None:
    error = failing(endpoint, EndpointAway, *[endpoint.stalls()] * 2, timeout_s=0.2, retries=1)
    assert "no answer within 0.2 s; gave up after 2 tries" in str(error)
    assert (error.effort.requests, error.effort.lost) == (2, 2)
    assert 0.4 <= error.effort.elapsed_s < 5


def test_a_connection_that_is_cut_is_tried_again(endpoint: Endpoint) -> None:
    endpoint.then(cut("yes"), OK)
    answer = using(llm_settings(endpoint), ask)
    assert (answer.text, answer.attempts, answer.lost) == ("yes", 2, 1)


def test_nobody_there_is_said_so() -> None:
    with socket.socket() as deaf:
        deaf.bind(("127.0.0.1", 0))
        place = f"127.0.0.1:{deaf.getsockname()[1]}"
        settings = LlmSettings(endpoint=f"http://{place}/v1", model=MODEL, retries=1)
        with pytest.raises(EndpointAway, match=rf"{place}/v1: no answer .*gave up after 2 tries") as caught:
            using(settings, ask)
    assert (caught.value.effort.requests, caught.value.effort.lost) == (2, 0)


@pytest.mark.parametrize(
    ("step", "kind", "advice"),
    [
        (refuses(401, "bad key"), AccessRefused, "bad key. Check the key in MY_KEY"),
        (refuses(403, "not you", ErrorForm.DETAIL), AccessRefused, "not you. Check the key in MY_KEY"),
        (refuses(402, "pay first"), AccessRefused, "There is no credit left"),
        (refuses(429, "You exceeded your current quota"), AccessRefused, "There is no credit left"),
        (refuses(404, "model not found", ErrorForm.WORD), ModelUnknown, f"serves the model '{MODEL}'"),
        (refuses(413, "too large", ErrorForm.HTML), RequestRefused, "answered 413: <html><body>too large"),
        (refuses(501, "later"), RequestRefused, "answered 501: later"),
        (refuses(307, "over there", Location="http://127.0.0.1:9/"), RequestRefused, "give that address as endpoint"),
    ],
)  # fmt: skip
def test_what_will_not_get_better_is_said_at_once_with_advice(
    endpoint: Endpoint, step: Step, kind: type[LlmError], advice: str
) -> None:
    endpoint.then(step)
    with pytest.raises(LlmFinal) as caught:
        using(llm_settings(endpoint, api_key_env="MY_KEY"), ask, environ={"MY_KEY": KEY})
    assert type(caught.value) is kind
    assert advice in str(caught.value)
    assert len(endpoint.asked) == 1
    assert caught.value.effort.lost == 0


def test_the_name_of_the_token_limit_is_advised(endpoint: Endpoint) -> None:
    words = "Unsupported parameter: 'max_tokens'. Use 'max_completion_tokens' instead."
    error = failing(endpoint, RequestRefused, *[refuses(400, words)] * len(Mode))
    assert "Set token_field: max_completion_tokens" in str(error)


@pytest.mark.parametrize(
    ("step", "expected"),
    [
        (gives({"choices": []}), "one without"),
        (gives({"choices": [None]}), "one without"),
        (gives({"choices": [{"text": "old api"}]}), "one without"),
        (gives({"choices": None}), "expected a chat completion with choices"),
        (gives(["no"]), "expected a chat completion with choices"),
        (gives({"error": {"message": "no code"}}), "got no code"),
        (huge(1000), "got no JSON"),
    ],
)
def test_a_success_that_is_no_completion_is_not_asked_for_again(
    endpoint: Endpoint, step: Step, expected: str
) -> None:
    error = failing(endpoint, UnusableReply, step)
    assert expected in str(error)
    assert (error.effort.requests, error.effort.lost) == (1, 1)


def test_a_huge_body_is_cut(endpoint: Endpoint) -> None:
    error = failing(endpoint, UnusableReply, huge(8 * MOST_REPLY_BYTES))
    assert f"at most {MOST_REPLY_BYTES} bytes" in str(error)


def test_nothing_is_sent_without_a_key_that_is_wanted(endpoint: Endpoint) -> None:
    error = failing(endpoint, KeyMissing, api_key_env="MY_KEY")
    assert "MY_KEY is not set" in str(error)
    assert endpoint.asked == []
    assert error.effort.requests == 0


def test_each_request_is_allowed_first(endpoint: Endpoint) -> None:
    seen: list[int] = []

    def may_send(lost: int) -> None:
        seen.append(lost)
        if lost == 2:
            raise OverBudget("no more")

    endpoint.then(cut("a"), refuses(503), cut("b"), OK)
    with pytest.raises(OverBudget, match="no more") as caught:
        using(llm_settings(endpoint, retries=9), lambda c: c.complete(ASKED, SCHEMA, may_send=may_send))
    assert seen == [0, 1, 1, 2]
    assert (caught.value.effort.requests, caught.value.effort.lost) == (3, 2)


def test_the_key_is_never_repeated(endpoint: Endpoint, caplog: pytest.LogCaptureFixture) -> None:
    """Some gateways quote the key that they refuse; models can be made to."""
    endpoint.key = "another"
    settings, environ = llm_settings(endpoint, api_key_env="MY_KEY"), {"MY_KEY": KEY}
    with caplog.at_level(logging.DEBUG):
        with pytest.raises(AccessRefused, match=r"Incorrect API key provided: \[key\]") as caught:
            using(settings, ask, environ=environ)
        endpoint.reset()
        endpoint.then(refuses(503, f"busy with {KEY}"), says(f"your key is {KEY}"))
        answer = using(settings, ask, environ=environ)
    assert answer.text == "your key is [key]"
    chain = repr(caught.value) + repr(caught.value.__context__) + str(vars(caught.value))
    for shown in (chain, repr(answer), answer.raw, caplog.text, repr(settings), settings.model_dump_json()):
        assert KEY not in shown
        assert KEY.replace("/", "\\/") not in shown
    assert any(KEY in asked.headers["authorization"] for asked in endpoint.asked)


@pytest.mark.parametrize(
    ("listed", "names"),
    [
        ({"object": "list", "data": [{"id": "a", "max_model_len": 4096}, {"id": "b"}]}, ("a", "b")),
        (
            {"models": [{"name": "a:latest", "model": "a:latest"}], "object": "list", "data": [{"id": "a"}]},
            ("a",),
        ),
        ({"models": [{"name": "a:latest"}]}, ("a:latest",)),
        (["a", {"id": "b"}, {"id": 7}, None], ("a", "b")),
        ({"data": []}, ()),
        ({"data": "x"}, None),
        (7, None),
        (None, None),
    ],
)
def test_models_are_listed_in_any_form(
    endpoint: Endpoint, listed: Any, names: tuple[str, ...] | None
) -> None:
    endpoint.models = listed
    assert using(llm_settings(endpoint), lambda client: client.models()) == names
