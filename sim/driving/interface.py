"""What the world tells the driving system, and what the driving system answers.

Frames: world x east, y north, yaw counter-clockwise from x, all on the ground plane. Route coordinates: station s
along the ego's lane centre line, offset d to its left. The camera looks along the ego's yaw; image x to the
right, y down, in pixels.

Values that are made at every step are named tuples: immutable as all values here, and made in less than half the
time of a frozen dataclass. Make them by keyword.
"""

from enum import StrEnum
from typing import NamedTuple, Protocol


class ObstacleLabel(StrEnum):
    """What the obstacle detector says it sees."""

    VEHICLE = "vehicle"
    PERSON = "person"


class LightState(StrEnum):
    """The state of a traffic light as the light detector reports it."""

    GREEN = "green"
    AMBER = "amber"
    RED = "red"


class EgoState(NamedTuple):
    """The ego's pose and motion, as localisation reports it (reference point: centre of the car)."""

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
    """What the light detector reports of the next traffic light on the route."""

    state: LightState
    stop_line_station_m: float


class Observation(NamedTuple):
    """All that the driving system learns in one control step (20 Hz).

    Attributes:
        time_s: Simulated time.
        ego: Where localisation says that the ego is.
        boxes: The detector's output, on perception steps (10 Hz); None on the steps between.
        light: The next traffic light, or None if none is seen.
    """

    time_s: float
    ego: EgoState
    boxes: tuple[Box, ...] | None
    light: LightReading | None


class Command(NamedTuple):
    """What the ego should do until the next control step."""

    accel_mps2: float
    steer_rad: float


class PlanMode(StrEnum):
    """What the planner is doing, for traces and replays."""

    CRUISE = "cruise"
    FOLLOW = "follow"
    STOP = "stop"
    YIELD = "yield"
    NUDGE = "nudge"
    OVERTAKE = "overtake"


class PlanState(NamedTuple):
    """What the planner decided, for traces and replays."""

    mode: PlanMode
    target_speed_mps: float
    target_offset_m: float


class PerceivedObstacle(NamedTuple):
    """A confirmed track: what the planner believes stands or moves around the ego, in world coordinates."""

    track: int
    label: ObstacleLabel
    x_m: float
    y_m: float
    vx_mps: float
    vy_mps: float
    length_m: float
    width_m: float


class Route(Protocol):
    """The ego's lane centre line from start to goal, with what the map knows of it."""

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
        """Stations of the stop lines that a traffic light guards, ascending."""
        ...

    def pose_at(self, station_m: float, offset_m: float = 0.0) -> tuple[float, float, float]:
        """Return (x, y, yaw) at a station and offset; beyond the ends the route goes on straight."""
        ...

    def curvature_at(self, station_m: float) -> float:
        """Return the signed curvature in 1/m, positive to the left."""
        ...

    def project(self, x_m: float, y_m: float, near_station_m: float) -> tuple[float, float]:
        """Return (station, offset) of the closest point of the route near a known station."""
        ...

    def oncoming_lane_at(self, station_m: float) -> bool:
        """Return whether a lane for oncoming traffic lies directly to the left here (for overtaking)."""
        ...


class DrivingSystem(Protocol):
    """The modular driving system under test. Made anew for every episode."""

    def step(self, observation: Observation) -> Command:
        """Take one control step."""
        ...

    @property
    def plan(self) -> PlanState:
        """What the planner decided in the last step."""
        ...

    @property
    def obstacles(self) -> tuple[PerceivedObstacle, ...]:
        """What the planner believed to be around the ego in the last step."""
        ...
