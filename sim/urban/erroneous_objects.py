"""The sensor that reports the truth as a list of objects, with errors.

It reports whom the camera could have seen. Errors act on objects in the ego's frame at the time of the report, one
after another; an error of severity 0 changes nothing. Objects are moved on to the time at which they arrive, by the
reported velocity, and are relative to where the ego then really is. Systems that get boxes, guards, and Brink's own
driving system where it fills in, get the boxes of the reported objects, so that they see the same errors.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Final, NamedTuple

from brink.sim.driving.camera import Camera, Solid
from brink.sim.driving.interface import PERCEPTION_STEP_S, Box, ObstacleLabel, SeenObject
from brink.sim.urban.detection_errors import DetectionError, ErrorType
from brink.sim.urban.erroneous_detector import ActiveError, Observer, Scene
from brink.sim.urban.error_process import FloatArray
from brink.sim.world.ego import EgoMotion
from brink.sim.world.streams import Stream, generator
from brink.sim.world.world import World

NEAREST_M: Final = 0.1
"""Nobody is reported nearer than this to the camera."""
_GHOST_ID: Final = 1_000
_NEW_ID: Final = 100_000


class ObjectReport(NamedTuple):
    """An object in the world, as of the time of a report.

    Attributes:
        id: Number of its track.
        existence: How sure it is, in [0, 1].
        solid: Its body; the height serves boxes alone.
        vx_mps: Velocity over ground, in the world.
        vy_mps: Velocity over ground, in the world.
    """

    id: int
    existence: float
    solid: Solid
    vx_mps: float
    vy_mps: float


class ErroneousObjects:
    """Reports the truth with errors. Create a new one for each episode.

    Args:
        world: The world of the episode.
        camera: The camera that decides who is seen.
        errors: The errors, which act in this order.
        seed: The episode's seed.
        steps: Number of perception steps.

    Attributes:
        objects: What was reported last.
        steps: For each error, the first and last perception step at which it changed the output; None if it never
            did.
    """

    def __init__(
        self, world: World, camera: Camera, errors: Sequence[DetectionError], *, seed: int, steps: int
    ) -> None:
        self._world = world
        self._camera = camera
        self._observer = Observer(world, camera)
        self._errors = [
            _ObjectError(error, camera, seed=seed, index=index, steps=steps)
            for index, error in enumerate(errors)
        ]
        self.objects: tuple[ObjectReport, ...] = ()
        self.steps: list[tuple[int, int] | None] = [None] * len(errors)

    def __call__(self, time_s: float) -> tuple[Box, ...]:
        """Report objects at a perception step, and return their boxes."""
        scene = self._observer.look(time_s)
        movers = (*self._world.vehicles, *self._world.walkers)
        reports: list[tuple[int, ObjectReport]] = []
        for sight in scene.sights:
            solid, speed_mps = scene.bodies[sight.body], movers[sight.body].speed_mps
            velocity = speed_mps * math.cos(solid.yaw_rad), speed_mps * math.sin(solid.yaw_rad)
            reports.append((sight.body, ObjectReport(sight.body, 1.0, solid, *velocity)))
        step = round(time_s / PERCEPTION_STEP_S)
        for index, error in enumerate(self._errors):
            changed, reports = error.apply(scene, reports)
            if changed:
                since = self.steps[index]
                self.steps[index] = (since[0] if since else step, step)
        self.objects = tuple(report for _, report in reports)
        ego = self._world.ego
        seen = (self._camera.project(ego.x_m, ego.y_m, ego.yaw_rad, one.solid) for one in self.objects)
        return self._camera.all_tilted((one[0] for one in seen if one is not None), ego.pitch_rad)


class _ObjectError(ActiveError[ObjectReport]):
    """An error of the objects."""

    def __init__(self, error: DetectionError, camera: Camera, *, seed: int, index: int, steps: int) -> None:
        super().__init__(error)
        self._camera = camera
        self._index = index
        self._seed, self._steps = seed, steps
        self._noise: dict[int, FloatArray] = {}
        self._past: dict[int, dict[int, ObjectReport]] = {}
        self._place: list[tuple[float, float, float]] = []

    def apply(
        self, scene: Scene, reports: list[tuple[int, ObjectReport]]
    ) -> tuple[bool, list[tuple[int, ObjectReport]]]:
        if self._error.type is ErrorType.STALE:
            step = round(scene.time_s / PERCEPTION_STEP_S)
            for body, report in reports:
                self._past.setdefault(body, {})[step] = report
        return super().apply(scene, reports)

    def _edit(self, scene: Scene) -> Callable[[int, ObjectReport], ObjectReport | None]:
        much, ego = self._error.magnitude, scene.world.ego
        step = round(scene.time_s / PERCEPTION_STEP_S)
        match self._error.type:
            case ErrorType.TOO_FAR:
                return lambda _, one: self._at_distance(ego, one, 1.0 + much)
            case ErrorType.TOO_NEAR:
                return lambda _, one: self._at_distance(ego, one, 1.0 - much)
            case ErrorType.LEFT:
                return lambda _, one: _moved(one, -much * math.sin(ego.yaw_rad), much * math.cos(ego.yaw_rad))
            case ErrorType.RIGHT:
                return lambda _, one: _moved(one, much * math.sin(ego.yaw_rad), -much * math.cos(ego.yaw_rad))
            case ErrorType.TOO_LARGE:
                return lambda _, one: _scaled(one, 1.0 + much)
            case ErrorType.TOO_SMALL:
                return lambda _, one: _scaled(one, 1.0 - much)
            case ErrorType.TOO_FAST:
                return lambda _, one: _faster(one, much)
            case ErrorType.TOO_SLOW:
                return lambda _, one: _faster(one, -much)
            case ErrorType.STALE:
                return lambda body, _: self._earlier(body, step, much)
            case ErrorType.UNSURE:
                return lambda _, one: one._replace(existence=one.existence * (1.0 - much))
            case ErrorType.NEW_ID:
                return lambda body, one: one._replace(id=_NEW_ID * (step + 1) + body)
            case ErrorType.NOISE:
                return lambda body, one: self._noisy(ego, one, body, step)
            case _:
                return lambda _, one: _relabelled(one)

    def _ghosts_now(self, scene: Scene) -> list[ObjectReport]:
        ego, in_image = scene.world.ego, self._error.type is ErrorType.GHOST_IN_IMAGE
        cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
        if in_image and not self._place:
            self._place = [
                (
                    (ghost.x_m - ego.x_m) * cos_yaw + (ghost.y_m - ego.y_m) * sin_yaw,
                    (ghost.y_m - ego.y_m) * cos_yaw - (ghost.x_m - ego.x_m) * sin_yaw,
                    ghost.yaw_rad - ego.yaw_rad,
                )
                for ghost in self._ghosts
            ]
        ghosts, velocity = self._ghosts, (0.0, 0.0)
        if in_image:
            velocity = ego.speed_mps * cos_yaw, ego.speed_mps * sin_yaw
            ghosts = [
                ghost._replace(
                    x_m=ego.x_m + ahead * cos_yaw - left * sin_yaw,
                    y_m=ego.y_m + ahead * sin_yaw + left * cos_yaw,
                    yaw_rad=ego.yaw_rad + turn,
                )
                for ghost, (ahead, left, turn) in zip(self._ghosts, self._place, strict=True)
            ]
        return [
            ObjectReport(_GHOST_ID * (self._index + 1) + number, 1.0, ghost, *velocity)
            for number, ghost in enumerate(ghosts)
            if self._camera.project(ego.x_m, ego.y_m, ego.yaw_rad, ghost) is not None
        ]

    def _at_distance(self, ego: EgoMotion, one: ObjectReport, factor: float) -> ObjectReport:
        """Return an object with its near face at another distance: same bearing, relative velocity scaled, too."""
        cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
        x_m, y_m = ego.x_m + self._camera.forward_m * cos_yaw, ego.y_m + self._camera.forward_m * sin_yaw
        dx, dy = one.solid.x_m - x_m, one.solid.y_m - y_m
        range_m = math.hypot(dx, dy)
        bearing = math.atan2(dy, dx) - one.solid.yaw_rad
        half_m = 0.5 * min(
            one.solid.length_m / max(abs(math.cos(bearing)), 1e-9),
            one.solid.width_m / max(abs(math.sin(bearing)), 1e-9),
        )
        farther = (factor - 1.0) * max(range_m - half_m, NEAREST_M) / max(range_m, NEAREST_M)
        vx, vy = ego.speed_mps * cos_yaw, ego.speed_mps * sin_yaw
        return _moved(one, farther * dx, farther * dy)._replace(
            vx_mps=vx + factor * (one.vx_mps - vx), vy_mps=vy + factor * (one.vy_mps - vy)
        )

    def _earlier(self, body: int, step: int, age_s: float) -> ObjectReport:
        """Return the report of a body from some time ago, or its first one if it was not reported then."""
        past, wanted = self._past[body], step - round(age_s / PERCEPTION_STEP_S)
        return past[max((one for one in past if one <= wanted), default=min(past))]

    def _noisy(self, ego: EgoMotion, one: ObjectReport, body: int, step: int) -> ObjectReport:
        """Return an object at a place with noise; draws are addressed by error, body and step."""
        if body not in self._noise:
            seed, steps = self._seed, self._steps
            stream = generator(seed, Stream.DETECTOR_NOISE, _GHOST_ID * (self._index + 1) + body)
            self._noise[body] = stream.normal(size=(steps, 2))
        x, y = self._noise[body][step].tolist()
        sigma_m = self._error.magnitude * math.hypot(one.solid.x_m - ego.x_m, one.solid.y_m - ego.y_m)
        return _moved(one, sigma_m * x, sigma_m * y)


def seen_from(reports: Iterable[ObjectReport], ego: EgoMotion, age_s: float) -> tuple[SeenObject, ...]:
    """Return reported objects in the ego's frame, moved on by the age of the report."""
    cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
    seen = []
    for one in reports:
        solid = one.solid
        dx = solid.x_m + age_s * one.vx_mps - ego.x_m
        dy = solid.y_m + age_s * one.vy_mps - ego.y_m
        seen.append(
            SeenObject(
                id=one.id,
                label=solid.label,
                existence=one.existence,
                x_m=dx * cos_yaw + dy * sin_yaw,
                y_m=dy * cos_yaw - dx * sin_yaw,
                yaw_rad=(solid.yaw_rad - ego.yaw_rad + math.pi) % (2.0 * math.pi) - math.pi,
                vx_mps=one.vx_mps * cos_yaw + one.vy_mps * sin_yaw,
                vy_mps=one.vy_mps * cos_yaw - one.vx_mps * sin_yaw,
                length_m=solid.length_m,
                width_m=solid.width_m,
            )
        )
    return tuple(seen)


def _moved(one: ObjectReport, dx_m: float, dy_m: float) -> ObjectReport:
    return one._replace(solid=one.solid._replace(x_m=one.solid.x_m + dx_m, y_m=one.solid.y_m + dy_m))


def _scaled(one: ObjectReport, factor: float) -> ObjectReport:
    length_m, width_m, height_m = (
        factor * size for size in (one.solid.length_m, one.solid.width_m, one.solid.height_m)
    )
    return one._replace(solid=one.solid._replace(length_m=length_m, width_m=width_m, height_m=height_m))


def _faster(one: ObjectReport, more_mps: float) -> ObjectReport:
    yaw_rad = one.solid.yaw_rad
    return one._replace(
        vx_mps=one.vx_mps + more_mps * math.cos(yaw_rad), vy_mps=one.vy_mps + more_mps * math.sin(yaw_rad)
    )


def _relabelled(one: ObjectReport) -> ObjectReport:
    is_person = one.solid.label is ObstacleLabel.PERSON
    label = ObstacleLabel.VEHICLE if is_person else ObstacleLabel.PERSON
    return one._replace(solid=one.solid._replace(label=label))
