"""Pairs over the API and on the command line: a safe and an unsafe solution, and the change between them."""

import csv
import io
import json
from pathlib import Path
from typing import Any, ClassVar

import httpx
import pytest
from support.api import FakeWorker, ball, expect, finish, submit
from support.problems import REQUIREMENT, simulated
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.search.algorithm import Evaluation, Scored
from brink.search.space import Categorical, Component, Integer, SearchSpace
from brink.server.campaigns.pairs import find_reducible
from brink.server.problems.base import InProcessProblem, NoParams, Vectors
from brink.server.problems.catalogue import PROBLEMS
from brink.sim import catalogue
from brink.worker.wire import Completed, JobFailed, LeasedJob, WireVerdict

API = "/api/v1/campaigns"
WIDE: dict[str, float] = {"eps": 0.1, "d_th": 0.1}


def body(simulations: int = 200, **changes: Any) -> dict[str, Any]:
    """Return the body of a random search of the ball, which is unsafe within 1 m of the origin."""
    algorithm = {"id": "random@1", "params": {"generation_size": 20}}
    return ball(simulations=simulations, **{"algorithm": algorithm, **changes})


def pairs_of(client: httpx.Client, campaign: str, **params: Any) -> dict[str, Any]:
    found: dict[str, Any] = expect(client.get(f"{API}/{campaign}/pairs", params=params))
    return found


def points(client: httpx.Client, campaign: str) -> dict[int, tuple[float, float, str]]:
    page = expect(client.get(f"{API}/{campaign}/solutions", params={"limit": 1000}))
    return {
        one["number"]: (one["parameters"]["where"]["x"], one["parameters"]["what"]["y"], one["verdict"])
        for one in page["solutions"]
    }


class Crossroads(InProcessProblem):
    """Unsafe on ice if the detector is blind or the car is fast, and on a dry road if it is blind and fast."""

    id: ClassVar[str] = "crossroads@1"
    summary: ClassVar[str] = "Categories of the scenario and of the component, and a number."
    params_type: ClassVar[type[Any]] = NoParams

    def __init__(self, params: NoParams) -> None:
        road, detector = Categorical("road", ("dry", "ice")), Categorical("detector", ("sees", "blind"))
        speed = Integer("speed", 0, 9)
        self.space = SearchSpace((Component("scenario", (road,)), Component("behaviour", (detector, speed))))

    def evaluate(self, vectors: Vectors) -> Evaluation:
        """Return the verdict."""
        icy, blind, fast = vectors[0][0] == 1.0, vectors[1][0] == 1.0, vectors[1][1] > 4.0
        unsafe = sum(map(int, (icy, blind, fast))) >= 2
        return Scored(unsafe=unsafe, robustness=-1.0 if unsafe else 1.0)


def test_categorical_pairs_are_counted_apart_and_come_last(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(catalogue._registered[PROBLEMS], Crossroads.id, Crossroads)
    campaign = finish(client, body(simulations=40, problem={"id": Crossroads.id}))
    view = pairs_of(client, campaign, eps=0.4, d_th=0.0, limit=1000)
    natures = [pair["nature"] for pair in view["pairs"]]
    order = ["numbers", "category", "scenario category"]
    assert natures == sorted(natures, key=order.index)
    assert [natures.count(one) > 0 for one in order] == [True, True, True]
    assert view["categorical"] == natures.count("category") + natures.count("scenario category")
    assert view["scenario_only"] == natures.count("scenario category")
    for pair in view["pairs"]:
        changed = [name for change in pair["changes"] for name in change["names"]]
        if pair["nature"] == "scenario category":
            assert changed == ["scenario.road"]
        elif pair["nature"] == "category":  # or one step of the whole number
            assert changed in (["behaviour.detector"], ["behaviour.speed"])
        else:
            assert "behaviour.speed" in changed
            assert pair["distance"] > 0.5 / 9  # more than one step
    finding = expect(client.get(f"{API}/{campaign}/findings/pairs", params={"eps": 0.4, "d_th": 0.0}))
    assert finding["more"] == [
        f"In {view['categorical']} of {view['distinct']} pairs, a category or a step is changed and nothing else; in "
        f"{view['scenario_only']} of these, it belongs to the scenario"
    ]


def by_chance(job: LeasedJob) -> Completed | JobFailed:
    """Return the outcome that the ball would give or, for one seed in five, the opposite."""
    result = simulated(job.spec)
    if job.spec["seed"] % 5:
        return result
    robustness = -result.verdicts[REQUIREMENT].robustness
    return Completed(verdicts={REQUIREMENT: WireVerdict(robustness=robustness, unit="m", violated_at_s=None)})


def test_pairs_are_close_have_opposite_verdicts_and_lie_apart(client: httpx.Client) -> None:
    campaign = finish(client, body())
    view = pairs_of(client, campaign, **WIDE)
    where = points(client, campaign)
    assert view["complete"]
    assert (view["distinct"], len(view["pairs"])) == (len(view["pairs"]), view["distinct"])
    assert view["tight"] >= view["distinct"] >= 3
    assert (view["safe"] + view["unsafe"], view["chancy"]) == (200, 0)
    assert view["rule"] == {
        "safe_at_most": 0.2,
        "unsafe_at_least": 0.8,
        "error": 0.05,
        "least_drives": 15,
        "further_drives": 12,
        "interval": 0.9,
    }
    assert view["note"] == f"{view['distinct']} distinct pairs across the boundary, none simulated again yet"
    middles = []
    for place, pair in enumerate(view["pairs"], start=1):
        (x, y, safe), (u, v, unsafe) = (where[pair[side]["number"]] for side in ("safe", "unsafe"))
        assert (pair["place"], safe, unsafe) == (place, "safe", "unsafe")
        distance = 0.5 * (abs(x - u) + abs(y - v)) / 4.0
        assert pair["distance"] == pytest.approx(distance)
        assert distance <= 0.1
        assert pair["safe"]["parameters"] == {"where": {"x": x}, "what": {"y": y}}
        assert pair["safe"]["robustness"] > 0 > pair["unsafe"]["robustness"]
        assert [change["names"] for change in pair["changes"]] == [["where.x"], ["what.y"]]
        assert [change["active"] for change in pair["changes"]] == [None, None]
        assert pair["changes"][0]["safe"] == [x]
        assert pair["change"].startswith("where.x ")
        assert pair["words"].endswith(": violated distance")
        assert (pair["checked"], pair["same_seed"]) == (False, False)
        assert pair["confirmation"]["state"] == "not tried"
        assert (pair["component"]["state"], pair["minimality"]["state"]) == ("not tried", "different seeds")
        middles.append((0.5 * (x + u), 0.5 * (y + v)))
    apart = [0.125 * (abs(a - c) + abs(b - d)) for a, b in middles for c, d in middles]
    assert min(gap for gap in apart if gap) >= 0.1
    distances = [pair["distance"] for pair in view["pairs"]]
    assert distances == sorted(distances)


def test_the_answer_is_cached_by_the_client_until_something_changes(client: httpx.Client) -> None:
    campaign = finish(client, body())
    first = client.get(f"{API}/{campaign}/pairs", params=WIDE)
    again = client.get(
        f"{API}/{campaign}/pairs", params=WIDE, headers={"If-None-Match": first.headers["ETag"]}
    )
    assert (again.status_code, again.content) == (304, b"")
    number = first.json()["pairs"][0]["safe"]["number"]
    expect(client.post(f"{API}/{campaign}/repeats", json={"numbers": [number], "repeats": 5}), 201)
    changed = client.get(
        f"{API}/{campaign}/pairs", params=WIDE, headers={"If-None-Match": first.headers["ETag"]}
    )
    assert changed.status_code == 200


def test_a_running_campaign_shows_its_pairs_so_far(client: httpx.Client) -> None:
    campaign = submit(client, body())
    FakeWorker(client).work(campaign, until=lambda found: found["generation"] >= 4)
    view = pairs_of(client, campaign, **WIDE)
    assert (view["complete"], view["status"]) == (False, "running")
    assert view["note"].startswith(f"so far, after {view['evaluated']} of 200 simulations: ")
    assert 0 < view["evaluated"] < 200
    before = submit(client, body(seed=2))
    assert (
        pairs_of(client, before)["note"]
        == "so far, after 0 of 200 simulations: no solution has been evaluated: no pair"
    )


def test_a_campaign_with_one_verdict_has_no_pair(client: httpx.Client) -> None:
    safe = finish(client, body(40, problem={"id": "ball@1", "params": {"limit": 1e-9}}))
    view = pairs_of(client, safe)
    assert (view["note"], view["pairs"], view["nearest"]) == (
        "all 40 solutions held distance: no pair",
        [],
        None,
    )
    unsafe = finish(client, body(40, problem={"id": "ball@1", "params": {"limit": 4.0}}))
    assert pairs_of(client, unsafe)["note"] == "all 40 solutions violated distance: no pair"


def test_without_a_pair_the_nearest_opposite_verdicts_are_named(client: httpx.Client) -> None:
    campaign = finish(client, body(40))
    view = pairs_of(client, campaign, eps=1e-6)
    where = points(client, campaign)
    gaps = {
        (a, b): 0.125 * (abs(where[a][0] - where[b][0]) + abs(where[a][1] - where[b][1]))
        for a in where
        for b in where
        if (where[a][2], where[b][2]) == ("safe", "unsafe")
    }
    nearest = min(gaps, key=lambda pair: gaps[pair])
    assert (view["nearest"]["safe"], view["nearest"]["unsafe"]) == nearest
    assert view["nearest"]["distance"] == pytest.approx(gaps[nearest])
    assert f"{nearest[0]} and {nearest[1]}, are" in view["note"]
    assert view["note"].startswith("no pair within eps 1e-06: ")


@pytest.mark.usefixtures("few_trees")
def test_the_settings_of_the_search_for_pairs_are_the_default(client: httpx.Client) -> None:
    edge = {"id": "edge@1", "params": {"eps": 0.05, "d_th": 0.15}}
    campaign = submit(client, body(120, algorithm=edge))
    view = pairs_of(client, campaign)
    assert (view["eps"], view["d_th"]) == (0.05, 0.15)
    view = pairs_of(client, campaign, eps=0.2)
    assert (view["eps"], view["d_th"]) == (0.2, 0.15)
    plain = pairs_of(client, submit(client, body(20)))
    assert (plain["eps"], plain["d_th"]) == (0.02, 0.2)


def again(*points: tuple[float, float], simulations: int, **changes: Any) -> dict[str, Any]:
    """Return the body of a campaign that simulates given points in turn."""
    params = {"solutions": [[*point] for point in points]}
    return body(simulations, algorithm={"id": "repeat@1", "params": params}, **changes)


def test_a_pair_is_checked_if_both_sides_kept_their_verdicts(client: httpx.Client) -> None:
    campaign = finish(client, again((0.98, 0.0), (1.02, 0.0), (-0.98, 0.0), (-1.02, 0.0), simulations=7))
    view = pairs_of(client, campaign)
    sides = [(pair["checked"], pair["safe"]["number"], pair["unsafe"]["number"]) for pair in view["pairs"]]
    assert sides == [(True, 1, 0), (False, 3, 2)]
    assert [pair["safe"]["evaluated"] for pair in view["pairs"]] == [2, 1]
    assert view["note"] == "2 distinct pairs across the boundary, 1 checked"
    assert [pair["minimality"]["state"] for pair in view["pairs"]] == ["different seeds"] * 2


def test_a_side_that_was_simulated_twice_with_one_seed_is_not_checked(client: httpx.Client) -> None:
    params = {"solutions": [[0.98, 0.0], [1.02, 0.0]] * 2, "seed_numbers": [0, 0, 0, 0]}
    campaign = finish(client, body(4, algorithm={"id": "repeat@1", "params": params}))
    [pair] = pairs_of(client, campaign)["pairs"]
    assert (pair["safe"]["evaluated"], pair["checked"], pair["same_seed"]) == (2, False, True)
    assert pair["minimality"]["state"] == "minimal", "one number differs"


def test_too_many_pairs_are_refused(client: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign = finish(client, body())
    monkeypatch.setattr("brink.search.analysis.pairs.MOST_TIGHT", 100)
    [error] = expect(client.get(f"{API}/{campaign}/pairs", params={"eps": 1.0}), 422)["errors"]
    assert error["pointer"] == "/query/eps"
    assert "more than 100 pairs of solutions are within eps 1: choose a smaller eps" in error["message"]
    assert expect(client.get(f"{API}/{campaign}/pairs", params={"eps": 0.001})) is not None
    follow_up = {"kind": "confirm", "eps": 1.0}
    [error] = expect(client.post(f"{API}/{campaign}/pairs/follow-ups", json=follow_up), 422)["errors"]
    assert error["pointer"] == "/eps"
    monkeypatch.setattr("brink.search.analysis.pairs.MOST_TIGHT", 100_000)
    [error] = expect(client.get(f"{API}/{campaign}/pairs", params={"eps": 1.0}), 422)["errors"]
    assert "more than 100 pairs" in error["message"], "the refusal is cached"
    monkeypatch.setattr("brink.search.analysis.pairs.MOST_DISTINCT", 2)
    close = {"eps": 0.2, "d_th": 0.0}
    [error] = expect(client.get(f"{API}/{campaign}/pairs", params=close), 422)["errors"]
    assert error["pointer"] == "/query/d_th"
    assert "more than 2 distinct pairs at d_th 0: choose a larger d_th or a smaller eps" in error["message"]


def test_a_campaign_that_is_deleted_meanwhile_is_not_found(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign = finish(client, body(40))
    monkeypatch.setattr("brink.server.campaigns.view_store.read_seeds", lambda *_: {})
    problem = expect(client.get(f"{API}/{campaign}/pairs", params=WIDE), 404)
    assert problem["detail"] == f"campaign {campaign}: no such campaign"


def test_differences_are_reverted_on_paper_only_where_pairs_are_shown_before_the_end(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []

    def counted(plan: Any, archive: Any, pairs: Any) -> Any:
        asked.append(len(pairs))
        return find_reducible(plan, archive, pairs)

    monkeypatch.setattr("brink.server.campaigns.pairs.find_reducible", counted)
    monkeypatch.setattr("brink.server.findings.pairs.analysis.find_reducible", counted)
    campaign = submit(client, body())
    FakeWorker(client).work(campaign, until=lambda found: found["generation"] >= 6)
    running = pairs_of(client, campaign, **WIDE, limit=1)
    assert running["distinct"] > 1
    assert asked == [1]
    FakeWorker(client).work(campaign)
    ended = pairs_of(client, campaign, **WIDE, limit=1)
    assert asked == [1, ended["distinct"]]


def test_a_chancy_solution_is_no_side_of_a_pair(client: httpx.Client) -> None:
    campaign = finish(client, again((0.98, 0.0), (1.02, 0.0), simulations=40), by_chance)
    view = pairs_of(client, campaign)
    assert (view["safe"], view["unsafe"], view["chancy"], view["distinct"]) == (0, 0, 2, 0)
    assert view["note"] == "every solution had both verdicts (2): no pair"


@pytest.mark.parametrize("params", [{"eps": 1.5}, {"eps": -0.1}, {"d_th": 2}, {"limit": 0}, {"eps": "near"}])
def test_settings_out_of_range_are_refused(client: httpx.Client, params: dict[str, Any]) -> None:
    campaign = submit(client, body(20))
    [error] = expect(client.get(f"{API}/{campaign}/pairs", params=params), 422)["errors"]
    assert error["pointer"] == f"/query/{next(iter(params))}"


def test_computed_verdicts_need_no_seeds(client: httpx.Client) -> None:
    campaign = submit(client, body(300, problem={"id": "mtq@1"}))
    assert FakeWorker(client).work(campaign)["status"] == "finished"
    view = pairs_of(client, campaign, eps=0.05, d_th=0.05)
    assert view["computed"]
    assert view["note"] == f"{view['distinct']} distinct pairs across the boundary", "nothing to check"
    assert {pair["unsafe"]["outcome"] for pair in view["pairs"]} == {"unsafe"}


def test_tables_have_one_row_for_each_pair(client: httpx.Client) -> None:
    campaign = finish(client, body())
    view = pairs_of(client, campaign, **WIDE)
    answer = client.get(f"{API}/{campaign}/pairs", params={**WIDE, "format": "jsonl"})
    assert answer.headers["content-type"].startswith("application/jsonl")
    assert f"pairs-{campaign}.jsonl" in answer.headers["content-disposition"]
    assert [json.loads(line) for line in answer.text.splitlines()] == view["pairs"]
    table = client.get(f"{API}/{campaign}/pairs", params={**WIDE, "format": "csv", "limit": 2}).text
    rows = list(csv.DictReader(io.StringIO(table)))
    assert [row["words"] for row in rows] == [pair["words"] for pair in view["pairs"][:2]]
    assert float(rows[0]["unsafe.where.x"]) == view["pairs"][0]["unsafe"]["parameters"]["where"]["x"]
    empty = client.get(f"{API}/{campaign}/pairs", params={"eps": 0, "format": "jsonl"})
    assert empty.content == b""


@pytest.mark.long("one more command of a feature whose parts have unit tests")
@pytest.mark.usefixtures("short_forests")
def test_the_command_shows_and_writes_pairs_that_a_monitor_is_judged_on(
    listening_client: httpx.Client, tmp_path: Path
) -> None:
    campaign = finish(listening_client, body())
    server = ["--server", str(listening_client.base_url)]

    def brink(*arguments: str | Path, status: int = 0) -> str:
        shown = CliRunner().invoke(app, [str(one) for one in (*arguments, *server)])
        assert shown.exit_code == status, shown.output
        return shown.output if status == 0 else str(shown.exception)

    wide = ("--eps", "0.1", "--d-th", "0.1")
    view = json.loads(brink("pairs", campaign, *wide, "--json"))
    shown = brink("pairs", campaign, *wide, "--limit", "2")
    assert f"{view['distinct']} distinct pairs across the boundary, none simulated again yet" in shown
    assert "found once" in shown
    assert f"and {view['distinct'] - 2} more: --limit" in shown
    file = tmp_path / "pairs.jsonl"
    assert f"{file}: {view['distinct']} of {view['distinct']} distinct pairs" in brink(
        "pairs", campaign, *wide, "--out", file
    )
    assert brink("pairs", campaign, *wide, "--format", "jsonl") == file.read_text()
    assert len(file.read_text().splitlines()) == view["distinct"]
    brink("pairs", campaign, *wide, "--out", tmp_path / "pairs.parquet")
    assert (tmp_path / "pairs.parquet").read_bytes()[:4] == b"PAR1"

    monitor, fresh = tmp_path / "monitor.json", finish(listening_client, body(60, seed=2))
    brink("monitor", "fit", campaign, "--out", monitor)
    judged = json.loads(brink("monitor", "judge", monitor, fresh, "--pairs", file, "--json"))
    assert judged["pairs"]["pairs"] == view["distinct"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--out", "pairs.txt"], "ends in .csv, .jsonl or .parquet"),
        (["--format", "parquet"], "expected a file to write Parquet to"),
        (["--format", "csv", "--json"], "cannot be combined with --format"),
        (["--format", "table", "--out", "pairs.csv"], "for a file, got table"),
        (
            ["--picture", "1", "a.png", "--out", "pairs.csv"],
            "cannot be combined with --out: draw the pair alone",
        ),
        (["--film", "1", "a.gif", "--json", "--limit", "3"], "cannot be combined with --json and --limit"),
    ],
)
def test_options_that_contradict_each_other_are_refused(options: list[str], message: str) -> None:
    shown = CliRunner().invoke(app, ["pairs", "3f2a", *options])
    assert shown.exit_code == 1
    assert message in str(shown.exception)


def test_comparing_searches_for_pairs_counts_their_pairs(listening_client: httpx.Client) -> None:
    edge = {"id": "edge@1", "params": {"eps": 0.3, "d_th": 0.1}}
    campaign = finish(listening_client, body(60, algorithm=edge))
    distinct = expect(listening_client.get(f"/api/v1/campaigns/{campaign}/pairs"))["distinct"]
    server = str(listening_client.base_url)
    shown = CliRunner().invoke(app, ["compare", campaign, "--server", server])
    assert shown.exit_code == 0, shown.output
    assert "Pairs across the boundary" in shown.stdout
    assert "DBS" not in shown.stdout, "it did not search for that boundary"
    written = CliRunner().invoke(app, ["compare", campaign, "--server", server, "--json", "--no-control"])
    assert [row["pairs"]["distinct"] for row in json.loads(written.stdout)] == [distinct]
