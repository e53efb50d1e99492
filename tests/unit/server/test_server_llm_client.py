"""The client understands the usual servers and arbitrary replies, retries, and reports errors with advice."""

import asyncio
import json
import logging
import socket
import time
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from random import Random
from typing import Any, TypeVar

import pytest
from fastapi.responses import Response
from hypothesis import given
from hypothesis import strategies as st
from support.llm_endpoint import (
    MODEL,
    Endpoint,
    ErrorForm,
    Server,
    Step,
    access_to,
    completion,
    error_body,
    gives,
    huge,
    llm_settings,
    refuses,
    says,
    unencrypted,
)

from brink.server.llm.client import MAX_REPLY_BYTES, Call, LlmClient
from brink.server.llm.protocol import (
    AccessRefused,
    EndpointUnavailable,
    LlmError,
    Message,
    NotSent,
    Refused,
    Reply,
    UnusableReply,
    Usage,
    embedded_status,
    error_text,
    parse_models,
    parse_retry_after,
    read_reply,
    sanitize,
)
from brink.server.llm.replies import SCHEMA
from brink.server.llm.settings import LlmSettings
from brink.server.seeding import Mode
from brink.worker.backoff import Backoff

NOW = datetime(2026, 3, 1, 12, 0, 0, tzinfo=UTC)
KEY = "sk-secret/0123456789"

json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(
                [
                    "choices",
                    "message",
                    "content",
                    "text",
                    "usage",
                    "prompt_tokens",
                    "total_tokens",
                    "error",
                    "code",
                    "detail",
                    "msg",
                    "data",
                    "models",
                    "id",
                    "refusal",
                    "finish_reason",
                ]
            ),
            inner,
        )
    ),
    max_leaves=12,
)


def heard(body: Any) -> Reply:
    return read_reply(json.dumps(body))


@pytest.mark.parametrize("server", Server)
@pytest.mark.parametrize("finish", ["stop", "length", "MAX_TOKENS", None])
def test_replies_of_all_servers_are_parsed(server: Server, finish: str | None) -> None:
    reply = heard(completion("yes", server, finish))
    assert reply.text == "yes"
    assert reply.finish_reason == (finish.lower() if finish else None)
    assert reply.truncated is (finish in ("length", "MAX_TOKENS"))
    assert not reply.refusal
    stated = None if server is Server.OLLAMA else Usage(prompt_tokens=900, completion_tokens=100)
    assert reply.usage == stated


@pytest.mark.parametrize("name", ["reasoning_content", "reasoning", "thinking"])
def test_reasoning_is_the_answer_only_if_there_is_no_content(name: str) -> None:
    with_both, with_thoughts = completion("yes"), completion(None)
    for body in (with_both, with_thoughts):
        body["choices"][0]["message"][name] = "hm"
    assert heard(with_both).text == "yes"
    assert heard(with_thoughts).text == "hm"


@pytest.mark.parametrize(
    ("usage", "expected"),
    [
        ({"prompt_tokens": 5, "completion_tokens": 7}, (5, 7)),
        ({"prompt_tokens": 5, "total_tokens": 12}, (5, 7)),
        ({"prompt_tokens": 5, "completion_tokens": 7, "total_tokens": 40}, (5, 35)),
        ({"prompt_tokens": 5.0, "completion_tokens": 7}, (5, 7)),
        ({"prompt_tokens": 5}, None),
        ({"prompt_tokens": -5, "completion_tokens": 7}, None),
        ({"prompt_tokens": 10**30, "completion_tokens": 7}, None),
        ({"prompt_tokens": float("nan"), "completion_tokens": 7}, None),
        ({"prompt_tokens": True, "completion_tokens": "7"}, None),
        ({}, None),
        (None, None),
        ("many", None),
    ],
)
def test_invalid_usage_is_ignored(usage: Any, expected: tuple[int, int] | None) -> None:
    found = heard({**completion("yes"), "usage": usage}).usage
    assert (None if found is None else (found.prompt_tokens, found.completion_tokens)) == expected


@given(json_values | st.builds(lambda value: {"choices": [{"message": value}]}, json_values))
def test_arbitrary_json_is_parsed_or_rejected(value: Any) -> None:
    raw = json.dumps(value)
    with suppress(UnusableReply):
        assert isinstance(read_reply(raw).text, str)
    words = error_text(raw)
    assert 0 < len(words) <= 300
    assert words.isprintable()
    names = parse_models(raw)
    assert names is None or all(isinstance(name, str) for name in names)
    status = embedded_status(raw)
    assert status is None or 400 <= status <= 599


@pytest.mark.parametrize("raw", ["", "<html>", "[" * 100_000, '{"choices": [', "null"])
def test_what_is_no_json_is_no_reply(raw: str) -> None:
    with pytest.raises(UnusableReply, match="expected a chat completion"):
        read_reply(raw)
    assert parse_models(raw) is None


@pytest.mark.parametrize("form", ErrorForm)
def test_errors_are_understood_in_any_form(form: ErrorForm) -> None:
    body = error_body("too\n many \x07 requests", form)
    words = error_text(body if isinstance(body, str) else json.dumps(body))
    assert "too many requests" in words
    assert "{" not in words


def test_what_was_said_is_bounded() -> None:
    assert error_text("x" * 10_000) == "x" * 300
    assert error_text(" \n ") == "nothing"


@pytest.mark.parametrize("key", [KEY, 'sk-quoted"and\\slashed'])
def test_the_key_is_removed_in_every_json_escaping(key: str) -> None:
    bodies = (key, json.dumps({"said": key}), json.dumps({"said": key}).replace("/", "\\/"))
    for body in bodies:
        assert "[key]" in sanitize(body.encode(), [key])


def test_bodies_are_decoded_to_text_that_can_be_stored() -> None:
    assert sanitize(b"a\x00b\xff") == "a\ufffdb\ufffd"


@given(
    st.text()
    | st.from_regex(r"\A[A-Z][a-z]{2}, [0-9]{1,2} [A-Z][a-z]{2} [0-9]{1,5} [0-9:]{1,8} [-+A-Z0-9]{1,6}\Z")
    | st.sampled_from(
        ["Sun, 01 Mar 2026 12:00:09", "Sun, 01 Mar 9999 12:00:09 -9999", "0001", "1e308", "-inf"]
    )
)
def test_arbitrary_retry_after_headers_give_a_time_or_none(stated: str) -> None:
    wait_s = parse_retry_after({"Retry-After": stated}, NOW)
    assert wait_s is None or wait_s >= 0
    assert parse_retry_after({}, NOW) is None


pytestmark = pytest.mark.timeout(30)

ASKED = (Message("system", "be brief"), Message("user", "what?"))
OK = says("yes")
R = TypeVar("R")


def using(
    settings: LlmSettings,
    task: Callable[[LlmClient], Awaitable[R]],
    pauses: list[float] | None = None,
    environ: Mapping[str, str] | None = None,
    **options: Any,
) -> R:
    """Run a task with a client that does not wait during pauses."""
    waits = pauses if pauses is not None else []

    async def pause(seconds: float) -> None:
        waits.append(seconds)

    async def run() -> R:
        given = {
            "access": access_to(settings, environ),
            "transport": unencrypted(),
            "rng": Random(1),
            "now": lambda: NOW,
            **options,
        }
        async with LlmClient(settings, pause=pause, **given) as client:
            return await task(client)

    return asyncio.run(run())


def ask(client: LlmClient, call: Call | None = None) -> Awaitable[Reply]:
    call = call or Call()
    call.tries = client.settings.retries + 1
    return client.complete(ASKED, SCHEMA, call)


def counted(settings: LlmSettings, **options: Any) -> tuple[Call, Reply | LlmError]:
    """Return the requests of a call, and the reply or the error that it gives."""
    call = Call()
    try:
        return call, using(settings, partial(ask, call=call), **options)
    except LlmError as error:
        return call, error


def failing(endpoint: Endpoint, kind: type[LlmError], *steps: Step, **changes: Any) -> tuple[Call, LlmError]:
    """Return the requests of a call that fails, and its error."""
    endpoint.then(*steps)
    call, error = counted(llm_settings(endpoint, **changes))
    assert type(error) is kind
    return call, error


def test_a_request_contains_all_settings(endpoint: Endpoint) -> None:
    endpoint.then(OK)
    changes: dict[str, Any] = {
        "temperature": 0.3,
        "top_p": 0.9,
        "seed": 7,
        "max_tokens": 512,
        "token_field": "max_completion_tokens",
        "api_key_env": "MY_KEY",
    }
    call, answer = counted(llm_settings(endpoint, **changes), environ={"MY_KEY": KEY})
    assert isinstance(answer, Reply)
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
    assert (answer.text, call.requests) == ("yes", 1)
    assert json.loads(answer.raw)["choices"]
    assert call.latency_s > 0


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
def test_rejected_form_is_permanently_replaced_by_a_looser(endpoint: Endpoint, form_refusal: Step) -> None:
    endpoint.forms, endpoint.form_refusal = ("schema_in_object", "json_object", "plain"), form_refusal
    endpoint.then(OK, OK)

    calls = Call(), Call()

    async def twice(client: LlmClient) -> tuple[Reply, Reply, Mode]:
        return await ask(client, calls[0]), await ask(client, calls[1]), client.mode

    pauses: list[float] = []
    *_, mode = using(llm_settings(endpoint), twice, pauses)
    assert [asked.form for asked in endpoint.asked] == ["json_schema", "schema_in_object", "schema_in_object"]
    assert endpoint.asked[1].body["response_format"] == {"type": "json_object", "schema": dict(SCHEMA)}
    assert [(call.requests, call.failures) for call in calls] == [(2, ["json_schema refused"]), (1, [])]
    assert mode is Mode.SCHEMA_IN_OBJECT
    assert pauses == []


def test_the_form_that_an_earlier_client_found_is_used_first(endpoint: Endpoint) -> None:
    endpoint.then(OK)
    using(llm_settings(endpoint), ask, mode=Mode.PLAIN)
    assert [asked.form for asked in endpoint.asked] == ["plain"]


def test_a_working_form_is_kept_after_an_unrelated_error(endpoint: Endpoint) -> None:
    endpoint.then(OK, refuses(400, "maximum context length is 2048 tokens"), OK)

    async def thrice(client: LlmClient) -> Mode:
        await ask(client)
        with pytest.raises(Refused, match="context length"):
            await ask(client)
        await ask(client)
        return client.mode

    assert using(llm_settings(endpoint), thrice) is Mode.JSON_SCHEMA
    assert [asked.form for asked in endpoint.asked] == ["json_schema"] * 3


@pytest.mark.parametrize("status", [408, 409, 425, 429, 500, 502, 503, 504])
def test_retryable_errors_are_retried_with_growing_pauses(endpoint: Endpoint, status: int) -> None:
    pauses: list[float] = []
    endpoint.then(refuses(status, "busy"), refuses(status, "busy"), OK)
    call, _ = counted(llm_settings(endpoint), pauses=pauses, backoff=Backoff(first_s=1.0, cap_s=60.0))
    assert (call.requests, call.lost, call.failures) == (3, 0, [f"HTTP {status}"] * 2)
    assert 0.5 <= pauses[0] <= 1.0 <= pauses[1] <= 2.0


def test_an_error_embedded_in_a_2xx_answer_is_retried(endpoint: Endpoint) -> None:
    endpoint.then(gives({"error": {"message": "upstream overloaded", "code": 502}}), OK)
    call, answer = counted(llm_settings(endpoint))
    assert isinstance(answer, Reply)
    assert call.requests == 2


@pytest.mark.parametrize(
    ("stated", "waited"),
    [
        ("7", 7.0),
        ("0.5", 0.5),
        ("Sun, 01 Mar 2026 12:00:09 GMT", 9.0),
        ("Sun, 01 Mar 2026 13:00:09 +0100", 9.0),
    ],
)
def test_retry_after_is_honoured(endpoint: Endpoint, stated: str, waited: float) -> None:
    pauses: list[float] = []
    endpoint.then(refuses(429, "slow down", Retry_After=stated), OK)
    using(llm_settings(endpoint), ask, pauses)
    assert pauses == [waited]


@pytest.mark.parametrize(
    "stated", ["soon", "-5", "nan", "inf", "0", "Sun, 01 Mar 2020 12:00:09 GMT", "1" * 400]
)
def test_an_invalid_retry_after_is_ignored(endpoint: Endpoint, stated: str) -> None:
    pauses: list[float] = []
    endpoint.then(refuses(429, "slow down", Retry_After=stated), OK)
    using(llm_settings(endpoint), ask, pauses)
    assert 0.5 <= pauses[0] <= 1.0


def test_backoff_is_limited_by_max_wait_s(endpoint: Endpoint) -> None:
    pauses: list[float] = []
    endpoint.then(*[refuses(503)] * 4, OK)
    using(llm_settings(endpoint, retries=4, max_wait_s=0.6), ask, pauses)
    assert len(pauses) == 4
    assert max(pauses) <= 0.6


def test_an_unreachable_endpoint_is_reported() -> None:
    with socket.socket() as deaf:
        deaf.bind(("127.0.0.1", 0))
        place = f"127.0.0.1:{deaf.getsockname()[1]}"
        settings = LlmSettings(endpoint=f"http://{place}/v1", model=MODEL, retries=1)
        call, error = counted(settings)
    assert isinstance(error, EndpointUnavailable)
    assert f"{place}/v1: no connection (2 tries): " in str(error)
    assert (call.requests, call.lost) == (2, 0)


@pytest.mark.parametrize(
    ("step", "kind", "advice"),
    [
        (refuses(401, "bad key"), AccessRefused, "bad key. Check the key in MY_KEY"),
        (refuses(403, "not you", ErrorForm.DETAIL), AccessRefused, "not you. Check the key in MY_KEY"),
        (refuses(402, "pay first"), AccessRefused, "There is no credit left"),
        (refuses(429, "You exceeded your current quota"), AccessRefused, "There is no credit left"),
        (refuses(404, "model not found", ErrorForm.WORD), Refused, f"serves the model '{MODEL}'"),
        (refuses(413, "too large", ErrorForm.HTML), Refused, "HTTP 413: <html><body>too large"),
        (refuses(501, "later"), Refused, "HTTP 501: later"),
        (refuses(307, "over there", Location="http://127.0.0.1:9/"), Refused, "set endpoint to the new"),
    ],
)
def test_final_errors_come_with_advice(
    endpoint: Endpoint, step: Step, kind: type[LlmError], advice: str
) -> None:
    endpoint.then(step)
    call, error = counted(llm_settings(endpoint, api_key_env="MY_KEY"), environ={"MY_KEY": KEY})
    assert type(error) is kind
    assert advice in str(error)
    assert len(endpoint.asked) == 1
    assert call.lost == 0


@pytest.mark.parametrize(
    ("step", "expected"),
    [
        (gives({"choices": []}), "one without"),
        (gives({"choices": [None]}), "one without"),
        (gives({"choices": [{"text": "old api"}]}), "one without"),
        (gives({"choices": None}), "expected a chat completion with choices"),
        (gives(["no"]), "expected a chat completion with choices"),
        (gives({"error": {"message": "no code"}}), "got no code"),
        (huge(1000), "expected a chat completion with choices"),
    ],
)
def test_an_unusable_2xx_answer_is_not_retried(endpoint: Endpoint, step: Step, expected: str) -> None:
    call, error = failing(endpoint, UnusableReply, step)
    assert expected in str(error)
    assert (call.requests, call.lost) == (1, 1)


def test_the_key_is_never_repeated(endpoint: Endpoint, caplog: pytest.LogCaptureFixture) -> None:
    """Some gateways quote a rejected key, and models can be made to quote it."""
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
def test_every_model_list_is_parsed(endpoint: Endpoint, listed: Any, names: tuple[str, ...] | None) -> None:
    endpoint.models = listed
    assert using(llm_settings(endpoint), lambda client: client.models()) == names


def test_a_redirect_is_not_followed(endpoint: Endpoint) -> None:
    """Whoever answers must not choose where the prompt and the key go."""

    def elsewhere(_: object) -> Response:
        return Response(status_code=307, headers={"Location": f"{endpoint.url}/chat/completions"})

    endpoint.then(elsewhere, OK)
    with pytest.raises(Refused, match="It redirects: set endpoint to the new address"):
        using(llm_settings(endpoint, api_key_env="MY_KEY"), ask, environ={"MY_KEY": KEY})
    assert len(endpoint.asked) == 1


def test_what_the_operator_does_not_allow_is_not_sent(endpoint: Endpoint) -> None:
    settings = llm_settings(endpoint, api_key_env="OTHER_SECRET")
    for task in (ask, LlmClient.models):
        with pytest.raises(NotSent, match="may not send the key in OTHER_SECRET"):
            using(settings, task, environ={"OTHER_SECRET": KEY})
    assert endpoint.asked == []


@pytest.mark.parametrize("stated", ["31", "1e9", "Sun, 01 Mar 2026 12:00:31 GMT"])
def test_a_retry_after_beyond_the_limit_ends_the_call(endpoint: Endpoint, stated: str) -> None:
    pauses: list[float] = []
    endpoint.then(refuses(429, "slow down", Retry_After=stated))
    with pytest.raises(EndpointUnavailable, match=r"longer than max_wait_s \(30 s\)"):
        using(llm_settings(endpoint, max_wait_s=30), ask, pauses)
    assert pauses == []
    assert len(endpoint.asked) == 1


def test_a_stalled_server_times_out(endpoint: Endpoint) -> None:
    began = time.monotonic()
    call, error = failing(endpoint, EndpointUnavailable, *[endpoint.stalls()] * 2, timeout_s=0.2, retries=1)
    assert "timed out after 0.2 s (2 tries)" in str(error)
    assert (call.requests, call.lost) == (2, 2)
    assert 0.4 <= time.monotonic() - began < 5


def test_an_oversized_body_is_rejected(endpoint: Endpoint) -> None:
    _, error = failing(endpoint, UnusableReply, huge(8 * MAX_REPLY_BYTES))
    assert f"at most {MAX_REPLY_BYTES} bytes" in str(error)


def test_nothing_is_sent_while_the_key_is_missing(endpoint: Endpoint) -> None:
    call, error = failing(endpoint, NotSent, api_key_env="MY_KEY")
    assert "MY_KEY is not set" in str(error)
    assert endpoint.asked == []
    assert call.requests == 0
