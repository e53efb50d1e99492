"""Follow-ups of thresholds: do both ends hold, and is the component to blame?"""

from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from support.api import FakeWorker, expect, listening_coordinator
from support.databases import Databases
from support.missed import PROBLEM, SECONDS, SIMULATOR, judge, missing
from support.sweep import Sweep
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.server.problems.catalogue import ALGORITHMS
from brink.sim import catalogue

API = "/api/v1/campaigns"


@pytest.fixture(scope="module")
def client(module_databases: Databases) -> Iterator[httpx.Client]:
    with module_databases.database() as url, pytest.MonkeyPatch.context() as patch:
        patch.setitem(catalogue._registered, ALGORITHMS, {Sweep.id: Sweep})
        with listening_coordinator(url) as opened:
            yield opened


def work(client: httpx.Client, campaign: str) -> None:
    assert FakeWorker(client, capabilities=(SIMULATOR,), judge=judge).work(campaign)["status"] == "finished"


@pytest.fixture
def campaign(client: httpx.Client) -> str:
    rows = [*missing("clear", SECONDS), *missing("hard_rain", SECONDS)]
    algorithm = {"id": Sweep.id, "params": {"rows": rows}}
    body = {
        "name": "missing",
        "problem": PROBLEM,
        "algorithm": algorithm,
        "budget": {"simulations": len(rows)},
    }
    found: str = expect(client.post(API, json=body), 201)["id"]
    work(client, found)
    return found


def finding_of(client: httpx.Client, campaign: str) -> dict[str, Any]:
    found: dict[str, Any] = expect(client.get(f"{API}/{campaign}/findings/thresholds"))
    return found


def blamed(finding: dict[str, Any]) -> list[str]:
    column = [one["name"] for one in finding["tables"][0]["columns"]].index("blame")
    return sorted(row[column] for row in finding["tables"][0]["rows"])


def test_ground_truth_tells_whether_the_component_is_to_blame_for_a_threshold(
    client: httpx.Client, campaign: str
) -> None:
    before = finding_of(client, campaign)
    assert len(before["view"]["thresholds"]) == 2
    assert blamed(before) == ["ground truth not tried"] * 2
    assert "Whether the component or the scenario is to blame was not tried" in before["more"]
    (step,) = [one for one in before["steps"] if one["kind"] == "component"]
    assert step["by_default"]
    assert step["words"].endswith("It takes at most 2 simulations.")
    asked = expect(client.post(f"/api/v1/{step['request']['path']}", json=step["request"]["body"]), 201)
    assert blamed(finding_of(client, campaign)) == ["ground truth pending"] * 2
    few = expect(client.get(f"{API}/{campaign}/findings", params={"rows": 1}))
    assert len(few["findings"][0]["view"]["thresholds"]) == 1
    assert [one["words"] for one in few["steps"]][1:2] == [one["words"] for one in before["steps"]][1:2], (
        "a step is about all thresholds, however many rows are listed"
    )
    (running,) = [one for one in finding_of(client, campaign)["steps"] if one["kind"] == "component"]
    assert running["follow_up"]["campaign"] == asked["campaign"]
    work(client, asked["campaign"])
    after = finding_of(client, campaign)
    assert blamed(after) == ["component's hazard (one seed)", "scenario's hazard (one seed)"]
    told = (
        "With ground truth in place of the component, in one drive each, the unsafe end of 1 of 2 thresholds is "
        "safe: there, the component is to blame"
    )
    assert told in after["more"]
    by_weather = {"hard rain" in one["held"]: one for one in after["view"]["thresholds"]}
    assert (by_weather[False]["blame"], by_weather[True]["blame"]) == ("component", "scenario")
    assert "front gap held" in by_weather[False]["truth"]
    assert not [one for one in after["steps"] if one["kind"] == "component"]


def test_the_command_confirms_both_ends_and_draws_as_many_as_are_asked_for(
    client: httpx.Client, campaign: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def shown(*options: str) -> str:
        said = CliRunner().invoke(app, ["thresholds", campaign, *options, "--server", str(client.base_url)])
        assert said.exit_code == 0, said.output
        return " ".join(said.output.split())

    assert "simulates them (both ends of each threshold with other seeds)" in shown("--confirm", "30")
    (step,) = [one for one in finding_of(client, campaign)["steps"] if one["kind"] == "confirm"]
    work(client, step["follow_up"]["campaign"])
    states = {one["pair"]["confirmation"] for one in finding_of(client, campaign)["view"]["thresholds"]}
    assert states == {"confirmed"}
    told = (
        "Both ends of 2 thresholds were simulated again with other seeds: 2 confirmed, 0 undecided, 0 refuted"
    )
    assert any(words.startswith(told) for words in finding_of(client, campaign)["more"])
    drawn: list[Any] = []
    monkeypatch.setattr("brink.cli.thresholds.draw_thresholds", lambda finding, path: drawn.append(finding))
    for options in ((), ("--limit", "1")):
        shown("--picture", "curves.png", *options)
    assert [len(finding.view["thresholds"]) for finding in drawn] == [2, 1]


def test_a_campaign_without_thresholds_cannot_be_asked_about_them(client: httpx.Client) -> None:
    rows = missing("clear", [0.1, 0.2, 0.3])
    algorithm = {"id": Sweep.id, "params": {"rows": rows}}
    body = {"name": "safe", "problem": PROBLEM, "algorithm": algorithm, "budget": {"simulations": 3}}
    campaign = expect(client.post(API, json=body), 201)["id"]
    work(client, campaign)
    answer = expect(client.post(f"{API}/{campaign}/thresholds/follow-ups", json={"kind": "component"}), 409)
    assert answer["detail"] == f"campaign {campaign} has no threshold"
