"""The still part of the map: everything that does not move, drawn once an episode on one large canvas.

The canvas keeps palette indices, one byte a pixel, at twice the map's resolution: a frame cuts its part out, draws
what moves on it and halves it, which is what makes edges smooth.
"""

from typing import Final

import numpy as np
from PIL import Image, ImageDraw

from brink.sim.replay.palette import GROUND, ROUTE, SURFACES, UNKNOWN_SURFACE, Rgb
from brink.sim.replay.viewport import Viewport
from brink.sim.trace import Surface, Trace

SUPERSAMPLING: Final = 2
ROUTE_WIDTH_M: Final = 0.3


def paint_scene(trace: Trace, viewport: Viewport) -> Image.Image:
    """Return the canvas of an episode, in palette mode, of the viewport's size."""
    fills = [GROUND, ROUTE, *UNKNOWN_SURFACE[:1]]
    for fill, edge in SURFACES.values():
        fills += [fill] if edge is None else [fill, edge]
    colours: dict[Rgb, int] = {colour: index for index, colour in enumerate(dict.fromkeys(fills))}
    canvas = Image.new("P", viewport.size_px, colours[GROUND])
    canvas.putpalette([channel for colour in colours for channel in colour])
    draw = ImageDraw.Draw(canvas)
    route_drawn = False
    for surface in trace.scene:
        # The route lies on the road and under whatever stands beside it.
        if not route_drawn and surface.kind in {"building", "parked-car", "tree"}:
            _draw_route(draw, trace, viewport, colours[ROUTE])
            route_drawn = True
        _draw_surface(draw, surface, viewport, colours)
    if not route_drawn:
        _draw_route(draw, trace, viewport, colours[ROUTE])
    return canvas


def _draw_surface(
    draw: ImageDraw.ImageDraw, surface: Surface, viewport: Viewport, colours: dict[Rgb, int]
) -> None:
    if len(surface.points) < 2:
        return
    fill, edge = SURFACES.get(surface.kind, UNKNOWN_SURFACE)
    points = viewport.to_px(surface.points)
    width, height = viewport.size_px
    low, high = points.min(axis=0), points.max(axis=0)
    if high[0] < 0 or high[1] < 0 or low[0] > width or low[1] > height:
        return
    flat = [tuple(point) for point in points.tolist()]
    if surface.closed:
        draw.polygon(flat, fill=colours[fill])
        if edge is not None:
            draw.line([*flat, flat[0], flat[1]], fill=colours[edge], width=SUPERSAMPLING, joint="curve")
    else:
        draw.line(
            flat,
            fill=colours[fill],
            width=max(SUPERSAMPLING, round(surface.width_m * viewport.px_per_m)),
            joint="curve",
        )


def _draw_route(draw: ImageDraw.ImageDraw, trace: Trace, viewport: Viewport, colour: int) -> None:
    if len(trace.route) < 2:
        return
    route = viewport.to_px(trace.route)
    width = max(SUPERSAMPLING, round(ROUTE_WIDTH_M * viewport.px_per_m))
    draw.line([tuple(point) for point in route.tolist()], fill=colour, width=width, joint="curve")
    _draw_arrow(draw, route, colour, 3.0 * width)


def _draw_arrow(
    draw: ImageDraw.ImageDraw,
    route: "np.ndarray[tuple[int, int], np.dtype[np.float64]]",
    colour: int,
    size: float,
) -> None:
    step = route[-1] - route[-2]
    length = float(np.hypot(*step))
    if length < 1e-9:
        return
    ahead = step / length
    left = np.array([-ahead[1], ahead[0]])
    tip = route[-1] + ahead * size
    corners = [tip, route[-1] + left * size * 0.7, route[-1] - left * size * 0.7]
    draw.polygon([tuple(corner.tolist()) for corner in corners], fill=colour)
