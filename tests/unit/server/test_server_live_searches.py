"""The searches in memory: the latest ones, as far as memory allows."""

from dataclasses import replace

import numpy as np
import pytest

from brink.search.algorithm import Scored
from brink.server.campaigns.body import parse_body
from brink.server.campaigns.live_searches import LiveSearches
from brink.server.campaigns.memory import memory_of
from brink.server.campaigns.plan import LiveSearch, first_generations


@pytest.fixture(scope="module")
def live() -> LiveSearch:
    body = parse_body(
        {
            "name": "x",
            "problem": {"id": "mtq@1"},
            "algorithm": {"id": "random@1"},
            "budget": {"simulations": 5000},
        }
    )
    return first_generations(body)[0]


def told(live: LiveSearch, count: int) -> LiveSearch:
    """Return a search some generations later."""
    state, algorithm = live.state, live.plan.algorithm
    for _ in range(count):
        state = algorithm.tell(state, {c.number: Scored(unsafe=False, robustness=1.0) for c in state.pending})
        state, _ = algorithm.ask(state)
    return replace(live, generation=live.generation + count, state=state).measured()


def test_least_recently_stepped_searches_are_dropped_beyond_the_limit(live: LiveSearch) -> None:
    dropped: list[str] = []
    kept = LiveSearches(most_bytes=int(2.5 * live.size), on_drop=dropped.append)
    for name in ("a", "b", "a", "c"):
        kept.keep(name, live)
    assert (kept.campaigns, dropped) == (("a", "c"), ["b"])
    assert kept.get("a") is live
    assert kept.get("b") is None


def test_the_latest_search_is_kept_however_large(live: LiveSearch) -> None:
    kept = LiveSearches(most_bytes=0, on_drop=lambda _: None)
    for name in ("a", "b"):
        kept.keep(name, live)
    assert kept.campaigns == ("b",)


def test_dropped_memory_counts_no_more(live: LiveSearch) -> None:
    kept = LiveSearches(most_bytes=2**40, on_drop=lambda _: None)
    for name in ("a", "b", "a"):
        kept.keep(name, live)
    assert kept.size == 2 * live.size > 0
    for name in ("a", "b", "b"):
        kept.drop(name)
    assert (kept.size, kept.campaigns) == (0, ())


def test_memory_grows_with_the_archive_and_is_measured_again(live: LiveSearch) -> None:
    later = told(live, 8)
    assert later.size > live.size + later.state.archive.vectors.nbytes
    kept = LiveSearches(most_bytes=2**40, on_drop=lambda _: None)
    kept.keep("a", live)
    kept.keep("a", later)
    assert kept.size == later.size


def test_measuring_runs_no_code_of_a_state() -> None:
    class State:
        def __init__(self) -> None:
            self.array = np.zeros(1000)

        def __sizeof__(self) -> int:
            raise AssertionError

        def __getattribute__(self, name: str) -> object:
            raise AssertionError

    assert 8000 < memory_of(State()) < 9000
