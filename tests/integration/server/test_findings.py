"""A kind of findings in one folder of the tests is seen everywhere; built-in kinds obey the same contract."""

import csv
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from support.api import FakeWorker, ball, expect, finish, listening_coordinator, perturbed, submit
from support.databases import Databases
from support.extremes import ExtremesAlgorithm, ExtremesKind
from support.problems import small_problems
from support.tolerance import body as tolerance
from support.tolerance import judge as judge_errors
from support.traffic import traffic_worker
from typer.testing import CliRunner

import brink
from brink.cli.commands import app
from brink.server import user_code
from brink.server.findings.finding import Finding, Step
from brink.server.findings.kind import FINDINGS, Subject, all_kinds
from brink.server.problems.catalogue import ALGORITHMS, describe_algorithms
from brink.sim import catalogue

pytestmark = pytest.mark.usefixtures("smaller_library")
API = "/api/v1/campaigns"
ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def client(module_databases: Databases) -> Iterator[httpx.Client]:
    with module_databases.database() as url, small_problems(), pytest.MonkeyPatch.context() as patch:
        patch.setitem(catalogue._registered, FINDINGS, {ExtremesKind.id: ExtremesKind})
        patch.setitem(catalogue._registered, ALGORITHMS, {ExtremesAlgorithm.id: ExtremesAlgorithm})
        with listening_coordinator(url) as opened:
            yield opened


@pytest.fixture(scope="module")
def campaign(client: httpx.Client) -> str:
    return finish(client, ball(simulations=40, algorithm={"id": ExtremesAlgorithm.id}))


def test_the_toy_kind_comes_first_in_rest_and_its_table_is_a_file(
    client: httpx.Client, campaign: str
) -> None:
    found = expect(client.get(f"{API}/{campaign}/findings", params={"rows": 3}))
    first = found["findings"][0]
    assert (first["kind"], first["role"]) == ("extremes", "sought")
    worst = first["view"]["worst"]
    assert found["words"] == f"Solution {worst} is the most extreme of 40."
    assert (len(first["tables"][0]["rows"]), first["tables"][0]["left_out"]) == (3, 37)
    assert f"brink replay {campaign} {worst} --out worst.png" in [step["command"] for step in found["steps"]]
    one = expect(client.get(f"{API}/{campaign}/findings/extremes"))
    assert len(one["tables"][0]["rows"]) == 40
    text = client.get(f"{API}/{campaign}/findings/extremes", params={"format": "csv"}).text
    rows = list(csv.DictReader(io.StringIO(text)))
    assert list(rows[0]) == ["number", "robustness", "unsafe"]
    assert (len(rows), rows[0]["number"], rows[0]["unsafe"]) == (40, str(worst), "True")


def test_the_toy_kind_is_asked_with_settings_of_its_own(client: httpx.Client, campaign: str) -> None:
    path = f"{API}/{campaign}/findings/extremes"
    smallest = expect(client.get(path))["tables"][0]["rows"]
    largest = expect(client.get(path, params={"largest": "true", "rows": 3}))["tables"][0]["rows"]
    assert [row[1] for row in largest] == [row[1] for row in smallest[:-4:-1]]
    for params, pointer in (({"large": "true"}, "/query/large"), ({"largest": "3"}, "/query/largest")):
        refused = expect(client.get(path, params=params), 422)
        assert [one["pointer"] for one in refused["errors"]] == [pointer]


def test_the_toy_kind_is_named_in_the_list_of_campaigns(client: httpx.Client, campaign: str) -> None:
    def listed() -> Any:
        read = expect(client.get("/api/v1/overview"))
        return dict(zip(read["id"], read["found"], strict=True))[campaign]

    while (words := listed()) is None:
        pass
    assert words == "extreme of 40"


def test_the_toy_kind_is_shown_in_the_terminal_and_written_as_markdown(
    client: httpx.Client, campaign: str, tmp_path: Path
) -> None:
    server = ["--server", str(client.base_url)]
    shown = CliRunner().invoke(app, ["findings", campaign, *server])
    assert shown.exit_code == 0, shown.output
    assert "most extreme of 40" in shown.stdout
    assert "robustness (m)" in shown.stdout
    assert f"brink findings {campaign} extremes" in shown.stdout
    assert f"  brink replay {campaign}" in shown.stdout
    sentences = [line for line in shown.stdout.splitlines() if line.endswith(".")]
    assert len(sentences) == len(set(sentences)), "no sentence is told twice"
    out = tmp_path / "found.md"
    assert (
        CliRunner().invoke(app, ["findings", campaign, "extremes", "--out", str(out), *server]).exit_code == 0
    )
    assert "| solution | robustness (m) | unsafe |" in out.read_text()
    refused = CliRunner().invoke(app, ["findings", campaign, "--out", str(tmp_path / "x.csv"), *server])
    assert "expected a kind" in str(refused.exception)


def test_the_toy_kind_is_a_data_frame_and_a_section_of_the_report(
    client: httpx.Client, campaign: str, tmp_path: Path
) -> None:
    result = brink.connect(str(client.base_url)).campaign(campaign).result()
    frame = result.findings("extremes")
    assert list(frame.columns) == ["number", "robustness", "unsafe"]
    assert [str(one) for one in frame.dtypes] == ["int64", "float64", "bool"]
    assert result.findings()["kind"].tolist()[:1] == ["extremes"]
    page = result.report(tmp_path / "report.html").read_text()
    assert "<h2>Extremes</h2>" in page
    assert "Solutions by robustness" in page


class _Broken(ExtremesKind):
    id = "broken"
    title = "Broken"

    def analyse(self, subject: Subject) -> Finding:
        raise ZeroDivisionError("a mistake in a plug-in")

    def leads_to(self, subject: Subject) -> list[Step]:
        raise ZeroDivisionError("another one")


class _Hanging(_Broken):
    id = "hanging"

    def analyse(self, subject: Subject) -> Finding:
        while True:
            pass


@pytest.mark.parametrize("kind", [_Broken, _Hanging])
def test_a_kind_of_a_plug_in_that_fails_or_hangs_loses_no_finding_but_its_own(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch, kind: type[ExtremesKind]
) -> None:
    class Algorithm(ExtremesAlgorithm):
        id = f"{kind.id}@1"
        finds = ("extremes", kind.id)

    monkeypatch.setattr(user_code, "VIEW_LIMIT_S", 1.0)
    monkeypatch.setitem(catalogue._registered, FINDINGS, {ExtremesKind.id: ExtremesKind, kind.id: kind})
    monkeypatch.setitem(catalogue._registered[ALGORITHMS], Algorithm.id, Algorithm)
    made = finish(client, ball(simulations=40, algorithm={"id": Algorithm.id}))
    found = {one["kind"]: one for one in expect(client.get(f"{API}/{made}/findings"))["findings"]}
    assert found["extremes"]["tables"][0]["rows"]
    assert "plug-in of this finding failed" in found[kind.id]["sentence"]
    other = finish(client, ball(simulations=40))
    assert expect(client.get(f"{API}/{other}/findings"))["steps"], "its step is left out"


def test_a_kind_that_a_campaign_does_not_have_is_refused(client: httpx.Client, campaign: str) -> None:
    refused = client.get(f"{API}/{campaign}/findings/tolerances")
    assert refused.status_code == 404
    assert "it has extremes" in refused.json()["detail"]


def headlines(client: httpx.Client, campaign: str) -> dict[str, int]:
    """Return the number of words of the sentence of each kind of findings of a campaign."""
    found = expect(client.get(f"{API}/{campaign}/findings"))["findings"]
    return {one["kind"]: len(one["sentence"].split()) for one in found}


SLOTTED = {"id": "slotted@1"}


@pytest.mark.usefixtures("few_trees", "small_pools")
def test_headlines_of_all_algorithms_have_at_most_25_words(client: httpx.Client) -> None:
    own = [
        one
        for one in describe_algorithms()
        if not one["internal"] and catalogue.is_own_plugin(ALGORITHMS, one["id"])
    ]
    seen: dict[str, int] = {}
    ran = []
    for algorithm in own:
        params = {"eps": 0.3, "d_th": 0.1} if algorithm["id"] == "edge@1" else {}
        asked = {"id": algorithm["id"], "params": params}
        for problem in ({"id": "ball@1"}, SLOTTED):
            answer = client.post(API, json=ball(simulations=120, problem=problem, algorithm=asked))
            if answer.status_code == 422:  # it cannot search this space
                continue
            campaign = expect(answer, 201)["id"]
            if FakeWorker(client, judge=perturbed).work(campaign)["status"] == "finished":
                ran.append(algorithm["id"])
                words = headlines(client, campaign)
                assert max(words.values()) <= 25, words
                seen |= words
    assert {"edge@1", "ga@1", "mlcshe@1", "random@1"} <= set(ran)
    assert {"pairs", "boundary", "verdicts", "combinations"} <= seen.keys()


@pytest.mark.long("runs searches for tolerances and violations")
def test_headlines_of_tolerances_and_violations_have_at_most_25_words(client: httpx.Client) -> None:
    tolerances = submit(client, tolerance(simulations=400))
    FakeWorker(client, capabilities=("brink-drive-errors@2",), judge=judge_errors).work(tolerances)
    traffic = {
        "name": "traffic",
        "problem": {"id": "npc-actions@1", "params": {"participants": 3, "duration_s": 12.0}},
        "algorithm": {"id": "mumoea@1", "params": {"population_size": 20}},
        "budget": {"simulations": 40},
    }
    violations = submit(client, traffic)
    traffic_worker(client).work(violations)
    for campaign, kind in ((tolerances, "tolerances"), (violations, "violations")):
        words = headlines(client, campaign)
        assert kind in words
        assert max(words.values()) <= 25, words


def test_kinds_are_found_without_a_list_of_them(client: httpx.Client) -> None:
    folders = {path.parent.name for path in (ROOT / "server" / "findings").glob("*/kind.py")}
    assert {kind.id for kind in all_kinds()} == {*folders, "extremes"}
