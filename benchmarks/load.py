"""Synthetic load: the problem ``load@1``, whose episodes only wait, its campaigns, and clients that play workers.

Episodes take log-normal times, as simulations do. Times and verdicts depend only on the candidate and its seed, so
every run of a campaign must produce the same archive. The problem is not in the catalogue: processes that need it
import this module through ``BRINK_PLUGINS``.
"""

import asyncio
import json
import math
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import Any, ClassVar, Self
from urllib.parse import urlsplit

import numpy as np

from brink.search.algorithm import Evaluation, Scored
from brink.search.settings import check_settings, setting
from brink.search.space import Component, Real, SearchSpace
from brink.server.problems.base import SimulatedProblem, Vectors
from brink.server.problems.catalogue import PROBLEMS
from brink.sim.catalogue import SIMULATORS, register
from brink.sim.episode import EpisodeResult, EpisodeSpec, Verdict
from brink.sim.errors import InvalidEpisode
from brink.worker.wire import Completed, machine_name

LOAD = "load@1"
MODULE = __name__
REQUIREMENT = "far@1"


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadParams:
    """Distribution of episode times."""

    mean_s: float = setting(0.0, help="Mean duration of an episode; 0: no wait.", ge=0.0, le=60.0, unit="s")
    sigma: float = setting(0.5, help="Standard deviation of the logarithm of the duration.", ge=0.0, le=2.0)

    def __post_init__(self) -> None:
        check_settings(self)


class Load(SimulatedProblem):
    """A problem whose unsafe region is the unit disc."""

    id: ClassVar[str] = LOAD
    summary: ClassVar[str] = "Episodes that only wait."
    params_type: ClassVar[type[Any]] = LoadParams

    def __init__(self, params: LoadParams) -> None:
        self.params = params
        self.space = SearchSpace(
            (
                Component("scenario", (Real("x", -2.0, 2.0, "m", resolution=0.01),)),
                Component("behaviour", (Real("y", -2.0, 2.0, "m", resolution=0.01),)),
            )
        )
        self.algorithm_defaults = {"radius": 0.2}
        self.needs = LOAD
        self.timeout_s = 300.0

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode of a candidate."""
        return EpisodeSpec(
            simulator=LOAD,
            scenario={"x": float(vectors[0][0]), "wait_s": self._wait_s(seed)},
            behaviour={"y": float(vectors[1][0])},
            requirements=(REQUIREMENT,),
            seed=seed,
            duration_s=1.0,
        )

    def evaluation(self, outcome: Completed) -> Evaluation:
        """Return the evaluation of an episode's outcome."""
        robustness = outcome.verdicts[REQUIREMENT].robustness
        return Scored(unsafe=robustness < 0, robustness=robustness, objectives=outcome.objectives)

    def _wait_s(self, seed: int) -> float:
        if self.params.mean_s == 0.0:
            return 0.0
        sigma = self.params.sigma
        drawn = np.random.default_rng(seed).lognormal(-(sigma**2) / 2, sigma)
        return self.params.mean_s * float(drawn)


class Waiter:
    """A simulator that waits and then measures the distance of a point from the origin."""

    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        """Run one episode.

        Raises:
            InvalidEpisode: The episode does not belong to this problem.
        """
        x, y, wait_s = spec.scenario.get("x"), spec.behaviour.get("y"), spec.scenario.get("wait_s")
        if not (isinstance(x, float) and isinstance(y, float) and isinstance(wait_s, float)):
            raise InvalidEpisode("expected the numbers scenario.x, scenario.wait_s and behaviour.y")
        if wait_s > 0.0:
            time.sleep(wait_s)
        verdict, distance_m = _verdict(x, y)
        return EpisodeResult(
            verdicts={REQUIREMENT: Verdict(**verdict)},
            objectives={"distance": distance_m},
            features={},
            provenance={},
            trace=b"" if record else None,
        )


def _verdict(x: float, y: float) -> tuple[dict[str, Any], float]:
    """Return the verdict on a point, and its distance from the origin in metres."""
    distance_m = math.hypot(x, y)
    unsafe = distance_m < 1.0
    return {"robustness": distance_m - 1.0, "unit": "m", "violated_at_s": 0.0 if unsafe else None}, distance_m


register(PROBLEMS, LOAD, Load)
register(SIMULATORS, LOAD, Waiter)


def load_campaign(
    jobs: int,
    *,
    generation: int,
    seed: int,
    mean_s: float = 0.0,
    algorithm: str = "random@1",
    **params: float,
) -> dict[str, Any]:
    """Return the request body for a campaign on ``load@1`` without the simulation cache.

    Args:
        jobs: Budget of simulations.
        generation: Jobs per generation.
        seed: Seed of the points and of the episode times.
        mean_s: Mean duration of an episode; 0 for no wait.
        algorithm: Id of the algorithm.
        params: Further parameters of the algorithm.
    """
    return {
        "name": f"load {seed}",
        "problem": {"id": LOAD, "params": {"mean_s": mean_s}},
        "seed": seed,
        "algorithm": {"id": algorithm, "params": {"generation_size": generation, **params}},
        "budget": {"simulations": jobs},
        "execution": {"cache": False, "keep_traces": 0},
    }


class LoadClient:
    """A worker without a simulator, which leases and reports jobs over one persistent connection.

    It speaks HTTP over asyncio streams, because a full HTTP client costs more CPU time than the coordinator.

    Attributes:
        times_s: Times of the requests that reported results and were granted new jobs.

    Args:
        url: URL of the coordinator.
        name: Worker id.
        max_jobs: Maximum number of jobs per lease request.
        wait_s: Longest time for which the coordinator may hold a lease request.
    """

    def __init__(self, url: str, name: str, *, max_jobs: int = 1, wait_s: float = 20.0) -> None:
        parts = urlsplit(url)
        self._host, self._port = parts.hostname or "", parts.port or 80
        worker = {"id": name, "host": "bench", "machine": machine_name(), "pid": os.getpid()}
        self._lease = {"worker": worker, "capabilities": [LOAD], "max_jobs": max_jobs, "wait_s": wait_s}
        self.times_s: list[float] = []

    async def __aenter__(self) -> Self:
        self._reader, self._writer = await asyncio.open_connection(self._host, self._port)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, stack: TracebackType | None
    ) -> None:
        self._writer.close()

    async def lease(self) -> list[dict[str, Any]]:
        """Lease jobs."""
        reply = await self._post("lease", self._lease)
        jobs: list[dict[str, Any]] = reply["jobs"]
        return jobs

    async def report(self, jobs: list[dict[str, Any]]) -> list[dict[str, Any]]:
        """Report jobs as completed and lease the next ones in the same request.

        Raises:
            RuntimeError: The coordinator did not accept every result.
        """
        results = [
            {"job": job["job"], "token": job["token"], "outcome": _outcome(job["spec"])} for job in jobs
        ]
        start = time.perf_counter()
        reply = await self._post(
            "results", {"worker": self._lease["worker"], "results": results, "lease": self._lease}
        )
        statuses = {status["status"] for status in reply["statuses"]}
        if statuses - {"accepted"}:
            raise RuntimeError(f"expected the coordinator to accept all results, got {statuses}")
        granted: list[dict[str, Any]] = reply["lease"]["jobs"]
        if granted:
            self.times_s.append(time.perf_counter() - start)
        return granted

    async def _post(self, name: str, message: dict[str, Any]) -> Any:
        body = json.dumps(message, separators=(",", ":")).encode()
        head = (
            f"POST /api/v1/jobs/{name} HTTP/1.1\r\nHost: {self._host}\r\nContent-Type: application/json\r\n"
            f"Content-Length: {len(body)}\r\n\r\n"
        )
        self._writer.write(head.encode() + body)
        headers = (await self._reader.readuntil(b"\r\n\r\n")).lower()
        length = int(headers.partition(b"content-length:")[2].partition(b"\r\n")[0])
        answer = await self._reader.readexactly(length)
        if not headers.startswith(b"http/1.1 200"):
            raise RuntimeError(f"expected 200, got {headers.splitlines()[0]!r}: {answer[:500]!r}")
        return json.loads(answer)


def _outcome(spec: Mapping[str, Any]) -> dict[str, Any]:
    verdict, distance_m = _verdict(spec["scenario"]["x"], spec["behaviour"]["y"])
    return {"kind": "completed", "verdicts": {REQUIREMENT: verdict}, "objectives": {"distance": distance_m}}
