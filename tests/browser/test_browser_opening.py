"""What a campaign page says first: the finding, what to do next; and results as they come in."""

import shutil
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import expect as shown
from support.api import FakeWorker, ball, coordinator, eventually, expect, finish, progress, submit
from support.problems import small_problems

from browser.served import API, NOBODYS, PATIENCE_S, Served, origin
from browser.visits import Visits

pytestmark = pytest.mark.long("the dashboard beyond a walk through it")

PHONE_WIDTH, PHONE_HEIGHT = 390, 844
DRIVES: dict[str, Any] = {
    "name": "pairs of drives",
    "problem": {"id": "urban-injected@1", "params": {"duration_s": 12.0}},
    "algorithm": {"id": "edge@1", "params": {"eps": 1.0, "d_th": 0.1}},
    "budget": {"simulations": 24},
    "seed": 8,
}
"""A search whose pairs can be drawn; with such thresholds a few drives have enough of them."""

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
def own_database(request: pytest.FixtureRequest, sqlite_file: Path, tmp_path: Path) -> str:
    """The URL of a database of the test's own, with a finished search for pairs if the test uses `edge`."""
    made = request.getfixturevalue("searched")[0] if "edge" in request.fixturenames else sqlite_file
    return f"sqlite:///{shutil.copyfile(made, tmp_path / 'own.db')}"


@pytest.fixture
def edge(own: httpx.Client, searched: tuple[Path, str]) -> str:
    """A finished search for pairs on the ball, in the test's own coordinator, which has heard of a worker."""
    FakeWorker(own).lease()
    return searched[1]


SHIFTS = """() => new PerformanceObserver((list) => {
  for (const one of list.getEntries()) window.shifted = (window.shifted ?? 0) + one.value;
}).observe({ type: "layout-shift", buffered: true })"""
BOTTOM = """() => Math.max(...[...document.querySelectorAll("main section.card")]
  .map((card) => card.getBoundingClientRect().bottom + scrollY))"""


@pytest.fixture(scope="module")
def drives(site: Served) -> str:
    """A finished search for pairs of drives."""
    campaign = submit(site.client, DRIVES)
    eventually(lambda: progress(site.client, campaign)["status"] == "finished", "the search ends", PATIENCE_S)
    return campaign


@pytest.mark.parametrize(("width", "height", "screens"), [(1280, 900, 1), (PHONE_WIDTH, PHONE_HEIGHT, 2)])
def test_finding_pictures_and_next_steps_fit_and_stay_where_they_are(
    site: Served, drives: str, visit: Visits, width: int, height: int, screens: int
) -> None:
    page = visit(site.url, f"#/campaigns/{drives}", width=width, height=height)
    page.evaluate(SHIFTS)
    shown(page.locator(".best-pairs figure .sides.drawn")).to_have_count(3, timeout=PATIENCE_S * 1000)
    shown(page.get_by_role("region", name="What to do next")).to_contain_text("Do the pairs hold?")
    assert page.evaluate(BOTTOM) <= screens * height
    assert page.evaluate("() => window.shifted ?? 0") < 0.01


def finding_of(client: httpx.Client, campaign: str) -> dict[str, Any]:
    found: dict[str, Any] = expect(client.get(f"{API}/campaigns/{campaign}/findings"))
    return found


def test_the_overview_has_the_finding_and_what_to_do_and_each_tab_its_cards(
    own: httpx.Client, edge: str, visit: Visits
) -> None:
    page = visit(origin(own), f"#/campaigns/{edge}")
    found = finding_of(own, edge)
    shown(page.get_by_role("region", name="Finding")).to_contain_text(found["words"])
    assert page.evaluate(BESIDE_CARDS) == ["Finding", "Best pairs", "What to do next"]
    for tab, card in (
        ("Map", "Map"),
        ("Results", "Pairs"),
        ("Parameters", "Parameter dependence"),
        ("Search", "About the run"),
    ):
        page.get_by_role("tab", name=tab).click()
        shown(page.get_by_role("region", name=card, exact=True)).to_be_visible()
        shown(page.get_by_role("region", name="Finding")).to_be_hidden()
    page.get_by_role("region", name="About the run").locator("summary").click()
    shown(page.get_by_text("SHA-256 of the archive")).to_be_visible()
    page.get_by_role("tab", name="Settings").click()
    page.reload()
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
    confirm.get_by_text("Command").click()
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


def test_results_appear_as_they_are_reported_and_no_card_before_it_has_something_to_show(
    own: httpx.Client, visit: Visits
) -> None:
    campaign = submit(own, ball(simulations=40))
    page = visit(origin(own), f"#/campaigns/{campaign}")
    about = page.get_by_role("region", name="Finding")
    shown(about).to_contain_text("No simulation has a verdict yet.")
    assert page.evaluate(BESIDE_CARDS) == ["Finding"]
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
    shown(page.get_by_role("region", name="Pairs")).to_be_hidden()
