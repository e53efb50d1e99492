"""Vehicle models: proportions, colours and faces, upright or overturned.

A vehicle fills its box: it touches the full length, width and height, and the ground.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, TypeAlias

import numpy as np

from brink.sim.rendering.scene import Rgb, choose, choose_fraction, scaled
from brink.sim.rendering.solids import Face, Finish, Group, Mesh, make_mesh, unit_normal

Point: TypeAlias = tuple[float, float, float]
Part: TypeAlias = tuple[float, float, float, float]
"""A part of a quadrilateral, as shares: left, right, bottom, top."""

_GLASS: Final[Rgb] = (34, 42, 50)
_RUBBER: Final[Rgb] = (24, 24, 25)
_RIM: Final[Rgb] = (150, 153, 156)
_TRIM: Final[Rgb] = (30, 31, 33)
_LAMP: Final[Rgb] = (222, 226, 228)
_TAIL: Final[Rgb] = (140, 18, 20)
_PLATE: Final[Rgb] = (232, 230, 218)
_PRINT: Final[Rgb] = (126, 124, 118)
_AMBER: Final[Rgb] = (206, 112, 30)
_SKY_IN_GLASS: Final[Rgb] = (74, 86, 98)
_STREAK: Final[Rgb] = (92, 104, 116)
_SEAT: Final[Rgb] = (20, 21, 24)
_VAN_PRINTS: Final[tuple[Rgb, ...]] = (
    (178, 34, 38), (28, 72, 140), (30, 112, 70), (214, 150, 30), (60, 62, 68), (92, 160, 196),
)  # fmt: skip
_TREADS: Final = 10


class _VehicleBuilder:
    """Builds the faces of one upright vehicle, in metres."""

    def __init__(self, look: int, length_m: float, width_m: float, height_m: float) -> None:
        self.look, self.shape = look, _vehicle_shape(look, height_m)
        self.length_m, self.width_m, self.height_m = length_m, width_m, height_m
        self.paint = vehicle_colour(look, height_m)
        self.belt_m = self.shape.belt_z * height_m
        self.wheel_m = min(0.225 * height_m, 0.36, 0.12 * length_m)
        self.floor_m = 0.62 * self.wheel_m
        self.nose_m, self.tail_m = 0.5 * length_m, -0.5 * length_m
        self.shoulder_m, self.haunch_m = 0.43 * length_m, -0.455 * length_m
        self._inside = (0.0, 0.0, 0.0)

    def faces(self, *, turned: bool) -> list[Face]:
        """Return all faces; an overturned vehicle also shows its underside and whole wheels."""
        self._inside = (0.0, 0.0, 0.5 * (self.floor_m + self.belt_m))
        lower = [*self._sides(), *self._front(), *self._rear(), *self._decks()]
        if turned:
            lower += self._underside()
        self._inside = (0.0, 0.0, 0.5 * (self.height_m + self.belt_m))
        return [*self._treads(whole=turned), *lower, *self._cabin(), *self._discs()]

    def _face(
        self,
        corners: list[Point],
        rgb: Rgb,
        group: Group,
        finish: Finish = Finish.PAINT,
        *,
        solid: bool = False,
        shown_px: float = 0.0,
    ) -> Face:
        """Return a face of the current part, oriented away from the part's inside."""
        x, y, z = unit_normal(corners)
        inside_x, inside_y, inside_z = self._inside
        at_x, at_y, at_z = corners[0]
        if x * (at_x - inside_x) + y * (at_y - inside_y) + z * (at_z - inside_z) < 0:
            corners = corners[::-1]
        return Face(corners, rgb, group, solid, finish, shown_px)

    def _hood_z(self, x_m: float) -> float:
        """Return the height of the bonnet at x."""
        front = self.shape.base_front * self.length_m
        part = (self.nose_m - x_m) / (self.nose_m - front)
        nose = self.shape.nose_z * self.height_m
        return nose + (self.belt_m - nose) * min(part, 1.0)

    def _sides(self) -> list[Face]:
        half, low = 0.5 * self.width_m, self.floor_m
        front = self.shape.base_front * self.length_m
        faces = []
        if front > self.shoulder_m:
            front = self.shoulder_m
        for y in (half, -half):
            outline = [
                (self.shoulder_m, y, low),
                (self.shoulder_m, y, self._hood_z(self.shoulder_m)),
                (front, y, self._hood_z(front)),
                (self.haunch_m, y, self.belt_m),
                (self.haunch_m, y, low),
            ]
            faces.append(self._face(outline, self.paint, Group.LOWER, solid=True))
            sill = low + 0.09 * self.height_m
            faces.append(
                self._strip(y, self.haunch_m, self.shoulder_m, low, sill, scaled(self.paint, 0.45), 22)
            )
            band = self.belt_m - 0.10 * self.height_m
            shade = scaled(self.paint, 0.86)
            faces.append(self._strip(y, self.haunch_m, self.shoulder_m, sill, band - 0.08, shade, 40))
            bright = _light(self.paint, 1.22)
            top = self.belt_m - 0.02 * self.height_m
            shine = self.belt_m - 0.055 * self.height_m
            faces.append(self._strip(y, self.haunch_m, front, shine, top, bright, 24))
            seams = (0.17, -0.075, -0.29) if len(self.shape.windows) > 1 else (0.36, 0.17)
            for seam in seams:
                x = seam * self.length_m
                faces.append(
                    self._strip(y, x, x + 0.014, sill, self.belt_m - 0.02, scaled(self.paint, 0.4), 60)
                )
            for seam in seams[1:]:
                x = seam * self.length_m + 0.07
                faces.append(self._strip(y, x, x + 0.17, band, band + 0.035, scaled(self.paint, 0.55), 80))
        return faces

    def _strip(
        self, y: float, from_m: float, to_m: float, low: float, high: float, rgb: Rgb, shown_px: float
    ) -> Face:
        corners = [(from_m, y, low), (to_m, y, low), (to_m, y, high), (from_m, y, high)]
        return self._face(corners, rgb, Group.LOWER, shown_px=shown_px)

    def _end(self, x: float, part: tuple[float, float, float, float]) -> list[Point]:
        """Return the corners of an upright rectangle perpendicular to the vehicle's axis, at x.

        `part` gives its left and right edge in vehicle widths, then its lower and upper edge in vehicle heights.
        """
        left, right, low, high = part
        width, height = self.width_m, self.height_m
        return [
            (x, left * width, low * height),
            (x, right * width, low * height),
            (x, right * width, high * height),
            (x, left * width, high * height),
        ]

    def _corner(
        self, end_m: float, body_m: float, half_end: float, side: float, low: float, high: float
    ) -> list[Point]:
        """Return a strip of the slanted corner between an end and a side; z in m."""
        half = 0.5 * self.width_m
        return [
            (end_m, side * half_end, low),
            (body_m, side * half, low),
            (body_m, side * half, high),
            (end_m, side * half_end, high),
        ]

    def _front(self) -> list[Face]:
        shape, height = self.shape, self.height_m
        half = 0.5 * shape.nose_width * self.width_m
        nose, top = self.nose_m, shape.nose_z * self.height_m
        edge, low = 0.5 * shape.nose_width, self.floor_m / height
        faces = [
            self._face(self._end(nose, (-edge, edge, low, shape.nose_z)), self.paint, Group.LOWER, solid=True)
        ]
        for side in (1.0, -1.0):
            outline = self._corner(nose, self.shoulder_m, half, side, self.floor_m, top)
            outline[2] = (self.shoulder_m, side * 0.5 * self.width_m, self._hood_z(self.shoulder_m))
            faces.append(self._face(outline, self.paint, Group.LOWER, solid=True))
        lamp_low, lamp_high = (shape.nose_z - 0.125) * height, (shape.nose_z - 0.03) * height
        bumper = low + 0.07
        rows: list[tuple[tuple[float, float, float, float], Rgb, float]] = [
            ((-edge, edge, low, bumper), _TRIM, 16),
            ((-0.27, 0.27, shape.nose_z - 0.125, shape.nose_z - 0.045), _TRIM, 16),
            ((-0.22, 0.22, bumper + 0.015, bumper + 0.075), _TRIM, 36),
            ((-0.135, 0.135, shape.nose_z - 0.21, shape.nose_z - 0.145), _PLATE, 26),
            ((-0.11, 0.11, shape.nose_z - 0.195, shape.nose_z - 0.16), _PRINT, 80),
            ((-0.26, 0.26, shape.nose_z - 0.092, shape.nose_z - 0.080), scaled(_RIM, 0.5), 50),
            ((-0.035, 0.035, shape.nose_z - 0.105, shape.nose_z - 0.065), _RIM, 44),
            ((-edge, edge, bumper + 0.085, bumper + 0.098), _light(self.paint, 1.15), 40),
            ((-0.38, -0.29, bumper + 0.02, bumper + 0.065), _TRIM, 40),
            ((0.29, 0.38, bumper + 0.02, bumper + 0.065), _TRIM, 40),
        ]
        faces += [
            self._face(self._end(nose, part), rgb, Group.LOWER, Finish.FLAT, shown_px=px)
            for part, rgb, px in rows
        ]
        for side in (1.0, -1.0):
            part = (side * 0.29, side * edge, lamp_low / height, lamp_high / height)
            faces.append(self._face(self._end(nose, part), _LAMP, Group.LOWER, Finish.LAMP, shown_px=9))
            eye = (side * 0.315, side * (edge - 0.02), lamp_low / height + 0.014, lamp_high / height - 0.03)
            faces.append(
                self._face(self._end(nose, eye), scaled(_LAMP, 0.6), Group.LOWER, Finish.LAMP, shown_px=50)
            )
            corner = self._corner(nose, 0.5 * (self.shoulder_m + nose), half, side, lamp_low, lamp_high)
            halfway = 0.5 * (half + 0.5 * self.width_m)
            corner = [(x, side * halfway if abs(y) > half else y, z) for x, y, z in corner]
            faces.append(self._face(corner, _LAMP, Group.LOWER, Finish.LAMP, shown_px=24))
        return faces

    def _rear(self) -> list[Face]:
        shape, height = self.shape, self.height_m
        half = 0.5 * shape.tail_width * self.width_m
        tail, edge = self.tail_m, 0.5 * shape.tail_width
        low, top = self.floor_m / height, shape.belt_z
        faces = [self._face(self._end(tail, (-edge, edge, low, top)), self.paint, Group.LOWER, solid=True)]
        for side in (1.0, -1.0):
            outline = self._corner(tail, self.haunch_m, half, side, self.floor_m, self.belt_m)
            faces.append(self._face(outline, self.paint, Group.LOWER, solid=True))
        bumper = low + 0.11
        rows: list[tuple[tuple[float, float, float, float], Rgb, float]] = [
            ((-edge, edge, low, low + 0.065), _TRIM, 16),
            ((-edge, edge, bumper + 0.045, bumper + 0.085), _light(self.paint, 1.14), 30),
            ((-edge, edge, bumper + 0.085, bumper + 0.095), scaled(self.paint, 0.45), 50),
            ((-edge + 0.03, -edge + 0.12, low + 0.09, low + 0.12), (120, 26, 24), 44),
            ((edge - 0.12, edge - 0.03, low + 0.09, low + 0.12), (120, 26, 24), 44),
            ((-0.19, 0.19, top - 0.22, top - 0.115), scaled(self.paint, 0.62), 30),
            ((-0.14, 0.14, top - 0.20, top - 0.13), _PLATE, 22),
            ((-0.115, 0.115, top - 0.183, top - 0.147), _PRINT, 80),
            ((-0.03, 0.03, top - 0.09, top - 0.05), _RIM, 50),
            ((0.24, 0.31, low - 0.01, low + 0.03), scaled(_RIM, 0.6), 60),
        ]
        faces += [
            self._face(self._end(tail, part), rgb, Group.LOWER, Finish.FLAT, shown_px=px)
            for part, rgb, px in rows
        ]
        inner = edge - (0.13 if height < _VAN_FROM_M else 0.06)
        lamp = (top - 0.155, top - 0.035) if height < _VAN_FROM_M else (top - 0.24, top - 0.05)
        for side in (1.0, -1.0):
            part = (side * inner, side * edge, *lamp)
            faces.append(self._face(self._end(tail, part), _TAIL, Group.LOWER, Finish.TAIL, shown_px=8))
            span = lamp[1] - lamp[0]
            for rgb, a, b in ((_AMBER, 0.70, 0.92), (_LAMP, 0.08, 0.26)):
                piece = (side * (inner + 0.012), side * edge, lamp[0] + a * span, lamp[0] + b * span)
                faces.append(self._face(self._end(tail, piece), rgb, Group.LOWER, Finish.FLAT, shown_px=44))
            corner = self._corner(tail, self.haunch_m, half, side, lamp[0] * height, lamp[1] * height)
            faces.append(self._face(corner, _TAIL, Group.LOWER, Finish.TAIL, shown_px=14))
        return faces

    def _decks(self) -> list[Face]:
        half, shape = 0.5 * self.width_m, self.shape
        front = shape.base_front * self.length_m
        nose_half, tail_half = 0.5 * shape.nose_width * self.width_m, 0.5 * shape.tail_width * self.width_m
        shoulder = max(self.shoulder_m, front + 0.01)
        bonnet = [(front, half, self.belt_m), (shoulder, half, self._hood_z(shoulder))]
        bonnet.append((self.nose_m, nose_half, self._hood_z(self.nose_m)))
        bonnet += [(x, -y, z) for x, y, z in bonnet[::-1]]
        deck = [
            (front, half, self.belt_m),
            (self.haunch_m, half, self.belt_m),
            (self.tail_m, tail_half, self.belt_m),
        ]
        deck += [(x, -y, z) for x, y, z in deck[::-1]]
        return [
            self._face(deck, self.paint, Group.LOWER, solid=True),
            self._face(bonnet, self.paint, Group.LOWER, solid=True),
        ]

    def _underside(self) -> list[Face]:
        low, half = self.floor_m, 0.5 * self.width_m
        shape = self.shape
        nose, tail = 0.5 * shape.nose_width * self.width_m, 0.5 * shape.tail_width * self.width_m
        plate = [(self.nose_m, nose, low), (self.shoulder_m, half, low), (self.haunch_m, half, low)]
        plate.append((self.tail_m, tail, low))
        plate += [(x, -y, z) for x, y, z in plate[::-1]]
        faces = [self._face(plate, (66, 64, 62), Group.LOWER, solid=True)]

        def part(x0: float, x1: float, y0: float, y1: float, rgb: Rgb) -> None:
            scale_x, scale_y = self.length_m, self.width_m
            corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
            points = [(x * scale_x, y * scale_y, low) for x, y in corners]
            faces.append(self._face(points, rgb, Group.LOWER, Finish.FLAT, shown_px=12))

        part(shape.wheel_front - 0.02, shape.wheel_front + 0.02, -0.42, 0.42, (34, 34, 35))
        part(shape.wheel_rear - 0.02, shape.wheel_rear + 0.02, -0.42, 0.42, (34, 34, 35))
        part(0.22, 0.44, -0.24, 0.24, (46, 45, 44))
        part(-0.42, 0.22, 0.05, 0.12, (112, 106, 100))
        part(-0.44, -0.33, 0.02, 0.26, (128, 122, 114))
        part(-0.26, 0.14, -0.36, -0.30, (92, 88, 84))
        return faces

    def _cabin(self) -> list[Face]:
        # The mirrors come first so that the cabin hides the one on the far side.
        return [*self._mirrors(), *self._side_walls(), *self._screens(), *self._roof()]

    def _pillars(self, *, rear: bool) -> tuple[Point, Point]:
        """Return the left corners of the cabin, at the belt and at the roof."""
        shape = self.shape
        base, roof = (shape.base_rear, shape.roof_rear) if rear else (shape.base_front, shape.roof_front)
        brow = self.height_m - min(0.05 * self.height_m, 0.07)
        half, roof_half = 0.5 * shape.base_width * self.width_m, 0.5 * shape.roof_width * self.width_m
        return (base * self.length_m, half, self.belt_m), (roof * self.length_m, roof_half, brow)

    def _side_walls(self) -> list[Face]:
        (x_br, base, low), (x_rr, roof, brow) = self._pillars(rear=True)
        (x_bf, _, _), (x_rf, _, _) = self._pillars(rear=False)
        shape, faces = self.shape, list[Face]()
        for side in (1.0, -1.0):
            quad = [
                (x_br, side * base, low),
                (x_bf, side * base, low),
                (x_rf, side * roof, brow),
                (x_rr, side * roof, brow),
            ]
            faces += self._glazed(quad, [(a, b, 0.10, 0.86) for a, b in shape.windows], 7)
            if len(shape.windows) == 1 and choose(self.look, 6, 3):
                faces += self._print(quad)
        return faces

    def _print(self, wall: list[Point]) -> list[Face]:
        """Return the name of a firm on a van: a panel, a mark and two lines of print."""
        rgb = _VAN_PRINTS[choose(self.look, 7, len(_VAN_PRINTS))]
        return [
            self._panel(wall, (0.10, 0.70, -0.02, 0.16), rgb, Finish.PAINT, 24),
            self._panel(wall, (0.16, 0.28, 0.38, 0.74), rgb, Finish.PAINT, 24),
            self._panel(wall, (0.32, 0.66, 0.56, 0.70), rgb, Finish.PAINT, 30),
            self._panel(wall, (0.32, 0.58, 0.40, 0.47), scaled(rgb, 0.7), Finish.PAINT, 40),
        ]

    def _screens(self) -> list[Face]:
        faces = []
        glass = self.shape.rear_glass
        doors = [(0.10, 0.46, 0.35, 0.86), (0.54, 0.90, 0.35, 0.86)]
        windows = [(0.09, 0.91, glass, 0.86)] if glass < 0.25 else doors
        for is_rear, panes, px in ((False, [(0.045, 0.955, 0.04, 0.93)], 5), (True, windows, 6)):
            (x_b, base, low), (x_r, roof, brow) = self._pillars(rear=is_rear)
            quad = [(x_b, base, low), (x_b, -base, low), (x_r, -roof, brow), (x_r, roof, brow)]
            faces += self._glazed(quad, panes, px)
        faces.append(self._panel(quad, (0.40, 0.60, 0.90, 0.96), (70, 14, 16), Finish.BRAKE, 14))
        return faces

    def _roof(self) -> list[Face]:
        _, (x_rr, roof, brow) = self._pillars(rear=True)
        _, (x_rf, _, _) = self._pillars(rear=False)
        front, rear = x_rf - 0.05 * self.length_m, x_rr + 0.02 * self.length_m
        top = [
            (front, 0.80 * roof, self.height_m),
            (front, -0.80 * roof, self.height_m),
            (rear, -0.80 * roof, self.height_m),
            (rear, 0.80 * roof, self.height_m),
        ]
        rim = [(x_rf, roof, brow), (x_rf, -roof, brow), (x_rr, -roof, brow), (x_rr, roof, brow)]
        slopes = [[rim[i], rim[j], top[j], top[i]] for i, j in ((0, 1), (1, 2), (2, 3), (3, 0))]
        return [self._face(quad, self.paint, Group.CABIN, solid=True) for quad in (*slopes, top)]

    def _glazed(self, wall: list[Point], panes: list[Part], px: float) -> list[Face]:
        """Return a wall of the cabin with its windows, and the seats and the reflections that they show.

        Args:
            wall: Its four corners.
            panes: The windows, as parts of the wall.
            px: Apparent height of the vehicle from which on the windows are drawn.
        """
        faces = [self._face(wall, self.paint, Group.CABIN, solid=True)]
        for s0, s1, t0, t1 in panes:
            frame = (s0 - 0.018, s1 + 0.018, t0 - 0.05, t1 + 0.04)
            glass = _part(wall, (s0, s1, t0, t1))
            faces += [
                self._panel(wall, frame, _TRIM, Finish.FLAT, 26),
                self._face(glass, _GLASS, Group.CABIN, Finish.GLASS, shown_px=px),
                self._panel(glass, (0.0, 1.0, 0.58, 1.0), _SKY_IN_GLASS, Finish.GLASS, 20),
            ]
            for left, right in ((0.17, 0.36), (0.64, 0.83)) if s1 - s0 > 0.6 else ((0.34, 0.66),):
                faces += [
                    self._panel(glass, (left, right, 0.0, 0.46), _SEAT, Finish.FLAT, 40),
                    self._panel(glass, (left + 0.045, right - 0.045, 0.46, 0.66), _SEAT, Finish.FLAT, 54),
                ]
            streak = ((0.50, 0.0), (0.60, 0.0), (0.80, 1.0), (0.70, 1.0))
            shine = [_within(glass, s, t) for s, t in streak]
            faces.append(self._face(shine, _STREAK, Group.CABIN, Finish.GLASS, shown_px=60))
        return faces

    def _panel(self, quad: list[Point], part: Part, rgb: Rgb, finish: Finish, px: float) -> Face:
        return self._face(_part(quad, part), rgb, Group.CABIN, finish, shown_px=px)

    def _mirrors(self) -> list[Face]:
        """Return the two wing mirrors, within the width of the body."""
        x = (self.shape.base_front - 0.075) * self.length_m
        low, high = self.belt_m + 0.01, self.belt_m + 0.085 * self.height_m
        outer, inner = 0.5 * self.width_m, 0.42 * self.width_m
        faces = []
        for side in (1.0, -1.0):
            quad = [
                (x, side * inner, low),
                (x, side * outer, low),
                (x, side * outer, high),
                (x, side * inner, high),
            ]
            faces += [
                Face(quad, scaled(self.paint, 0.8), Group.CABIN, True, Finish.PAINT, 30.0),
                Face(quad[::-1], scaled(self.paint, 0.7), Group.CABIN, True, Finish.PAINT, 30.0),
            ]
        return faces

    def _axles(self) -> tuple[float, float]:
        return self.shape.wheel_front * self.length_m, self.shape.wheel_rear * self.length_m

    def _treads(self, *, whole: bool) -> list[Face]:
        """Return the treads of the wheels: the full circle, or only what shows below the bumpers."""
        radius, half = self.wheel_m, 0.5 * self.width_m
        inner = half - min(0.22, 0.15 * self.width_m)
        faces = []
        for axle in self._axles():
            for side in (1.0, -1.0):
                self._inside = (axle, side * 0.5 * (half + inner), radius)
                ring = _circle(axle, radius, radius, _TREADS)
                # Only the lower quarter of a wheel shows below its arch, at the front and at the back.
                edges = range(_TREADS) if whole else (0, 1, _TREADS - 2, _TREADS - 3)
                for edge in edges:
                    (x0, z0), (x1, z1) = ring[edge], ring[(edge + 1) % _TREADS]
                    quad = [
                        (x0, side * inner, z0),
                        (x1, side * inner, z1),
                        (x1, side * half, z1),
                        (x0, side * half, z0),
                    ]
                    px = 0.0 if whole or edge in (0, _TREADS - 2) else 26.0
                    faces.append(
                        self._face(quad, _RUBBER, Group.WHEELS, Finish.FLAT, solid=True, shown_px=px)
                    )
        return faces

    def _discs(self) -> list[Face]:
        radius, half = self.wheel_m, 0.5 * self.width_m
        self._inside = (0.0, 0.0, 0.0)
        faces = []
        for axle in self._axles():
            for y in (half, -half):
                arch = [(x, y, z) for x, z in _circle(axle, radius, 1.2 * radius, 14) if z > 0.9 * radius]
                arch.sort(key=lambda point: math.atan2(point[2] - radius, point[0] - axle))
                faces.append(self._face(arch, (17, 17, 18), Group.DISCS, Finish.FLAT, shown_px=12))
                for size, rgb, count, px in (
                    (1.0, _RUBBER, 14, 0),
                    (0.68, _RIM, 10, 14),
                    (0.2, scaled(_RIM, 0.7), 6, 60),
                ):
                    disc = [(x, y, z) for x, z in _circle(axle, radius, size * radius, count)]
                    faces.append(
                        self._face(disc, rgb, Group.DISCS, Finish.FLAT, solid=size == 1.0, shown_px=float(px))
                    )
                for spoke in range(5):
                    gap = [
                        (axle + share * radius * math.cos(a), y, radius + share * radius * math.sin(a))
                        for share, turn in ((0.24, 0.0), (0.58, -0.42), (0.58, 0.42))
                        for a in (math.tau * spoke / 5 + turn,)
                    ]
                    faces.append(self._face(gap, scaled(_RIM, 0.38), Group.DISCS, Finish.FLAT, shown_px=46.0))
        return faces


def _light(rgb: Rgb, by: float) -> Rgb:
    """Return a lighter colour; black becomes dark grey."""
    return min(rgb[0] * by + 10, 250.0), min(rgb[1] * by + 10, 250.0), min(rgb[2] * by + 10, 250.0)


def _circle(x: float, z: float, radius: float, count: int) -> list[tuple[float, float]]:
    angles = [2 * math.pi * (i + 0.5) / count - math.pi / 2 for i in range(count)]
    # The lowest corners lie on the ground, so that a wheel with few corners still touches it.
    low = radius / math.cos(math.pi / count)
    return [
        (x + radius * math.cos(a), z + (low if i in (0, count - 1) else radius) * math.sin(a))
        for i, a in enumerate(angles)
    ]


def _within(quad: list[Point], s: float, t: float) -> Point:
    """Return the point of a quad at fraction s along its first edge and t of the way to its third."""
    a, b, c, d = quad
    x, y, z = ((1 - t) * ((1 - s) * a[i] + s * b[i]) + t * ((1 - s) * d[i] + s * c[i]) for i in range(3))
    return x, y, z


def _part(quad: list[Point], part: Part) -> list[Point]:
    s0, s1, t0, t1 = part
    return [_within(quad, s, t) for s, t in ((s0, t0), (s1, t0), (s1, t1), (s0, t1))]


_PAINTS: Final[tuple[Rgb, ...]] = (
    (236, 236, 232), (26, 27, 30), (168, 172, 176), (96, 100, 106), (176, 28, 30), (30, 62, 132),
    (222, 222, 214), (42, 74, 58), (198, 176, 138), (226, 178, 32), (66, 124, 164), (112, 34, 44),
    (58, 60, 66), (206, 96, 36), (236, 236, 232), (228, 229, 230), (26, 27, 30), (34, 35, 38), (96, 100, 106),
    (70, 74, 80), (168, 172, 176), (140, 145, 150), (36, 50, 84), (122, 32, 34), (90, 82, 72), (152, 160, 150),
)  # fmt: skip
_VAN_PAINTS: Final[tuple[Rgb, ...]] = (
    (238, 238, 235), (228, 229, 226), (200, 204, 206), (44, 74, 132), (214, 168, 38), (150, 40, 38),
    (64, 68, 74),
)  # fmt: skip
_VAN_FROM_M: Final = 1.9


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """Proportions of a vehicle: x in vehicle lengths from the middle, z in heights, widths in vehicle widths."""

    nose_z: float
    belt_z: float
    base_front: float
    base_rear: float
    roof_front: float
    roof_rear: float
    base_width: float = 0.94
    roof_width: float = 0.76
    nose_width: float = 0.84
    tail_width: float = 0.88
    wheel_front: float = 0.305
    wheel_rear: float = -0.295
    windows: tuple[tuple[float, float], ...] = ((0.05, 0.47), (0.53, 0.95))
    rear_glass: float = 0.16


_CARS: Final = (
    Shape(nose_z=0.50, belt_z=0.61, base_front=0.23, base_rear=-0.475, roof_front=0.05, roof_rear=-0.37),
    Shape(nose_z=0.49, belt_z=0.61, base_front=0.21, base_rear=-0.385, roof_front=0.03, roof_rear=-0.23),
    Shape(
        nose_z=0.55, belt_z=0.63, base_front=0.25, base_rear=-0.485, roof_front=0.09, roof_rear=-0.44,
        windows=((0.04, 0.33), (0.37, 0.66), (0.70, 0.95)),
    ),
    Shape(nose_z=0.52, belt_z=0.60, base_front=0.27, base_rear=-0.48, roof_front=0.08, roof_rear=-0.34),
    Shape(nose_z=0.57, belt_z=0.64, base_front=0.22, base_rear=-0.49, roof_front=0.07, roof_rear=-0.455,
          windows=((0.04, 0.34), (0.38, 0.68), (0.72, 0.94))),
    Shape(nose_z=0.54, belt_z=0.62, base_front=0.31, base_rear=-0.485, roof_front=0.13, roof_rear=-0.40),
)  # fmt: skip
_VANS: Final = (
    Shape(
        nose_z=0.40, belt_z=0.49, base_front=0.43, base_rear=-0.495, roof_front=0.26, roof_rear=-0.49,
        base_width=0.985, roof_width=0.90, nose_width=0.88, tail_width=0.97, wheel_front=0.33,
        windows=((0.80, 0.965),), rear_glass=0.3,
    ),
    Shape(
        nose_z=0.41, belt_z=0.50, base_front=0.43, base_rear=-0.495, roof_front=0.27, roof_rear=-0.485,
        base_width=0.985, roof_width=0.89, nose_width=0.88, tail_width=0.97, wheel_front=0.33,
        windows=((0.04, 0.26), (0.29, 0.51), (0.54, 0.76), (0.80, 0.965)),
    ),
)  # fmt: skip


def _vehicle_shape(look: int, height_m: float) -> Shape:
    """Return the proportions of a vehicle; tall vehicles are vans."""
    shapes = _VANS if height_m >= _VAN_FROM_M else _CARS
    return shapes[choose(look, 3, len(shapes))]


def vehicle_colour(look: int, height_m: float) -> Rgb:
    """Return the body colour of a vehicle."""
    paints = _VAN_PAINTS if height_m >= _VAN_FROM_M else _PAINTS
    base = paints[choose(look, 1, len(paints))]
    shade = 0.93 + 0.14 * choose_fraction(look, 2)
    return base[0] * shade, base[1] * shade, base[2] * shade


@lru_cache(maxsize=512)
def make_vehicle_mesh(look: int, length_m: float, width_m: float, height_m: float) -> Mesh:
    """Build an upright vehicle that fills its box.

    Args:
        look: Selects colour and shape.
        length_m: Length of the box.
        width_m: Width of the box.
        height_m: Height of the box; tall vehicles are vans.
    """
    builder = _VehicleBuilder(look, length_m, width_m, height_m)
    return make_mesh(
        builder.faces(turned=False),
        floor=((0.0, 0.0, 1.0), builder.floor_m),
        belt=((0.0, 0.0, 1.0), builder.belt_m),
    )


@lru_cache(maxsize=64)
def make_overturned_mesh(look: int, length_m: float, width_m: float, height_m: float) -> Mesh:
    """Build a vehicle that lies on its roof or on one side and fills its box.

    Args:
        look: Selects colour, shape and side.
        length_m: Length of the box.
        width_m: Width of the box.
        height_m: Height of the box.
    """
    way = choose(look, 5, 3)
    if way == 0:
        builder = _VehicleBuilder(look, length_m, width_m, height_m)
        turn = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
        shift = np.array([0.0, 0.0, height_m])
    else:
        side = 1.0 if way == 1 else -1.0
        builder = _VehicleBuilder(look, length_m, height_m, width_m)
        turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -side], [0.0, side, 0.0]])
        shift = np.array([0.0, side * width_m / 2, height_m / 2])
    faces = []
    for face in builder.faces(turned=True):
        corners = (np.array(face.corners) @ turn.T + shift).tolist()
        faces.append(face._replace(corners=corners))
    x, y, z = turn[:, 2].tolist()
    lift = float(turn[:, 2] @ shift)
    return make_mesh(
        faces, floor=((x, y, z), builder.floor_m + lift), belt=((x, y, z), builder.belt_m + lift)
    )
