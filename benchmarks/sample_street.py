"""A sample street and traffic for the contact sheet and the rendering benchmark."""

import math
from typing import Final

import numpy as np

from brink.sim.rendering.furniture import FURNITURE_SIZE_M
from brink.sim.rendering.scene import (
    Body,
    BodyKind,
    Building,
    FloatArray,
    Furniture,
    FurnitureKind,
    Ground,
    Lamp,
    Material,
    StreetScene,
    Tree,
    Viewpoint,
)

EGO: Final = Viewpoint(x_m=0.0, y_m=-1.75, yaw_rad=0.0)
_CAR: Final = (4.4, 1.8, 1.5)
_VAN: Final = (5.6, 2.0, 2.3)


def sample_street(*, parked: int = 8, houses: int = 8, trees: int = 7) -> StreetScene:
    """Return a straight street with a pedestrian crossing.

    Args:
        parked: Number of parked vehicles.
        houses: Number of buildings on each side.
        trees: Number of trees on each side.
    """
    return StreetScene(
        ground=tuple(_ground()),
        buildings=tuple(_house(number, side) for number in range(houses) for side in (1, -1)),
        trees=tuple(_tree(number, side) for number in range(trees) for side in (1, -1)),
        parked=tuple(_parked(number) for number in range(parked)),
        lamps=tuple(
            Lamp(x_m=10.0 + 13.0 * number, y_m=side * 6.3, yaw_rad=-side * math.pi / 2)
            for number, side in enumerate((1, -1) * 4)
        ),
        furniture=tuple(_furniture(number, kind) for number, kind in enumerate(FurnitureKind)),
    )


def sample_traffic(phase: float = 1.0) -> tuple[Body, ...]:
    """Return four driving vehicles and eight walking people."""
    return (
        vehicle(1, 17.0, -1.75, braking=True),
        vehicle(2, 30.0, 1.75, yaw_rad=math.pi),
        vehicle(3, 46.0, 1.75, yaw_rad=math.pi, van=True),
        vehicle(4, 62.0, -1.75),
        person(11, 10.0, -6.9, yaw_rad=0.0, phase=phase),
        person(12, 13.0, 7.0, yaw_rad=math.pi, phase=phase + 1.0, height_m=1.62),
        person(13, 24.0, 2.5, yaw_rad=-math.pi / 2, phase=phase + 0.4),
        person(14, 25.5, -3.4, yaw_rad=math.pi / 2, phase=phase + 2.0, height_m=1.15),
        person(15, 20.0, -6.6, yaw_rad=math.pi, phase=phase + 3.0, height_m=1.86),
        person(16, 33.0, 6.9, yaw_rad=0.0, phase=phase),
        person(17, 18.0, 6.7, yaw_rad=0.2, phase=phase + 4.0),
        person(18, 41.0, -6.8, yaw_rad=0.0, phase=phase + 0.7),
    )


def vehicle(
    number: int,
    x_m: float,
    y_m: float,
    *,
    yaw_rad: float = 0.0,
    look: int | None = None,
    braking: bool = False,
    van: bool = False,
    kind: BodyKind = BodyKind.VEHICLE,
) -> Body:
    """Return a car or a van.

    Args:
        number: Id.
        x_m: Position.
        y_m: Position.
        yaw_rad: Heading.
        look: Selects colour and shape; derived from the id by default.
        braking: Whether the brake lights are on.
        van: Whether it is a van.
        kind: Upright or overturned.
    """
    length_m, width_m, height_m = _VAN if van else _CAR
    return Body(
        id=number,
        kind=kind,
        x_m=x_m,
        y_m=y_m,
        yaw_rad=yaw_rad,
        length_m=length_m,
        width_m=width_m,
        height_m=height_m,
        look=number * 31 if look is None else look,
        braking=braking,
    )


def person(
    number: int, x_m: float, y_m: float, *, yaw_rad: float, phase: float = 1.0, height_m: float = 1.74
) -> Body:
    """Return a walking person.

    Args:
        number: Id.
        x_m: Position.
        y_m: Position.
        yaw_rad: Heading.
        phase: Phase of the walk in radians.
        height_m: Height.
    """
    return Body(
        id=number,
        kind=BodyKind.PERSON,
        x_m=x_m,
        y_m=y_m,
        yaw_rad=yaw_rad,
        length_m=0.5,
        width_m=0.5,
        height_m=height_m,
        look=number * 17,
        phase=phase,
    )


def fallen_tree(number: int, x_m: float, y_m: float, *, yaw_rad: float) -> Body:
    """Return a tree that lies on the road.

    Args:
        number: Id.
        x_m: Position of the centre.
        y_m: Position of the centre.
        yaw_rad: Direction of the crown.
    """
    return Body(
        id=number,
        kind=BodyKind.FALLEN_TREE,
        x_m=x_m,
        y_m=y_m,
        yaw_rad=yaw_rad,
        length_m=7.0,
        width_m=2.6,
        height_m=1.5,
        look=number,
    )


def _rectangle(from_m: float, to_m: float, right_m: float, left_m: float) -> FloatArray:
    return np.array([(from_m, right_m), (to_m, right_m), (to_m, left_m), (from_m, left_m)], dtype=np.float64)


def _ground() -> list[Ground]:
    surfaces = [
        Ground(material=material, points=_rectangle(-40.0, 220.0, -half_m, half_m))
        for material, half_m in (
            (Material.PAVEMENT, 8.4),
            (Material.KERB, 5.95),
            (Material.GUTTER, 5.75),
            (Material.ASPHALT, 5.6),
        )
    ]
    for number in range(42):
        from_m = -40.0 + 6.0 * number
        if not 19.0 < from_m < 28.0:
            surfaces.append(
                Ground(material=Material.MARKING, points=_rectangle(from_m, from_m + 3.0, -0.08, 0.08))
            )
    surfaces += [
        Ground(material=Material.CROSSING, points=_rectangle(23.5, 26.5, y_m - 0.25, y_m + 0.25))
        for y_m in np.arange(-5.0, 5.5, 1.0).tolist()
    ]
    return surfaces


def _house(number: int, side: int) -> Building:
    return Building(
        x_m=-14.0 + 15.0 * number + (5.0 if side < 0 else 0.0),
        y_m=side * 13.2,
        yaw_rad=0.0,
        length_m=12.0 + number % 3,
        width_m=8.0,
        height_m=7.0 + 3.0 * ((number + side) % 4),
        look=7 * number + 3 * (side > 0),
    )


def _tree(number: int, side: int) -> Tree:
    return Tree(
        x_m=8.0 + 13.0 * number + 3.0 * side,
        y_m=side * 6.7,
        height_m=6.0 + 0.6 * (number % 3),
        crown_m=3.4 + 0.4 * (number % 2),
        look=2 * number + (side > 0),
    )


def _furniture(number: int, kind: FurnitureKind) -> Furniture:
    length_m, width_m, height_m = FURNITURE_SIZE_M[kind]
    side = 1 if number % 2 else -1
    return Furniture(
        kind=kind,
        x_m=9.0 + 3.3 * number,
        y_m=side * 8.2,
        yaw_rad=math.pi if number % 3 else 0.0,
        length_m=length_m,
        width_m=width_m,
        height_m=height_m,
        look=11 * number,
    )


def _parked(number: int) -> Body:
    side = 1 if number % 2 else -1
    x_m = 10.5 + 3.4 * number + (8.0 if number > 1 else 0.0)
    yaw_rad = math.pi if side > 0 else 0.0
    return vehicle(1001 + number, x_m, side * 4.65, yaw_rad=yaw_rad, van=number % 5 == 2)
