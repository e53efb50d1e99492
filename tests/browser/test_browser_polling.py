"""A page that is left open: it follows what goes on, asks for nothing while hidden, and gets over an absence."""

from functools import partial

import httpx
import pytest
from playwright.sync_api import Page, Route
from playwright.sync_api import expect as shown
from support.api import FakeWorker, ball, listening_coordinator, submit

from browser.console import Console
from browser.served import Served, origin
from browser.visits import Visits

pytestmark = pytest.mark.long("the dashboard beyond a walk through it")

HIDE = """hidden => {
  Object.defineProperty(document, "hidden", { configurable: true, get: () => hidden });
  document.dispatchEvent(new Event("visibilitychange"));
}"""
IDLE_MS = 10_000
"""How often a page looks where nothing goes on."""


def asked(page: Page) -> list[str]:
    """Return a list to which every request of the API is added from now on."""
    told: list[str] = []
    page.on("request", lambda request: told.append(request.url) if "/api/v1/" in request.url else None)
    return told


def test_a_hidden_page_stops_polling_and_refreshes_when_shown(site: Served, visit: Visits) -> None:
    page = visit(site.url, stopped=True)
    shown(page.get_by_role("link", name="night rain", exact=True)).to_be_visible()
    with page.expect_response("**/api/v1/overview*"):
        page.clock.run_for(IDLE_MS)
    page.evaluate(HIDE, True)
    page.clock.run_for(IDLE_MS)
    told = asked(page)
    page.clock.run_for(60 * IDLE_MS)
    page.evaluate("() => fetch('dashboard/icon.svg')")
    assert told == []
    with page.expect_response("**/api/v1/overview*"):
        page.evaluate(HIDE, False)


def test_what_did_not_change_is_answered_without_a_body(own: httpx.Client, visit: Visits) -> None:
    campaign = submit(own, ball())  # where no worker of another test comes and goes
    FakeWorker(own).work(campaign)
    page = visit(origin(own), f"#/campaigns/{campaign}", stopped=True)
    # Only the first answer to a poll fills this in; the status is known before it.
    shown(page.get_by_role("region", name="Finding")).to_contain_text("of 60")
    statuses = []
    for _ in range(3):
        with page.expect_response("**/progress*") as coming:
            page.clock.run_for(IDLE_MS)
        statuses.append(coming.value.status)
    assert statuses == [200, 304, 304], "once what is new since the generations that are known, then nothing"


def keep_away(status: int, detail: str, route: Route) -> None:
    route.fulfill(status=status, json={"detail": detail})


def test_what_keeps_answers_away_is_said_until_they_come(
    site: Served, visit: Visits, console: Console
) -> None:
    page = visit(site.url, stopped=True)
    shown(page.get_by_role("link", name="night rain", exact=True)).to_be_visible()
    for status, detail, words in (
        (429, "too many requests", "Rate limit exceeded."),
        (503, "the database did not answer", "The database did not answer."),
    ):
        console.expect_status(status)
        page.route("**/overview*", partial(keep_away, status, detail))
        page.clock.run_for(IDLE_MS)
        notice = page.get_by_text(f"{words} Retrying; the page keeps what it shows.")
        shown(notice).to_be_visible()
        shown(page.get_by_role("link", name="night rain", exact=True)).to_be_visible()
        page.unroute("**/overview*")
        page.clock.run_for(IDLE_MS)
        shown(notice).to_be_hidden()


def test_a_page_reports_and_survives_a_lost_coordinator(
    own_database: str, small_problems: None, visit: Visits, console: Console
) -> None:
    with listening_coordinator(own_database) as client:
        campaign = submit(client, ball(name="interrupted"))
        FakeWorker(client).report(FakeWorker(client).lease(5))
        page = visit(origin(client), f"#/campaigns/{campaign}")
        figures = page.get_by_role("region", name="Finding")
        shown(figures).to_contain_text("5 of 60")
        console.expect_lost_connections()
        port = client.base_url.port
    notice = page.get_by_text("The coordinator does not respond.")
    shown(notice).to_be_visible()
    shown(figures).to_contain_text("5 of 60")

    with listening_coordinator(own_database, port=port) as client:
        shown(notice).to_be_hidden()
        FakeWorker(client).report(FakeWorker(client).lease(4))
        shown(figures).to_contain_text("9 of 60")
        page.close()
