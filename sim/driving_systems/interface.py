"""What a driving system of users gets and answers.

A factory gets a `Start` and returns a new system for one drive. In each control step the system gets an `Observation`
and returns a `Decision`.

Frames: world x east, y north, yaw counter-clockwise from x, on the ground plane. Route coordinates: station along the
middle of the ego's lane, offset to its left. The ego's frame: origin at the centre of its body, x ahead, y left. All
angles are in radians, all times in seconds of the simulation, which begins at 0.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final, Literal, NamedTuple, Protocol, TypeAlias

from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import Observation, PerceivedObstacle, Route, SeenObject
from brink.sim.episode import Json

INTERFACE: Final = 1
"""Version of this interface."""

Needs: TypeAlias = Literal["boxes", "objects"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CarLimits:
    """The ego's body and what it can do. It cannot do more, whatever a decision demands.

    Attributes:
        length_m: Length of the body.
        width_m: Width of the body.
        wheelbase_m: Distance between the axles; the centre of the body is halfway between them.
        steer_limit_rad: Largest angle of the road wheels to either side.
        steer_rate_radps: Largest rate of that angle.
        engine_mps2: Largest acceleration, at low speed.
        brake_mps2: Largest deceleration on perfect grip; a dry road allows about 9 m/s², a wet one 6.
        delay_s: Time from a command to its first effect.
    """

    length_m: float
    width_m: float
    wheelbase_m: float
    steer_limit_rad: float
    steer_rate_radps: float
    engine_mps2: float
    brake_mps2: float
    delay_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """What a driving system knows before a drive begins.

    Attributes:
        route: The lane to follow, with its limits, stop lines, crossings and the oncoming lane.
        car: The ego's body and limits.
        camera: The camera that boxes come from.
        control_s: Time between control steps.
        perception_s: Time between reports of boxes or objects.
        settings: What the campaign says under `driving_settings`.
        seed: Seed for systems that draw random numbers, in [0, 2**53); draw them from nothing else.
        interface: Version of this interface.
    """

    route: Route
    car: CarLimits
    camera: Camera
    control_s: float
    perception_s: float
    settings: Mapping[str, Json]
    seed: int
    interface: int = INTERFACE


class TrajectoryPoint(NamedTuple):
    """Where the centre of the ego's body should be at a time.

    Attributes:
        time_s: Simulated time.
        x_m: In the world.
        y_m: In the world.
        yaw_rad: Heading of the body.
        speed_mps: Speed along the heading, >= 0.
        accel_mps2: Acceleration along the heading.
    """

    time_s: float
    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    accel_mps2: float


# Not frozen: creating a frozen one takes three times as long.
@dataclass(slots=True, kw_only=True)
class Decision:
    """What the ego does until the next control step: a command, pedals, or a trajectory.

    Acceleration (or pedal) and steering (or wheel) may each be left out. Brink's own driving system, which follows
    every drive from its beginning, then decides in its place. So an emergency brake or a cruise control is a driving
    system, too. All numbers are finite floats or ints of Python itself, not of NumPy.

    Attributes:
        accel_mps2: Desired acceleration; negative brakes.
        steer_rad: Desired angle of the road wheels, positive to the left.
        pedal: In place of `accel_mps2`, in [-1, 1]: the share of the engine's limit, or of the brakes' if negative.
        wheel: In place of `steer_rad`, in [-1, 1]: the share of the steering limit, positive to the left.
        trajectory: In place of all these, two to `MAX_POINTS` points in order of time, which Brink tracks. It must
            reach from now, or earlier, to the next control step, or later; return it again until there is a new one.
        emergency: Whether this is emergency braking, for which there should be a reason on the road.
        mode: What the system is doing, in up to `MAX_MODE_CHARS` characters, for traces and replays. Guards
            understand those of `brink.sim.driving.interface.PlanMode`.
        target_speed_mps: Speed that it wants to reach, for traces and guards.
        target_offset_m: Offset from the middle of the lane that it wants to reach, for traces and guards.
        objects: The objects that it believes in, for traces; None if as before, or if it does not say. `SeenObject`
            in the ego's frame, or `PerceivedObstacle` in the world.
    """

    accel_mps2: float | None = None
    steer_rad: float | None = None
    pedal: float | None = None
    wheel: float | None = None
    trajectory: Sequence[TrajectoryPoint] | None = None
    emergency: bool = False
    mode: str = ""
    target_speed_mps: float | None = None
    target_offset_m: float | None = None
    objects: Sequence[SeenObject | PerceivedObstacle] | None = None


MAX_POINTS: Final = 1_000
MAX_MODE_CHARS: Final = 40
MAX_OBJECTS: Final = 1_000


class DrivingSystem(Protocol):
    """A driving system in one drive.

    The same drive must lead to the same decisions: keep nothing from one drive to the next, and read no clock.

    It may have a property ``believed_objects`` in place of `Decision.objects`, with the same content. It is read in
    recorded drives alone, after each step, so it must change nothing.

    Attributes:
        needs: Whether it gets image boxes, or objects that Brink's localiser and tracker make of them.
    """

    needs: ClassVar[Needs]

    def step(self, observation: Observation) -> Decision:
        """Decide what the ego does until the next control step."""


class MakeDrivingSystem(Protocol):
    """What is registered: a class of driving systems, or a function that returns one."""

    def __call__(self, start: Start, /) -> DrivingSystem:
        """Return a new driving system for one drive."""
