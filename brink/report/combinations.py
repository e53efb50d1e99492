"""Hazardous chains of techniques, in words and as pictures of each chain with its parts."""

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

from brink.report.figures import Drawing
from brink.server.findings.combinations.views import Combinations, Variant

if TYPE_CHECKING:
    from brink.pictures.sheets import Row


async def draw_chains(found: Combinations, drawing: Drawing, most: int) -> list[Path]:
    """Draw the clearest combinations, each with its parts and other orders; return the files.

    Args:
        found: The combinations, most informative first.
        drawing: The campaign and the folder.
        most: Number of combinations to draw.
    """
    from brink.pictures.sheets import side_by_side  # slow to import

    files: list[Path] = []
    for one in found.combinations:
        if drawing.stop.is_set() or len(files) == most:
            break
        solutions = one.together or one.turned
        drawing.show("drawing combinations", len(files), most)
        rows = await _variants(drawing, solutions[0]) if solutions else []
        if not rows or any(row.trace.film is None for row in rows):
            continue
        title = f"The same street with the same seed: solution {solutions[0]} and its parts"
        picture = await asyncio.to_thread(side_by_side, rows, title=title)
        path = drawing.folder / f"combination-{len(files) + 1}.png"
        await asyncio.to_thread(picture.save, path)
        files.append(path)
    return files


async def _variants(drawing: Drawing, number: int) -> "list[Row]":
    """Return the traces of a solution and its variants; empty if one of them is not available."""
    from brink.pictures.sheets import Row

    path = f"/campaigns/{drawing.campaign}/solutions/{number}/variants"
    rows = []
    for variant in await drawing.api.read(list[Variant], path):
        trace = await drawing.trace(variant.number)
        if trace is None:
            return []
        rows.append(Row(words=variant.words, trace=trace))
    return rows
