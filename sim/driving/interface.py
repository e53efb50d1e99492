"""The interface between the world and the driving system.

Frames: world x east, y north, yaw counter-clockwise from x, all on the ground plane. Route coordinates: station s
along the ego's lane centre line, offset d to its left. The camera looks along the ego's yaw; image x points right, y
down, in pixels.

`brink.sim.driving_systems` is the interface for driving systems of users. What they share with this module is part of
it, and stays: it may gain attributes, so read and create all values by name.

Most values created at every step are named tuples: immutable like all values here, and created in less than half the
time of a frozen dataclass.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final, NamedTuple, Protocol

CONTROL_STEP_S: Final = 0.05
"""A driving system runs this often."""
PERCEPTION_STEP_S: Final = 0.1
"""Its detectors report this often."""
LATENCY_S: Final = 0.1
"""From an image to the arrival of what was detected in it: exposure, transfer, detector."""


class ObstacleLabel(StrEnum):
    """Label of a detection."""

    VEHICLE = "vehicle"
    PERSON = "person"


class LightState(StrEnum):
    """State of a traffic light as reported by the traffic-light detector."""

    GREEN = "green"
    AMBER = "amber"
    RED = "red"


class EgoState(NamedTuple):
    """The ego's pose and motion as reported by localisation; the reference point is the centre of the car."""

    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    accel_mps2: float
    station_m: float
    offset_m: float


class Box(NamedTuple):
    """One detection in the 800 x 600 image."""

    label: ObstacleLabel
    x_min_px: float
    x_max_px: float
    y_min_px: float
    y_max_px: float


class LightReading(NamedTuple):
    """The traffic-light detector's report on the next light on the route."""

    state: LightState
    stop_line_station_m: float


class SeenObject(NamedTuple):
    """A road user in the ego's frame: origin at the centre of its body, x ahead, y left.

    Attributes:
        id: The same number in every step, as long as it is followed.
        label: Vehicle or person.
        existence: How sure it is that it exists, in [0, 1].
        x_m: Centre of its body, ahead of the ego's centre.
        y_m: Centre of its body, left of the ego's centre.
        yaw_rad: Its heading relative to the ego's, counter-clockwise.
        vx_mps: Velocity over ground (not relative to the ego), along the ego's x axis.
        vy_mps: Velocity over ground, along the ego's y axis.
        length_m: Extent along its heading.
        width_m: Extent across its heading.
    """

    id: int
    label: ObstacleLabel
    existence: float
    x_m: float
    y_m: float
    yaw_rad: float
    vx_mps: float
    vy_mps: float
    length_m: float
    width_m: float


# Not frozen: creating a frozen one takes three times as long.
@dataclass(slots=True, kw_only=True)
class Observation:
    """Everything that the driving system receives in one control step (20 Hz). Do not change it: guards see it too.

    Attributes:
        time_s: Simulated time.
        ego: Localised state of the ego.
        boxes: The detector's output when a new one arrives (10 Hz); None at the steps between, and for systems that
            get objects.
        light: The next traffic light, or None if none is detected.
        seen_s: Time of the image that `boxes`, `objects` and `light` come from, if it is older than `time_s`.
        objects: The road users around when a new report arrives, moved on to `time_s`, for systems that get objects;
            None at the steps between, and for systems that get boxes.
    """

    time_s: float
    ego: EgoState
    boxes: tuple[Box, ...] | None
    light: LightReading | None
    seen_s: float | None = None
    objects: tuple[SeenObject, ...] | None = None


class Command(NamedTuple):
    """Command for the ego until the next control step.

    Attributes:
        accel_mps2: Desired acceleration; negative brakes.
        steer_rad: Desired angle of the road wheels.
        emergency: Whether this is emergency braking, for which there should be a reason on the road.
    """

    accel_mps2: float
    steer_rad: float
    emergency: bool = False


class PlanMode(StrEnum):
    """The planner's current activity. Guards know these six; other words are for traces and replays alone."""

    CRUISE = "cruise"
    FOLLOW = "follow"
    STOP = "stop"
    YIELD = "yield"
    NUDGE = "nudge"
    OVERTAKE = "overtake"


class PlanState(NamedTuple):
    """The planner's decision, for guards, traces and replays.

    Attributes:
        mode: A `PlanMode`, or other words; empty if unknown.
        target_speed_mps: Speed that it wants to reach.
        target_offset_m: Offset from the middle of the lane that it wants to reach.
    """

    mode: str
    target_speed_mps: float
    target_offset_m: float


class PerceivedObstacle(NamedTuple):
    """A confirmed track: an obstacle near the ego that the planner treats as real, in world coordinates."""

    track: int
    label: ObstacleLabel
    x_m: float
    y_m: float
    vx_mps: float
    vy_mps: float
    length_m: float
    width_m: float


class Crossing(NamedTuple):
    """A pedestrian crossing on the route, where pedestrians have priority.

    Attributes:
        from_m: Station at which it begins.
        to_m: Station at which it ends.
        right_kerb_m: Offset of the kerb on the right.
        left_kerb_m: Offset of the kerb on the left.
    """

    from_m: float
    to_m: float
    right_kerb_m: float
    left_kerb_m: float


class Route(Protocol):
    """The ego's lane centre line from start to goal, with map data."""

    @property
    def start_pose(self) -> tuple[float, float, float]:
        """x_m, y_m and yaw_rad at station 0."""

    @property
    def pieces(self) -> tuple[tuple[float, float], ...]:
        """The straights and arcs of the line, from station 0: length in m, curvature in 1/m, positive to the left."""

    @property
    def length_m(self) -> float:
        """Length from the first to the last station."""

    @property
    def lane_width_m(self) -> float:
        """Width of the ego's lane."""

    @property
    def speed_limit_mps(self) -> float:
        """Speed limit on the route."""

    @property
    def stop_line_stations_m(self) -> tuple[float, ...]:
        """Stations of the stop lines with a traffic light, ascending."""

    @property
    def crossings(self) -> tuple[Crossing, ...]:
        """The crossings at which pedestrians have priority, in driving order."""

    def pose_at(self, station_m: float, offset_m: float = 0.0) -> tuple[float, float, float]:
        """Return (x, y, yaw) at a station and offset; the route continues straight beyond its ends."""

    def curvature_at(self, station_m: float) -> float:
        """Return the signed curvature in 1/m, positive to the left."""

    def project(self, x_m: float, y_m: float, near_station_m: float) -> tuple[float, float]:
        """Return (station, offset) of the closest point on the route near a known station.

        Args:
            x_m: Point to project.
            y_m: Point to project.
            near_station_m: Station at which the search starts.
        """

    @property
    def oncoming(self) -> tuple[tuple[float, float], ...]:
        """The stretches, from and to a station, with an oncoming lane directly to the left."""

    def oncoming_lane_at(self, station_m: float) -> bool:
        """Return whether an oncoming lane lies directly to the left of a station."""


class Driving(Protocol):
    """Whoever drives the ego, as simulators see it. Create a new one for each episode.

    Driving systems of users are simpler (`brink.sim.driving_systems.DrivingSystem`); `SystemUnderTest` adapts them.
    """

    def step(self, observation: Observation) -> Command:
        """Run one control step and return its command."""

    @property
    def plan(self) -> PlanState:
        """The planner's decision in the last step."""

    @property
    def obstacles(self) -> tuple[PerceivedObstacle, ...]:
        """The obstacles near the ego that the planner treated as real in the last step."""
