"""Chromium without a window, for measurements, tests and pictures: this machine's own, nothing is downloaded.

``TEST_CHROMIUM`` names the program where it is not one of the usual names.
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
    """There is no Chromium on this machine."""


def executable() -> str:
    """Return the path of Chromium.

    Raises:
        NoChromium: There is none; the message says how to get one.
    """
    given = os.environ.get(VARIABLE)
    for name in (given,) if given else NAMES:
        if found := shutil.which(name):
            return found
    sought = f"{VARIABLE}={given} is no program" if given else f"none of {', '.join(NAMES)} is on the PATH"
    raise NoChromium(
        f"the dashboard needs Chromium: {sought}; install it (Debian and Ubuntu: apt-get install chromium), "
        f"or name one in {VARIABLE}"
    )


@contextmanager
def chromium() -> Iterator[Browser]:
    """Give a browser until the end of the block.

    Raises:
        NoChromium: There is none.
    """
    path = executable()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path)
        try:
            yield browser
        finally:
            browser.close()
