"""Owns the loop of an emergency-braking episode: look, decide, drive, touch, judge, record."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from brink.sim.aeb.braking import PERSON, EmergencyBrake
from brink.sim.aeb.facts import Facts
from brink.sim.aeb.recorder import AebRecorder
from brink.sim.aeb.sight import Look, Sight
from brink.sim.aeb.street import CRUISE_MPS, Street
from brink.sim.requirements import Collision, Requirement, WorldSample
from brink.sim.world.ego import STEP_S as PHYSICS_STEP_S
from brink.sim.world.ego import EgoCar

FRAME_S: Final = 0.05
PHYSICS_STEPS: Final = round(FRAME_S / PHYSICS_STEP_S)
FULL_BRAKE_MPS2: Final = -12.0
LOOK_BACK_FRAMES: Final = 10
"""Somebody who was expected in the region so lately is a reason to brake."""
PAST_LINE_M: Final = 15.0
"""The episode is over when the ego is past the pedestrian's line by so much."""


@dataclass(slots=True, kw_only=True)
class Outcome:
    """How an episode went, besides what its requirements know.

    Attributes:
        ended: ``collision``, ``past`` or ``time``.
        frames: Frames that were looked at.
        time_s: When it ended.
        collision: What the ego hit.
        first_seen_s: When a person was first detected in the picture.
        braked_at_s: When the brake first came on.
        stopped_at_s: When the ego first stood.
        stopping_gap_m: Clearance then, to the nearest person or to what stands in the lane ahead.
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
    """One episode. Its parts change in place; made anew for each.

    Attributes:
        street: Where it is.
        ego: The car under test.
        facts: What measures it.
        sight: What gives the frames.
        brake: What decides.
        requirements: By id; they observe every frame.
        line_m: Way of the ego's bumper to the pedestrian's line.
        recorder: Takes the trace, if there is one.
    """

    street: Street
    ego: EgoCar
    facts: Facts
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
        """Run to the ego's first collision, past the pedestrian's line, or to the end of the time."""
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
            self.recorder.end(self.outcome.time_s)
        return self.outcome

    def _step(self, frame: int) -> WorldSample:
        time_s = frame * FRAME_S
        look = self.sight.look(frame, time_s, self.street, self.ego)
        brakes = self.brake.decide(time_s, look.detections)
        self._judge_reason(frame, brakes)
        self._note(time_s, look, brakes)
        if self.recorder is not None:
            self.recorder.sample(time_s, look, brakes=brakes)
        accel_mps2 = FULL_BRAKE_MPS2 if brakes else min(max(CRUISE_MPS - self.ego.speed_mps, -3.0), 2.5)
        for part in range(PHYSICS_STEPS):
            self.ego.drive(accel_mps2, 0.0, 1)
            self.street.advance(time_s + part * PHYSICS_STEP_S, PHYSICS_STEP_S)
            self.facts.touch()
            if self.facts.collided:
                break
        sample = self.facts.sample(time_s + FRAME_S, brakes_for_nothing=brakes and not self._justified)
        for name, requirement in self.requirements.items():
            robustness = requirement.observe(sample)
            if self.recorder is not None:
                self.recorder.judge(name, robustness)
        self._note_stop(sample, brakes)
        return sample

    def _judge_reason(self, frame: int, brakes: bool) -> None:
        """Keep in mind whether the braking that is on has a reason."""
        if self.facts.expected():
            self._expected_frame = frame
        if not brakes:
            self._braking = self._justified = False
            return
        recently = frame - self._expected_frame <= LOOK_BACK_FRAMES
        self._justified = recently or (self._braking and self._justified)
        self._braking = True

    def _note(self, time_s: float, look: Look, brakes: bool) -> None:
        outcome = self.outcome
        if outcome.first_seen_s is None and any(box.label == PERSON for box in look.detections):
            outcome.first_seen_s = time_s
        if brakes and outcome.braked_at_s is None:
            outcome.braked_at_s = time_s

    def _note_stop(self, sample: WorldSample, brakes: bool) -> None:
        if brakes and sample.speed_mps < 0.05 and self.outcome.stopped_at_s is None:
            self.outcome.stopped_at_s = sample.time_s
            ahead_m = [gap for gap in (sample.pedestrian_gap_m, sample.front_gap_m) if gap is not None]
            self.outcome.stopping_gap_m = min(ahead_m, default=None)
