"""Visitors of the dashboard: each has a browser's storage and cache of its own, except for one who stays."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal, Protocol

from playwright.sync_api import Browser, BrowserContext, Page
from playwright.sync_api import expect as shown

from browser.console import Console

PATIENCE_MS = 15_000
WIDTH, HEIGHT = 1280, 900
NOWHERE = "#/nowhere"
"""A place where a page asks for nothing."""
Theme = Literal["light", "dark"]


class Browse(Protocol):
    """Goes to a place of the site, given as the part of its address that begins with ``#``."""

    def __call__(self, place: str = "#/") -> Page:
        """Return the page."""


class Visits:
    """Opens pages.

    Args:
        browser: In which.
        console: Hears what they complain of.
    """

    def __init__(self, browser: Browser, console: Console) -> None:
        self._browser = browser
        self._console = console
        self._contexts: list[BrowserContext] = []

    def __call__(
        self,
        url: str,
        place: str = "#/",
        *,
        width: int = WIDTH,
        height: int = HEIGHT,
        theme: Theme = "light",
        token: str | None = None,
        stopped: bool = False,
    ) -> Page:
        """Open a place as somebody who was never here before.

        Args:
            url: Of the coordinator.
            place: The address from the ``#`` on.
            width: Of the page in px.
            height: Of the page in px.
            theme: What the system asks for.
            token: What they signed in with.
            stopped: Whether the page's clock goes on only where ``page.clock`` is told to.
        """
        context = self._browser.new_context(viewport={"width": width, "height": height}, color_scheme=theme)
        self._contexts.append(context)
        context.set_default_timeout(PATIENCE_MS)
        if token is not None:
            context.add_init_script(f"sessionStorage.setItem('brink.token', '{token}')")
        if stopped:
            context.clock.install()
        page = context.new_page()
        self._console.watch(page)
        page.goto(f"{url}/{place}")
        return page

    def end(self) -> None:
        """Close all pages."""
        for context in self._contexts:
            context.close()
        self._contexts.clear()


class Regular:
    """A visitor who stays for test after test, and goes from view to view as people do: nothing is loaded again.

    What the browser keeps is forgotten for each test. Between tests it is where nothing is shown or asked for.

    Args:
        browser: In which.
    """

    def __init__(self, browser: Browser) -> None:
        self._browser = browser
        self._visits: Visits | None = None
        self._page: Page | None = None
        self._url = ""

    def come(self, url: str, console: Console) -> Page:
        """Return the visitor's page.

        Args:
            url: Of the coordinator.
            console: Hears what it complains of, until the visitor goes.
        """
        if self._page is None:
            self.end()
            self._visits = Visits(self._browser, console)
            self._page, self._url = self._visits(url, NOWHERE), url
        else:
            assert self._url == url
            console.watch(self._page)
            self._page.set_viewport_size({"width": WIDTH, "height": HEIGHT})
            self._page.emulate_media(color_scheme="light")
            self._page.evaluate("() => { localStorage.clear(); sessionStorage.clear(); }")
        return self._page

    def go(self, console: Console) -> None:
        """Leave the view."""
        page, self._page = self._page, None  # not used again if it cannot leave
        assert page is not None
        page.goto(f"{self._url}/{NOWHERE}")
        shown(page.get_by_text("There is no such page.")).to_be_visible()
        console.unwatch(page)
        self._page = page

    def end(self) -> None:
        """Close the page; whoever comes next gets another."""
        if self._visits is not None:
            self._visits.end()
        self._page = self._visits = None


@contextmanager
def visiting(browser: Browser, console: Console) -> Iterator[Visits]:
    """Give visits, which end with the block."""
    visits = Visits(browser, console)
    try:
        yield visits
    finally:
        visits.end()
