"""Wide and narrow, light and dark."""

import io
import re

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Locator, Page
from playwright.sync_api import expect as shown

from browser.served import Served, unsafe_one
from browser.views import View, open_view
from browser.visits import Browse, Visits

PHONE_PX = 390
OVERHANGING = """width => [...document.querySelectorAll("body *")]
  .filter(node => node.getBoundingClientRect().right > width && !node.closest(".scroll, nav"))
  .map(node => `${node.tagName}.${node.className}`).slice(0, 5)"""


def test_no_view_scrolls_sideways_on_a_phone(site: Served, views: list[View], browse: Browse) -> None:
    page = browse()
    page.set_viewport_size({"width": PHONE_PX, "height": 844})
    found = {}
    for view in views:
        open_view(page, site.url, view)
        if page.evaluate("document.scrollingElement.scrollWidth") > PHONE_PX:
            found[view.name] = page.evaluate(OVERHANGING, PHONE_PX)
    assert not found


def right_edge(region: Locator) -> float:
    """Return how bright the last column of pixels is, in the middle of its range."""
    with Image.open(io.BytesIO(region.screenshot())) as picture:
        return float(np.median(np.asarray(picture.convert("L"))[:, -1]))


def test_a_table_whose_columns_are_cut_off_has_a_shadow_there(site: Served, visit: Visits) -> None:
    page = visit(site.url, f"#/campaigns/{site.ball}", theme="light")
    table = page.get_by_role("region", name="Table of boundary solutions")
    shown(table).to_be_visible()
    whole = right_edge(table)
    page.set_viewport_size({"width": PHONE_PX, "height": 844})
    cut = right_edge(table)
    table.evaluate("region => { region.scrollLeft = region.scrollWidth; }")
    assert (whole - cut > 30, right_edge(table)) == (True, whole)


def ground(page: Page) -> str:
    found: str = page.evaluate("getComputedStyle(document.documentElement).backgroundColor")
    return found


def test_the_theme_that_was_chosen_is_remembered(site: Served, visit: Visits) -> None:
    page = visit(site.url, theme="light")
    button = page.get_by_role("button", name=re.compile("^Theme: "))
    shown(button).to_have_text("Theme: system")
    light = ground(page)
    button.click()
    shown(button).to_have_text("Theme: light")
    assert ground(page) == light
    button.click()
    shown(button).to_have_text("Theme: dark")
    dark = ground(page)
    assert dark != light
    page.reload()
    shown(button).to_have_text("Theme: dark")
    assert ground(page) == dark
    page.emulate_media(color_scheme="dark")
    button.click()
    shown(button).to_have_text("Theme: system")
    assert ground(page) == dark, "the system's is dark now"


@pytest.mark.parametrize("width", [320, PHONE_PX, 700, 1280])
def test_the_requirement_that_decided_is_never_clipped(site: Served, browse: Browse, width: int) -> None:
    page = browse()
    page.set_viewport_size({"width": width, "height": 900})
    page.goto(f"{site.url}/#/campaigns/{site.urban}/solutions/{unsafe_one(site)['number']}")
    table = page.get_by_role("region", name="Table of verdicts")
    shown(table.get_by_role("row").nth(1)).to_contain_text("decisive")
    assert table.evaluate("node => node.scrollWidth <= node.clientWidth")
    for cell in table.get_by_role("row").nth(1).locator("th, td").all():
        box = cell.bounding_box()
        assert box is not None
        assert 0 <= box["x"] < box["x"] + box["width"] <= width
