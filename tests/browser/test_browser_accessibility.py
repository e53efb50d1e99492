"""axe-core finds nothing serious in any view, light or dark."""

from typing import Any

import httpx
import pytest
from axe_playwright_python.base import AXE_SCRIPT
from playwright.sync_api import Page
from playwright.sync_api import expect as shown
from support.marks import mostly_long

from browser.console import Console
from browser.served import Served, origin
from browser.views import View, open_view
from browser.visits import Browse, Theme, Visits

EVERYTHING = {"resultTypes": ["violations"]}
COLOURS = {**EVERYTHING, "runOnly": ["color-contrast", "link-in-text-block"]}
"""The rules that a theme can break: the dark one changes nothing but colours."""

RULES: dict[Theme, dict[str, Any]] = {"light": EVERYTHING, "dark": COLOURS}


def faults(page: Page, options: dict[str, Any]) -> list[str]:
    """Return what is serious or critical on a page, with where it is."""
    if page.evaluate("typeof axe") == "undefined":  # it stays while one goes from view to view
        page.evaluate(AXE_SCRIPT)
    found = page.evaluate("options => axe.run(options).then(found => found.violations)", options)
    return [
        f"{one['id']}: {one['help']}: {[node['target'] for node in one['nodes']][:4]}"
        for one in found
        if one["impact"] in ("serious", "critical")
    ]


@pytest.mark.long("the dashboard beyond one walk through it")
@pytest.mark.parametrize("theme", mostly_long(["light", "dark"], ["light"], "checks every view once more"))
def test_no_view_has_a_serious_fault(site: Served, views: list[View], browse: Browse, theme: Theme) -> None:
    page = browse()
    page.emulate_media(color_scheme=theme)
    found = {}
    for view in views:
        open_view(page, site.url, view)
        if wrong := faults(page, RULES[theme]):
            found[view.name] = wrong
    assert not found


@pytest.mark.parametrize("theme", mostly_long(["light", "dark"], ["light"], "the same in other colours"))
def test_token_page_is_accessible(
    guarded: httpx.Client, visit: Visits, console: Console, theme: Theme
) -> None:
    console.expect_status(401)
    page = visit(origin(guarded), theme=theme)
    page.get_by_label("Token").fill("wrong")
    page.get_by_role("button", name="Sign in").click()
    shown(page.get_by_role("alert")).to_contain_text("Token rejected")
    assert faults(page, RULES[theme]) == []
