"""Suites from a campaign to the verdicts: created, run, compared, with the exit codes that a CI needs."""

import json
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import httpx
import pytest
import yaml
from support.api import FakeWorker, Judge, ball, expect, submit
from support.databases import on_sqlite
from support.populated import TRAFFIC
from support.problems import REQUIREMENT
from support.traffic import traffic_worker
from typer.testing import CliRunner, Result

from brink.cli.commands import app
from brink.worker.wire import Completed, JobFailed, LeasedJob, WireVerdict

pytestmark = on_sqlite
API = "/api/v1"
POINTS = {"inside": (0.1, 0.1), "near": (0.7, 0.0), "outside": (1.9, 1.9)}


def outcome(robustness: float) -> Completed:
    return Completed(verdicts={REQUIREMENT: WireVerdict(robustness=robustness, unit="m", violated_at_s=None)})


def certain(job: LeasedJob) -> Completed | JobFailed:
    """Return what the ball shows: it depends on the place alone."""
    x, y, limit = job.spec["scenario"]["x"], job.spec["behaviour"]["y"], job.spec["scenario"]["limit"]
    return outcome((x**2 + y**2) ** 0.5 - limit)


def chancy(job: LeasedJob) -> Completed | JobFailed:
    """Return the same, but near the edge a verdict that depends on the seed."""
    return (
        outcome(-1.0 if job.spec["seed"] % 2 else 1.0) if job.spec["scenario"]["x"] == 0.7 else certain(job)
    )


def failing(job: LeasedJob) -> Completed | JobFailed:
    """Fail near the edge."""
    if job.spec["scenario"]["x"] == 0.7:
        return JobFailed(reason="error", message="broken")
    return certain(job)


@dataclass(slots=True)
class Bench:
    """A coordinator with a worker, and the command."""

    client: httpx.Client
    folder: Path
    judge: Judge = certain
    jobs: int = 0

    def brink(self, *arguments: str, judge: Judge = certain) -> Result:
        """Run a command while a worker simulates."""
        self.judge = judge
        server = (
            []
            if arguments[1] in ("remove", "rename", "show", "matrix")
            else ["--server", str(self.client.base_url)]
        )
        with ThreadPoolExecutor(1) as pool:
            ending = pool.submit(CliRunner().invoke, app, [*arguments, *server])
            worker = FakeWorker(self.client, judge=self._count)
            while not ending.done():
                worker.report_all()
        return ending.result()

    def _count(self, job: LeasedJob) -> Completed | JobFailed:
        self.jobs += 1
        return self.judge(job)


@pytest.fixture
def bench(listening_client: httpx.Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    monkeypatch.chdir(tmp_path)
    return Bench(client=listening_client, folder=tmp_path)


def found(bench: Bench, points: Iterable[tuple[float, float]] = tuple(POINTS.values())) -> str:
    """Simulate points, and return their campaign."""
    solutions = [list(point) for point in points]
    algorithm = {"id": "repeat@1", "params": {"solutions": solutions}}
    campaign = submit(bench.client, ball(simulations=len(solutions), algorithm=algorithm))
    assert FakeWorker(bench.client, judge=certain).work(campaign)["status"] == "finished"
    return campaign


def created(bench: Bench) -> Path:
    campaign = found(bench)
    answer = bench.brink("suite", "create", campaign, "--solutions", "0,1,2", "--out", "hazards.yaml")
    assert answer.exit_code == 0, answer.output
    return bench.folder / "hazards.yaml"


def verdicts(answer: Result) -> dict[str, str]:
    return {case["name"]: case["verdict"] for case in json.loads(answer.stdout)["cases"]}


def test_nothing_changed_is_reproduced_and_costs_nothing_the_second_time(bench: Bench) -> None:
    created(bench)
    bench.jobs = 0
    first = bench.brink("suite", "run", "hazards.yaml", "--json", "--out", "first.json")
    assert first.exit_code == 0, first.output
    assert verdicts(first) == {"unsafe-0": "still unsafe", "unsafe-1": "still unsafe", "safe-2": "still safe"}
    assert bench.jobs == 3 * 5
    again = bench.brink("suite", "run", "hazards.yaml", "--json")
    new = bench.brink("suite", "run", "hazards.yaml", "--json", "--new")
    assert verdicts(again) == verdicts(new) == verdicts(first)
    assert bench.jobs == 15, "the second run is the first one, and a new one has its results from the cache"
    renamed = bench.brink("suite", "rename", "hazards.yaml", "unsafe-0", "late")
    assert renamed.exit_code == 0
    assert "late" in verdicts(bench.brink("suite", "run", "hazards.yaml", "--json"))
    assert bench.jobs == 15, "the seeds of a drive do not depend on its name"


def test_a_change_breaks_and_fixes_drives(bench: Bench) -> None:
    file = created(bench)
    better = bench.brink(
        "suite", "run", "hazards.yaml", "--set", "limit=0.5", "--json", "--out", "better.json"
    )
    assert better.exit_code == 0, better.output
    assert verdicts(better) == {"unsafe-0": "still unsafe", "unsafe-1": "fixed", "safe-2": "still safe"}
    worse = bench.brink(
        "suite", "run", "hazards.yaml", "--set", "limit=3.0", "--against", "better.json", "--json",
        "--junit", "hazards.xml", "--markdown", "comment.md", "--out", "worse.json",
    )  # fmt: skip
    assert worse.exit_code == 1
    assert verdicts(worse) == {"unsafe-0": "still unsafe", "unsafe-1": "broken", "safe-2": "broken"}
    root = ElementTree.parse(bench.folder / "hazards.xml").getroot()
    assert (root.attrib["tests"], root.attrib["failures"], root.attrib["skipped"]) == ("3", "2", "1")
    failures = {case.attrib["name"] for case in root.iter("testcase") if case.find("failure") is not None}
    assert failures == {"unsafe-1", "safe-2"}
    comment = (bench.folder / "comment.md").read_text()
    assert "**2 not as expected**" in comment
    assert "| unsafe-1 | broken | 5 of 5 | unsafe | safe in limit=0.5 |" in comment
    text = file.read_text().replace("expect: unsafe", "expect: safe")
    file.write_text(text)
    kept = bench.brink("suite", "run", "hazards.yaml", "--set", "limit=0.5", "--json")
    assert verdicts(kept) == {"unsafe-0": "broken", "unsafe-1": "still safe", "safe-2": "still safe"}
    assert kept.exit_code == 1
    drawn = bench.brink("suite", "matrix", "better.json", "worse.json", "--out", "matrix.html")
    assert drawn.exit_code == 0, drawn.output
    assert "3 drives in 2 versions: 2 turned unsafe" in drawn.output


def test_what_is_unclear_or_fails_or_is_not_reproduced_is_told_apart(bench: Bench) -> None:
    created(bench)
    unclear = bench.brink("suite", "run", "hazards.yaml", "--set", "limit=1.1", "--json", judge=chancy)
    assert verdicts(unclear)["unsafe-1"] in ("unclear", "still unsafe", "fixed")
    broken = bench.brink("suite", "run", "hazards.yaml", "--set", "limit=1.2", "--json", judge=failing)
    assert verdicts(broken)["unsafe-1"] == "cannot run"
    assert broken.exit_code == 1
    other = bench.brink("suite", "run", "hazards.yaml", "--json", judge=lambda job: outcome(1.0))
    assert verdicts(other)["unsafe-0"] == "not reproduced"
    assert other.exit_code == 1


def test_what_no_longer_exists_cannot_run_and_never_passes(bench: Bench) -> None:
    file = created(bench)
    document = yaml.safe_load(file.read_text())
    document["entries"][0]["unsafe"]["values"]["where.x"] = 99.0
    document["entries"][1]["unsafe"]["values"]["where.z"] = 1.0
    document["systems"]["gone"] = {"problem": "gone@1"}
    document["entries"][2]["system"] = "gone"
    file.write_text(yaml.safe_dump(document, sort_keys=False))
    answer = bench.brink("suite", "run", "hazards.yaml", "--json")
    assert answer.exit_code == 1
    cases = json.loads(answer.stdout)["cases"]
    assert {case["verdict"] for case in cases} == {"cannot run"}
    line = file.read_text()[: file.read_text().index("where.x: 99.0")].count("\n") + 1
    assert f"line {line}: entries[0].unsafe.values.where.x: expected" in cases[0]["reason"]
    assert "where.z" in cases[1]["reason"]
    assert "gone@1" in cases[2]["reason"]


def entries(file: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = yaml.safe_load(file.read_text())["entries"]
    return found


def sides(pair: Mapping[str, Any], number: str) -> dict[str, int]:
    return {side: pair[side][number] for side in ("unsafe", "safe")}


def test_confirmed_all_and_single_pairs_are_taken_with_their_evidence(bench: Bench) -> None:
    campaign = found(bench, [(0.99, 0.0), (1.01, 0.0), (-0.99, 0.0), (-1.01, 0.0)])
    none = bench.brink("suite", "create", campaign, "--pairs", "confirmed", "--out", "none.yaml")
    assert none.exit_code == 2
    assert "are not confirmed" in none.output
    asked = {"kind": "confirm", "repeats": 30, "limit": 1}
    again = expect(bench.client.post(f"{API}/campaigns/{campaign}/pairs/follow-ups", json=asked), 201)
    assert FakeWorker(bench.client, judge=certain).work(again["campaign"])["status"] == "finished"
    pairs = expect(bench.client.get(f"{API}/campaigns/{campaign}/pairs"))["pairs"]
    assert [one["confirmation"]["state"] == "confirmed" for one in pairs] == [True] + [False] * (
        len(pairs) - 1
    )
    assert len(pairs) > 1
    last = sides(pairs[-1], "number")
    for wanted, expected in (
        ("all", pairs),
        (f"{last['safe']}-{last['unsafe']}", pairs[-1:]),
        ("confirmed", pairs[:1]),
    ):
        answer = bench.brink("suite", "create", campaign, "--pairs", wanted, "--out", "p.yaml", "--force")
        assert answer.exit_code == 0, answer.output
        taken = entries(bench.folder / "p.yaml")
        assert [sides(one, "solution") for one in taken] == [sides(one, "number") for one in expected]
    (confirmed,) = taken
    assert confirmed["unsafe"]["unsafe"] == confirmed["unsafe"]["of"] > 4
    assert confirmed["safe"]["unsafe"] == 0 < 4 < confirmed["safe"]["of"]
    missing = bench.brink("suite", "create", campaign, "--pairs", "0-0", "--out", "none.yaml")
    assert missing.exit_code == 2
    assert "has no pair 0-0" in missing.output
    assert not (bench.folder / "none.yaml").exists()


def test_both_ends_of_each_threshold_are_taken(bench: Bench) -> None:
    body: dict[str, Any] = {"algorithm": {"id": "edge@2"}, "execution": {"keep_traces": 0}}
    campaign = submit(bench.client, ball(simulations=120, **body))
    assert FakeWorker(bench.client, judge=certain).work(campaign)["status"] == "finished"
    found = expect(bench.client.get(f"{API}/campaigns/{campaign}/findings/thresholds"))
    view = found["view"]["thresholds"]
    ends = [sides(one["pair"], "number") for one in view if one["pair"]]
    answer = bench.brink("suite", "create", campaign, "--thresholds", "--out", "ends.yaml")
    assert answer.exit_code == 0, answer.output
    taken = entries(bench.folder / "ends.yaml")
    assert [sides(one, "solution") for one in taken] == ends != []
    assert {tuple(one["tags"]) for one in taken} == {("threshold",)}


def test_an_example_of_each_type_of_violations_is_taken(bench: Bench) -> None:
    campaign = submit(bench.client, {**TRAFFIC, "budget": {"simulations": 24}})
    assert traffic_worker(bench.client).work(campaign)["status"] == "finished"
    types = expect(bench.client.get(f"{API}/campaigns/{campaign}/violations"))["types"]
    careful = {one["type"] for one in types if one["avoidable"] == "careful"}
    unsafe = expect(bench.client.get(f"{API}/campaigns/{campaign}/solutions", params={"unsafe": True}))
    decides = {one["number"] for one in unsafe["solutions"]}
    for wanted, kinds in (("all", {one["type"] for one in types}), ("avoidable", careful)):
        answer = bench.brink(
            "suite", "create", campaign, "--violations", wanted, "--out", "v.yaml", "--force"
        )
        of_verdict = {one["type"] for one in types if one["type"] in kinds and decides & {*one["numbers"]}}
        assert answer.exit_code == (0 if of_verdict else 2), answer.output
        if of_verdict:
            taken = entries(bench.folder / "v.yaml")
            assert {one["note"] for one in taken} == of_verdict
            assert {one["unsafe"]["solution"] for one in taken} <= decides
    assert types


def test_a_suite_that_was_found_with_a_newer_simulator_cannot_run(bench: Bench) -> None:
    file = created(bench)
    (simulator,) = {one["simulator"] for one in yaml.safe_load(file.read_text())["systems"].values()}
    stem, _, version = simulator.rpartition("@")
    newer = f"{stem}@{int(version) + 1}"
    file.write_text(file.read_text().replace(f"simulator: {simulator}", f"simulator: {newer}"))
    bench.jobs = 0
    answer = bench.brink("suite", "run", "hazards.yaml", "--json", "--junit", "hazards.xml")
    assert answer.exit_code == 1
    cases = json.loads(answer.stdout)["cases"]
    assert [(case["verdict"], case["passed"]) for case in cases] == [("cannot run", False)] * 3
    assert f"found with {newer}, and this Brink has {simulator}: update it" in cases[0]["reason"]
    assert ElementTree.parse(bench.folder / "hazards.xml").getroot().attrib["errors"] == "3"
    assert bench.jobs == 0


def test_versions_are_compared_and_a_run_is_submitted_over_the_api(bench: Bench) -> None:
    file = created(bench)
    old = bench.brink("suite", "run", "hazards.yaml", "--set", "limit=0.5", "--label", "1.0", "--json")
    bench.brink("suite", "run", "hazards.yaml", "--set", "limit=0.5", "--label", "1.1", "--json")
    document = yaml.safe_load(file.read_text())
    document["systems"]["gone"] = {"problem": "gone@1"}
    document["entries"].append({**document["entries"][0], "name": "lost", "system": "gone"})
    body = {"name": "hazards", "suite": document, "changes": {"limit": 3.0}, "label": "1.2"}
    runs = expect(bench.client.post(f"{API}/suites/runs", json=body), 201)
    assert [run["campaign"] is None for run in runs] == [False, True]
    assert [one["name"] for one in runs[1]["refused"]] == ["lost"]
    assert "gone@1" in runs[1]["refused"][0]["reason"]
    campaign = runs[0]["campaign"]
    assert FakeWorker(bench.client, judge=certain).work(campaign)["status"] == "finished"
    versions = expect(bench.client.get(f"{API}/campaigns/{campaign}/suite/versions"))
    assert [one["label"] for one in versions["versions"]] == ["1.2", "1.0, 1.1"]
    assert versions["versions"][1]["campaign"] == json.loads(old.stdout)["cases"][0]["campaign"]
    rows = {
        row["name"]: (row["turned_unsafe"], *(cell["mark"] for cell in row["cells"]))
        for row in versions["rows"]
    }
    assert rows == {"unsafe-1": (True, "✗", "✓"), "safe-2": (True, "✗", "✓"), "unsafe-0": (False, "✗", "✗")}
    assert list(rows)[-1] == "unsafe-0", "what turned unsafe is on top"
    wrong = {**body, "changes": {"limits": 1}}
    assert (
        "limits" in expect(bench.client.post(f"{API}/suites/runs", json=wrong), 422)["errors"][0]["message"]
    )
    document["entries"][0]["system"] = "nobody"
    refused = expect(bench.client.post(f"{API}/suites/runs", json=body), 422)
    assert refused["errors"][0]["pointer"] == "/suite/entries/0/system"
    assert bench.client.get(f"{API}/campaigns/{found(bench)}/suite/versions").status_code == 422


WRONG = [
    (["run", "hazards.yaml", "--set", "limits=1"], "--set: expected a parameter of ball@1, such as"),
    (["run", "nowhere.yaml"], "nowhere.yaml: No such file"),
    (["run", "hazards.yaml", "--against", "hazards.yaml"], "--against hazards.yaml"),
    (["run", "hazards.yaml", "--tag", "x"], "--tag: expected one of none"),
    (["create", "12", "--out", "other.yaml"], "which drives to take"),
    (["create", "12", "--pairs", "best", "--out", "other.yaml"], "--pairs: expected confirmed or all"),
    (["add", "hazards.yaml", "12", "--solutions", "x"], "--solutions: expected numbers such as 3,17"),
    (["create", "12", "--solutions", "1", "--out", "hazards.yaml"], "hazards.yaml exists"),
    (["remove", "hazards.yaml", "unsafe-7"], "did you mean"),
]


def test_wrong_usage_exits_with_2(bench: Bench) -> None:
    created(bench)
    for arguments, words in WRONG:
        answer = bench.brink("suite", *arguments)
        assert answer.exit_code == 2, answer.output
        assert words in answer.output


def test_adding_skips_what_is_there(bench: Bench) -> None:
    file = created(bench)
    before = file.read_text()
    campaign = found(bench)
    answer = bench.brink("suite", "add", "hazards.yaml", campaign, "--solutions", "0,1")
    assert answer.exit_code == 2
    assert "2 already in the suite" in answer.output
    assert file.read_text() == before
    shown = bench.brink("suite", "show", "hazards.yaml")
    assert shown.output.count("1 of 1 unsafe") == 2


def test_the_findings_and_the_api_have_the_verdicts(bench: Bench) -> None:
    created(bench)
    answer = bench.brink("suite", "run", "hazards.yaml", "--set", "limit=0.5", "--json")
    campaign = json.loads(answer.stdout)["cases"][0]["campaign"]
    cases = expect(bench.client.get(f"{API}/campaigns/{campaign}/suite"))
    assert {case["name"]: case["verdict"] for case in cases} == verdicts(answer)
    finding = expect(bench.client.get(f"{API}/campaigns/{campaign}/findings/suite"))
    assert finding["sentence"] == "3 drives: 1 fixed, 1 still unsafe, 1 still safe"
    refused = bench.client.get(f"{API}/campaigns/{found(bench)}/suite")
    assert refused.status_code == 422
