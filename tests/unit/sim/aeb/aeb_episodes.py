"""Specifications of emergency-braking episodes, and fake detectors."""

from typing import Any

import numpy as np

from brink.sim.aeb.specification import ARRIVAL_S, CROSSING_M, ONCOMING_M, TIMES, WEATHERS, Occluder
from brink.sim.episode import EpisodeSpec

REQUIREMENTS = ("no-collision@1", "no-dangerous-stop@1")


def spec(seed: int, *, mode: str = "oracle", obstacle: str = "none", **options: Any) -> EpisodeSpec:
    """Return an episode with a random scenario."""
    rng = np.random.default_rng(seed)
    return EpisodeSpec(
        simulator="brink-aeb@3",
        scenario={
            "time_of_day": str(rng.choice(TIMES)),
            "weather": str(rng.choice(WEATHERS)),
            "occluder": str(rng.choice(list(Occluder))),
            "crossing_m": float(rng.uniform(*CROSSING_M)),
            "arrival_s": float(rng.uniform(*ARRIVAL_S)),
            "oncoming_m": float(rng.uniform(*ONCOMING_M)),
            "obstacle": obstacle,
        },
        behaviour={"mode": mode},
        requirements=REQUIREMENTS,
        seed=seed,
        duration_s=15.0,
        options=options,
    )
