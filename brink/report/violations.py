"""Types of violations as a gallery of replays."""

import asyncio
from pathlib import Path

from brink.report.figures import Drawing
from brink.server.api.schemas import Violations
from brink.sim.replay import render


async def draw_gallery(found: Violations, drawing: Drawing, most: int) -> list[Path]:
    """Draw an example of each of the first types, skipping those without a trace; return the files.

    Args:
        found: The violations, avoidable types first.
        drawing: The campaign and the folder.
        most: Number of types to draw.
    """
    files = []
    requirement = {(one.number, one.type): one.requirement for one in found.violations}
    types = found.types[:most]
    for place, kind in enumerate(types, start=1):
        if drawing.stop.is_set():
            break
        drawing.show("drawing types of violations", place - 1, len(types))
        trace = await drawing.trace(kind.example)
        if trace is None:
            continue
        path = drawing.folder / f"violation-{place}.png"
        await asyncio.to_thread(render, trace, path, requirement=requirement[kind.example, kind.type])
        files.append(path)
    return files
