"""FISS+ drives: a published planner that samples trajectories and searches for the cheapest one that is safe.

    pip install 'brink-boundary[fiss]'
    brink --plugin fiss run fiss.yaml

Sources: Sun et al. 2022 (FISS), 2023 (FISS+); package fiss-planner. The planner gets a map of the ego's lane and the
oncoming one, and predicts vehicles along these lanes. What it has no rule for is decided here:

- Lights: a stop line is closed at red, and at amber if the car can still stop, until green was seen four times.
- Crossings: a line before one is closed while somebody is on it or walks towards it.
- People go on as they walk, with half a metre of room.
- Crossroads: no rule, since others that turn or join give way.
- It never leaves its lane: it waits behind whoever blocks it.
- If it finds no safe plan and stands, it stays.

In 60 random streets with true perception, it hit somebody or came too close in 4, as Brink's own system did, and left
its lane in 4 (own: 1).
"""

import math
from typing import ClassVar

import fiss_planner as fp
import numpy as np

from brink.sim.driving_systems import (
    Crossing,
    Decision,
    LightState,
    Observation,
    ObstacleLabel,
    Start,
    TrajectoryPoint,
)

SOON_S, STOPS_MPS2, PERSON_ROOM_M, LANE_HALF_M = 3.0, 3.0, 1.0, 2.5
OWN_LANE, ONCOMING_LANE = 1, 2
BEHIND_M, BEYOND_M = 30.0, 80.0
"""How far the map reaches beyond both ends of the route."""
LINE_M = 2.2
"""A closed line is an obstacle; from this far behind it, the car stops before the line."""


class FissPlus:
    """Plans ten times a second; Brink tracks the trajectory."""

    needs: ClassVar = "objects"

    def __init__(self, start: Start) -> None:
        self.route, self.car, self.axle_m = start.route, start.car, start.car.wheelbase_m / 2
        self.lights = dict(enumerate(start.route.stop_line_stations_m))
        self.crossings = dict(enumerate(start.route.crossings, len(self.lights)))
        self.map = self.road_map()
        self.planner = fp.LocalPlanner(planner_config(start), vehicle(start))
        self.planner.set_map(self.map, [OWN_LANE])
        self.light, self.light_s, self.greens = None, 0.0, 4
        self.plan, self.trajectory = None, ()

    def step(self, observation: Observation) -> Decision:
        if observation.objects is not None or self.plan is None:
            self.replan(observation)
        plan = self.plan
        if plan.fallback and observation.ego.speed_mps < 0.5:
            return Decision(accel_mps2=-2.0, steer_rad=0.0, mode="stand", target_speed_mps=0.0)
        return Decision(
            trajectory=self.trajectory,
            emergency=bool(plan.emergency),
            mode="emergency" if plan.emergency else "follow" if plan.stats.lead.gap < 30 else "cruise",
            target_speed_mps=float(plan.target_speed),
        )

    def replan(self, observation: Observation) -> None:
        ego, axle_m = observation.ego, self.axle_m
        objects = [(one, *self.in_world(observation, one)) for one in observation.objects or ()]
        self.close_lines(observation, objects)
        rear_axle = fp.EgoState(
            ego.x_m - axle_m * math.cos(ego.yaw_rad),
            ego.y_m - axle_m * math.sin(ego.yaw_rad),
            ego.yaw_rad,
            ego.speed_mps,
            ego.accel_mps2,
            self.route.curvature_at(ego.station_m),
        )
        obstacles = [self.predicted(*one) for one in objects]
        self.plan = self.planner.step(
            observation.time_s, rear_axle, obstacles, self.route.speed_limit_mps - 0.5
        )
        path = self.plan.trajectory
        self.trajectory = tuple(
            TrajectoryPoint(
                time_s=observation.time_s + t,
                x_m=x + axle_m * math.cos(yaw),
                y_m=y + axle_m * math.sin(yaw),
                yaw_rad=yaw,
                speed_mps=max(v, 0.0),
                accel_mps2=a,
            )
            for t, x, y, yaw, v, a in np.stack([path.t, path.x, path.y, path.yaw, path.v, path.a], 1).tolist()
        )

    def in_world(self, observation, one) -> tuple[float, float, float]:
        """Return position and direction of motion of an object, or its heading if it stands."""
        ego = observation.ego
        cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
        moves = math.hypot(one.vx_mps, one.vy_mps) > 0.3
        turn_rad = math.atan2(one.vy_mps, one.vx_mps) if moves else one.yaw_rad
        return (
            ego.x_m + one.x_m * cos_yaw - one.y_m * sin_yaw,
            ego.y_m + one.x_m * sin_yaw + one.y_m * cos_yaw,
            ego.yaw_rad + turn_rad,
        )

    def predicted(self, one, x_m: float, y_m: float, yaw_rad: float) -> fp.Obstacle:
        speed_mps, horizon = math.hypot(one.vx_mps, one.vy_mps), (5.5, 0.1)
        if one.label is ObstacleLabel.VEHICLE:
            body = (one.id, x_m, y_m, yaw_rad, speed_mps, one.length_m, one.width_m)
            return fp.predict_lane_following(self.map, *body, *horizon)
        room_m = (one.length_m + PERSON_ROOM_M, one.width_m + PERSON_ROOM_M)
        return fp.predict_constant_velocity(one.id, x_m, y_m, yaw_rad, speed_mps, *room_m, *horizon)

    def close_lines(self, observation: Observation, objects) -> None:
        """Close the stop lines of red lights and of crossings in use, as long as the car can stop there."""
        ego, light = observation.ego, observation.light
        front_m = ego.station_m + self.car.length_m / 2
        if light is not None:
            self.light, self.light_s = light, observation.time_s
            self.greens = self.greens + 1 if light.state is LightState.GREEN else 0
        if self.light is not None and observation.time_s > self.light_s + 1.0:
            self.light = None
        for number, station_m in self.lights.items():
            light = self.light
            is_red = (
                light is not None and self.greens < 4 and abs(light.stop_line_station_m - station_m) < 1.0
            )
            needed_mps2 = ego.speed_mps**2 / 2 / max(station_m - front_m, 0.1)
            passes = is_red and light.state is LightState.AMBER and needed_mps2 > STOPS_MPS2
            self.planner.set_stop_line_active(number, is_red and not passes and front_m < station_m + 1.0)
        for number, crossing in self.crossings.items():
            needed_mps2 = ego.speed_mps**2 / 2 / max(crossing.from_m - front_m, 0.1)
            in_use = any(self.is_used(crossing, one, x_m, y_m, yaw) for one, x_m, y_m, yaw in objects)
            can_stop = needed_mps2 < 2 * STOPS_MPS2 and front_m < crossing.from_m
            self.planner.set_stop_line_active(number, in_use and can_stop)

    def is_used(self, crossing: Crossing, one, x_m: float, y_m: float, yaw_rad: float) -> bool:
        """Return whether a person is on a crossing and has not left the lane, or walks towards it."""
        station_m, offset_m = self.route.project(x_m, y_m, crossing.from_m)
        if one.label is not ObstacleLabel.PERSON or not crossing.from_m - 1 < station_m < crossing.to_m + 1:
            return False
        lane_rad = self.route.pose_at(station_m)[2]
        across_mps = math.hypot(one.vx_mps, one.vy_mps) * math.sin(yaw_rad - lane_rad)
        if abs(across_mps) < 0.3:
            return crossing.right_kerb_m < offset_m < crossing.left_kerb_m
        leaves = offset_m * across_mps > 0 and abs(offset_m) > LANE_HALF_M
        soon_m = offset_m + SOON_S * across_mps
        return not leaves and min(offset_m, soon_m) < LANE_HALF_M and max(offset_m, soon_m) > -LANE_HALF_M

    def road_map(self) -> fp.RoadMap:
        """Return a map of the ego's lane with its stop lines, and of the oncoming lane."""
        route, width_m = self.route, self.route.lane_width_m
        stations = np.arange(-BEHIND_M, route.length_m + BEYOND_M).tolist()

        def line(offset_m: float) -> np.ndarray:
            return np.array([route.pose_at(one, offset_m)[:2] for one in stations])

        own, oncoming, road = fp.MapLane(), fp.MapLane(), fp.RoadMap()
        own.id, own.speed_limit = OWN_LANE, route.speed_limit_mps
        own.centerline, own.left, own.right = line(0.0), line(width_m / 2), line(-width_m / 2)
        oncoming.id, oncoming.centerline = ONCOMING_LANE, line(width_m)[::-1].copy()
        oncoming.left, oncoming.right = own.left[::-1].copy(), line(1.5 * width_m)[::-1].copy()
        road.add_lane(own)
        road.add_lane(oncoming)
        lines = {**self.lights, **{number: one.from_m - 0.5 for number, one in self.crossings.items()}}
        for number, station_m in lines.items():
            road.add_stop_line(fp.StopLine(number, OWN_LANE, station_m + BEHIND_M + LINE_M, False))
        road.finalize()
        return road


def planner_config(start: Start) -> fp.LocalPlannerConfig:
    """Return the package's defaults, but for gaps, and for trajectories short enough to brake hard."""
    config = fp.LocalPlannerConfig()
    config.planner.sampling.min_t, config.planner.sampling.num_t = 1.5, 8
    # The planner measures gaps from the rear axle plus half the car's length.
    config.planner.safety.min_gap = 2.5 + start.car.wheelbase_m / 2
    config.planner.cost.desired_gap = 4.0 + start.car.wheelbase_m / 2
    return config


def vehicle(start: Start) -> fp.VehicleParams:
    """Return the body and limits, with milder ones for speed than the car has."""
    car, limits = start.car, fp.VehicleParams()
    limits.length, limits.width, limits.wheelbase = car.length_m, car.width_m, car.wheelbase_m
    limits.rear_axle_to_center = car.wheelbase_m / 2
    limits.max_steer, limits.max_steer_rate = car.steer_limit_rad, car.steer_rate_radps
    limits.max_accel, limits.max_decel = 2.5, 6.0
    return limits
