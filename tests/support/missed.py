"""Drives in which the car ahead is not reported for some time: lines of solutions, and an outcome with chance."""

import numpy as np

from brink.server.problems.catalogue import make_problem
from brink.server.problems.urban_errors import SIMULATOR
from brink.worker.wire import Completed, LeasedJob
from support.tolerance import outcome

__all__ = ["PROBLEM", "SECONDS", "SIMULATOR", "judge", "missing"]
PROBLEM = {"id": "urban-errors@1", "params": {"errors": 1, "requirement": "front-gap@1"}}


def missing(weather: str, seconds: list[float]) -> list[list[float]]:
    """Return drives in which the car ahead is not reported for some time, all else alike."""
    space = make_problem(PROBLEM["id"], PROBLEM["params"]).space  # type: ignore[arg-type]
    values = space.decode(space.sample(np.random.default_rng(1)))
    values["scenario"] |= {"weather": weather, "pedestrians": "0", "time_of_day": "noon"}
    rows = []
    for one in seconds:
        error: dict[str, float | str] = {
            "type": "miss",
            "target": "lead",
            "severity": one / 8.0,
            "onset": "time",
            "onset_s": 4.0,
        }
        values["behaviour"] |= {f"error_1.{name}": value for name, value in error.items()}
        rows.append(space.join(space.encode(values)).tolist())
    return rows


SECONDS = [1.0, 1.1, 1.2, 1.3, 1.35, 1.4, 1.45, 1.5, 1.6, 1.7, 1.8, 1.25] * 3


def judge(job: LeasedJob) -> Completed:
    """Let missing the car ahead for 1.4 s, give or take 0.04 s, be unsafe; in hard rain, so are drives without it."""
    spec = job.spec
    errors = spec["behaviour"].get("errors", [])
    missed_s = max((one["magnitude"] for one in errors), default=0.0)
    least_s = 1.4 + 0.08 * (np.random.default_rng(spec["seed"] % 2**32).random() - 0.5)
    return outcome(missed_s > least_s or (not errors and spec["scenario"]["weather"] == "hard_rain"), {})
