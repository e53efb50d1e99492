"""Solutions of the urban problem that are pairs, and a judge of their episodes that needs no simulator."""

from typing import Any

from brink.server.problems.urban_injected import REQUIREMENTS, UrbanInjected
from brink.worker.wire import Completed, JobFailed, LeasedJob, WireVerdict

SPACE = UrbanInjected(UrbanInjected.params_type()).space
SCENARIO = {
    "time_of_day": "noon",
    "weather": "clear",
    "pedestrians": "0",
    "road_curve": "straight",
    "road_id": "0",
    "road_length": "0",
    "driving_task": "follow_road",
}
BOX = {
    "x_min_0_px": 300.0,
    "x_max_0_px": 400.0,
    "y_min_0_px": 250.0,
    "y_max_0_px": 400.0,
    "x_min_1_px": 100.0,
    "x_max_1_px": 500.0,
    "y_min_1_px": 250.0,
    "y_max_1_px": 500.0,
}
NONE: dict[str, Any] = {"label": "null", "t0_step": 0, "t1_step": 0, **dict.fromkeys(BOX, 0.0)}
LATEST_STEP = 150
"""A report that begins before this step is unsafe."""


def row(start: int, *, weather: str = "clear", **box: float) -> list[float]:
    """Return a solution with one report that begins at a step."""
    reports = ({"label": "person", "t0_step": start, "t1_step": 250, **BOX, **box}, NONE)
    values = {
        f"trajectory_{n}.{name}": value
        for n, one in enumerate(reports, start=1)
        for name, value in one.items()
    }
    vectors = SPACE.encode({"scenario": {**SCENARIO, "weather": weather}, "behaviour": values})
    return [float(value) for value in SPACE.join(vectors)]


SAFE, UNSAFE = row(152), row(148, x_min_0_px=302.0, x_max_1_px=501.0)
ICY_SAFE, ICY_UNSAFE = row(152, weather="hard_rain"), row(148, weather="hard_rain")


def judged(job: LeasedJob) -> Completed | JobFailed:
    """Return an unsafe outcome if a report begins early, or if ground truth meets hard rain."""
    behaviour, weather = job.spec["behaviour"], job.spec["scenario"]["weather"]
    unsafe = weather == "hard_rain"
    if behaviour["mode"] == "injected":
        unsafe = behaviour["trajectories"][0]["t0_step"] < LATEST_STEP
    verdict = WireVerdict(
        robustness=-1.0 if unsafe else 1.0, unit="m", violated_at_s=16.1 if unsafe else None
    )
    held = WireVerdict(robustness=2.0, unit="m", violated_at_s=None)
    return Completed(verdicts={**dict.fromkeys(REQUIREMENTS, held), "front-gap@1": verdict})
