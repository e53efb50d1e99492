"""A closed loop for tests of the driving system: road, ego, actors on fixed paths, a perfect detector."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from brink.sim.driving.camera import Camera, Solid
from brink.sim.driving.interface import (
    Box,
    Crossing,
    EgoState,
    LightReading,
    LightState,
    Observation,
    ObstacleLabel,
)
from brink.sim.driving.settings import DrivingSettings
from brink.sim.driving.system import ModularDriving
from brink.sim.plane import Rectangle, signed_gap_m
from brink.sim.world.ego import EgoCar
from brink.sim.world.line import Piece, ReferenceLine
from brink.sim.world.road import LaneRoute

CONTROL_S = 0.05


def road(
    *pieces: Piece,
    lane_width_m: float = 3.5,
    stop_lines_m: tuple[float, ...] = (),
    oncoming: bool = True,
    crossings: tuple[Crossing, ...] = (),
) -> LaneRoute:
    """Return a route from the origin to the east, by default 300 m straight."""
    line = ReferenceLine(0.0, 0.0, 0.0, pieces or (Piece(300.0),))
    return LaneRoute(
        line=line,
        lane_width_m=lane_width_m,
        speed_limit_mps=50 / 3.6,
        stop_line_stations_m=stop_lines_m,
        oncoming=((-50.0, line.length_m + 50.0),) if oncoming else (),
        crossings=crossings,
    )


@dataclass
class Actor:
    """A road user on a fixed path: station and offset of its centre over time."""

    label: ObstacleLabel
    at: Callable[[float], tuple[float, float]]
    length_m: float = 4.5
    width_m: float = 1.8
    height_m: float = 1.5

    def body(self, route: LaneRoute, time_s: float) -> Solid:
        x_m, y_m, yaw_rad = route.pose_at(*self.at(time_s))
        return Solid(self.label, x_m, y_m, yaw_rad, self.length_m, self.width_m, self.height_m)


def vehicle(at: Callable[[float], tuple[float, float]]) -> Actor:
    return Actor(ObstacleLabel.VEHICLE, at)


def person(at: Callable[[float], tuple[float, float]]) -> Actor:
    return Actor(ObstacleLabel.PERSON, at, length_m=0.5, width_m=0.5, height_m=1.75)


@dataclass
class Drive:
    """The recorded drive, with one entry per control step."""

    time_s: list[float] = field(default_factory=list)
    station_m: list[float] = field(default_factory=list)
    offset_m: list[float] = field(default_factory=list)
    speed_mps: list[float] = field(default_factory=list)
    accel_mps2: list[float] = field(default_factory=list)
    steer_rad: list[float] = field(default_factory=list)
    mode: list[str] = field(default_factory=list)
    clearance_m: list[float] = field(default_factory=list)
    front_gap_m: list[float] = field(default_factory=list)

    def modes(self) -> set[str]:
        return set(self.mode)


def drive(
    route: LaneRoute,
    actors: Sequence[Actor] = (),
    *,
    ghosts: Callable[[float], tuple[Box, ...]] = lambda _: (),
    light: Callable[[float], LightState] | None = None,
    duration_s: float = 30.0,
    speed_mps: float = 8.0,
    station_m: float = 5.0,
    friction: float = 0.9,
    oracle: bool = True,
    settings: DrivingSettings | None = None,
) -> Drive:
    """Drive along a route among actors; the detector reports ghosts, and with `oracle` the actors too."""
    camera = Camera()
    system = ModularDriving(route, settings=settings or DrivingSettings(), camera=camera)
    ego = EgoCar(route.pose_at(station_m), speed_mps, friction=friction)
    done = Drive()
    near_m = station_m
    for step in range(round(duration_s / CONTROL_S)):
        time_s = step * CONTROL_S
        near_m, offset_m = route.project(ego.x_m, ego.y_m, near_m)
        bodies = [actor.body(route, time_s) for actor in actors]
        boxes: tuple[Box, ...] | None = None
        if step % 2 == 0:
            seen = camera.look(ego.x_m, ego.y_m, ego.yaw_rad, bodies) if oracle else []
            boxes = (*(sight.box for sight in seen), *ghosts(time_s))
        state = EgoState(
            x_m=ego.x_m,
            y_m=ego.y_m,
            yaw_rad=ego.yaw_rad,
            speed_mps=ego.speed_mps,
            accel_mps2=ego.accel_mps2,
            station_m=near_m,
            offset_m=offset_m,
        )
        reading = None
        if light is not None:
            ahead = [line for line in route.stop_line_stations_m if line > near_m + 2.25]
            reading = LightReading(light(time_s), ahead[0]) if ahead else None
        command = system.step(Observation(time_s=time_s, ego=state, boxes=boxes, light=reading))
        _record(done, time_s, state, command.accel_mps2, command.steer_rad, system.plan.mode)
        done.clearance_m.append(min((_clearance(ego, body) for body in bodies), default=math.inf))
        done.front_gap_m.append(_front_gap(route, actors, time_s, near_m, offset_m))
        ego.drive(command.accel_mps2, command.steer_rad, 5)
    return done


def _record(done: Drive, time_s: float, ego: EgoState, accel: float, steer: float, mode: str) -> None:
    done.time_s.append(time_s)
    done.station_m.append(ego.station_m)
    done.offset_m.append(ego.offset_m)
    done.speed_mps.append(ego.speed_mps)
    done.accel_mps2.append(accel)
    done.steer_rad.append(steer)
    done.mode.append(mode)


def _front_gap(
    route: LaneRoute, actors: Sequence[Actor], time_s: float, station_m: float, offset_m: float
) -> float:
    gaps = [math.inf]
    for actor in actors:
        if actor.label is ObstacleLabel.VEHICLE:
            s, d = actor.at(time_s)
            if s - 4.2 > station_m and abs(d - offset_m) < 2.0:
                gaps.append(s - station_m - 4.5)
    return min(gaps)


def _clearance(ego: EgoCar, body: Solid) -> float:
    """Return the distance of two rectangles, 0 if they overlap."""
    ours = Rectangle(ego.x_m, ego.y_m, ego.yaw_rad, 0.5 * ego.length_m, 0.5 * ego.width_m)
    theirs = Rectangle(body.x_m, body.y_m, body.yaw_rad, 0.5 * body.length_m, 0.5 * body.width_m)
    return max(0.0, signed_gap_m(ours, theirs))
