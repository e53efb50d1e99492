"""What a campaign page says first: the finding, the best pairs, what to do next; and results as they come in."""

import base64
import re
import shutil
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Locator
from playwright.sync_api import expect as shown
from support.api import FakeWorker, ball, coordinator, eventually, expect, finish, submit
from support.problems import small_problems
from support.traces import make_trace
from support.urban_pairs import SAFE, UNSAFE, judged

from brink.server.problems.urban_injected import SIMULATOR as URBAN
from brink.worker.wire import Completed, JobFailed, LeasedJob
from browser.console import Console
from browser.served import API, NOBODYS, origin
from browser.visits import Visits

pytestmark = pytest.mark.long("the dashboard beyond a walk through it")

PHONE_WIDTH, PHONE_HEIGHT = 390, 844
PAIRS = ball(name="edge", algorithm={"id": "edge@1", "params": {"eps": 0.3, "d_th": 0.1}})
BESIDE_CARDS = """() => [...document.querySelectorAll("main section.card")]
  .filter(card => card.checkVisibility()).map(card => card.getAttribute("aria-label"))"""


@pytest.fixture(scope="module")
def searched(sqlite_file: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A database with a finished search for pairs on the ball, to be copied, and the campaign's id."""
    file = Path(shutil.copy(sqlite_file, tmp_path_factory.mktemp("searched") / "brink.db"))
    with small_problems(), coordinator(f"sqlite:///{file}") as client:
        return file, finish(client, PAIRS)


@pytest.fixture
def edge(own: httpx.Client, searched: tuple[Path, str]) -> str:
    """A finished search for pairs on the ball, in the test's own coordinator, which has heard of a worker."""
    FakeWorker(own).lease()
    return searched[1]


def finding_of(client: httpx.Client, campaign: str) -> dict[str, Any]:
    found: dict[str, Any] = expect(client.get(f"{API}/campaigns/{campaign}/finding"))
    return found


def test_the_finding_comes_first_then_what_to_do_then_the_map_and_delete_last(
    own: httpx.Client, edge: str, visit: Visits
) -> None:
    page = visit(origin(own), f"#/campaigns/{edge}")
    found = finding_of(own, edge)
    shown(page.get_by_role("region", name="Finding")).to_contain_text(found["words"])
    for card in ("What to do next", "Map", "Pairs across the boundary", "Parameter dependence"):
        shown(page.get_by_role("region", name=card, exact=True)).to_be_visible()
    cards = page.evaluate(BESIDE_CARDS)
    assert cards[:4] == ["Finding", "What to do next", "Map", "Pairs across the boundary"]
    assert cards[-2:] == ["Settings", "About the run"]
    shown(page.get_by_role("region", name="Finding")).not_to_contain_text("SHA-256")
    page.get_by_role("region", name="About the run").locator("summary").click()
    shown(page.get_by_text("SHA-256 of the archive")).to_be_visible()
    shown(page.get_by_role("button").last).to_have_text("Delete")
    assert (
        page.get_by_role("button", name="Delete").evaluate("node => getComputedStyle(node).borderWidth")
        == "0px"
    )


def test_a_step_is_taken_by_its_button_and_followed_until_it_is_answered(
    own: httpx.Client, edge: str, visit: Visits
) -> None:
    page = visit(origin(own), f"#/campaigns/{edge}")
    steps = page.get_by_role("region", name="What to do next").get_by_role("listitem")
    confirm = steps.filter(has_text="Do the pairs hold?")
    shown(confirm.get_by_text(f"brink pairs {edge} --confirm 30 --server {origin(own)}")).to_be_visible()
    confirm.get_by_role("button", name="Confirm the pairs").click()
    shown(confirm.get_by_role("progressbar")).to_be_visible()
    shown(confirm.get_by_role("button")).to_have_count(0)
    (asked,) = expect(own.get(f"{API}/campaigns/{edge}/pairs"))["follow_ups"]
    shown(confirm.get_by_role("link", name="Campaign")).to_have_attribute(
        "href", f"#/campaigns/{asked['campaign']}"
    )
    FakeWorker(own).work(asked["campaign"])
    shown(confirm).to_have_count(0, timeout=20_000)
    shown(page.get_by_role("region", name="Finding")).to_contain_text("simulated again with other seeds")


def test_once_everything_is_answered_a_next_step_opens_the_form_for_another_campaign(
    own: httpx.Client, visit: Visits
) -> None:
    body = {
        "name": "answered",
        "problem": {"id": "urban-injected@1"},
        "budget": {"simulations": 2},
        "algorithm": {"id": "repeat@1", "params": {"solutions": [SAFE, UNSAFE]}},
        "execution": {"keep_traces": 0},
    }
    campaign = submit(own, body)
    FakeWorker(own, capabilities=(URBAN,), judge=judged).work(campaign)
    page = visit(origin(own), f"#/campaigns/{campaign}")
    steps = page.get_by_role("region", name="What to do next").get_by_role("listitem")
    shown(
        steps.get_by_text(f"brink report {campaign} --out report.html --server {origin(own)}")
    ).to_be_visible()
    shown(steps.get_by_role("link", name="Search for any violation")).to_be_visible()
    steps.get_by_role("link", name="Search for tolerances").click()
    shown(page.get_by_label("Problem", exact=True)).to_have_value("urban-errors@1")
    shown(page.get_by_label("Algorithm", exact=True)).to_have_value("tolerance@1")
    shown(page.get_by_label("Cells", exact=True)).to_have_value(re.compile('"short_range"'))
    page.get_by_role("button", name="Check only").click()
    shown(page.get_by_text("answered: tolerances is valid")).to_be_visible()


def filmed(job: LeasedJob) -> Completed | JobFailed:
    outcome = judged(job)
    if not job.record or not isinstance(outcome, Completed):
        return outcome
    return outcome.model_copy(update={"trace": base64.b64encode(make_trace().to_bytes()).decode()})


def test_the_best_pairs_are_shown_as_pictures_once_a_worker_has_run_them_again(
    own: httpx.Client, visit: Visits, console: Console
) -> None:
    console.expect_status(503)
    body = {
        "name": "pictured",
        "problem": {"id": "urban-injected@1"},
        "budget": {"simulations": 2},
        "algorithm": {"id": "repeat@1", "params": {"solutions": [SAFE, UNSAFE]}},
        "execution": {"keep_traces": 0},
    }
    campaign = submit(own, body)
    worker = FakeWorker(own, capabilities=(URBAN,), judge=filmed)
    worker.work(campaign)
    page = visit(origin(own), f"#/campaigns/{campaign}")
    shown(page.get_by_role("region", name="Map")).to_be_visible()
    best = page.get_by_role("region", name="Best pairs")
    shown(best).to_be_hidden()
    own.post(f"{API}/workers/{worker.id}/drain")
    page.reload()
    shown(best).to_contain_text("a worker must simulate them again")
    shown(best.locator("code")).to_have_text(f"brink worker --server {origin(own)}")
    worker = FakeWorker(own, id="second", capabilities=(URBAN,), judge=filmed)
    recorded = 0

    def record() -> bool:
        nonlocal recorded
        jobs = worker.lease()
        worker.report(jobs)
        recorded += len(jobs)
        return recorded == 2

    eventually(record, "the page asks for both drives")
    shown(best.get_by_role("link", name="Pair 1")).to_have_attribute(
        "href", f"#/campaigns/{campaign}/pairs/0-1"
    )
    shown(best).to_contain_text("violated the front gap")
    for side in ("safe", "unsafe"):
        drive = best.get_by_role("img", name=f"The {side} drive of pair 1 from above")
        shown(drive).to_be_visible()
        assert colours(drive) > 5
    shown(best).to_contain_text("A pair holds if, with other seeds")
    evidence = best.locator("figcaption .badge")
    shown(evidence).to_have_text("not simulated again yet")
    asked = expect(own.post(f"{API}/campaigns/{campaign}/pairs/follow-ups", json={"kind": "confirm"}), 201)
    worker.work(asked["campaign"])
    page.reload()
    shown(evidence).to_have_text("confirmed: unsafe in 0/15 and 15/15 drives with other seeds")
    shown(evidence).to_have_attribute("title", re.compile("unsafe drive in 15 of 15\\.$"))
    again = page.get_by_role("region", name="Repeats")
    shown(again).to_contain_text("By solution: 1 always unsafe, 1 always safe, 0 with both verdicts.")
    shown(again).not_to_contain_text("p_th")


def colours(canvas: Locator) -> int:
    """Return how many colours a canvas shows."""
    found: int = canvas.evaluate(
        "canvas => new Set(new Uint32Array("
        "canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data.buffer)).size"
    )
    return found


def test_results_appear_as_they_are_reported_and_no_card_before_it_has_something_to_show(
    own: httpx.Client, visit: Visits
) -> None:
    campaign = submit(own, ball(simulations=40))
    page = visit(origin(own), f"#/campaigns/{campaign}")
    about = page.get_by_role("region", name="Finding")
    shown(about).to_contain_text("No simulation has a verdict yet.")
    assert page.evaluate(BESIDE_CARDS) == ["Finding", "Settings", "About the run"]
    worker = FakeWorker(own)
    worker.report(worker.lease(max_jobs=5))
    shown(about).to_contain_text("5 of 40", timeout=20_000)
    shown(about).to_contain_text("of the first 5 drives")
    points = page.locator("canvas.map")
    shown(points).to_have_attribute("data-points", "5")
    shown(page.get_by_role("list", name="Colours")).to_contain_text("5 just reported, not scored yet")
    reported = expect(own.get(f"{API}/campaigns/{campaign}/map"))["reported"]
    unsafe = sum(reported["unsafe"])
    facts = about.get_by_role("definition")
    shown(facts.filter(has_text=f"{unsafe} (")).to_be_visible()
    worker.report(worker.lease(max_jobs=5))
    shown(points).to_have_attribute("data-points", "10", timeout=20_000)


def test_what_nobody_can_simulate_shows_no_empty_map(own: httpx.Client, visit: Visits) -> None:
    campaign = submit(own, ball(name="idle", problem=NOBODYS))
    page = visit(origin(own), f"#/campaigns/{campaign}")
    shown(page.get_by_text("a worker with the plug-in that provides nobody-has-it@1")).to_be_visible()
    shown(page.get_by_role("region", name="Map")).to_be_hidden()
    shown(page.get_by_role("region", name="Pairs across the boundary")).to_be_hidden()
