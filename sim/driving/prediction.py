"""Prediction: where on the route each obstacle is, and where it will be at constant velocity for three seconds.

Velocity is held constant along and across the route, not in the plane: on a bend a vehicle that keeps its lane is
then predicted to keep it, and on a straight both are the same.
"""

import math
from collections.abc import Sequence
from typing import Protocol

from brink.sim.driving.interface import EgoState, ObstacleLabel, Route
from brink.sim.driving.settings import PredictionSettings
from brink.sim.driving.tracking import Track


class RoadObstacle:
    """A tracked obstacle in route coordinates. Made by the predictor, changed by nobody.

    Attributes:
        track: The track's number.
        label: What it is taken for.
        near_m: Station of its nearer end.
        far_m: Station of its farther end.
        right_m: Offset of its right end, < `left_m`.
        left_m: Offset of its left end.
        along_mps: Speed along the route, negative if it comes towards the ego.
        across_mps: Speed across the route, positive to the left.
        standing_s: How long it has been standing, 0 if it moves.
        horizon_s: How far ahead it can be predicted.
    """

    __slots__ = (
        "across_mps",
        "along_mps",
        "far_m",
        "horizon_s",
        "label",
        "left_m",
        "near_m",
        "right_m",
        "standing_s",
        "track",
    )

    def __init__(
        self,
        *,
        track: int,
        label: ObstacleLabel,
        near_m: float,
        far_m: float,
        right_m: float,
        left_m: float,
        along_mps: float = 0.0,
        across_mps: float = 0.0,
        standing_s: float = 0.0,
        horizon_s: float = 3.0,
    ) -> None:
        self.track = track
        self.label = label
        self.near_m = near_m
        self.far_m = far_m
        self.right_m = right_m
        self.left_m = left_m
        self.along_mps = along_mps
        self.across_mps = across_mps
        self.standing_s = standing_s
        self.horizon_s = horizon_s

    def overlaps(self, right_m: float, left_m: float) -> bool:
        """Return whether it now reaches into a strip of offsets."""
        return self.left_m > right_m and self.right_m < left_m

    def time_in(self, right_m: float, left_m: float) -> tuple[float, float] | None:
        """Return from when to when it is predicted in a strip of offsets; None if not within the horizon."""
        speed = self.across_mps
        if speed == 0.0:
            return (0.0, self.horizon_s) if self.overlaps(right_m, left_m) else None
        if speed > 0:
            enters, leaves = (right_m - self.left_m) / speed, (left_m - self.right_m) / speed
        else:
            enters, leaves = (left_m - self.right_m) / speed, (right_m - self.left_m) / speed
        if leaves <= 0 or enters >= self.horizon_s:
            return None
        return max(enters, 0.0), min(leaves, self.horizon_s)


class Predictor(Protocol):
    """Puts tracks on the route and predicts them."""

    def predict(self, time_s: float, ego: EgoState, tracks: Sequence[Track]) -> list[RoadObstacle]:
        """Return one obstacle a track, in the order of the tracks."""
        ...


class ConstantVelocityPredictor:
    """Constant velocity along and across the route."""

    __slots__ = ("_route", "_settings")

    def __init__(self, route: Route, settings: PredictionSettings) -> None:
        self._route = route
        self._settings = settings

    def predict(self, time_s: float, ego: EgoState, tracks: Sequence[Track]) -> list[RoadObstacle]:
        """Return one obstacle a track, in the order of the tracks."""
        route, horizon_s = self._route, self._settings.horizon_s
        obstacles = []
        for track in tracks:
            x_m, y_m = track.x_m, track.y_m
            hint_m = track.station_hint_m
            if hint_m is None:
                dx, dy = x_m - ego.x_m, y_m - ego.y_m
                hint_m = ego.station_m + math.sqrt(dx * dx + dy * dy)
            station_m, middle_m = route.project(x_m, y_m, hint_m)
            track.station_hint_m = station_m
            since_s = track.standing_since_s
            along = across = 0.0
            standing_s = 0.0 if since_s is None else time_s - since_s
            # A slow person matters; a vehicle that stands is not taken to drift.
            if since_s is None or track.label is ObstacleLabel.PERSON:
                yaw_rad = route.pose_at(station_m)[2]
                cos_yaw, sin_yaw = math.cos(yaw_rad), math.sin(yaw_rad)
                along = track.vx_mps * cos_yaw + track.vy_mps * sin_yaw
                across = track.vy_mps * cos_yaw - track.vx_mps * sin_yaw
            half_m, half_length_m = 0.5 * track.width_m, 0.5 * track.length_m
            obstacles.append(
                RoadObstacle(
                    track=track.number,
                    label=track.label,
                    near_m=station_m - half_length_m,
                    far_m=station_m + half_length_m,
                    right_m=middle_m - half_m,
                    left_m=middle_m + half_m,
                    along_mps=along,
                    across_mps=across,
                    standing_s=standing_s,
                    horizon_s=horizon_s,
                )
            )
        return obstacles
