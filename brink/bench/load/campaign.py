"""Campaigns whose jobs cost what a measurement wants them to cost: random search on ``load@1``."""

from typing import Any

from brink.bench.load.problem import LOAD


def load_campaign(
    jobs: int, *, generation: int, seed: int, mean_s: float = 0.0, **params: float
) -> dict[str, Any]:
    """Return the body of a campaign that shares no results with others.

    Args:
        jobs: Its budget.
        generation: Jobs a generation.
        seed: Of the points, and of the episodes' times.
        mean_s: Mean time of an episode; 0 does nothing.
        params: More of the algorithm's parameters.
    """
    return {
        "name": f"load {seed}", "problem": {"id": LOAD, "params": {"mean_s": mean_s}}, "seed": seed,
        "algorithm": {"id": "random@1", "params": {"generation_size": generation, **params}},
        "budget": {"simulations": jobs}, "execution": {"cache": False, "keep_traces": 0},
    }  # fmt: skip
