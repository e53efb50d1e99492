"""``load@1``: a problem and its simulator, whose episodes do nothing but wait as long as they are told.

Times are log-normal, as simulations' are: many of about the same length, a few much longer. They and the verdict
depend on the candidate and its seed alone, so that every run of a campaign must come to the same archive.
Not part of the catalogue: name this module in ``BRINK_PLUGINS``.
"""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from brink.search.algorithm import Evaluation, Scored
from brink.search.settings import check_settings, setting
from brink.search.space import Component, Real, SearchSpace
from brink.server.problems.base import Vectors
from brink.server.problems.catalogue import PROBLEMS
from brink.sim.catalogue import SIMULATORS, register
from brink.sim.episode import EpisodeResult, EpisodeSpec, Verdict
from brink.sim.errors import InvalidEpisode
from brink.worker.wire import Completed

LOAD = "load@1"
MODULE = __name__
REQUIREMENT = "far@1"


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadParams:
    """How long episodes take."""

    mean_s: float = setting(0.0, help="Mean time of an episode; 0 does nothing.", ge=0.0, le=60.0, unit="s")
    sigma: float = setting(0.5, help="Standard deviation of the time's logarithm.", ge=0.0, le=2.0)

    def __post_init__(self) -> None:
        check_settings(self)


class Load:
    """Unsafe inside a circle in the plane."""

    id: ClassVar[str] = LOAD
    summary: ClassVar[str] = "Waits as long as it is told."
    params_type: ClassVar[type[Any]] = LoadParams

    def __init__(self, params: LoadParams) -> None:
        self.params = params
        self.space = SearchSpace(
            (
                Component("scenario", (Real("x", -2.0, 2.0, "m"),)),
                Component("behaviour", (Real("y", -2.0, 2.0, "m"),)),
            )
        )
        self.algorithm_defaults: Mapping[str, Any] = {"radius": 0.2}
        self.needs = LOAD
        self.timeout_s = 300.0

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode at a point."""
        return EpisodeSpec(
            simulator=LOAD, scenario={"x": float(vectors[0][0]), "wait_s": self._wait_s(seed)},
            behaviour={"y": float(vectors[1][0])}, requirements=(REQUIREMENT,), seed=seed, duration_s=1.0,
        )  # fmt: skip

    def evaluation(self, outcome: Completed) -> Evaluation:
        """Return the verdict at a point."""
        robustness = outcome.verdicts[REQUIREMENT].robustness
        return Scored(unsafe=robustness < 0, robustness=robustness, objectives=outcome.objectives)

    def _wait_s(self, seed: int) -> float:
        if self.params.mean_s == 0.0:
            return 0.0
        sigma = self.params.sigma
        drawn = np.random.default_rng(seed).lognormal(-(sigma**2) / 2, sigma)
        return self.params.mean_s * float(drawn)


class Waiter:
    """Waits, then says how far from the origin a point is."""

    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        """Run one episode.

        Raises:
            InvalidEpisode: It is none of this problem.
        """
        x, y, wait_s = (
            place.get(name)
            for place, name in ((spec.scenario, "x"), (spec.behaviour, "y"), (spec.scenario, "wait_s"))
        )
        if not (isinstance(x, float) and isinstance(y, float) and isinstance(wait_s, float)):
            raise InvalidEpisode("expected the numbers scenario.x, scenario.wait_s and behaviour.y")
        if wait_s > 0.0:
            time.sleep(wait_s)
        distance_m = math.hypot(x, y)
        robustness = distance_m - 1.0
        return EpisodeResult(
            verdicts={
                REQUIREMENT: Verdict(
                    robustness=robustness, unit="m", violated_at_s=0.0 if robustness < 0 else None
                )
            },
            objectives={"distance": distance_m},
            features={},
            provenance={},
            trace=b"" if record else None,
        )


register(PROBLEMS, LOAD, Load)
register(SIMULATORS, LOAD, Waiter)
