"""What is measured of a queue."""

import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

WORKERS = (1, 4, 16)
BATCHES = (1, 8, 32)


@dataclass(frozen=True, slots=True, kw_only=True)
class Throughput:
    """No-op jobs that went through a queue.

    Attributes:
        system: Which queue, with its database.
        workers: Workers that shared it.
        batch: Most jobs a request or, for the others, that a worker fetches ahead.
        jobs: Jobs measured.
        seconds: From the first start to the last stored outcome.
        lease_p50_ms: Median time of a request that reports and leases; None where there is no such thing.
        lease_p99_ms: Its 99th percentile.
    """

    system: str
    workers: int
    batch: int
    jobs: int
    seconds: float
    lease_p50_ms: float | None = None
    lease_p99_ms: float | None = None

    @property
    def per_s(self) -> float:
        """Jobs a second."""
        return self.jobs / self.seconds


@dataclass(frozen=True, slots=True, kw_only=True)
class Pickup:
    """How soon an idle worker starts a job that is enqueued.

    Attributes:
        system: Which queue, with its database.
        since: The moment from which it is counted.
        times_ms: One for each job.
    """

    system: str
    since: str
    times_ms: tuple[float, ...]

    @property
    def p50_ms(self) -> float:
        """Median."""
        return percentile(self.times_ms, 50)

    @property
    def p99_ms(self) -> float:
        """99th percentile."""
        return percentile(self.times_ms, 99)


def medians(measured: Iterable[Throughput]) -> list[Throughput]:
    """Return, of what was measured several times, the one with the median of the jobs a second."""
    found: dict[tuple[str, int, int], list[Throughput]] = {}
    for one in measured:
        found.setdefault((one.system, one.workers, one.batch), []).append(one)
    return [sorted(same, key=lambda one: one.per_s)[len(same) // 2] for same in found.values()]


def together(measured: Iterable[Pickup]) -> list[Pickup]:
    """Return what was measured several times as one."""
    found: dict[tuple[str, str], tuple[float, ...]] = {}
    for one in measured:
        found[one.system, one.since] = found.get((one.system, one.since), ()) + one.times_ms
    return [Pickup(system=system, since=since, times_ms=times) for (system, since), times in found.items()]


def percentile(values: Sequence[float], percent: int) -> float:
    """Return a percentile, between the two values next to it."""
    if len(values) == 1:
        return values[0]
    return statistics.quantiles(values, n=100, method="inclusive")[percent - 1]
