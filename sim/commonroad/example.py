"""A small recording of our own: a straight road with two lanes, and a car ahead that brakes."""

from typing import Any

from brink.sim.commonroad.recording import KINDS, delta_coded

_STEPS = 80
_BRAKES = 20
_SPEED_MPS = 10.0
_LEFT_M, _MIDDLE_M, _RIGHT_M = 5.25, 1.75, -1.75


def example_document() -> dict[str, Any]:
    """Return the recording's document: 8 s in which the car ahead brakes at 4 m/s² from 2 s on."""
    speeds = [max(0.0, _SPEED_MPS - 0.4 * max(0, step - _BRAKES)) for step in range(_STEPS + 1)]
    ways = [15.0]
    for speed in speeds[:-1]:
        ways.append(ways[-1] + 0.1 * speed)
    return {
        "version": 1,
        "name": "braking",
        "step_s": 0.1,
        "start": [0, 0, 0, round(1000 * _SPEED_MPS)],
        "start_step": 0,
        "goals": [
            {"areas": [], "lanelets": [1], "steps": [_STEPS, _STEPS], "speed_mps": None, "yaw_rad": None}
        ],
        "lanelets": [
            _lanelet(1, _MIDDLE_M, _RIGHT_M, beside_left=[2, True]),
            _lanelet(2, _LEFT_M, _MIDDLE_M, beside_right=[1, True]),
        ],
        "road_users": [
            {
                "id": 10,
                "kind": KINDS.index("car"),
                "length_m": 4.4,
                "width_m": 1.8,
                "first": 0,
                "stands": False,
                "states": [
                    delta_coded([round(1000 * way) for way in ways]),
                    [0] * (_STEPS + 1),
                    [0] * (_STEPS + 1),
                    delta_coded([round(1000 * speed) for speed in speeds]),
                ],
            }
        ],
    }


def _lanelet(number: int, left_m: float, right_m: float, **beside: list[Any]) -> dict[str, Any]:
    x = delta_coded([1000 * way for way in range(-50, 251, 10)])
    edges = {
        name: [x, delta_coded([round(1000 * offset_m)] * len(x))]
        for name, offset_m in (("left", left_m), ("right", right_m))
    }
    return {"id": number, **edges, "next": [], "kind": "urban", "limit": 13.9, **beside}
