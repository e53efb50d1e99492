"""Draws a contact sheet: genes at their lowest, middle and highest level on one picture, with captions."""

from collections.abc import Sequence
from typing import cast

import cv2
import numpy as np

from brink.sim.perturbations.gene import Frame, Gene
from brink.sim.perturbations.perturbation import Perturbation
from brink.sim.perturbations.pipeline import apply, generator

CAPTION_PX = 26
MARGIN_PX = 6
PAPER, INK = 255, (32, 36, 42)
COLUMNS = 3
LARGER = 2
"""Perturbed at this many times the size of a tile, so that thin lines and single pixels are not overdrawn."""


def contact_sheet(
    picture: Frame, genes: Sequence[Gene], *, seed: int = 0, tile_width: int = 320, abreast: int = 1
) -> Frame:
    """Return a sheet with three tiles a gene: lowest, middle and highest level.

    A gene with two levels leaves its third place to the untouched picture.

    Args:
        picture: What to perturb: RGB, uint8, shape ``(height, width, 3)``.
        genes: What to show, in this order.
        seed: Seeds the random fields, the same for all levels of a gene.
        tile_width: Width of a tile in px.
        abreast: How many genes stand side by side.
    """
    height, width = picture.shape[:2]
    tile_height = max(1, round(height * tile_width / width))
    size = (LARGER * tile_width, LARGER * tile_height)
    shrunk = cast(Frame, cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
    strips = [_strip(shrunk, gene, seed, (tile_width, tile_height)) for gene in genes]
    while len(strips) % abreast:
        strips.append(np.full_like(strips[0], PAPER))
    rows = [np.hstack(strips[first : first + abreast]) for first in range(0, len(strips), abreast)]
    return _framed(np.vstack(rows))


def _strip(picture: Frame, gene: Gene, seed: int, tile: tuple[int, int]) -> Frame:
    levels = [*gene.representative_levels, 0, 0][:COLUMNS]
    tiles = []
    for level in levels:
        perturbed = apply(picture, Perturbation(gene.name, level), generator(seed, 0, 0))
        small = cv2.resize(perturbed, tile, interpolation=cv2.INTER_AREA)
        tiles.append(_captioned(cast(Frame, small), _caption(gene, level)))
    return _framed(np.hstack(tiles))


def _caption(gene: Gene, level: int) -> str:
    value = gene.value(level)
    return "no effect" if value is None else f"{gene.name} {level} of {gene.levels - 1} (v = {value:.3g})"


def _captioned(tile: Frame, caption: str) -> Frame:
    banner = np.full((CAPTION_PX, tile.shape[1] + 2 * MARGIN_PX, 3), PAPER, dtype=np.uint8)
    size = min(0.5, 0.5 * tile.shape[1] / 280)
    cv2.putText(
        banner, caption, (MARGIN_PX, CAPTION_PX - 9), cv2.FONT_HERSHEY_SIMPLEX, size, INK, 1, cv2.LINE_AA
    )
    sides = cv2.copyMakeBorder(
        tile, 0, 0, MARGIN_PX, MARGIN_PX, cv2.BORDER_CONSTANT, value=(PAPER, PAPER, PAPER)
    )
    return np.vstack([banner, cast(Frame, sides)])


def _framed(picture: Frame) -> Frame:
    white = (PAPER, PAPER, PAPER)
    return cast(Frame, cv2.copyMakeBorder(picture, 0, MARGIN_PX, 0, 0, cv2.BORDER_CONSTANT, value=white))
