"""The interface between the world and the driving system.

Frames: world x east, y north, yaw counter-clockwise from x, all on the ground plane. Route coordinates: station s
along the ego's lane centre line, offset d to its left. The camera looks along the ego's yaw; image x points right, y
down, in pixels.

Values created at every step are named tuples: immutable like all values here, and created in less than half the time
of a frozen dataclass. Create them with keywords.
"""

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


class Observation(NamedTuple):
    """Everything that the driving system receives in one control step (20 Hz).

    Attributes:
        time_s: Simulated time.
        ego: Localised state of the ego.
        boxes: The detector's output when a new one arrives (10 Hz); None at the steps between.
        light: The next traffic light, or None if none is detected.
        seen_s: Time of the image that `boxes` and `light` were detected in, if it is older than `time_s`.
    """

    time_s: float
    ego: EgoState
    boxes: tuple[Box, ...] | None
    light: LightReading | None
    seen_s: float | None = None


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
    """The planner's current activity, for traces and replays."""

    CRUISE = "cruise"
    FOLLOW = "follow"
    STOP = "stop"
    YIELD = "yield"
    NUDGE = "nudge"
    OVERTAKE = "overtake"


class PlanState(NamedTuple):
    """The planner's decision, for traces and replays."""

    mode: PlanMode
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
    def length_m(self) -> float:
        """Length from the first to the last station."""
        ...

    @property
    def lane_width_m(self) -> float:
        """Width of the ego's lane."""
        ...

    @property
    def speed_limit_mps(self) -> float:
        """Speed limit on the route."""
        ...

    @property
    def stop_line_stations_m(self) -> tuple[float, ...]:
        """Stations of the stop lines with a traffic light, ascending."""
        ...

    @property
    def crossings(self) -> tuple[Crossing, ...]:
        """The crossings at which pedestrians have priority, in driving order."""
        ...

    def pose_at(self, station_m: float, offset_m: float = 0.0) -> tuple[float, float, float]:
        """Return (x, y, yaw) at a station and offset; the route continues straight beyond its ends."""
        ...

    def curvature_at(self, station_m: float) -> float:
        """Return the signed curvature in 1/m, positive to the left."""
        ...

    def project(self, x_m: float, y_m: float, near_station_m: float) -> tuple[float, float]:
        """Return (station, offset) of the closest point on the route near a known station.

        Args:
            x_m: Point to project.
            y_m: Point to project.
            near_station_m: Station at which the search starts.
        """
        ...

    def oncoming_lane_at(self, station_m: float) -> bool:
        """Return whether an oncoming lane lies directly to the left of a station."""
        ...


class DrivingSystem(Protocol):
    """The driving system under test. Create a new one for each episode."""

    def step(self, observation: Observation) -> Command:
        """Run one control step and return its command."""
        ...

    @property
    def plan(self) -> PlanState:
        """The planner's decision in the last step."""
        ...

    @property
    def obstacles(self) -> tuple[PerceivedObstacle, ...]:
        """The obstacles near the ego that the planner treated as real in the last step."""
        ...
