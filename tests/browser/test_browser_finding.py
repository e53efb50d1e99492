"""Finding one's way: campaigns by name and state, an experiment's results, campaigns side by side."""

import re

import pytest
from playwright.sync_api import expect as shown
from support.api import ball, expect, submit

from browser.served import API, NOBODYS, Served
from browser.visits import Browse

pytestmark = pytest.mark.long("the dashboard beyond a walk through it")


def test_campaigns_are_found_by_name_and_state_and_steered_from_the_list(
    site: Served, browse: Browse
) -> None:
    submit(site.client, ball(name="needle one", problem=NOBODYS))
    submit(site.client, ball(name="needle two", problem=NOBODYS))
    page = browse()
    rows = page.locator("table.campaigns tbody tr")
    shown(rows.filter(has_text="night rain")).to_be_visible()
    page.get_by_label("Find").fill("needle")
    shown(rows).to_have_count(2)
    page.get_by_role("button", name="Pause needle one").click()
    shown(rows.filter(has_text="needle one").locator(".badge")).to_have_text("paused")
    page.get_by_label("Status").select_option("paused")
    shown(rows).to_have_count(1)
    page.reload()
    shown(rows).to_have_count(1)
    shown(page.get_by_label("Find")).to_have_value("needle")
    page.get_by_label("Find").fill("haystack")
    shown(page.get_by_text("No campaign matches.")).to_be_visible()


def test_an_experiment_shows_its_results_and_its_campaigns(site: Served, browse: Browse) -> None:
    page = browse("#/experiments")
    page.get_by_role("link", name="two on a ball").click()
    shown(page.locator(".head .badge")).to_have_text("finished")
    shown(page.get_by_role("region", name="Progress")).to_contain_text("4 of 4")
    shown(page.get_by_role("rowheader", name="random@1").first).to_be_visible()
    page.get_by_role("link", name="Show campaigns").click()
    shown(page.locator("table.campaigns tbody tr")).to_have_count(4)


def test_campaigns_that_are_ticked_stand_side_by_side(site: Served, browse: Browse) -> None:
    page = browse(f"#/compare?ids={site.urban}")
    shown(page.get_by_text("Choose one more campaign.")).to_be_visible()
    page.get_by_role("checkbox", name=re.compile("^ball ")).check()
    shown(page.get_by_role("heading", name="Side by side")).to_be_visible()
    page.reload()
    chosen = page.get_by_role("list", name="Compared campaigns").get_by_role("listitem")
    shown(chosen).to_have_text(["night rain×", "ball×"])
    shown(page.get_by_role("heading", name="Settings that differ")).to_be_visible()
    found = page.get_by_role("row").filter(
        has=page.get_by_role("rowheader", name="Distinct boundary solutions")
    )
    for cell, campaign in zip(found.get_by_role("cell").all(), (site.urban, site.ball), strict=True):
        told = expect(site.client.get(f"{API}/campaigns/{campaign}/findings"))["findings"][0]
        shown(cell).to_have_text(told["figures"][0]["term"])
    chosen.filter(has_text="night rain").get_by_role("button").click()
    shown(chosen).to_have_count(1)
