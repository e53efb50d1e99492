"""The emergency-braking episode: the control loop, and the monitor that measures distances and contacts.

Every frame, the loop observes, decides, drives, measures, judges and records. The monitor looks for contacts at 100
Hz, independently of the camera's frame rate and of the detector.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from brink.sim.aeb.braking import PERSON, EmergencyBrake
from brink.sim.aeb.recorder import AebRecorder
from brink.sim.aeb.sight import FrameObservation, Sight
from brink.sim.aeb.street import CRUISE_MPS, END_M, LANE_M, LANE_Y_M, Actor, Street
from brink.sim.bullet.engine import Block, BodyId, Engine
from brink.sim.plane import half_extents_m
from brink.sim.rendering.scene import Body, BodyKind
from brink.sim.requirements import Collision, CollisionKind, Requirement, WorldSample
from brink.sim.world.ego import PHYSICS_STEP_S, EgoCar

NEAR_M: Final = 8.0
CREEPING_MPS: Final = 0.05
"""Contacts at a lower ego speed are not collisions of the ego: the other body moves into it."""
CAMERA_FORWARD_M: Final = 1.3
REGION_AHEAD_M: Final = 10.5
"""How far the warning region extends ahead of the camera on the ground, plus half a car's width."""
REGION_ASIDE_M: Final = 1.9
LOOK_AHEAD_S: Final = 2.0
"""Time within which a body must reach the region, at constant velocities, to be expected in it."""

_KINDS: Final = {BodyKind.VEHICLE: CollisionKind.VEHICLE, BodyKind.PERSON: CollisionKind.PEDESTRIAN}


class WorldMonitor:
    """Measures the ground-truth state of an episode.

    Args:
        street: The street; its bodies are added to the engine.
        ego: The car under test.
        engine: An empty physics engine.
    """

    def __init__(self, street: Street, ego: EgoCar, engine: Engine) -> None:
        self._street = street
        self._ego = ego
        self._engine = engine
        model = ego.model
        blocks = [
            Block(
                length_m=ego.length_m,
                width_m=ego.width_m,
                height_m=model.height_m,
                x_m=ego.x_m,
                y_m=ego.y_m,
                yaw_rad=ego.yaw_rad,
            ),
            *(_block(actor.body) for actor in street.actors),
            *(_block(body) for body in street.scene.parked),
        ]
        ids = engine.add_blocks(blocks)
        count = len(street.actors)
        self._ego_body = ids[0]
        self._actors = list(zip(street.actors, ids[1 : 1 + count], strict=True))
        self._parked = list(zip(street.scene.parked, ids[1 + count :], strict=True))
        self._gap_m: float | None = None
        self._person_m: float | None = None
        self._closing_mps = 0.0
        self._collision: Collision | None = None

    def update(self) -> None:
        """Measure contacts and clearances now; call it after every step of the ego and before `sample`."""
        ego = self._ego
        self._engine.move(self._ego_body, ego.x_m, ego.y_m, ego.yaw_rad, ego.model.height_m)
        self._gap_m, self._person_m, self._closing_mps = None, None, 0.0
        for actor, body in self._actors:
            if self._far(actor.x_m, actor.y_m, actor.body):
                continue
            self._engine.move(body, actor.x_m, actor.y_m, actor.body.yaw_rad, actor.body.height_m)
            heading = actor.body.yaw_rad
            velocity = (actor.speed_mps * math.cos(heading), actor.speed_mps * math.sin(heading))
            self._measure(body, actor.body, actor.name, velocity, beside=actor.name.startswith("oncoming"))
        for still, body in self._parked:
            if not self._far(still.x_m, still.y_m, still):
                self._measure(body, still, "parked-car", (0.0, 0.0), beside=True)

    def _far(self, x_m: float, y_m: float, body: Body) -> bool:
        ego = self._ego
        reach_m = NEAR_M + 0.5 * (ego.length_m + body.length_m + body.width_m) + 1.0
        return abs(x_m - ego.x_m) > reach_m or abs(y_m - ego.y_m) > reach_m

    def _measure(
        self, body: BodyId, shape: Body, name: str, velocity: tuple[float, float], *, beside: bool
    ) -> None:
        """Measure the clearance between a body and the ego; if it passes `beside` the ego, only contacts count."""
        found = self._engine.closest(self._ego_body, body, NEAR_M)
        if found is None:
            return
        ego = self._ego
        along = velocity[0] - ego.speed_mps * math.cos(ego.yaw_rad)
        across = velocity[1] - ego.speed_mps * math.sin(ego.yaw_rad)
        gap_m = max(found.clearance_m, 0.0)
        if shape.kind is BodyKind.PERSON:
            self._person_m = gap_m if self._person_m is None else min(gap_m, self._person_m)
        if not beside and (self._gap_m is None or gap_m < self._gap_m):
            self._gap_m = gap_m
            self._closing_mps = along * found.normal_x + across * found.normal_y
        if found.clearance_m <= 0.0 and abs(ego.speed_mps) > CREEPING_MPS and self._collision is None:
            kind = _KINDS.get(shape.kind, CollisionKind.OBJECT)
            self._collision = Collision(
                kind=kind, counterpart=name, impact_speed_mps=math.hypot(along, across)
            )

    @property
    def collided(self) -> bool:
        """Whether the ego has hit anything."""
        return self._collision is not None

    def anyone_expected(self) -> bool:
        """Return whether, by ground truth, anyone is in the warning region or on a course into it."""
        return any(self._expects(actor) for actor, _ in self._actors)

    def _expects(self, actor: Actor) -> bool:
        ego, body = self._ego, actor.body
        half_along, half_across = half_extents_m(body.length_m, body.width_m, body.yaw_rad)
        vx = actor.speed_mps * math.cos(body.yaw_rad)
        vy = actor.speed_mps * math.sin(body.yaw_rad)
        for tenth in range(round(LOOK_AHEAD_S / 0.1) + 1):
            later_s = 0.1 * tenth
            ahead_m = actor.x_m + vx * later_s - (ego.x_m + ego.speed_mps * later_s + CAMERA_FORWARD_M)
            aside_m = actor.y_m + vy * later_s - ego.y_m
            if (
                -half_along <= ahead_m - half_along <= REGION_AHEAD_M
                and abs(aside_m) <= REGION_ASIDE_M + half_across
            ):
                return True
        return False

    def sample(self, time_s: float, *, brakes_for_nothing: bool) -> WorldSample:
        """Return the current ground-truth state."""
        ego = self._ego
        front_m = self._front_gap()
        return WorldSample(
            time_s=time_s,
            x_m=ego.x_m,
            y_m=ego.y_m,
            yaw_rad=ego.yaw_rad,
            speed_mps=ego.speed_mps,
            station_m=ego.x_m,
            offset_m=ego.y_m - LANE_Y_M,
            heading_error_rad=ego.yaw_rad,
            ego_length_m=ego.length_m,
            ego_width_m=ego.width_m,
            lane_left_m=0.5 * LANE_M,
            lane_right_m=-0.5 * LANE_M,
            speed_limit_mps=CRUISE_MPS + 2.0,
            front_gap_m=front_m,
            pedestrian_gap_m=self._person_m,
            nearest_gap_m=self._gap_m,
            closing_speed_mps=self._closing_mps,
            collision=self._collision,
            may_wait=self.anyone_expected(),
            goal_reached=ego.x_m > END_M - 20.0,
            brakes_for_nothing=brakes_for_nothing,
        )

    def _front_gap(self) -> float | None:
        """Return the bumper-to-bumper gap to the nearest vehicle ahead in the ego's lane."""
        ego = self._ego
        gaps = [
            actor.x_m - 0.5 * actor.body.length_m - ego.x_m - 0.5 * ego.length_m
            for actor, _ in self._actors
            if actor.body.kind is not BodyKind.PERSON
            and abs(actor.y_m - ego.y_m) < 0.5 * (ego.width_m + actor.body.width_m)
            and actor.x_m > ego.x_m
        ]
        nearest_m = min(gaps, default=None)
        return None if nearest_m is None or nearest_m > 50.0 else max(nearest_m, 0.0)


def _block(body: Body) -> Block:
    return Block(
        length_m=body.length_m,
        width_m=body.width_m,
        height_m=body.height_m,
        x_m=body.x_m,
        y_m=body.y_m,
        yaw_rad=body.yaw_rad,
    )


FRAME_S: Final = 0.05
PHYSICS_STEPS: Final = round(FRAME_S / PHYSICS_STEP_S)
FULL_BRAKE_MPS2: Final = -12.0
LOOK_BACK_FRAMES: Final = 10
"""Braking is justified if someone was expected in the region within this many frames."""
PAST_LINE_M: Final = 15.0
"""The episode ends when the ego is this far beyond the pedestrian's line."""


@dataclass(slots=True, kw_only=True)
class Outcome:
    """Result of an episode beyond what its requirements measure.

    Attributes:
        ended: ``collision``, ``past`` or ``time``.
        frames: Number of frames.
        time_s: When the episode ended.
        collision: The ego's collision, if there was one.
        first_seen_s: When a person was first detected.
        braked_at_s: When the brake was first applied.
        stopped_at_s: When the ego first stood still.
        stopping_gap_m: Clearance at that time to the nearest person or to an obstacle ahead in the lane.
    """

    ended: str = "time"
    frames: int = 0
    time_s: float = 0.0
    collision: Collision | None = None
    first_seen_s: float | None = None
    braked_at_s: float | None = None
    stopped_at_s: float | None = None
    stopping_gap_m: float | None = None


@dataclass(slots=True, kw_only=True)
class Episode:
    """One episode. Its parts are stateful and are created for each episode.

    Attributes:
        street: The street.
        ego: The car under test.
        monitor: Measures the ground-truth state.
        sight: Provides the observations.
        brake: Decides when to brake.
        requirements: By id; they observe every frame.
        line_m: Distance from the ego's bumper to the pedestrian's line.
        recorder: Records the trace, if given.
    """

    street: Street
    ego: EgoCar
    monitor: WorldMonitor
    sight: Sight
    brake: EmergencyBrake
    requirements: Mapping[str, Requirement]
    line_m: float
    recorder: AebRecorder | None = None
    outcome: Outcome = field(default_factory=Outcome)
    _braking: bool = False
    _justified: bool = False
    _expected_frame: int = -1000

    def run(self, duration_s: float) -> Outcome:
        """Run until the first collision, until the ego is past the pedestrian's line, or until time is up."""
        for frame in range(round(duration_s / FRAME_S)):
            sample = self._step(frame)
            self.outcome.frames = frame + 1
            self.outcome.time_s = sample.time_s
            if sample.collision is not None:
                self.outcome.ended, self.outcome.collision = "collision", sample.collision
                break
            if self.ego.x_m > self.line_m + PAST_LINE_M:
                self.outcome.ended = "past"
                break
        if self.recorder is not None:
            self.recorder.finish(self.outcome.time_s)
        return self.outcome

    def _step(self, frame: int) -> WorldSample:
        time_s = frame * FRAME_S
        observation = self.sight.observe(frame, time_s, self.street, self.ego)
        brakes = self.brake.decide(time_s, observation.detections)
        self._update_justified(frame, brakes)
        self._record_events(time_s, observation, brakes)
        if self.recorder is not None:
            self.recorder.record_frame(time_s, observation, brakes=brakes)
        accel_mps2 = FULL_BRAKE_MPS2 if brakes else min(max(CRUISE_MPS - self.ego.speed_mps, -3.0), 2.5)
        for part in range(PHYSICS_STEPS):
            self.ego.drive(accel_mps2, 0.0, 1)
            self.street.advance(time_s + part * PHYSICS_STEP_S, PHYSICS_STEP_S)
            self.monitor.update()
            if self.monitor.collided:
                break
        sample = self.monitor.sample(time_s + FRAME_S, brakes_for_nothing=brakes and not self._justified)
        for name, requirement in self.requirements.items():
            robustness = requirement.observe(sample)
            if self.recorder is not None:
                self.recorder.record_robustness(name, robustness)
        self._record_stop(sample, brakes)
        return sample

    def _update_justified(self, frame: int, brakes: bool) -> None:
        """Track whether the current braking is justified."""
        if self.monitor.anyone_expected():
            self._expected_frame = frame
        if not brakes:
            self._braking = self._justified = False
            return
        recently = frame - self._expected_frame <= LOOK_BACK_FRAMES
        self._justified = recently or (self._braking and self._justified)
        self._braking = True

    def _record_events(self, time_s: float, observation: FrameObservation, brakes: bool) -> None:
        outcome = self.outcome
        if outcome.first_seen_s is None and any(box.label == PERSON for box in observation.detections):
            outcome.first_seen_s = time_s
        if brakes and outcome.braked_at_s is None:
            outcome.braked_at_s = time_s

    def _record_stop(self, sample: WorldSample, brakes: bool) -> None:
        if brakes and sample.speed_mps < 0.05 and self.outcome.stopped_at_s is None:
            self.outcome.stopped_at_s = sample.time_s
            ahead_m = [gap for gap in (sample.pedestrian_gap_m, sample.front_gap_m) if gap is not None]
            self.outcome.stopping_gap_m = min(ahead_m, default=None)
