"""Types of violations: how many are known over time, and a gallery of replays."""

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

from brink.pictures import render
from brink.report.figures import Drawing
from brink.search.analysis.avoidable import Avoidable
from brink.server.findings.violations.views import Violations

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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


def figure_types(found: Violations) -> "Figure":
    """Plot how the numbers of known types and of avoidable ones grow with the solutions."""
    # matplotlib takes half a second to load: only commands that draw wait for it.
    from brink.pictures.figure import LiteralFigure

    firsts = sorted(kind.first for kind in found.types)
    curves = [(firsts, "#0072b2", "all types")]
    if any(kind.avoidable for kind in found.types):
        curves.append((_first_avoidable(found), "#d55e00", "avoidable by a careful driver"))
    last = max((one.number for one in found.violations), default=0)
    figure = LiteralFigure(figsize=(6, 3.4), layout="constrained")
    axes = figure.subplots()
    for numbers, colour, label in curves:
        axes.step(
            [0, *numbers, last],
            [0, *range(1, len(numbers) + 1), len(numbers)],
            where="post",
            color=colour,
            label=label,
        )
    axes.set(xlabel="solutions proposed", ylabel="types of violations known", xlim=(0, None), ylim=(0, None))
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False)
    return figure


def _first_avoidable(found: Violations) -> list[int]:
    """Return the solutions that first showed a type to be avoidable by a careful driver, ascending."""
    firsts: dict[str, int] = {}
    for one in found.violations:
        if one.avoidable is Avoidable.CAREFUL:
            firsts[one.type] = min(one.number, firsts.get(one.type, one.number))
    return sorted(firsts.values())
