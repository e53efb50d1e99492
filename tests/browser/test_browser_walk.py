"""A walk through the dashboard: a campaign is submitted by the form, runs, and is seen to finish."""

from playwright.sync_api import expect as shown

from browser.served import Served
from browser.test_browser_submitting import fill
from browser.visits import Browse


def test_a_campaign_that_is_submitted_by_the_form_is_seen_to_finish(site: Served, browse: Browse) -> None:
    page = browse()
    page.get_by_role("link", name="New campaign").click()
    fill(page, "by the form", 24)
    page.get_by_role("button", name="Submit campaign").click()
    shown(page.get_by_role("heading", name="by the form")).to_be_visible()
    shown(page.locator(".head .badge")).to_have_text("finished")
    figures = page.get_by_role("region", name="Finding")
    shown(figures).to_contain_text("24 of 24")
    shown(figures.get_by_role("progressbar")).to_be_hidden()
    shown(page.get_by_text("24 solutions.")).to_be_visible()
