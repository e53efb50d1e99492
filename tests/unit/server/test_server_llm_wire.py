"""Replies of all the usual servers are understood, and whatever else comes is told from them."""

import json
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.llm_endpoint import ErrorForm, Server, completion, error_body

from brink.server.llm.errors import UnusableReply
from brink.server.llm.faults import retry_after_s, status_within
from brink.server.llm.wire import Mode, Reply, Usage, clean, listed_models, read_reply, said

NOW = datetime(2026, 3, 1, 12, 0, 0, tzinfo=UTC)
KEY = "sk-secret/0123456789"

json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(
                ["choices", "message", "content", "text", "usage", "prompt_tokens", "total_tokens", "error", "code",
                 "detail", "msg", "data", "models", "id", "refusal", "finish_reason"]
            ),
            inner,
        )
    ),
    max_leaves=12,
)  # fmt: skip


def heard(body: Any) -> Reply:
    return read_reply(json.dumps(body))


@pytest.mark.parametrize("server", Server)
@pytest.mark.parametrize("finish", ["stop", "length", "MAX_TOKENS", None])
def test_all_servers_are_understood(server: Server, finish: str | None) -> None:
    reply = heard(completion("yes", server, finish))
    assert reply.text == "yes"
    assert reply.finish_reason == (finish.lower() if finish else None)
    assert reply.cut_short is (finish in ("length", "MAX_TOKENS"))
    assert not reply.refusal
    stated = None if server is Server.OLLAMA else Usage(prompt_tokens=900, completion_tokens=100)
    assert reply.usage == stated


@pytest.mark.parametrize(
    ("content", "text"),
    [
        ([{"type": "text", "text": "ye"}, {"type": "text", "text": "s"}], "yes"),
        (["y", {"text": "es"}, {"type": "image_url"}, 7], "yes"),
        (None, ""),
        ("", ""),
        (7, ""),
    ],
)
def test_content_may_come_in_parts_or_not_at_all(content: Any, text: str) -> None:
    assert heard(completion(content)).text == text


@pytest.mark.parametrize("name", ["reasoning_content", "reasoning", "thinking"])
def test_thoughts_are_no_answer_unless_there_is_none(name: str) -> None:
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
def test_usage_is_taken_only_if_it_makes_sense(usage: Any, expected: tuple[int, int] | None) -> None:
    found = heard({**completion("yes"), "usage": usage}).usage
    assert (None if found is None else (found.prompt_tokens, found.completion_tokens)) == expected


@pytest.mark.parametrize("finish", ["content_filter", "SAFETY"])
def test_a_filter_declines(finish: str) -> None:
    assert heard(completion(None, finish=finish)).refusal


def test_a_model_declines() -> None:
    body = completion(None)
    body["choices"][0]["message"]["refusal"] = "I cannot help with that."
    assert heard(body).refusal


@given(json_values | st.builds(lambda value: {"choices": [{"message": value}]}, json_values))
def test_any_json_is_a_reply_or_none(value: Any) -> None:
    raw = json.dumps(value)
    with suppress(UnusableReply):
        assert isinstance(read_reply(raw).text, str)
    words = said(raw)
    assert 0 < len(words) <= 300
    assert words.isprintable()
    names = listed_models(raw)
    assert names is None or all(isinstance(name, str) for name in names)
    status = status_within(raw)
    assert status is None or 400 <= status <= 599


@pytest.mark.parametrize("raw", ["", "<html>", "[" * 100_000, '{"choices": [', "null"])
def test_what_is_no_json_is_no_reply(raw: str) -> None:
    with pytest.raises(UnusableReply, match="expected a chat completion"):
        read_reply(raw)
    assert listed_models(raw) is None


@pytest.mark.parametrize("form", ErrorForm)
def test_errors_are_understood_in_any_form(form: ErrorForm) -> None:
    body = error_body("too\n many \x07 requests", form)
    words = said(body if isinstance(body, str) else json.dumps(body))
    assert "too many requests" in words
    assert "{" not in words


def test_what_was_said_is_bounded() -> None:
    assert said("x" * 10_000) == "x" * 300
    assert said(" \n ") == "nothing"


@pytest.mark.parametrize("key", [KEY, 'sk-quoted"and\\slashed'])
def test_the_key_is_found_however_json_writes_it(key: str) -> None:
    bodies = (key, json.dumps({"said": key}), json.dumps({"said": key}).replace("/", "\\/"))
    for body in bodies:
        assert "[key]" in clean(body.encode(), [key])


def test_a_body_becomes_text_that_can_be_stored() -> None:
    assert clean(b"a\x00b\xff") == "a\ufffdb\ufffd"


@given(
    st.text()
    | st.from_regex(r"\A[A-Z][a-z]{2}, [0-9]{1,2} [A-Z][a-z]{2} [0-9]{1,5} [0-9:]{1,8} [-+A-Z0-9]{1,6}\Z")
    | st.sampled_from(
        ["Sun, 01 Mar 2026 12:00:09", "Sun, 01 Mar 9999 12:00:09 -9999", "0001", "1e308", "-inf"]
    )
)
def test_any_wish_for_a_pause_is_a_time_or_nothing(stated: str) -> None:
    wait_s = retry_after_s({"Retry-After": stated}, NOW)
    assert wait_s is None or wait_s >= 0
    assert retry_after_s({}, NOW) is None


def test_modes_go_from_strict_to_plain() -> None:
    assert [mode.looser for mode in Mode] == [Mode.SCHEMA_IN_OBJECT, Mode.JSON_OBJECT, Mode.PLAIN, None]
