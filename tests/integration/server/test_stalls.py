"""A coordinator beside code and requests that stall, as `python -m benchmarks stalls` measures it."""

import pytest

from benchmarks.stalls import DISTURBANCES, PROBES, measure_stall


@pytest.mark.long("starts a coordinator, and measures wall-clock time")
def test_a_stall_is_measured_beside_every_probe() -> None:
    (raises,) = (one for one in DISTURBANCES if one.title == "plug-in: tell raises an error")
    stalled = measure_stall(raises, seconds=1.0, idle_s=0.5)
    assert [one.probe for one in stalled.latencies] == list(PROBES)
    assert not any(one.failed for one in stalled.latencies)
    assert stalled.fate.startswith("paused: generation ")
    assert "RuntimeError: tell fails" in stalled.fate
    assert stalled.cancel_s is not None
