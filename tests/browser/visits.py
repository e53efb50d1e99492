"""Visitors of the dashboard: each has a browser's storage and cache of its own."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

from playwright.sync_api import Browser, BrowserContext, Page

from browser.console import Console

PATIENCE_MS = 15_000
Theme = Literal["light", "dark"]


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
        self, url: str, place: str = "#/", *, width: int = 1280, height: int = 900, theme: Theme = "light",
        token: str | None = None, stopped: bool = False,
    ) -> Page:  # fmt: skip
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


@contextmanager
def visiting(browser: Browser, console: Console) -> Iterator[Visits]:
    """Give visits, which end with the block."""
    visits = Visits(browser, console)
    try:
        yield visits
    finally:
        visits.end()
