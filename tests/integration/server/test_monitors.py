"""Monitors over the API and at the command line: fitting, scoring, and evaluation on fresh solutions."""

import json
from pathlib import Path
from typing import Any

import httpx
import pytest
from support.api import ball, expect, finish, submit
from support.databases import on_sqlite
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.search.analysis.monitor import Monitor

RANDOM = {"id": "random@1", "params": {"generation_size": 100, "radius": 0.2}}


def at(x: float, y: float) -> dict[str, dict[str, float]]:
    return {"where": {"x": x}, "what": {"y": y}}


def test_campaign_scores_solutions(client: httpx.Client) -> None:
    campaign = finish(client, ball(simulations=900, algorithm=RANDOM))
    path = f"/api/v1/campaigns/{campaign}/monitor/score"
    scored = expect(client.post(path, json={"solutions": [at(0, 0), at(1.5, -1.5)], "threshold": 0.5}))
    assert (scored["campaign"], scored["learned_from"], scored["threshold"]) == (campaign, 900, 0.5)
    inside, outside = scored["risks"]
    assert inside["probability"] > 0.8 > 0.2 > outside["probability"]
    assert (inside["answer"], outside["answer"]) == ("unsafe", "safe")
    assert expect(client.post(path, json={"solutions": [at(0, 0)]}))["threshold"] == 0.1, "p_th"


@on_sqlite
@pytest.mark.parametrize(
    ("body", "pointer"),
    [
        ({"solutions": []}, "/solutions"),
        ({"solutions": [at(0, 0), at(9, 0)]}, "/solutions/1"),
        ({"solutions": [{"where": {"x": 0}}]}, "/solutions/0"),
        ({"solutions": [at(0, 0)], "threshold": 1.0}, "/threshold"),
        ({"solutions": [{"where": {"x": "NaN"}, "what": {"y": 0}}]}, "/solutions/0"),
    ],
)
def test_answer_points_at_the_unscorable_solution(client: httpx.Client, body: Any, pointer: str) -> None:
    campaign = finish(client, ball(simulations=40))
    document = expect(client.post(f"/api/v1/campaigns/{campaign}/monitor/score", json=body), 422)
    assert [error["pointer"] for error in document["errors"]] == [pointer]


@on_sqlite
def test_campaign_without_verdicts_cannot_score(client: httpx.Client) -> None:
    campaign = submit(client, ball())
    path = f"/api/v1/campaigns/{campaign}/monitor/score"
    assert "two evaluated" in expect(client.post(path, json={"solutions": [at(0, 0)]}), 409)["detail"]


@on_sqlite
def test_monitor_file_scores_and_is_evaluated_offline(listening_client: httpx.Client, tmp_path: Path) -> None:
    learned = finish(listening_client, ball(simulations=400, algorithm=RANDOM))
    fresh = finish(listening_client, ball(simulations=400, algorithm=RANDOM, seed=9))
    file, server = tmp_path / "monitor.json", ["--server", str(listening_client.base_url)]
    run = CliRunner().invoke

    made = run(app, ["monitor", "fit", learned, "--out", str(file), "--threshold", "0.5", *server])
    assert made.exit_code == 0, made.output
    assert "400 solutions" in made.output
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
        assert here.pop("answer") == there.pop("answer")
        assert here == pytest.approx(there)

    picture = tmp_path / "monitor.png"
    judged = run(app, ["monitor", "judge", str(file), fresh, "--picture", str(picture), "--json", *server])
    assert judged.exit_code == 0, judged.output
    trial = json.loads(judged.stdout)
    witnesses = {one["name"]: one["judgement"] for one in trial["witnesses"]}
    assert set(witnesses) == {"monitor", "majority", "gradient-boosted trees"}
    assert (trial["learned"], trial["fresh"], trial["left_out"]) == (400, 400, {})
    assert witnesses["majority"]["auroc"] == 0.5
    assert witnesses["monitor"]["auroc"] > 0.95
    assert witnesses["monitor"]["brier"] < witnesses["majority"]["brier"] / 2
    assert picture.stat().st_size > 10_000
    said = run(app, ["monitor", "judge", str(file), fresh, *server])
    assert "evaluated on 400 others" in said.output

    known = run(app, ["monitor", "judge", str(file), learned, *server])
    assert known.exit_code == 1
    assert "safe and unsafe" in str(known.exception), "a monitor is not evaluated on its own training data"
