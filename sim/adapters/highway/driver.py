"""The vehicles of an episode: the ego, the driver that controls it, and the other traffic.

The driver is highway-env's own model (IDM along the lane, MOBIL across lanes) in a road of its own, which holds only
what the ego perceives. In addition it gives way where its road enters another. All parameters of the models are set
here: some environments of highway-env change them for the whole process, which would change later episodes.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final, TypeAlias

import numpy as np
from highway_env.road.lane import CircularLane, StraightLane
from highway_env.road.road import Road
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.controller import ControlledVehicle, MDPVehicle
from highway_env.vehicle.kinematics import Vehicle

from brink.sim.adapters.highway.specification import STEPS_PER_S

HIGHWAY_STEP_S: Final = 1.0 / STEPS_PER_S
GIVE_WAY_WITHIN_M: Final = 45.0
"""Distance from the line at which the driver begins to look whether it must give way."""
BRAKES_MPS2: Final = 6.0
"""Strongest braking of the driver, also when it decides whether it can still stop at the line."""
_COMFORT_MPS2: Final = 3.0
_WARY_MPS2: Final = 4.0
_LINE_GAP_M: Final = 1.0
_STANDING_MPS: Final = 0.5
_STANDING_S: Final = 0.5
"""A car slower than that comes to a standstill in about this time."""
_WATCHED_M: Final = 90.0
_TIMES_S: Final = np.arange(0.0, 5.0, 0.25)
"""The times at which the driver compares ways when it decides whether to give way."""
_TICK_S: Final = 0.25
_MARGIN_TICKS: Final = 3
"""Two cars are in conflict if they need the same place within this many ticks."""
_CIRCLES_M: Final = np.array([-1.7, 0.0, 1.7])
_CIRCLE_RADIUS_M: Final = 1.4
"""A car is modelled as three circles in a row, somewhat larger than it is."""
Ways: TypeAlias = "np.ndarray[Any, np.dtype[np.float64]]"
"""Centres of a car's circles at each tick, shape ``(n, 3, 2)``."""


class _Models:
    """Parameters of IDM and MOBIL: highway-env's defaults."""

    ACC_MAX = 6.0
    COMFORT_ACC_MAX = 3.0
    COMFORT_ACC_MIN = -5.0
    DISTANCE_WANTED = 10.0
    TIME_WANTED = 1.5
    DELTA = 4.0
    POLITENESS = 0.0
    LANE_CHANGE_MIN_ACC_GAIN = 0.2
    LANE_CHANGE_MAX_BRAKING_IMPOSED = 2.0
    LANE_CHANGE_DELAY = 1.0


class _Forwards(IDMVehicle):  # type: ignore[misc]  # (highway-env has no types)
    """A vehicle that never reverses; plain IDM reverses when something is very close."""

    def act(self, action: Any = None) -> None:
        """Decide on steering and acceleration."""
        super().act()
        if not self.crashed:
            self.action["acceleration"] = max(
                self.action["acceleration"], -max(self.speed, 0.0) / HIGHWAY_STEP_S
            )


class Traffic(_Models, _Forwards):
    """Another vehicle."""


class IntersectionTraffic(_Models, _Forwards):
    """Another vehicle at an intersection, with the parameters of that environment."""

    COMFORT_ACC_MAX = 6.0
    COMFORT_ACC_MIN = -3.0
    DISTANCE_WANTED = 7.0


class Ego(MDPVehicle):  # type: ignore[misc]
    """The car under test in the world; it executes its driver's latest decision."""

    def act(self, action: Any = None) -> None:
        """Take over an action of the driver, if one is given."""
        if isinstance(action, dict):
            Vehicle.act(self, action)


class Driver(_Models, _Forwards):
    """The ego's driver, which knows only the vehicles on the road from `perceived_road`.

    Attributes:
        lines: Lanes at whose ends the driver gives way, with the distance of the line from the end.
        watched: Lanes on which it brakes for vehicles that are about to drive into its way.
        waits: Whether it is giving way.
    """

    lines: Mapping[tuple[str, str], float] = MappingProxyType({})
    watched: frozenset[tuple[str, str]] = frozenset()
    waits = False

    def act(self, action: Any = None) -> None:
        """Decide on steering and acceleration."""
        super().act()
        distance_m = self._to_line_m()
        watches = distance_m is not None or tuple(self.lane_index[:2]) in self.watched
        self.waits = watches and self._must_give_way()
        if self.waits:
            slowed_mps2 = -_WARY_MPS2 if distance_m is None else self._stopping_mps2(distance_m)
            slowed_mps2 = max(slowed_mps2, -max(self.speed, 0.0) / HIGHWAY_STEP_S)
            self.action["acceleration"] = max(-BRAKES_MPS2, min(self.action["acceleration"], slowed_mps2))

    def _to_line_m(self) -> float | None:
        """Return how far the front is from a line ahead at which it can still stop; None if there is none."""
        setback_m = self.lines.get(tuple(self.lane_index[:2]))
        if setback_m is None:
            return None
        along_m = self.lane.local_coordinates(self.position)[0]
        distance_m = float(self.lane.length - setback_m - along_m - 0.5 * self.LENGTH)
        stops_in_m = self.speed**2 / (2.0 * BRAKES_MPS2)
        return distance_m if stops_in_m - _LINE_GAP_M <= distance_m <= GIVE_WAY_WITHIN_M else None

    def _stopping_mps2(self, distance_m: float) -> float:
        """Return the acceleration with which it stops at the line."""
        room_m = max(distance_m - _LINE_GAP_M, 0.1)
        speed_mps = float(self.speed)
        if speed_mps < _STANDING_MPS:
            return -speed_mps / _STANDING_S
        needed_mps2 = speed_mps**2 / (2.0 * room_m)
        # Further away it may still accelerate, but not to more than it can lose in comfort.
        return -needed_mps2 if needed_mps2 > 0.6 * _COMFORT_MPS2 else _COMFORT_MPS2 - needed_mps2

    def _must_give_way(self) -> bool:
        own = self._own_way()
        for vehicle in self.road.vehicles:
            if (
                vehicle is self
                or vehicle.lane_index[:2] == self.lane_index[:2]
                or self._is_followed_by(vehicle)
            ):
                continue
            if np.linalg.norm(vehicle.position - self.position) > _WATCHED_M:
                continue
            if _in_conflict(own, _circles(list(_way_of(vehicle)))):
                return True
        return False

    def _is_followed_by(self, vehicle: Any) -> bool:
        behind = float(self.direction.dot(vehicle.position - self.position)) < 0.0
        return behind and float(self.direction.dot(vehicle.direction)) > 0.5

    def _own_way(self) -> Ways:
        """Return the ego's future positions if it did not give way."""
        lane_index, speed_mps = self.lane_index, max(self.speed, 0.0)
        target_mps = max(self.target_speed, 1.0)
        route = self.route or [lane_index]
        if route[0][:2] != lane_index[:2]:
            route = [lane_index, *route]
        along_m = self.lane.local_coordinates(self.position)[0]
        places = []
        for _ in _TIMES_S:
            places.append(self.road.network.position_heading_along_route(route, along_m, 0.0, lane_index))
            along_m += speed_mps * _TICK_S
            speed_mps = min(target_mps, speed_mps + _COMFORT_MPS2 * _TICK_S)
        return _circles(places)


def _circles(places: Sequence[tuple[Any, float]]) -> Ways:
    """Return the circles of a car at positions with headings."""
    headings = np.array([heading for _, heading in places])
    along = np.column_stack([np.cos(headings), np.sin(headings)])
    centres: Ways = np.array([position for position, _ in places])[:, None, :] + (
        _CIRCLES_M[None, :, None] * along[:, None, :]
    )
    return centres


def _in_conflict(own: Ways, other: Ways) -> bool:
    """Return whether two cars need the same place at about the same time."""
    ticks = len(own)
    for shift in range(-_MARGIN_TICKS, _MARGIN_TICKS + 1):
        mine = own[max(shift, 0) : ticks + min(shift, 0)]
        theirs = other[max(-shift, 0) : ticks - max(shift, 0)]
        apart = mine[:, :, None, :] - theirs[:, None, :, :]
        if float((apart**2).sum(axis=-1).min()) < (2.0 * _CIRCLE_RADIUS_M) ** 2:
            return True
    return False


def _way_of(vehicle: Any) -> Iterator[tuple[Any, float]]:
    """Yield where a vehicle will be if it keeps its speed: on around a roundabout, straight on at an intersection."""
    network = vehicle.road.network
    index, lane = vehicle.lane_index, vehicle.lane
    along_m, aside_m = lane.local_coordinates(vehicle.position)
    for time_s in _TIMES_S:
        at_m = along_m + vehicle.speed * time_s
        while at_m > lane.length:
            following = _straight_on(network, index, lane)
            if following is None:
                break
            at_m, along_m = at_m - lane.length, along_m - lane.length
            index = following
            lane = network.get_lane(index)
        yield lane.position(at_m, aside_m), lane.heading_at(at_m)


def _straight_on(network: Any, index: Any, lane: Any) -> Any:
    """Return the lane that continues one of the same shape; None if none does."""
    shape = CircularLane if isinstance(lane, CircularLane) else StraightLane
    found = None
    for node, lanes in network.graph.get(index[1], {}).items():
        number = index[2] if index[2] < len(lanes) else len(lanes) - 1
        if found is None or isinstance(lanes[number], shape):
            found = (index[1], node, number)
            if type(lanes[number]) is shape:
                break
    return found


def perceived_vehicle(
    road: Road, position: Sequence[float], heading: float, speed: float, lane_index: Any = None
) -> ControlledVehicle:
    """Return a vehicle as the driver perceives it: where it is, but neither its route nor its intentions.

    Args:
        road: The road from `perceived_road`.
        position: In highway-env's coordinates, as all else here.
        heading: Its heading.
        speed: Its speed.
        lane_index: Its lane if that is known; finding it takes time.
    """
    vehicle = ControlledVehicle(None, position, heading, speed)
    vehicle.road = road
    if lane_index is None:
        lane_index = road.network.get_closest_lane_index(vehicle.position, heading)
    vehicle.lane_index = vehicle.target_lane_index = lane_index
    vehicle.lane = road.network.get_lane(lane_index)
    return vehicle


def perceived_road(network: Any) -> Road:
    """Return a road without vehicles for the driver."""
    return Road(network=network, np_random=np.random.default_rng(0), neighbour_vehicles_connected_lanes=True)


def wrapped(angle_rad: float) -> float:
    """Return an angle in [-pi, pi)."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi
