"""Headless Chromium for measurements, tests and screenshots. Uses the installed browser and downloads nothing.

Set ``TEST_CHROMIUM`` to the executable if it is not found under one of the usual names.
"""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from playwright.sync_api import Browser, sync_playwright

from brink.server.errors import ServerError

VARIABLE: Final = "TEST_CHROMIUM"
NAMES: Final = ("chromium", "chromium-browser", "google-chrome")


class NoChromium(ServerError):
    """Chromium is not installed."""


def executable() -> str:
    """Return the path of the Chromium executable.

    Raises:
        NoChromium: It was not found; the message says how to install it.
    """
    given = os.environ.get(VARIABLE)
    for name in (given,) if given else NAMES:
        if found := shutil.which(name):
            return found
    reason = (
        f"{VARIABLE}={given} is not an executable" if given else f"none of {', '.join(NAMES)} is on the PATH"
    )
    raise NoChromium(
        f"this needs Chromium: {reason}; install it (Debian and Ubuntu: apt-get install chromium) or set "
        f"{VARIABLE} to its path"
    )


@contextmanager
def chromium() -> Iterator[Browser]:
    """Run a headless browser until the end of the block.

    Raises:
        NoChromium: Chromium is not installed.
    """
    path = executable()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path)
        try:
            yield browser
        finally:
            browser.close()
