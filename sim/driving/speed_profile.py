"""The fastest comfortable speed along the route: cruising speed, speed limit, and curves with braking before them."""

import math

from brink.sim.driving.interface import Route
from brink.sim.driving.settings import SpeedSettings

_BEYOND_M = 20.0


class SpeedProfile:
    """A table over stations, made once an episode."""

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
        """Return the speed in m/s; beyond the table's ends that of its ends."""
        # One cell ahead, so that the speed is reached before the curve and not in it.
        cell = int(station_m / self._grid_m) + 1 if station_m > 0.0 else 0
        return self._speeds_mps[cell if cell < self._cells else -1]
