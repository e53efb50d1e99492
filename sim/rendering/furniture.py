"""Models of street furniture: what stands on pavements and is neither a person nor a vehicle.

Some of it, such as a parking meter or a sign, resembles a person from afar. It has no label, but it hides what is
behind it. A model fills its box: x along the item, y across, z up, in metres.
"""

import math
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Final, TypeAlias

from brink.sim.rendering.scene import Furniture, FurnitureKind, Rgb, choose, choose_fraction, scaled
from brink.sim.rendering.solids import Face, Finish, Group, Mesh, Plane, make_mesh

Point: TypeAlias = tuple[float, float, float]

FURNITURE_SIZE_M: Final[Mapping[FurnitureKind, tuple[float, float, float]]] = {
    FurnitureKind.BICYCLE: (1.75, 0.55, 1.05),
    FurnitureKind.BIN: (0.5, 0.5, 0.95),
    FurnitureKind.BOLLARD: (0.16, 0.16, 0.95),
    FurnitureKind.POST_BOX: (0.5, 0.5, 1.55),
    FurnitureKind.SIGN: (0.12, 0.6, 2.3),
    FurnitureKind.METER: (0.32, 0.36, 1.65),
    FurnitureKind.PLANTER: (1.2, 0.55, 1.0),
    FurnitureKind.BENCH: (1.7, 0.5, 0.85),
    FurnitureKind.BOARD: (0.5, 0.6, 1.0),
}
"""Usual length, width and height."""
_STEEL: Final[Rgb] = (112, 116, 118)
_WOOD: Final[Rgb] = (126, 88, 58)
_STONE: Final[Rgb] = (150, 146, 138)
_PAINTS: Final[tuple[Rgb, ...]] = (
    (38, 62, 50), (44, 46, 50), (150, 34, 36), (36, 64, 110), (178, 150, 48), (96, 100, 104), (70, 84, 60),
    (170, 172, 170), (140, 78, 40), (98, 44, 92),
)  # fmt: skip
_LEAVES: Final[tuple[Rgb, ...]] = ((58, 88, 44), (76, 102, 52), (50, 76, 50), (96, 112, 60))
_FLOWERS: Final[tuple[Rgb, ...]] = ((176, 60, 70), (206, 170, 60), (190, 120, 160), (220, 216, 208))
_SIGNS: Final[tuple[tuple[Rgb, Rgb], ...]] = (
    ((186, 34, 38), (230, 228, 222)), ((34, 76, 150), (34, 76, 150)), ((34, 76, 150), (226, 228, 230)),
    ((206, 168, 40), (206, 168, 40)), ((186, 34, 38), (34, 76, 150)), ((60, 110, 70), (226, 226, 220)),
)  # fmt: skip
_ABOVE: Final[Plane] = ((0.0, 0.0, 1.0), 0.0)
_Spot: TypeAlias = tuple[float, float]


class _Parts:
    """Collects the faces of one item."""

    def __init__(self) -> None:
        self.faces: list[Face] = []

    def box(
        self, low: Point, high: Point, rgb: Rgb, group: Group = Group.LOWER, *, shown_px: float = 0.0
    ) -> None:
        """Add the four sides and the top of an upright box."""
        (x0, y0, z0), (x1, y1, z1) = low, high
        corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
        self.prism(corners, (z0, z1), rgb, group, shown_px=shown_px)

    def prism(
        self,
        ring: list[tuple[float, float]],
        z: tuple[float, float],
        rgb: Rgb,
        group: Group = Group.LOWER,
        *,
        narrow: float = 1.0,
        shown_px: float = 0.0,
    ) -> None:
        """Add the sides and the top of a prism over a counter-clockwise ring, whose top may be narrower."""
        low = [(x, y, z[0]) for x, y in ring]
        top = [(narrow * x, narrow * y, z[1]) for x, y in ring]
        for i in range(len(ring)):
            j = (i + 1) % len(ring)
            self._add([low[i], low[j], top[j], top[i]], rgb, group, shown_px)
        self._add(top, rgb, group, shown_px)

    def sheet(
        self, corners: list[Point], rgb: Rgb, group: Group = Group.DISCS, shown_px: float = 0.0
    ) -> None:
        """Add a thin flat face that is visible from both sides."""
        self._add(corners, rgb, group, shown_px)
        self._add(corners[::-1], rgb, group, shown_px)

    def _add(self, corners: list[Point], rgb: Rgb, group: Group, shown_px: float) -> None:
        self.faces.append(Face(corners, rgb, group, True, Finish.PAINT, shown_px))


def _circle(radius_m: float, count: int, wide: float = 1.0) -> list[tuple[float, float]]:
    turns = [math.tau * (i + 0.5) / count for i in range(count)]
    return [(radius_m * math.cos(turn), wide * radius_m * math.sin(turn)) for turn in turns]


def _paint(look: int, question: int) -> Rgb:
    shade = 0.8 + 0.35 * choose_fraction(look, question + 1)
    return scaled(_PAINTS[choose(look, question, len(_PAINTS))], shade)


def _add_wheels(parts: _Parts, hubs: tuple[float, float], radius: float, tyre: Rgb) -> None:
    count = 8
    for hub in hubs:
        for i in range(count):
            turns = (math.tau * i / count, math.tau * (i + 1) / count)
            edge = [
                (hub + share * radius * math.cos(turn), 0.0, radius + share * radius * math.sin(turn))
                for share, ends in ((1.0, turns), (0.86, turns[::-1]))
                for turn in ends
            ]
            parts.sheet(edge, tyre, Group.LOWER)
        for end in (hub - radius, hub + radius):
            strip = [(end, -0.022, 0.4 * radius), (end, 0.022, 0.4 * radius)]
            strip += [(end, 0.022, 1.6 * radius), (end, -0.022, 1.6 * radius)]
            parts.sheet(strip, tyre, Group.LOWER, 40.0)


def _bicycle(item: Furniture, parts: _Parts) -> Plane:
    """A bicycle in the plane y = 0, with handlebars and tyres of some width."""
    radius = 0.33 * item.height_m
    back, front = -0.5 * item.length_m + radius, 0.5 * item.length_m - radius
    rgb, tyre = _paint(item.look, 1), (26, 26, 28)
    _add_wheels(parts, (back, front), radius, tyre)

    def tube(start: tuple[float, float], end: tuple[float, float], colour: Rgb, wide: float = 0.022) -> None:
        along = (end[0] - start[0], end[1] - start[1])
        length = max(math.hypot(*along), 1e-6)
        out = (-along[1] / length * wide, along[0] / length * wide)
        corners = [(start, 1), (end, 1), (end, -1), (start, -1)]
        parts.sheet([(p[0] + s * out[0], 0.0, p[1] + s * out[1]) for p, s in corners], colour)

    pedal: _Spot = (-0.08, 0.9 * radius)
    seat: _Spot = (-0.24, 0.84 * item.height_m)
    head: _Spot = (0.36, 0.82 * item.height_m)
    hubs = ((back, radius), (front, radius))
    frame: tuple[tuple[_Spot, _Spot], ...] = (
        (hubs[0], pedal),
        (pedal, head),
        (pedal, seat),
        (hubs[0], (-0.2, 0.72 * item.height_m)),
    )
    for start, end in frame:
        tube(start, end, rgb)
    if choose(item.look, 3, 2):
        tube((-0.2, 0.72 * item.height_m), head, rgb)
    tube(hubs[1], (0.34, 0.94 * item.height_m), scaled(rgb, 0.8))
    tube((-0.38, 0.89 * item.height_m), (-0.14, 0.90 * item.height_m), tyre, 0.03)
    bar, half = 0.97 * item.height_m, 0.48 * item.width_m
    parts.sheet(
        [(0.31, -half, bar), (0.31, half, bar), (0.34, half, item.height_m), (0.34, -half, item.height_m)],
        tyre,
    )
    if choose(item.look, 4, 3) == 0:
        parts.box((0.36, -0.15, 0.62 * item.height_m), (0.62, 0.15, 0.86 * item.height_m), _WOOD, Group.CABIN)
    return _ABOVE


def _bin(item: Furniture, parts: _Parts) -> Plane:
    """A litter bin on a foot, or a wheeled bin with a lid."""
    rgb, x, y, high = _paint(item.look, 1), 0.5 * item.length_m, 0.5 * item.width_m, item.height_m
    ring = [(0.86 * -x, 0.86 * -y), (0.86 * x, 0.86 * -y), (0.86 * x, 0.86 * y), (0.86 * -x, 0.86 * y)]
    if choose(item.look, 3, 2):
        ring = _circle(0.86 * x, 8)
    parts.prism(ring, (0.0, 0.88 * high), rgb, narrow=1.14)
    parts.prism(
        [(1.1 * a, 1.1 * b) for a, b in ring], (0.88 * high, high), scaled(rgb, 0.6), Group.CABIN, narrow=0.7
    )
    return (0.0, 0.0, 1.0), 0.88 * high


def _bollard(item: Furniture, parts: _Parts) -> Plane:
    rgb = (44, 46, 48) if choose(item.look, 1, 3) else _STONE
    radius, high = 0.5 * item.width_m, item.height_m
    parts.prism(_circle(radius, 6), (0.0, 0.8 * high), rgb)
    band = (226, 224, 214) if choose(item.look, 2, 2) else (176, 40, 38)
    parts.prism(_circle(radius, 6), (0.8 * high, 0.9 * high), band, Group.CABIN)
    parts.prism(_circle(radius, 6), (0.9 * high, high), rgb, Group.CABIN, narrow=0.6)
    return (0.0, 0.0, 1.0), 0.8 * high


def _post_box(item: Furniture, parts: _Parts) -> Plane:
    rgb = ((166, 28, 32), (206, 168, 40), (36, 70, 130))[choose(item.look, 1, 3)]
    radius, high = 0.5 * item.width_m, item.height_m
    parts.prism(_circle(0.94 * radius, 10), (0.0, 0.12 * high), (30, 30, 32))
    parts.prism(_circle(0.94 * radius, 10), (0.12 * high, 0.86 * high), rgb)
    parts.prism(_circle(radius, 10), (0.86 * high, 0.93 * high), scaled(rgb, 0.85), Group.CABIN)
    parts.prism(_circle(radius, 10), (0.93 * high, high), rgb, Group.CABIN, narrow=0.55)
    for side in (1.0, -1.0):
        x = side * 0.95 * radius
        slot = [(x, side * -0.10, 0.76 * high), (x, side * 0.10, 0.76 * high)]
        slot += [(x, side * 0.10, 0.79 * high), (x, side * -0.10, 0.79 * high)]
        parts.faces.append(Face(slot, (20, 20, 22), Group.CABIN, False, Finish.FLAT, 30.0))
    return (0.0, 0.0, 1.0), 0.86 * high


def _sign(item: Furniture, parts: _Parts) -> Plane:
    """A traffic sign on a pole, in some cases above a narrow plate for words."""
    edge, middle = _SIGNS[choose(item.look, 1, len(_SIGNS))]
    half, high = 0.5 * item.width_m, item.height_m
    parts.prism(_circle(0.035, 6), (0.0, high), _STEEL)
    count = (16, 16, 4, 3)[choose(item.look, 2, 4)]
    centre = high - half
    turn = math.pi / 4 if count == 4 else math.pi / 2
    for x, size, rgb, px in ((0.045, 1.0, edge, 0.0), (0.047, 0.74, middle, 24.0)):
        plate = [
            (
                x,
                size * half * math.cos(math.tau * i / count + turn),
                centre + size * half * math.sin(math.tau * i / count + turn),
            )
            for i in range(count)
        ]
        parts.faces.append(Face(plate, rgb, Group.DISCS, True, Finish.PAINT, px))
        parts.faces.append(Face(plate[::-1], scaled(_STEEL, 1.2), Group.DISCS, True, Finish.PAINT, px))
    if choose(item.look, 3, 2):
        low, wide = centre - half - 0.32, 0.8 * half
        words = [
            (0.045, -wide, low),
            (0.045, wide, low),
            (0.045, wide, low + 0.24),
            (0.045, -wide, low + 0.24),
        ]
        parts.sheet(words, (222, 222, 216))
    return _ABOVE


def _meter(item: Furniture, parts: _Parts) -> Plane:
    """A parking meter or ticket machine: a post or a cabinet with a head of another colour, as tall as a person."""
    rgb, x, y, high = _paint(item.look, 1), 0.5 * item.length_m, 0.5 * item.width_m, item.height_m
    slim = 0.3 if choose(item.look, 3, 2) else 0.8
    parts.box((-slim * x, -slim * y, 0.0), (slim * x, slim * y, 0.74 * high), scaled(rgb, 0.8))
    parts.box((-x, -y, 0.74 * high), (x, y, high), rgb, Group.CABIN)
    face = [
        (x, -0.7 * y, 0.82 * high),
        (x, 0.7 * y, 0.82 * high),
        (x, 0.7 * y, 0.95 * high),
        (x, -0.7 * y, 0.95 * high),
    ]
    parts.faces.append(Face(face, (176, 190, 186), Group.CABIN, False, Finish.PAINT, 24.0))
    return (0.0, 0.0, 1.0), 0.74 * high


def _planter(item: Furniture, parts: _Parts) -> Plane:
    x, y, rim = 0.5 * item.length_m, 0.5 * item.width_m, 0.5 * item.height_m
    tub = _STONE if choose(item.look, 1, 2) else _paint(item.look, 2)
    parts.box((-0.92 * x, -0.92 * y, 0.0), (0.92 * x, 0.92 * y, rim), tub)
    leaves = _LEAVES[choose(item.look, 4, len(_LEAVES))]
    flower = _FLOWERS[choose(item.look, 5, len(_FLOWERS))]
    for number, (low, high, wide) in enumerate(((1.0, 1.5, 0.98), (1.5, 2.0, 0.7))):
        ring = [(x / y * a, b) for a, b in _circle(wide * y, 7)]
        shade = scaled(leaves, 0.8 + 0.3 * number)
        parts.prism(ring, (low * rim, high * rim), shade, Group.CABIN, narrow=0.68)
    for number in range(7):
        turn, size = math.tau * choose_fraction(item.look, 20 + number), 0.05
        at_x, at_y, z = 0.72 * x * math.cos(turn), 0.72 * y * math.sin(turn), (1.3 + 0.08 * number) * rim
        spot = [
            (at_x - size, at_y, z),
            (at_x, at_y - size, z),
            (at_x + size, at_y, z),
            (at_x, at_y + size, z),
        ]
        parts.faces.append(Face(spot, flower, Group.DISCS, False, Finish.PAINT, 30.0))
    return (0.0, 0.0, 1.0), rim


def _bench(item: Furniture, parts: _Parts) -> Plane:
    x, y, seat = 0.5 * item.length_m, 0.5 * item.width_m, 0.5 * item.height_m
    wood = scaled(_WOOD, 0.7 + 0.5 * choose_fraction(item.look, 1))
    for at in (-0.8, 0.8):
        parts.box((at * x - 0.03, -0.8 * y, 0.0), (at * x + 0.03, 0.8 * y, seat - 0.05), (48, 50, 52))
    for low, high in ((-1.0, -0.36), (-0.30, 0.36), (0.42, 1.0)):
        parts.box((-x, low * y, seat - 0.05), (x, high * y, seat), wood, Group.CABIN)
    for low, high in ((1.15, 1.5), (1.6, 2.0)):
        # The slats of the back stand on the plane that decides whether the seat hides them.
        slat = [
            (-x, -0.98 * y, low * seat),
            (x, -0.98 * y, low * seat),
            (x, -y, high * seat),
            (-x, -y, high * seat),
        ]
        parts.sheet(slat, scaled(wood, 0.9), Group.WHEELS)
    return (0.0, 0.0, 1.0), seat - 0.05


def _board(item: Furniture, parts: _Parts) -> Plane:
    """A sandwich board of a shop: two leaning sheets with a coloured poster."""
    x, y, high = 0.5 * item.length_m, 0.5 * item.width_m, item.height_m
    frame, poster = _paint(item.look, 1), _paint(item.look, 5)
    for side in (1.0, -1.0):
        for inset, rgb, group in ((0.0, frame, Group.LOWER), (0.14, poster, Group.CABIN)):
            wide, low, top = (1 - inset) * y * side, inset * high, (1 - inset) * high
            at_low, at_top = side * x * (1 - 0.9 * low / high), side * x * (1 - 0.9 * top / high)
            sheet = [(at_low, -wide, low), (at_low, wide, low), (at_top, wide, top), (at_top, -wide, top)]
            parts.faces.append(Face(sheet, rgb, group, group is Group.LOWER, Finish.PAINT, 0.0))
    return _ABOVE


_MAKERS: Final[Mapping[FurnitureKind, Callable[[Furniture, _Parts], Plane]]] = {
    FurnitureKind.BICYCLE: _bicycle,
    FurnitureKind.BIN: _bin,
    FurnitureKind.BOLLARD: _bollard,
    FurnitureKind.POST_BOX: _post_box,
    FurnitureKind.SIGN: _sign,
    FurnitureKind.METER: _meter,
    FurnitureKind.PLANTER: _planter,
    FurnitureKind.BENCH: _bench,
    FurnitureKind.BOARD: _board,
}


@lru_cache(maxsize=512)
def make_furniture_mesh(item: Furniture) -> Mesh:
    """Build the model of an item; items that differ only in their place have equal models."""
    parts = _Parts()
    belt = _MAKERS[item.kind](item, parts)
    back: Plane = ((0.0, 1.0, 0.0), -0.49 * item.width_m)
    return make_mesh(parts.faces, floor=back, belt=belt)
