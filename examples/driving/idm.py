"""The Intelligent Driver Model with pure pursuit, a driving system in sixty lines.

    brink --plugin idm run idm.yaml

It keeps its lane and never overtakes. It follows or stops for whoever is in the lane, or about to walk into it, and
for red lights. Sources: Treiber, Hennecke, Helbing 2000 (speed); Coulter 1992 (steering).
"""

import math
from typing import ClassVar

from brink.sim.driving_systems import Decision, LightState, Observation, ObstacleLabel, SeenObject, Start

ACCEL_MPS2, DECEL_MPS2, GAP_M, SIDE_ACCEL_MPS2 = 1.5, 2.0, 2.5, 1.8
WIDE_M, LOOKS_AHEAD_S = 0.4, 2.5


class Idm:
    """Follows the lane and whoever is in it."""

    needs: ClassVar = "objects"

    def __init__(self, start: Start) -> None:
        self.route, self.car = start.route, start.car
        self.headway_s = float(str(start.settings.get("headway_s", 1.4)))
        self.brake_mps2 = float(str(start.settings.get("brake_mps2", 8.0)))
        self.leaders: list[tuple[float, float]] = []

    def step(self, observation: Observation) -> Decision:
        ego = observation.ego
        if observation.objects is not None:
            found = (self.leader(observation, one) for one in observation.objects)
            self.leaders = [one for one in found if one is not None]
        front_m = ego.station_m + self.car.length_m / 2
        leaders = list(self.leaders)
        light = observation.light
        if light is not None and light.state is not LightState.GREEN:
            needed_mps2 = ego.speed_mps**2 / 2 / max(light.stop_line_station_m - front_m, 0.1)
            if light.state is LightState.RED or needed_mps2 < 3:
                leaders.append((light.stop_line_station_m + 1, 0.0))
        wanted_mps = self.free_speed(ego.station_m)
        accel = min(
            [self.idm(ego.speed_mps, wanted_mps, at_m - front_m, mps) for at_m, mps in leaders], default=9
        )
        accel = min(accel, self.idm(ego.speed_mps, wanted_mps, math.inf, 0.0))
        braking = accel < -0.5
        return Decision(
            accel_mps2=max(accel, -self.brake_mps2),
            steer_rad=self.steer(observation),
            mode="follow" if braking else "cruise",
            target_speed_mps=wanted_mps,
        )

    def leader(self, observation: Observation, one: SeenObject) -> tuple[float, float] | None:
        """Return the station of the rear of an object in the way, and its speed along the road; None if it is not."""
        ego = observation.ego
        cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
        x_m, y_m = (
            ego.x_m + one.x_m * cos_yaw - one.y_m * sin_yaw,
            ego.y_m + one.x_m * sin_yaw + one.y_m * cos_yaw,
        )
        station_m, offset_m = self.route.project(x_m, y_m, ego.station_m + one.x_m)
        turn = self.route.pose_at(station_m)[2] - ego.yaw_rad
        along_mps = one.vx_mps * math.cos(turn) + one.vy_mps * math.sin(turn)
        across_mps = one.vy_mps * math.cos(turn) - one.vx_mps * math.sin(turn)
        reach_m = self.car.width_m / 2 + one.width_m / 2 + WIDE_M
        soon_m = offset_m
        if one.label is ObstacleLabel.PERSON and abs(across_mps) > 0.3:
            soon_m += across_mps * LOOKS_AHEAD_S
        is_in_way = abs(offset_m) < reach_m or abs(soon_m) < reach_m or offset_m * soon_m < 0
        if station_m < ego.station_m or not is_in_way:
            return None
        return station_m - one.length_m / 2, max(along_mps, 0.0)

    def free_speed(self, station_m: float) -> float:
        """Return the speed that the limit and the bends ahead allow."""
        bends = [abs(self.route.curvature_at(station_m + ahead_m)) for ahead_m in range(0, 25, 3)]
        return min(self.route.speed_limit_mps - 0.5, math.sqrt(SIDE_ACCEL_MPS2 / max(*bends, 1e-3)))

    def idm(self, speed: float, wanted: float, gap_m: float, ahead_mps: float) -> float:
        """Return the acceleration of the Intelligent Driver Model."""
        closing = speed * (speed - ahead_mps) / 2 / math.sqrt(ACCEL_MPS2 * DECEL_MPS2)
        desired_m = GAP_M + max(0.0, speed * self.headway_s + closing)
        return ACCEL_MPS2 * (1 - (speed / wanted) ** 4 - (desired_m / max(gap_m, 0.1)) ** 2)

    def steer(self, observation: Observation) -> float:
        """Return the angle of the arc of the rear axle through a point of the lane ahead."""
        ego, axle_m = observation.ego, self.car.wheelbase_m / 2
        x_m, y_m, _ = self.route.pose_at(ego.station_m - axle_m + max(3.5, 0.8 * ego.speed_mps))
        cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
        dx, dy = x_m - ego.x_m + axle_m * cos_yaw, y_m - ego.y_m + axle_m * sin_yaw
        left_m = dy * cos_yaw - dx * sin_yaw
        return math.atan(2 * self.car.wheelbase_m * left_m / (dx * dx + dy * dy))
