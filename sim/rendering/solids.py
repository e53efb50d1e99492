"""Solid shapes as strokes: models of flat faces, and limbs with rounded ends.

A model has its own axes: x ahead, y left, z up, with the middle of its footprint at the origin. Its faces are convex
and listed in painting order within their group. Groups are ordered by the side of the separating plane that the eye
is on. All shapes of a frame are converted in one batch.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.sim.rendering.light import Lighting
from brink.sim.rendering.scene import FloatArray, Mark, Rgb, Stroke
from brink.sim.rendering.view import NEAR_M, SHIFT, View, to_fixed_point

Plane: TypeAlias = tuple[tuple[float, float, float], float]
"""Normal and offset of a plane in a model's axes."""


class Finish(IntEnum):
    """How a face responds to light."""

    PAINT = 0
    GLASS = 1
    LAMP = 2
    """White front light; on when vehicles drive with their lights on."""
    TAIL = 3
    """Red rear light; on with the lights, and brighter when braking."""
    FLAT = 4
    """Dark rubber and openings, hardly shaded."""
    BRAKE = 5
    """Third brake light; dark glass unless braking."""
    LIT = 6
    """A lamp that is on; its colour does not depend on the light."""


class Group(IntEnum):
    """Groups of faces of a model; planes between the groups decide their painting order."""

    WHEELS = 0
    LOWER = 1
    CABIN = 2
    DISCS = 3


class Face(NamedTuple):
    """A flat convex polygon with corners (x, y, z), counter-clockwise seen from outside.

    `shown_px` is the height in pixels that a model must reach for this face to be drawn.
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
        starts: Index in `points` at which each face begins, then the end, length faces + 1.
        normals: Outward unit normals, shape ``(faces, 3)``.
        centres: Shape ``(faces, 3)``.
        rgb: Shape ``(faces, 3)``.
        finish: Shape ``(faces,)``.
        group: Shape ``(faces,)``.
        solid: Whether a face adds to the silhouette, shape ``(faces,)``.
        shown_px: Height that the model must reach for a face to be drawn, shape ``(faces,)``.
        floor: Plane between wheels and body, rotated with an overturned model.
        belt: Plane between body and cabin.
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


def make_mesh(faces: Sequence[Face], *, floor: Plane, belt: Plane) -> Mesh:
    """Build a mesh from faces.

    Args:
        faces: In painting order within their group.
        floor: Plane between wheels and body.
        belt: Plane between body and cabin.
    """
    ordered = sorted(faces, key=lambda face: face.group)
    arrays = [np.array(face.corners, dtype=np.float64) for face in ordered]
    normals = np.array([unit_normal(face.corners) for face in ordered])
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


def unit_normal(corners: Sequence[tuple[float, float, float]]) -> tuple[float, float, float]:
    """Return the unit normal of a flat polygon (Newell's method), outward if it is counter-clockwise."""
    x = y = z = 0.0
    x0, y0, z0 = corners[-1]
    for x1, y1, z1 in corners:
        x += (y0 - y1) * (z0 + z1)
        y += (z0 - z1) * (x0 + x1)
        z += (x0 - x1) * (y0 + y1)
        x0, y0, z0 = x1, y1, z1
    length = max(math.sqrt(x * x + y * y + z * z), 1e-12)
    return x / length, y / length, z / length


class PlacedMesh(NamedTuple):
    """A mesh at a position in the world."""

    mesh: Mesh
    x_m: float
    y_m: float
    yaw_rad: float
    height_m: float
    braking: bool
    parked: bool


def draw_meshes(
    placed: Sequence[PlacedMesh], view: View, lighting: Lighting, lit: FloatArray
) -> list[list[Mark]]:
    """Return the strokes of each model, in painting order.

    Args:
        placed: The models.
        view: The camera.
        lighting: The light.
        lit: Artificial light on each model, in [0, 1], shape ``(n,)``.
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
    sight = towards / np.maximum(np.sqrt(np.einsum("ij,ij->i", towards, towards)), 1e-9)[:, None]
    facing = np.einsum("ij,ij->i", normals, sight)
    sun_x = lighting.sun[0] * cosine + lighting.sun[1] * sine
    sun_y = lighting.sun[1] * cosine - lighting.sun[0] * sine
    surface = _Surface(
        owner=owner,
        finish=np.concatenate([mesh.finish for mesh in meshes])[shown],
        rgb=np.concatenate([mesh.rgb for mesh in meshes])[shown],
        normals=normals,
        facing=facing,
        mirrored=2.0 * facing[:, None] * normals - sight,
        sun=np.stack((sun_x, sun_y, np.full(len(placed), lighting.sun[2])), 1)[owner],
    )
    rgb = surface.shaded(placed, lighting, lit)
    haze = lighting.haze(ahead)[owner][:, None]
    rgb = np.clip(rgb * (1 - haze) + np.array(lighting.haze_rgb) * haze, 0, 255)
    return _strokes(meshes, seen, shown, owner, rgb, view)


def _ranks(meshes: list[Mesh], eyes: FloatArray, owner: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return sort keys for painting: model by model, and within a model the hidden groups first."""
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


_GROUND_RGB: Final = 70.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Surface:
    """The visible faces of all models, each in the coordinates of its model.

    Attributes:
        owner: Index of each face's model, shape ``(n,)``.
        finish: Finish of each face, shape ``(n,)``.
        rgb: Colours, shape ``(n, 3)``.
        normals: Unit vectors, shape ``(n, 3)``.
        facing: Cosine between normal and sight, shape ``(n,)``.
        mirrored: Unit vectors of the sight as the face mirrors it, shape ``(n, 3)``.
        sun: Direction of the sun, shape ``(n, 3)``.
    """

    owner: NDArray[np.int64]
    finish: NDArray[np.int64]
    rgb: FloatArray
    normals: FloatArray
    facing: FloatArray
    mirrored: FloatArray
    sun: FloatArray

    def shaded(self, placed: Sequence[PlacedMesh], lighting: Lighting, lit: FloatArray) -> FloatArray:
        """Return the colours of the faces under the light, shape ``(n, 3)``."""
        rgb = self._diffuse(lighting, lit)
        self._add_reflections(rgb, lighting)
        self._switch_lamps(rgb, placed, lighting)
        return rgb

    def _diffuse(self, lighting: Lighting, lit: FloatArray) -> FloatArray:
        from_sky = 0.80 + 0.22 * self.normals[:, 2]
        to_sun = np.maximum(_dot(self.normals, self.sun), 0.0)
        share = lighting.ambient_strength * from_sky + lighting.sun_strength * to_sun
        share = share + lit[self.owner] * (0.25 + 0.75 * self.facing) * 0.9
        flat = 0.5 * share + 0.25 * (lighting.ambient_strength + lit[self.owner])
        share = np.where(self.finish == Finish.FLAT, flat, share)
        diffuse: FloatArray = self.rgb * share[:, None] * lighting.tint
        return diffuse

    def _add_reflections(self, rgb: FloatArray, lighting: Lighting) -> None:
        """Let paint and glass mirror the sun and the sky or the ground, most at a grazing angle."""
        paint, glass = self.finish == Finish.PAINT, self.finish == Finish.GLASS
        glint = 150.0 * lighting.sun_strength * np.maximum(_dot(self.mirrored, self.sun), 0.0) ** 14
        gloss = 0.05 + 0.34 * (1 - self.facing[paint, None]) ** 3
        ground = _GROUND_RGB * (lighting.ambient_strength + 0.5 * lighting.sun_strength)
        sky = np.array(lighting.sky_low_rgb)
        around = np.where(self.mirrored[paint, 2:] > 0, sky, ground)
        rgb[paint] += (around - rgb[paint]) * gloss
        rgb[paint | glass] += glint[paint | glass, None]
        steep = np.clip(0.10 + 0.30 * self.normals[glass, 2], 0.06, 0.34)[:, None]
        sheen = steep + 0.18 * (1 - self.facing[glass])[:, None] ** 2
        rgb[glass] = rgb[glass] * (1 - sheen) + sky * sheen

    def _switch_lamps(self, rgb: FloatArray, placed: Sequence[PlacedMesh], lighting: Lighting) -> None:
        braking = np.array([item.braking for item in placed])[self.owner]
        tail, third = self.finish == Finish.TAIL, self.finish == Finish.BRAKE
        if lighting.lights_on:
            driven = np.array([not item.parked for item in placed])[self.owner]
            tail &= driven
            rgb[(self.finish == Finish.LAMP) & driven] = (255, 250, 232)
            rgb[tail] = np.maximum(rgb[tail], (176, 22, 20))
        lit = self.finish == Finish.LIT
        rgb[lit] = self.rgb[lit]
        rgb[tail & braking] = (255, 56, 44)
        rgb[third & braking] = (255, 48, 40)


def _dot(first: FloatArray, second: FloatArray) -> FloatArray:
    product: FloatArray = first[:, 0] * second[:, 0] + first[:, 1] * second[:, 1] + first[:, 2] * second[:, 2]
    return product


_MARGIN: Final = 2 << SHIFT
_HALF_PIXEL: Final = 1 << (SHIFT - 1)


def _strokes(
    meshes: list[Mesh],
    seen: FloatArray,
    shown: NDArray[np.int64],
    owner: NDArray[np.int64],
    rgb: FloatArray,
    view: View,
) -> list[list[Mark]]:
    pixels = to_fixed_point(view.project(seen))
    clipped = seen[:, 0] < NEAR_M
    offsets = np.cumsum([0, *(len(mesh.points) for mesh in meshes)])
    starts = np.concatenate(
        [mesh.starts[:-1] + offset for mesh, offset in zip(meshes, offsets, strict=False)]
    )
    ends = np.concatenate([mesh.starts[1:] + offset for mesh, offset in zip(meshes, offsets, strict=False)])
    solid = np.concatenate([mesh.solid for mesh in meshes])[shown]
    cut_before = np.concatenate(([0], np.cumsum(clipped)))
    cut = cut_before[ends[shown]] > cut_before[starts[shown]]
    low, high = np.minimum.reduceat(pixels, starts)[shown], np.maximum.reduceat(pixels, starts)[shown]
    size = np.array([view.width_px << SHIFT, view.height_px << SHIFT])
    within = ((high > -_MARGIN) & (low < size + _MARGIN)).all(axis=1)
    # A detail narrower than half a pixel only costs time.
    kept = np.flatnonzero(cut | (within & (solid | ((high - low).min(axis=1) > _HALF_PIXEL))))
    shown = shown[kept]
    marks: list[list[Mark]] = [[] for _ in meshes]
    rows = zip(
        owner[kept].tolist(),
        starts[shown].tolist(),
        ends[shown].tolist(),
        rgb[kept].tolist(),
        solid[kept].tolist(),
        cut[kept].tolist(),
        strict=True,
    )
    for model, first, last, (red, green, blue), counts, near in rows:
        polygon = pixels[first:last]
        if near:
            polygon = view.project_polygon(seen[first:last])
        marks[model].append(Stroke(polygon, (red, green, blue), counts))
    return marks


_CAP_POINTS: Final = 5
_SHADED_FROM_PX: Final = 2.0
_SHRINK_PX: Final = 0.35
"""OpenCV fills half a pixel beyond a polygon's edge, which would make thin strokes too wide."""


def clip_segments_near(seen: FloatArray) -> NDArray[np.bool_]:
    """Clip line segments at the near plane in place and return which of them lie entirely in front of it.

    Args:
        seen: Both ends in camera coordinates, shape ``(n, 2, 3)``.
    """
    depth = seen[..., 0].copy()
    for end, other in ((0, 1), (1, 0)):
        cut = (depth[:, end] < NEAR_M) & (depth[:, other] >= NEAR_M)
        if cut.any():
            part = (NEAR_M - depth[cut, end]) / (depth[cut, other] - depth[cut, end])
            seen[cut, end] += part[:, None] * (seen[cut, other] - seen[cut, end])
    gone: NDArray[np.bool_] = np.asarray((depth < NEAR_M).all(axis=1))
    return gone


def radius_px(seen: FloatArray, radius_m: FloatArray, view: View) -> FloatArray:
    """Return the radii at the ends of limbs in pixels, shape ``(n, 2)``.

    Args:
        seen: Both ends in camera coordinates, shape ``(n, 2, 3)``.
        radius_m: Radii at both ends, shape ``(n, 2)``.
        view: The camera.
    """
    radius: FloatArray = radius_m * view.focal_px / np.maximum(seen[..., 0], NEAR_M)
    return radius


def capsule_polygons(
    seen: FloatArray, radius: FloatArray, view: View, shade_side: FloatArray | float = 1.0
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return limbs as convex polygons, and narrower polygons for the shade on one side.

    Args:
        seen: Both ends in camera coordinates, beyond the near plane, shape ``(n, 2, 3)``.
        radius: Radii at both ends in pixels, shape ``(n, 2)``.
        view: The camera.
        shade_side: Side in the shade: 1 for the right, -1 for the left; one value or shape ``(n,)``.

    Returns:
        Two arrays of shape ``(n, 10, 2)``, in sixteenths of a pixel.
    """
    pixels = view.project(seen.reshape(-1, 3)).reshape(-1, 2, 2)
    along = pixels[:, 1] - pixels[:, 0]
    base = np.arctan2(along[:, 1], along[:, 0])[:, None]
    angles = np.linspace(-np.pi / 2, np.pi / 2, _CAP_POINTS)
    reach = np.maximum(radius - _SHRINK_PX, 0.15)
    points = np.empty((len(seen), 2 * _CAP_POINTS, 2))
    for end, turns, first in ((1, base + angles, 0), (0, base + np.pi + angles, _CAP_POINTS)):
        rows = slice(first, first + _CAP_POINTS)
        points[:, rows, 0] = pixels[:, end, 0, None] + reach[:, end, None] * np.cos(turns)
        points[:, rows, 1] = pixels[:, end, 1, None] + reach[:, end, None] * np.sin(turns)
    shade = points.copy()
    axis = _axis_column(pixels, points)
    shade[..., 0] = axis + (points[..., 0] - axis) * 0.5 + (0.46 * shade_side * reach.mean(axis=1))[:, None]
    return to_fixed_point(points), to_fixed_point(shade)


def draw_limbs(
    joints_m: FloatArray, radii_m: FloatArray, colours: list[Rgb], view: View, *, flat_feet: bool
) -> list[list[Mark]]:
    """Return the strokes of each limb: one in its colour and, on a wide limb, a darker one for its shade.

    Args:
        joints_m: Both ends in the world, shape ``(n, 2, 3)``.
        radii_m: Radii at both ends, shape ``(n, 2)``.
        colours: Colour of each limb.
        view: The camera.
        flat_feet: Whether limbs are cut off flat at their lower end, on the ground.
    """
    if len(joints_m) == 0:
        return []
    seen = view.to_camera(joints_m.reshape(-1, 3)).reshape(-1, 2, 3)
    gone = clip_segments_near(seen).tolist()
    radius = radius_px(seen, radii_m, view)
    polygons, shades = capsule_polygons(seen, radius, view)
    if flat_feet:
        foot = to_fixed_point(view.project(seen[:, 0]))[:, 1, None]
        polygons[..., 1] = np.minimum(polygons[..., 1], foot)
        shades[..., 1] = np.minimum(shades[..., 1], foot)
    wide = (radius.max(axis=1) > _SHADED_FROM_PX).tolist()
    marks: list[list[Mark]] = []
    for index, (red, green, blue) in enumerate(colours):
        strokes: list[Mark] = []
        if not gone[index]:
            strokes.append(Stroke(polygons[index], (red, green, blue), True))
            if wide[index]:
                strokes.append(Stroke(shades[index], (0.72 * red, 0.72 * green, 0.74 * blue), False))
        marks.append(strokes)
    return marks


def _axis_column(pixels: FloatArray, points: FloatArray) -> FloatArray:
    """Return the column of a limb's axis in the row of each polygon point; for a flat limb, the point's column."""
    start, end = pixels[:, 0], pixels[:, 1]
    rise = end[:, 1] - start[:, 1]
    steep = np.abs(rise) > np.abs(end[:, 0] - start[:, 0]) * 0.5
    safe = np.where(steep, rise, 1.0)[:, None]
    part = np.clip((points[..., 1] - start[:, 1, None]) / safe, 0, 1)
    column = start[:, 0, None] + part * (end[:, 0] - start[:, 0])[:, None]
    axis: FloatArray = np.where(steep[:, None], column, points[..., 0])
    return axis
