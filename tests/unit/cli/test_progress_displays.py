"""Progress on terminals of any width, and in files, where control characters would be litter."""

import io
import threading
from typing import Any

import pytest
from rich.console import Console
from support.progress import PROGRESS

from brink.api.live import CampaignDisplay, Steps, updates_in_place
from brink.server.api.schemas import Progress


class Terminal(io.StringIO):
    """Output that claims to be a terminal."""

    def isatty(self) -> bool:
        return True


class Lines(io.StringIO):
    """Output that can be waited for."""

    def __init__(self, wanted: str) -> None:
        super().__init__()
        self._wanted = wanted
        self.complete = threading.Event()

    def write(self, text: str) -> int:
        written = super().write(text)
        if self._wanted in self.getvalue():
            self.complete.set()
        return written


def line_of(**changes: Any) -> str:
    screen = Console(file=io.StringIO(), markup=False)
    with CampaignDisplay(screen) as display:
        display.show(Progress.model_validate({**PROGRESS, **changes}))
    assert isinstance(screen.file, io.StringIO)
    return screen.file.getvalue()


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({}, "12.5 a second, remaining 1 min 24 s, workers 2"),
        ({"rate_per_s": None, "remaining_s": None, "workers": 0}, "workers none yet"),
        ({"rate_per_s": None, "remaining_s": None, "cached": 254}, "254 from the cache, workers 2"),
        (
            {
                "rate_per_s": None,
                "remaining_s": None,
                "failed": 2,
                "reported_failed": 3,
                "failure": "no road",
            },
            "workers 2, failed 5 (first: no road)",
        ),
    ],
)
def test_progress_in_a_file_is_one_plain_line_of_what_is_known(
    changes: dict[str, Any], line: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "30")
    assert line_of(**changes) == f"254/1300 simulations, {line}\n"


def test_progress_waits_for_the_first_worker_unless_that_takes_long(monkeypatch: pytest.MonkeyPatch) -> None:
    nothing: dict[str, Any] = {"simulations": 0, "rate_per_s": None, "remaining_s": None, "workers": 0}
    assert line_of(**nothing) == ""
    assert line_of(**{**nothing, "workers": 1}) == "0/1300 simulations, workers 1\n"
    assert line_of(**nothing, status="paused") != ""
    monkeypatch.setattr("brink.api.live.PLAIN_EVERY_S", 0.0)
    assert line_of(**nothing) == "0/1300 simulations, workers none yet\n"


def test_the_first_failure_is_shown_at_once_in_a_file() -> None:
    screen = Console(file=io.StringIO(), markup=False)
    with CampaignDisplay(screen) as display:
        for failed in (0, 1, 2):
            display.show(Progress.model_validate({**PROGRESS, "reported_failed": failed}))
    assert isinstance(screen.file, io.StringIO)
    lines = screen.file.getvalue().splitlines()
    assert [line.endswith("failed 1") for line in lines] == [False, True]


def test_colours_in_a_file_do_not_make_it_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    screen = Console(file=io.StringIO())
    assert screen.is_terminal, "so rich alone would move the cursor about in a file"
    assert not updates_in_place(screen)
    assert updates_in_place(Console(file=Terminal()))
    monkeypatch.setenv("TERM", "dumb")
    assert not updates_in_place(Console(file=Terminal()))


@pytest.mark.parametrize("width", [24, 40, 60, 80, 200])
def test_no_row_of_the_panel_wraps(width: int) -> None:
    screen = Console(file=io.StringIO(), width=width, markup=False)
    display = CampaignDisplay(screen)
    found = Progress.model_validate({**PROGRESS, "cached": 12, "asking": "a long request to a model " * 3})
    screen.print(display._panel(found))
    assert isinstance(screen.file, io.StringIO)
    rows = screen.file.getvalue().splitlines()
    assert len(rows) == 1 + len(display._facts(found))
    assert max(map(len, rows)) <= width
    if width >= 80:
        assert "254 of 1,300 simulations" in rows[0]


def test_steps_in_a_file_are_a_line_now_and_then() -> None:
    output = Lines(wanted="2 of 3, ")
    with Steps(Console(file=output, width=20, markup=False), "drawing", plain_every_s=0.001) as steps:
        steps.show("drawing [replays] of a long list", 2, 3)
        assert output.complete.wait(20.0)
    told = output.getvalue().splitlines()
    assert told[-1].startswith("drawing [replays] of a long list, 2 of 3, "), (
        "whole, and brackets are no markup"
    )
    assert "\x1b" not in output.getvalue()


def test_steps_on_a_terminal_are_one_line_that_disappears(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    output = Terminal()
    with Steps(
        Console(file=output, width=30, markup=False), "drawing [replays] that take very long"
    ) as steps:
        assert len(steps._line().plain) > 30
    shown = output.getvalue()
    assert "drawing [replays] that take v…" in shown
    assert shown.endswith("\x1b[1A\x1b[2K"), "erased"
