"""Records an episode of another simulator as a `Trace`, so that replays look like those of Brink's own simulators.

An adapter knows positions, not camera images: the trace has road users, what the driving system perceives, and the
road from above. Boxes in an image are optional: those of a camera that the car might have.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from brink.sim.driving.interface import Box, ObstacleLabel
from brink.sim.episode import Json
from brink.sim.trace import (
    BOX_COLUMNS,
    PERCEIVED_COLUMNS,
    ActorTrack,
    Event,
    FloatArray,
    Ragged,
    Surface,
    Trace,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pose:
    """Position and heading of a road user.

    Attributes:
        x_m: Centre of its body.
        y_m: Centre of its body.
        yaw_rad: Heading, counter-clockwise from x.
        speed_mps: Speed along the heading.
    """

    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Actor:
    """A road user other than the ego: its kind, ``vehicle`` or ``pedestrian``, and its size."""

    kind: str
    length_m: float
    width_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Perceived:
    """A road user as the driving system perceives it, which may be wrong or made up.

    Attributes:
        track: Number that stays the same from sample to sample.
        pose: Where it seems to be.
        length_m: How long it seems.
        width_m: How wide it seems.
        is_person: Whether it seems to be a person.
    """

    track: int
    pose: Pose
    length_m: float
    width_m: float
    is_person: bool = False


class TopDownRecorder:
    """Records an episode from above, one sample for each decision of the driving system.

    Args:
        requirements: Ids of the requirements, in order.
        ego_size_m: Length and width of the ego.
        scene: Static surfaces in drawing order.
        route: The centre line of the ego's lane, shape ``(k, 2)``; may be empty.
    """

    def __init__(
        self,
        requirements: Sequence[str],
        *,
        ego_size_m: tuple[float, float],
        scene: Sequence[Surface],
        route: FloatArray,
    ) -> None:
        self._ego_size_m = ego_size_m
        self._scene = tuple(scene)
        self._route = np.asarray(route, np.float32).reshape(-1, 2)
        self._times: list[float] = []
        self._ego: list[tuple[float, float, float, float, float]] = []
        self._actors: dict[str, Actor] = {}
        self._poses: list[Mapping[str, Pose]] = []
        self._perceived: list[Sequence[Perceived]] = []
        self._boxes: list[tuple[Sequence[Box], Sequence[Box]]] = []
        self._plans: list[str] = []
        self._lights: list[str] = []
        self._targets: list[tuple[float, float]] = []
        self._robustness: dict[str, list[float]] = {name: [] for name in requirements}
        self._events: list[Event] = []

    def sample(
        self,
        time_s: float,
        ego: Pose,
        accel_mps2: float,
        actors: Mapping[str, tuple[Actor, Pose]],
        *,
        perceived: Sequence[Perceived] = (),
        plan: str = "",
        target_speed_mps: float = math.nan,
        target_offset_m: float = 0.0,
        robustness: Mapping[str, float],
        seen: Sequence[Box] = (),
        given: Sequence[Box] = (),
        light: str = "",
    ) -> None:
        """Record a sample.

        Args:
            time_s: Simulated time, later than the last sample's.
            ego: Where the ego is.
            accel_mps2: The ego's acceleration along its heading.
            actors: The other road users by name. One that is absent now may come back.
            perceived: What the driving system perceives.
            plan: What it does about it, in a word or two.
            target_speed_mps: Speed that it aims at.
            target_offset_m: Offset from the route that it aims at.
            robustness: Robustness of each requirement, the smallest since the last sample.
            seen: The other road users in the image of the trace's camera.
            given: What is perceived, in the same image.
            light: State of the ego's traffic light: ``red``, ``amber`` or ``green``; empty without one.
        """
        self._times.append(time_s)
        self._ego.append((ego.x_m, ego.y_m, ego.yaw_rad, ego.speed_mps, accel_mps2))
        self._actors.update({name: actor for name, (actor, _) in actors.items()})
        self._poses.append({name: pose for name, (_, pose) in actors.items()})
        self._perceived.append(tuple(perceived))
        self._boxes.append((tuple(seen), tuple(given)))
        self._plans.append(plan)
        self._lights.append(light)
        self._targets.append((target_speed_mps, target_offset_m))
        for name, series in self._robustness.items():
            series.append(robustness[name])

    def event(self, time_s: float, kind: str, text: str) -> None:
        """Record an event, such as a collision, with a readable description."""
        self._events.append(Event(time_s=time_s, kind=kind, text=text))

    def trace(self, about: Mapping[str, Json]) -> Trace:
        """Return the trace of the whole episode.

        Args:
            about: Its header, from `brink.sim.provenance.trace_header`.
        """
        targets = np.array(self._targets, np.float32).reshape(-1, 2)
        return Trace(
            time_s=np.array(self._times, np.float32),
            ego=np.array(self._ego, np.float32).reshape(-1, 5),
            ego_size_m=self._ego_size_m,
            route=self._route,
            actors=tuple(self._track(name, actor) for name, actor in self._actors.items()),
            seen_boxes=_box_rows([seen for seen, _ in self._boxes]),
            given_boxes=_box_rows([given for _, given in self._boxes]),
            perceived=self._perceived_rows(),
            plan_mode=tuple(self._plans),
            target_speed_mps=targets[:, 0],
            target_offset_m=targets[:, 1],
            lights=tuple(self._lights),
            robustness={name: np.array(series, np.float32) for name, series in self._robustness.items()},
            events=tuple(sorted(self._events, key=lambda event: event.time_s)),
            scene=self._scene,
            about=about,
        )

    def _track(self, name: str, actor: Actor) -> ActorTrack:
        absent = (math.nan,) * 4
        rows = [
            absent if pose is None else (pose.x_m, pose.y_m, pose.yaw_rad, pose.speed_mps)
            for pose in (poses.get(name) for poses in self._poses)
        ]
        return ActorTrack(
            name=name,
            kind=actor.kind,
            length_m=actor.length_m,
            width_m=actor.width_m,
            motion=np.array(rows, np.float32).reshape(-1, 4),
        )

    def _perceived_rows(self) -> Ragged:
        rows = [
            (
                one.track,
                float(one.is_person),
                one.pose.x_m,
                one.pose.y_m,
                one.pose.speed_mps * math.cos(one.pose.yaw_rad),
                one.pose.speed_mps * math.sin(one.pose.yaw_rad),
                one.length_m,
                one.width_m,
            )
            for sample in self._perceived
            for one in sample
        ]
        first = np.cumsum([0, *(len(sample) for sample in self._perceived)])
        return Ragged(
            columns=PERCEIVED_COLUMNS,
            first=first.astype(np.int32),
            rows=np.array(rows, np.float32).reshape(-1, len(PERCEIVED_COLUMNS)),
        )


def _box_rows(samples: Sequence[Sequence[Box]]) -> Ragged:
    rows = [(float(box.label is ObstacleLabel.PERSON), *box[1:]) for boxes in samples for box in boxes]
    first = np.cumsum([0, *(len(boxes) for boxes in samples)])
    return Ragged(
        columns=BOX_COLUMNS,
        first=first.astype(np.int32),
        rows=np.array(rows, np.float32).reshape(-1, len(BOX_COLUMNS)),
    )
