"""Labelled pictures from the simulator: streets by day and night, in every weather, with people everywhere.

Training, validation and test draw from disjoint seeds and from disjoint looks (colours, textures, shapes). People
stand and walk where the emergency-braking episode has them, and elsewhere, at all distances; nothing unusual lies
on the road, and no picture is perturbed: both must stay new to the detector. (Training varies exposure a little.)
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Final

import numpy as np

from brink.sim.aeb.scenario import ARRIVAL_S, CROSSING_M, ONCOMING_M, AebScenario, Occluder
from brink.sim.aeb.street import CRUISE_MPS, KERB_M, LANE_M, LANE_Y_M, PERSON, STRIP_M, make_street
from brink.sim.perception.detector import Picture
from brink.sim.perception.quality import Truth
from brink.sim.rendering.renderer import Renderer
from brink.sim.rendering.scene import Body, BodyKind, Frame, Light, PictureCamera, StreetScene, Viewpoint
from brink.sim.rendering.visible import visible_bodies
from brink.sim.world.scenario import TimeOfDay, Weather

SIZE_PX: Final = (640, 360)
FRAMES_A_STREET: Final = 10
MIN_HEIGHT_SHARE: Final = 12.0 / 360.0
"""Lower boxes are ignored: 6 px where the network looks, whose picture is half as large."""
MIN_WIDTH_SHARE: Final = 6.0 / 640.0
"""So are narrower ones: 3 px."""
MIN_VISIBLE: Final = 0.25
_LABELS: Final = {BodyKind.VEHICLE: 0, BodyKind.PERSON: 1}


class Split(IntEnum):
    """What pictures are for; also the thousands of their seeds and looks."""

    TRAIN = 1
    VALIDATION = 2
    TEST = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LabelledFrame:
    """A picture and what is in it.

    Attributes:
        picture: RGB, shape ``(360, 640, 3)``.
        truth: Labels 0 (vehicle) and 1 (person).
        depths_m: How far away each box is, shape ``(n,)``.
    """

    picture: Picture
    truth: Truth
    depths_m: np.ndarray[tuple[int], np.dtype[np.float32]]


def labelled_frames(split: Split, count: int, seed: int = 0) -> Iterator[LabelledFrame]:
    """Yield pictures, the same ones for the same arguments.

    Args:
        split: Which of the three disjoint sets.
        count: How many.
        seed: Which pictures of the set.
    """
    for street in range(-(-count // FRAMES_A_STREET)):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(split), street)))
        for index, frame in enumerate(_street_frames(split, rng)):
            if street * FRAMES_A_STREET + index < count:
                yield frame


def _street_frames(split: Split, rng: np.random.Generator) -> Iterator[LabelledFrame]:
    scenario = AebScenario(
        time_of_day=list(TimeOfDay)[int(rng.integers(len(TimeOfDay)))],
        weather=list(Weather)[int(rng.integers(len(Weather)))],
        occluder=list(Occluder)[int(rng.integers(len(Occluder)))],
        crossing_m=float(rng.uniform(*CROSSING_M)),
        arrival_s=float(rng.uniform(*ARRIVAL_S)),
        oncoming_m=float(rng.uniform(*ONCOMING_M)),
    )
    street = make_street(scenario, int(split) * 10**6 + int(rng.integers(10**6)))
    scene = _with_looks(street.scene, split)
    renderer = Renderer(
        scene,
        Light(time_of_day=scenario.time_of_day, weather=scenario.weather),
        PictureCamera(width_px=SIZE_PX[0], height_px=SIZE_PX[1]),
        int(split) * 10**6 + int(rng.integers(10**6)),
    )
    people_from = 10_000
    for time_s in np.sort(rng.uniform(0.0, 12.0, FRAMES_A_STREET)).tolist():
        x_m = CRUISE_MPS * time_s
        walkers = [_person(people_from + index, x_m, split, rng) for index in range(int(rng.integers(3, 11)))]
        actors = [_with_look(actor.now(), split) for actor in street.actors]
        moved = [replace(body, x_m=x_m + float(rng.uniform(-5.0, 60.0))) for body in actors]
        view = Viewpoint(
            x_m=x_m, y_m=LANE_Y_M + float(rng.uniform(-0.3, 0.3)), yaw_rad=float(rng.normal(0.0, 0.02)),
            pitch_rad=float(rng.normal(0.0, 0.01)),
        )  # fmt: skip
        frame = renderer.frame(view, [*_apart(moved), *walkers], time_s)
        yield labelled(frame)


def _apart(bodies: list[Body]) -> list[Body]:
    """Return those bodies that stand in nobody's place."""
    kept: list[Body] = []
    for body in bodies:
        reach = [0.5 * (body.length_m + other.length_m) for other in kept]
        if all(
            abs(body.x_m - other.x_m) > far or abs(body.y_m - other.y_m) > 2.0
            for other, far in zip(kept, reach, strict=True)
        ):
            kept.append(body)
    return kept


def _with_looks(scene: StreetScene, split: Split) -> StreetScene:
    return replace(
        scene,
        buildings=tuple(replace(b, look=b.look + 1000 * split) for b in scene.buildings),
        trees=tuple(replace(t, look=t.look + 1000 * split) for t in scene.trees),
        parked=tuple(_with_look(b, split) for b in scene.parked),
    )


def _with_look(body: Body, split: Split) -> Body:
    return replace(body, look=body.look % 1000 + 1000 * int(split))


def _person(number: int, ego_x_m: float, split: Split, rng: np.random.Generator) -> Body:
    """Return somebody on a pavement, between parked vehicles, or on the road, most of them near."""
    ahead_m = 3.5 + 35.0 * float(rng.random()) ** 1.8
    place = rng.random()
    if place < 0.4:
        y_m = float(rng.choice([-1.0, 1.0])) * (KERB_M + float(rng.uniform(0.5, 2.7)))
    elif place < 0.6:
        y_m = float(rng.choice([-1.0, 1.0])) * (LANE_M + float(rng.uniform(0.0, STRIP_M)))
    else:
        y_m = float(rng.uniform(-LANE_M, LANE_M))
    length_m, width_m, height_m = PERSON
    return Body(
        id=number, kind=BodyKind.PERSON, x_m=ego_x_m + ahead_m, y_m=y_m,
        yaw_rad=float(rng.uniform(-math.pi, math.pi)), length_m=length_m, width_m=width_m,
        height_m=height_m + float(rng.uniform(-0.25, 0.15)), look=int(rng.integers(1000)) + 1000 * int(split),
        phase=float(rng.uniform(0.0, 2.0 * math.pi)),
    )  # fmt: skip


def labelled(frame: Frame) -> LabelledFrame:
    """Return a rendered picture with its ground truth.

    Boxes hold the whole of a body as far as the picture goes, hidden parts included; who is nearly hidden does not
    count.
    """
    seen = [body for body in visible_bodies(frame) if body.box is not None and body.kind in _LABELS]
    boxes = np.array([body.whole_box for body in seen], np.float32).reshape(len(seen), 4)
    height_px, width_px = frame.image.shape[:2]
    low = (boxes[:, 3] - boxes[:, 1]) < MIN_HEIGHT_SHARE * height_px
    low |= (boxes[:, 2] - boxes[:, 0]) < MIN_WIDTH_SHARE * width_px
    hidden = np.array([body.visible_share < MIN_VISIBLE for body in seen], np.bool_)
    return LabelledFrame(
        picture=frame.image,
        truth=Truth(
            labels=np.array([_LABELS[body.kind] for body in seen], np.int64),
            boxes=boxes,
            ignored=low | hidden,
        ),
        depths_m=np.array([body.depth_m for body in seen], np.float32),
    )
