"""Owns what a script needs to know of a road. Imports nothing heavy."""

from dataclasses import dataclass

from brink.sim.world.road import PARKING_STRIP_M, build_road
from brink.sim.world.scenario import UrbanScenario


@dataclass(frozen=True, slots=True, kw_only=True)
class Lanes:
    """What a script needs to know of a road. Offsets count from the middle of the ego's first lane.

    Attributes:
        lane_width_m: Of each of the two lanes; the oncoming one is to the left.
        strip_m: Between a lane and the kerb, where cars are parked.
        pavement_m: Width of each pavement.
        crossing_streets_m: Stations of the middles of streets that cross the road.
    """

    lane_width_m: float
    strip_m: float
    pavement_m: float
    crossing_streets_m: tuple[float, ...]


def lanes_of(place: UrbanScenario) -> Lanes:
    """Return what a script needs to know of the road of a place."""
    road = build_road(place.road_curve, place.road_id, place.road_length)
    return Lanes(
        lane_width_m=road.style.lane_width_m,
        strip_m=PARKING_STRIP_M if road.style.parking else 0.0,
        pavement_m=road.style.pavement_m,
        crossing_streets_m=tuple(j.forward_m for j in road.junctions if j.left and j.right),
    )
