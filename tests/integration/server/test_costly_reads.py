"""Costly reads keep nobody else waiting: threads of their own, one computation for all who ask, and a time limit."""

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import numpy as np
import pytest
from support.api import ball, eventually, expect, finish, listening_coordinator
from support.databases import Databases
from support.problems import small_problems

from brink.search import metric
from brink.search.analysis import boundary, neighbours
from brink.search.analysis.folds import kinds_of_solutions
from brink.search.metric import Metric
from brink.server import app as server_app
from brink.server.api import analysis, outcomes, solutions
from brink.server.campaigns import outcomes as campaign_outcomes
from brink.server.campaigns import plan
from brink.server.findings.boundary import repeats as repeated
from brink.server.findings.boundary import table as boundary_table
from brink.server.findings.pairs import kind, questions

API = "/api/v1/campaigns"
AT_ONCE = 12
"""Costly reads at once: more than the event loop has default threads on a small machine."""
LIMIT_S = 3.0
WORK = (
    (solutions, "solution_views"),
    (boundary_table, "boundary_rows"),
    (boundary_table, "table_bytes"),
    (np, "savez_compressed"),
    (analysis, "_map_view"),
    (analysis, "_dependence"),
    (outcomes, "_view"),
    (questions, "pairs_view"),
    (kind, "pairs_view"),
    (repeated, "repeats_view"),
    (campaign_outcomes, "read_outcomes"),
    (plan, "distinct_boundary"),
)
"""Functions that decode, compute or render for reads, where they are looked up."""
READS = (
    "solutions",
    "solutions?max_fitness=0.9",
    "solutions/3",
    "boundary?d_th=0.19",
    "boundary?format=csv",
    "archive.npz",
    "map",
    "outcomes",
    "pairs",
    "findings",
    "dependence",
    "repeats",
)


@pytest.fixture(scope="module")
def client(module_databases: Databases) -> Iterator[httpx.Client]:
    with module_databases.database() as url, small_problems(), listening_coordinator(url) as opened:
        yield opened


@pytest.fixture(scope="module")
def campaign(client: httpx.Client) -> str:
    params = {"generation_size": 60, "p_th": 0.35, "radius": 1.0}
    made = finish(client, ball(algorithm={"id": "random@1", "params": params}, execution={"keep_traces": 0}))
    expect(client.post(f"{API}/{made}/repeats", json={"repeats": 2, "numbers": [1, 2]}), 201)
    return made


def test_no_read_computes_on_the_event_loop_or_on_the_threads_of_short_queries(
    client: httpx.Client, campaign: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    worked: dict[str, set[str]] = {}

    def noted(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def noting(*args: Any, **kwargs: Any) -> Any:
            worked.setdefault(name, set()).add(threading.current_thread().name)
            return function(*args, **kwargs)

        return noting

    for module, name in WORK:
        monkeypatch.setattr(module, name, noted(name, getattr(module, name)))
    for path in READS:
        assert client.get(f"{API}/{campaign}/{path}").status_code == httpx.codes.OK, path
    assert set(worked) == {name for _, name in WORK}, "each of them was called"
    pools = ("brink-pages", "brink-analyses", "brink-draw", "brink-figures")
    elsewhere = {
        name: threads for name, threads in worked.items() if not all(t.startswith(pools) for t in threads)
    }
    assert not elsewhere


class Held:
    """A function that waits until it is let go, and counts its calls."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function, self.calls, self.go_on = function, 0, threading.Event()

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        self.calls += 1
        assert self.go_on.wait(60.0)
        return self.function(*args, **kwargs)


@pytest.fixture
def held(monkeypatch: pytest.MonkeyPatch) -> Iterator[Held]:
    """Hold every computation of a boundary."""
    held = Held(boundary.distinct_boundary)
    monkeypatch.setattr(plan, "distinct_boundary", held)
    yield held
    held.go_on.set()


def test_costly_reads_keep_no_other_reads_waiting(client: httpx.Client, campaign: str, held: Held) -> None:
    with ThreadPoolExecutor(AT_ONCE) as people:
        costly = [
            people.submit(client.get, f"{API}/{campaign}/boundary?t_b=0.9&d_th=0.{30 + n}")
            for n in range(AT_ONCE)
        ]
        eventually(lambda: held.calls > 0, "a boundary is being computed")
        try:
            for path in ("", "/progress", "/solutions", "/outcomes"):
                answer = client.get(
                    f"{API}/{campaign}{path}", timeout=20.0
                )  # all of them would wait for ever
                assert answer.status_code == httpx.codes.OK
            assert not any(one.done() for one in costly)
        finally:
            held.go_on.set()
        assert {one.result().status_code for one in costly} == {200}


def test_the_same_boundary_is_computed_once_for_all_who_ask(
    client: httpx.Client, campaign: str, held: Held
) -> None:
    with ThreadPoolExecutor(AT_ONCE) as people:
        asked = [
            people.submit(client.get, f"{API}/{campaign}/boundary?t_b=0.8&d_th=0.25") for _ in range(AT_ONCE)
        ]
        eventually(lambda: held.calls > 0, "it is being computed")
        held.go_on.set()
        assert len({one.result().text for one in asked}) == 1
    assert held.calls == 1


@pytest.mark.long("waits for time limits")
def test_a_read_that_takes_too_long_is_ended_and_says_what_to_ask_instead(
    module_databases: Databases, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocks = 0
    whole = Metric._block

    def slow(*args: Any) -> Any:
        nonlocal blocks
        blocks += 1
        threading.Event().wait(LIMIT_S)
        return whole(*args)

    with (
        module_databases.database("limited") as url,
        small_problems(),
        listening_coordinator(url, read_limit_s=LIMIT_S) as client,
    ):
        with listening_coordinator(url) as patient:
            campaign = finish(patient, ball())
        read = f"{API}/{campaign}/solutions"
        eventually(lambda: client.get(read).status_code == httpx.codes.OK, "the archive has been read")
        monkeypatch.setattr(metric, "BLOCK_ROWS", 2)
        monkeypatch.setattr(Metric, "_block", slow)
        answer = client.get(f"{API}/{campaign}/boundary?t_b=1&d_th=0.05")
        monkeypatch.undo()
        assert blocks == 1, "it was ended, not only abandoned"
        error = expect(answer, 503)
        assert answer.headers["content-type"] == "application/problem+json"
        assert int(answer.headers["retry-after"]) > 0
        assert error["title"] == "Too costly"
        assert f"after {LIMIT_S:g} s" in error["detail"]
        assert "a larger d_th, a smaller t_b" in error["detail"]
        read = f"{API}/{campaign}/boundary?t_b=1&d_th=0.05"
        eventually(lambda: client.get(read).status_code == httpx.codes.OK, "the failure is not kept")


def scored(client: httpx.Client, campaign: str) -> httpx.Response:
    asked = {"solutions": [{"where": {"x": 0}, "what": {"y": 0}}], "model": "neighbours"}
    return client.post(f"{API}/{campaign}/monitor/score", json=asked)


@pytest.fixture
def endless_fit(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Let monitors be fitted for hours; the event tells that one is being fitted."""
    began = threading.Event()

    def begun(*args: Any) -> Any:
        began.set()
        return kinds_of_solutions(*args)

    monkeypatch.setattr(neighbours, "kinds_of_solutions", begun)
    monkeypatch.setattr(neighbours, "LEVELS", neighbours.LEVELS * 10**6)
    return began


@pytest.mark.long("waits for time limits")
def test_a_fit_that_takes_too_long_is_ended_and_says_what_to_do_instead(
    module_databases: Databases, monkeypatch: pytest.MonkeyPatch, endless_fit: threading.Event
) -> None:
    monkeypatch.setattr(server_app, "FIT_LIMIT_S", LIMIT_S)
    with module_databases.database("fitting") as url, small_problems(), listening_coordinator(url) as client:
        answer = scored(client, finish(client, ball()))
        error = expect(answer, 503)
        assert endless_fit.is_set()
        assert error["title"] == "Too costly"
        assert f"after {LIMIT_S:g} s" in error["detail"]
        assert "brink monitor fit" in error["detail"]


@pytest.mark.long("waits for time limits")
def test_stopping_ends_a_fit(module_databases: Databases, endless_fit: threading.Event) -> None:
    with (
        ThreadPoolExecutor(1) as people,
        module_databases.database("stopping") as url,
        small_problems(),
        listening_coordinator(url) as client,
    ):
        asked = people.submit(scored, client, finish(client, ball()))
        assert endless_fit.wait(60.0)
        assert not asked.done()
    # otherwise, the coordinator would go on for hours
    assert asked.exception() is not None or asked.result().status_code == 503
