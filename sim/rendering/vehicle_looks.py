"""Owns the looks of vehicles: proportions of cars and vans, and their colours."""

from dataclasses import dataclass
from typing import Final

from brink.sim.rendering.looks import choice, share

Rgb = tuple[float, float, float]

_PAINTS: Final[tuple[Rgb, ...]] = (
    (236, 236, 232),
    (26, 27, 30),
    (168, 172, 176),
    (96, 100, 106),
    (176, 28, 30),
    (30, 62, 132),
    (222, 222, 214),
    (42, 74, 58),
    (198, 176, 138),
    (226, 178, 32),
    (66, 124, 164),
    (112, 34, 44),
    (58, 60, 66),
    (206, 96, 36),
)
_VAN_PAINTS: Final[tuple[Rgb, ...]] = (
    (238, 238, 235),
    (228, 229, 226),
    (200, 204, 206),
    (44, 74, 132),
    (214, 168, 38),
    (150, 40, 38),
    (64, 68, 74),
)
VAN_FROM_M: Final = 1.9


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """Proportions: x as shares of the length from the middle, z of the height, widths of the width."""

    nose_z: float
    belt_z: float
    base_front: float
    base_rear: float
    roof_front: float
    roof_rear: float
    base_width: float = 0.94
    roof_width: float = 0.76
    nose_width: float = 0.84
    tail_width: float = 0.88
    wheel_front: float = 0.305
    wheel_rear: float = -0.295
    windows: tuple[tuple[float, float], ...] = ((0.05, 0.47), (0.53, 0.95))
    rear_glass: float = 0.16


_CARS: Final = (
    Shape(nose_z=0.50, belt_z=0.61, base_front=0.23, base_rear=-0.475, roof_front=0.05, roof_rear=-0.37),
    Shape(nose_z=0.49, belt_z=0.61, base_front=0.21, base_rear=-0.385, roof_front=0.03, roof_rear=-0.23),
    Shape(
        nose_z=0.55,
        belt_z=0.63,
        base_front=0.25,
        base_rear=-0.485,
        roof_front=0.09,
        roof_rear=-0.44,
        windows=((0.04, 0.33), (0.37, 0.66), (0.70, 0.95)),
    ),
    Shape(nose_z=0.52, belt_z=0.60, base_front=0.27, base_rear=-0.48, roof_front=0.08, roof_rear=-0.34),
)
_VANS: Final = (
    Shape(
        nose_z=0.40,
        belt_z=0.49,
        base_front=0.43,
        base_rear=-0.495,
        roof_front=0.26,
        roof_rear=-0.49,
        base_width=0.985,
        roof_width=0.90,
        nose_width=0.88,
        tail_width=0.97,
        wheel_front=0.33,
        windows=((0.80, 0.965),),
        rear_glass=0.3,
    ),
    Shape(
        nose_z=0.41,
        belt_z=0.50,
        base_front=0.43,
        base_rear=-0.495,
        roof_front=0.27,
        roof_rear=-0.485,
        base_width=0.985,
        roof_width=0.89,
        nose_width=0.88,
        tail_width=0.97,
        wheel_front=0.33,
        windows=((0.04, 0.26), (0.29, 0.51), (0.54, 0.76), (0.80, 0.965)),
    ),
)


def shape_of(look: int, height_m: float) -> Shape:
    """Return the proportions of a vehicle: a van's from a certain height on."""
    shapes = _VANS if height_m >= VAN_FROM_M else _CARS
    return shapes[choice(look, 3, len(shapes))]


def paint_of(look: int, height_m: float) -> Rgb:
    """Return the colour of a vehicle's body."""
    paints = _VAN_PAINTS if height_m >= VAN_FROM_M else _PAINTS
    base = paints[choice(look, 1, len(paints))]
    shade = 0.93 + 0.14 * share(look, 2)
    return base[0] * shade, base[1] * shade, base[2] * shade
