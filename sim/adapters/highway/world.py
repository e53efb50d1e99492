"""The world of an episode: an environment of highway-env with the ego in it, in Brink's coordinates.

highway-env's y axis points to the right of x, Brink's to the left: both y and headings change sign here.
"""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from highway_env.envs.highway_env import HighwayEnv
from highway_env.envs.intersection_env import IntersectionEnv
from highway_env.envs.merge_env import MergeGenericEnv
from highway_env.envs.roundabout_env import RoundaboutGenericEnv
from highway_env.road.lane import LineType

from brink.sim.adapters.highway.driver import (
    HIGHWAY_STEP_S,
    Driver,
    Ego,
    perceived_road,
    perceived_vehicle,
    wrapped,
)
from brink.sim.adapters.highway.perception import NearbyVehicle
from brink.sim.adapters.highway.specification import (
    STEPS_PER_S,
    STRAIGHT_ROADS,
    USUAL_MPS,
    Goal,
    HighwayScenario,
    RoadKind,
)
from brink.sim.adapters.recording import Actor, Perceived, Pose
from brink.sim.plane import Point, Rectangle, clearance_m
from brink.sim.requirements import Collision, CollisionKind, WorldSample
from brink.sim.trace import FloatArray, Surface

_NEAR_M: Final = 26.0
"""Bodies whose centres are farther away are not near."""
_AHEAD_M: Final = 60.0
_BESIDE_M: Final = 1.0
"""A vehicle whose rear is farther than this behind the ego's front is beside it, not ahead."""
_CORRIDOR_MARGIN_M: Final = 0.2
_CLEAR_M: Final = 20.0
_START_BRAKES_MPS2: Final = 4.0
_LANE_M: Final = 4.0
_SCENE_BEHIND_M: Final = 100.0
_ROUTE_EVERY_M: Final = 2.0
_ROUTE_M: Final = 900.0
_ARRIVED_AFTER_M: Final = 25.0
_MARKING_M: Final = 0.15
_DASH_M: Final = (3.0, 6.0)
"""Lengths of a dash, and of the gap after it."""
_PATH: Final = "brink.sim.adapters.highway.driver."
_VEHICLES: Final = 18
"""Other vehicles on a highway; density changes the distances between them."""
_NAMES: Final[Mapping[Goal, tuple[str, str]]] = {
    Goal.LEFT: ("wxr", "o1"),
    Goal.STRAIGHT: ("nxr", "o2"),
    Goal.RIGHT: ("exr", "o3"),
}
"""Where the ego leaves a roundabout and an intersection, as nodes of highway-env's road networks."""
_LINES: Final[Mapping[RoadKind, Mapping[tuple[str, str], float]]] = {
    RoadKind.ROUNDABOUT: {("ses", "se"): 5.0},
    RoadKind.INTERSECTION: {("o0", "ir0"): 0.5},
}
"""Lanes at whose ends the ego gives way, and how far before the end the line is."""


class _Near(NamedTuple):
    """Another vehicle, where it is relative to the ego, and its clearance if it is near."""

    vehicle: Any
    along_m: float
    aside_m: float | None


class HighwayWorld:
    """The world of one episode.

    Args:
        scenario: The scenario.
        seed: Determines the traffic.
    """

    def __init__(self, scenario: HighwayScenario, seed: int) -> None:
        self._scenario = scenario
        self._env = _environment(scenario, seed)
        road = self._env.road
        self._numbers: dict[Any, int] = {}
        original = self._env.vehicle
        usual_mps = USUAL_MPS[scenario.road]
        others = [vehicle for vehicle in road.vehicles if vehicle is not original]
        for vehicle in others:
            vehicle.speed *= scenario.traffic_speed
            vehicle.target_speed *= scenario.traffic_speed
        route = self._route(original)
        self.ego = Ego(
            road,
            original.position,
            original.heading,
            scenario.ego_speed * usual_mps,
            route=route,
            target_speed=scenario.target_speed * usual_mps,
        )
        road.vehicles[:] = [self.ego, *(v for v in others if self._leaves_room(v))]
        self._env.controlled_vehicles = [self.ego]
        self._view = perceived_road(road.network)
        self._driver = Driver(
            self._view,
            self.ego.position.copy(),
            self.ego.heading,
            self.ego.speed,
            route=route,
            target_speed=scenario.target_speed * usual_mps,
            enable_lane_change=scenario.road in STRAIGHT_ROADS,
        )
        self._driver.lines = _LINES.get(scenario.road, {})
        if scenario.road is RoadKind.ROUNDABOUT:
            circle = ("se", "ex", "ee", "nx", "ne", "wx", "we", "sx", "se")
            self._driver.watched = frozenset(itertools.pairwise(circle))
        self.route = self._route_line(original)
        self._start = original.position.copy()
        self._driven_m = 0.0
        self._accel_mps2 = 0.0
        self._nearest_m: float | None = None
        self._around: list[_Near] = []
        self._look_around()

    def _route(self, ego: Any) -> list[Any] | None:
        """Return the ego's route as lanes; None if it chooses its lanes itself."""
        goal, road = self._scenario.goal, self._scenario.road
        network = self._env.road.network
        if road in STRAIGHT_ROADS:
            if goal is Goal.STRAIGHT:
                return None
            segments = [("0", "1")] if road is RoadKind.HIGHWAY else [("a", "b"), ("b", "c"), ("c", "d")]
            lanes = len(network.graph[segments[0][0]][segments[0][1]])
            return [(*segment, 0 if goal is Goal.LEFT else lanes - 1) for segment in segments]
        node = _NAMES[goal][road is RoadKind.INTERSECTION]
        path = network.shortest_path(ego.lane_index[1], node)
        return [ego.lane_index, *((one, other, None) for one, other in itertools.pairwise(path))]

    def _leaves_room(self, vehicle: Any) -> bool:
        """Return whether the ego and a vehicle near its start can avoid each other by braking."""
        ego = self.ego
        if float(np.linalg.norm(vehicle.position - ego.position)) < _CLEAR_M:
            return False
        if vehicle.lane_index != ego.lane_index:
            return True
        ahead_m = float(ego.lane_distance_to(vehicle))
        faster, slower = (ego, vehicle) if ahead_m > 0 else (vehicle, ego)
        needed_m = max(faster.speed**2 - slower.speed**2, 0.0) / (2.0 * _START_BRAKES_MPS2)
        return bool(abs(ahead_m) - 2.0 * ego.LENGTH > needed_m)

    def _route_line(self, ego: Any) -> FloatArray:
        """Return the centre line of the ego's lane, and of those that it will take unless it changes lanes."""
        network, start = self._env.road.network, ego.lane_index
        lanes = [start]
        for one, other, _ in self.ego.route or []:
            if (one, other) != start[:2] and self._scenario.road not in STRAIGHT_ROADS:
                lanes.append((one, other, None))
        if self._scenario.road is RoadKind.MERGE:
            lanes += [("b", "c", start[2]), ("c", "d", start[2])]
        length_m = sum(network.get_lane((*index[:2], index[2] or 0)).length for index in lanes)
        first_m = ego.lane.local_coordinates(ego.position)[0]
        stations = np.arange(first_m, min(length_m, first_m + _ROUTE_M), _ROUTE_EVERY_M)
        places = [network.position_heading_along_route(lanes, s, 0.0, start)[0] for s in stations]
        return np.array([_mirrored(place) for place in places], np.float32).reshape(-1, 2)

    @property
    def arrived(self) -> bool:
        """Whether the ego has left the part of the road that matters."""
        if self._scenario.road is RoadKind.HIGHWAY:
            return False
        if self._scenario.road is RoadKind.MERGE:
            return bool(self.ego.position[0] > self._env.end_position)
        node = _NAMES[self._scenario.goal][self._scenario.road is RoadKind.INTERSECTION]
        along_m = self._driver.lane.local_coordinates(self.ego.position)[0]
        return bool(self._driver.lane_index[1] == node and along_m >= _ARRIVED_AFTER_M)

    @property
    def pose(self) -> Pose:
        """The ego's pose."""
        return _pose(self.ego)

    @property
    def accel_mps2(self) -> float:
        """The ego's acceleration in the last step."""
        return self._accel_mps2

    @property
    def target_speed_mps(self) -> float:
        """Speed at which the ego wants to drive."""
        return float(self._driver.target_speed)

    @property
    def ego_size_m(self) -> tuple[float, float]:
        """Length and width of the ego."""
        return self.ego.LENGTH, self.ego.WIDTH

    def actors(self) -> dict[str, tuple[Actor, Pose]]:
        """Return the other vehicles by name."""
        return {
            self._name(near.vehicle): (
                Actor(kind="vehicle", length_m=near.vehicle.LENGTH, width_m=near.vehicle.WIDTH),
                _pose(near.vehicle),
            )
            for near in self._around
        }

    def bodies(self) -> list[NearbyVehicle]:
        """Return the other vehicles with their positions relative to the ego."""
        return [
            NearbyVehicle(
                number=self._number(near.vehicle),
                pose=_pose(near.vehicle),
                along_m=near.along_m,
                lane=None if near.aside_m is None else _lane_of(near.aside_m),
            )
            for near in self._around
        ]

    def decide(self, perceived: Sequence[Perceived]) -> str:
        """Let the driver decide the next step, and return its action in a word or two.

        Args:
            perceived: All that it knows of other vehicles. It knows the road, and what stands on it.
        """
        driver = self._driver
        true = {self._number(near.vehicle): near.vehicle for near in self._around}
        driver.position, driver.heading = self.ego.position.copy(), self.ego.heading
        driver.speed = self.ego.speed
        driver.on_state_update()
        self._view.objects = self._env.road.objects
        self._view.vehicles = [driver, *(self._perceived(one, true.get(one.track)) for one in perceived)]
        driver.act()
        driver.timer += HIGHWAY_STEP_S
        self.ego.target_lane_index = driver.target_lane_index
        self.ego.act(dict(driver.action))
        return self._plan()

    def _perceived(self, one: Perceived, true: Any) -> Any:
        pose = one.pose
        position, heading = _mirrored((pose.x_m, pose.y_m)), -pose.yaw_rad
        exact = true is not None and position == tuple(true.position)
        lane_index = true.lane_index if exact else None
        return perceived_vehicle(self._view, position, heading, pose.speed_mps, lane_index)

    def _plan(self) -> str:
        driver = self._driver
        if driver.waits:
            return "yield"
        if (
            driver.lane_index[:2] == driver.target_lane_index[:2]
            and driver.lane_index != driver.target_lane_index
        ):
            return "change lane"
        free_mps2 = float(driver.acceleration(driver))
        braking = driver.action["acceleration"] < free_mps2 - 0.5
        return "stop" if driver.action["acceleration"] < -4.0 else "follow" if braking else "cruise"

    def step(self) -> None:
        """Move everybody by one step."""
        speed_mps, place = self.ego.speed, self.ego.position.copy()
        self._env.step(None)
        self._accel_mps2 = float(self.ego.speed - speed_mps) / HIGHWAY_STEP_S
        self._driven_m += float(np.linalg.norm(self.ego.position - place))
        self._driver.position, self._driver.heading = self.ego.position.copy(), self.ego.heading
        self._driver.on_state_update()
        self._look_around()

    def _look_around(self) -> None:
        """Locate the other vehicles relative to the ego's path."""
        way = list(self._way())
        here_m = way[0][0].local_coordinates(self.ego.position)[0]
        self._around = []
        for vehicle in self._env.road.vehicles:
            if vehicle is not self.ego:
                along_m, aside_m = _located(way, here_m, vehicle.position)
                self._around.append(_Near(vehicle, along_m, aside_m))

    def _way(self) -> Iterator[tuple[Any, float]]:
        """Yield the lanes that the ego will take, and the station on its present lane at which each begins."""
        network, driver = self._env.road.network, self._driver
        index, begins_m = driver.lane_index, 0.0
        route = {lane[0]: lane for lane in driver.route or []}
        here_m = network.get_lane(index).local_coordinates(self.ego.position)[0]
        while True:
            lane = network.get_lane(index)
            yield lane, begins_m
            begins_m += lane.length
            following = network.graph.get(index[1], {})
            if begins_m - here_m > _AHEAD_M + 40.0 or not following:
                return
            node = route[index[1]][1] if index[1] in route else next(iter(following))
            number, _ = network.next_lane_given_next_road(*index, node, None, lane.position(lane.length, 0.0))
            index = (index[1], node, number)

    def measure(self, time_s: float) -> WorldSample:
        """Return the exact facts about the ego at a time."""
        ego, lane = self.ego, self._driver.lane
        along_m, aside_m = lane.local_coordinates(ego.position)
        pose = self.pose
        body = _outline(self.ego)
        nearest, front_m = self._gaps(body, aside_m)
        nearest_m = None if nearest is None else nearest[0]
        closing_mps = 0.0
        if nearest_m is not None and self._nearest_m is not None:
            closing_mps = (self._nearest_m - nearest_m) / HIGHWAY_STEP_S
        self._nearest_m = nearest_m
        half_lane_m = 0.5 * float(lane.width_at(along_m))
        return WorldSample(
            time_s=time_s,
            x_m=pose.x_m,
            y_m=pose.y_m,
            yaw_rad=pose.yaw_rad,
            speed_mps=pose.speed_mps,
            station_m=self._driven_m,
            offset_m=-float(aside_m),
            heading_error_rad=-wrapped(ego.heading - float(lane.heading_at(along_m))),
            ego_length_m=ego.LENGTH,
            ego_width_m=ego.WIDTH,
            lane_left_m=half_lane_m,
            lane_right_m=-half_lane_m,
            speed_limit_mps=float(lane.speed_limit),
            front_gap_m=front_m,
            nearest_gap_m=nearest_m,
            closing_speed_mps=closing_mps,
            collision=self._collision(nearest),
            may_wait=self._driver.waits or (front_m is not None and front_m < 10.0),
            goal_reached=self.arrived,
        )

    def _gaps(self, body: Any, aside_m: float) -> tuple[tuple[float, Any] | None, float | None]:
        """Return the clearance to the nearest body and which one that is, and the front gap."""
        ego = self.ego
        nearest: tuple[float, Any] | None = None
        front_m: float | None = None
        objects = [_Near(one, -math.inf, None) for one in self._env.road.objects]
        for near in [*self._around, *objects]:
            vehicle = near.vehicle
            distance_m = float(np.linalg.norm(vehicle.position - ego.position))
            ahead = self._is_ahead(near, aside_m) and distance_m < _AHEAD_M
            if not ahead and distance_m > _NEAR_M:
                continue
            gap_m = clearance_m(body, _outline(vehicle))
            if nearest is None or gap_m < nearest[0]:
                nearest = gap_m, vehicle
            if ahead and (front_m is None or gap_m < front_m):
                front_m = gap_m
        return nearest, front_m

    def _is_ahead(self, near: _Near, aside_m: float) -> bool:
        """Return whether a vehicle is ahead in the corridor that the ego's body needs."""
        if near.aside_m is None or near.along_m <= 0.0:
            return False
        vehicle, ego = near.vehicle, self.ego
        turn = abs(wrapped(vehicle.heading - ego.heading))
        cosine, sine = abs(math.cos(turn)), abs(math.sin(turn))
        across_m = 0.5 * (vehicle.WIDTH * cosine + vehicle.LENGTH * sine + ego.WIDTH) + _CORRIDOR_MARGIN_M
        along_m = 0.5 * (vehicle.LENGTH * cosine + vehicle.WIDTH * sine + ego.LENGTH) - _BESIDE_M
        own_aside_m = aside_m if near.along_m < _NEAR_M else 0.0
        return bool(abs(near.aside_m - own_aside_m) < across_m and near.along_m > along_m)

    def _collision(self, nearest: tuple[float, Any] | None) -> Collision | None:
        if not self.ego.crashed or nearest is None:
            return None
        other = nearest[1]
        towards = other.position - self.ego.position
        distance_m = max(float(np.linalg.norm(towards)), 1e-6)
        closing_mps = float((self.ego.velocity - other.velocity).dot(towards)) / distance_m
        is_vehicle = other in self._numbers
        return Collision(
            kind=CollisionKind.VEHICLE if is_vehicle else CollisionKind.OBJECT,
            counterpart=self._name(other) if is_vehicle else "obstacle",
            impact_speed_mps=max(closing_mps, 0.0),
        )

    def _number(self, vehicle: Any) -> int:
        return self._numbers.setdefault(vehicle, len(self._numbers) + 1)

    def _name(self, vehicle: Any) -> str:
        return f"car-{self._number(vehicle)}"

    def scene(self, duration_s: float) -> list[Surface]:
        """Return the road as surfaces: the whole network, or the part of a long highway that the ego can reach.

        Args:
            duration_s: Length of the episode.
        """
        reach_m = _SCENE_BEHIND_M + self.ego.MAX_SPEED * duration_s
        lanes = self._env.road.network.lanes_list()
        spans = [_span(lane, self._start, reach_m) for lane in lanes]
        areas = [_area(lane, span) for lane, span in zip(lanes, spans, strict=True)]
        lines = [line for lane, span in zip(lanes, spans, strict=True) for line in _markings(lane, span)]
        objects = [
            Surface(kind="building", closed=True, width_m=0.0, points=np.array(_outline(one), np.float32))
            for one in self._env.road.objects
        ]
        return [*areas, *lines, *objects]


def _environment(scenario: HighwayScenario, seed: int) -> Any:
    """Return the environment of a scenario, reset with a seed."""
    traffic = "IntersectionTraffic" if scenario.road is RoadKind.INTERSECTION else "Traffic"
    config: dict[str, Any] = {
        "observation": {"type": "AttributesObservation", "attributes": ["time"]},
        "simulation_frequency": STEPS_PER_S,
        "policy_frequency": STEPS_PER_S,
        "neighbour_vehicles_connected_lanes": True,
        "duration": math.inf,
        "other_vehicles_type": _PATH + traffic,
    }
    match scenario.road:
        case RoadKind.HIGHWAY:
            kind, counts = HighwayEnv, {"vehicles_count": _VEHICLES, "vehicles_density": scenario.density}
            config["lanes_count"] = scenario.lanes
        case RoadKind.MERGE:
            kind, counts = MergeGenericEnv, {"vehicles_count": round(7 * scenario.density)}
            config["lanes_count"] = scenario.lanes
        case RoadKind.ROUNDABOUT:
            kind, counts = RoundaboutGenericEnv, {"vehicles_count": round(5 * scenario.density)}
            config["roundabout_lanes"] = 1
        case RoadKind.INTERSECTION:
            # Vehicles appear once a step here, and once a second in highway-env.
            counts = {
                "initial_vehicle_count": round(8 * scenario.density),
                "spawn_probability": 0.6 * HIGHWAY_STEP_S * scenario.density,
            }
            kind = IntersectionEnv
    # A new environment resets itself once, with a seed of its own: without vehicles, that costs nothing.
    env = kind({**config, "vehicles_count": 1, "initial_vehicle_count": 1})
    env.reset(seed=seed, options={"config": counts})
    return env


def _mirrored(position: Sequence[float]) -> tuple[float, float]:
    return float(position[0]), -float(position[1])


def _outline(body: Any) -> list[Point]:
    pose = _pose(body)
    return Rectangle(pose.x_m, pose.y_m, pose.yaw_rad, 0.5 * body.LENGTH, 0.5 * body.WIDTH).corners()


def _pose(body: Any) -> Pose:
    x_m, y_m = _mirrored(body.position)
    return Pose(x_m=x_m, y_m=y_m, yaw_rad=-float(body.heading), speed_mps=float(body.speed))


def _lane_of(aside_m: float) -> int | None:
    """Return the lane beside the ego's path in which an offset to the right lies; None beyond those lanes."""
    number = round(aside_m / _LANE_M)
    return number if abs(number) <= 1 else None


def _located(way: Sequence[tuple[Any, float]], here_m: float, position: Any) -> tuple[float, float | None]:
    """Return how far ahead along the ego's path a position lies, and how far to the right; None off the path."""
    best: tuple[float, float] | None = None
    for order, (lane, begins_m) in enumerate(way):
        along_m, aside_m = lane.local_coordinates(position)
        first_m = -_AHEAD_M if order == 0 else 0.0
        if first_m <= along_m <= lane.length and abs(aside_m) <= 1.5 * _LANE_M:
            found = begins_m + along_m - here_m, float(aside_m)
            if best is None or abs(found[1]) < abs(best[1]):
                best = found
    return (0.0, None) if best is None else best


def _span(lane: Any, start: Any, reach_m: float) -> tuple[float, float]:
    """Return the stations between which a lane is drawn."""
    at_m = lane.local_coordinates(start)[0] if lane.length > reach_m else 0.0
    return max(0.0, at_m - _SCENE_BEHIND_M), min(lane.length, at_m + reach_m)


def _line(lane: Any, first_m: float, last_m: float, aside_m: float) -> list[tuple[float, float]]:
    straight = type(lane).__name__ == "StraightLane"
    count = 2 if straight else max(2, math.ceil((last_m - first_m) / 2.0) + 1)
    return [_mirrored(lane.position(s, aside_m)) for s in np.linspace(first_m, last_m, count)]


def _area(lane: Any, span: tuple[float, float]) -> Surface:
    half_m = 0.5 * float(lane.width_at(0.0))
    points = [*_line(lane, *span, half_m), *reversed(_line(lane, *span, -half_m))]
    return Surface(kind="road", points=np.array(points, np.float32), closed=True, width_m=0.0)


def _markings(lane: Any, span: tuple[float, float]) -> Iterator[Surface]:
    half_m = 0.5 * float(lane.width_at(0.0))
    for kind, aside_m in zip(lane.line_types, (-half_m, half_m), strict=True):
        if kind == LineType.NONE:
            continue
        parts = [span]
        if kind == LineType.STRIPED:
            dash_m, gap_m = _DASH_M
            parts = [(s, min(s + dash_m, span[1])) for s in np.arange(*span, dash_m + gap_m)]
        for part in parts:
            points = np.array(_line(lane, *part, aside_m), np.float32)
            yield Surface(kind="marking", points=points, closed=False, width_m=_MARKING_M)
