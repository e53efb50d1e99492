"""Images for trying out perturbations: files, a drawn street, and contact sheets."""

from collections.abc import Sequence
from pathlib import Path
from typing import cast

import cv2
import numpy as np

from brink.sim.perturbations.catalogue import Frame, Gene, InvalidFrame
from brink.sim.perturbations.pipeline import Perturbation, apply, check_frame, generator

CAPTION_PX = 26
MARGIN_PX = 6
PAPER, INK = 255, (32, 36, 42)
COLUMNS = 3
OVERSAMPLING = 2
"""Images are perturbed at this multiple of the tile size, which keeps fine detail realistic."""


def contact_sheet(
    picture: Frame, genes: Sequence[Gene], *, seed: int = 0, tile_width: int = 320, genes_per_row: int = 1
) -> Frame:
    """Return a sheet with the lowest, middle and highest level of each gene.

    For a gene with only two levels, the third tile shows the original image.

    Args:
        picture: The image to perturb: RGB, uint8, shape ``(height, width, 3)``.
        genes: The genes to show, in this order.
        seed: Seed of the random fields, the same for all levels of a gene.
        tile_width: Width of a tile in px.
        genes_per_row: Number of genes side by side.
    """
    height, width = picture.shape[:2]
    tile_height = max(1, round(height * tile_width / width))
    size = (OVERSAMPLING * tile_width, OVERSAMPLING * tile_height)
    shrunk = cast(Frame, cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
    strips = [_draw_gene_row(shrunk, gene, seed, (tile_width, tile_height)) for gene in genes]
    while len(strips) % genes_per_row:
        strips.append(np.full_like(strips[0], PAPER))
    rows = [
        np.hstack(strips[first : first + genes_per_row]) for first in range(0, len(strips), genes_per_row)
    ]
    return _add_margin(np.vstack(rows))


def _draw_gene_row(picture: Frame, gene: Gene, seed: int, tile: tuple[int, int]) -> Frame:
    levels = [*gene.representative_levels, 0, 0][:COLUMNS]
    tiles = []
    for level in levels:
        perturbed = apply(picture, Perturbation(gene.name, level), generator(seed, 0, 0))
        small = cv2.resize(perturbed, tile, interpolation=cv2.INTER_AREA)
        tiles.append(_add_caption(cast(Frame, small), _caption(gene, level)))
    return _add_margin(np.hstack(tiles))


def _caption(gene: Gene, level: int) -> str:
    value = gene.value(level)
    return "no effect" if value is None else f"{gene.name} {level} of {gene.levels - 1} (v = {value:.3g})"


def _add_caption(tile: Frame, caption: str) -> Frame:
    banner = np.full((CAPTION_PX, tile.shape[1] + 2 * MARGIN_PX, 3), PAPER, dtype=np.uint8)
    size = min(0.5, 0.5 * tile.shape[1] / 280)
    cv2.putText(
        banner, caption, (MARGIN_PX, CAPTION_PX - 9), cv2.FONT_HERSHEY_SIMPLEX, size, INK, 1, cv2.LINE_AA
    )
    sides = cv2.copyMakeBorder(
        tile, 0, 0, MARGIN_PX, MARGIN_PX, cv2.BORDER_CONSTANT, value=(PAPER, PAPER, PAPER)
    )
    return np.vstack([banner, cast(Frame, sides)])


def _add_margin(picture: Frame) -> Frame:
    white = (PAPER, PAPER, PAPER)
    return cast(Frame, cv2.copyMakeBorder(picture, 0, MARGIN_PX, 0, 0, cv2.BORDER_CONSTANT, value=white))


def read_picture(path: Path) -> Frame:
    """Read an image file as RGB, uint8, shape ``(height, width, 3)``; transparency is dropped.

    Raises:
        InvalidFrame: The file is not an image, or the image is too small.
        OSError: The file cannot be read.
    """
    content = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    try:
        decoded = cv2.imdecode(content, cv2.IMREAD_COLOR) if content.size else None
    except cv2.error:  # exceeds OpenCV's limit on the number of pixels
        decoded = None
    if decoded is None:
        raise InvalidFrame(f"{path}: expected an image (PNG, JPEG, WebP, TIFF, BMP), got something else")
    picture = cast(Frame, cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB))
    check_frame(picture, f"{path}: ")
    return picture


def write_picture(picture: Frame, path: Path) -> None:
    """Write an RGB image in the format given by the file's suffix, such as ``.png``.

    Raises:
        InvalidFrame: OpenCV does not support the format, or this image in it.
        OSError: The file cannot be written.
    """
    try:
        written, content = cv2.imencode(path.suffix, cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    except cv2.error as error:
        raise InvalidFrame(f"{path}: cannot be written as {path.suffix}: {error.err}") from error
    if not written:
        raise InvalidFrame(f"{path}: cannot be written as {path.suffix}")
    path.write_bytes(content.tobytes())


WIDTH_PX, HEIGHT_PX = 1280, 720
HORIZON_PX = 340

Colour = tuple[int, int, int]


def draw_street(height: int = HEIGHT_PX) -> Frame:
    """Draw a daytime street with houses, cars and people as a 16:9 RGB image, the same for every call.

    Args:
        height: Height in px, at least 16.
    """
    frame = np.zeros((HEIGHT_PX, WIDTH_PX, 3), dtype=np.uint8)
    _draw_ground(frame)
    for left, right, height_px, colour in (
        (0, 210, 300, (151, 111, 90)), (210, 330, 220, (176, 164, 140)), (330, 430, 150, (120, 128, 134)),
        (860, 960, 160, (164, 132, 104)), (960, 1100, 240, (138, 146, 150)), (1100, 1280, 310, (170, 150, 128)),
    ):  # fmt: skip
        _draw_house(frame, left, right, height_px, colour)
    _draw_tree(frame, 455, 372, 1.0)
    _draw_tree(frame, 835, 368, 0.9)
    _draw_car(frame, 300, 470, 1.25, (150, 32, 36))
    _draw_car(frame, 545, 384, 0.55, (52, 84, 142))
    _draw_person(frame, 735, 560, 1.5, (36, 74, 132), (44, 44, 52))
    _draw_person(frame, 1010, 455, 0.95, (188, 140, 44), (66, 56, 52))
    grain = np.random.default_rng(3).normal(0, 4, frame.shape)  # sensor noise
    picture = np.clip(cv2.GaussianBlur(frame, (3, 3), 0.7) + grain, 0, 255).astype(np.uint8)
    size = (round(height * WIDTH_PX / HEIGHT_PX), height)
    return (
        picture
        if height == HEIGHT_PX
        else cast(Frame, cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
    )


def _draw_ground(frame: Frame) -> None:
    sky = np.linspace((96, 146, 208), (206, 220, 232), HORIZON_PX)
    frame[:HORIZON_PX] = sky[:, None, :].astype(np.uint8)
    frame[HORIZON_PX:] = (104, 122, 80)
    _polygon(frame, [(600, 340), (680, 340), (1500, 720), (-220, 720)], (168, 162, 152))
    _polygon(frame, [(608, 340), (672, 340), (1300, 720), (-20, 720)], (84, 86, 90))
    for near, far in ((720, 640), (585, 535), (500, 468), (445, 424), (408, 394), (381, 372)):
        half = [(y - HORIZON_PX) * 0.016 for y in (near, far)]
        _polygon(
            frame,
            [(640 - half[0], near), (640 + half[0], near), (640 + half[1], far), (640 - half[1], far)],
            (222, 222, 214),
        )


def _draw_house(frame: Frame, left: int, right: int, height_px: int, colour: Colour) -> None:
    base = HORIZON_PX + 30
    cv2.rectangle(frame, (left, base - height_px), (right, base), colour, -1)
    dark = (colour[0] // 3, colour[1] // 3, colour[2] // 3)
    for x in range(left + 14, right - 20, 34):
        for y in range(base - height_px + 16, base - 34, 44):
            cv2.rectangle(frame, (x, y), (x + 15, y + 24), dark, -1)


def _draw_tree(frame: Frame, x: int, base: int, size: float) -> None:
    cv2.rectangle(
        frame, (x - round(5 * size), base - round(80 * size)), (x + round(5 * size), base), (74, 56, 40), -1
    )
    for dx, dy, radius, green in ((0, 120, 42, 92), (-24, 96, 30, 80), (24, 98, 30, 104)):
        middle = (x + round(dx * size), base - round(dy * size))
        cv2.circle(frame, middle, round(radius * size), (48, green, 44), -1, cv2.LINE_AA)


def _draw_car(frame: Frame, x: int, base: int, size: float, colour: Colour) -> None:
    """Draw a car from behind; `x` and `base` are the middle of its lower edge in px."""

    def at(*points: tuple[float, float]) -> list[tuple[float, float]]:
        return [(x + px * size, base - py * size) for px, py in points]

    _polygon(frame, at((-84, -4), (84, -4), (74, 6), (-74, 6)), (48, 48, 50))
    for side in (-1, 1):
        _polygon(frame, at((side * 72, -2), (side * 46, -2), (side * 46, 30), (side * 72, 30)), (24, 24, 26))
    _polygon(frame, at((-78, 14), (78, 14), (80, 62), (58, 74), (-58, 74), (-80, 62)), colour)
    _polygon(frame, at((-60, 72), (60, 72), (44, 116), (-44, 116)), colour)
    _polygon(frame, at((-51, 76), (51, 76), (38, 109), (-38, 109)), (44, 56, 66))
    for side in (-1, 1):
        _polygon(frame, at((side * 76, 46), (side * 54, 46), (side * 54, 62), (side * 77, 60)), (226, 52, 44))
    _polygon(frame, at((-20, 30), (20, 30), (20, 42), (-20, 42)), (232, 230, 216))


def _draw_person(frame: Frame, x: int, base: int, size: float, coat: Colour, trousers: Colour) -> None:
    """Draw a walking person; `x` and `base` are the point between the feet in px."""

    def at(*points: tuple[float, float]) -> list[tuple[float, float]]:
        return [(x + px * size, base - py * size) for px, py in points]

    for foot, hip in ((-17, -5), (15, 5)):
        _polygon(frame, at((foot - 5, 0), (foot + 6, 0), (hip + 7, 56), (hip - 7, 56)), trousers)
    _polygon(frame, at((-14, 52), (14, 52), (16, 104), (-16, 104)), coat)
    for hand, shoulder in ((-26, -14), (25, 14)):
        _polygon(frame, at((hand - 4, 60), (hand + 4, 60), (shoulder + 5, 102), (shoulder - 5, 102)), coat)
    ((hx, hy),) = at((0, 119))
    cv2.circle(frame, (round(hx), round(hy)), round(12 * size), (206, 160, 132), -1, cv2.LINE_AA)
    cv2.ellipse(
        frame, (round(hx), round(hy)), (round(12 * size),) * 2, 0, 180, 360, (58, 42, 34), -1, cv2.LINE_AA
    )


def _polygon(frame: Frame, corners: Sequence[tuple[float, float]], colour: Colour) -> None:
    cv2.fillPoly(frame, [np.array(corners).round().astype(np.int32)], colour, cv2.LINE_AA)
