"""What pages complain of: their console, and errors that nobody caught.

A page that works says nothing. Chromium itself notes what the page's policy forbids, such as a request to elsewhere,
each answer of 4xx and 5xx, and each lost connection: a test that brings one about says so beforehand.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager

from playwright.sync_api import ConsoleMessage, Error, Page

_REFUSED = r"Failed to load resource: the server responded with a status of {status} "
_LOST = (
    r"Failed to load resource: net::ERR_"
    r"(CONNECTION_\w+|EMPTY_RESPONSE|SOCKET_NOT_CONNECTED|CONTENT_LENGTH_MISMATCH|INCOMPLETE_CHUNKED_ENCODING)"
)


class Console:
    """Gathers what pages complain of.

    Attributes:
        complaints: What came and was not expected.
    """

    def __init__(self) -> None:
        self.complaints: list[str] = []
        self._expected: dict[str, int] = {}

    def watch(self, page: Page) -> None:
        """Listen to a page."""
        page.on("console", self._told)
        page.on("pageerror", self._failed)

    def unwatch(self, page: Page) -> None:
        """Listen to a page no more."""
        page.remove_listener("console", self._told)
        page.remove_listener("pageerror", self._failed)

    def expect_status(self, *statuses: int) -> None:
        """Expect answers of these statuses from now on; each has to come."""
        for status in statuses:
            self._expected.setdefault(_REFUSED.format(status=status), 0)

    def expect_lost_connections(self) -> None:
        """Expect connections to be lost from now on; one has to be."""
        self._expected.setdefault(_LOST, 0)

    def settle(self) -> None:
        """Fail if something came that was not expected, or something that was did not come."""
        assert not self.complaints, "\n".join(["the page complains:", *self.complaints])
        missing = [pattern for pattern, times in self._expected.items() if not times]
        assert not missing, f"expected in the console, but never there: {missing}"

    def _told(self, message: ConsoleMessage) -> None:
        if message.type not in ("error", "warning", "assert"):
            return
        for pattern in self._expected:
            if re.match(pattern, message.text):
                self._expected[pattern] += 1
                return
        where = message.location.get("url", "")
        self.complaints.append(f"console {message.type}: {message.text} ({where})")

    def _failed(self, error: Error) -> None:
        self.complaints.append(f"uncaught: {error.stack or error.message}")


@contextmanager
def silence() -> Iterator[Console]:
    """Give a console; at the end of a block that did not fail itself, nothing unexpected may have come."""
    console = Console()
    yield console
    console.settle()
