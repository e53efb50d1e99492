"""Types of violations: the most frequent first, and as a gallery of replays."""

import asyncio
from pathlib import Path

from brink.report.figures import Drawing
from brink.server.api.schemas import TypeView, Violations
from brink.sim.replay import render


def by_frequency(found: Violations) -> list[TypeView]:
    """Return the types of violations, most frequent first."""
    return sorted(found.types, key=lambda kind: (-kind.solutions, kind.first))


async def draw_gallery(found: Violations, drawing: Drawing, most: int) -> list[Path]:
    """Draw the first solution of each common type, skipping those without a trace; return the files.

    Args:
        found: The violations.
        drawing: The campaign and the folder.
        most: Number of types to draw.
    """
    files = []
    requirement = {(one.number, one.type): one.requirement for one in found.violations}
    types = by_frequency(found)[:most]
    for place, kind in enumerate(types, start=1):
        if drawing.stop.is_set():
            break
        drawing.show("drawing types of violations", place - 1, len(types))
        trace = await drawing.trace(kind.first)
        if trace is None:
            continue
        path = drawing.folder / f"violation-{place}.png"
        await asyncio.to_thread(render, trace, path, requirement=requirement[kind.first, kind.type])
        files.append(path)
    return files
