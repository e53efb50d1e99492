"""Small campaigns with a known landscape, for figures."""

import numpy as np

from brink.plots import CampaignFigures
from brink.search.archive import Archive, Neighbourhood
from brink.search.problems import MTQ_RADIUS, MTQ_SPACE, mtq_robustness
from brink.search.space import Categorical, Component, Dormant, Integer, Real, SearchSpace

MIXED = SearchSpace(
    (
        Component(
            "scenario", (Categorical("weather", ("clear", "wet", "hard_rain")), Integer("lanes", 1, 4))
        ),
        Component(
            "behaviour",
            (
                Categorical("label", ("null", "vehicle")),
                Real("x_px", 0.0, 800.0, "px"),
                Integer("t0_step", 0, 300),
            ),
            (Dormant("label", "null", ("x_px", "t0_step")),),
        ),
    )
)
"""A space with everything in it: a category, few and many integers, a number that can sleep."""


def mtq_campaign(count: int = 400, *, seed: int = 1, t_b: float = 0.2, d_th: float = 0.05) -> CampaignFigures:
    rng = np.random.default_rng(seed)
    vectors = np.clip(rng.normal(0.75, 0.2, (count, 2)), 0, 1)
    values = np.array([mtq_robustness(x, y) for x, y in vectors.tolist()])
    # MTQ is unsafe nearly everywhere: turned round, the disc is what is unsafe.
    return campaign(MTQ_SPACE, vectors, values > 0, -values, radius=MTQ_RADIUS, t_b=t_b, d_th=d_th)


def mixed_campaign(count: int = 300, *, seed: int = 1, null_share: float = 0.4) -> CampaignFigures:
    rng = np.random.default_rng(seed)
    weather, lanes = rng.integers(0, 3, count), rng.integers(1, 5, count)
    label = (rng.random(count) >= null_share).astype(float)
    x_px, t0 = rng.uniform(1, 800, count) * label, rng.integers(1, 301, count) * label
    vectors = np.column_stack([weather, lanes, label, x_px, t0]).astype(float)
    chance = np.where(weather == 2, 0.6, 0.05) + 0.3 * (x_px > 400)
    unsafe = rng.random(count) < chance
    return campaign(MIXED, vectors, unsafe, np.where(unsafe, -1.0, 1.0), radius=0.3, t_b=0.2, d_th=0.1)


def campaign(
    space: SearchSpace,
    vectors: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    unsafe: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
    values: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    *,
    radius: float,
    t_b: float,
    d_th: float,
) -> CampaignFigures:
    count = len(vectors)
    archive = Archive.empty(space, Neighbourhood(radius, 0.1)).grown(
        np.arange(count), vectors, unsafe, values
    )
    ends = tuple(range(50, count, 50)) + ((count,) if count else ())
    return CampaignFigures(
        archive=archive, space=space, title="Test", generation_ends=ends, t_b=t_b, d_th=d_th
    )
