"""Violations over the API and the command line: their types, and the names that people give them."""

import csv
import io
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from PIL import Image
from rich.console import Console
from support.api import expect, listening_coordinator, progress, submit
from support.databases import Databases, module_sqlite_then_postgres
from support.traffic import traffic_worker
from typer.testing import CliRunner

from brink.api.live import CampaignDisplay
from brink.cli.commands import app
from brink.cli.kind_files import draw_types, write_violations
from brink.pictures.pair_view import STILL_WIDTH_PX
from brink.search.analysis.violations import RULES_VERSION
from brink.server.api.schemas import Progress
from brink.server.findings.violations.views import Violations

TRAFFIC: dict[str, Any] = {
    "name": "traffic",
    "problem": {"id": "npc-actions@1", "params": {"participants": 3, "duration_s": 12.0}},
    "algorithm": {"id": "mumoea@1", "params": {"population_size": 20}},
    "budget": {"simulations": 40},
    "seed": 1,
}


@pytest.fixture(scope="module")
def client(module_databases: Databases) -> Iterator[httpx.Client]:
    """A client of a coordinator that the command line can reach too."""
    with module_databases.database() as url, listening_coordinator(url) as opened:
        yield opened


@pytest.fixture(scope="module")
def campaign(client: httpx.Client) -> str:
    """A campaign with violations; tests that name them take the names back."""
    campaign = submit(client, TRAFFIC)
    stands = traffic_worker(client).work(campaign)
    assert (stands["status"], stands["failed"]) == ("finished", 0)
    return campaign


@pytest.mark.long("runs searches that unit tests of violations need not")
def test_every_unsafe_solution_has_a_violation_with_a_type(client: httpx.Client, campaign: str) -> None:
    path = f"/api/v1/campaigns/{campaign}"
    found = expect(client.get(f"{path}/violations"))
    solutions = expect(client.get(f"{path}/solutions", params={"unsafe": True}))["solutions"]
    assert solutions
    assert {one["number"] for one in found["violations"]} == {one["number"] for one in solutions}
    assert found["rules_version"] == RULES_VERSION
    types = {kind["type"]: kind for kind in found["types"]}
    for one in found["violations"]:
        assert one["number"] in types[one["type"]]["numbers"]
        assert one["signature"]["requirement"] == one["requirement"]
        assert one["circumstances"]["time_s"] == one["time_s"]
    for kind in found["types"]:
        assert kind["first"] == min(kind["numbers"])
        assert 1 <= kind["instances"] <= kind["solutions"] == len(kind["numbers"])
    types_only = expect(client.get(f"{path}/violations", params={"types_only": True}))
    assert types_only == {**found, "violations": []}


BEST = ["careful", "ideal", "no"]


@module_sqlite_then_postgres
def test_types_begin_with_what_a_careful_driver_would_have_avoided(
    client: httpx.Client, campaign: str
) -> None:
    found = expect(client.get(f"/api/v1/campaigns/{campaign}/violations"))
    types = found["types"]
    assert {kind["avoidable"] for kind in types} > {"careful"}
    order = [
        (kind["avoidable"] == "no", kind["avoidable"], -kind["solutions"], kind["first"]) for kind in types
    ]
    assert order == sorted(order)
    examples: set[int] = set()
    for kind in types:
        its = [one for one in found["violations"] if one["type"] == kind["type"]]
        assert kind["avoidable_by"] == {by: sum(one["avoidable"] == by for one in its) for by in BEST}
        assert kind["avoidable"] == next(by for by in BEST if kind["avoidable_by"][by])
        fitting = {one["number"] for one in its if one["avoidable"] == kind["avoidable"]}
        assert kind["example"] == min(fitting - examples or fitting)
        examples.add(kind["example"])
        all_of_them = str(len({one["number"] for one in its}))
        words = f"{len(fitting)} of {all_of_them}"
        assert kind["avoided"] == (all_of_them if kind["avoidable"] == "no" else words)
        faults = {one["at_fault"] for one in its}
        assert kind["at_fault"] == (faults.pop() if len(faults) == 1 else None)
    avoided = [one for one in found["violations"] if one["avoidable"] == "careful"]
    numbers, solutions = ({one["number"] for one in some} for some in (avoided, found["violations"]))
    assert {one["avoided_by"] for one in avoided} <= {"braking", "driving on"}
    assert {one["avoided_by"] for one in found["violations"] if one["avoidable"] == "no"} == {None}
    braking = {one["type"] for one in avoided if one["avoided_by"] == "braking"}
    assert braking == {kind["type"] for kind in types if kind["avoided_by"] == "braking"} & {
        one["type"] for one in avoided
    }
    careful = sum(kind["avoidable"] == "careful" for kind in types)
    assert found["words"] == (
        f"a careful driver would have avoided {careful} of {len(types)} types of violations, "
        f"{len(braking)} of them by braking, in {len(numbers)} of {len(solutions)} solutions with violations"
    )
    assert "Regulation No. 157, Annex 3" in found["explanation"]


@module_sqlite_then_postgres
def test_violations_can_be_filtered_by_who_would_have_avoided_them(
    client: httpx.Client, campaign: str
) -> None:
    path = f"/api/v1/campaigns/{campaign}/violations"
    found = expect(client.get(path))
    for by in BEST:
        chosen = expect(client.get(path, params={"avoidable": by}))
        assert chosen["violations"] == [one for one in found["violations"] if one["avoidable"] == by]
        assert {kind["type"] for kind in chosen["types"]} == {one["type"] for one in chosen["violations"]}
        assert all(kind["avoidable"] == by for kind in chosen["types"])
        solutions = {kind["type"]: kind["solutions"] for kind in found["types"]}
        for kind in chosen["types"]:
            words = f"{kind['solutions']} of {solutions[kind['type']]}"
            assert kind["avoided"] in ((words, words.partition(" ")[0]) if by == "no" else (words,))
        assert chosen["words"] == found["words"]
    expect(client.get(path, params={"avoidable": "nobody"}), 422)


@module_sqlite_then_postgres
def test_a_solution_says_who_would_have_avoided_each_of_its_violations(
    client: httpx.Client, campaign: str
) -> None:
    path = f"/api/v1/campaigns/{campaign}"
    found = expect(client.get(f"{path}/violations"))["violations"]
    for number in {one["number"] for one in found}:
        solution = expect(client.get(f"{path}/solutions/{number}"))
        told = {one["requirement"]: one["avoidable"] for one in solution["violated"]}
        assert told == {one["requirement"]: one["avoidable"] for one in found if one["number"] == number}


def recorded(client: httpx.Client, path: str) -> httpx.Response:
    """Return what needs a trace, which a worker records if there is none."""
    solution = re.match(r".*/solutions/\d+", path)
    assert solution is not None
    if client.post(path if "/compared/" in path else f"{solution[0]}/trace").status_code == 202:
        traffic_worker(client).report_all()
    return client.get(path, params={"wait_s": 0})


def example(found: dict[str, Any], avoidable: str) -> int:
    """Return the first solution whose violations are all avoidable by one driver, or by none."""
    by_number: dict[int, set[str]] = {}
    for one in found["violations"]:
        by_number.setdefault(one["number"], set()).add(one["avoidable"])
    return next(number for number, kinds in sorted(by_number.items()) if kinds == {avoidable})


@module_sqlite_then_postgres
def test_an_episode_has_the_drive_of_the_careful_driver_who_avoids_its_violation(
    client: httpx.Client, campaign: str
) -> None:
    path = f"/api/v1/campaigns/{campaign}"
    number = example(expect(client.get(f"{path}/violations")), "careful")
    violated = expect(client.get(f"{path}/solutions/{number}"))["violated"]
    episode = expect(recorded(client, f"{path}/solutions/{number}/episode"))
    reference = episode["reference"]
    assert (reference["driver"], reference["name"]) == ("careful", "careful driver")
    system, instead = reference["sentences"]
    named = re.sub(r"\ba (vehicle|pedestrian)\b", r"\\S+", violated[0]["words"])
    assert re.match(f"The system (.* and )?{named}", system)
    assert set(reference["violated"]) == {one["requirement"] for one in violated}
    assert reference["violated"][violated[0]["requirement"]] in system
    assert (reference["avoided_by"] == "") is (violated[0]["avoided_by"] == "braking")
    assert set(reference["drive"]["plan_mode"]) <= {"brakes", "waits", "drives"}
    assert instead.startswith("A careful driver ")
    assert pytest.approx(reference["moment_s"]) in [one["time_s"] for one in violated]
    drive = reference["drive"]
    assert drive["reference"] is None
    assert [one["name"] for one in drive["actors"]] == [one["name"] for one in episode["actors"]]
    assert len(drive["time_s"]) == len(drive["ego"]["x_m"])
    assert not drive["story"]["violated"]
    picture = Image.open(io.BytesIO(recorded(client, f"{path}/solutions/{number}/replay.png").content))
    assert picture.width == STILL_WIDTH_PX, "both drives are side by side"
    sides = {
        side: expect_picture(recorded(client, f"{path}/solutions/{number}/compared/{side}.png"))
        for side in ("system", "reference")
    }
    assert sides["system"] != sides["reference"]


def expect_picture(response: httpx.Response) -> bytes:
    assert (response.status_code, response.headers["content-type"]) == (200, "image/png")
    return response.content


@module_sqlite_then_postgres
def test_an_episode_whose_violation_nobody_avoids_is_shown_alone(client: httpx.Client, campaign: str) -> None:
    path = f"/api/v1/campaigns/{campaign}"
    number = example(expect(client.get(f"{path}/violations")), "no")
    assert expect(recorded(client, f"{path}/solutions/{number}/episode"))["reference"] is None
    assert recorded(client, f"{path}/solutions/{number}/compared/system.png").status_code == 204
    picture = Image.open(io.BytesIO(recorded(client, f"{path}/solutions/{number}/replay.png").content))
    assert picture.width != STILL_WIDTH_PX


@module_sqlite_then_postgres
def test_the_finding_begins_with_what_a_careful_driver_would_have_avoided(
    client: httpx.Client, campaign: str
) -> None:
    found = expect(client.get(f"/api/v1/campaigns/{campaign}/violations"))
    told = expect(client.get(f"/api/v1/campaigns/{campaign}/findings"))
    assert told["words"] == f"{found['words'][0].upper()}{found['words'][1:]}."
    careful = {one["number"]: one for one in found["violations"] if one["avoidable"] == "careful"}
    view = next(one["view"] for one in told["findings"] if one["kind"] == "violations")
    assert 1 <= len(view["examples"]) <= 2
    assert view["examples"][0]["type"] == found["types"][0]["type"]
    for one in view["examples"]:
        assert one["number"] in careful
        assert one["words"].endswith(" s")
    assert view["explanation"] == found["explanation"]


@module_sqlite_then_postgres
def test_a_name_makes_a_type_and_can_be_taken_back(client: httpx.Client, campaign: str) -> None:
    path = f"/api/v1/campaigns/{campaign}/violations"
    before = expect(client.get(path))
    one = before["violations"][0]
    name = f"{path}/{one['number']}/{one['requirement']}/name"
    expect(client.put(name, json={"name": "squeezed out"}), 204)
    expect(client.put(name, json={"name": "squeezed <b>out</b>"}), 204)
    named = expect(client.get(path))
    (kind,) = [kind for kind in named["types"] if kind["type"] == "squeezed <b>out</b>"]
    assert (kind["numbers"], kind["named"]) == ([one["number"]], 1)
    assert named["types"][0] == kind, "what a person named comes first"
    assert named["violations"][0]["signature"] == one["signature"]
    expect(client.delete(name), 204)
    assert expect(client.get(path)) == before


@module_sqlite_then_postgres
def test_names_of_what_is_not_there_are_refused(client: httpx.Client, campaign: str) -> None:
    path = f"/api/v1/campaigns/{campaign}/violations"
    one = expect(client.get(path))["violations"][0]
    safe = next(
        n for n in range(40) if n not in {v["number"] for v in expect(client.get(path))["violations"]}
    )
    detail = expect(client.put(f"{path}/{safe}/no-collision@1/name", json={"name": "x"}), 404)["detail"]
    assert "it has none" in detail
    detail = expect(client.put(f"{path}/{one['number']}/comfort@1/name", json={"name": "x"}), 404)["detail"]
    assert one["requirement"] in detail
    for body in ({}, {"name": ""}, {"name": "x" * 201}, {"name": "two\nlines"}, {"name": "x", "more": 1}):
        expect(client.put(f"{path}/{one['number']}/{one['requirement']}/name", json=body), 422)


@pytest.mark.long("runs searches that unit tests of violations need not")
def test_a_search_for_violations_says_so_while_it_runs(client: httpx.Client, capsys: Any) -> None:
    campaign = submit(client, {**TRAFFIC, "seed": 2})
    traffic_worker(client).work(campaign, until=lambda stands: bool(stands["generations"]))
    stands = progress(client, campaign)
    assert (stands["status"], stands["finds"]) == ("running", ["violations"])
    with CampaignDisplay(Console(width=200)) as display:
        display.show(Progress.model_validate(stands))
    said = capsys.readouterr().out
    assert "criticality" in said
    assert "boundary" not in said
    assert "best fitness" not in said


@module_sqlite_then_postgres
def test_nothing_is_said_of_a_boundary_that_was_not_searched_for(client: httpx.Client, campaign: str) -> None:
    place = ["--server", str(client.base_url)]
    assert "boundary" not in CliRunner().invoke(app, ["status", campaign, *place]).stdout
    refused = CliRunner().invoke(app, ["results", campaign, *place])
    assert "has no findings of kind 'boundary'; it has violations" in str(refused.exception)
    assert expect(client.get(f"/api/v1/campaigns/{campaign}"))["finds"] == ["violations"]


@module_sqlite_then_postgres
def test_a_problem_without_violations_says_so(client: httpx.Client) -> None:
    body = {
        "name": "m",
        "problem": {"id": "mtq@1"},
        "algorithm": {"id": "random@1"},
        "budget": {"simulations": 60},
    }
    campaign = submit(client, body)
    detail = expect(client.get(f"/api/v1/campaigns/{campaign}/violations"), 404)["detail"]
    assert "as for npc-actions@1, not for mtq@1; see what it found with: brink report" in detail


@module_sqlite_then_postgres
def test_command_line_names_them(
    client: httpx.Client, campaign: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "220")
    place = ["--server", str(client.base_url)]
    found = json.loads(CliRunner().invoke(app, ["violations", campaign, "--json", *place]).stdout)
    assert found == expect(client.get(f"/api/v1/campaigns/{campaign}/violations"))
    shown = CliRunner().invoke(app, ["violations", campaign, *place])
    assert shown.exit_code == 0, shown.output
    assert found["words"] in " ".join(shown.stdout.split())
    assert all(kind["type"] in " ".join(shown.stdout.split()) for kind in found["types"])
    few = CliRunner().invoke(app, ["violations", campaign, "--shown", "1", *place])
    assert f"… and {len(found['types']) - 1} more: without --shown" in few.stdout
    careful = CliRunner().invoke(app, ["violations", campaign, "--avoidable", "careful", "--json", *place])
    path = f"/api/v1/campaigns/{campaign}/violations"
    assert json.loads(careful.stdout) == expect(client.get(path, params={"avoidable": "careful"}))
    one = found["violations"][0]
    which = ["--number", str(one["number"]), "--requirement", one["requirement"], *place]
    named = CliRunner().invoke(app, ["violations", campaign, "--name", "squeezed out", *which])
    assert f"{one['requirement']}: squeezed out" in named.stdout
    unnamed = CliRunner().invoke(app, ["violations", campaign, "--unname", *which])
    assert one["type"] in unnamed.stdout
    by_requirement = ["--requirement", one["requirement"], "--shown", "1", *place]
    listed = CliRunner().invoke(app, ["violations", campaign, *by_requirement]).stdout.splitlines()
    assert [line.partition(" ")[0] for line in listed] == [str(one["number"]), "…"]
    for wrong in (["--name", "x"], ["--number", "0", "--name", "x", "--unname"]):
        refused = CliRunner().invoke(app, ["violations", campaign, *wrong, *place])
        assert refused.exit_code != 0


@module_sqlite_then_postgres
def test_the_command_line_says_which_violation_is_not_there(client: httpx.Client, campaign: str) -> None:
    found = expect(client.get(f"/api/v1/campaigns/{campaign}/violations"))["violations"]
    safe = next(number for number in range(40) if number not in {one["number"] for one in found})
    own = [one["requirement"] for one in found if one["number"] == found[0]["number"]]
    for given, message in [
        (["--number", "9999"], f"campaign {campaign} has no solution 9999"),
        (["--number", str(safe)], f"solution {safe} violates nothing"),
        (["--number", str(safe), "--name", "x"], f"solution {safe} violates nothing"),
        (["--requirement", "front-gap@1"], "got 'front-gap@1'"),
        (
            ["--number", str(found[0]["number"]), "--requirement", "comfort@1"],
            f"--requirement: expected one of {', '.join(sorted(own))}; got 'comfort@1'",
        ),
    ]:
        said = CliRunner().invoke(app, ["violations", campaign, *given, "--server", str(client.base_url)])
        assert (said.exit_code, said.stdout) == (1, "")
        assert message in str(said.exception)


@module_sqlite_then_postgres
def test_files_hold_every_violation(client: httpx.Client, campaign: str, tmp_path: Path) -> None:
    found = expect(client.get(f"/api/v1/campaigns/{campaign}/violations"))
    document, table = write_violations(Violations.model_validate(found), tmp_path)
    assert json.loads(document.read_text()) == found
    rows = list(csv.DictReader(io.StringIO(table.read_text())))
    assert [row["type"] for row in rows] == [one["type"] for one in found["violations"]]
    assert [row["avoidable"] for row in rows] == [one["avoidable"] for one in found["violations"]]
    assert [row["avoided_by"] or None for row in rows] == [one["avoided_by"] for one in found["violations"]]
    assert [row["at_fault"] == "True" for row in rows] == [one["at_fault"] for one in found["violations"]]
    assert all(
        float(row["time_s"]) == round(one["time_s"], 3)
        for row, one in zip(rows, found["violations"], strict=True)
    )
    assert {row["place"] for row in rows} <= {"straight", "curve", "junction", "crossing"}
    assert draw_types(Violations.model_validate(found), tmp_path).stat().st_size > 5_000
