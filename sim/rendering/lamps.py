"""Street lamps, vehicle lights, and the halos around them and around traffic lights."""

import math
from collections.abc import Mapping, Sequence
from typing import Final

import cv2
import numpy as np

from brink.sim.driving.interface import LightState
from brink.sim.rendering.canvas import Canvas
from brink.sim.rendering.light import Lighting
from brink.sim.rendering.order import Thing
from brink.sim.rendering.scene import (
    Body,
    BodyKind,
    FloatArray,
    Lamp,
    Mark,
    Picture,
    Rgb,
    SignalGroup,
    Stroke,
    TrafficLight,
)
from brink.sim.rendering.signals import lit_lamp
from brink.sim.rendering.solids import draw_limbs
from brink.sim.rendering.view import NEAR_M, View, to_fixed_point

_ARM_M: Final = 1.6
_POST: Final = (92.0, 96.0, 98.0)
_LAMP_LIGHT: Final = (230.0, 190.0, 120.0)
_HEADLIGHT: Final = (220.0, 214.0, 196.0)
_TAIL_LIGHT: Final = (120.0, 12.0, 10.0)
_BRAKE_LIGHT: Final = (200.0, 30.0, 20.0)
_HEADLIGHT_M, _TAIL_LIGHT_M, _BRAKE_LIGHT_M, _LAMP_LIGHT_M, _TRAFFIC_LIGHT_M = 0.75, 0.4, 0.6, 1.5, 0.5
"""Reach of the halos."""
_TRAFFIC_LIGHT_STRENGTH: Final = 0.7


def lamp_head_position(lamp: Lamp) -> tuple[float, float]:
    """Return the position of a lamp's head."""
    return lamp.x_m + _ARM_M * float(np.cos(lamp.yaw_rad)), lamp.y_m + _ARM_M * float(np.sin(lamp.yaw_rad))


def vehicle_light_positions(body: Body) -> list[tuple[tuple[float, float, float], float]]:
    """Return the world positions of a vehicle's four lights, each followed by 1.0 for front or -1.0 for rear."""
    cosine, sine = math.cos(body.yaw_rad), math.sin(body.yaw_rad)
    up = min(0.46 * body.height_m, 0.8)
    places = []
    for end, side in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
        along, across = end * body.length_m / 2, side * 0.36 * body.width_m
        x_m, y_m = body.x_m + along * cosine - across * sine, body.y_m + along * sine + across * cosine
        places.append(((x_m, y_m, up), end))
    return places


def draw_lamps(
    lamps: Sequence[Lamp], lighting: Lighting, view: View, lit: FloatArray, *, burning: bool
) -> list[list[Mark]]:
    """Return the marks of each lamp's post, arm and head, in painting order.

    Args:
        lamps: The lamps.
        lighting: The light.
        view: The camera.
        lit: Artificial light on each lamp, in [0, 1], shape ``(n,)``.
        burning: Whether the lamps are on.
    """
    if not lamps:
        return []
    joints = np.array([limb for lamp in lamps for limb in _limbs(lamp)])
    radii = np.array([(0.085, 0.055), (0.05, 0.04)] * len(lamps))
    steel = np.array([_POST] * len(joints))
    colours = lighting.shade(steel, joints[:, 0], view, np.repeat(lit, 2))
    limbs = draw_limbs(joints, radii, colours, view, flat_feet=False)
    rgb = (255.0, 232.0, 184.0) if burning else (150.0, 152.0, 154.0)
    seen = view.to_camera(np.array([corner for lamp in lamps for corner in _head(lamp)]))
    heads = to_fixed_point(view.project(seen)).reshape(-1, 4, 2)
    before: list[bool] = np.all(seen[:, 0].reshape(-1, 4) > NEAR_M, axis=1).tolist()
    marks: list[list[Mark]] = []
    for number, head in enumerate(heads):
        strokes = [*limbs[2 * number], *limbs[2 * number + 1]]
        marks.append([*strokes, Stroke(head, rgb, True)] if before[number] else strokes)
    return marks


def _limbs(lamp: Lamp) -> list[list[tuple[float, float, float]]]:
    x_m, y_m = lamp_head_position(lamp)
    top = (lamp.x_m, lamp.y_m, lamp.height_m)
    return [[(lamp.x_m, lamp.y_m, 0.0), top], [top, (x_m, y_m, lamp.height_m + 0.1)]]


def _head(lamp: Lamp) -> list[tuple[float, float, float]]:
    x_m, y_m = lamp_head_position(lamp)
    cosine, sine = math.cos(lamp.yaw_rad), math.sin(lamp.yaw_rad)
    corners = ((-0.15, -0.16), (0.45, -0.16), (0.45, 0.16), (-0.15, 0.16))
    return [
        (x_m + a * cosine - b * sine, y_m + a * sine + b * cosine, lamp.height_m + 0.04) for a, b in corners
    ]


class Halos:
    """Adds halos around visible lights.

    Args:
        night: Whether it is dark; by day, halos are faint and street lamps are off.
    """

    def __init__(self, *, night: bool) -> None:
        self._strength = 1.0 if night else 0.4
        self._lamps_burn = night
        line = (np.arange(65) - 32) / 32
        fall = np.clip(1 - np.hypot(line[:, None], line[None, :]), 0, 1) ** 2.4
        self._disc: Picture = np.clip(255 * fall, 0, 255).astype(np.uint8)

    def add(
        self,
        canvas: Canvas,
        things: Sequence[Thing],
        parked: frozenset[int],
        signals: Mapping[SignalGroup, LightState],
        view: View,
    ) -> None:
        """Add the halos of painted objects; a light is visible if its pixel belongs to its own object.

        Args:
            canvas: The finished image and mask; an object without an id has minus its number, from 1, in the mask.
            things: Painted objects.
            parked: Ids of parked vehicles, which have their lights off.
            signals: What the traffic lights show.
            view: The camera.
        """
        for number, thing in enumerate(things, 1):
            if isinstance(thing, Lamp) and self._lamps_burn:
                x_m, y_m = lamp_head_position(thing)
                self._add(canvas, (x_m, y_m, thing.height_m), _LAMP_LIGHT_M, _LAMP_LIGHT, -number, view)
            elif isinstance(thing, TrafficLight) and thing.group in signals:
                self._add_traffic_light(canvas, thing, signals[thing.group], -number, view)
            elif isinstance(thing, Body) and thing.kind is BodyKind.VEHICLE and thing.id not in parked:
                self._add_vehicle(canvas, thing, view)

    def _add_traffic_light(
        self, canvas: Canvas, light: TrafficLight, state: LightState, number: int, view: View
    ) -> None:
        (x_m, y_m, z_m), (red, green, blue) = lit_lamp(light, state)
        ahead_m = (view.x_m - x_m) * math.cos(light.yaw_rad) + (view.y_m - y_m) * math.sin(light.yaw_rad)
        if ahead_m > 0.0:
            share = _TRAFFIC_LIGHT_STRENGTH * self._strength
            rgb = (share * red, share * green, share * blue)
            self._add(canvas, (x_m, y_m, z_m), _TRAFFIC_LIGHT_M, rgb, number, view)

    def _add_vehicle(self, canvas: Canvas, body: Body, view: View) -> None:
        ahead_m = (view.x_m - body.x_m) * math.cos(body.yaw_rad) + (view.y_m - body.y_m) * math.sin(
            body.yaw_rad
        )
        for place, end in vehicle_light_positions(body):
            if ahead_m * end <= body.length_m / 2:
                continue
            if end > 0:
                rgb, size_m = _HEADLIGHT, _HEADLIGHT_M
            elif body.braking:
                rgb, size_m = _BRAKE_LIGHT, _BRAKE_LIGHT_M
            else:
                rgb, size_m = _TAIL_LIGHT, _TAIL_LIGHT_M
            red, green, blue = (self._strength * part for part in rgb)
            self._add(canvas, place, size_m, (red, green, blue), body.id, view)

    def _add(
        self,
        canvas: Canvas,
        place: tuple[float, float, float],
        size_m: float,
        rgb: Rgb,
        number: int,
        view: View,
    ) -> None:
        depth, left_m, up_m = view.point_to_camera(*place)
        if depth < 1.0:
            return
        scale = view.focal_px / depth
        x = round(view.width_px / 2 - 0.5 - left_m * scale)
        y = round(view.height_px / 2 - 0.5 - up_m * scale)
        if not (0 <= x < view.width_px and 0 <= y < view.height_px):
            return
        # The head of a lamp may be thinner than a pixel.
        around = 1 if number < 0 else 0
        seen = canvas.ids[max(y - around, 0) : y + around + 1, max(x - around, 0) : x + around + 1]
        if not (seen == number).any():
            return
        half = round(min(max(size_m * scale, 0.008 * view.width_px), 0.2 * view.width_px))
        left, top = max(x - half, 0), max(y - half, 0)
        right, bottom = min(x + half + 1, view.width_px), min(y + half + 1, view.height_px)
        disc = cv2.resize(self._disc, (2 * half + 1, 2 * half + 1), interpolation=cv2.INTER_LINEAR)
        cut = disc[top - y + half : bottom - y + half, left - x + half : right - x + half]
        halo = cv2.merge([cv2.convertScaleAbs(cut, alpha=part / 255) for part in rgb])
        region = canvas.image[top:bottom, left:right]
        cv2.add(region, halo, dst=region)
