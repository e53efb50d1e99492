"""What is known before a campaign starts: whether an endpoint works, what calls cost, and what the budget allows."""

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.llm_endpoint import (
    MODEL,
    Endpoint,
    Server,
    access_to,
    gives,
    items,
    llm_settings,
    refuses,
    reply_text,
    says,
)

from brink.search.traffic.participants import RoadLimits
from brink.server.llm.calls import check_budget, cost_of, tokens_of, using, worst_usage
from brink.server.llm.preflight import EndpointReport, Estimate, check_endpoint, estimate
from brink.server.llm.protocol import Message, OverBudget, Usage, canonical
from brink.server.llm.settings import LlmSettings
from brink.server.seeding import LlmCall, Mode, Spent, spent_on

ASKED = (Message("user", "x" * 700),)
PRICES = {"input_price": 2.0, "output_price": 10.0}


def settings(**changes: Any) -> LlmSettings:
    given: dict[str, Any] = {
        "endpoint": "http://127.0.0.1:8000/v1",
        "model": "m",
        "max_tokens": 1000,
        **changes,
    }
    return LlmSettings.model_validate(given)


WORST = worst_usage(settings(), ASKED)


def test_the_worst_case_is_the_estimated_prompt_and_the_longest_reply() -> None:
    assert tokens_of(7) == 2
    assert tokens_of(8) == 3
    assert WORST.prompt_tokens == tokens_of(len(canonical(ASKED)))
    assert (WORST.completion_tokens, WORST.estimated) == (1000, True)
    assert WORST.prompt_tokens >= 200


def test_a_cost_needs_both_prices() -> None:
    usage = Usage(prompt_tokens=1_000_000, completion_tokens=100_000)
    assert cost_of(usage, settings(**PRICES)) == pytest.approx(3.0)
    assert cost_of(usage, settings(input_price=2.0)) is None
    assert cost_of(usage, settings()) is None


def test_each_limit_is_enforced_exactly() -> None:
    check_budget(Spent(total_calls=1), settings(max_calls=2), ASKED)
    with pytest.raises(OverBudget, match="all 2 requests of max_calls"):
        check_budget(Spent(total_calls=2), settings(max_calls=2), ASKED)
    limited = settings(max_total_tokens=5000)
    check_budget(Spent(total_tokens=5000 - WORST.total), limited, ASKED)
    with pytest.raises(OverBudget, match=r"max_total_tokens"):
        check_budget(Spent(total_tokens=5001 - WORST.total), limited, ASKED)
    priced = settings(max_cost=1.0, **PRICES)
    worst = cost_of(WORST, priced)
    assert worst is not None
    check_budget(Spent(cost=0.999 - worst), priced, ASKED)
    with pytest.raises(OverBudget, match="max_cost"):
        check_budget(Spent(cost=1.001 - worst), priced, ASKED)


NEW = LlmCall(request=0, turn=0, prompt_hash="0" * 64, mode=Mode.PLAIN)


def test_max_cost_cannot_be_enforced_while_the_cost_is_unknown() -> None:
    unpriced = using(NEW, settings(), 2, WORST)
    with pytest.raises(OverBudget, match="the cost of earlier requests is unknown"):
        check_budget(spent_on([unpriced]), settings(max_cost=1.0, **PRICES), ASKED)


@given(
    st.lists(st.integers(1, 2000), max_size=30),
    st.integers(1, 20_000),
    st.integers(1, 10),
    st.floats(0.001, 0.1),
)
def test_no_limit_is_ever_exceeded(replies: list[int], tokens: int, calls: int, cost: float) -> None:
    """Provided that prompts are no longer than estimated, and replies no longer than requested."""
    limits = settings(max_total_tokens=tokens, max_calls=calls, max_cost=cost, **PRICES)
    made: list[LlmCall] = []
    for reply in replies:
        try:
            check_budget(spent_on(made), limits, ASKED)
        except OverBudget:
            continue
        usage = Usage(prompt_tokens=WORST.prompt_tokens, completion_tokens=min(reply, limits.max_tokens))
        made.append(using(NEW, limits, 1, usage))
    spent = spent_on(made)
    assert spent.total_calls <= calls
    assert spent.total_tokens <= tokens
    assert spent.cost is not None
    assert spent.cost <= cost


def estimated(**changes: Any) -> Estimate:
    numbers = {"initial": 50, "differential": 10, "differential_calls": 5}
    numbers |= {name: changes.pop(name) for name in list(changes) if name in numbers}
    problem = SimpleNamespace(road=RoadLimits(), max_participants=4, system="a car")
    return estimate(settings(**changes), problem, **numbers)


def test_an_estimate_covers_the_first_and_the_later_requests() -> None:
    found = estimated()
    assert (found.expected.total_calls, found.most.total_calls) == (6, 12)
    assert 6 * 500 < found.expected.total_tokens < found.most.total_tokens
    assert found.expected.cost is found.most.cost is None
    assert "cost unknown (at most unknown)" in found.words
    assert estimated(initial=0).expected.total_calls == 5
    assert estimated(differential_calls=0).expected.total_calls == 1
    assert estimated(initial=0, differential_calls=0).expected.total_tokens == 0
    assert estimated(differential_calls=10**9, max_calls=10**6).expected.total_calls == 10**6


def test_an_estimate_respects_max_calls() -> None:
    for limit, expected, most in ((8, 6, 8), (3, 3, 3)):
        found = estimated(max_calls=limit)
        assert (found.expected.total_calls, found.most.total_calls) == (expected, most)
    priced = estimated(max_calls=8, **PRICES)
    assert priced.expected.cost is not None
    assert priced.most.cost is not None
    assert 0 < priced.expected.cost < priced.most.cost


pytestmark = pytest.mark.timeout(30)

GOOD = says(reply_text(items(1)))


def checked(endpoint: Endpoint, **changes: Any) -> EndpointReport:
    settings = llm_settings(endpoint, **changes)
    return asyncio.run(check_endpoint(settings, access=access_to(settings)))


def test_an_endpoint_that_supports_all_forms(endpoint: Endpoint) -> None:
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


def test_an_endpoint_that_supports_only_plain_text(endpoint: Endpoint) -> None:
    endpoint.forms = ("plain",)
    endpoint.then(says(reply_text(items(1)), server=Server.OLLAMA, finish=None))
    report = checked(endpoint)
    assert (report.models, report.model_listed, report.mode) == (None, None, Mode.PLAIN)
    assert [one.accepted for one in report.modes] == [False, False, False, True]
    assert "HTTP 400" in str(report.modes[0].trouble)
    assert not report.modes[-1].usage_stated
    assert report.modes[-1].finish_reason is None
    assert len(endpoint.asked) == len(Mode)


def test_a_model_whose_replies_are_unusable(endpoint: Endpoint) -> None:
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
def test_check_reports_if_model_is_listed(
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
    assert "HTTP 401" in str(report.trouble)
    assert endpoint.asked == []


def test_the_check_reports_an_unreachable_endpoint(endpoint: Endpoint) -> None:
    settings = llm_settings(Endpoint("http://127.0.0.1:1/v1"))
    report = asyncio.run(check_endpoint(settings, access=access_to(settings)))
    assert (report.reachable, report.modes) == (False, ())
    assert "no connection" in str(report.trouble)


def test_the_check_does_not_retry(endpoint: Endpoint) -> None:
    endpoint.then(*[refuses(503, "busy")] * len(Mode))
    report = checked(endpoint, retries=5)
    assert len(endpoint.asked) == len(Mode)
    assert all("busy" in str(one.trouble) for one in report.modes)
