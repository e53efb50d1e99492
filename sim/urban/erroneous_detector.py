"""The obstacle detector that reports the truth with errors.

Errors act on image boxes, before tracking, one after another, as if the camera were level; the boxes are tilted with
the camera at the end. An error of severity 0 changes nothing, so that without others the reported boxes are the true
ones, bit for bit.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

from brink.sim.driving.camera import Camera, Sighting, Solid
from brink.sim.driving.interface import PERCEPTION_STEP_S, Box, ObstacleLabel
from brink.sim.urban.detection_errors import (
    GHOSTS,
    MAGNITUDES,
    PEDESTRIAN_WITHIN_M,
    DetectionError,
    ErrorType,
    Onset,
    Target,
)
from brink.sim.urban.error_meter import HALF_LANE_M, TrueBox
from brink.sim.world.pedestrians import PERSON_HEIGHT_M, PERSON_LENGTH_M, PERSON_WIDTH_M, Phase, Walker
from brink.sim.world.scenery import PARKED, fixtures
from brink.sim.world.vehicle import CAR
from brink.sim.world.world import World, bodies_of, screens_of

FLICKER_PERIOD_S: Final = 2.0
GHOST_AHEAD_M: Final = 15.0
"""Distance of a ghost from the ego's centre when it appears."""
BRAKES_ABOVE_MPS2: Final = 1.5
"""The lead brakes if it loses speed faster than this."""
STEPS_OUT_WITHIN_M: Final = 40.0
"""A pedestrian who steps onto the road counts within this distance ahead of the ego."""

_LEAST_PX: Final = 1.0
"""Narrower or lower boxes are not reported."""
_ROUNDING: Final = 1e-9

T = TypeVar("T")
"""What is reported of a road user."""


class ErroneousDetector:
    """Reports the truth with errors. Create a new one for each episode.

    Args:
        world: The world of the episode.
        camera: The detector's camera.
        errors: The errors, which act in this order.

    Attributes:
        steps: For each error, the first and last perception step at which it changed the output; None if it never
            did.
    """

    def __init__(self, world: World, camera: Camera, errors: Sequence[DetectionError]) -> None:
        self._world = world
        self._camera = camera
        self._observer = Observer(world, camera)
        self._errors = [_BoxError(error, camera) for error in errors]
        self.steps: list[tuple[int, int] | None] = [None] * len(errors)

    def __call__(self, time_s: float) -> tuple[Box, ...]:
        """Return the reported boxes at a perception step."""
        scene = self._observer.look(time_s)
        boxes: list[tuple[int, Box]] = [(sight.body, sight.box) for sight in scene.sights]
        step = round(time_s / PERCEPTION_STEP_S)
        for index, error in enumerate(self._errors):
            changed, boxes = error.apply(scene, boxes)
            if changed:
                since = self.steps[index]
                self.steps[index] = (since[0] if since else step, step)
        return self._camera.all_tilted((box for _, box in boxes), self._world.ego.pitch_rad)


class Observer:
    """Observes what a perfect detector would see, and identifies the road users. Create a new one for each episode.

    Args:
        world: The world of the episode.
        camera: The detector's camera.
    """

    def __init__(self, world: World, camera: Camera) -> None:
        self._world = world
        self._camera = camera
        self._station_m = 0.0
        self._speeds_mps: dict[str, float] = {}
        self._were_crossing = {walker.name for walker in world.walkers if _crosses(walker)}
        self._parked = [
            Solid(
                ObstacleLabel.VEHICLE, one.x_m, one.y_m, one.yaw_rad, one.length_m, one.width_m, one.height_m
            )
            for one in fixtures(world.road)
            if one.kind == PARKED
        ]

    def look(self, time_s: float) -> "Scene":
        """Return the scene at a perception step; called once for each, in order."""
        world = self._world
        ego = world.ego
        bodies = bodies_of(world)
        self._station_m, _ = world.route.line.project(ego.x_m, ego.y_m, self._station_m)
        sights = self._camera.sights(ego.x_m, ego.y_m, ego.yaw_rad, bodies, screens_of(world.road))
        least = self._camera.least_visible
        speeds = {vehicle.name: vehicle.speed_mps for vehicle in world.vehicles}
        braking = {
            index
            for index, vehicle in enumerate(world.vehicles)
            if self._speeds_mps.get(vehicle.name, 0.0) - vehicle.speed_mps
            > BRAKES_ABOVE_MPS2 * PERCEPTION_STEP_S
        }
        self._speeds_mps = speeds
        crossing = {walker.name for walker in world.walkers if _crosses(walker)}
        new = crossing - self._were_crossing
        self._were_crossing = crossing
        first_walker = len(world.vehicles)
        stepped_out = [
            (self._ahead_m(bodies[index]), index)
            for index, walker in enumerate(world.walkers, first_walker)
            if walker.name in new and 0.0 < self._ahead_m(bodies[index]) < STEPS_OUT_WITHIN_M
        ]
        return Scene(
            time_s=time_s,
            world=world,
            station_m=self._station_m,
            bodies=bodies,
            sights=[sight for sight in sights if sight.visible >= least],
            hidden=[sight for sight in sights if sight.visible < least],
            braking=frozenset(braking),
            stepped_out=min(stepped_out)[1] if stepped_out else None,
        )

    def is_in_lane(self, box: Box) -> bool:
        """Return whether a box of a level camera stands in the ego's lane, in the scene that was looked at last."""
        camera, ego, line = self._camera, self._world.ego, self._world.route.line
        depth_m = camera.ground_depth_m(box.y_max_px)
        if depth_m is None:
            return False
        ahead_m = camera.forward_m + depth_m
        left_m = camera.left_m(0.5 * (box.x_min_px + box.x_max_px), depth_m)
        cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
        _, offset_m = line.project(
            ego.x_m + ahead_m * cos_yaw - left_m * sin_yaw,
            ego.y_m + ahead_m * sin_yaw + left_m * cos_yaw,
            self._station_m + ahead_m,
        )
        return abs(offset_m) < HALF_LANE_M

    def parked_boxes(self) -> list[Box]:
        """Return the boxes of parked cars in the image of a level camera, hidden or not."""
        ego = self._world.ego
        seen = (self._camera.project(ego.x_m, ego.y_m, ego.yaw_rad, body) for body in self._parked)
        return [one[0] for one in seen if one is not None]

    def _ahead_m(self, body: Solid) -> float:
        ego = self._world.ego
        return (body.x_m - ego.x_m) * math.cos(ego.yaw_rad) + (body.y_m - ego.y_m) * math.sin(ego.yaw_rad)


def _crosses(walker: object) -> bool:
    return isinstance(walker, Walker) and walker.phase is Phase.CROSSING


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """What is visible at a perception step.

    Attributes:
        time_s: Simulated time.
        world: The world.
        station_m: Station of the ego on its route.
        bodies: All bodies around the ego.
        sights: The visible ones, nearest first.
        hidden: Those of which too little is visible, nearest first.
        braking: Numbers of the bodies that brake.
        stepped_out: Number of the nearest pedestrian who has just stepped onto the road ahead.
    """

    time_s: float
    world: World
    station_m: float
    bodies: Sequence[Solid]
    sights: Sequence[Sighting]
    hidden: Sequence[Sighting]
    braking: frozenset[int]
    stepped_out: int | None

    def lead(self) -> int | None:
        """Return the number of the nearest visible vehicle ahead in the ego's lane."""
        route = self.world.route
        half_lane_m = 0.5 * route.lane_width_m
        for sight in self.sights:
            body = self.bodies[sight.body]
            if self.kind(body) is not Target.LEAD:
                continue
            at_m, offset_m = route.line.project(body.x_m, body.y_m, self.station_m + sight.depth_m)
            if at_m > self.station_m and abs(offset_m) < half_lane_m:
                return sight.body
        return None

    def kind(self, body: Solid) -> Target:
        """Return which kind of road user a body is; vehicles by their heading relative to the ego's."""
        if body.label is ObstacleLabel.PERSON:
            return Target.PEDESTRIAN
        cosine = math.cos(body.yaw_rad - self.world.ego.yaw_rad)
        if cosine >= _COS_45:
            return Target.LEAD
        return Target.ONCOMING if cosine <= -_COS_45 else Target.CROSSING

    def group(self, target: Target) -> set[int]:
        """Return the numbers of all visible bodies of a kind; for the lead's kind, vehicles going the ego's way."""
        found = set()
        for sight in self.sights:
            body = self.bodies[sight.body]
            if target in (Target.EVERYBODY, self.kind(body)):
                found.add(sight.body)
        return found

    def true_boxes(self) -> list[TrueBox]:
        """Return the boxes of all bodies in the image, the visible ones first, each with its relation to the ego."""
        targets = {self.lead(), self.pedestrian()}
        return [
            TrueBox(
                sight.body, sight.box, self.kind(self.bodies[sight.body]), sight.body in targets, is_visible
            )
            for sights, is_visible in ((self.sights, True), (self.hidden, False))
            for sight in sights
        ]

    def pedestrian(self) -> int | None:
        """Return the number of the nearest visible pedestrian ahead in or beside the ego's lane."""
        route = self.world.route
        for sight in self.sights:
            body = self.bodies[sight.body]
            if body.label is not ObstacleLabel.PERSON:
                continue
            _, offset_m = route.line.project(body.x_m, body.y_m, self.station_m + sight.depth_m)
            if abs(offset_m) < PEDESTRIAN_WITHIN_M:
                return sight.body
        return None


_COS_45: Final = math.cos(math.radians(45.0))


class ActiveError(ABC, Generic[T]):
    """One error during an episode: when and on whom it acts. Subclasses say what it does to a report.

    Args:
        error: The error.
    """

    def __init__(self, error: DetectionError) -> None:
        self._error = error
        self._has_effect = error.severity > 0.0
        self._lasts_s = error.duration_s if MAGNITUDES[error.type].has_duration else error.magnitude
        self._begun_s: float | None = None
        self._has_happened = False
        self._stepped_out: int | None = None
        self._only: int | None = None
        self._first_seen_s: dict[int, float] = {}
        self._ghosts: list[Solid] = []

    @abstractmethod
    def _edit(self, scene: Scene) -> Callable[[int, T], T | None]:
        """Return what the error makes of the report of a body; None if it is not reported."""

    @abstractmethod
    def _ghosts_now(self, scene: Scene) -> list[T]:
        """Return the reports of ghosts."""

    def apply(self, scene: Scene, reports: list[tuple[int, T]]) -> tuple[bool, list[tuple[int, T]]]:
        """Return whether the error changes anything, and the resulting reports, each with the number of its body."""
        if not self._has_effect:
            return False, reports
        error = self._error
        if error.type is ErrorType.LATE:
            return self._edited(reports, self._not_yet_reported(scene), _nothing)
        if error.type is ErrorType.SHORT_RANGE:
            far = {sight.body for sight in scene.sights if sight.depth_m > error.magnitude}
            return self._edited(reports, far & scene.group(error.target), _nothing)
        if not self._is_on(scene):
            return False, reports
        if error.type in GHOSTS:
            ghosts = self._ghosts_now(scene)
            return bool(ghosts), [*reports, *((-1, ghost) for ghost in ghosts)]
        if error.type is ErrorType.MISS or (error.type is ErrorType.FLICKER and self._flickers(scene)):
            return self._edited(reports, self._targets(scene), _nothing)
        if error.type is ErrorType.FLICKER:
            return False, reports
        return self._edited(reports, self._targets(scene), self._edit(scene))

    def _flickers(self, scene: Scene) -> bool:
        since_s = scene.time_s - (self._begun_s or 0.0) + _ROUNDING
        return since_s % FLICKER_PERIOD_S < self._error.magnitude * FLICKER_PERIOD_S

    def _is_on(self, scene: Scene) -> bool:
        """Return whether the window is open, and open it if its onset has come and there is a target."""
        if self._begun_s is None:
            if scene.time_s < self._error.onset_s - _ROUNDING or not self._begins(scene):
                return False
            self._begun_s = scene.time_s
        return scene.time_s - self._begun_s < self._lasts_s - _ROUNDING

    def _begins(self, scene: Scene) -> bool:
        """Return whether the window opens: its event has happened, and there is a target, which is noted."""
        error = self._error
        lead = scene.lead() if error.onset is Onset.LEAD_BRAKES or error.target is Target.LEAD else None
        match error.onset:
            case Onset.LEAD_BRAKES:
                self._has_happened = self._has_happened or lead in scene.braking
            case Onset.PEDESTRIAN_STEPS_OUT:
                if scene.stepped_out is not None and not self._has_happened:
                    self._stepped_out = scene.stepped_out
                self._has_happened = self._has_happened or scene.stepped_out is not None
            case Onset.TIME:
                self._has_happened = True
        if not self._has_happened:
            return False
        if error.type in GHOSTS:
            self._ghosts = ghost_bodies(scene, error.target, GHOST_AHEAD_M)
            return True
        if error.target is Target.LEAD:
            self._only = lead
        elif error.target is Target.PEDESTRIAN:
            self._only = scene.pedestrian() if self._stepped_out is None else self._stepped_out
        else:
            return bool(scene.group(error.target))
        return self._only is not None

    def _targets(self, scene: Scene) -> set[int]:
        return scene.group(self._error.target) if self._only is None else {self._only}

    def _not_yet_reported(self, scene: Scene) -> set[int]:
        for sight in scene.sights:
            self._first_seen_s.setdefault(sight.body, scene.time_s)
        return {
            body
            for body in scene.group(self._error.target)
            if scene.time_s - self._first_seen_s[body] < self._error.magnitude - _ROUNDING
        }

    def _edited(
        self, reports: list[tuple[int, T]], targets: set[int], edit: Callable[[int, T], T | None]
    ) -> tuple[bool, list[tuple[int, T]]]:
        if not targets:
            return False, reports
        changed, kept = False, []
        for body, report in reports:
            if body not in targets:
                kept.append((body, report))
                continue
            new = edit(body, report)
            changed = changed or new != report
            if new is not None:
                kept.append((body, new))
        return changed, kept


class _BoxError(ActiveError[Box]):
    """An error of the boxes."""

    def __init__(self, error: DetectionError, camera: Camera) -> None:
        super().__init__(error)
        self._camera = camera
        self._ghost_boxes: list[Box] = []

    def _edit(self, scene: Scene) -> Callable[[int, Box], Box | None]:
        error, camera = self._error, self._camera
        match error.type:
            case ErrorType.TOO_FAR:
                return lambda _, box: _at_distance(camera, box, 1.0 + error.magnitude)
            case ErrorType.TOO_NEAR:
                return lambda _, box: _at_distance(camera, box, 1.0 - error.magnitude)
            case ErrorType.LEFT:
                return lambda _, box: _moved_aside(camera, box, -error.magnitude)
            case ErrorType.RIGHT:
                return lambda _, box: _moved_aside(camera, box, error.magnitude)
            case ErrorType.TOO_LARGE:
                return lambda _, box: _scaled(camera, box, 1.0 + error.magnitude)
            case ErrorType.TOO_SMALL:
                return lambda _, box: _scaled(camera, box, 1.0 - error.magnitude)
            case _:
                return lambda _, box: relabelled(box)

    def _ghosts_now(self, scene: Scene) -> list[Box]:
        ego = scene.world.ego
        if self._error.type is ErrorType.GHOST_IN_IMAGE and self._ghost_boxes:
            # It stays in the image of the camera, whatever its pitch.
            return list(self._camera.all_tilted(self._ghost_boxes, -ego.pitch_rad))
        seen = [self._camera.project(ego.x_m, ego.y_m, ego.yaw_rad, body) for body in self._ghosts]
        boxes = [sight[0] for sight in seen if sight is not None]
        if self._error.type is ErrorType.GHOST_IN_IMAGE:
            self._ghost_boxes = list(self._camera.all_tilted(boxes, ego.pitch_rad))
        return boxes


def _nothing(_: int, report: object) -> None:
    return None


def relabelled(box: Box) -> Box:
    """Return a box with the other label."""
    is_person = box.label is ObstacleLabel.PERSON
    return box._replace(label=ObstacleLabel.VEHICLE if is_person else ObstacleLabel.PERSON)


def _at_distance(camera: Camera, box: Box, factor: float) -> Box | None:
    """Return a box with its bottom edge where something at another distance would stand.

    Args:
        camera: The camera.
        box: The box.
        factor: The new distance as a multiple of the one that the bottom edge shows.
    """
    below_px = (box.y_max_px - camera.horizon_px) / factor
    return clipped(camera, box._replace(y_max_px=camera.horizon_px + below_px))


def _moved_aside(camera: Camera, box: Box, right_m: float) -> Box | None:
    depth_m = camera.ground_depth_m(box.y_max_px)
    if depth_m is None:
        return box
    shift_px = right_m * camera.focal_px / depth_m
    return clipped(camera, box._replace(x_min_px=box.x_min_px + shift_px, x_max_px=box.x_max_px + shift_px))


def _scaled(camera: Camera, box: Box, factor: float) -> Box | None:
    middle_x, middle_y = 0.5 * (box.x_min_px + box.x_max_px), 0.5 * (box.y_min_px + box.y_max_px)
    half_width = 0.5 * factor * (box.x_max_px - box.x_min_px)
    half_height = 0.5 * factor * (box.y_max_px - box.y_min_px)
    return clipped(
        camera,
        Box(
            label=box.label,
            x_min_px=middle_x - half_width,
            x_max_px=middle_x + half_width,
            y_min_px=middle_y - half_height,
            y_max_px=middle_y + half_height,
        ),
    )


def clipped(camera: Camera, box: Box) -> Box | None:
    """Return the part of a box inside the image; None if hardly any is."""
    x_min, x_max = max(box.x_min_px, 0.0), min(box.x_max_px, float(camera.width_px))
    y_min, y_max = max(box.y_min_px, 0.0), min(box.y_max_px, float(camera.height_px))
    if x_max - x_min < _LEAST_PX or y_max - y_min < _LEAST_PX:
        return None
    return Box(label=box.label, x_min_px=x_min, x_max_px=x_max, y_min_px=y_min, y_max_px=y_max)


def ghost_bodies(scene: Scene, target: Target, ahead_m: float) -> list[Solid]:
    """Return the bodies that a ghost imitates, which stand on the ego's route that far ahead of its centre."""
    route = scene.world.route
    at_m = scene.station_m + ahead_m
    ghosts = []
    if target is not Target.PEDESTRIAN:
        aside_m = route.lane_width_m if target is Target.ONCOMING else 0.0
        x_m, y_m, yaw_rad = route.pose_at(at_m, aside_m)
        turn_rad = {Target.ONCOMING: math.pi, Target.CROSSING: 0.5 * math.pi}.get(target, 0.0)
        ghosts.append(
            Solid(
                ObstacleLabel.VEHICLE, x_m, y_m, yaw_rad + turn_rad, CAR.length_m, CAR.width_m, CAR.height_m
            )
        )
    if target in (Target.PEDESTRIAN, Target.EVERYBODY):
        x_m, y_m, yaw_rad = route.pose_at(at_m)
        ghosts.append(
            Solid(
                ObstacleLabel.PERSON,
                x_m,
                y_m,
                yaw_rad + 0.5 * math.pi,
                PERSON_LENGTH_M,
                PERSON_WIDTH_M,
                PERSON_HEIGHT_M,
            )
        )
    return ghosts
