"""The trace of an episode in SUMO: the roads around the ego's path, and the vehicles around the ego, from above."""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from brink.sim.adapters.recording import Actor, Perceived, Pose, TopDownRecorder
from brink.sim.adapters.sumo.facts import SumoFacts, VehicleState
from brink.sim.adapters.sumo.library import Library
from brink.sim.adapters.sumo.specification import RANGE_M
from brink.sim.driving.camera import Camera, Solid
from brink.sim.driving.interface import Box, ObstacleLabel
from brink.sim.episode import Json
from brink.sim.requirements import WorldSample
from brink.sim.trace import Surface, Trace

REACH_M: Final = 100.0
"""Roads and vehicles farther than this from the ego are left out."""
HEIGHT_M: Final = 1.6
"""Assumed height of vehicles in the sketch of a camera's image."""
BRAKES_MPS2: Final = -1.0
FOLLOWS_WITHIN_S: Final = 2.5
DASH_M: Final = 3.0
DASHES_EVERY_M: Final = 9.0
LINE_M: Final = 0.15
STOP_LINE_M: Final = 0.5
MAX_ROUTE_M: Final = 3000.0
ROUTE_EVERY_M: Final = 3.0
"""Distance of the points of a route: replays take the direction of the road from the nearest two."""
PIECE_M: Final = 20.0
"""Length of the parts in which roads are kept or left out."""

Points = NDArray[np.float64]


class Drawing:
    """Records the ego and everything around it.

    Args:
        sumo: The simulation.
        ego: Id of the ego.
        requirements: Ids of the requirements, in order.
        facts: Knows where vehicles are.
    """

    def __init__(self, sumo: Library, ego: str, requirements: Sequence[str], facts: SumoFacts) -> None:
        self._sumo = sumo
        self._ego = ego
        self._requirements = requirements
        self._facts = facts
        self._samples: list[dict[str, Any]] = []
        self._path: list[tuple[float, float]] = []
        self._collision: tuple[float, str] | None = None
        self._size_m = facts.body(ego).length_m, facts.body(ego).width_m
        self._numbers: dict[str, int] = {}
        self._roads = _Roads(sumo)
        self._route = self._roads.route(sumo.vehicle.getRoute(ego), sumo.vehicle.getLaneID(ego))

    def sample(self, sample: WorldSample, robustness: Mapping[str, float], gap_state: float) -> None:
        """Record a step.

        Args:
            sample: The facts about the ego.
            robustness: Robustness of each requirement.
            gap_state: By which share of its distance the ego perceives the vehicle ahead too far away.
        """
        facts = self._facts
        pose = Pose(x_m=sample.x_m, y_m=sample.y_m, yaw_rad=sample.yaw_rad, speed_mps=sample.speed_mps)
        self._path.append((sample.x_m, sample.y_m))
        bodies = self._around(sample)
        perceived = self._perceived(sample, bodies, gap_state)
        lead = None if facts.lead is None else bodies.get(facts.lead)
        self._samples.append(
            {
                "time_s": sample.time_s,
                "ego": pose,
                "accel_mps2": facts.accel_mps2,
                "actors": {name: (_actor(body), _pose(body)) for name, body in bodies.items()},
                "perceived": perceived,
                "seen": _boxes(sample, [] if lead is None else [lead]),
                "given": _boxes(sample, [_body(one) for one in perceived]),
                "plan": _plan(sample, facts.accel_mps2),
                "target_speed_mps": float(self._sumo.vehicle.getAllowedSpeed(self._ego)),
                "robustness": robustness,
                "light": "" if sample.light is None else sample.light.value,
            }
        )
        if sample.collision is not None:
            hit = sample.collision
            ahead = hit.counterpart == facts.lead
            who = f"the ego hits {hit.counterpart}" if ahead else f"{hit.counterpart} hits the ego"
            self._collision = sample.time_s, f"{who} at {hit.impact_speed_mps:.1f} m/s"

    def trace(self, about: Mapping[str, Json]) -> Trace:
        """Return the trace, after the simulation has ended.

        Args:
            about: Its header.
        """
        path = np.array(self._path, np.float64)
        recorder = TopDownRecorder(
            self._requirements,
            ego_size_m=self._size_m,
            scene=self._roads.near(path),
            route=_float32(self._route),
        )
        for sample in self._samples:
            recorder.sample(**sample)
        if self._collision is not None:
            recorder.event(self._collision[0], "collision", self._collision[1])
        return recorder.trace(about)

    def _around(self, sample: WorldSample) -> dict[str, VehicleState]:
        """Return the bodies of the vehicles around the ego, by id."""
        own, bodies = self._sumo.vehicle, {}
        for vehicle in own.getIDList():
            if vehicle == self._ego:
                continue
            x_m, y_m = own.getPosition(vehicle)
            if math.hypot(x_m - sample.x_m, y_m - sample.y_m) < REACH_M:
                bodies[str(vehicle)] = self._facts.body(vehicle)
        return bodies

    def _perceived(
        self, sample: WorldSample, bodies: Mapping[str, VehicleState], gap_state: float
    ) -> tuple[Perceived, ...]:
        """Return the vehicle ahead, where the ego perceives it; nothing if it seems to be out of range."""
        lead = self._facts.lead
        body = None if lead is None else bodies.get(lead)
        if lead is None or body is None or sample.front_gap_m is None:
            return ()
        # SUMO scales the gap without the part that is kept at a standstill.
        kept_m = float(self._sumo.vehicle.getMinGap(self._ego))
        shift_m = max(gap_state, -1.0) * max(0.0, sample.front_gap_m - kept_m)
        if sample.front_gap_m + shift_m > RANGE_M:
            return ()
        heading = math.atan2(body.y_m - sample.y_m, body.x_m - sample.x_m)
        pose = Pose(
            x_m=body.x_m + shift_m * math.cos(heading),
            y_m=body.y_m + shift_m * math.sin(heading),
            yaw_rad=body.yaw_rad,
            speed_mps=body.speed_mps,
        )
        track = self._numbers.setdefault(lead, len(self._numbers) + 1)
        return (Perceived(track=track, pose=pose, length_m=body.length_m, width_m=body.width_m),)


def _boxes(sample: WorldSample, bodies: Sequence[VehicleState]) -> list[Box]:
    """Return bodies as boxes in the image of a camera, in which replays compare perception and truth."""
    camera, found = Camera(), []
    for one in bodies:
        solid = Solid(
            ObstacleLabel.VEHICLE, one.x_m, one.y_m, one.yaw_rad, one.length_m, one.width_m, HEIGHT_M
        )
        seen = camera.project(sample.x_m, sample.y_m, sample.yaw_rad, solid)
        if seen is not None:
            found.append(seen[0])
    return found


def _body(perceived: Perceived) -> VehicleState:
    pose = perceived.pose
    return VehicleState(
        x_m=pose.x_m,
        y_m=pose.y_m,
        yaw_rad=pose.yaw_rad,
        speed_mps=pose.speed_mps,
        length_m=perceived.length_m,
        width_m=perceived.width_m,
    )


def _plan(sample: WorldSample, accel_mps2: float) -> str:
    if sample.speed_mps < 0.1:
        return "stop"
    if accel_mps2 < BRAKES_MPS2:
        return "brake"
    near = sample.front_gap_m is not None and sample.front_gap_m < FOLLOWS_WITHIN_S * sample.speed_mps
    return "follow" if near else "cruise"


def _actor(body: VehicleState) -> Actor:
    return Actor(kind="vehicle", length_m=body.length_m, width_m=body.width_m)


def _pose(body: VehicleState) -> Pose:
    return Pose(x_m=body.x_m, y_m=body.y_m, yaw_rad=body.yaw_rad, speed_mps=body.speed_mps)


class _Roads:
    """The roads of a network, as surfaces. Everything is read when the episode begins.

    Args:
        sumo: The simulation.
    """

    def __init__(self, sumo: Library) -> None:
        own = sumo.lane
        self._sumo = sumo
        self._shapes: dict[str, Points] = {}
        self._widths: dict[str, float] = {}
        for lane in own.getIDList():
            self._shapes[lane] = np.array(own.getShape(lane), np.float64)
            self._widths[lane] = float(own.getWidth(lane))
        self._junctions = [
            np.array(shape, np.float64)
            for name in sumo.junction.getIDList()
            if not name.startswith(":") and len(shape := sumo.junction.getShape(name)) > 2
        ]
        lights = {
            link[0][0]
            for light in sumo.trafficlight.getIDList()
            for link in sumo.trafficlight.getControlledLinks(light)
            if link
        }
        self._ends_at_light = frozenset(lights)

    def route(self, edges: Sequence[str], lane: str) -> Points:
        """Return the centre line of the lanes along a route.

        Args:
            edges: Its edges.
            lane: The lane in which it is driven on the first of them, if it is on the first.
        """
        index = int(lane.rpartition("_")[2])
        points: list[Points] = []
        length_m = 0.0
        for place, edge in enumerate(edges):
            following = edges[place + 1] if place + 1 < len(edges) else None
            here, via = self._lane_towards(edge, index, following)
            for name in filter(None, (here, via)):
                points.append(self._shapes[name])
                length_m += _length_m(self._shapes[name])
            if length_m > MAX_ROUTE_M:
                break
        return _resampled(np.vstack(points), ROUTE_EVERY_M)

    def _lane_towards(self, edge: str, index: int, following: str | None) -> tuple[str, str]:
        """Return the lane of an edge from which the next edge is reached, and the lane across the junction."""
        count = self._sumo.edge.getLaneNumber(edge)
        order = sorted(range(count), key=lambda lane: abs(lane - index))
        for lane in order if following is not None else ():
            for link in self._sumo.lane.getLinks(f"{edge}_{lane}"):
                if link[0].rpartition("_")[0] == following:
                    return f"{edge}_{lane}", str(link[4])
        return f"{edge}_{order[0]}", ""

    def near(self, path: Points) -> list[Surface]:
        """Return the surfaces near a path, in drawing order."""
        lanes = [name for name, shape in self._shapes.items() if _is_near(shape, path)]
        areas = [
            _ribbon(part, self._widths[name]) for name in lanes for part in _pieces(self._shapes[name], path)
        ]
        areas += [shape for shape in self._junctions if _is_near(shape, path)]
        found = [Surface(kind="road", points=_float32(area), closed=True, width_m=0.0) for area in areas]
        for name in lanes:
            if not name.startswith(":"):
                found += self._markings(name, path)
        return found

    def _markings(self, name: str, path: Points) -> list[Surface]:
        """Return the lines of a lane: its left edge, its right one if it is the outermost, and its stop line."""
        edge, _, index = name.rpartition("_")
        shape, half_m = self._shapes[name], self._widths[name] / 2
        has_left = f"{edge}_{int(index) + 1}" in self._shapes
        found = []
        for piece in _pieces(shape, path):
            left = _offset(piece, half_m)
            found += [_line(dash, LINE_M, "marking") for dash in (_dashes(left) if has_left else [left])]
            if index == "0":
                found.append(_line(_offset(piece, -half_m), LINE_M, "marking"))
        end = shape[-2:]
        if name in self._ends_at_light and _is_near(end, path):
            across = np.vstack([_offset(end, half_m)[-1], _offset(end, -half_m)[-1]])
            found.append(_line(across, STOP_LINE_M, "stop-line"))
        return found


def _float32(points: Points) -> NDArray[np.float32]:
    return np.asarray(points, np.float32)


def _line(points: Points, width_m: float, kind: str) -> Surface:
    return Surface(kind=kind, points=_float32(points), closed=False, width_m=width_m)


def _length_m(points: Points) -> float:
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def _is_near(points: Points, path: Points) -> bool:
    """Return whether a line comes within reach of a path."""
    return len(_pieces(points, path)) > 0


def _pieces(points: Points, path: Points) -> list[Points]:
    """Return the parts of a line that are within reach of a path."""
    fine = _resampled(points, PIECE_M)
    sparse = path[:: max(1, len(path) // 200)]
    near = (np.hypot(*(fine[:, None] - sparse[None]).transpose(2, 0, 1)) < REACH_M).any(axis=1)
    if near.all():
        return [points]
    edges = np.flatnonzero(np.diff(near.astype(int), prepend=0, append=0)).reshape(-1, 2)
    return [fine[first:last] for first, last in edges.tolist() if last - first > 1]


def _resampled(points: Points, every_m: float) -> Points:
    """Return a line with points added so that neighbours are at most a given distance apart."""
    parts = [
        np.linspace(one, other, max(1, math.ceil(np.hypot(*(other - one)) / every_m)), endpoint=False)
        for one, other in pairwise(points)
        if not np.array_equal(one, other)
    ]
    return np.vstack([*parts, points[-1:]])


def _offset(points: Points, left_m: float) -> Points:
    """Return a line beside another one."""
    steps = np.diff(points, axis=0)
    steps /= np.maximum(1e-9, np.hypot(*steps.T))[:, None]
    along = np.vstack([steps[:1], steps[:-1] + steps[1:], steps[-1:]])
    along /= np.maximum(1e-9, np.hypot(*along.T))[:, None]
    return points + left_m * np.column_stack([-along[:, 1], along[:, 0]])


def _ribbon(points: Points, width_m: float) -> Points:
    """Return the outline of a strip along a line."""
    return np.vstack([_offset(points, width_m / 2), _offset(points, -width_m / 2)[::-1]])


def _dashes(points: Points) -> list[Points]:
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    starts = np.arange(0.0, along[-1] - DASH_M, DASHES_EVERY_M)

    def at(station_m: float) -> Points:
        return np.array([np.interp(station_m, along, points[:, axis]) for axis in (0, 1)])

    return [np.vstack([at(start), at(start + DASH_M)]) for start in starts]
