"""The report of a campaign in a browser: complete in itself, readable at every width, accessible."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page

from brink.cli.options import with_api
from brink.report.campaign import campaign_report, write_page
from browser.console import Console
from browser.served import Served
from browser.test_browser_accessibility import COLOURS, EVERYTHING, faults
from browser.test_browser_layout import OVERHANGING, PHONE_PX
from browser.visits import WIDTH, Theme

pytestmark = pytest.mark.long("the dashboard beyond a walk through it")

Open = Callable[..., Page]


@pytest.fixture(scope="module")
def report(site: Served, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The address of the report of a campaign that was simulated for real."""
    path = f"/api/v1/campaigns/{site.urban}"
    labels = {"notes": "A note with an-unbreakable-word-" + "x" * 200, "tags": ["night", "rain"]}
    assert site.client.patch(path, json=labels).status_code == 200
    with ThreadPoolExecutor(1) as other:  # in this thread the browser has an event loop of its own
        page = other.submit(
            with_api, site.url, None, lambda api: campaign_report(api, site.urban, workers=True)
        ).result()
    site.client.patch(path, json={"notes": "", "tags": []})
    file: Path = tmp_path_factory.mktemp("report") / "report.html"
    write_page(file, page)
    return file.as_uri()


@pytest.fixture
def open_report(browser: Browser, console: Console, report: str) -> Iterator[Open]:
    """Opens the report as somebody who has no coordinator."""
    contexts = []

    def opened(*, width: int = WIDTH, theme: Theme = "light", bypass_csp: bool = False) -> Page:
        context = browser.new_context(
            viewport={"width": width, "height": 900}, color_scheme=theme, offline=True, bypass_csp=bypass_csp
        )
        contexts.append(context)
        page = context.new_page()
        console.watch(page)
        requests: list[str] = []
        page.on("request", lambda request: requests.append(request.url))
        page.goto(report)
        assert [url for url in requests if not url.startswith("data:")] == [report]
        return page

    yield opened
    for context in contexts:
        context.close()


@pytest.mark.parametrize("width", [PHONE_PX, WIDTH])
def test_the_page_needs_nothing_else_and_does_not_scroll_sideways(open_report: Open, width: int) -> None:
    page = open_report(width=width)
    assert page.evaluate("document.scrollingElement.scrollWidth") == width, page.evaluate(OVERHANGING, width)
    pictures = page.locator("img")
    assert pictures.count() >= 1
    for picture in pictures.all():
        assert picture.evaluate("node => node.complete && node.naturalWidth > 0")
    assert page.get_by_role("heading", level=2).first.inner_text() == "What was found"


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_the_page_has_no_serious_fault(open_report: Open, theme: Theme) -> None:
    rules = EVERYTHING if theme == "light" else COLOURS
    assert faults(open_report(theme=theme, bypass_csp=True), rules) == []
