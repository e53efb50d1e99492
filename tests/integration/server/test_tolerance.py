"""Tolerances over the API and on the command line: how gross errors may be, and whether a detector keeps within."""

import csv
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from support.api import coordinator, expect, submit
from support.databases import Databases
from support.tolerance import body, camera, finished
from typer.testing import CliRunner

from brink.cli.commands import app

pytestmark = pytest.mark.usefixtures("smaller_library")
API = "/api/v1/campaigns"


class Service:
    """A coordinator with a finished search, a second one with other seeds, and drives with a camera."""

    def __init__(self, client: httpx.Client) -> None:
        self.client = client
        self.campaign, self.fresh, self.camera = (
            finished(client, one)
            for one in (body(), body(2, 500, design="random", without_error=1), camera())
        )

    def get(self, path: str = "", status: int = 200, **params: Any) -> Any:
        return expect(self.client.get(f"{API}/{self.campaign}/tolerance{path}", params=params), status)


@pytest.fixture(scope="module")
def database(module_databases: Databases) -> Iterator[str]:
    with module_databases.database() as url:
        yield url


@pytest.fixture(scope="module")
def service(database: str) -> Iterator[Service]:
    with coordinator(database) as client:
        yield Service(client)


@pytest.mark.long("runs searches for tolerances")
def test_the_tolerated_magnitudes_are_found_with_units_and_sentences(service: Service) -> None:
    view = service.get()
    assert (view["complete"], view["open"], view["limit"], view["confidence"]) == (True, 0, 0.05, 0.9)
    assert view["conditions"] == ["by day", "by night"]
    assert len(view["cells"]) == 8
    for cell in view["cells"]:
        kind, target = cell["choices"].values()
        found = cell["tolerated"]
        if (kind, target) == ("miss", "lead"):
            assert found["finding"] == "limit"
            assert found["low"]["magnitude"] <= 2.25
            assert found["high"]["magnitude"] >= 1.9
            assert cell["caused"] > 0
            assert [one["magnitude"] for one in cell["examples"]] == sorted(
                one["magnitude"] for one in cell["examples"]
            )
            words = f"{cell['condition'].capitalize()}: not reporting the lead for "
            assert cell["sentence"].startswith(words)
            basis = (
                f"such errors did so in {cell['caused']} of {cell['drives']} vulnerable drives; "
                f"{cell['vulnerable']} of {cell['screened']} drives are vulnerable"
            )
            assert cell["sentence"].endswith(
                f" makes 5% of drives violate the front gap or collide ({basis})."
            )
            assert cell["error"] == "not reporting the lead for …"
        else:
            assert found["finding"] in ("throughout", "undecided")
            assert cell["caused"] == 0
        assert cell["unit"] == {"miss": "s", "left": "m"}[kind]
        assert cell["curve"]["severity"][-1] == 1.0
        assert cell["curve"]["magnitude"][-1] == {"miss": 8.0, "left": 4.0}[kind]
        assert sum(cell["curve"]["drives"]) == cell["drives"]
    assert view["note"].startswith("of 8 cells, ")
    assert f"; {sum(cell['drives'] for cell in view['cells'])} drives with an error" in view["note"]


def test_the_finding_says_what_a_missing_limit_does_not_mean(service: Service) -> None:
    finding = expect(service.client.get(f"{API}/{service.campaign}/findings"))
    assert "8 cells" in finding["words"]
    caveat = finding["more"][-1]
    assert "is not harmless" in caveat
    shares = [
        round(100 * cell["vulnerable"] / cell["screened"])
        for cell in service.get()["cells"]
        if cell["tolerated"]["finding"] == "throughout"
    ]
    low, high = min(shares), max(shares)
    assert f"makes {low}%{f' to {high}%' if low < high else ''} of drives violate" in caveat
    assert [one["kind"] for one in finding["findings"]] == ["tolerances"]


def test_violations_without_an_error_are_counted_apart(service: Service) -> None:
    view = service.get()
    shares = [one["share"] for one in view["baseline"]]
    assert [share["evaluated"] for share in shares] == [25] * 4
    assert 0 < sum(share["unsafe"] for share in shares) < 50
    assert [one["choices"] for one in view["baseline"]][:2] == [
        [{"behaviour.error_1.target": "lead"}],
        [{"behaviour.error_1.target": "pedestrian"}],
    ]
    assert all(cell["screened"] >= 40 for cell in view["cells"])
    assert all(cell["vulnerable"] <= cell["screened"] for cell in view["cells"])
    assert view["audited"] > view["leaks"] == 0


def test_csv_has_one_row_for_each_cell(service: Service) -> None:
    answer = service.client.get(f"{API}/{service.campaign}/tolerance", params={"format": "csv"})
    rows = list(csv.DictReader(io.StringIO(answer.text)))
    view = service.get()
    assert [(row["type"], row["target"], row["condition"]) for row in rows] == [
        (*cell["choices"].values(), cell["condition"]) for cell in view["cells"]
    ]
    assert [row["sentence"] for row in rows] == [cell["sentence"] for cell in view["cells"]]
    assert float(rows[0]["value"]) == pytest.approx(
        view["cells"][0]["tolerated"]["value"]["magnitude"], rel=1e-3
    )


def test_an_unchanged_answer_is_not_sent_again(service: Service) -> None:
    path = f"{API}/{service.campaign}/tolerance"
    etag = service.client.get(path).headers["ETag"]
    assert service.client.get(path, headers={"If-None-Match": etag}).status_code == 304


def test_fresh_drives_are_as_predicted(service: Service) -> None:
    view = service.get("/agreement", fresh=service.fresh)
    assert (len(view["cells"]), view["drives"]) == (8, sum(cell["drives"] for cell in view["cells"]))
    assert view["agreeing"] >= 7
    assert view["agreeing"] == sum(cell["agrees"] is True for cell in view["cells"])
    for cell in view["cells"]:
        assert cell["agrees"] == (cell["low"] <= cell["caused"] <= cell["high"])
    assert f"contradict the predictions in {8 - view['agreeing']} of 8 cells" in view["note"]


def test_a_campaign_is_not_compared_with_its_own_drives(service: Service) -> None:
    problem = service.get("/agreement", 422, fresh=service.campaign)
    assert "another campaign" in problem["errors"][0]["message"]


def test_only_drives_that_were_not_screened_are_fresh(service: Service) -> None:
    other = finished(service.client, body(6, 400))
    problem = service.get("/agreement", 422, fresh=other)
    assert "does not screen its drives" in problem["errors"][0]["message"]


def test_a_detector_is_held_against_the_tolerances(service: Service) -> None:
    view = service.get("/detector", episodes=service.camera)
    assert view["detector"] == "brink-det@2"
    results = {(*cell["choices"].values(), cell["condition"]): cell for cell in view["cells"]}
    by_day, by_night = (results["miss", "lead", condition] for condition in ("by day", "by night"))
    assert (by_day["result"], by_night["result"]) == ("met", "not met")
    assert by_day["grossest"] < 0.41 < by_night["grossest"]
    assert by_night["beyond"] > 0 == by_day["beyond"]
    assert by_night["low"] > view["limit"] > by_day["high"]
    assert len(by_night["worst"]) == 5
    assert sum(one["drives"] for one in view["conditions"]) == 200
    assert sum(one["violations"] for one in view["conditions"]) < 40
    assert view["cells"][0]["result"] == "not met"
    # No drive had a pedestrian.
    nobody = [cell for cell in view["cells"] if "pedestrian" in cell["choices"].values()]
    assert {(cell["result"], cell["share"], cell["high"]) for cell in nobody} == {("no data", None, None)}
    assert "by day: not reporting the nearest pedestrian for …, " in view["no_data"]
    assert any("59 drives or more each with a pedestrian near the lane" in words for words in view["next"])


def judged(service: Service, drives: list[Any]) -> dict[tuple[str, ...], Any]:
    """Return what the coordinator says of drives, by type, target and condition."""
    path = f"{API}/{service.campaign}/tolerance/detector"
    view = expect(service.client.post(path, json={"detector": "mine", "drives": drives}))
    return {(*cell["choices"].values(), cell["condition"]): cell for cell in view["cells"]}


def test_drives_that_do_not_tell_give_no_verdict(service: Service) -> None:
    silent: list[dict[str, Any]] = [
        {"measures": {}},
        {"measures": {"lead": {"left": 0.1}}},
        {"measures": {"pedestrian": {"miss": 0.0}}},
        {"measures": {"lead": {"miss": 0.0}}, "at_least": {"lead": ["miss"]}},
    ]
    for drive in silent:
        cells = judged(service, [{"name": f"d{i}", "condition": "by night", **drive} for i in range(200)])
        cell = cells["miss", "lead", "by night"]
        assert (cell["result"], cell["drives"], cell["share"], cell["needed"]) == ("no data", 0, None, 59)


def test_few_drives_say_too_little_and_how_many_would_do(service: Service) -> None:
    def drives(count: int) -> list[Any]:
        measures = {"lead": {"miss": 0.1, "left": 0.0}}
        return [{"name": f"d{i}", "condition": "by night", "measures": measures} for i in range(count)]

    few = judged(service, drives(20))["miss", "lead", "by night"]
    assert (few["result"], few["drives"]) == ("not enough data", 20)
    assert few["high"] > few["low"]
    assert 30 < few["needed"] <= 70
    enough = judged(service, drives(few["needed"] + 10))["miss", "lead", "by night"]
    assert (enough["result"], enough["needed"]) == ("met", None)
    assert enough["high"] > 0.0


def test_a_blind_detector_is_not_met_after_a_dozen_drives(service: Service) -> None:
    blind = [
        {"name": f"d{i}", "condition": "by night", "measures": {"lead": {"miss": 8.0}}} for i in range(12)
    ]
    assert judged(service, blind)["miss", "lead", "by night"]["result"] == "not met"


def test_drives_without_a_condition_count_under_all_drives_alone(service: Service) -> None:
    bad = {"measures": {"lead": {"miss": 6.0}}}
    cells = judged(service, [{"name": f"d{i}", **bad} for i in range(40)])
    assert cells["miss", "lead", "all drives"]["result"] == "not met"
    for condition in ("by day", "by night"):
        assert cells["miss", "lead", condition]["result"] == "no data"
    named = judged(service, [{"name": "d", "condition": "by day", **bad}])
    assert ("miss", "lead", "all drives") not in named


def test_what_is_beyond_the_scale_may_be_as_bad_as_can_be(service: Service) -> None:
    def cell(magnitude: float) -> Any:
        measures = {"pedestrian": {"left": magnitude}}
        drives = [{"name": f"d{i}", "condition": "by day", "measures": measures} for i in range(40)]
        return judged(service, drives)["left", "pedestrian", "by day"]

    assert cell(4.0)["high"] < 0.2 < 0.9 < cell(9.0)["high"]


@pytest.mark.parametrize(
    ("drives", "words"),
    [
        ([], "at least 1"),
        (
            [{"name": "a", "condition": "in fog", "measures": {}}],
            "expected one of the conditions by day; by night",
        ),
        ([{"name": "a", "measures": {"lead": {"miss": "long"}}}], "number"),
        ([{"name": "a", "measures": {}, "speed": 3}], "speed"),
        ([{"name": "a", "measures": {"laed": {"miss": 1.0}}}], "expected targets of lead, oncoming"),
        ([{"name": "a", "measures": {"lead": {"Miss": 1.0}}}], "expected types of miss, late"),
        ([{"name": "a", "measures": {"lead": {"miss": -1.0}}}], "expected a magnitude >= 0"),
    ],
)
def test_errors_that_do_not_fit_are_refused(service: Service, drives: list[Any], words: str) -> None:
    path = f"{API}/{service.campaign}/tolerance/detector"
    problem = expect(service.client.post(path, json={"detector": "mine", "drives": drives}), 422)
    assert words in json.dumps(problem["errors"])


def test_other_campaigns_have_no_tolerances(service: Service) -> None:
    problem = expect(service.client.get(f"{API}/{service.camera}/tolerance"), 422)
    assert "tolerance@1" in problem["errors"][0]["message"]
    problem = service.get("/detector", 422, episodes=service.fresh)
    assert "detector in the loop" in problem["errors"][0]["message"]


@pytest.mark.parametrize(
    ("changes", "pointer", "words"),
    [
        ({"cells": {"type": ["mis"]}}, "/algorithm/params/cells", "did you mean 'miss'"),
        ({"cells": {"typ": ["miss"]}}, "/algorithm/params/cells", "unknown parameter 'typ'"),
        ({"conditions": [{"weather": "snow"}]}, "/algorithm/params/conditions", "expected one of clear"),
        (
            {"conditions": [{"name": "empty", "pedestrians": "0"}]},
            "/algorithm/params/conditions",
            "pedestrian under empty: expected scenario.pedestrians to allow 18, got 0",
        ),
        ({"limit": 1.5}, "/algorithm/params/limit", "less than 1"),
    ],
)
def test_a_search_that_cannot_run_is_refused_at_submission(
    service: Service, changes: dict[str, Any], pointer: str, words: str
) -> None:
    problem = expect(service.client.post(API, json=body(9, **changes)), 422)
    (error,) = problem["errors"]
    assert error["pointer"] == pointer
    assert words in error["message"]


def test_progress_names_the_kind_of_search(service: Service) -> None:
    found = expect(service.client.get(f"{API}/{service.campaign}/progress"))
    assert found["finds"] == ["tolerances"]


def test_a_running_search_has_tolerances(service: Service) -> None:
    campaign = submit(service.client, body(5))
    view = expect(service.client.get(f"{API}/{campaign}/tolerance"))
    assert not view["complete"]
    assert {cell["tolerated"]["finding"] for cell in view["cells"]} == {"undecided"}
    assert all("nothing is known yet" in cell["sentence"] for cell in view["cells"])
    assert view["note"].startswith("no drive with an error has been simulated yet")
    expect(service.client.post(f"{API}/{campaign}/cancel"))


# The command line.

HEADER = "drive,time_s,source,id,label,x_min_px,x_max_px,y_min_px,y_max_px,condition\n"


def detections(path: Path, *, drives: int, missed_s: float) -> Path:
    """Write drives of 8 s with a lead 15 m ahead that is missed for a while in each."""
    rows = [HEADER]
    for drive in range(drives):
        for step in range(81):
            time_s = step / 10
            box = "380,420,310,345,by night"
            rows.append(f"{drive},{time_s},truth,7,vehicle,{box}\n")
            if not 3.0 <= time_s < 3.0 + missed_s:
                rows.append(f"{drive},{time_s},detection,,vehicle,{box}\n")
    path.write_text("".join(rows))
    return path


@pytest.mark.long("runs searches for tolerances")
def test_commands_show_write_and_draw_tolerances(service: Service, database: str, tmp_path: Path) -> None:

    def tolerance(*options: str) -> str:
        done = CliRunner().invoke(app, ["tolerance", service.campaign, "--database", database, *options])
        assert done.exit_code == 0, done.output
        return done.stdout

    shown = tolerance()
    assert "not reporting the lead for …" in shown
    assert "not reporting the nearest pedestrian for …" in shown
    assert "vulnerable: those that it makes violate" in shown
    assert "Drives without any error" in shown
    sentences = tolerance("--format", "sentences").splitlines()
    assert len(sentences) == 8
    assert sentences[0].startswith("By day: not reporting the lead for ")
    table, picture = tmp_path / "requirement.csv", tmp_path / "requirement.png"
    tolerance("--out", str(table), "--picture", str(picture))
    assert len(table.read_text().splitlines()) == 9
    assert picture.stat().st_size > 20_000
    assert len(json.loads(tolerance("--json"))["cells"]) == 8
    assert "intervals of at least two do not overlap" in tolerance("--beside", service.fresh)
    document = tmp_path / "requirement.md"
    tolerance("--out", str(document))
    text = document.read_text()
    assert text.startswith("# Requirement on the component: tolerance-1\n")
    assert text.count("\n- By ") == 8
    no_limit = text.partition("## No limit found")[2]
    assert "makes fewer than 5% of drives" in no_limit
    assert "An error for which no limit was found is not harmless" in text
    good = detections(tmp_path / "good.csv", drives=60, missed_s=0.3)
    bad = detections(tmp_path / "bad.csv", drives=20, missed_s=4.0)
    for file, result in ((good, "met"), (bad, "not met")):
        view = json.loads(tolerance("--detections", str(file), "--json"))
        (cell,) = (
            one
            for one in view["cells"]
            if list(one["choices"].values()) == ["miss", "lead"] and one["condition"] == "by night"
        )
        assert cell["result"] == result
        assert cell["typical"] == pytest.approx(0.3 if result == "met" else 4.0)
    assert "not met" in tolerance("--detections", str(bad))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--out", "requirement.txt"], "ends in .csv, .json or .md"),
        (["--json", "--format", "csv"], "cannot be combined with --format"),
        (["--against", "3f2a", "--episodes", "9c01"], "cannot be combined with --against"),
        (["--beside", "9c01", "--picture", "curves.png"], "cannot be combined with --beside"),
        (["--picture", "curves.gif"], "ends in .png, .svg or .pdf"),
    ],
)
def test_options_that_contradict_each_other_are_refused(
    service: Service, options: list[str], words: str
) -> None:
    done = CliRunner().invoke(app, ["tolerance", service.campaign, *options])
    assert done.exit_code != 0
    assert words in str(done.exception)
