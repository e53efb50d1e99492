"""How the world's metres become pixels of the map: one rotation an episode, so that the drive goes to the right."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from brink.sim.replay.geometry import Points
from brink.sim.trace import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Viewport:
    """An affine map from world coordinates to pixels.

    Attributes:
        px_per_m: Scale.
        turn_rad: The world is turned by this, counter-clockwise, before it is drawn.
        left_m: Least x of the turned world that is on the canvas.
        top_m: Greatest y of the turned world that is on the canvas.
        size_px: Width and height of the canvas.
    """

    px_per_m: float
    turn_rad: float
    left_m: float
    top_m: float
    size_px: tuple[int, int]

    @classmethod
    def along(
        cls, route: FloatArray, ego: FloatArray, *, px_per_m: float, margin_m: tuple[float, float]
    ) -> Self:
        """Return the canvas around everywhere the ego is, turned so that its first heading points to the right.

        Args:
            route: The route, shape ``(k, 2)``.
            ego: The ego's poses, shape ``(n, 5)``.
            px_per_m: Scale.
            margin_m: How far the canvas reaches beyond the ego's places, across and up.
        """
        turn_rad = -float(ego[0, 2])
        places = np.asarray(ego[:, :2], dtype=np.float64)
        if len(route) > 1:
            # The first heading is that of the road, which a swerve in the first sample must not turn.
            nearest = int(np.hypot(*(route - ego[0, :2]).T).argmin())
            start = min(nearest, len(route) - 2)
            step = route[start + 1] - route[start]
            turn_rad = -float(np.arctan2(step[1], step[0]))
        turned = _turned(places, turn_rad)
        low = turned.min(axis=0) - margin_m
        high = turned.max(axis=0) + margin_m
        width, height = np.ceil((high - low) * px_per_m).astype(int)
        return cls(
            px_per_m=px_per_m,
            turn_rad=turn_rad,
            left_m=float(low[0]),
            top_m=float(high[1]),
            size_px=(int(width), int(height)),
        )

    def to_px(self, points: Points | FloatArray) -> Points:
        """Return world coordinates as pixels of the canvas, shape ``(k, 2)``."""
        turned = _turned(np.asarray(points, dtype=np.float64), self.turn_rad)
        return (turned - (self.left_m, self.top_m)) * (self.px_per_m, -self.px_per_m)


def _turned(points: Points, turn_rad: float) -> Points:
    cosine, sine = np.cos(turn_rad), np.sin(turn_rad)
    turned: Points = points @ np.array([[cosine, sine], [-sine, cosine]])
    return turned
