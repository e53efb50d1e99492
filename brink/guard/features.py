"""Features of a guard: what a car can observe, as numbers, at each perception step.

A `FeatureExtractor` is fed with the observations and commands of one drive, in order, and returns a vector whose
names are `FEATURES` (and `RANGE_FEATURES`, if the car has a range sensor). It is causal: a vector depends on what was
observed so far, mostly within the last three seconds, never on the truth or the future. It uses the driving system's
own knowledge: the map of the route, its camera, its localisation, its plan and command.

Boxes are followed from step to step by label and overlap. The most relevant box is the nearest one in the ego's path
or, if none is in it, the nearest one. Its distance is estimated twice, from the row of its base on level ground and
from its height, and so is its motion: of a real obstacle, both agree, and the obstacle's speed over ground is
plausible. An injected or hallucinated box need not be consistent with the ground, with itself, or with the ego's
motion.

Vectors are rounded to half precision, in training as in the car. Change `FEATURES_ID` with every change of their
meaning: a model refuses features that it was not fitted to.
"""

import math
from collections import deque
from collections.abc import Sequence
from itertools import pairwise
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.guard.range_features import RANGE_FEATURES, RangeFeatures
from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import (
    PERCEPTION_STEP_S,
    Box,
    Command,
    EgoState,
    LightReading,
    LightState,
    Observation,
    ObstacleLabel,
    PlanMode,
    PlanState,
    Route,
)
from brink.sim.driving.obstacles import depth_m, overlap
from brink.sim.driving.settings import DrivingSettings
from brink.sim.guard.interface import KnownConditions, RangeScan

FeatureVector: TypeAlias = NDArray[np.float32]

FEATURES_ID: Final = "guard-features@1"
WINDOW_STEPS: Final = 30
"""Perception steps that a vector depends on, besides the current one: three seconds."""
SECOND_STEPS: Final = 10
MOTION_STEPS: Final = 5
"""Perception steps over which the motion of a box is measured."""

FAR_M: Final = 120.0
"""Distance of a box that has none on the ground: its base lies at or above the horizon."""
NO_BOX_M: Final = 150.0
"""Distance where there is no box."""
MAX_TTC_S: Final = 10.0
MAX_SPEED_MPS: Final = 60.0
MAX_AGE_S: Final = 10.0
PATH_MARGIN_M: Final = 0.3
"""A box this close beside the ego's body is in its path."""
NEAR_M: Final = 25.0
"""Boxes that appear or disappear nearer than this do so suddenly, unless at the border of the image."""
BORDER_PX: Final = 4.0
LINE_BEFORE_M, LINE_AHEAD_M = -5.0, 80.0
AHEAD_M: Final = (10.0, 25.0)
"""Distances at which the curvature of the route is read."""

_SETTINGS: Final = DrivingSettings()
_SHAPE: Final = _SETTINGS.shape
_LOCALISATION: Final = _SETTINGS.localisation
_CAMERA: Final = Camera()
_BUMPER_M: Final = 0.5 * _SHAPE.length_m - _CAMERA.forward_m
"""The front bumper's distance ahead of the camera."""

_BOX: Final = (
    "is_person",
    "in_path",
    "base_m",
    "size_m",
    "base_over_size",
    "lateral_m",
    "width_px",
    "height_px",
    "centre_x_px",
    "base_y_px",
    "at_border",
    "age_s",
    "speed_by_base_mps",
    "speed_by_size_mps",
    "ttc_by_base_s",
    "ttc_by_size_s",
    "speeds_differ_mps",
    "sideways_px_s",
    "needed_decel_mps2",
)

FEATURES: Final[tuple[str, ...]] = (
    # The ego and its plan.
    "speed_mps",
    "accel_mps2",
    "offset_m",
    "heading_error_rad",
    "speed_change_1s_mps",
    "speed_change_3s_mps",
    "least_accel_1s_mps2",
    "least_accel_3s_mps2",
    "least_speed_3s_mps",
    "standing_s",
    "command_mps2",
    "least_command_1s_mps2",
    "steer_rad",
    "plan_curvature_per_m",
    "route_curvature_per_m",
    *(f"route_curvature_{ahead:g}m_per_m" for ahead in AHEAD_M),
    "target_minus_speed_mps",
    "target_offset_m",
    *(f"mode_{mode.value}" for mode in PlanMode),
    "oncoming_lane",
    # What is known of the conditions.
    "rain",
    "wet",
    "dark",
    # The light and the stop line.
    "light_reported",
    "light",
    "light_age_s",
    "light_changes_3s",
    "line_m",
    "line_s",
    "line_needed_decel_mps2",
    "light_red_3s",
    # All boxes.
    "vehicles",
    "persons",
    "boxes_in_path",
    "largest_share",
    "boxes_mean_3s",
    "in_path_share_1s",
    "in_path_share_3s",
    "births_1s",
    "births_3s",
    "deaths_1s",
    "deaths_3s",
    "sudden_births_1s",
    "sudden_births_3s",
    "sudden_deaths_1s",
    "sudden_deaths_3s",
    "since_box_s",
    "since_in_path_s",
    "ttc_s",
    "least_ttc_1s",
    "least_ttc_3s",
    "least_distance_3s_m",
    "most_inconsistent_1s",
    "brakes_without_box",
    "blocked_without_braking",
    # The most relevant box.
    *(f"box_{name}" for name in _BOX),
)
"""Names of the features of a car without a range sensor, in order."""

TTC: Final = FEATURES.index("ttc_s")
"""The shortest time to collision on reported boxes in the path, which is a baseline, too."""

ALL_FEATURES: Final = (*FEATURES, *RANGE_FEATURES)
"""Names of the features of a car with a range sensor, in order."""

_MODES: Final = tuple(PlanMode)
_LIGHTS: Final = {LightState.GREEN: 0.0, LightState.AMBER: 1.0, LightState.RED: 2.0}
_NO_LIGHT: Final = -1.0


UNKNOWN: Final = KnownConditions()


class _Seen:
    """A box that is followed from step to step.

    Attributes:
        box: The box at the current step.
        age: Number of earlier steps at which it was there.
        base_m: Distance of its base from the front bumper, on level ground.
        size_m: Distance from the front bumper at which an object of usual height looks as tall.
        believed_m: The one of the two that the driving system goes by.
        lateral_m: Distance from the middle of the ego's lane, to the left.
        in_path: Whether it overlaps the ego's path.
        past: ``(base_m, size_m, height_px, centre_px)`` of the last steps, oldest first.
    """

    __slots__ = ("age", "base_m", "believed_m", "box", "in_path", "lateral_m", "past", "size_m")

    def __init__(self, box: Box) -> None:
        self.box = box
        self.age = 0
        self.base_m = self.size_m = self.believed_m = NO_BOX_M
        self.lateral_m = 0.0
        self.in_path = False
        self.past: deque[tuple[float, float, float, float]] = deque(maxlen=MOTION_STEPS + 1)

    @property
    def at_border(self) -> bool:
        """Whether the left or right border of the image cuts the box."""
        _, x_min, x_max, _, _ = self.box
        return x_min <= BORDER_PX or x_max >= _CAMERA.width_px - BORDER_PX

    @property
    def rates(self) -> tuple[float, float, float, float]:
        """Rates of the distance by base and by size, of the log of the height, and of the centre, per second."""
        count = len(self.past) - 1
        if count < 1:
            return 0.0, 0.0, 0.0, 0.0
        first, last, elapsed_s = self.past[0], self.past[-1], count * PERCEPTION_STEP_S
        return (
            (last[0] - first[0]) / elapsed_s,
            (last[1] - first[1]) / elapsed_s,
            math.log(last[2] / first[2]) / elapsed_s,
            (last[3] - first[3]) / elapsed_s,
        )


class _Step(NamedTuple):
    """The values of a perception step that later steps need."""

    speed_mps: float
    accel_mps2: float
    command_mps2: float
    boxes: float
    in_path: bool
    ttc_s: float
    nearest_m: float
    inconsistent: float
    births: int
    deaths: int
    sudden_births: int
    sudden_deaths: int
    light: float


class FeatureExtractor:
    """Extracts the features of one drive. Create a new one for each drive.

    Args:
        route: The route of the drive.
        conditions: What the car knows about the time of day and the weather.
        ranges: Whether the car has a range sensor.
    """

    def __init__(self, route: Route, conditions: KnownConditions = UNKNOWN, *, ranges: bool = False) -> None:
        self._route = route
        self._conditions = conditions
        self._ranges = RangeFeatures(route) if ranges else None
        self._seen: list[_Seen] = []
        self._steps: deque[_Step] = deque(maxlen=WINDOW_STEPS + 1)
        self._standing = 0
        self._since_box = self._since_in_path = round(MAX_AGE_S / PERCEPTION_STEP_S)
        self._light_age = 0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the features, in order."""
        return FEATURES if self._ranges is None else ALL_FEATURES

    def step(
        self,
        observation: Observation,
        command: Command,
        plan: PlanState | None = None,
        scan: RangeScan | None = None,
    ) -> FeatureVector:
        """Process one perception step and return its features, shape ``(len(names),)``.

        Args:
            observation: What the driving system received; its boxes are not None.
            command: What it commanded.
            plan: The planner's decision, if known.
            scan: The scan of the range sensor; None counts as a scan in which nothing was measured.

        Raises:
            ValueError: The observation has no boxes: it is not of a perception step.
        """
        if observation.boxes is None:
            raise ValueError("expected the observation of a perception step, whose boxes are not None")
        ego, light = observation.ego, observation.light
        births, deaths, sudden_births, sudden_deaths = self._follow(ego, observation.boxes)
        relevant = _most_relevant(self._seen)
        of_box = _box_values(relevant, ego.speed_mps)
        self._steps.append(
            _Step(
                speed_mps=ego.speed_mps,
                accel_mps2=ego.accel_mps2,
                command_mps2=command.accel_mps2,
                boxes=float(len(self._seen)),
                in_path=any(one.in_path for one in self._seen),
                ttc_s=min(
                    (_ttc_s(one, ego.speed_mps) for one in self._seen if one.in_path), default=MAX_TTC_S
                ),
                nearest_m=min((one.believed_m for one in self._seen if one.in_path), default=NO_BOX_M),
                inconsistent=0.0 if relevant is None else abs(of_box[_RATIO]),
                births=births,
                deaths=deaths,
                sudden_births=sudden_births,
                sudden_deaths=sudden_deaths,
                light=_NO_LIGHT if light is None else _LIGHTS[light.state],
            )
        )
        self._count()
        values = [
            *self._of_ego(ego, command, plan),
            *self._conditions,
            *self._of_light(ego, light),
            *self._of_boxes(command),
            *of_box,
        ]
        if self._ranges is not None:
            reported_m = self._steps[-1].nearest_m
            values += self._ranges.step(ego, scan, reported_m=reported_m)
        return rounded(values)

    def _count(self) -> None:
        """Update how long the ego has been standing, without boxes, and with the same light."""
        now = self._steps[-1]
        self._standing = self._standing + 1 if now.speed_mps < 0.3 else 0
        self._since_box = 0 if now.boxes else self._since_box + 1
        self._since_in_path = 0 if now.in_path else self._since_in_path + 1
        same = len(self._steps) > 1 and self._steps[-2].light == now.light
        self._light_age = self._light_age + 1 if same else 0

    def _follow(self, ego: EgoState, boxes: Sequence[Box]) -> tuple[int, int, int, int]:
        """Match the boxes to those of the last step.

        Returns:
            Number of births and deaths, and of those that were sudden.
        """
        before, now = self._seen, [_Seen(box) for box in boxes if _has_extent(box)]
        pairs = [
            (overlap(new.box, old.box), row, column)
            for row, old in enumerate(before)
            for column, new in enumerate(now)
            if new.box.label is old.box.label
        ]
        pairs.sort(key=lambda pair: (-pair[0], pair[1], pair[2]))
        gone, born = set(range(len(before))), set(range(len(now)))
        for share, row, column in pairs:
            if share >= _SETTINGS.tracking.min_overlap and row in gone and column in born:
                gone.discard(row)
                born.discard(column)
                now[column].age = before[row].age + 1
                now[column].past = before[row].past
        for one in now:
            self._place(one, ego)
        self._seen = now
        sudden_births = sum(_is_sudden(now[column]) for column in born)
        return len(born), len(gone), sudden_births, sum(_is_sudden(before[row]) for row in gone)

    def _place(self, one: _Seen, ego: EgoState) -> None:
        """Estimate the position of a box."""
        box = one.box
        label, x_min, x_max, y_min, y_max = box
        ground_m = _CAMERA.ground_depth_m(y_max)
        tall = (
            _LOCALISATION.person_height_m if label is ObstacleLabel.PERSON else _LOCALISATION.vehicle_height_m
        )
        one.base_m = FAR_M if ground_m is None else min(ground_m - _BUMPER_M, FAR_M)
        one.size_m = min(_CAMERA.focal_px * tall / (y_max - y_min) - _BUMPER_M, FAR_M)
        deep_m = depth_m(box, _CAMERA, _LOCALISATION)
        assert deep_m is not None, "boxes without an extent are left out"
        one.believed_m = deep_m - _BUMPER_M
        aside_m = _CAMERA.left_m(0.5 * (x_min + x_max), deep_m)
        half_m = 0.5 * (x_max - x_min) * deep_m / _CAMERA.focal_px
        cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
        ahead_m = _CAMERA.forward_m + deep_m
        _, one.lateral_m = self._route.project(
            ego.x_m + ahead_m * cos_yaw - aside_m * sin_yaw,
            ego.y_m + ahead_m * sin_yaw + aside_m * cos_yaw,
            ego.station_m + ahead_m,
        )
        reach_m = half_m + 0.5 * _SHAPE.width_m + PATH_MARGIN_M
        one.in_path = (
            abs(one.lateral_m - ego.offset_m) < reach_m and one.believed_m < _SETTINGS.planning.follow.range_m
        )
        one.past.append((one.base_m, one.size_m, y_max - y_min, 0.5 * (x_min + x_max)))

    def _of_ego(self, ego: EgoState, command: Command, plan: PlanState | None) -> list[float]:
        steps, route = self._steps, self._route
        second = list(steps)[-SECOND_STEPS - 1 :]
        heading = (ego.yaw_rad - route.pose_at(ego.station_m)[2] + math.pi) % (2.0 * math.pi) - math.pi
        front_m = ego.station_m + 0.5 * _SHAPE.length_m
        return [
            ego.speed_mps,
            ego.accel_mps2,
            ego.offset_m,
            heading,
            ego.speed_mps - second[0].speed_mps,
            ego.speed_mps - steps[0].speed_mps,
            min(one.accel_mps2 for one in second),
            min(one.accel_mps2 for one in steps),
            min(one.speed_mps for one in steps),
            min(self._standing * PERCEPTION_STEP_S, MAX_AGE_S),
            command.accel_mps2,
            min(one.command_mps2 for one in second),
            command.steer_rad,
            math.tan(command.steer_rad) / _SHAPE.wheelbase_m,
            route.curvature_at(ego.station_m),
            *(route.curvature_at(front_m + ahead_m) for ahead_m in AHEAD_M),
            0.0 if plan is None else plan.target_speed_mps - ego.speed_mps,
            0.0 if plan is None else plan.target_offset_m,
            *(float(plan is not None and plan.mode is mode) for mode in _MODES),
            float(route.oncoming_lane_at(ego.station_m)),
        ]

    def _of_light(self, ego: EgoState, light: LightReading | None) -> list[float]:
        lights = [one.light for one in self._steps]
        changes = sum(old != new for old, new in pairwise(lights))
        front_m = ego.station_m + 0.5 * _SHAPE.length_m
        line_m = min(
            (
                ahead_m
                for station_m in self._route.stop_line_stations_m
                if (ahead_m := station_m - front_m) > LINE_BEFORE_M
            ),
            default=LINE_AHEAD_M,
        )
        line_m = min(line_m, LINE_AHEAD_M)
        speed = max(ego.speed_mps, 0.0)
        return [
            float(light is not None),
            lights[-1],
            min(self._light_age * PERCEPTION_STEP_S, MAX_AGE_S),
            float(changes),
            line_m,
            min(max(line_m, 0.0) / max(speed, 0.1), MAX_TTC_S),
            _needed_decel(speed, line_m) if line_m < LINE_AHEAD_M else 0.0,
            sum(one == _LIGHTS[LightState.RED] for one in lights) / len(lights),
        ]

    def _of_boxes(self, command: Command) -> list[float]:
        steps, seen = self._steps, self._seen
        second = list(steps)[-SECOND_STEPS - 1 :]
        now = steps[-1]
        persons = sum(one.box.label is ObstacleLabel.PERSON for one in seen)
        area = _CAMERA.width_px * _CAMERA.height_px
        return [
            float(len(seen) - persons),
            float(persons),
            float(sum(one.in_path for one in seen)),
            max((_area(one.box) for one in seen), default=0.0) / area,
            sum(one.boxes for one in steps) / len(steps),
            sum(one.in_path for one in second) / len(second),
            sum(one.in_path for one in steps) / len(steps),
            float(sum(one.births for one in second)),
            float(sum(one.births for one in steps)),
            float(sum(one.deaths for one in second)),
            float(sum(one.deaths for one in steps)),
            float(sum(one.sudden_births for one in second)),
            float(sum(one.sudden_births for one in steps)),
            float(sum(one.sudden_deaths for one in second)),
            float(sum(one.sudden_deaths for one in steps)),
            min(self._since_box * PERCEPTION_STEP_S, MAX_AGE_S),
            min(self._since_in_path * PERCEPTION_STEP_S, MAX_AGE_S),
            now.ttc_s,
            min(one.ttc_s for one in second),
            min(one.ttc_s for one in steps),
            min(one.nearest_m for one in steps),
            max(one.inconsistent for one in second),
            float(command.accel_mps2 < -1.0 and not now.in_path),
            float(now.ttc_s < 3.0 and command.accel_mps2 > -0.5),
        ]


_RATIO: Final = _BOX.index("base_over_size")


def rounded(values: Sequence[float]) -> FeatureVector:
    """Return features in half precision, as they are recorded."""
    return np.asarray(values, np.float16).astype(np.float32)


def _has_extent(box: Box) -> bool:
    return depth_m(box, _CAMERA, _LOCALISATION) is not None


def _area(box: Box) -> float:
    return (box.x_max_px - box.x_min_px) * (box.y_max_px - box.y_min_px)


def _is_sudden(one: _Seen) -> bool:
    return one.believed_m < NEAR_M and not one.at_border


def _most_relevant(seen: Sequence[_Seen]) -> _Seen | None:
    """Return the nearest box in the path, or the nearest one if there is none in it."""
    return min(seen, key=lambda one: (not one.in_path, one.believed_m), default=None)


def _ttc_s(one: _Seen, speed_mps: float) -> float:
    """Return the time to collision with a box, by its faster approach; a new box is assumed to be stationary."""
    base_rate, _, growth, _ = one.rates
    closing = -base_rate if one.age else speed_mps
    by_base = one.believed_m / closing if closing > 0.1 else MAX_TTC_S
    by_size = 1.0 / growth if growth > 0.1 else MAX_TTC_S
    return min(max(min(by_base, by_size), 0.0), MAX_TTC_S)


def _needed_decel(speed_mps: float, distance_m: float) -> float:
    """Return the constant braking that stops the ego within a distance, at most 20 m/s^2."""
    return min(speed_mps * speed_mps / (2.0 * max(distance_m, 0.1)), 20.0)


def _box_values(one: _Seen | None, speed_mps: float) -> list[float]:
    """Return the features of a box, in the order of `_BOX`."""
    if one is None:
        return [
            -1.0, 0.0, NO_BOX_M, NO_BOX_M, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, MAX_TTC_S, MAX_TTC_S,
            0.0, 0.0, 0.0,
        ]  # fmt: skip
    label, x_min, x_max, y_min, y_max = one.box
    base_rate, size_rate, growth, sideways = one.rates
    by_base, by_size = _clipped(speed_mps + base_rate), _clipped(speed_mps + size_rate)
    return [
        float(label is ObstacleLabel.PERSON),
        float(one.in_path),
        one.base_m,
        one.size_m,
        math.log(max(one.base_m + _BUMPER_M, 1.0) / max(one.size_m + _BUMPER_M, 1.0)),
        min(max(one.lateral_m, -50.0), 50.0),
        x_max - x_min,
        y_max - y_min,
        0.5 * (x_min + x_max),
        y_max,
        float(one.at_border),
        min(one.age * PERCEPTION_STEP_S, MAX_AGE_S),
        by_base,
        by_size,
        min(one.base_m / -base_rate, MAX_TTC_S) if base_rate < -0.1 and one.base_m > 0 else MAX_TTC_S,
        min(1.0 / growth, MAX_TTC_S) if growth > 0.1 else MAX_TTC_S,
        abs(by_base - by_size),
        min(max(sideways, -4_000.0), 4_000.0),
        _needed_decel(max(speed_mps, 0.0), one.believed_m) if one.in_path else 0.0,
    ]


def _clipped(speed_mps: float) -> float:
    return min(max(speed_mps, -MAX_SPEED_MPS), MAX_SPEED_MPS)
