"""Monitors over the API and at the command line: fitting, scoring, and evaluation on fresh solutions."""

import json
import re
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from support.api import ball, expect, finish, submit
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.search.analysis.monitor import Monitor
from brink.search.space import Component, Real, SearchSpace
from brink.server.errors import InvalidInput

pytestmark = pytest.mark.usefixtures("short_forests")

RANDOM = {"id": "random@1", "params": {"generation_size": 100, "radius": 0.2}}


def at(x: float, y: float) -> dict[str, dict[str, float]]:
    return {"where": {"x": x}, "what": {"y": y}}


def test_campaign_scores_solutions(client: httpx.Client) -> None:
    campaign = finish(client, ball(simulations=600, algorithm=RANDOM))
    path = f"/api/v1/campaigns/{campaign}/monitor/score"
    scored = expect(client.post(path, json={"solutions": [at(0, 0), at(1.5, -1.5)], "threshold": 0.5}))
    assert (scored["campaign"], scored["learned_from"], scored["threshold"]) == (campaign, 600, 0.5)
    inside, outside = scored["risks"]
    assert inside["probability"] > 0.8 > 0.2 > outside["probability"]
    assert (inside["answer"], outside["answer"]) == ("unsafe", "safe")
    assert (scored["model"], inside["neighbours"], inside["unlike"]) == ("trees", None, "")
    neighbours = expect(
        client.post(path, json={"solutions": [at(0, 0)], "threshold": 0.5, "model": "neighbours"})
    )
    assert neighbours["model"] == "neighbours"
    assert neighbours["risks"][0]["neighbours"] > 10
    assert expect(client.post(path, json={"solutions": [at(0, 0)]}))["threshold"] == 0.1, "p_th"


def test_answer_points_at_the_unscorable_solution(client: httpx.Client) -> None:
    campaign = finish(client, ball(simulations=40))
    bad: tuple[tuple[dict[str, Any], str], ...] = (
        ({"solutions": []}, "/solutions"),
        ({"solutions": [at(0, 0), at(9, 0)]}, "/solutions/1"),
        ({"solutions": [{"where": {"x": 0}}]}, "/solutions/0"),
        ({"solutions": [at(0, 0)], "threshold": 1.0}, "/threshold"),
        ({"solutions": [at(0, 0)], "model": "oracle"}, "/model"),
        ({"solutions": [{"where": {"x": "NaN"}, "what": {"y": 0}}]}, "/solutions/0"),
    )
    for body, pointer in bad:
        document = expect(client.post(f"/api/v1/campaigns/{campaign}/monitor/score", json=body), 422)
        assert [error["pointer"] for error in document["errors"]] == [pointer]


def test_campaign_without_verdicts_cannot_score(client: httpx.Client) -> None:
    campaign = submit(client, ball())
    path = f"/api/v1/campaigns/{campaign}/monitor/score"
    assert "two evaluated" in expect(client.post(path, json={"solutions": [at(0, 0)]}), 409)["detail"]


@pytest.mark.long("runs campaigns; monitors have unit tests")
def test_monitor_file_scores_and_is_evaluated_offline(listening_client: httpx.Client, tmp_path: Path) -> None:
    learned = finish(listening_client, ball(simulations=400, algorithm=RANDOM))
    fresh = finish(listening_client, ball(simulations=400, algorithm=RANDOM, seed=9))
    file, server = tmp_path / "monitor.json", ["--server", str(listening_client.base_url)]
    run = CliRunner().invoke

    made = run(app, ["monitor", "fit", learned, "--out", str(file), "--threshold", "0.5", *server])
    assert made.exit_code == 0, made.output
    assert "trees, fitted to 400 solutions" in made.output
    monitor = Monitor.load(file)
    assert json.loads(file.read_text())["about"]["campaigns"] == [learned]
    assert monitor.ask(at(0, 0)).answer == "unsafe"

    questions = tmp_path / "solutions.json"
    questions.write_text(json.dumps([at(0, 0), {"parameters": at(1.9, 1.9)}]))
    asked = run(app, ["monitor", "score", str(file), str(questions), "--json"])
    assert asked.exit_code == 0, asked.output
    path = f"/api/v1/campaigns/{learned}/monitor/score"
    body = {"solutions": [at(0, 0), at(1.9, 1.9)], "threshold": 0.5}
    from_api = expect(listening_client.post(path, json=body))["risks"]
    for here, there in zip(json.loads(asked.stdout), from_api, strict=True):
        for exact in ("answer", "unlike", "neighbours"):
            assert here.pop(exact) == there.pop(exact)
        assert here == pytest.approx(there)

    picture = tmp_path / "monitor.png"
    judged = run(app, ["monitor", "judge", str(file), fresh, "--picture", str(picture), "--json", *server])
    assert judged.exit_code == 0, judged.output
    trial = json.loads(judged.stdout)
    witnesses = {one["name"]: one["judgement"] for one in trial["witnesses"]}
    assert set(witnesses) == {"monitor", "majority", "neighbours"}
    assert (trial["model"], trial["learned"], trial["fresh"]) == ("trees", 400, 400)
    assert (trial["left_out"], trial["pairs"]) == ({}, None)
    assert witnesses["majority"]["auroc"] == 0.5
    assert witnesses["monitor"]["auroc"] > 0.95
    assert witnesses["monitor"]["brier"] < witnesses["majority"]["brier"] / 2
    assert picture.stat().st_size > 10_000
    pairs = tmp_path / "pairs.jsonl"
    sides = [
        {"safe": {"parameters": at(1.9, 1.9)}, "unsafe": {"parameters": at(0, 0), "number": 7}, "distance": 1}
    ]
    pairs.write_text("".join(json.dumps(pair) + "\n" for pair in sides) + "\n")
    said = run(app, ["monitor", "judge", str(file), fresh, "--pairs", str(pairs), *server])
    assert "evaluated on 400 others" in said.output
    assert "pairs across the boundary: 1; both sides right 1 (100%)" in said.output

    known = run(app, ["monitor", "judge", str(file), learned[:4], *server])
    assert known.exit_code == 1
    assert f"was fitted to campaign {learned}: " in str(known.exception)
    assert "evaluate it on another campaign" in str(known.exception)
    both = run(app, ["monitor", "judge", str(file), learned, fresh, *server])
    assert both.exit_code == 0, both.output
    assert f"was fitted to campaign {learned}: its training data is left out" in both.stderr
    assert "evaluated on 400 others" in both.stdout


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "expected at least one pair, got none"),
        ("[]", r"line 1: expected \{\"safe\""),
        ('{"safe": {"parameters": {}}}', "line 1: where: missing component"),
        ('\n{"safe": 3}', r"line 2: expected \{\"safe\""),
        ('{"safe": {"parameters": {"where": {"x": 9}, "what": {"y": 0}}}}', r"where.x: expected a number in"),
    ],
)
def test_invalid_pairs_are_located(tmp_path: Path, text: str, said: str) -> None:
    space = SearchSpace((Component("where", (Real("x", -2, 2),)), Component("what", (Real("y", -2, 2),))))
    rows = np.zeros((3, 2))
    file, pairs = tmp_path / "monitor.json", tmp_path / "pairs.jsonl"
    file.write_text(Monitor.of(space, (1, 1), rows, np.arange(3) == 1, threshold=0.1).to_json())
    pairs.write_text(text)
    judged = CliRunner().invoke(app, ["monitor", "judge", str(file), "3f2a", "--pairs", str(pairs)])
    assert judged.exit_code != 0
    assert isinstance(judged.exception, InvalidInput)
    assert re.search(said, str(judged.exception))
