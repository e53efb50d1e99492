"""Chains of techniques over the API: which are hazardous, what is beside a solution."""

import json

import httpx
import pytest
from support.api import FakeWorker, expect, submit
from test_measurements import SIMOOD, judge
from typer.testing import CliRunner

from brink.cli.commands import app


@pytest.fixture
def campaign(client: httpx.Client) -> str:
    campaign = submit(client, SIMOOD)
    FakeWorker(client, judge=judge).work(campaign)
    return campaign


def test_every_simulated_chain_is_told_with_its_parts(client: httpx.Client, campaign: str) -> None:
    found = expect(client.get(f"/api/v1/campaigns/{campaign}/combinations"))
    chains = found["combinations"]
    hazardous = [one for one in chains if one["hazardous"]]
    assert hazardous, "strong techniques that come first are unsafe"
    for one in chains:
        assert 1 <= one["trials"] <= 3
        assert one["words"] == ", then ".join(
            f"{step['technique']} {step['level']}/{step['levels']}" for step in one["chain"]
        )
    explained = [one for one in hazardous if one["parts"]]
    assert all({len(part["chain"]) for part in one["parts"]} == {0, 1} for one in explained)
    alone = {step["words"]: (step["alone_unsafe"], step["alone_trials"]) for step in found["steps"]}
    singles = [part for one in explained for part in one["parts"] if len(part["chain"]) == 1]
    assert all(alone[part["words"]] == (part["unsafe"], part["trials"]) for part in singles)


def test_what_is_beside_a_solution_ends_with_itself(client: httpx.Client, campaign: str) -> None:
    path = f"/api/v1/campaigns/{campaign}"
    found = expect(client.get(f"{path}/combinations"))["combinations"]
    solutions = expect(client.get(f"{path}/solutions", params={"unsafe": True}))["solutions"]
    number = solutions[0]["number"]
    variants = expect(client.get(f"{path}/solutions/{number}/variants"))
    assert variants[-1]["number"] == number
    assert variants[-1]["unsafe"] is True
    assert variants[-1]["words"] in {one["words"] for one in found}
    assert variants[0]["chain"] == [], "nothing at all comes first"
    scenarios = {
        str(expect(client.get(f"{path}/solutions/{one['number']}"))["parameters"]["scenario"])
        for one in variants
    }
    assert len(scenarios) == 1
    measured = expect(client.get(f"{path}/solutions"))["solutions"][0]
    assert measured["verdict"] == "measured"
    expect(client.get(f"{path}/solutions/{measured['number']}/variants"), 404)


def test_a_problem_without_techniques_says_so(client: httpx.Client) -> None:
    body = {
        "name": "m",
        "problem": {"id": "mtq@1"},
        "algorithm": {"id": "random@1"},
        "budget": {"simulations": 60},
    }
    campaign = submit(client, body)
    for path in ("combinations", "solutions/0/variants"):
        detail = expect(client.get(f"/api/v1/campaigns/{campaign}/{path}"), 404)["detail"]
        assert "mtq@1 has no ordered techniques" in detail


def test_the_command_line_says_it_in_tables_and_a_sentence(
    client: httpx.Client, campaign: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    place = ["--server", str(client.base_url)]
    told = CliRunner().invoke(app, ["combinations", campaign, *place])
    assert told.exit_code == 0, told.output
    found = json.loads(CliRunner().invoke(app, ["combinations", campaign, "--json", *place]).stdout)
    assert found == expect(client.get(f"/api/v1/campaigns/{campaign}/combinations"))
    assert found["combinations"][0]["words"] in told.stdout
    assert "chains are hazardous" in told.stdout
    assert "3 of 3" in told.stdout
