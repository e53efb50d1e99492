"""Thresholds over the API and on the command line: where along one number drives turn from safe to unsafe."""

import csv
import io
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from support.api import FakeWorker, ball, expect, finish, listening_coordinator
from support.databases import Databases
from support.problems import Line, small_problems
from support.sweep import Sweep, along_x, by_seed
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.search.algorithm import Evaluation, Scored
from brink.search.space import Categorical, Component, SearchSpace
from brink.server.problems.base import InProcessProblem, NoParams, Vectors
from brink.server.problems.catalogue import ALGORITHMS, PROBLEMS
from brink.sim import catalogue

API = "/api/v1/campaigns"
SHARED = along_x(0.0, [0.0, 2.0, 1.5, 0.5, 1.2])
FRESH = along_x(0.0, [0.85, 0.9, 0.95, 1.0, 1.0, 1.05, 1.1, 1.15, 0.92, 0.97, 1.03, 1.08] * 3)
"""Places along a radius of the ball, which is unsafe within about 1 m."""


class Choices(InProcessProblem):
    """Unsafe by night in rain or fog: a space without numbers."""

    id = "choices@1"
    summary = "Choices."
    params_type = NoParams

    def __init__(self, params: NoParams) -> None:
        choices = Categorical("light", ("day", "night")), Categorical("weather", ("clear", "rain", "fog"))
        self.space = SearchSpace((Component("where", choices),))

    def evaluate(self, vectors: Vectors) -> Evaluation:
        """Return the verdict of two choices."""
        values = self.space.decode(tuple(vectors))["where"]
        unsafe = values["light"] == "night" and values["weather"] != "clear"
        return Scored(unsafe=unsafe, robustness=-1.0 if unsafe else 1.0)


def sweep(rows: list[list[float]], shared: int = 0, **changes: Any) -> dict[str, Any]:
    algorithm = {"id": Sweep.id, "params": {"rows": rows, "shared": shared}}
    return ball(simulations=len(rows), algorithm=algorithm, **changes)


@pytest.fixture(scope="module")
def client(module_databases: Databases) -> Iterator[httpx.Client]:
    with module_databases.database() as url, small_problems(), pytest.MonkeyPatch.context() as patch:
        patch.setitem(catalogue._registered, ALGORITHMS, {Sweep.id: Sweep})
        patch.setitem(catalogue._registered[PROBLEMS], Choices.id, Choices)
        with listening_coordinator(url) as opened:
            yield opened


def run(client: httpx.Client, body: dict[str, Any]) -> str:
    campaign: str = expect(client.post(API, json=body), 201)["id"]
    assert FakeWorker(client, judge=by_seed).work(campaign)["status"] == "finished"
    return campaign


@pytest.fixture(scope="module")
def campaign(client: httpx.Client) -> str:
    return run(client, sweep(SHARED + FRESH, shared=len(SHARED)))


@pytest.fixture(scope="module")
def finding(client: httpx.Client, campaign: str) -> dict[str, Any]:
    found: dict[str, Any] = expect(client.get(f"{API}/{campaign}/findings/thresholds"))
    return found


@pytest.fixture(scope="module")
def threshold(finding: dict[str, Any]) -> dict[str, Any]:
    (one,) = finding["view"]["thresholds"]
    return dict(one)


def test_the_radius_of_the_ball_is_found_with_an_interval_in_metres(threshold: dict[str, Any]) -> None:
    assert threshold["outcome"] == "threshold"
    assert threshold["low"] < 1.0 < threshold["high"]
    assert threshold["high"] - threshold["low"] < 0.2
    assert threshold["at_80"] < threshold["middle"] < threshold["at_20"]
    assert 0.02 < threshold["stretch"] < 0.3
    assert (threshold["unit"], threshold["decimals"], threshold["resolution"]) == ("m", 2, 0.04)
    assert not threshold["rises"]
    assert not threshold["states_resolution"]
    assert threshold["turns"].startswith(f"{threshold['middle']:.2f} m [{threshold['low']:.2f}, ")
    assert threshold["rule"] == f"unsafe with a probability of at least 80% at {threshold['at_80']:.2f} m", (
        "nothing was simulated beyond the interval of the 80% point"
    )
    assert threshold["held"] == "y 0 m"
    assert threshold["kind"] == ["where.x", "violated distance"]
    assert threshold["change"] == f"X {threshold['at_80']:.2f} m instead of {threshold['at_20']:.2f} m"
    assert threshold["words"] == f"{threshold['change']}: {threshold['fails']}"


def test_it_rests_on_the_drives_with_a_seed_of_their_own(threshold: dict[str, Any]) -> None:
    assert threshold["drives"] == len(FRESH)
    assert sum(dot["drives"] for dot in threshold["dots"]) == len(FRESH)
    assert {dot["value"] for dot in threshold["dots"]} == {row[0] for row in FRESH}
    curve = threshold["curve"]
    assert curve["value"] == sorted(curve["value"])
    assert curve["share"] == sorted(curve["share"], reverse=True)
    assert all(
        low <= at <= high for low, at, high in zip(curve["low"], curve["share"], curve["high"], strict=True)
    )


def test_both_ends_are_simulated_drives_beyond_20_and_80_percent(
    client: httpx.Client, campaign: str, threshold: dict[str, Any]
) -> None:
    pair = threshold["pair"]
    assert pair["unsafe"]["value"] <= threshold["at_80"] < threshold["at_20"] <= pair["safe"]["value"]
    assert pair["tight"] == (pair["width"] <= threshold["stretch"] + 2 * threshold["resolution"])
    for side in ("safe", "unsafe"):
        solution = expect(client.get(f"{API}/{campaign}/solutions/{pair[side]['number']}"))
        assert (solution["verdict"], solution["parameters"]["where"]["x"]) == (side, pair[side]["value"])


def test_the_finding_is_a_sentence_a_table_and_files(
    client: httpx.Client, campaign: str, finding: dict[str, Any], threshold: dict[str, Any]
) -> None:
    assert finding["role"] == "sought"
    assert finding["sentence"].startswith("1 threshold of 1 kind; from 20 to 80% unsafe within ")
    assert len(finding["sentence"].split()) <= 25
    everything = expect(client.get(f"{API}/{campaign}/findings"))
    assert everything["words"].startswith("1 threshold of 1 kind")
    answer = client.get(f"{API}/{campaign}/findings/thresholds", params={"format": "csv"})
    (row,) = csv.DictReader(io.StringIO(answer.text))
    assert (row["unit"], row["state"] if "state" in row else row["outcome"]) == ("m", "threshold")
    assert float(row["middle"]) == pytest.approx(threshold["middle"])
    assert int(row["safe"]) == threshold["pair"]["safe"]["number"]


def test_the_command_prints_and_draws_it(
    client: httpx.Client, campaign: str, threshold: dict[str, Any], tmp_path: Path
) -> None:
    def invoke(*words: str) -> Any:
        return CliRunner().invoke(app, ["findings", campaign, *words, "--server", str(client.base_url)])

    shown = invoke("thresholds")
    assert shown.exit_code == 0, shown.output
    assert threshold["turns"] in " ".join(shown.output.split())
    for name in ("curves.png", "curves.svg"):
        drawn = invoke("thresholds", "--picture", str(tmp_path / name))
        assert drawn.exit_code == 0, drawn.output
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")
    assert "50% point" in (tmp_path / "curves.svg").read_text()
    refused = invoke("verdicts", "--picture", str(tmp_path / "no.png"))
    assert "expected a kind that has a picture (rate, thresholds), got verdicts" in str(refused.exception)


def test_a_comparison_counts_what_searches_are_for(client: httpx.Client, campaign: str) -> None:
    drawn = run(client, ball(name="drawn", simulations=20, algorithm={"id": "random@1"}))

    def compared(*words: str) -> str:
        place = ("--no-control", "--server", str(client.base_url))
        return CliRunner().invoke(app, ["compare", *words, *place]).output

    assert "Thresholds" not in compared(drawn)
    assert "Pairs across" not in compared(campaign)
    both = compared(campaign, drawn)
    assert "only a search for thresholds makes on purpose" in " ".join(both.split())
    rows = [line.split()[1:] for line in both.splitlines() if " 41 " in line or "drawn" in line]
    assert rows[:2] == [["41", "0", "1", "1", "0", "–"], ["20", "0", "0", "0", "0", "–"]]
    told = json.loads(compared(campaign, drawn, "--json"))
    assert [one["thresholds"]["kinds"] for one in told] == [1, 0]


@pytest.mark.long("writes a whole report")
def test_a_report_has_the_curves(client: httpx.Client, campaign: str, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    written = CliRunner().invoke(
        app, ["report", campaign, "--out", str(page), "--server", str(client.base_url)]
    )
    assert written.exit_code == 0, written.output
    text = page.read_text(encoding="utf-8")
    assert "1 threshold of 1 kind" in text
    assert "Probability of a violation along one number, with every drive that says so" in text


def test_ends_that_are_simulated_again_are_confirmed(client: httpx.Client) -> None:
    wide = along_x(0.0, [0.5, 1.5, 0.8, 1.2, 0.96, 1.04, 0.7, 1.3] * 3)
    campaign = run(client, sweep(wide))
    found = expect(client.get(f"{API}/{campaign}/findings/thresholds"))
    (step,) = [one for one in found["steps"] if one["kind"] == "confirm"]
    asked = expect(client.post(f"/api/v1/{step['request']['path']}", json=step["request"]["body"]), 201)
    FakeWorker(client, judge=by_seed).work(asked["campaign"])
    (one,) = expect(client.get(f"{API}/{campaign}/findings/thresholds"))["view"]["thresholds"]
    assert one["pair"]["confirmation"] in ("confirmed", "undecided")
    assert 15 <= one["pair"]["safe"]["again"]["evaluated"] <= 30, "until it is confirmed"


def test_a_window_and_a_chancy_line_are_said(client: httpx.Client) -> None:
    beyond = [-1.1, -1.2, -1.3, -1.5, -1.7]
    window = along_x(
        0.2, [2.0, 1.9, 1.8, 1.7, 1.6, 1.4, 1.2, 1.1, 0.8, 0.6, 0.4, 0.2, 0.0, -0.4, -0.7, *beyond]
    )
    chancy = [[0.98, -0.3 + 0.03 * place] for place in range(20)]
    campaign = run(client, sweep(window + chancy))
    found = expect(client.get(f"{API}/{campaign}/findings/thresholds"))
    first, second = found["view"]["thresholds"]
    assert (first["outcome"], second["outcome"]) == ("threshold", "chancy")
    assert first["window"].startswith("further on, from -1.")
    assert " down to -0." in first["rule"], "and not to where it is safe again"
    assert (second["rule"], second["pair"], second["turns"]) == ("", None, "nowhere")
    assert second["words"] == "Y, varied from -0.30 m to 0.27 m: chance decides, no value does"
    assert found["sentence"].endswith("; 1 chancy line")


def test_a_campaign_without_lines_says_nothing_of_them_unless_asked(client: httpx.Client) -> None:
    campaign = finish(client, ball(simulations=40))
    kinds = [one["kind"] for one in expect(client.get(f"{API}/{campaign}/findings"))["findings"]]
    assert "thresholds" not in kinds
    asked = expect(client.get(f"{API}/{campaign}/findings/thresholds"))
    assert asked["sentence"] == "no threshold: no number was varied alone with enough episode seeds"
    assert (asked["is_empty"], asked["tables"]) == (True, [])


def test_without_chance_a_threshold_is_a_bracket_as_wide_as_the_resolution(client: httpx.Client) -> None:
    bisected = [[0.0], [1.0], [0.25], [0.45], [0.495], [0.51], [0.75]]
    campaign = run(client, sweep(bisected, problem={"id": Line.id}))
    found = expect(client.get(f"{API}/{campaign}/findings/thresholds"))
    (one,) = found["view"]["thresholds"]
    assert (one["at_80"], one["at_20"], one["rises"]) == (0.495, 0.51, False)
    assert one["turns"] == "between 0.495 and 0.51"
    assert one["rule"] == "unsafe from 0.49 down to 0.00"
    assert found["sentence"] == "1 threshold of 1 kind; safe and unsafe values 2% of the range apart"
    told = str([found["tables"][0]["columns"], found["legend"], found["trust"], found["caveats"]])
    assert "90%" not in told
    assert "with a probability of" not in told
    assert [step["kind"] for step in found["steps"]] == ["look", "suite"]
    coarse = run(client, sweep(bisected[:3], problem={"id": Line.id}))
    assert expect(client.get(f"{API}/{coarse}/findings/thresholds"))["is_empty"]


def asked(client: httpx.Client, campaign: str) -> dict[str, Any]:
    found: dict[str, Any] = expect(client.get(f"{API}/{campaign}/findings/thresholds"))
    assert len(found["sentence"].split()) <= 25
    return found


def test_where_nothing_is_unsafe_the_finding_says_what_was_tried(client: httpx.Client) -> None:
    campaign = run(client, sweep(along_x(0.0, [1.5, 1.6, 1.9, 1.4, 1.7])))
    found = asked(client, campaign)
    assert found["sentence"] == "no threshold: none of 5 drives was unsafe"
    [told] = found["more"]
    assert "whole budget was spent on looking for an unsafe drive. Solution 3 came closest" in told
    assert "may be unsafe" in told
    [step] = found["steps"]
    assert step["kind"] == "longer"


def test_where_everything_is_unsafe_the_finding_says_so(client: httpx.Client) -> None:
    found = asked(client, run(client, sweep(along_x(0.0, [0.1, 0.2, 0.3]))))
    assert found["sentence"] == "no threshold: all 3 drives were unsafe"
    assert "search a wider space" in found["more"][0]


def test_where_chance_decides_everywhere_the_finding_says_on_how_many_lines(client: httpx.Client) -> None:
    found = asked(client, run(client, sweep([[0.98, -0.3 + 0.03 * place] for place in range(20)])))
    assert found["sentence"] == "no threshold: chance decides on 1 line (20 drives)"
    assert "another number, or several together, may decide" in found["more"][0]


def test_a_space_without_numbers_has_categorical_pairs_and_no_thresholds(client: httpx.Client) -> None:
    body = ball(simulations=30, problem={"id": Choices.id}, algorithm={"id": "edge@2"})
    campaign = run(client, body)
    found = asked(client, campaign)
    assert found["sentence"] == "no threshold: the search space has no numbers, only categories"
    assert found["more"] == [
        "A category has no values in between. What changing one does is shown by the categorical pairs"
    ]
    pairs = expect(client.get(f"{API}/{campaign}/pairs"))
    assert pairs["categorical"] == pairs["distinct"] > 0


def test_a_resolution_that_the_problem_does_not_state_is_said_to_be_1_percent(
    finding: dict[str, Any],
) -> None:
    [told] = [words for words in finding["caveats"] if "resolution" in words]
    assert told == "The problem states no resolution of x: 1% of the range counts as the same there"


def test_where_chance_decides_the_finding_says_how_many_verdicts_changed(client: httpx.Client) -> None:
    angles = np.linspace(0.1, 1.4, 8).tolist()
    rows = [[0.97 * math.cos(angle), 0.97 * math.sin(angle)] for angle in angles for _ in range(4)]
    campaign = run(client, sweep(rows))
    solutions = expect(client.get(f"{API}/{campaign}/solutions?limit=100"))["solutions"]
    by_row: dict[float, list[str]] = {}
    for one in sorted(solutions, key=lambda one: one["number"]):
        by_row.setdefault(one["parameters"]["where"]["x"], []).append(one["verdict"])
    changed = sum(sum(one != first for one in others) >= 2 for first, *others in by_row.values())
    assert (len(by_row), changed > 0) == (8, True)
    sentence = expect(client.get(f"{API}/{campaign}/findings/thresholds"))["sentence"]
    assert sentence.startswith("no threshold: of 8 ")
    assert sentence.endswith(f" simulated again with other seeds, {changed} mostly had the other verdict")
