"""Budgets count the worst case before anything is sent; what is unknown is not 0."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from brink.search.traffic.participants import RoadLimits
from brink.server.llm.budget import Budget, cost_of, times, together, tokens_of, worst_usage
from brink.server.llm.errors import OverBudget
from brink.server.llm.estimate import Estimate, estimate
from brink.server.llm.settings import LlmSettings
from brink.server.llm.wire import Message, Usage, canonical

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


def test_the_worst_case_is_the_prompt_by_its_characters_and_the_longest_reply() -> None:
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


def test_estimates_stay_marked_when_they_are_added() -> None:
    stated = Usage(prompt_tokens=1, completion_tokens=2)
    assert together(stated, stated) == Usage(prompt_tokens=2, completion_tokens=4)
    assert together(stated, times(WORST, 2)).estimated
    assert times(WORST, 2).total == 2 * WORST.total


def test_a_budget_adds_up_and_knows_what_it_does_not_know() -> None:
    spent = Budget().plus(1, Usage(prompt_tokens=10, completion_tokens=5), 0.5)
    assert spent == Budget(calls=1, tokens=15, priced=0.5)
    assert spent.cost == 0.5
    more = spent.plus(2, WORST, None)
    assert (more.calls, more.tokens, more.estimated_tokens) == (3, 15 + WORST.total, WORST.total)
    assert more.cost is None
    assert spent.plus(0, None, 0.0) == spent


def test_each_budget_allows_up_to_its_end() -> None:
    Budget(calls=1).may_send(settings(max_calls=2), ASKED)
    with pytest.raises(OverBudget, match="all 2 calls of max_calls"):
        Budget(calls=2).may_send(settings(max_calls=2), ASKED)
    limited = settings(max_total_tokens=5000)
    Budget(tokens=5000 - WORST.total).may_send(limited, ASKED)
    with pytest.raises(OverBudget, match=r"max_total_tokens"):
        Budget(tokens=5001 - WORST.total).may_send(limited, ASKED)
    priced = settings(max_cost=1.0, **PRICES)
    worst = cost_of(WORST, priced)
    assert worst is not None
    Budget(priced=0.999 - worst).may_send(priced, ASKED)
    with pytest.raises(OverBudget, match="max_cost"):
        Budget(priced=1.001 - worst).may_send(priced, ASKED)


def test_a_cost_that_is_unknown_so_far_cannot_be_kept() -> None:
    with pytest.raises(OverBudget, match="the cost of 2 calls is unknown"):
        Budget(calls=2, unpriced_calls=2).may_send(settings(max_cost=1.0, **PRICES), ASKED)


@given(
    st.lists(st.integers(1, 2000), max_size=30),
    st.integers(1, 20_000),
    st.integers(1, 10),
    st.floats(0.001, 0.1),
)
def test_no_budget_is_ever_passed(replies: list[int], tokens: int, calls: int, cost: float) -> None:
    """As long as prompts are no longer than estimated, and replies no longer than asked for."""
    limits = settings(max_total_tokens=tokens, max_calls=calls, max_cost=cost, **PRICES)
    spent = Budget()
    for reply in replies:
        try:
            spent.may_send(limits, ASKED)
        except OverBudget:
            continue
        usage = Usage(prompt_tokens=WORST.prompt_tokens, completion_tokens=min(reply, limits.max_tokens))
        spent = spent.plus(1, usage, cost_of(usage, limits))
    assert spent.calls <= calls
    assert spent.tokens <= tokens
    assert spent.cost is not None
    assert spent.cost <= cost


def estimated(**changes: Any) -> Estimate:
    numbers = {"initial": 50, "differential": 10, "differential_calls": 5}
    numbers |= {name: changes.pop(name) for name in list(changes) if name in numbers}
    return estimate(settings(**changes), road=RoadLimits(), most=4, system="a car", **numbers)


def test_an_estimate_counts_the_first_request_and_the_later_ones() -> None:
    found = estimated()
    assert (found.calls, found.most_calls) == (6, 12)
    assert 6 * 500 < found.usage.total < found.most_usage.total
    assert found.usage.completion_tokens <= 6 * 1000
    assert found.usage.estimated
    assert found.cost is found.most_cost is None
    assert "cost unknown (at most unknown)" in found.words
    assert estimated(initial=0).calls == 5
    assert estimated(differential_calls=0).calls == 1
    assert estimated(initial=0, differential_calls=0).usage.total == 0
    assert estimated(differential_calls=10**9, max_calls=10**6).calls == 10**6


def test_an_estimate_costs_what_its_tokens_cost() -> None:
    found = estimated(**PRICES)
    assert found.cost == pytest.approx(cost_of(found.usage, settings(**PRICES)))
    assert found.most_cost is not None
    assert found.cost is not None
    assert 0 < found.cost < found.most_cost


def test_an_estimate_keeps_to_the_budget_of_calls() -> None:
    assert (estimated(max_calls=8).calls, estimated(max_calls=8).most_calls) == (6, 8)
    assert (estimated(max_calls=3).calls, estimated(max_calls=3).most_calls) == (3, 3)


def test_an_estimate_says_how_many_solutions_a_reply_has_room_for() -> None:
    assert estimated().solutions_a_reply < 10
    assert estimated(max_tokens=20_000).solutions_a_reply > 50
    assert "a reply has room for about" in estimated().words
