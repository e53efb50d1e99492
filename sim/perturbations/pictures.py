"""Images for trying out perturbations: files and contact sheets."""

from collections.abc import Sequence
from pathlib import Path
from typing import cast

import cv2
import numpy as np

from brink.sim.perturbations.catalogue import Frame, Gene, InvalidFrame
from brink.sim.perturbations.pipeline import Perturbation, apply, check_frame, generator
from brink.user_file import read_file

CAPTION_PX = 26
MARGIN_PX = 6
MAX_BYTES = 256 * 1024**2
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
    content = np.frombuffer(read_file(path, MAX_BYTES), dtype=np.uint8)
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
