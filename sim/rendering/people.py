"""Walking people: limbs with rounded ends between joints, painted from far to near.

Joints are shares of the body height: x ahead, y left, z up. The joints of all people in a frame are placed at once.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from brink.sim.rendering.light import Lighting
from brink.sim.rendering.scene import Body, FloatArray, Mark, Stroke, choose, choose_fraction
from brink.sim.rendering.solids import capsule_polygons, clip_segments_near, radius_px
from brink.sim.rendering.view import View

_SKINS: Final = ((236, 196, 168), (214, 164, 128), (172, 120, 84), (116, 76, 52), (224, 180, 150))
_HAIRS: Final = ((34, 26, 22), (78, 54, 36), (150, 112, 62), (120, 116, 112), (52, 38, 30))
_TOPS: Final = (
    (168, 40, 44), (38, 62, 118), (226, 224, 216), (52, 54, 58), (70, 112, 80), (222, 176, 56),
    (116, 70, 122), (92, 134, 168), (142, 104, 76), (206, 110, 60), (30, 32, 36), (176, 178, 176),
)  # fmt: skip
_BOTTOMS: Final = ((42, 54, 84), (32, 33, 38), (92, 84, 74), (70, 78, 96), (122, 112, 96), (58, 62, 60))
_SHOES: Final = ((28, 26, 26), (214, 212, 206), (88, 60, 42))


class _Limb(NamedTuple):
    """Joints, radii across and along the body, colour index, and the minimum body height in px to draw it."""

    start: tuple[float, float, float]
    end: tuple[float, float, float]
    across: tuple[float, float]
    along: tuple[float, float]
    colour: int
    shown_px: float = 0.0


_SKIN, _HAIR, _TOP, _BOTTOM, _SHOE, _EXTRA = range(6)


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
    limbs = [_limbs(body) for body in people]
    counts = [len(own) for own in limbs]
    owner = np.repeat(np.arange(len(people)), counts)
    joints = np.array([(limb.start, limb.end) for own in limbs for limb in own])
    radii = np.array([(*limb.across, *limb.along) for own in limbs for limb in own])
    pose = np.array([(body.x_m, body.y_m, body.yaw_rad, body.height_m) for body in people])
    seen, radius_m = _placed(joints, radii, pose[owner], view)
    gone = clip_segments_near(seen).tolist()
    rgb = _colours(people, limbs, pose, lighting, lit, view)
    ahead = np.hypot(pose[:, 0] - view.x_m, pose[:, 1] - view.y_m)
    tall_px = view.focal_px * pose[:, 3] / np.maximum(ahead, 0.3)
    polygons, shades = capsule_polygons(seen, radius_px(seen, radius_m, view), view)
    middle = seen[:, :, 0].mean(axis=1)
    marks: list[list[Mark]] = []
    first = 0
    shaded = lighting.sun_strength > 0.1
    for index, own in enumerate(limbs):
        last = first + len(own)
        order = np.argsort(-middle[first:last], kind="stable") + first
        strokes: list[Mark] = []
        for limb in order.tolist():
            if gone[limb] or own[limb - first].shown_px > tall_px[index]:
                continue
            strokes.append(Stroke(polygons[limb], rgb[limb], True))
            if tall_px[index] > 46 and shaded:
                dark = rgb[limb][0] * 0.78, rgb[limb][1] * 0.78, rgb[limb][2] * 0.8
                strokes.append(Stroke(shades[limb], dark, False))
        marks.append(strokes)
        first = last
    return marks


def _limbs(body: Body) -> list[_Limb]:
    """Return the limbs of a walking person, as shares of the body height."""
    swing = float(np.sin(body.phase))
    look = body.look
    broad = 0.90 + 0.25 * choose_fraction(look, 11)
    limbs: list[_Limb] = []
    for side, stride in ((1.0, swing), (-1.0, -swing)):
        limbs += _leg(side, stride, broad)
        limbs += _arm(side, -stride, broad, bare=choose(look, 12, 4) == 0)
    chest, waist = 0.092 * broad, 0.074 * broad
    long_top = choose(look, 13, 4) == 0
    limbs.append(_Limb((0, 0, 0.50), (0, 0, 0.56), (0.080 * broad, waist), (0.062, 0.056), _BOTTOM))
    limbs.append(_Limb((0, 0, 0.575), (0.008, 0, 0.765), (waist, chest), (0.056, 0.060), _TOP))
    if long_top:
        limbs.append(_Limb((0, 0, 0.42), (0, 0, 0.58), (0.100 * broad, waist), (0.082, 0.058), _TOP))
    limbs.append(_Limb((0.004, 0, 0.80), (0.014, 0, 0.87), (0.032, 0.030), (0.032, 0.030), _SKIN, 26))
    limbs.append(_Limb((0.022, 0, 0.900), (0.014, 0, 0.938), (0.043, 0.050), (0.045, 0.054), _SKIN))
    limbs.append(_Limb((-0.010, 0, 0.925), (0.000, 0, 0.947), (0.047, 0.053), (0.042, 0.051), _HAIR))
    if choose(look, 14, 5) == 0:
        limbs.append(_Limb((-0.075, 0, 0.60), (-0.075, 0, 0.74), (0.062, 0.058), (0.045, 0.045), _EXTRA, 18))
    return limbs


def _leg(side: float, stride: float, broad: float) -> list[_Limb]:
    angle = 0.46 * stride
    # The rear leg bends its knee and lifts its heel.
    bend = 0.18 + 0.42 * max(-stride, 0.0) if stride < 0 else 0.10 * stride
    hip = (0.0, 0.046 * side * broad, 0.505)
    knee = (hip[0] + 0.245 * np.sin(angle), hip[1], hip[2] - 0.245 * np.cos(angle))
    shin = angle - bend * min(abs(stride) * 3, 1.0)
    ankle = (knee[0] + 0.225 * np.sin(shin), knee[1], max(knee[2] - 0.225 * np.cos(shin), 0.035))
    toe = (ankle[0] + 0.075, ankle[1] + 0.012 * side, max(ankle[2] - 0.022, 0.019))
    return [
        _Limb(hip, knee, (0.052 * broad, 0.040), (0.054, 0.042), _BOTTOM),
        _Limb(knee, ankle, (0.040, 0.026), (0.042, 0.028), _BOTTOM),
        _Limb(
            (ankle[0] - 0.012, ankle[1], max(ankle[2] - 0.014, 0.019)),
            toe,
            (0.022, 0.019),
            (0.022, 0.019),
            _SHOE,
            20,
        ),
    ]


def _arm(side: float, stride: float, broad: float, *, bare: bool) -> list[_Limb]:
    angle = 0.50 * stride
    shoulder = (0.0, 0.112 * side * broad, 0.795)
    elbow = (0.165 * np.sin(angle), shoulder[1] + 0.016 * side, shoulder[2] - 0.165 * np.cos(angle))
    bend = angle + 0.28 + 0.15 * max(stride, 0.0)
    hand = (elbow[0] + 0.145 * np.sin(bend), elbow[1], elbow[2] - 0.145 * np.cos(bend))
    tip = (hand[0] + 0.03 * np.sin(bend), hand[1], hand[2] - 0.03 * np.cos(bend))
    return [
        _Limb(shoulder, elbow, (0.035, 0.028), (0.037, 0.029), _TOP, 12),
        _Limb(elbow, hand, (0.027, 0.020), (0.028, 0.021), _SKIN if bare else _TOP, 12),
        _Limb(hand, tip, (0.020, 0.017), (0.020, 0.017), _SKIN, 26),
    ]


def _placed(
    joints: FloatArray, radii: FloatArray, pose: FloatArray, view: View
) -> tuple[FloatArray, FloatArray]:
    """Return joints in camera coordinates, shape ``(n, 2, 3)``, and their radii in m, shape ``(n, 2)``."""
    cosine, sine = np.cos(pose[:, 2])[:, None], np.sin(pose[:, 2])[:, None]
    scaled = joints * pose[:, 3][:, None, None]
    world = np.empty_like(scaled)
    world[..., 0] = pose[:, 0][:, None] + cosine * scaled[..., 0] - sine * scaled[..., 1]
    world[..., 1] = pose[:, 1][:, None] + sine * scaled[..., 0] + cosine * scaled[..., 1]
    world[..., 2] = scaled[..., 2]
    seen = view.to_camera(world.reshape(-1, 3)).reshape(-1, 2, 3)
    sight = np.arctan2(pose[:, 1] - view.y_m, pose[:, 0] - view.x_m) - pose[:, 2]
    facing, profile = np.cos(sight)[:, None] ** 2, np.sin(sight)[:, None] ** 2
    radius_m = np.sqrt(facing * radii[:, :2] ** 2 + profile * radii[:, 2:] ** 2) * pose[:, 3][:, None]
    return seen, radius_m


def _colours(
    people: Sequence[Body],
    limbs: list[list[_Limb]],
    pose: FloatArray,
    lighting: Lighting,
    lit: FloatArray,
    view: View,
) -> list[tuple[float, float, float]]:
    ahead = np.hypot(pose[:, 0] - view.x_m, pose[:, 1] - view.y_m)
    haze = lighting.haze(ahead)
    veil = np.array(lighting.haze_rgb)
    colours: list[tuple[float, float, float]] = []
    for index, body in enumerate(people):
        light = lighting.ambient_strength + 0.55 * lighting.sun_strength + 0.85 * float(lit[index])
        shades = np.array(_palette(body.look)) * (light * lighting.tint)
        mixed = np.clip(shades * (1 - haze[index]) + veil * haze[index], 0, 255).tolist()
        colours += [tuple(mixed[limb.colour]) for limb in limbs[index]]
    return colours


@lru_cache(maxsize=1024)
def _palette(look: int) -> tuple[tuple[int, int, int], ...]:
    """Return the colours of skin, hair, top, bottom, shoes and bag."""
    return (
        _SKINS[choose(look, 21, len(_SKINS))],
        _HAIRS[choose(look, 22, len(_HAIRS))],
        _TOPS[choose(look, 23, len(_TOPS))],
        _BOTTOMS[choose(look, 24, len(_BOTTOMS))],
        _SHOES[choose(look, 25, len(_SHOES))],
        _TOPS[choose(look, 26, len(_TOPS))],
    )
