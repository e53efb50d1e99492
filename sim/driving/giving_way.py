"""Giving way: stopping for a perceived person in or heading into the path, and for a vehicle about to cross it.

Somebody matters if the prediction brings them into the strip that the ego's body will sweep, with a margin, at a
time when the ego is there. So it is the label that makes a box something to stop for rather than to follow; its
lateral place and lateral motion that decide whether; its distance that decides where; and its disappearance, after
the track has died and a short hold, that lets the ego go on.
"""

from collections.abc import Sequence

from brink.sim.driving.interface import ObstacleLabel
from brink.sim.driving.prediction import RoadObstacle
from brink.sim.driving.settings import YieldSettings

_LEAST_SPEED_MPS = 2.0


class GiveWay:
    """Decides at perception steps where to stop and how fast to pass; holds its reasons for a moment."""

    __slots__ = ("_half_width_m", "_length_m", "_reasons", "_settings", "slow", "stops_m")

    def __init__(self, settings: YieldSettings, *, length_m: float, width_m: float) -> None:
        self._settings = settings
        self._length_m = length_m
        self._half_width_m = 0.5 * width_m
        self._reasons: dict[int, tuple[float, float]] = {}
        self.stops_m: list[float] = []
        """Stations at which the front bumper should stand at the latest."""
        self.slow = False
        """Whether somebody stands so close to the path that they are passed slowly."""

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
        """Take the obstacles of a perception step.

        Args:
            time_s: Now.
            obstacles: Everybody.
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
        # Who also comes towards the ego is met nearer than they are now.
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

    def _stands_close(self, obstacle: RoadObstacle, front_m: float, right_m: float, left_m: float) -> bool:
        settings = self._settings
        if obstacle.near_m > front_m + 15.0:
            return False
        more = settings.pass_slowly_within_m - settings.person_margin_m
        return obstacle.overlaps(right_m - more, left_m + more)
