"""Features of a coarse forward range sensor, independent of the obstacle detector.

The sensor has five sectors, from left to right, and measures the distance from the front bumper to the nearest
obstacle in each, of any kind. Drop-outs are bridged for half a second. The path of the ego is traced over the
sectors, so that on a bend the distance in the path is not that of a car parked straight ahead.
"""

import math
from collections import deque
from collections.abc import Sequence
from typing import Final

from brink.sim.driving.interface import PERCEPTION_STEP_S, EgoState, Route
from brink.sim.driving.settings import DrivingSettings
from brink.sim.guard.interface import RANGE_M, SECTOR_EDGES_DEG, SECTORS, RangeScan

BRIDGED_STEPS: Final = 5
"""Consecutive drop-outs for which the last measured distance is kept; after more, nothing counts as in range."""
SECOND_STEPS: Final = 10
WINDOW_STEPS: Final = 30
TRACED_M: Final = tuple(range(3, 61, 3))
"""Distances ahead at which the path is traced."""
AROUND_M: Final = 3.0
"""A distance in the sector of a traced point is in the path if it differs from the point's by at most this."""
MAX_TTC_S: Final = 10.0
MIN_CLOSING_MPS: Final = 0.3
JUMP_M: Final = 3.0
STANDSTILL_M: Final = 1.5
"""Distance to keep, in the braking that is needed."""

_HALF_LENGTH_M: Final = 0.5 * DrivingSettings().shape.length_m

RANGE_FEATURES: Final[tuple[str, ...]] = (
    *(f"range_{sector}_m" for sector in range(SECTORS)),
    *(f"range_{sector}_closing_mps" for sector in range(SECTORS)),
    "range_measured_1s",
    "range_path_m",
    "range_path_closing_mps",
    "range_path_ttc_s",
    "range_path_needed_decel_mps2",
    "range_path_headway_s",
    "range_path_least_1s_m",
    "range_path_least_3s_m",
    "range_path_change_1s_m",
    "range_path_speed_mps",
    "range_least_m",
    "range_unreported_m",
)
"""Names of the features, in order."""


class RangeFeatures:
    """Extracts the features of the range sensor of one drive.

    Args:
        route: The route of the drive.
    """

    def __init__(self, route: Route) -> None:
        self._route = route
        self._held = [RANGE_M] * SECTORS
        self._missing = [BRIDGED_STEPS + 1] * SECTORS
        self._sectors: deque[list[float]] = deque(maxlen=SECOND_STEPS + 1)
        self._measured: deque[float] = deque(maxlen=SECOND_STEPS + 1)
        self._path: deque[float] = deque(maxlen=WINDOW_STEPS + 1)

    def step(self, ego: EgoState, scan: RangeScan | None, *, reported_m: float) -> list[float]:
        """Process one perception step and return its features, in the order of `RANGE_FEATURES`.

        Args:
            ego: State of the ego.
            scan: The scan; None if nothing was measured.
            reported_m: Distance of the nearest reported box in the path.

        Raises:
            ValueError: The scan has another number of sectors.
        """
        self._hold((math.nan,) * SECTORS if scan is None else scan.distances_m)
        path_m = self._in_path(ego)
        self._path.append(path_m)
        second = list(self._path)[-SECOND_STEPS - 1 :]
        closing = closing_mps(second)
        speed = max(ego.speed_mps, 0.0)
        room_m = max(path_m - STANDSTILL_M, 0.2)
        near = path_m < RANGE_M
        return [
            *self._held,
            *(closing_mps([one[sector] for one in self._sectors]) for sector in range(SECTORS)),
            sum(self._measured) / len(self._measured),
            path_m,
            closing,
            min(path_m / closing, MAX_TTC_S) if near and closing > MIN_CLOSING_MPS else MAX_TTC_S,
            min(max(closing, 0.0) ** 2 / (2.0 * room_m), 20.0) if near else 0.0,
            min(path_m / max(speed, 0.1), MAX_TTC_S),
            min(second),
            min(self._path),
            path_m - second[0],
            speed - closing if near else 0.0,
            min(self._held),
            min(max(reported_m, 0.0), RANGE_M) - path_m,
        ]

    def _hold(self, distances_m: Sequence[float]) -> None:
        if len(distances_m) != SECTORS:
            raise ValueError(f"expected the distances of {SECTORS} sectors, got {len(distances_m)}")
        for sector, distance_m in enumerate(distances_m):
            if not math.isnan(distance_m):
                self._held[sector] = min(max(distance_m, 0.0), RANGE_M)
                self._missing[sector] = 0
            else:
                self._missing[sector] += 1
                if self._missing[sector] > BRIDGED_STEPS:
                    self._held[sector] = RANGE_M
        self._sectors.append(list(self._held))
        self._measured.append(sum(not math.isnan(one) for one in distances_m) / SECTORS)

    def _in_path(self, ego: EgoState) -> float:
        """Return the smallest distance of a sector at which the path runs through that sector."""
        held, route = self._held, self._route
        if min(held) >= RANGE_M:
            return RANGE_M
        cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
        bumper_x = ego.x_m + _HALF_LENGTH_M * cos_yaw
        bumper_y = ego.y_m + _HALF_LENGTH_M * sin_yaw
        nearest_m = RANGE_M
        for ahead_m in TRACED_M:
            if ahead_m - AROUND_M >= nearest_m:
                break
            x_m, y_m, _ = route.pose_at(ego.station_m + _HALF_LENGTH_M + ahead_m, ego.offset_m)
            dx, dy = x_m - bumper_x, y_m - bumper_y
            sector = sector_of(
                math.degrees(math.atan2(dy * cos_yaw - dx * sin_yaw, dx * cos_yaw + dy * sin_yaw))
            )
            if sector is not None and abs(held[sector] - ahead_m) <= AROUND_M:
                nearest_m = min(nearest_m, held[sector])
        return nearest_m


def sector_of(angle_deg: float) -> int | None:
    """Return the sector of a direction; None if it is in no sector."""
    for sector in range(SECTORS):
        if SECTOR_EDGES_DEG[sector] >= angle_deg > SECTOR_EDGES_DEG[sector + 1]:
            return sector
    return None


def closing_mps(distances_m: Sequence[float]) -> float:
    """Return the rate at which distances shrink: the slope of a least-squares line, bounded to 30 m/s.

    Only the last distances count that are in range and differ by at most `JUMP_M` from step to step: a jump is
    another obstacle. It is 0 for fewer than three of them.

    Args:
        distances_m: Distances of successive perception steps.
    """
    kept: list[float] = []
    for distance_m in reversed(distances_m):
        if distance_m >= RANGE_M or (kept and abs(distance_m - kept[-1]) > JUMP_M):
            break
        kept.append(distance_m)
    count = len(kept)
    if count < 3:
        return 0.0
    # `kept` runs backwards in time, so its slope is the rate of closing.
    middle, mean = 0.5 * (count - 1), sum(kept) / count
    spread = count * (count * count - 1) / 12.0
    slope = sum((place - middle) * (one - mean) for place, one in enumerate(kept)) / spread
    return min(max(slope / PERCEPTION_STEP_S, -30.0), 30.0)
