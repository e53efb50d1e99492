"""Owns what the driving system is told: localisation with its errors, the light detector, the obstacle boxes.

The obstacle detector is the component under test: its boxes are the injected ones or the ground truth, never noisy.
The other parts are as good as time of day and weather let them be.
"""

import math
from collections.abc import Callable
from typing import TypeAlias

from brink.sim.driving.camera import Body, Camera
from brink.sim.driving.interface import Box, EgoState, LightReading, LightState, ObstacleLabel
from brink.sim.urban.behaviour import BehaviourMode, DetectorBehaviour
from brink.sim.world.pedestrians import PERSON_HEIGHT_M
from brink.sim.world.streams import Stream, generator
from brink.sim.world.world import World

Detects: TypeAlias = Callable[[float], tuple[Box, ...]]
"""Says what an obstacle detector finds at a simulated time."""

DRIFT_S = 1.5
"""Time constant of localisation errors."""

YAW_ERROR_RAD_PER_M = 0.03


class Sensing:
    """Makes the observations of an episode.

    Args:
        world: What there is to sense.
        behaviour: What the obstacle detector says.
        camera: Through which it sees.
        seed: The episode's seed.
        perception_steps: How many there will be.
        step_s: Time between perception steps.
        detects: Says what the obstacle detector finds at a time, if that is not the behaviour's matter.
    """

    def __init__(
        self,
        world: World,
        behaviour: DetectorBehaviour,
        camera: Camera,
        *,
        seed: int,
        perception_steps: int,
        step_s: float,
        detects: Detects | None = None,
    ) -> None:
        self._world = world
        self._step_s = step_s
        self._detects = detects
        self._behaviour = behaviour
        self._camera = camera
        self._station_m = 0.0
        weather = world.weather
        errors = generator(seed, Stream.LOCALISATION).normal(size=(perception_steps + 2, 3))
        keep = math.exp(-step_s / DRIFT_S)
        self._keep = keep
        self._fresh = weather.position_noise_m * math.sqrt(1.0 - keep * keep)
        self._errors: list[list[float]] = errors.tolist()
        self._along_bias_m = weather.position_bias_m * self._errors[-1][0]
        self._side_bias_m = weather.position_bias_m * self._errors[-1][1]
        self._along_m = weather.position_noise_m * self._errors[-2][0]
        self._side_m = weather.position_noise_m * self._errors[-2][1]
        self._yaw_rad = 0.0
        chances = generator(seed, Stream.LIGHT_DETECTION).random(size=perception_steps)
        self._light_chances: list[float] = chances.tolist()

    def localise(self, perception_step: int | None) -> EgoState:
        """Return where localisation says the ego is.

        Args:
            perception_step: Number of the perception step, at which errors change; None between them.
        """
        if perception_step is not None:
            along, side, yaw = self._errors[perception_step]
            self._along_m = self._keep * self._along_m + self._fresh * along
            self._side_m = self._keep * self._side_m + self._fresh * side
            self._yaw_rad = self._keep * self._yaw_rad + self._fresh * YAW_ERROR_RAD_PER_M * yaw
        ego, line = self._world.ego, self._world.route.line
        yaw_rad = ego.yaw_rad + self._yaw_rad
        along_m, side_m = self._along_m + self._along_bias_m, self._side_m + self._side_bias_m
        cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
        x_m = ego.x_m + along_m * cos_yaw - side_m * sin_yaw
        y_m = ego.y_m + along_m * sin_yaw + side_m * cos_yaw
        self._station_m, offset_m = line.project(x_m, y_m, self._station_m)
        return EgoState(
            x_m=x_m,
            y_m=y_m,
            yaw_rad=yaw_rad,
            speed_mps=ego.speed_mps,
            accel_mps2=ego.accel_mps2,
            station_m=self._station_m,
            offset_m=offset_m,
        )

    def light(self, perception_step: int, time_s: float) -> LightReading | None:
        """Return what the light detector reports at a perception step."""
        world = self._world
        if world.signals is None:
            return None
        weather = world.weather
        bumper_m = self._station_m + 0.5 * world.ego.length_m
        for line_m in world.route.stop_line_stations_m:
            if not -1.0 < line_m - bumper_m < weather.light_range_m:
                continue
            chance = self._light_chances[perception_step]
            if chance < weather.light_miss_share:
                return None
            state = world.signals.main_at(time_s)
            if chance > 1.0 - weather.light_confusion_share:
                state = LightState.GREEN if state is not LightState.GREEN else LightState.RED
            return LightReading(state=state, stop_line_station_m=line_m)
        return None

    def boxes(self, perception_step: int) -> tuple[Box, ...]:
        """Return what the obstacle detector says at a perception step."""
        if self._detects is not None:
            return self._detects(perception_step * self._step_s)
        if self._behaviour.mode is BehaviourMode.ORACLE:
            return self.truth()
        return self._behaviour.boxes_at(perception_step)

    def truth(self) -> tuple[Box, ...]:
        """Return the boxes of what the camera truly sees."""
        world = self._world
        ego = world.ego
        bodies = [
            Body(
                ObstacleLabel.VEHICLE,
                vehicle.x_m,
                vehicle.y_m,
                vehicle.yaw_rad,
                vehicle.length_m,
                vehicle.width_m,
                vehicle.size.height_m,
            )
            for vehicle in world.vehicles
        ]
        bodies += [
            Body(
                ObstacleLabel.PERSON,
                walker.x_m,
                walker.y_m,
                walker.yaw_rad,
                walker.length_m,
                walker.width_m,
                PERSON_HEIGHT_M,
            )
            for walker in world.walkers
        ]
        return tuple(sight.box for sight in self._camera.look(ego.x_m, ego.y_m, ego.yaw_rad, bodies))
