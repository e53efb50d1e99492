"""An episode made by hand, with everything in it that a replay draws; positions are exact, so tests can check."""

import io
from dataclasses import replace

import numpy as np
from PIL import Image

from brink.sim.driving.camera import Camera, Solid
from brink.sim.driving.interface import ObstacleLabel
from brink.sim.trace import (
    BOX_COLUMNS,
    FOUND_COLUMNS,
    JUDGED_COLUMNS,
    PERCEIVED_COLUMNS,
    ActorTrack,
    Event,
    Film,
    GuardTrack,
    Ragged,
    Surface,
    Trace,
)

REQUIRED_GAP_M = 1.5
HORIZON_M = 50.0
EGO_SIZE_M = (4.5, 1.85)


def ragged(columns: tuple[str, ...], samples: list[list[tuple[float, ...]]]) -> Ragged:
    first = np.cumsum([0, *(len(rows) for rows in samples)]).astype(np.int32)
    rows = [row for sample in samples for row in sample]
    return Ragged(
        columns=columns, first=first, rows=np.array(rows, dtype=np.float32).reshape(-1, len(columns))
    )


def surface(kind: str, points: object, *, closed: bool = True, width_m: float = 0.0) -> Surface:
    return Surface(kind=kind, points=np.array(points, dtype=np.float32), closed=closed, width_m=width_m)


def rectangle(kind: str, left: float, bottom: float, right: float, top: float) -> Surface:
    return surface(kind, [(left, bottom), (right, bottom), (right, top), (left, top)])


def straight_scene() -> tuple[Surface, ...]:
    """A road along x, lanes of 3.5 m, a crossing at 60 m and a side street to the right at 95 m."""
    found = [
        rectangle("pavement", -40, -7.5, 160, -5.5),
        rectangle("pavement", -40, 5.5, 160, 7.5),
        rectangle("road", -40, -5.5, 160, 5.5),
        rectangle("road", 95, -60, 102, -5.0),
        surface("marking", [(-40, -3.6), (160, -3.6)], closed=False, width_m=0.12),
        surface("marking", [(-40, 3.6), (160, 3.6)], closed=False, width_m=0.12),
    ]
    found += [
        surface("marking", [(x, 0), (x + 3, 0)], closed=False, width_m=0.15) for x in range(-40, 160, 7)
    ]
    found += [rectangle("crossing", 60, y, 63, y + 0.5) for y in np.arange(-5.3, 5.2, 1.0)]
    found.append(rectangle("stop-line", 58.4, -3.5, 58.8, 0.0))
    found += [rectangle("building", x, 10, x + 16, 22) for x in range(-30, 150, 22)]
    found += [rectangle("building", x, -24, x + 12, -11) for x in range(-30, 80, 19)]
    found += [rectangle("parked-car", x, -5.4, x + 4.4, -3.7) for x in (12, 20, 75)]
    turn = np.linspace(0, 2 * np.pi, 13)[:-1]
    for x in range(-20, 150, 22):
        found.append(surface("tree", np.column_stack([x + 1.6 * np.cos(turn), 8.8 + 1.6 * np.sin(turn)])))
    return tuple(found)


def make_trace(*, samples: int = 200, lead_stops_at_m: float = 80.0, violated: bool = True) -> Trace:
    """The ego follows a road with a ghost beside it and comes too near to the vehicle ahead, or just not."""
    time_s = np.arange(samples) * 0.1
    standstill = lead_stops_at_m - 4.5 - (0.6 if violated else 3.0)
    x = (
        standstill * (1 - np.exp(-time_s / 5.0)) / (1 - np.exp(-time_s[-1] / 5.0))
        if samples > 1
        else np.zeros(1)
    )
    y = -1.75 + 0.9 * np.exp(-((x - 35.0) ** 2) / 60.0)
    yaw = np.arctan2(np.gradient(y), np.gradient(x)) if samples > 1 else np.zeros(1)
    speed = np.hypot(np.gradient(x, 0.1), np.gradient(y, 0.1)) if samples > 1 else np.zeros(1)
    accel = np.gradient(speed, 0.1) if samples > 1 else np.zeros(1)
    lead_x = np.minimum(22.0 + 7.0 * time_s, lead_stops_at_m)
    motions = {
        "lead": ("vehicle", 4.5, 1.85, lead_x, np.full(samples, -1.75), np.zeros(samples)),
        "oncoming": ("vehicle", 4.7, 1.9, 120 - 6 * time_s, np.full(samples, 1.75), np.full(samples, np.pi)),
        "pedestrian-1": ("pedestrian", 0.5, 0.5, np.full(samples, 61.0), 6 - 1.1 * time_s, np.full(samples, -1.57)),
        "pedestrian-2": ("pedestrian", 0.5, 0.5, 20 + 1.2 * time_s, np.full(samples, 6.6), np.zeros(samples)),
    }  # fmt: skip
    actors = []
    for name, (kind, length_m, width_m, ax, ay, ayaw) in motions.items():
        aspeed = np.abs(np.gradient(ax, 0.1)) if samples > 1 else np.zeros(1)
        motion = np.column_stack([ax, ay, ayaw, aspeed]).astype(np.float32)
        if name == "oncoming":
            motion[: samples // 20] = np.nan
        actors.append(ActorTrack(name=name, kind=kind, length_m=length_m, width_m=width_m, motion=motion))
    gap = np.clip(lead_x - x - 4.5, 0.0, HORIZON_M)
    robustness = np.minimum(gap - REQUIRED_GAP_M, HORIZON_M)
    ghost = (time_s > 3.0) & (time_s < 9.0)
    given: list[list[tuple[float, ...]]] = [
        [(0.0, 420 + 8 * t, 520 + 12 * t, 290.0, 360 + 8 * t)] if on else []
        for t, on in zip(time_s, ghost, strict=True)
    ]
    perceived: list[list[tuple[float, ...]]] = [
        [(1.0, 0.0, ex + 14.0, -3.4, 0.2, 0.0, 4.5, 1.8)] if on else []
        for ex, on in zip(x, ghost, strict=True)
    ]
    modes = np.where(ghost, "nudge", "cruise")
    modes[(speed < 2.0) & (time_s > 9)] = "stop"
    decisive = np.flatnonzero(robustness < 0)
    events = [Event(time_s=3.1, kind="nudge", text="nudges around vehicle")]
    if decisive.size:
        events.append(
            Event(time_s=float(time_s[decisive[0]]), kind="violation", text="front gap under 1.5 m")
        )
    ego = np.column_stack([x, y, yaw, speed, accel]).astype(np.float32)
    return Trace(
        time_s=time_s.astype(np.float32),
        ego=ego,
        ego_size_m=EGO_SIZE_M,
        route=np.column_stack([np.arange(-10, 130, 2.0), np.full(70, -1.75)]).astype(np.float32),
        actors=tuple(actors),
        seen_boxes=ragged(BOX_COLUMNS, _seen(ego, actors)),
        given_boxes=ragged(BOX_COLUMNS, given),
        perceived=ragged(PERCEIVED_COLUMNS, perceived),
        plan_mode=tuple(str(mode) for mode in modes),
        target_speed_mps=np.where(ghost, 6.0, 8.0).astype(np.float32),
        target_offset_m=np.where(ghost, 0.9, 0.0).astype(np.float32),
        lights=tuple("red" if 4 < t < 8 else "green" for t in time_s),
        robustness={
            "front-gap@1": robustness.astype(np.float32),
            "progress@1": np.full(samples, 5, np.float32),
        },
        events=tuple(events),
        scene=straight_scene(),
        about={
            "spec": {
                "scenario": {
                    "time_of_day": "sunset",
                    "weather": "wet_cloudy",
                    "pedestrians": 18,
                    "road_curve": "straight",
                    "road_id": 1,
                    "road_length": 1,
                    "driving_task": "follow_road",
                }
            }
        },
    )


def _seen(ego: np.ndarray, actors: list[ActorTrack]) -> list[list[tuple[float, ...]]]:
    camera = Camera()
    found: list[list[tuple[float, ...]]] = []
    for sample, (x_m, y_m, yaw_rad, _, _) in enumerate(ego.tolist()):
        rows: list[tuple[float, ...]] = []
        for actor in actors:
            ax, ay, ayaw, _ = actor.motion[sample].tolist()
            if ax != ax:
                continue
            vehicle = actor.kind == "vehicle"
            body = Solid(
                label=ObstacleLabel.VEHICLE if vehicle else ObstacleLabel.PERSON,
                x_m=ax,
                y_m=ay,
                yaw_rad=ayaw,
                length_m=actor.length_m,
                width_m=actor.width_m,
                height_m=1.5 if vehicle else 1.75,
            )
            seen = camera.project(x_m, y_m, yaw_rad, body)
            if seen is not None:
                box = seen[0]
                rows.append((0.0 if vehicle else 1.0, box.x_min_px, box.x_max_px, box.y_min_px, box.y_max_px))
        found.append(rows)
    return found


def filmed(trace: Trace, pictures: int = 3) -> Trace:
    """Return an episode with a film: a person who is there at every sample, and detected less and less surely."""
    samples = len(trace.time_s)
    there = (1.0, 100.0, 130.0, 150.0, 240.0)
    film = Film(
        size_px=(320, 240),
        pictures=tuple(grey_jpeg(64 + 8 * index) for index in range(pictures)),
        samples=np.arange(pictures, dtype=np.int32) * 2,
        judged=ragged(JUDGED_COLUMNS, [[(*there, 0.0)] for _ in range(samples)]),
        found=ragged(FOUND_COLUMNS, [[(*there, 1 - index / samples)] for index in range(samples)]),
        regions={"warning": np.array([(130, 150), (190, 150), (250, 240), (70, 240)], np.float32)},
    )
    return replace(trace, film=film)


def guarded(trace: Trace) -> Trace:
    """Return a drive of at least 8 s with an alarm from 4 to 6 s, on which a fallback intervenes from 4.5 to 8 s."""
    samples = len(trace.time_s)
    alarm, intervenes = (np.zeros(samples, np.uint8) for _ in range(2))
    alarm[40:60], intervenes[45:80] = 1, 1
    rising = np.linspace(0.0, 0.9, samples, dtype=np.float32)
    track = GuardTrack(
        fallback="safe-stop@1",
        horizons_s=(1.0, 3.0),
        probabilities=np.column_stack([rising / 2, rising]),
        alarm=alarm,
        intervenes=intervenes,
    )
    return replace(trace, guard=track)


def grey_jpeg(level: int) -> bytes:
    """Return a small picture of one grey."""
    buffer = io.BytesIO()
    Image.new("RGB", (32, 24), (level, level, level)).save(buffer, "JPEG")
    return buffer.getvalue()
