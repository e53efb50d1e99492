"""What a campaign found, in a sentence; what to do next; and the pictures of its pairs."""

import base64
import io
import json
from typing import Any
from urllib.parse import parse_qs

import httpx
import pytest
from PIL import Image
from support.api import FakeWorker, ball, completes, expect, finish, submit
from support.databases import sqlite_then_postgres
from support.problems import REQUIREMENT, SIMULATOR
from support.traces import make_trace
from support.urban_pairs import SAFE, UNSAFE, judged, row

from brink.server.problems.urban_injected import SIMULATOR as URBAN
from brink.worker.wire import Completed, JobFailed, LeasedJob

pytestmark = pytest.mark.usefixtures("few_trees")
API = "/api/v1/campaigns"
YAML = {"Content-Type": "application/yaml"}
SEARCH = ball(simulations=60)
PAIRS = ball(name="edge", simulations=60, algorithm={"id": "edge@1", "params": {"eps": 0.3, "d_th": 0.1}})


def finding(client: httpx.Client, campaign: str) -> dict[str, Any]:
    found: dict[str, Any] = expect(client.get(f"{API}/{campaign}/findings"))
    return found


def of_pairs(found: dict[str, Any]) -> dict[str, Any]:
    """Return what only pairs have."""
    view: dict[str, Any] = next(one["view"] for one in found["findings"] if one["kind"] == "pairs")
    return view


def rings(found: dict[str, Any], kind: str) -> list[list[int]]:
    """Return the solutions of each finding of a kind."""
    solutions: list[list[int]] = next(one["rings"] for one in found["findings"] if one["kind"] == kind)
    return solutions


def kinds(found: dict[str, Any]) -> list[str]:
    return [step["kind"] for step in found["steps"]]


def take(client: httpx.Client, step: dict[str, Any]) -> dict[str, Any]:
    """Take a step as the dashboard does."""
    answer = client.post(f"/api/v1/{step['request']['path']}", json=step["request"]["body"])
    taken: dict[str, Any] = expect(answer, 201)
    return taken


def test_a_search_for_the_boundary_says_how_many_solutions_it_found_and_asks_whether_they_hold(
    client: httpx.Client,
) -> None:
    campaign = finish(client, SEARCH)
    boundary = expect(client.get(f"{API}/{campaign}/boundary"))
    assert boundary["dbs"] > 0
    found = finding(client, campaign)
    assert found["words"].startswith(f"{boundary['dbs']} distinct boundary solution")
    assert found["words"].endswith(f"{boundary['strict_dbs']} of them strict.")
    assert (found["complete"], rings(found, "pairs")) == (True, [])
    repeat = found["steps"][0]
    assert (repeat["kind"], repeat["command"]) == ("repeat", f"brink repeats {campaign}")
    assert f"{50 * boundary['dbs']:,} simulations" in repeat["words"]

    again = take(client, repeat)
    waiting = finding(client, campaign)["steps"][0]
    assert (waiting["kind"], waiting["follow_up"]["campaign"]) == ("repeat", again["campaign"])
    FakeWorker(client).work(again["campaign"])
    assert "repeat" not in kinds(finding(client, campaign)), "it has been answered"

    follow_up = finding(client, again["campaign"])
    assert follow_up["of"] == {"campaign": campaign, "name": "ball", "kind": "confirm"}
    assert "simulations were unsafe" in follow_up["words"]
    assert follow_up["steps"] == []


def test_a_search_for_pairs_says_how_many_it_found_and_asks_what_has_not_been_asked(
    client: httpx.Client,
) -> None:
    campaign = finish(client, PAIRS)
    pairs = expect(client.get(f"{API}/{campaign}/pairs"))
    assert pairs["distinct"] > 1
    found = finding(client, campaign)
    assert found["words"].lower() == f"{pairs['note'].lower()}."
    assert pairs["distinct"] == len(rings(found, "pairs"))
    sides = [[pair["safe"]["number"], pair["unsafe"]["number"]] for pair in pairs["pairs"]]
    assert rings(found, "pairs") == sides
    assert [[one["safe"], one["unsafe"]] for one in of_pairs(found)["best"]] == sides[:3]
    assert of_pairs(found)["best"][0]["words"] == pairs["pairs"][0]["words"]
    assert "confirm" in kinds(found)
    assert "component" not in kinds(found), "the ball has no component"

    confirm = next(step for step in found["steps"] if step["kind"] == "confirm")
    assert confirm["command"] == f"brink pairs {campaign} --confirm 30"
    again = take(client, confirm)
    waiting = next(step for step in finding(client, campaign)["steps"] if step["kind"] == "confirm")
    assert waiting["follow_up"]["campaign"] == again["campaign"]
    FakeWorker(client).work(again["campaign"])
    later = finding(client, campaign)
    assert "confirm" not in kinds(later)
    assert "simulated again with other seeds" in later["words"]


def test_the_best_pairs_are_confirmed_ones_and_refuted_ones_come_last(client: httpx.Client) -> None:
    campaign = finish(client, PAIRS)
    pairs = expect(client.get(f"{API}/{campaign}/pairs"))["pairs"]
    assert len(pairs) > 2
    known = {tuple(one["evidence"].split(", ")) for one in of_pairs(finding(client, campaign))["best"]}
    assert known <= {("found once", "different seeds"), ("checked", "different seeds")}
    ask = {"kind": "confirm", "limit": 2}
    again = expect(client.post(f"{API}/{campaign}/pairs/follow-ups", json=ask), 201)["campaign"]
    assert [
        "confirmation pending" in one["evidence"] for one in of_pairs(finding(client, campaign))["best"]
    ] == [True, True, False]
    first = pairs[0]["unsafe"]["parameters"]

    def refuting(job: LeasedJob) -> Completed | JobFailed:
        """Let the unsafe side of the first pair be safe each time."""
        outcome = completes(job)
        assert isinstance(outcome, Completed)
        at = (job.spec["scenario"]["x"], job.spec["behaviour"]["y"])
        if at != (first["where"]["x"], first["what"]["y"]):
            return outcome
        held = outcome.verdicts[REQUIREMENT].model_copy(update={"robustness": 0.5})
        return outcome.model_copy(update={"verdicts": {REQUIREMENT: held}})

    FakeWorker(client, judge=refuting).work(again)
    found = finding(client, campaign)
    assert [one["place"] for one in of_pairs(found)["best"]] == [2, 3, 4]
    assert "confirmed 0/15 15/15" in of_pairs(found)["best"][0]["evidence"]
    assert "unsafe drive in 15 of 15." in of_pairs(found)["best"][0]["shares"]
    assert (of_pairs(found)["best"][1]["state"], of_pairs(found)["best"][1]["shares"]) == ("not tried", "")
    assert rings(found, "pairs")[0] == [pairs[0]["safe"]["number"], pairs[0]["unsafe"]["number"]], (
        "places stay"
    )
    assert "with an error rate of 5%" in of_pairs(found)["rule"]


def test_without_a_pair_the_next_step_is_a_larger_budget(client: httpx.Client) -> None:
    tight = {"id": "edge@1", "params": {"eps": 0.000001, "d_th": 0.1}}
    campaign = finish(client, ball(algorithm=tight, simulations=20))
    found = finding(client, campaign)
    assert rings(found, "pairs") == []
    assert [(step["kind"], step["place"]) for step in found["steps"]] == [
        ("longer", f"new?from={campaign}&simulations=80"),
        ("nearest", None),
    ]


def test_a_running_campaign_says_what_has_been_reported_so_far(client: httpx.Client) -> None:
    campaign = submit(client, ball(simulations=40))
    assert finding(client, campaign)["words"] == "No simulation has a verdict yet."
    worker = FakeWorker(client)
    worker.report(worker.lease(max_jobs=5))
    assert "of the first 5 drives" in finding(client, campaign)["words"]
    worker.work(campaign, until=lambda stands: stands["generation"] >= 1)
    found = finding(client, campaign)
    assert found["words"].startswith("So far, after 20 of 40 simulations: ")
    assert (found["complete"], found["steps"]) == (False, [])


@sqlite_then_postgres
def test_a_paused_campaign_can_be_resumed(client: httpx.Client) -> None:
    campaign = submit(client, ball())
    expect(client.post(f"{API}/{campaign}/pause"))
    (step,) = finding(client, campaign)["steps"]
    expect(client.post(f"/api/v1/{step['request']['path']}", json=step["request"]["body"]))
    assert expect(client.get(f"{API}/{campaign}"))["status"] == "running"


def test_once_everything_is_answered_the_next_steps_lead_on(client: httpx.Client) -> None:
    campaign = finish(client, PAIRS)
    assert "report" not in kinds(finding(client, campaign)), "the pairs have not been confirmed yet"
    again = expect(client.post(f"{API}/{campaign}/pairs/follow-ups", json={"kind": "confirm"}), 201)
    FakeWorker(client).work(again["campaign"])
    assert "report" not in kinds(finding(client, campaign)), "the pairs have not been sharpened yet"
    sharpened = expect(client.post(f"{API}/{campaign}/pairs/follow-ups", json={"kind": "sharpen"}), 201)
    FakeWorker(client).work(sharpened["campaign"])
    steps = {step["kind"]: step for step in finding(client, campaign)["steps"]}
    for step in ("minimise", "component", "sharpen"):
        assert step not in steps, "the differences of these pairs cannot be reverted"
    assert steps["report"]["command"] == f"brink report {campaign} --out report.html"
    assert steps["go on"]["place"] == f"new?start_from={campaign}"
    assert steps["monitor"]["command"] == f"brink monitor fit {campaign} --out monitor.json"
    assert not steps.keys() & {"any requirement", "tolerance"}, "the ball has no requirements and no detector"


def test_a_campaign_with_a_detector_leads_on_to_its_tolerances_and_to_other_requirements(
    client: httpx.Client,
) -> None:
    campaign = urban(client)
    steps = {step["kind"]: step for step in finding(client, campaign)["steps"]}
    assert steps["any requirement"]["place"] == f"new?from={campaign}&requirement=any"
    assert "go on" not in steps, "repeat@1 does not start from results"
    query = parse_qs(steps["tolerance"]["place"].partition("?")[2])
    body = json.loads(query["body"][0])
    checked = client.post("/api/v1/campaigns/check", content=json.dumps(body), headers=YAML)
    assert expect(checked)["problem"]["params"]["requirement"] == "front-gap@1"
    questions = [step["question"] for step in steps.values()]
    assert len(set(questions)) == len(questions)


def filmed(job: LeasedJob) -> Completed | JobFailed:
    """Return what `judged` does, with a trace if one was requested."""
    outcome = judged(job)
    if not job.record or not isinstance(outcome, Completed):
        return outcome
    return outcome.model_copy(update={"trace": base64.b64encode(make_trace().to_bytes()).decode()})


def urban(client: httpx.Client, unsafe: list[float] = UNSAFE) -> str:
    """Return a finished campaign with one pair, without traces."""
    body = {
        "name": "given",
        "problem": {"id": "urban-injected@1"},
        "seed": 4,
        "budget": {"simulations": 2},
        "algorithm": {"id": "repeat@1", "params": {"solutions": [SAFE, unsafe]}},
        "execution": {"keep_traces": 0},
    }
    campaign = submit(client, body)
    FakeWorker(client, capabilities=(URBAN,), judge=filmed).work(campaign)
    return campaign


@sqlite_then_postgres
def test_a_solution_and_its_pair_count_the_same_parameters(client: httpx.Client) -> None:
    campaign = urban(client, row(148, x_min_0_px=302.0, x_max_0_px=402.0))
    [pair] = expect(client.get(f"{API}/{campaign}/pairs"))["pairs"]
    opposite = expect(client.get(f"{API}/{campaign}/solutions/0/neighbours"))["opposite"]
    assert opposite["number"] == pair["unsafe"]["number"]
    assert opposite["differences"] == sum(len(change["names"]) for change in pair["changes"]) == 3


def picture(client: httpx.Client, campaign: str, side: str = "safe") -> httpx.Response:
    return client.get(f"{API}/{campaign}/pairs/0-1/{side}.png", params={"wait_s": 0})


def ask_for_picture(client: httpx.Client, campaign: str) -> httpx.Response:
    return client.post(f"{API}/{campaign}/pairs/0-1/safe.png")


def test_workers_record_what_the_pictures_of_a_pair_need_and_both_are_requested_at_once(
    client: httpx.Client,
) -> None:
    campaign = urban(client)
    assert picture(client, campaign).status_code == 204
    worker = FakeWorker(client, capabilities=(URBAN,), judge=filmed)
    assert worker.lease() == [], "nothing is recorded that was not asked for"
    assert ask_for_picture(client, campaign).status_code == 202
    jobs = [*worker.lease(), *worker.lease()]
    assert [job.record for job in jobs] == [True, True]
    worker.report(jobs)
    images = []
    for side in ("safe", "unsafe"):
        answer = picture(client, campaign, side)
        assert (answer.status_code, answer.headers["content-type"]) == (200, "image/png")
        images.append(Image.open(io.BytesIO(answer.content)))
    assert {image.size for image in images} == {(480, 228)}
    assert ask_for_picture(client, campaign).status_code == 204, "they are kept now"


@sqlite_then_postgres
def test_solutions_that_do_not_exist_have_no_picture(client: httpx.Client) -> None:
    campaign = urban(client)
    unknown = client.get(f"{API}/{campaign}/pairs/0-77/safe.png", params={"wait_s": 0})
    assert (unknown.status_code, unknown.content) == (204, b"")
    assert FakeWorker(client, capabilities=(URBAN,)).lease() == []


def test_a_simulator_without_traces_has_no_pictures(client: httpx.Client) -> None:
    campaign = finish(client, ball(simulations=20, execution={"keep_traces": 0}), completes)
    worker = FakeWorker(client)
    assert ask_for_picture(client, campaign).status_code == 202
    worker.report(worker.lease())
    assert picture(client, campaign).status_code == 204
    assert SIMULATOR in worker.capabilities


def fails_in_part(job: LeasedJob) -> Completed | JobFailed:
    """Return what the simulator of the ball would give, but fail in one run of seven."""
    return JobFailed(reason="error", message="no road") if job.spec["seed"] % 7 == 0 else completes(job)


def test_a_finding_names_the_failures_that_it_does_not_rest_on(client: httpx.Client) -> None:
    lenient = ball(**{**PAIRS, "execution": {"max_failed_share": 1.0, "max_attempts": 1}})
    campaign = submit(client, lenient)
    failed = FakeWorker(client, judge=fails_in_part).work(campaign)["failed"]
    assert failed > 0
    assert f"{failed} of 60 simulations failed" in finding(client, campaign)["words"]
    assert "failed" not in finding(client, finish(client, PAIRS))["words"]
