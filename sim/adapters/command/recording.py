"""The trace of an episode with signals: these and, if some are positions, the drive from above."""

import math
from dataclasses import replace
from typing import Final

import numpy as np

from brink.sim.adapters.command.attempt import Judged
from brink.sim.adapters.command.signals import EGO, FloatArray
from brink.sim.adapters.recording import Actor, Pose, TopDownRecorder
from brink.sim.episode import EpisodeSpec
from brink.sim.provenance import trace_header, versions_with
from brink.sim.trace import Trace

SIZE_M: Final = (4.5, 1.8)
"""Length and width with which vehicles are drawn, as logs have no sizes."""
MAX_SAMPLES: Final = 3000


def trace_of(spec: EpisodeSpec, done: Judged, *packages: str) -> Trace:
    """Return the trace of an episode, with at most `MAX_SAMPLES` samples.

    Args:
        spec: The episode.
        done: What came of it, with all signals. Positions are relative to the ego's first one; without any, the ego
            stays there.
        packages: Further distributions whose versions decide the episode.
    """
    first = np.arange(0, len(done.time_s), math.ceil(len(done.time_s) / MAX_SAMPLES))
    time_s = done.time_s[first]
    margins = {
        name: np.minimum.reduceat(one.margins(done.time_s, done.signals), first)
        for name, one in done.requirements.items()
    }
    columns = {
        name: [done.signals[one][first] for one in names] for name, names in done.source.positions.items()
    }
    origin_m = [column[0] for column in columns.get(EGO, ())][:2]
    positions = {name: _poses(time_s, one, origin_m) for name, one in columns.items()}
    ego = positions.pop(EGO, None) or [Pose(x_m=0.0, y_m=0.0, yaw_rad=0.0, speed_mps=0.0)] * len(time_s)
    recorder = TopDownRecorder(
        tuple(done.requirements), ego_size_m=SIZE_M, scene=(), route=np.zeros((0, 2), np.float32)
    )
    vehicle = Actor(kind="vehicle", length_m=SIZE_M[0], width_m=SIZE_M[1])
    for sample, now_s in enumerate(time_s.tolist()):
        recorder.sample(
            now_s,
            ego[sample],
            0.0,
            {name: (vehicle, poses[sample]) for name, poses in positions.items()},
            robustness={name: float(series[sample]) for name, series in margins.items()},
        )
    trace = recorder.trace(trace_header(spec, done.verdicts, versions_with(*packages)))
    signals = {name: values[first].astype(np.float32) for name, values in done.signals.items()}
    return replace(trace, signals=signals)


def _poses(time_s: FloatArray, columns: list[FloatArray], origin_m: list[float]) -> list[Pose]:
    """Return the poses of a road user from an origin; without a heading, it looks where it moves."""
    x_m, y_m = (column - origin for column, origin in zip(columns, origin_m, strict=False))
    if len(time_s) > 1:
        vx_mps, vy_mps = np.gradient(x_m, time_s), np.gradient(y_m, time_s)
    else:
        vx_mps = vy_mps = np.zeros(1)
    yaw_rad = columns[2] if len(columns) > 2 else np.arctan2(vy_mps, vx_mps)
    speed_mps = np.hypot(vx_mps, vy_mps)
    return [
        Pose(x_m=x, y_m=y, yaw_rad=yaw, speed_mps=speed)
        for x, y, yaw, speed in zip(*(one.tolist() for one in (x_m, y_m, yaw_rad, speed_mps)), strict=True)
    ]
