"""The pages of pairs: both drives of a pair on one clock, and follow-ups that are asked for from the list."""

import re

import pytest
from playwright.sync_api import Page
from playwright.sync_api import expect as shown
from support.api import eventually, progress, submit

from browser.canvas import changes, picture
from browser.served import ANY_PAIR, PATIENCE_S, URBAN, Served, a_pair
from browser.visits import Browse

pytestmark = pytest.mark.long("the dashboard beyond a walk through it")

NEAREST = "?eps=1&d_th=1"
"""Thresholds, in an address, at which a campaign has a single pair: its nearest opposite verdicts."""


@pytest.fixture
def pair(site: Served, browse: Browse) -> Page:
    """The page of a pair of the urban campaign, opened from the list, with both drives loaded."""
    found, _ = a_pair(site.client, site.urban)
    page = browse(f"#/campaigns/{site.urban}/pairs{ANY_PAIR}")
    page.get_by_role("link", name=f"pair {found['place']}", exact=True).click()
    shown(page.get_by_role("button", name="Play", exact=True)).to_be_visible(timeout=60_000)
    return page


def clock(page: Page) -> float:
    return float(page.locator("output.clock").inner_text().split(" / ")[0])


def test_the_page_of_a_pair_shows_the_change_both_sides_and_links_to_each(site: Served, pair: Page) -> None:
    found, _ = a_pair(site.client, site.urban)
    shown(pair.get_by_role("region", name="The change", exact=True)).to_contain_text(found["change"][1:])
    for side in ("safe", "unsafe"):
        card = pair.get_by_role("region", name=f"The {side} side", exact=True)
        shown(card).to_contain_text(found[side]["outcome"][1:])
        link = card.get_by_role("link", name=f"Solution {found[side]['number']}")
        shown(link).to_have_attribute("href", f"#/campaigns/{site.urban}/solutions/{found[side]['number']}")
    rows = pair.get_by_role("region", name="Table of differences").get_by_role("row")
    shown(rows).to_have_count(1 + len(found["changes"]))


def test_one_slider_moves_both_drives(pair: Page) -> None:
    maps = pair.locator(".drive canvas")
    shown(maps).to_have_count(2)
    slider = pair.get_by_label("Time in the episode")
    shown(slider).to_have_count(1)
    before = [picture(maps.nth(index)) for index in (0, 1)]
    slider.focus()
    slider.press("Home")
    shown(pair.locator("output.clock")).to_have_text(re.compile("^0.0 /"))
    for index in (0, 1):
        changes(maps.nth(index), before[index])
    pair.keyboard.press("ArrowRight")
    assert 0 < clock(pair) < 0.3


def test_a_pair_opens_at_the_violation_and_jumps_back_to_it(pair: Page) -> None:
    opened = clock(pair)
    jump = pair.get_by_role("button", name="the unsafe drive's violation")
    shown(jump).to_contain_text(f"{opened:.1f} s")
    unsafe = pair.locator("section[aria-label='The unsafe side'] h2")
    shown(unsafe).to_contain_text(f"at {opened:.1f} s")
    pair.get_by_label("Time in the episode").press("End")
    assert clock(pair) > opened
    jump.click()
    assert clock(pair) == pytest.approx(opened, abs=0.05)


def test_a_pair_is_followed_up_from_the_list_and_the_answer_appears_on_its_page(
    site: Served, browse: Browse
) -> None:
    # That which the site's worker has simulated already, under a name of its own
    campaign = submit(site.client, {**URBAN, "name": "asked"})
    eventually(
        lambda: progress(site.client, campaign)["status"] == "finished", "the campaign ends", PATIENCE_S
    )
    found, _ = a_pair(site.client, campaign, NEAREST)
    page = browse(f"#/campaigns/{campaign}/pairs{NEAREST}")
    shown(page.get_by_role("link", name="pair 1", exact=True)).to_be_visible()
    blame = page.get_by_role("group", name="Is the component to blame?")
    shown(blame.get_by_text(re.compile(r"^\d+ simulations?\.$"))).to_be_visible()
    blame.get_by_role("button", name="Simulate with ground truth").click()
    shown(blame.get_by_text("All unsafe sides have been simulated with ground truth.")).to_be_visible(
        timeout=60_000
    )
    shown(blame.get_by_role("button", name="Simulate with ground truth")).to_be_disabled()
    shown(blame.get_by_text("finished")).to_be_visible()
    after, _ = a_pair(site.client, campaign, NEAREST)
    row = page.get_by_role("row").filter(has=page.get_by_role("link", name="pair 1", exact=True))
    shown(row).to_contain_text(f"{after['component']['state']}'s hazard")
    page.get_by_role("link", name=f"pair {found['place']}", exact=True).click()
    told = page.get_by_role("region", name="The change", exact=True)
    for words in after["shown"]:
        shown(told).to_contain_text(words)
    link = told.get_by_role("link", name="Drive with ground truth")
    shown(link).to_have_attribute(
        "href", f"#/campaigns/{after['component']['campaign']}/solutions/{after['component']['number']}"
    )
