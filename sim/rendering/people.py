"""Walking people: torso, head and clothes as stacks of rings, arms and legs as limbs with rounded ends.

Lengths are shares of the body height: x ahead, y left, z up. All parts of all people in a frame are placed at once.
What a person wears and carries depends only on `look`; children, told by their height, have larger heads.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from brink.sim.rendering.light import Lighting
from brink.sim.rendering.scene import Body, FloatArray, IntArray, Mark, Rgb, Stroke, choose, choose_fraction
from brink.sim.rendering.solids import capsule_polygons, clip_segments_near, radius_px
from brink.sim.rendering.view import NEAR_M, View, to_fixed_point

_SKINS: Final = (
    (236, 196, 168),
    (214, 164, 128),
    (172, 120, 84),
    (116, 76, 52),
    (224, 180, 150),
    (88, 58, 42),
)
_HAIRS: Final = ((30, 24, 21), (70, 48, 34), (142, 106, 62), (128, 124, 120), (48, 34, 27), (186, 150, 96))
_TOPS: Final = (
    (158, 40, 44), (38, 58, 108), (222, 220, 212), (52, 54, 58), (66, 100, 74), (206, 164, 60),
    (108, 68, 114), (88, 124, 156), (134, 100, 76), (192, 104, 62), (30, 32, 36), (168, 170, 168),
    (44, 92, 96), (196, 132, 140), (84, 40, 48), (98, 102, 66),
)  # fmt: skip
_BOTTOMS: Final = (
    (42, 54, 84), (32, 33, 38), (92, 84, 74), (70, 78, 96), (122, 112, 96), (58, 62, 60), (96, 112, 138),
    (66, 50, 44),
)  # fmt: skip
_SHOES: Final = ((28, 26, 26), (214, 212, 206), (88, 60, 42), (54, 56, 66), (150, 60, 54))
_VEST: Final = (214, 226, 62)
_REFLECTOR: Final = (226, 228, 224)

_SKIN, _HAIR, _TOP, _BOTTOM, _SHOE, _EXTRA, _INNER, _HAT, _DARK, _SHINE = range(10)
_LEGS, _BODY, _HEAD = range(3)
"""Groups of parts in painting order; within a group, far parts are painted first."""

_RINGS: Final = 8
_SHRINK_PX: Final = 0.4
"""OpenCV fills half a pixel beyond a polygon's edge."""
_FEW_PX: Final = 22.0
"""Smaller people have neither shaded sides nor details."""
_FULL_PX: Final = 56.0
"""Larger people also have shaded limbs."""


class _Limb(NamedTuple):
    """Joints, radii across and along the body at both ends, and how it is painted."""

    start: tuple[float, float, float]
    end: tuple[float, float, float]
    across: tuple[float, float]
    along: tuple[float, float]
    colour: int
    group: int
    shown_px: float = 0.0


class _Stack(NamedTuple):
    """Rings (x, z, radius across, radius along) from top to bottom, or the band of their visible side from k0 to k1.

    `nearer` moves a part in front of others in the painting order, in shares of the body height.
    """

    rings: tuple[tuple[float, float, float, float], ...]
    colour: int
    group: int
    shown_px: float = 0.0
    shaded: bool = True
    band: tuple[float, float] = (-1.0, 1.0)
    y: float = 0.0
    nearer: float = 0.0


def draw_people(people: Sequence[Body], view: View, lighting: Lighting, lit: FloatArray) -> list[list[Mark]]:
    """Return the strokes of each person, in painting order.

    Args:
        people: Bodies of kind `PERSON`.
        view: The camera.
        lighting: The light.
        lit: Artificial light on each person, in [0, 1], shape ``(n,)``.
    """
    if not people:
        return []
    pose = np.array([(body.x_m, body.y_m, body.yaw_rad, body.height_m) for body in people])
    dx, dy = view.x_m - pose[:, 0], view.y_m - pose[:, 1]
    tall_px = (view.focal_px * pose[:, 3] / np.maximum(np.hypot(dx, dy), 0.3)).tolist()
    outfits = [_outfit(body.look, round(body.height_m, 1)) for body in people]
    limbs: list[_Limb] = []
    stacks: list[_Stack] = []
    of_limbs: list[int] = []
    of_stacks: list[int] = []
    for index, (body, outfit) in enumerate(zip(people, outfits, strict=True)):
        own = [limb for limb in _limbs(outfit, body.phase) if limb.shown_px <= tall_px[index]]
        limbs += own
        of_limbs += [index] * len(own)
        parts = [stack for stack in outfit.stacks if stack.shown_px <= tall_px[index]]
        stacks += parts
        of_stacks += [index] * len(parts)
    paint = _Paint(people, outfits, pose, view, lighting, lit)
    found: list[list[tuple[float, list[Mark]]]] = [[] for _ in people]
    _add_limbs(found, limbs, np.array(of_limbs), tall_px, paint)
    _add_stacks(found, stacks, np.array(of_stacks), tall_px, paint)
    for parts_of_one in found:
        parts_of_one.sort(key=lambda part: part[0])
    return [[mark for _, marks in one for mark in marks] for one in found]


class _Paint:
    """The light on each person, and the direction from which the camera sees them."""

    def __init__(
        self,
        people: Sequence[Body],
        outfits: Sequence["_Outfit"],
        pose: FloatArray,
        view: View,
        lighting: Lighting,
        lit: FloatArray,
    ) -> None:
        self.view, self.pose = view, pose
        dx, dy = view.x_m - pose[:, 0], view.y_m - pose[:, 1]
        far = np.maximum(np.hypot(dx, dy), 1e-6)
        self.facing = np.arctan2(dy, dx) - pose[:, 2]
        level = max(float(np.hypot(*lighting.sun[:2])), 1e-6)
        towards = (dx * lighting.sun[0] + dy * lighting.sun[1]) / (far * level)
        # The sun's share to the right of the line of sight; the other side of a body is in the shade.
        self.sun_right = (dx * lighting.sun[1] - dy * lighting.sun[0]) / (far * level)
        sun = lighting.sun_strength
        self.light = lighting.ambient_strength + sun * (0.52 + 0.33 * towards)
        self.lit = 0.85 * lit
        haze = lighting.haze(far)
        self.clear, self.veil = (1 - haze), haze[:, None] * np.array(lighting.haze_rgb)
        self.palette = np.array([outfit.palette for outfit in outfits], dtype=np.float64) * lighting.tint
        self.dark = 1.0 - (0.14 + 0.40 * min(sun / max(sun + lighting.ambient_strength, 1e-6), 0.6))
        self.sunny = sun > 0.3

    def colours(self, owner: IntArray, colour: IntArray, z: FloatArray) -> FloatArray:
        """Return the colours of parts whose middle is at height z, shape ``(n, 3)``."""
        # The sky lights what is high, headlights what is low.
        share = self.light[owner] * (0.86 + 0.17 * z) + self.lit[owner] * (1.2 - 0.45 * z)
        own = self.palette[owner, colour] * (share * self.clear[owner])[:, None]
        result: FloatArray = own + self.veil[owner]
        return result

    def nearness(self, owner: IntArray, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return how far parts are moved towards the camera, as fractions of the body height."""
        near: FloatArray = x * np.cos(self.facing[owner]) + y * np.sin(self.facing[owner])
        return near


def _add_limbs(
    found: list[list[tuple[float, list[Mark]]]],
    limbs: list[_Limb],
    owner: IntArray,
    tall_px: list[float],
    paint: _Paint,
) -> None:
    joints = np.array([(limb.start, limb.end) for limb in limbs])
    radii = np.array([(*limb.across, *limb.along) for limb in limbs])
    pose = paint.pose[owner]
    seen = _placed(joints, pose, paint.view)
    radius_m = _apparent(radii[:, :2], radii[:, 2:], paint.facing[owner]) * pose[:, 3][:, None]
    gone = clip_segments_near(seen).tolist()
    side = np.where(paint.sun_right[owner] > 0, -1.0, 1.0)
    radius = radius_px(seen, radius_m, paint.view)
    polygons, shades = capsule_polygons(seen, radius, paint.view, shade_side=side)
    middle = joints.mean(axis=1)
    base = np.clip(paint.colours(owner, np.array([limb.colour for limb in limbs]), middle[:, 2]), 0, 255)
    shade = (base * paint.dark).tolist()
    order = paint.nearness(owner, middle[:, 0], middle[:, 1]).tolist()
    rgb = base.tolist()
    for row, (index, limb) in enumerate(zip(owner.tolist(), limbs, strict=True)):
        if gone[row]:
            continue
        marks: list[Mark] = [Stroke(polygons[row], tuple(rgb[row]), True)]
        if tall_px[index] > _FULL_PX:
            marks.append(Stroke(shades[row], tuple(shade[row]), False))
        found[index].append((10.0 * limb.group + order[row], marks))


def _add_stacks(
    found: list[list[tuple[float, list[Mark]]]],
    stacks: list[_Stack],
    owner: IntArray,
    tall_px: list[float],
    paint: _Paint,
) -> None:
    count = len(stacks)
    rings = np.array([stack.rings for stack in stacks])
    y = np.array([stack.y for stack in stacks])
    points = np.empty((count, _RINGS, 3))
    points[..., 0], points[..., 1], points[..., 2] = rings[..., 0], y[:, None], rings[..., 1]
    pose = paint.pose[owner]
    seen = _placed(points, pose, paint.view)
    gone: list[bool] = np.any(seen[..., 0] < NEAR_M, axis=1).tolist()
    wide_m = _apparent(rings[..., 2], rings[..., 3], paint.facing[owner]) * pose[:, 3][:, None]
    wide = np.maximum(wide_m * paint.view.focal_px / np.maximum(seen[..., 0], NEAR_M) - _SHRINK_PX, 0.2)
    pixels = paint.view.project(seen.reshape(-1, 3)).reshape(count, _RINGS, 2)
    top, bottom = pixels[:, :1, 1] + _SHRINK_PX, pixels[:, -1:, 1] - _SHRINK_PX
    pixels[..., 1] = np.minimum(np.maximum(pixels[..., 1], top), np.maximum(bottom, top))
    bands = np.array([stack.band for stack in stacks])
    polygons = _between(pixels, wide, bands[:, 0], bands[:, 1])
    right = np.where(paint.sun_right[owner] > 0, -1.0, 1.0)
    edge = np.clip(0.55 - 0.5 * np.abs(paint.sun_right[owner]), 0.1, 0.6)
    shades = _between(pixels, wide, right * edge, right * 0.97)
    lights = _between(pixels, wide, -right * 0.82, -right * 0.45)
    z = rings[..., 1].mean(axis=1)
    base = paint.colours(owner, np.array([stack.colour for stack in stacks]), z)
    dark = (np.clip(base, 0, 255) * paint.dark).tolist()
    bright = np.clip(base * 1.13, 0, 255).tolist()
    rgb = np.clip(base, 0, 255).tolist()
    order = paint.nearness(owner, rings[..., 0].mean(axis=1), y).tolist()
    for row, (index, stack) in enumerate(zip(owner.tolist(), stacks, strict=True)):
        if gone[row]:
            continue
        marks: list[Mark] = [Stroke(polygons[row], tuple(rgb[row]), stack.band == (-1.0, 1.0))]
        if stack.shaded and tall_px[index] > _FEW_PX:
            if paint.sunny and tall_px[index] > _FULL_PX:
                marks.append(Stroke(lights[row], tuple(bright[row]), False))
            marks.append(Stroke(shades[row], tuple(dark[row]), False))
        found[index].append((10.0 * stack.group + order[row] + stack.nearer, marks))


def _between(pixels: FloatArray, wide: FloatArray, first: FloatArray, last: FloatArray) -> IntArray:
    """Return the part of stacks between two fractions of their half width, shape ``(n, 2 * rings, 2)``."""
    points = np.concatenate((pixels, pixels[:, ::-1]), axis=1)
    points[:, :_RINGS, 0] += first[:, None] * wide
    points[:, _RINGS:, 0] += last[:, None] * wide[:, ::-1]
    return to_fixed_point(points)


def _apparent(across: FloatArray, along: FloatArray, facing: FloatArray) -> FloatArray:
    """Return the apparent radii of ellipses as seen from the camera."""
    front, profile = np.cos(facing)[:, None] ** 2, np.sin(facing)[:, None] ** 2
    radius: FloatArray = np.sqrt(front * across**2 + profile * along**2)
    return radius


def _placed(points: FloatArray, pose: FloatArray, view: View) -> FloatArray:
    """Return points of people, shape ``(n, k, 3)``, in camera coordinates."""
    cosine, sine = np.cos(pose[:, 2])[:, None], np.sin(pose[:, 2])[:, None]
    scaled = points * pose[:, 3][:, None, None]
    world = np.empty_like(scaled)
    world[..., 0] = pose[:, 0][:, None] + cosine * scaled[..., 0] - sine * scaled[..., 1]
    world[..., 1] = pose[:, 1][:, None] + sine * scaled[..., 0] + cosine * scaled[..., 1]
    world[..., 2] = scaled[..., 2]
    return view.to_camera(world.reshape(-1, 3)).reshape(points.shape)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Outfit:
    """What a person wears and carries.

    Attributes:
        palette: Colours by index.
        broad: Width of the body, 1 on average.
        sleeve: Colour index of the forearms.
        shin: Colour index of the lower legs.
        trouser: Width of the trousers, 1 on average.
        stride: Length of the stride, 1 on average.
        bag: Side on which a bag hangs from a hand, 0 for none.
        stacks: All parts that do not move with the walk.
    """

    palette: tuple[Rgb, ...]
    broad: float
    sleeve: int
    shin: int
    trouser: float
    stride: float
    bag: float
    stacks: tuple[_Stack, ...]


@lru_cache(maxsize=2048)
def _outfit(look: int, height_m: float) -> _Outfit:
    """Return the outfit of a person; height_m is rounded, since it only distinguishes children."""
    child = min(max((1.55 - height_m) / 0.5, 0.0), 1.0)
    broad = 0.90 + 0.26 * choose_fraction(look, 11) + 0.06 * child
    style = choose(look, 13, 16)
    coat, skirt, shorts, vest = style < 2, 2 <= style < 5, 5 <= style < 7, style == 7
    stacks = [*_torso(look, broad, coat=coat, vest=vest), *_head(look, child)]
    if coat or skirt:
        stacks += _skirt(look, broad, coat=coat)
    if choose(look, 14, 4) == 0:
        stacks += _backpack(look, child)
    bare = choose(look, 12, 4) == 0 and not coat
    bare_legs = shorts or (skirt and choose(look, 16, 2) == 0)
    return _Outfit(
        palette=_palette(look, vest=vest),
        broad=broad,
        sleeve=_SKIN if bare else _TOP,
        shin=_SKIN if bare_legs else _BOTTOM,
        trouser=0.92 + 0.24 * choose_fraction(look, 15),
        stride=0.75 if skirt or coat else 1.0,
        bag=(1.0, -1.0, 0.0, 0.0, 0.0, 0.0)[choose(look, 17, 6)],
        stacks=tuple(stacks),
    )


def _rings(*shape: tuple[float, float, float, float]) -> tuple[tuple[float, float, float, float], ...]:
    """Return rings filled up to their fixed number with the last one."""
    return (*shape, *[shape[-1]] * (_RINGS - len(shape)))


def _torso(look: int, broad: float, *, coat: bool, vest: bool) -> list[_Stack]:
    belly = 0.016 * choose_fraction(look, 18) ** 2 + (0.006 if coat else 0.0)
    shoulder = (0.098 + 0.016 * choose_fraction(look, 19)) * broad
    waist, hip = 0.074 * broad + belly, (0.082 + 0.010 * choose_fraction(look, 20)) * broad
    chest = _rings(
        (0.006, 0.852, 0.030, 0.030), (0.004, 0.832, 0.062, 0.040), (0.002, 0.812, shoulder, 0.050),
        (0.006, 0.765, shoulder + 0.003, 0.062), (0.010, 0.70, 0.094 * broad, 0.066 + 0.3 * belly),
        (0.006, 0.61, waist, 0.056 + belly), (0.002, 0.53, hip, 0.062 + 0.5 * belly), (0.0, 0.497, 0.90 * hip, 0.058),
    )  # fmt: skip
    seat = _rings((0.0, 0.53, 0.98 * hip, 0.060), (-0.004, 0.49, hip, 0.064), (0.0, 0.455, 0.8 * hip, 0.056))
    stacks = [_Stack(seat, _BOTTOM, _LEGS, nearer=0.5), _Stack(chest, _TOP, _BODY)]
    pattern = 9 if vest else choose(look, 27, 7)

    def strip(high: float, low: float, colour: int, shown_px: float) -> None:
        levels = np.linspace(high, low, 4).tolist()
        z = [ring[1] for ring in chest][::-1]
        sides = [[ring[part] for ring in chest][::-1] for part in (0, 2, 3)]
        rings = [tuple(float(np.interp(level, z, side)) for side in sides) for level in levels]
        shape = [(x, level, a, b) for (x, a, b), level in zip(rings, levels, strict=True)]
        band = (-0.97, 0.97)
        stacks.append(_Stack(_rings(*shape), colour, _BODY, shown_px, True, band, nearer=0.004))

    if pattern == 0:
        for high in (0.78, 0.71, 0.64, 0.57):
            strip(high, high - 0.03, _INNER, 40)
    elif pattern == 1:
        strip(0.80, 0.71, _INNER, 24)
    elif pattern == 2:
        strip(0.60, 0.50, _INNER, 30)
    elif pattern == 9:
        strip(0.72, 0.69, _SHINE, 20)
        strip(0.61, 0.58, _SHINE, 20)
    if pattern in (3, 4) or coat:
        # An open jacket: a stripe of the shirt, in front only, so it is hidden by the back when that is nearer.
        front = _rings(
            (0.050, 0.84, 0.018, 0.006), (0.056, 0.79, 0.030, 0.006), (0.066, 0.70, 0.024, 0.006),
            (0.058 + belly, 0.60, 0.022, 0.006), (0.056, 0.52, 0.024, 0.006),
        )  # fmt: skip
        stacks.append(_Stack(front, _INNER, _BODY, 34, False, (-1.0, 0.999)))
    return stacks


def _head(look: int, child: float) -> list[_Stack]:
    """Return neck, hair, face and, on some, a cap, a hood or long hair."""
    tall, wide = 0.066 * (1 + 0.25 * child), 0.0435 * (1 + 0.28 * child)
    middle = 1.0 - tall
    kind = choose(look, 28, 8)
    neck = _rings((0.006, middle - 0.3 * tall, 0.030, 0.032), (0.003, 0.825, 0.033, 0.034))
    skull = _ball(-0.002, middle, tall, wide, 1.2 * wide, 0.86)
    face = _ball(0.014, middle - 0.18 * tall, 0.80 * tall, 0.90 * wide, 1.0 * wide, 0.82)
    crown = _HAIR if kind != 7 else _SKIN
    stacks = [
        _Stack(neck, _SKIN, _HEAD, 16, nearer=-0.5),
        _Stack(skull, crown, _HEAD),
        _Stack(face, _SKIN, _HEAD, 12, nearer=0.004),
        *_headwear(kind, tall, wide),
    ]
    for side in (1.0, -1.0):
        eye = _ball(0.014 + 0.80 * wide, middle - 0.02 * tall, 0.07 * tall, 0.13 * wide, 0.10 * wide)
        stacks.append(_Stack(eye, _DARK, _HEAD, 110, False, (-1.0, 0.999), side * 0.42 * wide, 0.0))
    mouth = _ball(0.014 + 0.80 * wide, middle - 0.58 * tall, 0.05 * tall, 0.3 * wide, 0.1 * wide)
    stacks.append(_Stack(mouth, _DARK, _HEAD, 150, False, (-1.0, 0.999)))
    return stacks


def _headwear(kind: int, tall: float, wide: float) -> list[_Stack]:
    """Return long hair (kinds 0 and 1), a cap (2, with a brim, and 3), a hood (4) or nothing."""
    top, middle = 1.0, 1.0 - tall
    if kind in (0, 1):
        long = _rings(
            (-0.008, middle + 0.4 * tall, 0.96 * wide, 0.9 * wide),
            (-0.016, middle - 0.3 * tall, 1.12 * wide, 0.9 * wide),
            (-0.022, 0.86, 1.1 * wide, 0.8 * wide), (-0.026, 0.80 - 0.05 * kind, 0.8 * wide, 0.6 * wide),
        )  # fmt: skip
        return [_Stack(long, _HAIR, _HEAD, 18, nearer=0.002)]
    if kind in (2, 3):
        low = top - 0.78 * tall
        cap = _rings(
            (-0.002, top, 0.5 * wide, 0.5 * wide), (-0.002, top - 0.16 * tall, 0.86 * wide, 1.04 * wide),
            (0.0, top - 0.45 * tall, 1.04 * wide, 1.26 * wide), (0.0, low, 1.05 * wide, 1.26 * wide),
        )  # fmt: skip
        brim = _rings(
            (0.040, low + 0.006, 0.9 * wide, 0.9 * wide), (0.052, low - 0.012, 0.8 * wide, 0.8 * wide)
        )
        stacks = [_Stack(cap, _HAT, _HEAD, 14, nearer=0.03)]
        return stacks if kind == 3 else [*stacks, _Stack(brim, _HAT, _HEAD, 40, nearer=0.031)]
    if kind == 4:
        hood = _ball(-0.010, middle - 0.02 * tall, 1.0 * tall, 1.22 * wide, 1.32 * wide)
        return [_Stack(hood, _TOP, _HEAD, 14, nearer=0.001)]
    return []


def _ball(
    x: float, z: float, high: float, across: float, along: float, jaw: float = 1.0
) -> tuple[tuple[float, float, float, float], ...]:
    rings = []
    for turn in np.linspace(0.12, math.pi - 0.12, _RINGS).tolist():
        narrow = math.sin(turn) * (1.0 if math.cos(turn) > -0.2 else jaw)
        rings.append((x, z + high * math.cos(turn) / math.cos(0.12), across * narrow, along * narrow))
    return tuple(rings)


def _skirt(look: int, broad: float, *, coat: bool) -> list[_Stack]:
    hem = (0.30 if coat else 0.27) + 0.12 * choose_fraction(look, 29)
    flare = (0.088 if coat else 0.098 + 0.03 * choose_fraction(look, 30)) * broad
    rings = _rings(
        (0.0, 0.60, 0.078 * broad, 0.060), (0.0, 0.54, 0.090 * broad, 0.068), (0.0, 0.46, 0.096 * broad, 0.080),
        (0.0, hem, flare, 0.096),
    )  # fmt: skip
    return [_Stack(rings, _TOP if coat else _BOTTOM, _LEGS, nearer=0.6)]


def _backpack(look: int, child: float) -> list[_Stack]:
    wide = 0.066 + 0.014 * choose_fraction(look, 35) + 0.012 * child
    pack = _rings(
        (-0.085, 0.815, 0.6 * wide, 0.026), (-0.092, 0.79, wide, 0.040), (-0.098, 0.70, wide, 0.048),
        (-0.096, 0.60, wide, 0.044), (-0.090, 0.575, 0.85 * wide, 0.034),
    )  # fmt: skip
    pocket = _rings((-0.130, 0.68, 0.7 * wide, 0.014), (-0.130, 0.60, 0.7 * wide, 0.014))
    stacks = [_Stack(pack, _EXTRA, _BODY, 14), _Stack(pocket, _DARK, _BODY, 70, False, (-1.0, 0.999))]
    for side in (1.0, -1.0):
        strap = _rings((0.045, 0.83, 0.011, 0.01), (0.064, 0.74, 0.010, 0.006), (0.056, 0.66, 0.010, 0.006))
        stacks.append(_Stack(strap, _EXTRA, _BODY, 60, False, (-1.0, 0.999), side * 0.058))
    return stacks


def shadow_outline(body: Body) -> FloatArray:
    """Return the outline on the ground of the upright shape that casts a person's shadow, shape ``(8, 2)``."""
    turn = np.linspace(0.0, 2.0 * math.pi, 8, endpoint=False)
    along, across = 0.085 * body.height_m * np.cos(turn), 0.115 * body.height_m * np.sin(turn)
    cosine, sine = math.cos(body.yaw_rad), math.sin(body.yaw_rad)
    return np.stack((body.x_m + cosine * along - sine * across, body.y_m + sine * along + cosine * across), 1)


def _limbs(outfit: _Outfit, phase: float) -> list[_Limb]:
    """Return arms and legs at a phase of the walk."""
    swing = math.sin(phase) * outfit.stride
    limbs: list[_Limb] = []
    for side, stride in ((1.0, swing), (-1.0, -swing)):
        limbs += _leg(side, stride, outfit)
        limbs += _arm(side, -stride, outfit)
    return limbs


def _leg(side: float, stride: float, outfit: _Outfit) -> list[_Limb]:
    angle = 0.46 * stride
    # The rear leg bends its knee and lifts its heel.
    bend = 0.18 + 0.42 * max(-stride, 0.0) if stride < 0 else 0.10 * stride
    hip = (0.0, 0.043 * side * outfit.broad, 0.500)
    knee = (hip[0] + 0.240 * math.sin(angle), hip[1], hip[2] - 0.240 * math.cos(angle))
    shin = angle - bend * min(abs(stride) * 3, 1.0)
    ankle = (knee[0] + 0.222 * math.sin(shin), knee[1], max(knee[2] - 0.222 * math.cos(shin), 0.035))
    toe = (ankle[0] + 0.075, ankle[1] + 0.012 * side, max(ankle[2] - 0.022, 0.019))
    heel = (ankle[0] - 0.012, ankle[1], max(ankle[2] - 0.014, 0.019))
    wide = outfit.trouser if outfit.shin == _BOTTOM else 0.9
    return [
        _Limb(hip, knee, (0.047 * outfit.broad, 0.038 * wide), (0.054, 0.040 * wide), _BOTTOM, _LEGS),
        _Limb(knee, ankle, (0.036 * wide, 0.026 * wide), (0.040 * wide, 0.029 * wide), outfit.shin, _LEGS),
        _Limb(heel, toe, (0.022, 0.019), (0.022, 0.019), _SHOE, _LEGS, 18),
    ]


def _arm(side: float, stride: float, outfit: _Outfit) -> list[_Limb]:
    angle = 0.50 * stride
    shoulder = (0.0, 0.103 * side * outfit.broad, 0.795)
    elbow = (0.165 * math.sin(angle), shoulder[1] + 0.020 * side, shoulder[2] - 0.165 * math.cos(angle))
    bend = angle + 0.28 + 0.15 * max(stride, 0.0)
    hand = (elbow[0] + 0.140 * math.sin(bend), elbow[1] + 0.004 * side, elbow[2] - 0.140 * math.cos(bend))
    tip = (hand[0] + 0.03 * math.sin(bend), hand[1], hand[2] - 0.03 * math.cos(bend))
    limbs = [
        _Limb(shoulder, elbow, (0.033, 0.028), (0.035, 0.029), _TOP, _BODY),
        _Limb(elbow, hand, (0.026, 0.020), (0.027, 0.021), outfit.sleeve, _BODY),
        _Limb(hand, tip, (0.018, 0.016), (0.020, 0.017), _SKIN, _BODY, 26),
    ]
    if side == outfit.bag:
        low = (tip[0], tip[1] + 0.01 * side, tip[2] - 0.15)
        limbs.append(
            _Limb((low[0], low[1], tip[2] - 0.06), low, (0.034, 0.040), (0.062, 0.072), _EXTRA, _BODY, 14)
        )
    return limbs


@lru_cache(maxsize=2048)
def _palette(look: int, *, vest: bool) -> tuple[Rgb, ...]:
    """Return the colours of a person by index."""

    def worn(colours: Sequence[Rgb], question: int) -> Rgb:
        red, green, blue = colours[choose(look, question, len(colours))]
        shade = 0.78 + 0.36 * choose_fraction(look, question + 100)
        return red * shade, green * shade, blue * shade

    skin, hair = _SKINS[choose(look, 21, len(_SKINS))], _HAIRS[choose(look, 22, len(_HAIRS))]
    top, bottom, shoe = worn(_TOPS, 23), worn(_BOTTOMS, 24), worn(_SHOES, 25)
    extra, inner, hat = worn(_TOPS, 26), worn(_TOPS, 36), worn(_TOPS, 37)
    return (skin, hair, _VEST if vest else top, bottom, shoe, extra, inner, hat, (44, 34, 32), _REFLECTOR)
