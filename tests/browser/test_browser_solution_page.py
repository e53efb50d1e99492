"""The page of one solution: its episode is re-run if its trace was not kept, played, scrubbed and saved."""

import base64
import json
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Locator, Page
from playwright.sync_api import expect as shown
from sqlalchemy import update
from support.api import FakeWorker, ball, completes, expect, submit
from support.traces import guarded, make_trace

from brink.server.db.engine import open_engines
from brink.server.db.models import WorkerRow
from brink.worker.wire import Completed, JobFailed, LeasedJob
from browser.canvas import becomes, changes, picture
from browser.console import Console
from browser.served import API, Served, loose, origin, unsafe_one
from browser.visits import Browse, Visits

pytestmark = pytest.mark.long("the dashboard beyond a walk through it")

TRACE, GUARDED = (
    base64.b64encode(trace.to_bytes()).decode() for trace in (make_trace(), guarded(make_trace()))
)


@pytest.fixture
def solution(site: Served, browse: Browse) -> Page:
    """The page of an unsafe boundary solution, opened from the table, with its replay loaded."""
    number = unsafe_one(site)["number"]
    page = browse(loose(site.urban, "results"))
    table = page.get_by_role("region", name="The boundary", exact=True)
    table.get_by_role("searchbox", name="Find").fill(str(number))
    table.get_by_role("link", name=str(number), exact=True).click()
    shown(page.get_by_role("heading", name=f"Solution {number}", exact=True)).to_be_visible()
    shown(page.get_by_role("button", name="Play", exact=True)).to_be_visible(timeout=60_000)
    return page


def above(page: Page) -> Locator:
    return page.get_by_role("img", name="The episode from above")


def clock(page: Page) -> float:
    return float(page.locator("output.clock").inner_text().split(" / ")[0])


def test_playing_replay_advances_and_changes_the_picture(solution: Page) -> None:
    sheet = above(solution)
    sheet.scroll_into_view_if_needed()
    first = picture(sheet)
    solution.get_by_role("button", name="4×").click()
    solution.get_by_role("button", name="Play", exact=True).click()
    shown(solution.locator("output.clock")).to_have_text(re.compile(r"^[1-9]"))
    solution.get_by_role("button", name="Pause", exact=True).click()
    assert clock(solution) >= 1
    assert int(solution.get_by_label("Time in the episode").input_value()) > 0
    changes(sheet, first)
    still, at = picture(sheet), clock(solution)
    solution.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    assert (picture(sheet), clock(solution)) == (still, at), "the replay is paused"


def test_scrubber_shows_the_same_picture_for_the_same_moment(solution: Page) -> None:
    sheet, scrubber = above(solution), solution.get_by_label("Time in the episode")
    first = picture(sheet)
    last = int(scrubber.get_attribute("max") or 0)
    scrubber.fill(str(last // 2))
    middle = changes(sheet, first)
    end = float(solution.locator("output.clock").inner_text().split(" / ")[1].removesuffix(" s"))
    assert clock(solution) == pytest.approx(end / 2, abs=0.2)
    scrubber.focus()
    solution.keyboard.press("End")
    shown(solution.locator("output.clock")).to_have_text(f"{end} / {end} s")
    changes(sheet, middle)
    scrubber.fill(str(last // 2))
    becomes(sheet, middle)


def test_page_shows_what_the_api_returns(site: Served, solution: Page) -> None:
    one = unsafe_one(site)
    shown(solution.locator(".head .badge")).to_have_text(one["outcome"])
    assert one["kind"] == "violated"
    shown(solution.get_by_role("region", name="Description")).to_contain_text(one["words"])
    with solution.expect_download() as download:
        solution.get_by_role("button", name="Specification, JSON").click()
    found = expect(site.client.get(f"{API}/campaigns/{site.urban}/solutions/{one['number']}"))
    assert json.loads(Path(download.value.path()).read_text(encoding="utf-8")) == found["spec"]
    solution.get_by_role("link", name="Open on the map").click()
    panel = solution.get_by_role("complementary", name="Selection on the map")
    shown(panel.get_by_role("heading", name=f"Solution {one['number']}")).to_be_visible()


def test_episode_without_a_capable_worker_is_made_when_one_appears(
    own: httpx.Client, own_database: str, visit: Visits, console: Console
) -> None:
    worker = FakeWorker(own, judge=with_trace)
    campaign = submit(own, ball(execution={"keep_traces": 0}))
    worker.work(campaign)
    _forget_workers(own_database)
    console.expect_status(503)
    page = visit(origin(own), f"#/campaigns/{campaign}/solutions/3")
    shown(page.get_by_text("no live worker can run faulty@1")).to_be_visible()
    another = FakeWorker(own, id="another", judge=with_trace)
    assert another.lease() == []
    page.get_by_role("button", name="Try again").click()
    another.report(another.lease(wait_s=20))
    shown(page.get_by_role("button", name="Play", exact=True)).to_be_visible()
    shown(page.locator("output.clock")).to_have_text("0.0 / 19.9 s")


def with_trace(job: LeasedJob) -> Completed | JobFailed:
    outcome = completes(job)
    return outcome.model_copy(update={"trace": TRACE}) if job.record else outcome


def _forget_workers(database: str) -> None:
    engines = open_engines(database)
    try:
        with engines.writer.begin() as connection:
            connection.execute(update(WorkerRow).values(last_seen_at=datetime(2020, 1, 1, tzinfo=UTC)))
    finally:
        engines.dispose()


def violating(site: Served, campaign: str, avoidable: str) -> dict[str, Any]:
    """Return the first solution of a campaign whose violations are all avoidable by somebody, or by nobody."""
    told = expect(site.client.get(f"{API}/campaigns/{campaign}/violations"))["violations"]
    number = next(
        number
        for number in sorted({one["number"] for one in told})
        if {one["avoidable"] for one in told if one["number"] == number} == {avoidable}
    )
    found: dict[str, Any] = expect(site.client.get(f"{API}/campaigns/{campaign}/solutions/{number}"))
    return found


def test_a_careful_drivers_drive_is_beside_that_which_it_would_have_avoided(
    site: Served, traffic: str, browse: Browse
) -> None:
    one = violating(site, traffic, "careful")
    page = browse(f"#/campaigns/{traffic}/solutions/{one['number']}")
    card = page.get_by_role("region", name="Replay")
    shown(card).to_contain_text(re.compile("The system .*A careful driver "), timeout=60_000)
    shown(card.get_by_role("list", name="Who would have avoided")).to_contain_text(
        "avoidable by a careful driver"
    )
    shown(page.get_by_role("region", name="Verdicts", exact=True)).to_contain_text(
        "avoidable by a careful driver"
    )
    maps = card.locator(".drive canvas")
    shown(maps).to_have_count(2)
    shown(card.locator(".drive .badge")).to_have_text(["system", "careful driver"])
    moments = [violated["time_s"] for violated in one["violated"]]
    assert min(abs(clock(page) - at_s) for at_s in moments) < 0.11, "it opens at the violation"
    before = [picture(maps.nth(index)) for index in (0, 1)]
    card.get_by_label("Time in the episode").press("Home")
    for index in (0, 1):
        changes(maps.nth(index), before[index])
    page.get_by_role("region", name="Events in chronological order").get_by_role("button").last.click()
    assert clock(page) > 0, "both drives go where the system's events lead"


LABELS = """async () => {
  const { labelPlaces } = await import(new URL("dashboard/js/views/solution/drawing.js", document.baseURI));
  let state = 1;
  const random = (most) => (state = (state * 48271) % 2147483647) / 2147483647 * most;
  const [width, height] = [300, 160];
  return Array.from({ length: 200 }, () => {
    const labels = Array.from({ length: 12 }, (_, index) => ({
      words: "person".repeat(1 + index % 3), box: [random(400) - 50, random(260) - 50, random(60), random(60)],
    }));
    return { labels, placed: labelPlaces(labels, width, height, (words) => 7 * words.length) };
  });
}"""


def test_labels_stay_inside_the_picture_and_clear_of_each_other(browse: Browse) -> None:
    pictures = browse().evaluate(LABELS)
    for drawn in pictures:
        placed = drawn["placed"]
        for index, one in enumerate(placed):
            assert one["left"] >= 0
            assert one["left"] + one["wide"] <= 300
            assert 15 <= one["bottom"] <= 160
            for other in placed[:index]:
                beside = (
                    one["left"] >= other["left"] + other["wide"] or other["left"] >= one["left"] + one["wide"]
                )
                assert beside or abs(one["bottom"] - other["bottom"]) >= 15
        if any(_is_inside(*label["box"]) for label in drawn["labels"]):
            assert placed, "there is room for a label"
    assert sum(len(drawn["placed"]) for drawn in pictures) > 4 * len(pictures)


def _is_inside(left: float, top: float, wide: float, high: float) -> bool:
    return left >= 0 and top >= 0 and left + wide <= 300 and top + high <= 160
