"""A coarse forward range sensor: the distance to the nearest obstacle in each of a few sectors, with noise.

It is a second, independent look at the world for a guard; the driving system under test does not have it. It sees the
footprints of vehicles, pedestrians, parked cars, trees and buildings up to 60 m from the front bumper, and nothing of
what the obstacle detector reports. Distances have noise that grows with distance, and sectors drop out, more often in
rain. Both are modelling choices, about those of a cheap automotive radar or ultrasonic array.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from brink.sim.driving.interface import CONTROL_STEP_S, PERCEPTION_STEP_S
from brink.sim.episode import EpisodeSpec
from brink.sim.guard.interface import RANGE_M, SECTOR_EDGES_DEG, KnownConditions, RangeScan
from brink.sim.urban.behaviour import last_perception_step
from brink.sim.world.scenario import UrbanScenario
from brink.sim.world.scenery import fixtures
from brink.sim.world.streams import Stream, generator
from brink.sim.world.weather import rain_wet_dark
from brink.sim.world.world import World

NOISE_M: Final = 0.15
NOISE_SHARE: Final = 0.015
"""The standard deviation of a distance is `NOISE_M` plus this share of the distance."""
DROP_SHARE: Final = 0.05
RAIN_DROP_SHARE: Final = 0.1
"""Share of dropped readings without rain, and what the hardest rain adds to it."""

FloatArray = NDArray[np.float64]


class RangeSensor:
    """The range sensor of one episode.

    Args:
        world: The world to measure.
        conditions: Rain makes sectors drop out.
        seed: The episode's seed.
        perception_steps: Number of perception steps.
    """

    def __init__(
        self, world: World, conditions: KnownConditions, *, seed: int, perception_steps: int
    ) -> None:
        self._world = world
        draws = generator(seed, Stream.RANGE_SENSOR)
        sectors = len(SECTOR_EDGES_DEG) - 1
        self._noise = draws.normal(size=(perception_steps, sectors))
        dropped = DROP_SHARE + RAIN_DROP_SHARE * max(conditions.rain, 0.0)
        self._dropped = draws.random(size=(perception_steps, sectors)) < dropped
        still = [(one.x_m, one.y_m, one.yaw_rad, one.length_m, one.width_m) for one in fixtures(world.road)]
        self._still = np.array(still, np.float64).reshape(-1, 5)

    def scan(self, number: int) -> RangeScan:
        """Return what the sensor measures now.

        Args:
            number: Number of the scan, from 0; see `scan_number`.
        """
        exact = self.true_distances()
        noisy = exact + (NOISE_M + NOISE_SHARE * np.minimum(exact, RANGE_M)) * self._noise[number]
        measured = np.where(exact <= RANGE_M, np.maximum(noisy, 0.0), np.inf)
        return RangeScan(distances_m=tuple(np.where(self._dropped[number], np.nan, measured).tolist()))

    def true_distances(self) -> FloatArray:
        """Return the exact distance to the nearest obstacle in each sector; infinite beyond the range."""
        ego = self._world.ego
        cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
        bumper_x, bumper_y = ego.x_m + 0.5 * ego.length_m * cos_yaw, ego.y_m + 0.5 * ego.length_m * sin_yaw
        movers = [
            (one.x_m, one.y_m, one.yaw_rad, one.length_m, one.width_m)
            for one in (*self._world.vehicles, *self._world.walkers)
        ]
        bodies = np.concatenate([np.array(movers, np.float64).reshape(-1, 5), self._still])
        dx, dy = bodies[:, 0] - bumper_x, bodies[:, 1] - bumper_y
        reach_m = RANGE_M + 0.5 * np.hypot(bodies[:, 3], bodies[:, 4])
        kept = dx * dx + dy * dy < reach_m * reach_m
        bodies, dx, dy = bodies[kept], dx[kept], dy[kept]
        ahead, left = dx * cos_yaw + dy * sin_yaw, dy * cos_yaw - dx * sin_yaw
        corners = _corners(ahead, left, bodies[:, 2] - ego.yaw_rad, bodies[:, 3], bodies[:, 4])
        distances = sector_distances(corners, np.roll(corners, -1, axis=1))
        return np.where(distances <= RANGE_M, distances, np.inf)


def _corners(
    ahead: FloatArray, left: FloatArray, turn: FloatArray, length: FloatArray, width: FloatArray
) -> FloatArray:
    """Return the corners of footprints around each of them, shape ``(n, 4, 2)``, as (ahead, left).

    It is `brink.sim.plane.Rectangle.corners` for arrays, whose cosines may differ in the last bit.
    """
    along = 0.5 * length * np.array([np.cos(turn), np.sin(turn)])
    across = 0.5 * width * np.array([-np.sin(turn), np.cos(turn)])
    centre = np.array([ahead, left])
    signs = ((1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0))
    return np.stack([(centre + a * along + b * across).T for a, b in signs], axis=1)


def sector_distances(starts: FloatArray, ends: FloatArray) -> FloatArray:
    """Return the distance from the origin to the nearest point of any segment in each sector, shape ``(sectors,)``.

    Args:
        starts: First points of the segments as (ahead, left), shape ``(…, 2)``.
        ends: Last points of the segments, of the same shape.

    Returns:
        Exact distances; infinite if no segment is in a sector.
    """
    first, along = starts.reshape(-1, 2), (ends - starts).reshape(-1, 2)
    edges = np.radians(SECTOR_EDGES_DEG)
    # A point p is in a sector if it is not left of its left edge and not right of its right edge. On the segment
    # first + t * along, with 0 <= t <= 1, each condition is a + b t >= 0.
    bounds_low = np.zeros((len(edges) - 1, len(first)))
    bounds_high = np.ones_like(bounds_low)
    for which, sign in ((slice(None, -1), 1.0), (slice(1, None), -1.0)):
        normals = sign * np.stack([np.sin(edges[which]), -np.cos(edges[which])])
        a, b = (first @ normals).T, (along @ normals).T
        with np.errstate(divide="ignore", invalid="ignore"):
            root = -a / b
        bounds_low = np.where(b > 0, np.maximum(bounds_low, root), bounds_low)
        bounds_high = np.where(b < 0, np.minimum(bounds_high, root), bounds_high)
        bounds_high = np.where((b == 0) & (a < 0), -1.0, bounds_high)
    squared = np.maximum((along * along).sum(axis=1), 1e-12)
    nearest = np.clip(-(first * along).sum(axis=1) / squared, bounds_low, np.maximum(bounds_high, bounds_low))
    points = first + nearest[..., None] * along
    distances = np.hypot(points[..., 0], points[..., 1])
    distances[bounds_high < bounds_low] = np.inf
    found: FloatArray = distances.min(axis=1, initial=np.inf)
    return found


def in_view(ahead_m: float, left_m: float, turn_rad: float, length_m: float, width_m: float) -> bool:
    """Return whether a footprint is within the range and the sectors of a range sensor, ignoring occlusion.

    Args:
        ahead_m: Its centre ahead of the sensor.
        left_m: Its centre to the left of the sensor.
        turn_rad: Its heading relative to the sensor's.
        length_m: Extent along its heading.
        width_m: Extent across its heading.
    """
    place = (np.array([value]) for value in (ahead_m, left_m, turn_rad, length_m, width_m))
    corners = _corners(*place)
    return bool(sector_distances(corners, np.roll(corners, -1, axis=1)).min() <= RANGE_M)


def scan_number(time_s: float) -> int:
    """Return the number of a scan that is made when boxes arrive, whatever the latency of the detector."""
    return int((time_s + 0.5 * CONTROL_STEP_S) / PERCEPTION_STEP_S)


def known_conditions(scenario: UrbanScenario) -> KnownConditions:
    """Return what a car knows about the conditions of a scenario."""
    return KnownConditions(*rain_wet_dark(scenario.time_of_day, scenario.weather))


def range_sensor(world: World, scenario: UrbanScenario, spec: EpisodeSpec) -> RangeSensor:
    """Return the range sensor of an episode."""
    return RangeSensor(
        world,
        known_conditions(scenario),
        seed=spec.seed,
        perception_steps=last_perception_step(spec.duration_s) + 1,
    )
