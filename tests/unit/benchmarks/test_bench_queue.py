"""The throughput of the queue, measured on a real coordinator."""

from pathlib import Path

import pytest

from benchmarks.measurement import percentile
from benchmarks.queue import SQLITE, _BrinkQueue


@pytest.mark.long("starts a coordinator and its clients")
def test_clients_wait_for_the_first_jobs_and_need_no_further_ones(tmp_path: Path) -> None:
    with _BrinkQueue(SQLITE, f"sqlite:///{tmp_path}/queue.db", tmp_path) as queue:
        few = queue.throughput(workers=2, batch=8, jobs=1)
        more = queue.throughput(workers=1, batch=4, jobs=12)
    assert (few.jobs, more.jobs) == (1, 12)
    assert few.lease_p50_ms is None, "no job was left for a request that reports one"
    assert more.lease_p50_ms is not None
    assert few.seconds > 0
    assert more.seconds > 0


def test_a_percentile_is_interpolated() -> None:
    assert percentile([4.0], 99) == 4.0
    assert percentile([1.0, 2.0, 4.0], 75) == pytest.approx(3.0)
