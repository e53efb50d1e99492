"""Views on a phone, and the theme that was chosen."""

import re

import pytest
from playwright.sync_api import Page
from playwright.sync_api import expect as shown

from browser.served import Served
from browser.views import View, open_view
from browser.visits import Browse, Visits

pytestmark = pytest.mark.long("the dashboard beyond a walk through it")

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
