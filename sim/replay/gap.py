"""Which vehicle ahead the front gap is to, found again from the trace, so that the map can draw it."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from brink.sim.replay.captions import plain_name
from brink.sim.replay.geometry import Points, closest_points, outline
from brink.sim.requirements import REQUIRED_GAP_M
from brink.sim.trace import ActorTrack, Trace

FRONT_GAP: Final = "front-gap"
NO_COLLISION: Final = "no-collision"
DRAWN_UP_TO_M: Final = 40.0
CORRIDOR_M: Final = 2.5
"""Without a recorded front gap: how far off the ego's axis a vehicle may be to count as ahead."""
APART_M: Final = 1.0
"""Two that have hit each other are seen less than this apart: they bounce off between two samples."""
TOLERANCE_M: Final = 0.75
"""How far a clearance between outlines may differ from the recorded gap: float32 poses, sampling, slopes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrontGap:
    """The line from the ego to the vehicle ahead.

    Attributes:
        actor: Index of the vehicle among the trace's actors.
        ends: Point of the ego and point of the vehicle, shape ``(2, 2)``.
        gap_m: Length, as the requirement measured it where it was recorded.
    """

    actor: int
    ends: Points
    gap_m: float


def front_gap(trace: Trace, sample: int) -> FrontGap | None:
    """Return the gap to the vehicle ahead at a sample; None if there is none within 40 m, or that is what was hit."""
    series = {plain_name(name): series for name, series in trace.robustness.items()}
    recorded = series.get(FRONT_GAP)
    gap_m = None if recorded is None else float(recorded[sample]) + REQUIRED_GAP_M
    if gap_m is not None and gap_m > DRAWN_UP_TO_M:
        return None
    x_m, y_m, yaw_rad = (float(value) for value in trace.ego[sample, :3])
    ego = outline(x_m, y_m, yaw_rad, *trace.ego_size_m)
    route = trace.route if len(trace.route) else trace.ego[sample : sample + 1, :2]
    found: list[tuple[float, FrontGap]] = []
    for index, actor in enumerate(trace.actors):
        if actor.kind != "vehicle" or not _ahead(actor, sample, x_m, y_m, yaw_rad, trace.ego_size_m[0]):
            continue
        there = actor.motion[sample].tolist()
        other = outline(there[0], there[1], there[2], actor.length_m, actor.width_m)
        start, end, clearance_m = closest_points(ego, other)
        if gap_m is None:
            if _off_axis(actor, sample, x_m, y_m, yaw_rad) > CORRIDOR_M:
                continue
            unlikely = clearance_m
        elif abs(clearance_m - gap_m) > TOLERANCE_M:
            continue
        else:
            # An oncoming vehicle may pass at just that distance: the one ahead is the one on the route.
            unlikely = float(np.hypot(*(route - actor.motion[sample, :2]).T).min())
        line = FrontGap(
            actor=index,
            ends=np.vstack([start, end]),
            gap_m=clearance_m if gap_m is None else max(0.0, gap_m),
        )
        found.append((unlikely, line))
    nearest = min(found, key=lambda pair: pair[0])[1] if found else None
    hits = NO_COLLISION in series and bool(series[NO_COLLISION][sample] < 0)
    return None if nearest is None or (hits and nearest.gap_m < APART_M) else nearest


def _ahead(
    actor: ActorTrack, sample: int, x_m: float, y_m: float, yaw_rad: float, ego_length_m: float
) -> bool:
    dx, dy = float(actor.motion[sample, 0]) - x_m, float(actor.motion[sample, 1]) - y_m
    along_m = dx * np.cos(yaw_rad) + dy * np.sin(yaw_rad)
    reach_m = DRAWN_UP_TO_M + ego_length_m + actor.length_m
    # A comparison with NaN is false: an actor that is not there is not ahead.
    return bool(along_m > 0 and np.hypot(dx, dy) < reach_m)


def _off_axis(actor: ActorTrack, sample: int, x_m: float, y_m: float, yaw_rad: float) -> float:
    dx, dy = float(actor.motion[sample, 0]) - x_m, float(actor.motion[sample, 1]) - y_m
    return float(abs(dy * np.cos(yaw_rad) - dx * np.sin(yaw_rad)))
