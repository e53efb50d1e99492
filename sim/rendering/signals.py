"""Traffic lights: a post, a housing, and three lamps of which those are on that the state tells.

A model stands on the origin and faces along x, in metres.
"""

import math
from functools import lru_cache
from typing import Final

from brink.sim.driving.interface import LightState
from brink.sim.rendering.scene import Rgb, TrafficLight
from brink.sim.rendering.solids import Face, Finish, Group, Mesh, make_mesh

_LAMPS: Final[tuple[tuple[LightState, Rgb], ...]] = (
    (LightState.RED, (255, 40, 30)), (LightState.AMBER, (255, 176, 26)), (LightState.GREEN, (44, 240, 150)),
)  # fmt: skip
"""Colours of the lamps, from top to bottom."""
_DARK: Final = 0.2
"""Brightness of a lamp that is off."""
_HOUSING: Final[Rgb] = (26, 30, 30)
_POST: Final[Rgb] = (112, 116, 118)
_POST_M: Final = 0.06
_BACK_M: Final = 0.07
_FRONT_M: Final = 0.25
_HALF_M: Final = 0.2
_LAMP_RADIUS_M: Final = 0.15
"""Lamps have a diameter of 300 mm, the larger one of the two that EN 12368 knows."""
_LAMP_EVERY_M: Final = 0.36
_CORNERS: Final = 12


@lru_cache(maxsize=16)
def make_traffic_light_mesh(height_m: float, state: LightState | None) -> Mesh:
    """Return the model of a traffic light.

    Args:
        height_m: Height of its upper end.
        state: What it shows; None if it is off.
    """
    low_m = height_m - _LAMP_EVERY_M * len(_LAMPS)
    faces = [
        *_box((-_POST_M, -_POST_M, 0.0), (_POST_M, _POST_M, height_m), _POST, Group.LOWER),
        *_box((_BACK_M, -_HALF_M, low_m), (_FRONT_M, _HALF_M, height_m), _HOUSING, Group.CABIN),
    ]
    for number, (shown, rgb) in enumerate(_LAMPS):
        middle_m = _lamp_m(height_m, number)
        turns = [math.tau * corner / _CORNERS for corner in range(_CORNERS)]
        disc = [
            (_FRONT_M, _LAMP_RADIUS_M * math.cos(turn), middle_m + _LAMP_RADIUS_M * math.sin(turn))
            for turn in turns
        ]
        if state is shown:
            faces.append(Face(disc, rgb, Group.DISCS, finish=Finish.LIT))
        else:
            red, green, blue = rgb
            dark = (_DARK * red, _DARK * green, _DARK * blue)
            faces.append(Face(disc, dark, Group.DISCS, finish=Finish.FLAT, shown_px=20.0))
    return make_mesh(faces, floor=((1.0, 0.0, 0.0), _POST_M), belt=((1.0, 0.0, 0.0), _POST_M))


def lit_lamp(light: TrafficLight, state: LightState) -> tuple[tuple[float, float, float], Rgb]:
    """Return the position in the world and the colour of the lamp that is on."""
    number = [shown for shown, _ in _LAMPS].index(state)
    x_m = light.x_m + _FRONT_M * math.cos(light.yaw_rad)
    y_m = light.y_m + _FRONT_M * math.sin(light.yaw_rad)
    return (x_m, y_m, _lamp_m(light.height_m, number)), _LAMPS[number][1]


def _lamp_m(height_m: float, number: int) -> float:
    """Return the height of a lamp's middle."""
    return height_m - (number + 0.5) * _LAMP_EVERY_M


def _box(
    low: tuple[float, float, float], high: tuple[float, float, float], rgb: Rgb, group: Group
) -> list[Face]:
    (x0, y0, z0), (x1, y1, z1) = low, high
    sides = (
        [(x1, y0, z0), (x1, y1, z0), (x1, y1, z1), (x1, y0, z1)],
        [(x0, y0, z0), (x0, y0, z1), (x0, y1, z1), (x0, y1, z0)],
        [(x0, y1, z0), (x0, y1, z1), (x1, y1, z1), (x1, y1, z0)],
        [(x0, y0, z0), (x1, y0, z0), (x1, y0, z1), (x0, y0, z1)],
        [(x0, y0, z1), (x1, y0, z1), (x1, y1, z1), (x0, y1, z1)],
        [(x0, y0, z0), (x0, y1, z0), (x1, y1, z0), (x1, y0, z0)],
    )
    return [Face(corners, rgb, group) for corners in sides]
