"""Longitudinal laws: bounds on speed and acceleration from the road, gaps, traffic lights and giving way.

The gap law is the interaction term of the intelligent driver model (Treiber, Hennecke and Helbing 2000). It uses only
the gap, the ego's speed and the obstacle's speed, so any change in a box's distance or motion takes effect at once
and in proportion. It brakes comfortably from far away, which a wet road allows; a late appearance is an emergency.

At amber the ego continues if it could stop only by braking hard, at red only if it could not stop before the line at
all. The decision for a line holds until the light is green, so that it does not waver. The light detector may miss a
frame or report a wrong state: a light that is no longer reported is remembered for a while, and a change counts once
it has been reported for `confirm_s`.

The ego gives way to a person in or heading into its path, and to a vehicle about to cross it: to anyone predicted
to be in the strip that the ego's body will sweep, with a margin, at a time when the ego is there. So a box's label
decides between stopping and following, its lateral position and motion whether to stop, and its distance where to
stop; after it disappears, the ego continues once the track has been dropped and a short hold has passed.
"""

import math
from collections.abc import Sequence

from brink.sim.driving.interface import Crossing, LightReading, LightState, ObstacleLabel, Route
from brink.sim.driving.obstacles import RoadObstacle
from brink.sim.driving.settings import FollowSettings, LightSettings, SpeedSettings, YieldSettings

_BEYOND_M = 20.0


class SpeedProfile:
    """The highest comfortable speed at each station, limited by cruising speed, speed limit and curves."""

    __slots__ = ("_cells", "_grid_m", "_speeds_mps")

    def __init__(self, route: Route, settings: SpeedSettings) -> None:
        grid_m = settings.grid_m
        top_mps = max(min(settings.cruise_mps, route.speed_limit_mps - settings.limit_margin_mps), 0.5)
        count = max(int((route.length_m + _BEYOND_M) / grid_m), 1) + 1
        speeds = []
        for cell in range(count):
            curvature = abs(route.curvature_at(cell * grid_m))
            curve_mps = math.sqrt(settings.lateral_accel_mps2 / curvature) if curvature > 1e-6 else top_mps
            speeds.append(min(top_mps, max(curve_mps, settings.min_curve_mps)))
        gained = 2.0 * settings.curve_decel_mps2 * grid_m
        for cell in range(count - 2, -1, -1):
            speeds[cell] = min(speeds[cell], math.sqrt(speeds[cell + 1] ** 2 + gained))
        self._speeds_mps = speeds
        self._grid_m = grid_m
        self._cells = count

    def speed_at(self, station_m: float) -> float:
        """Return the speed in m/s at a station; constant beyond the ends of the table."""
        # One cell ahead, so that the speed is reached before the curve rather than in it.
        cell = int(station_m / self._grid_m) + 1 if station_m > 0.0 else 0
        return self._speeds_mps[cell if cell < self._cells else -1]


NO_LIMIT_MPS2 = 100.0
"""Result of a law that imposes no limit."""


def follow_accel(settings: FollowSettings, speed_mps: float, gap_m: float, other_mps: float) -> float:
    """Return the highest acceleration in m/s^2 that keeps the gap to an obstacle ahead.

    Args:
        settings: Gaps and accelerations.
        speed_mps: The ego's speed.
        gap_m: Distance from the front bumper to the obstacle; negative if it overlaps.
        other_mps: The obstacle's speed along the route, negative if it comes towards the ego.
    """
    hardest = -settings.max_decel_mps2
    if gap_m <= 0.1:
        return hardest
    accel, decel = settings.accel_mps2, settings.decel_mps2
    standstill_m = settings.standstill_gap_m
    if speed_mps < 0.3 and other_mps < 0.5 and gap_m < standstill_m + settings.hold_gap_m:
        return -1.0
    closing = speed_mps - other_mps
    dynamic_m = speed_mps * settings.time_gap_s + speed_mps * closing / (2.0 * math.sqrt(accel * decel))
    ratio = (standstill_m + (dynamic_m if dynamic_m > 0.0 else 0.0)) / gap_m
    wanted = accel * (1.0 - ratio * ratio)
    if closing > 0.0:
        room_m = max(gap_m - settings.reserve_gap_m, 0.2)
        if other_mps > 0.0:
            needed = closing * closing / (2.0 * room_m)
        else:
            # An oncoming obstacle uses up part of the room while the ego stops.
            needed = speed_mps * (speed_mps - 2.0 * other_mps) / (2.0 * room_m)
        if needed > settings.emergency_above_mps2:
            return max(hardest, -settings.emergency_factor * needed)
    # Outside emergencies, the model's reaction to a short gap is limited to what a wet road allows.
    return max(wanted, -settings.emergency_above_mps2)


def stop_accel(decel_mps2: float, gain_per_s: float, speed_mps: float, distance_m: float) -> float:
    """Return the highest acceleration in m/s^2 with which the ego can stop within a distance.

    Follows the speed profile sqrt(2 decel distance): below the profile it allows acceleration, on the profile it
    brakes with `decel_mps2`, above it harder.

    Args:
        decel_mps2: Comfortable braking, > 0.
        gain_per_s: Feedback gain on the deviation from the profile.
        speed_mps: The ego's speed.
        distance_m: Distance to the stopping point; negative past it.
    """
    if distance_m <= 0.0:
        return -max(decel_mps2, gain_per_s * speed_mps)
    allowed_mps = math.sqrt(2.0 * decel_mps2 * distance_m)
    return gain_per_s * (allowed_mps - speed_mps) - decel_mps2


class TrafficLightLaw:
    """Limits acceleration at traffic lights; remembers the last reading and a decision not to stop."""

    __slots__ = ("_goes_on_at_m", "_other_since_s", "_reading", "_seen_s", "_settings", "_stopping")

    def __init__(self, settings: LightSettings) -> None:
        self._settings = settings
        self._reading: LightReading | None = None
        self._seen_s = 0.0
        self._other_since_s: float | None = None
        self._goes_on_at_m: float | None = None
        self._stopping = False

    def accel(self, time_s: float, reading: LightReading | None, front_m: float, speed_mps: float) -> float:
        """Return the highest acceleration in m/s^2 that the traffic light allows.

        Args:
            time_s: Current time.
            reading: Output of the light detector.
            front_m: Station of the ego's front bumper.
            speed_mps: The ego's speed.
        """
        settings = self._settings
        believed = self._believed(time_s, reading)
        if believed is None:
            self._stopping = False
            return NO_LIMIT_MPS2
        state, line_m = believed
        to_line_m = line_m - front_m
        if state is LightState.GREEN:
            self._stopping = False
            self._goes_on_at_m = None
            return NO_LIMIT_MPS2
        if to_line_m < 0.0:
            self._stopping = False
            return NO_LIMIT_MPS2
        if self._goes_on_at_m == line_m and speed_mps > 1.0:
            return NO_LIMIT_MPS2
        if not self._stopping:
            needed = speed_mps * speed_mps / (2.0 * max(to_line_m, 0.01))
            is_amber = state is LightState.AMBER
            if needed > (settings.amber_go_above_mps2 if is_amber else settings.red_go_above_mps2):
                self._goes_on_at_m = line_m
                return NO_LIMIT_MPS2
            self._stopping = True
        return stop_accel(
            settings.decel_mps2, settings.approach_gain_per_s, speed_mps, to_line_m - settings.stop_margin_m
        )

    def _believed(self, time_s: float, reading: LightReading | None) -> LightReading | None:
        settings, before = self._settings, self._reading
        if reading is None:
            if before is not None and time_s - self._seen_s > settings.memory_s:
                self._reading = None
            return self._reading
        self._seen_s = time_s
        is_other = (
            before is not None
            and before.state is not reading.state
            and before.stop_line_station_m == reading.stop_line_station_m
        )
        if not is_other:
            self._other_since_s = None
            self._reading = reading
        elif self._other_since_s is None:
            self._other_since_s = time_s
        elif time_s - self._other_since_s >= settings.confirm_s:
            self._other_since_s = None
            self._reading = reading
        return self._reading


_LEAST_SPEED_MPS = 2.0


class GiveWay:
    """Decides at each perception step where to stop and whether to pass slowly; holds each decision briefly.

    Args:
        settings: Margins and times.
        crossings: Where pedestrians have priority.
        length_m: Length of the ego's body.
        width_m: Width of the ego's body.
    """

    __slots__ = ("_crossings", "_half_width_m", "_length_m", "_reasons", "_settings", "slow", "stops_m")

    def __init__(
        self, settings: YieldSettings, crossings: Sequence[Crossing], *, length_m: float, width_m: float
    ) -> None:
        self._settings = settings
        self._crossings = crossings
        self._length_m = length_m
        self._half_width_m = 0.5 * width_m
        self._reasons: dict[int, tuple[float, float]] = {}
        self.stops_m: list[float] = []
        """Stations at which the front bumper must stop."""
        self.slow = False
        """Whether a person is so close to the path that the ego passes slowly."""

    def update(
        self,
        time_s: float,
        obstacles: Sequence[RoadObstacle],
        *,
        front_m: float,
        speed_mps: float,
        right_m: float,
        left_m: float,
    ) -> None:
        """Process the obstacles of a perception step.

        Args:
            time_s: Current time.
            obstacles: All obstacles.
            front_m: Station of the ego's front bumper.
            speed_mps: The ego's speed.
            right_m: Lowest offset of the ego's centre on the way ahead.
            left_m: Highest offset of the ego's centre on the way ahead.
        """
        settings, reasons = self._settings, self._reasons
        strip_right, strip_left = right_m - self._half_width_m, left_m + self._half_width_m
        self.slow = False
        last_m = front_m + settings.range_m
        for obstacle in obstacles:
            if obstacle.near_m > last_m or obstacle.near_m < front_m - 0.5:
                continue
            stop_m = self._stop_m(obstacle, front_m, speed_mps, strip_right, strip_left)
            if self._crossings and obstacle.label is ObstacleLabel.PERSON:
                before_m = self._before_crossing_m(obstacle, front_m, speed_mps, strip_right, strip_left)
                if before_m is not None and (stop_m is None or before_m < stop_m):
                    stop_m = before_m
            if stop_m is not None:
                reasons[obstacle.track] = (time_s + settings.hold_s, stop_m)
        if reasons:
            for track in [number for number, reason in reasons.items() if reason[0] < time_s]:
                del reasons[track]
        self.stops_m = [stop_m for _, stop_m in reasons.values()]

    def _stop_m(
        self, obstacle: RoadObstacle, front_m: float, speed_mps: float, right_m: float, left_m: float
    ) -> float | None:
        settings = self._settings
        across = abs(obstacle.across_mps)
        if obstacle.label is ObstacleLabel.PERSON:
            margin = settings.person_margin_m
            crossing_above, gap_m = settings.crossing_above_mps, settings.person_gap_m
        else:
            margin = settings.vehicle_margin_m
            crossing_above = max(
                settings.vehicle_crossing_above_mps, settings.vehicle_crossing_slope * abs(obstacle.along_mps)
            )
            gap_m = settings.person_gap_m
            if across <= crossing_above or obstacle.overlaps(right_m, left_m):
                return None
        if obstacle.track in self._reasons:
            margin += settings.stay_margin_m
            crossing_above *= 0.5
        right_m, left_m = right_m - margin, left_m + margin
        is_inside = obstacle.overlaps(right_m, left_m)
        if not is_inside:
            if obstacle.label is ObstacleLabel.PERSON and self._stands_close(
                obstacle, front_m, right_m, left_m
            ):
                self.slow = True
            if across < crossing_above:
                return None
        window = obstacle.time_in(right_m, left_m)
        if window is None:
            return None
        enters_s, leaves_s = window
        speed = max(speed_mps, _LEAST_SPEED_MPS)
        # An obstacle that also comes towards the ego is met closer than its current position.
        towards_mps = min(obstacle.along_mps, 0.0)
        enters_m = obstacle.near_m + towards_mps * enters_s
        leaves_m = obstacle.near_m + towards_mps * leaves_s
        clears_s = (enters_m - front_m + self._length_m + 1.0) / speed
        is_past_before = clears_s + settings.time_margin_s < enters_s
        arrives_s = (leaves_m - front_m) / speed
        comes_after = leaves_s < obstacle.horizon_s and arrives_s > leaves_s + settings.time_margin_s
        if is_past_before or comes_after:
            return None
        return enters_m - gap_m

    def _before_crossing_m(
        self, person: RoadObstacle, front_m: float, speed_mps: float, right_m: float, left_m: float
    ) -> float | None:
        """Return where to stop for a person who has priority on a crossing, if the ego still can."""
        settings = self._settings
        for crossing in self._crossings:
            stop_m = crossing.from_m - settings.zebra_gap_m
            if person.far_m < crossing.from_m or person.near_m > crossing.to_m or front_m > stop_m + 0.5:
                continue
            behind_m = crossing.right_kerb_m - settings.zebra_kerb_m
            if not person.overlaps(behind_m, left_m + settings.zebra_left_m):
                continue
            moves_left = person.across_mps > settings.crossing_above_mps
            moves_right = person.across_mps < -settings.crossing_above_mps
            walks_away = (moves_left and person.right_m > left_m) or (moves_right and person.left_m < right_m)
            if walks_away or abs(person.along_mps) > settings.zebra_along_mps:
                continue
            if speed_mps * speed_mps < 2.0 * (settings.decel_mps2 + 1.0) * max(stop_m - front_m, 0.1):
                return stop_m
        return None

    def _stands_close(self, obstacle: RoadObstacle, front_m: float, right_m: float, left_m: float) -> bool:
        settings = self._settings
        if obstacle.near_m > front_m + 15.0:
            return False
        more = settings.pass_slowly_within_m - settings.person_margin_m
        return obstacle.overlaps(right_m - more, left_m + more)
