"""A violation as the simulator of encounters tells it, with whatever a test changes."""

from typing import Any


def violation(
    requirement: str = "no-collision@1",
    *,
    ego: dict[str, Any] | None = None,
    other: dict[str, Any] | None = None,
    nobody: bool = False,
    collision: str | None = "vehicle",
) -> dict[str, Any]:
    """Return circumstances as the simulator of encounters tells them."""
    return {
        "requirement": requirement,
        "time_s": 4.0,
        "ego": {
            "speed_mps": 7.0,
            "accel_mps2": 0.0,
            "yaw_rate_radps": 0.0,
            "offset_m": 0.0,
            "offset_rate_mps": 0.0,
            "plan": "cruise",
        }
        | (ego or {}),
        "other": None
        if nobody
        else {
            "index": 1,
            "kind": "van",
            "action": "cut_in",
            "gap_m": -0.1,
            "bearing_rad": 0.0,
            "heading_rad": 0.0,
            "speed_mps": 4.0,
            "accel_mps2": 0.0,
            "in_way_s": 3.0,
        }
        | (other or {}),
        "place": {"station_m": 30.0, "element": "straight", "light": None},
        "collision": collision,
        "impact_speed_mps": 3.0,
    }
