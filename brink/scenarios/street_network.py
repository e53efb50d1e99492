"""The road network of the emergency brake's street: one straight, level road."""

import math
from typing import Final

from brink.scenarios.network import Dashes, Lane, LaneKind, RoadNetwork, RoadObject, RoadPart
from brink.sim.aeb.street import BEGIN_M, END_M, LANE_M, PAVEMENT_M, STRIP_M, Street
from brink.sim.world.line import Piece, ReferenceLine

SPARE_M: Final = 20.0
"""The road continues this far beyond the last road user."""
BUILDINGS_BEYOND_M: Final = 30.0
"""The last buildings stand up to this far beyond the end of the street."""
CENTRE_LINE_WIDTH_M: Final = 0.12
EDGE_LINE_WIDTH_M: Final = 0.1
DASH_M: Final = 3.0
LAMP_WIDTH_M: Final = 0.2


def street_network(street: Street, first_x_m: float, last_x_m: float) -> RoadNetwork:
    """Return the network of a street, at least as long as the street.

    Args:
        street: The street.
        first_x_m: Smallest x of all road users.
        last_x_m: Greatest x of all road users.
    """
    from_m, to_m = min(BEGIN_M, first_x_m - SPARE_M), max(END_M + BUILDINGS_BEYOND_M, last_x_m + SPARE_M)
    lanes = (
        Lane(LaneKind.DRIVING, LANE_M),
        Lane(LaneKind.PARKING, STRIP_M),
        Lane(LaneKind.SIDEWALK, PAVEMENT_M),
    )
    road = RoadPart(
        id=1,
        name="street",
        line=ReferenceLine(from_m, 0.0, 0.0, (Piece(to_m - from_m),)),
        left=lanes,
        right=lanes,
        middle=Dashes(width_m=CENTRE_LINE_WIDTH_M, dash_m=DASH_M, first_m=BEGIN_M - from_m),
        lane_edge_m=EDGE_LINE_WIDTH_M,
        objects=tuple(_objects(street, from_m)),
    )
    return RoadNetwork(name="Brink street", roads=(road,))


def _objects(street: Street, from_m: float) -> list[RoadObject]:
    scene = street.scene
    placed = [
        ("building", one.x_m, one.y_m, one.yaw_rad, one.length_m, one.width_m, one.height_m)
        for one in scene.buildings
    ]
    placed += [("tree", one.x_m, one.y_m, 0.0, one.crown_m, 0.0, one.height_m) for one in scene.trees]
    placed += [
        ("streetLamp", one.x_m, one.y_m, one.yaw_rad, LAMP_WIDTH_M, 0.0, one.height_m) for one in scene.lamps
    ]
    return [
        RoadObject(
            kind=kind,
            name=f"{kind} {index}",
            s_m=x_m - from_m,
            t_m=y_m,
            heading_rad=math.remainder(yaw_rad, 2.0 * math.pi),
            length_m=length_m,
            width_m=width_m,
            height_m=height_m,
        )
        for index, (kind, x_m, y_m, yaw_rad, length_m, width_m, height_m) in enumerate(placed, start=1)
    ]
