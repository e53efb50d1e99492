"""Outcomes over the API: no drive that violates any requirement is called safe without saying so."""

from collections import Counter
from collections.abc import Iterator
from typing import Any

import httpx
import numpy as np
import pytest
from support.api import FakeWorker, coordinator, expect, solutions, submit
from support.databases import Databases
from support.problems import small_problems

from brink.server.db.engine import Engines
from brink.server.problems.urban_injected import SIMULATOR as DRIVES
from brink.worker.wire import Completed, JobFailed, LeasedJob, WireVerdict

API = "/api/v1/campaigns"
URBAN: dict[str, Any] = {
    "name": "urban",
    "problem": {"id": "urban-injected@1", "params": {"requirement": "front-gap@1"}},
    "algorithm": {"id": "random@1", "params": {"generation_size": 30}},
    "budget": {"simulations": 60},
    "seed": 3,
}
UNITS = {"speed-limit@1": "m/s", "progress@1": "s"}


def drive(job: LeasedJob) -> Completed | JobFailed:
    """Return an outcome by the seed: a third violates the front gap, a third hits a pedestrian, a third is clean."""
    case = job.spec["seed"] % 3
    bad = {0: {"front-gap@1": 4.05}, 1: {"no-collision@1": 12.84}, 2: {}}[case]
    return Completed(
        verdicts={
            name: WireVerdict(
                robustness=-0.5 if name in bad else 2.0,
                unit=UNITS.get(name, "m"),
                violated_at_s=bad.get(name),
            )
            for name in job.spec["requirements"]
        },
        features={"no-collision@1:collision_kind": "pedestrian" if case == 1 else None},
    )


@pytest.fixture(scope="module")
def driven(module_databases: Databases) -> Iterator[tuple[httpx.Client, str]]:
    with small_problems(), module_databases.database() as url, coordinator(url) as client:
        campaign = submit(client, URBAN)
        worker = FakeWorker(client, judge=drive, capabilities=(DRIVES,))
        assert worker.work(campaign)["status"] == "finished"
        yield client, campaign


WORDS = {
    0: ("unsafe", "violated", "violated the front gap at 4.1 s"),
    1: ("safe", "other", "front gap held; hit a pedestrian at 12.8 s"),
    2: ("safe", "held", "front gap held"),
}


def test_every_solution_says_what_its_verdict_is_about(driven: tuple[httpx.Client, str]) -> None:
    found = solutions(*driven)
    assert {one["seed"] % 3 for one in found} == {0, 1, 2}
    for one in found:
        assert (one["verdict"], one["kind"], one["outcome"]) == WORDS[one["seed"] % 3]
        assert one["requirements"] == ["front-gap@1"]
    hit = next(one for one in found if one["kind"] == "other")
    [violated] = hit["violated"]
    assert violated == {
        "requirement": "no-collision@1",
        "time_s": 12.84,
        "words": "hit a pedestrian",
        "decides": False,
        "avoidable": None,
        "avoided_by": None,
        "avoidable_words": "",
    }


def test_outcomes_are_counted(driven: tuple[httpx.Client, str]) -> None:
    client, campaign = driven
    found = Counter(one["kind"] for one in solutions(client, campaign))
    view = expect(client.get(f"{API}/{campaign}/outcomes"))
    assert view["counts"] == found
    assert view["recorded"] == view["evaluated"] == 60
    safe = found["held"] + found["other"]
    assert view["words"] == (
        f"{safe} of 60 drives held the front gap; of these, {found['other']} hit a pedestrian."
    )
    assert view["kinds"]["other"] == "front gap held, another requirement violated"
    assert view["number"] is None
    full = expect(client.get(f"{API}/{campaign}/outcomes", params={"solutions": True}))
    shown = {one["number"]: one for one in solutions(client, campaign)}
    for number, group in zip(full["number"], full["group"], strict=True):
        assert full["groups"][group]["kind"] == shown[number]["kind"]


@pytest.mark.parametrize(
    ("requirement", "unsafe", "held"),
    [
        (["front-gap@1", "no-collision@1"], (0, 1), "front gap held, no collision"),
        ("any", (0, 1), "all 6 requirements held"),
        (["lane-keeping@1"], (), "lane kept"),
    ],
)
def test_a_campaign_may_be_about_several_requirements(
    client: httpx.Client, requirement: str | list[str], unsafe: tuple[int, ...], held: str
) -> None:
    body = {**URBAN, "problem": {"id": "urban-injected@1", "params": {"requirement": requirement}}}
    campaign = submit(client, body)
    worker = FakeWorker(client, judge=drive, capabilities=(DRIVES,))
    assert worker.work(campaign)["status"] == "finished"
    for one in solutions(client, campaign):
        assert (one["verdict"] == "unsafe") == (one["seed"] % 3 in unsafe)
        assert one["robustness"] == (-0.5 if one["verdict"] == "unsafe" else 2.0)
        if one["seed"] % 3 == 2:
            assert one["outcome"] == held
        else:
            assert one["kind"] == ("violated" if one["seed"] % 3 in unsafe else "other")


def test_results_without_requirements_are_not_called_clean(client: httpx.Client, engines: Engines) -> None:
    campaign = submit(client, URBAN)
    FakeWorker(client, judge=drive, capabilities=(DRIVES,)).work(campaign)
    with engines.writer.begin() as connection:
        connection.exec_driver_sql("UPDATE jobs SET result = NULL WHERE number % 2 = 0")
    for one in solutions(client, campaign):
        if one["number"] % 2 == 0:
            words = "front gap held" if one["verdict"] == "safe" else "violated the front gap"
            assert one["outcome"] == f"{words}; other requirements not recorded"
            assert one["requirements"] == []
    view = expect(client.get(f"{API}/{campaign}/outcomes"))
    assert view["recorded"] == 30
    assert "; not recorded for 30" in view["words"]
    assert np.sum(list(view["counts"].values())) == 60
