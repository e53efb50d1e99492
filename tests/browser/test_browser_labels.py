"""Tags and notes, edited in place; follow-ups, folded below their campaign."""

import re
from typing import Any

import httpx
import pytest
from playwright.sync_api import Page
from playwright.sync_api import expect as shown
from support.api import FakeWorker, ball, expect, finish, submit

from browser.served import API, NOBODYS, origin
from browser.test_browser_accessibility import RULES, faults
from browser.visits import Visits

pytestmark = pytest.mark.long("the dashboard beyond a walk through it")

LONGEST_TAG = "x" * 40


@pytest.fixture
def three(own: httpx.Client) -> dict[str, str]:
    """Campaigns by name: two with tags and notes, one without."""
    bodies: list[dict[str, Any]] = [
        ball(name="alpha", problem=NOBODYS, tags=["night", "rain"], notes="Too dark at dusk.\nAsk again."),
        ball(name="beta", problem=NOBODYS, tags=["night", LONGEST_TAG], seed=2),
        ball(name="gamma", problem=NOBODYS, seed=3),
    ]
    return {body["name"]: submit(own, body) for body in bodies}


def rows(page: Page) -> list[str]:
    return page.locator("table.campaigns tbody a.row").all_inner_texts()


def labels_of(client: httpx.Client, campaign: str) -> tuple[list[str], str]:
    read = expect(client.get(f"{API}/campaigns/{campaign}"))
    return read["tags"], read["notes"]


def test_tags_and_notes_are_edited_in_place_by_keyboard(
    own: httpx.Client, three: dict[str, str], visit: Visits
) -> None:
    page = visit(origin(own), f"#/campaigns/{three['alpha']}")
    labels = page.get_by_role("region", name="Tags and notes")
    shown(labels).to_contain_text("Too dark at dusk.")
    labels.get_by_role("button", name="Edit tags and notes").press("Enter")
    shown(labels.get_by_role("textbox", name="Tags")).to_be_focused()
    shown(labels.get_by_role("textbox", name="Tags")).to_have_value("night rain")
    labels.get_by_role("textbox", name="Tags").fill("Rain  release-4, fog")
    labels.get_by_role("textbox", name="Notes").fill("Detector of release 4.")
    expect(own.patch(f"{API}/campaigns/{three['alpha']}", json={"add_tags": ["meanwhile"]}))
    labels.get_by_role("button", name="Save").press("Enter")
    shown(labels.get_by_role("listitem")).to_have_text(["fog", "meanwhile", "rain", "release-4"])
    shown(labels).to_contain_text("Detector of release 4.")
    shown(labels.get_by_role("button", name="Edit tags and notes")).to_be_focused()
    assert labels_of(own, three["alpha"])[1] == "Detector of release 4."

    labels.get_by_role("button", name="Edit tags and notes").click()
    labels.get_by_role("textbox", name="Notes").fill("never mind")
    page.keyboard.press("Escape")
    shown(labels.get_by_role("textbox", name="Notes")).to_have_count(0)
    assert labels_of(own, three["alpha"])[1] == "Detector of release 4."
    labels.get_by_role("link", name="fog").click()
    shown(page.get_by_role("link", name="alpha")).to_be_visible()
    assert (rows(page), page.url.rpartition("#")[2]) == (["alpha"], "/campaigns?tag=fog")


def test_follow_ups_are_folded_below_their_campaign(own: httpx.Client, visit: Visits) -> None:
    campaign = finish(own, ball(name="searched"))
    numbers = [one["number"] for one in expect(own.get(f"{API}/campaigns/{campaign}/solutions"))["solutions"]]
    once, twice = (
        expect(own.post(f"{API}/campaigns/{campaign}/repeats", json={"numbers": [number]}), 201)["campaign"]
        for number in numbers[:2]
    )
    page = visit(origin(own))
    fold = page.get_by_role("button", name="2 follow-ups, 2 under way")
    shown(fold).to_have_attribute("aria-expanded", "false")
    assert rows(page) == ["searched"]
    fold.press("Enter")
    nested = page.locator("table.campaigns tbody tr.nested")
    shown(nested).to_have_count(2)
    shown(fold).to_be_focused()
    links = page.locator("table.campaigns tbody a.row")
    assert [link.get_attribute("href") for link in links.all()] == [
        f"#/campaigns/{one}" for one in (campaign, once, twice)
    ]
    page.reload()
    shown(nested).to_have_count(2)
    assert faults(page, RULES["light"]) == []
    page.get_by_label("Status").select_option("running")
    shown(links).to_have_count(2)
    shown(nested).to_have_count(0)
    page.get_by_label("Status").select_option("")
    FakeWorker(own).work(once)
    FakeWorker(own).work(twice)
    page.get_by_role("button", name=re.compile("^−2 follow-ups$")).click()
    shown(nested).to_have_count(0)
