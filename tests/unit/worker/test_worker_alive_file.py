"""The file that a worker touches for liveness probes."""

import logging
import os
from pathlib import Path

import pytest

from brink.worker.alive_file import STUCK_S, TOUCH_S, AliveFile


class Clock:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "alive"


def is_touched(alive: AliveFile, file: Path, progress_s: float) -> bool:
    """Return whether an update touches a file."""
    os.utime(file, (0, 0))
    alive.update(progress_s)
    return file.stat().st_mtime > 0


def test_the_file_is_touched_now_and_then(clock: Clock, file: Path) -> None:
    alive = AliveFile(file, clock)
    alive.update()
    assert file.exists()
    clock.now_s += TOUCH_S / 2
    assert not is_touched(alive, file, clock.now_s)
    clock.now_s += TOUCH_S / 2
    assert is_touched(alive, file, clock.now_s)


def test_a_stuck_thread_stops_it(clock: Clock, file: Path, caplog: pytest.LogCaptureFixture) -> None:
    alive = AliveFile(file, clock)
    alive.update()
    began_s = clock.now_s
    clock.now_s += STUCK_S
    assert is_touched(alive, file, began_s)
    clock.now_s += TOUCH_S
    with caplog.at_level(logging.ERROR):
        assert not is_touched(alive, file, began_s)
    assert "heartbeat thread is stuck" in caplog.text
    clock.now_s += TOUCH_S
    assert is_touched(alive, file, clock.now_s), "it goes on again"


def test_a_file_that_cannot_be_touched_is_logged(
    clock: Clock, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    AliveFile(tmp_path / "missing" / "alive", clock).update()
    assert "No such file or directory" in caplog.text


def test_without_a_file_nothing_is_touched(clock: Clock) -> None:
    AliveFile(None, clock).update(0.0)
