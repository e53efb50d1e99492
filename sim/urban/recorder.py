"""The recorder: samples an episode while it runs and builds its `Trace` at the end."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import Box, Driving, ObstacleLabel
from brink.sim.episode import Json
from brink.sim.guard.guarded import Guarded
from brink.sim.requirements import WorldSample
from brink.sim.trace import BOX_COLUMNS, PERCEIVED_COLUMNS, ActorTrack, Event, GuardTrack, Ragged, Trace
from brink.sim.world.scenery import scene_surfaces
from brink.sim.world.world import RoadUser, World, bodies_of, screens_of

ROUTE_EVERY_M = 1.0
ROUTE_BEYOND_M = 15.0
_LABELS = {ObstacleLabel.VEHICLE: 0.0, ObstacleLabel.PERSON: 1.0}


class RaggedRows:
    """Accumulates rows of a `Ragged` array.

    Args:
        columns: Names of the columns.
    """

    def __init__(self, columns: tuple[str, ...]) -> None:
        self._columns = columns
        self._first = [0]
        self._rows: list[Sequence[float]] = []

    def add(self, rows: Sequence[Sequence[float]]) -> None:
        """Append an element with these rows."""
        self._rows += rows
        self._first.append(len(self._rows))

    def ragged(self) -> Ragged:
        """Return all elements so far."""
        rows = np.array(self._rows, dtype=np.float32).reshape(-1, len(self._columns))
        return Ragged(columns=self._columns, first=np.array(self._first, dtype=np.int32), rows=rows)


class Recorder:
    """Records an episode at the perception rate.

    Args:
        world: The world to record.
        requirements: Ids of the requirements, in order.
        camera: The obstacle detector's camera.
    """

    def __init__(self, world: World, requirements: Sequence[str], camera: Camera) -> None:
        self._world = world
        self._camera = camera
        self._ids = tuple(requirements)
        self._times: list[float] = []
        self._ego: list[tuple[float, float, float, float, float]] = []
        self._actors: list[RoadUser] = [*world.vehicles, *world.walkers]
        self._motions: list[list[tuple[float, float, float, float]]] = [[] for _ in self._actors]
        self._visible: list[list[float]] = []
        self._pitches: list[float] = []
        self._seen = RaggedRows(BOX_COLUMNS)
        self._given = RaggedRows(BOX_COLUMNS)
        self._perceived = RaggedRows(PERCEIVED_COLUMNS)
        self._modes: list[str] = []
        self._speeds: list[float] = []
        self._offsets: list[float] = []
        self._lights: list[str] = []
        self._robustness: dict[str, list[float]] = {name: [] for name in requirements}
        self._least: dict[str, float] = dict.fromkeys(requirements, math.inf)
        self._events: list[Event] = []
        self._readings: list[tuple[tuple[float, ...], bool, bool]] = []
        self._shown: tuple[Sequence[Box], Sequence[Box]] = ((), ())
        self._mode: str | None = None

    def sample(
        self, time_s: float, driving: Driving, seen: Sequence[Box], given: Sequence[Box], light: str
    ) -> None:
        """Record a perception step, after the driving system has decided.

        Args:
            time_s: Simulated time.
            driving: The system under test.
            seen: Ground-truth boxes.
            given: Boxes that the obstacle detector reported.
            light: State of the ego's traffic light, empty if there is none.
        """
        ego = self._world.ego
        self._shown = seen, given
        self._close_sample()
        self._times.append(time_s)
        self._ego.append((ego.x_m, ego.y_m, ego.yaw_rad, ego.speed_mps, ego.accel_mps2))
        for motion, actor in zip(self._motions, self._actors, strict=True):
            motion.append((actor.x_m, actor.y_m, actor.yaw_rad, actor.speed_mps))
        self._pitches.append(ego.pitch_rad)
        self._visible.append(self._visible_shares())
        self._seen.add([_box_row(box) for box in seen])
        self._given.add([_box_row(box) for box in given])
        self._perceived.add(
            [
                (
                    float(obstacle.track),
                    _LABELS[obstacle.label],
                    obstacle.x_m,
                    obstacle.y_m,
                    obstacle.vx_mps,
                    obstacle.vy_mps,
                    obstacle.length_m,
                    obstacle.width_m,
                )
                for obstacle in driving.obstacles
            ]
        )
        plan = driving.plan
        mode = str(plan.mode)
        if mode != self._mode:
            if self._mode is not None:
                self.event(time_s, f"plan-{mode}", f"the plan is now: {mode or 'unknown'}")
            self._mode = mode
        self._modes.append(mode)
        self._speeds.append(plan.target_speed_mps)
        self._offsets.append(plan.target_offset_m)
        self._lights.append(light)
        if isinstance(driving, Guarded):
            reading = driving.reading
            self._readings.append((reading.probabilities, reading.alarm, driving.intervenes))

    def _visible_shares(self) -> list[float]:
        """Return the visible share of each road user; NaN if it is not in the camera's image."""
        world, ego = self._world, self._world.ego
        shares = [math.nan] * len(self._actors)
        for sight in self._camera.sights(
            ego.x_m, ego.y_m, ego.yaw_rad, bodies_of(world), screens_of(world.road)
        ):
            shares[sight.body] = sight.visible
        return shares

    def end(self, time_s: float, driving: Driving, light: str) -> None:
        """Record the end of the episode, with the boxes of the last perception step.

        Args:
            time_s: Simulated time.
            driving: The system under test.
            light: State of the ego's traffic light, empty if there is none.
        """
        self.sample(time_s, driving, *self._shown, light)

    def judge(self, requirement: str, robustness: float) -> None:
        """Record a requirement's robustness at a control step; each sample keeps the smallest since the last."""
        if robustness < self._least[requirement]:
            self._least[requirement] = robustness

    def _close_sample(self) -> None:
        if len(self._times) > len(next(iter(self._robustness.values()), self._times)):
            for name, series in self._robustness.items():
                least = self._least[name]
                # Requirements are not evaluated after the end, so the last value stays.
                series.append(series[-1] if series and math.isinf(least) else least)
                self._least[name] = math.inf

    def event(self, time_s: float, kind: str, text: str) -> None:
        """Record an event.

        Args:
            time_s: Simulated time.
            kind: Kind of the event, such as ``collision``.
            text: Description for people.
        """
        self._events.append(Event(time_s=time_s, kind=kind, text=text))

    def watch(self, sample: WorldSample) -> None:
        """Record the events of a control step."""
        if sample.collision is not None:
            hit = sample.collision
            self.event(
                sample.time_s,
                "collision",
                f"the ego hits {hit.counterpart} at {hit.impact_speed_mps:.1f} m/s",
            )
        if sample.goal_reached:
            self.event(sample.time_s, "goal", "the ego reaches the end of its route")

    def trace(self, about: Mapping[str, Json], guarded: Guarded | None = None) -> Trace:
        """Return the trace of the whole episode.

        Args:
            about: What the trace says about itself.
            guarded: The driving system, if it has a guard.
        """
        self._close_sample()
        world = self._world
        line = world.route.line
        count = math.ceil((line.length_m + ROUTE_BEYOND_M) / ROUTE_EVERY_M)
        route = [line.pose_at(ROUTE_EVERY_M * i)[:2] for i in range(count + 1)]
        visible = np.array(self._visible, dtype=np.float32).reshape(len(self._times), len(self._actors))
        actors = tuple(
            ActorTrack(
                name=actor.name,
                kind="vehicle" if index < len(world.vehicles) else "pedestrian",
                length_m=actor.length_m,
                width_m=actor.width_m,
                motion=np.array(motion, dtype=np.float32).reshape(-1, 4),
                visible=visible[:, index],
            )
            for index, (actor, motion) in enumerate(zip(self._actors, self._motions, strict=True))
        )
        return Trace(
            time_s=np.array(self._times, dtype=np.float32),
            ego=np.array(self._ego, dtype=np.float32).reshape(-1, 5),
            ego_size_m=(world.ego.length_m, world.ego.width_m),
            route=np.array(route, dtype=np.float32),
            actors=actors,
            seen_boxes=self._seen.ragged(),
            given_boxes=self._given.ragged(),
            perceived=self._perceived.ragged(),
            plan_mode=tuple(self._modes),
            target_speed_mps=np.array(self._speeds, dtype=np.float32),
            target_offset_m=np.array(self._offsets, dtype=np.float32),
            lights=tuple(self._lights),
            robustness={
                name: np.array(series, dtype=np.float32) for name, series in self._robustness.items()
            },
            events=tuple(sorted(self._events, key=lambda event: event.time_s)),
            scene=scene_surfaces(world.road),
            about=about,
            guard=None if guarded is None else self._guard_track(guarded),
            pitch_rad=np.array(self._pitches, dtype=np.float32),
        )

    def _guard_track(self, guarded: Guarded) -> GuardTrack:
        """Return the guard's reading at each sample."""
        horizons_s = guarded.horizons_s
        rows = [probabilities for probabilities, _, _ in self._readings]
        return GuardTrack(
            fallback=guarded.fallback_id,
            horizons_s=horizons_s,
            probabilities=np.array(rows, dtype=np.float32).reshape(-1, len(horizons_s)),
            alarm=np.array([alarm for _, alarm, _ in self._readings], dtype=np.uint8),
            intervenes=np.array([intervenes for _, _, intervenes in self._readings], dtype=np.uint8),
        )


def _box_row(box: Box) -> tuple[float, ...]:
    return (_LABELS[box.label], box.x_min_px, box.x_max_px, box.y_min_px, box.y_max_px)
