"""The metrics of one coordinator process, for Prometheus."""

from collections.abc import Callable
from typing import Final

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram

_REQUEST_S: Final = (0.002, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0)
_STEP_S: Final = (0.002, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 120.0)


class Metrics:
    """Counts and times since the process started. Clients cannot add label values, so their number stays small."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self.requests = Histogram(
            "brink_request_seconds",
            "Time from request to response; lease requests wait for jobs by design",
            ["method", "route", "status"],
            buckets=_REQUEST_S,
            registry=self.registry,
        )
        self.results = Counter(
            "brink_results",
            "Reported results, by the status returned for them",
            ["status"],
            registry=self.registry,
        )
        self.failures = Counter(
            "brink_failures", "Attempts that failed, by reason", ["reason"], registry=self.registry
        )
        self.expired = Counter("brink_leases_expired", "Expired leases", registry=self.registry)
        self.steps = Histogram(
            "brink_step_seconds",
            "Time of a generation step: evaluate, tell, ask, store",
            buckets=_STEP_S,
            registry=self.registry,
        )
        self.commits = Histogram(
            "brink_commit_seconds",
            "Duration of a write transaction; all other writes wait",
            buckets=_STEP_S,
            registry=self.registry,
        )

    def watch(self, name: str, about: str, value: Callable[[], float]) -> None:
        """Register a value that is polled whenever the metrics are read."""
        Gauge(name, about, registry=self.registry).set_function(value)
