"""The visible actions of drivers and scripted road users in words: plans, scripts and motion; and the lane's edge.

A script that has a standing road user change lanes moves nobody: words follow the motion that the trace recorded.
"""

from typing import Final

import numpy as np

from brink.pictures.scene import Points, gap_to, is_car, plain_name, spec_part
from brink.pictures.story import runs
from brink.sim.encounter.specification import ACTION_WORDS, REFERENCE
from brink.sim.plane import half_extents_m
from brink.sim.requirements import LANE_TOLERANCE_M, STANDS_BELOW_MPS
from brink.sim.trace import ACTION, Trace

STANDS: Final = "stands"
KEEPS: Final = ACTION_WORDS["keep"]
BRAKES, WAITS, DRIVES = "brakes", "waits", "drives"
"""What a reference driver does."""
STANDS_MPS: Final = STANDS_BELOW_MPS
CREEPS_MPS: Final = 2.0
"""Below this speed, a driver who moves on a little after braking is still braking."""
_LETS_GO_S: Final = 1.5
"""A slow driver who lets go of the brake for a shorter time is still braking."""
_MOVES_UP_MPS: Final = 1.0
"""A waiting driver who moves up a little, more slowly than this, is still waiting."""
_STOP: Final = "stop"
_SAME_WAY: Final = 0.7
"""Cosine of the angle up to which road users go the same way."""


def is_reference(trace: Trace) -> bool:
    """Return whether a drive is that of a reference driver."""
    return spec_part(trace, "behaviour").get("mode") == REFERENCE


def plan_words(trace: Trace) -> list[str]:
    """Return the driver's plan at each sample; for a reference driver, its action: brake, wait or drive."""
    modes = [str(mode) for mode in trace.plan_mode]
    if not is_reference(trace):
        return modes
    stands = np.abs(trace.ego[:, 3]) < STANDS_MPS
    words = [DRIVES] * len(modes)
    last: int | None = None
    for mode, first, end in runs(modes):
        if mode != _STOP:
            continue
        words[first : end + 1] = [BRAKES] * (end + 1 - first)
        if last is not None and trace.time_s[first] - trace.time_s[last] < _LETS_GO_S:
            gap = slice(last + 1, first)
            if (trace.ego[gap, 3] < CREEPS_MPS).all():
                words[gap] = [BRAKES] * (first - last - 1)
        last = end
    words = [WAITS if standing else word for word, standing in zip(words, stands.tolist(), strict=True)]
    told = runs(words)
    for (before, _, _), (_, first, end), (after, _, _) in zip(told, told[1:], told[2:], strict=False):
        lasts_s = float(trace.time_s[end] - trace.time_s[first])
        if (
            before == after == WAITS
            and lasts_s < _LETS_GO_S
            and trace.ego[first : end + 1, 3].max() < _MOVES_UP_MPS
        ):
            words[first : end + 1] = [WAITS] * (end + 1 - first)
    return words


def brakings(trace: Trace) -> list[tuple[int, int]]:
    """Return the first and last sample of each time for which a reference driver brakes, and then waits."""
    slow = [word != DRIVES for word in plan_words(trace)]
    stops = [sample for sample, mode in enumerate(trace.plan_mode) if mode == _STOP]
    spans = [([at for at in stops if first <= at <= last], last) for held, first, last in runs(slow) if held]
    return [(its[0], last) for its, last in spans if its]


def scripts_of(trace: Trace) -> dict[str, list[str]]:
    """Return the action of each scripted road user at each sample in words, by name; empty without scripts."""
    scripts: dict[str, list[str]] = {}
    for event in trace.events:
        if event.kind == ACTION:
            name, _, action = event.text.partition(":")
            actions = scripts.setdefault(name, [""] * len(trace.time_s))
            first = int(np.searchsorted(trace.time_s, event.time_s - 0.06))
            words = ACTION_WORDS.get(action, action.replace("_", " "))
            actions[first:] = [words] * (len(actions) - first)
    for actor in trace.actors:
        for sample in np.flatnonzero(actor.motion[:, 3] < STANDS_MPS).tolist():
            if actor.name in scripts and scripts[actor.name][sample]:
                scripts[actor.name][sample] = STANDS
    return dict(sorted(scripts.items(), key=lambda item: int(item[0].rpartition("-")[2])))


def motion_of(trace: Trace, actor: int, sample: int) -> str:
    """Return how a road user moves relative to the road, such as ``stands`` or ``crosses at 3 m/s``."""
    other = trace.actors[actor]
    _, _, yaw_rad, speed_mps = (float(value) for value in other.motion[sample, :4])
    if not np.isfinite(speed_mps):
        return ""
    if abs(speed_mps) < STANDS_MPS:
        return STANDS
    along = float(np.cos(yaw_rad - route_yaw_rad(trace, sample)))
    speed = f"{speed_mps:.0f} m/s" if speed_mps >= 2.0 else f"{speed_mps:.1f} m/s"
    if abs(along) < _SAME_WAY:
        return f"crosses at {speed}"
    verb = "drives" if is_car(other) else "walks"
    return f"{verb} at {speed}" if along > 0 else f"comes towards at {speed}"


def route_yaw_rad(trace: Trace, sample: int) -> float:
    """Return the heading of the route where the ego is at a sample; the ego's own without a route."""
    if len(trace.route) < 2:
        return float(trace.ego[sample, 2])
    nearest = int(np.hypot(*(trace.route - trace.ego[sample, :2]).T).argmin())
    start = min(nearest, len(trace.route) - 2)
    step = trace.route[start + 1] - trace.route[start]
    return float(np.arctan2(step[1], step[0]))


def distances(trace: Trace, actor: int) -> Points:
    """Return the distance between the outlines of the ego and a road user at each sample; NaN while it is absent."""
    gaps = [gap_to(trace, sample, actor) for sample in range(len(trace.time_s))]
    return np.array([np.nan if gap is None else gap.gap_m for gap in gaps])


def lane_edge(trace: Trace, sample: int, reach_m: float) -> Points | None:
    """Return the edge of the lane on the ego's side as a line along the route, shape ``(k, 2)``; None if not known.

    Args:
        trace: The drive, which records the margin of `lane-keeping`.
        sample: Where the ego is.
        reach_m: How far the line extends along the route, ahead and behind.
    """
    series = next((one for name, one in trace.robustness.items() if plain_name(name) == "lane-keeping"), None)
    if series is None or len(trace.route) < 3:
        return None
    found = [_offset(trace, at) for at in range(0, len(trace.time_s), 5)]
    # The margin is measured from the outermost corner of the body; the median tells where the edge is.
    half_m = float(
        np.median(
            [abs(offset_m) + corner_m + float(series[5 * i]) for i, (offset_m, corner_m) in enumerate(found)]
        )
    )
    side = 1.0 if _offset(trace, sample)[0] >= 0 else -1.0
    route = np.asarray(trace.route, np.float64)
    near = int(np.hypot(*(route - trace.ego[sample, :2]).T).argmin())
    stations = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(route, axis=0).T))])
    inside = np.abs(stations - stations[near]) <= reach_m
    tangent = np.gradient(route, axis=0)
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    normal /= np.maximum(np.hypot(*normal.T), 1e-9)[:, None]
    edge: Points = (route + side * (half_m - LANE_TOLERANCE_M) * normal)[inside]
    return edge


def _offset(trace: Trace, sample: int) -> tuple[float, float]:
    """Return how far the ego is to the left of its route, and how far its outermost corner is from its middle."""
    yaw_rad = route_yaw_rad(trace, sample)
    near = int(np.hypot(*(trace.route - trace.ego[sample, :2]).T).argmin())
    dx, dy = (float(value) for value in trace.ego[sample, :2] - trace.route[near])
    error = float(trace.ego[sample, 2]) - yaw_rad
    length_m, width_m = trace.ego_size_m
    _, corner_m = half_extents_m(length_m, width_m, error)
    return dy * float(np.cos(yaw_rad)) - dx * float(np.sin(yaw_rad)), corner_m
