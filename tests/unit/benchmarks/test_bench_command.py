"""The cost of `command@1`: campaigns beside bare commands, and the figures that have targets."""

import shutil

import pytest

from benchmarks import command
from benchmarks.measurement import silent


def test_a_campaign_is_compared_with_as_many_bare_commands_at_a_time() -> None:
    rate, more_ms, share = command.rate_rows(20, 2, (90.0, 110.0), 81.0)
    assert rate.value == 81.0
    assert more_ms.value == pytest.approx(2000 / 81 - 20)
    assert share.value == pytest.approx(19 / 81)
    assert [rate.met, more_ms.met, share.met] == [None, True, False]
    assert [row.met for row in command.rate_rows(20, 8, (90.0, 110.0), 80.0)] == [None] * 3


@pytest.mark.long("starts a coordinator and a worker")
@pytest.mark.skipif(shutil.which("c++") is None, reason="there is no C++ compiler")
def test_a_real_campaign_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "DURATIONS_MS", (2,))
    monkeypatch.setattr(command, "WORKERS", (1,))
    rows = command.measure_command(episodes=2, simulations=20, progress=silent)
    assert [row.what for row in rows] == [
        "2 ms, one process: ms more than bare",
        "2 ms, 1 worker: simulations a second",
        "2 ms, 1 worker: ms a worker more than bare",
        "2 ms, 1 worker: share of the bare time",
    ]
    assert 0 < rows[1].value < 500  # the program alone takes 2 ms
