"""What one coordinator process measures of itself, for Prometheus."""

from typing import Final

from prometheus_client import CollectorRegistry, Counter, Histogram

_REQUEST_S: Final = (0.002, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0)
_STEP_S: Final = (0.002, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 120.0)


class Metrics:
    """Counts and times since the process began. Labels have few values each: nobody from outside can add any."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self.requests = Histogram(
            "brink_request_seconds",
            "Time from a request to its answer; leases wait for work on purpose",
            ["method", "route", "status"],
            buckets=_REQUEST_S,
            registry=self.registry,
        )
        self.results = Counter(
            "brink_results", "Results that workers reported, by what became of them", ["status"],
            registry=self.registry,
        )  # fmt: skip
        self.failures = Counter(
            "brink_failures", "Attempts that failed, by reason", ["reason"], registry=self.registry
        )
        self.expired = Counter("brink_leases_expired", "Leases that ran out", registry=self.registry)
        self.steps = Histogram(
            "brink_step_seconds", "Time of a generation step: tell, grow, ask, store", buckets=_STEP_S,
            registry=self.registry,
        )  # fmt: skip
        self.commits = Histogram(
            "brink_commit_seconds", "Time of a write transaction; all other writes wait for it", buckets=_STEP_S,
            registry=self.registry,
        )  # fmt: skip
