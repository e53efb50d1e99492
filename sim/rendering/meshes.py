"""Owns solid models: flat faces in groups, and how a whole frame's models become strokes at once.

A model stands in its own axes: x ahead, y left, z up, the middle of its footprint at the origin. Its faces are convex
and listed in painting order within their group; groups are ordered by where the eye is to the planes between them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.sim.rendering.canvas import Mark, Stroke
from brink.sim.rendering.light import Lighting
from brink.sim.rendering.scene import FloatArray
from brink.sim.rendering.view import NEAR_M, View, fixed_point

Plane: TypeAlias = tuple[tuple[float, float, float], float]
"""Normal and offset of a plane in a model's axes."""


class Finish(IntEnum):
    """How a face answers light."""

    PAINT = 0
    GLASS = 1
    LAMP = 2
    """White light ahead; shines when vehicles drive with their lights on."""
    TAIL = 3
    """Red light behind; shines with the lights, brighter when braking."""
    FLAT = 4
    """Dark rubber and holes: hardly shaded."""
    BRAKE = 5
    """The third brake light: dark glass unless braking."""


class Group(IntEnum):
    """Parts of a model between which planes decide the order."""

    WHEELS = 0
    LOWER = 1
    CABIN = 2
    DISCS = 3


class Face(NamedTuple):
    """A flat convex polygon: corners as (x, y, z), counter-clockwise seen from outside.

    `shown_px` is the height in pixels from which a model is large enough for this face to be drawn.
    """

    corners: Sequence[tuple[float, float, float]]
    rgb: tuple[float, float, float]
    group: Group
    solid: bool = True
    finish: Finish = Finish.PAINT
    shown_px: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mesh:
    """A model, ready to be placed.

    Attributes:
        points: Corners of all faces, shape ``(n, 3)``, m.
        starts: Where each face begins in `points`, and the end, length faces + 1.
        normals: Outward, shape ``(faces, 3)``.
        centres: Shape ``(faces, 3)``.
        rgb: Shape ``(faces, 3)``.
        finish: Shape ``(faces,)``.
        group: Shape ``(faces,)``.
        solid: Whether a face adds to the silhouette.
        shown_px: From which height of the model it is drawn.
        floor: Level plane (or side plane, when it was turned over) between wheels and body: normal and offset.
        belt: The same between body and cabin.
    """

    points: FloatArray
    starts: NDArray[np.int64]
    normals: FloatArray
    centres: FloatArray
    rgb: FloatArray
    finish: NDArray[np.int64]
    group: NDArray[np.int64]
    solid: NDArray[np.bool_]
    shown_px: FloatArray
    floor: Plane
    belt: Plane


def mesh_of(faces: Sequence[Face], *, floor: Plane, belt: Plane) -> Mesh:
    """Return faces as a mesh."""
    ordered = sorted(faces, key=lambda face: face.group)
    arrays = [np.array(face.corners, dtype=np.float64) for face in ordered]
    normals = np.array([normal_of(face.corners) for face in ordered])
    return Mesh(
        points=np.concatenate(arrays),
        starts=np.cumsum([0, *(len(corners) for corners in arrays)]),
        normals=normals,
        centres=np.array([corners.mean(axis=0) for corners in arrays]),
        rgb=np.array([face.rgb for face in ordered], dtype=np.float64),
        finish=np.array([face.finish for face in ordered]),
        group=np.array([face.group for face in ordered]),
        solid=np.array([face.solid for face in ordered]),
        shown_px=np.array([face.shown_px for face in ordered]),
        floor=floor,
        belt=belt,
    )


def normal_of(corners: Sequence[tuple[float, float, float]]) -> tuple[float, float, float]:
    """Return the unit normal of a flat polygon (Newell's sum), outward of a counter-clockwise one."""
    x = y = z = 0.0
    x0, y0, z0 = corners[-1]
    for x1, y1, z1 in corners:
        x += (y0 - y1) * (z0 + z1)
        y += (z0 - z1) * (x0 + x1)
        z += (x0 - x1) * (y0 + y1)
        x0, y0, z0 = x1, y1, z1
    length = max(math.sqrt(x * x + y * y + z * z), 1e-12)
    return x / length, y / length, z / length


class Placed(NamedTuple):
    """A mesh somewhere in the world."""

    mesh: Mesh
    x_m: float
    y_m: float
    yaw_rad: float
    height_m: float
    braking: bool
    parked: bool


def mesh_marks(placed: Sequence[Placed], view: View, lighting: Lighting, lit: FloatArray) -> list[list[Mark]]:
    """Return the strokes of each model, in painting order.

    Args:
        placed: The models.
        view: Whence they are seen.
        lighting: The light.
        lit: How strongly the ego's headlights light each model, shape ``(n,)``.
    """
    if not placed:
        return []
    meshes = [item.mesh for item in placed]
    pose = np.array([(item.x_m, item.y_m, item.yaw_rad) for item in placed])
    cosine, sine = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    seen = _seen(meshes, pose, cosine, sine, view)
    dx, dy = view.x_m - pose[:, 0], view.y_m - pose[:, 1]
    eyes = np.stack(
        (dx * cosine + dy * sine, dy * cosine - dx * sine, np.full(len(placed), view.height_m)), 1
    )
    faces = np.array([len(mesh.normals) for mesh in meshes])
    owner = np.repeat(np.arange(len(placed)), faces)
    towards = eyes[owner] - np.concatenate([mesh.centres for mesh in meshes])
    normals = np.concatenate([mesh.normals for mesh in meshes])
    across = np.einsum("ij,ij->i", towards, normals)
    ahead = np.hypot(dx, dy)
    tall_px = view.focal_px * np.array([item.height_m for item in placed]) / np.maximum(ahead, 0.5)
    large = np.concatenate([mesh.shown_px for mesh in meshes]) <= tall_px[owner]
    shown = np.flatnonzero((across > 1e-6) & large)
    shown = shown[np.argsort(_ranks(meshes, eyes, owner)[shown], kind="stable")]
    owner, towards, normals = owner[shown], towards[shown], normals[shown]
    facing = across[shown] / np.sqrt(np.einsum("ij,ij->i", towards, towards))
    rgb = _shaded(placed, meshes, shown, owner, normals, facing, cosine, sine, lighting, lit)
    haze = lighting.haze(ahead)[owner][:, None]
    rgb = np.clip(rgb * (1 - haze) + np.array(lighting.haze_rgb) * haze, 0, 255)
    return _strokes(meshes, seen, shown, owner, rgb, view)


def _ranks(meshes: list[Mesh], eyes: FloatArray, owner: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return numbers that rise in painting order: model by model, hidden groups of a model first."""
    order = np.zeros((len(meshes), len(Group)), dtype=np.int64)
    order[:, Group.DISCS] = 4
    for row, (mesh, eye) in enumerate(zip(meshes, eyes.tolist(), strict=True)):
        order[row, Group.LOWER], order[row, Group.CABIN] = (1, 2) if _beyond(mesh.belt, eye) else (2, 1)
        order[row, Group.WHEELS] = 0 if _beyond(mesh.floor, eye) else 3
    group = np.concatenate([mesh.group for mesh in meshes])
    ranks: NDArray[np.int64] = owner * 8 + order[owner, group]
    return ranks


def _beyond(plane: Plane, eye: list[float]) -> bool:
    (x, y, z), offset = plane
    return x * eye[0] + y * eye[1] + z * eye[2] >= offset


def _seen(
    meshes: list[Mesh], pose: FloatArray, cosine: FloatArray, sine: FloatArray, view: View
) -> FloatArray:
    """Return all corners of all models in camera coordinates, shape ``(n, 3)``."""
    counts = np.array([len(mesh.points) for mesh in meshes])
    points = np.concatenate([mesh.points for mesh in meshes])
    c, s = np.repeat(cosine, counts), np.repeat(sine, counts)
    world = np.empty_like(points)
    world[:, 0] = np.repeat(pose[:, 0], counts) + c * points[:, 0] - s * points[:, 1]
    world[:, 1] = np.repeat(pose[:, 1], counts) + s * points[:, 0] + c * points[:, 1]
    world[:, 2] = points[:, 2]
    return view.to_camera(world)


def _shaded(
    placed: Sequence[Placed],
    meshes: list[Mesh],
    shown: NDArray[np.int64],
    owner: NDArray[np.int64],
    normals: FloatArray,
    facing: FloatArray,
    cosine: FloatArray,
    sine: FloatArray,
    lighting: Lighting,
    lit: FloatArray,
) -> FloatArray:
    """Return the colours of the faces that are shown, under the light, shape ``(shown, 3)``."""
    finish = np.concatenate([mesh.finish for mesh in meshes])[shown]
    rgb = np.concatenate([mesh.rgb for mesh in meshes])[shown]
    sun_x = lighting.sun[0] * cosine + lighting.sun[1] * sine
    sun_y = lighting.sun[1] * cosine - lighting.sun[0] * sine
    to_sun = normals[:, 0] * sun_x[owner] + normals[:, 1] * sun_y[owner] + normals[:, 2] * lighting.sun[2]
    from_sky = 0.86 + 0.14 * normals[:, 2]
    share = lighting.ambient_share * from_sky + lighting.sun_share * np.maximum(to_sun, 0.0)
    share = share + lit[owner] * (0.25 + 0.75 * facing) * 0.9
    share = np.where(finish == Finish.FLAT, 0.5 * share + 0.25 * (lighting.ambient_share + lit[owner]), share)
    shaded = rgb * share[:, None] * lighting.tint
    glass = finish == Finish.GLASS
    sky = np.array(lighting.sky_low_rgb)
    sheen = (
        np.clip(0.10 + 0.30 * normals[glass, 2], 0.06, 0.34)[:, None]
        + 0.18 * (1 - facing[glass])[:, None] ** 2
    )
    shaded[glass] = shaded[glass] * (1 - sheen) + sky * sheen
    braking = np.array([item.braking for item in placed])[owner]
    tail, lamp, third = finish == Finish.TAIL, finish == Finish.LAMP, finish == Finish.BRAKE
    if lighting.lights_on:
        driven = np.array([not item.parked for item in placed])[owner]
        lamp &= driven
        tail &= driven
        shaded[lamp] = (255, 250, 232)
        shaded[tail] = np.maximum(shaded[tail], (176, 22, 20))
    shaded[tail & braking] = (255, 56, 44)
    shaded[third & braking] = (255, 48, 40)
    result: FloatArray = shaded
    return result


def _strokes(
    meshes: list[Mesh],
    seen: FloatArray,
    shown: NDArray[np.int64],
    owner: NDArray[np.int64],
    rgb: FloatArray,
    view: View,
) -> list[list[Mark]]:
    pixels = fixed_point(view.pixels(seen))
    clipped = seen[:, 0] < NEAR_M
    offsets = np.cumsum([0, *(len(mesh.points) for mesh in meshes)])
    starts = np.concatenate(
        [mesh.starts[:-1] + offset for mesh, offset in zip(meshes, offsets, strict=False)]
    )
    ends = np.concatenate([mesh.starts[1:] + offset for mesh, offset in zip(meshes, offsets, strict=False)])
    solid = np.concatenate([mesh.solid for mesh in meshes])[shown].tolist()
    cut_before = np.concatenate(([0], np.cumsum(clipped)))
    cut = (cut_before[ends[shown]] > cut_before[starts[shown]]).tolist()
    marks: list[list[Mark]] = [[] for _ in meshes]
    rows = zip(
        owner.tolist(), starts[shown].tolist(), ends[shown].tolist(), rgb.tolist(), solid, cut, strict=True
    )
    for model, first, last, (red, green, blue), counts, near in rows:
        polygon = pixels[first:last]
        if near:
            polygon = view.polygon(seen[first:last])
        marks[model].append(Stroke(polygon, (red, green, blue), counts))
    return marks
