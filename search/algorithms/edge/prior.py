"""What a search for pairs learns from the results that it starts with."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from brink.search.algorithm import Known
from brink.search.archive import Archive
from brink.search.pairs import Steps, midpoints
from brink.search.space import BoolArray, FloatArray

FEW: Final = 20
"""Solutions of each verdict below which nothing is too close to call."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prior:
    """What a search learns from known results.

    Attributes:
        rows: Possible anchors: solutions whose known results agree, shape ``(n, d)``.
        unsafe: Their verdicts, shape ``(n,)``.
        robustness: The robustness of the first known result of each, shape ``(n,)``.
        ends: Solutions that are a tight pair with another one, whether or not it holds, shape ``(m, d)``.
        middles: The middles of these pairs, shape ``(p, d)``.
    """

    rows: FloatArray
    unsafe: BoolArray
    robustness: FloatArray
    ends: FloatArray
    middles: FloatArray

    @classmethod
    def of(cls, known: Known, steps: Steps, eps: float) -> "Prior | None":
        """Return what a search learns from known results; None if there are none.

        Args:
            known: The known results.
            steps: Geometry of their space.
            eps: Largest distance of a tight pair.
        """
        if not len(known):
            return None
        _, first, which = np.unique(known.rows, axis=0, return_index=True, return_inverse=True)
        which = which.reshape(-1)
        times, unsafe = np.bincount(which), np.bincount(which, weights=known.unsafe)
        agree = np.sort(first[(unsafe == 0) | (unsafe == times)])
        sides = _tight_sides(known, steps, eps)
        return cls(
            rows=known.rows[agree],
            unsafe=known.unsafe[agree],
            robustness=known.robustness[agree],
            ends=np.concatenate(sides),
            middles=midpoints(*sides, steps.space),
        )


def _tight_sides(known: Known, steps: Steps, eps: float) -> tuple[FloatArray, FloatArray]:
    """Return the sides of tight pairs among known results: each unsafe one with the safe one nearest to it.

    Returns:
        The safe and the unsafe sides, both of shape ``(p, d)``.
    """
    safe, unsafe = known.rows[~known.unsafe], known.rows[known.unsafe]
    if not len(safe) or not len(unsafe):
        return known.rows[:0], known.rows[:0]
    distances = steps.metric.between(unsafe, safe)
    nearest = distances.argmin(axis=1)
    close = np.flatnonzero(distances[np.arange(len(unsafe)), nearest] <= steps.largest_tight(eps))
    places = [p for p in close.tolist() if steps.is_tight(safe[nearest[p]], unsafe[p], eps)]
    return safe[nearest[places]], unsafe[places]


def least_clear(archive: Archive, known: Known, margin: float) -> tuple[float, float]:
    """Return the least absolute robustness at which a safe and an unsafe solution are not too close to call."""
    size = np.abs(np.concatenate([archive.robustness, known.robustness]))
    unsafe = np.concatenate([archive.unsafe, known.unsafe])

    def least(mine: FloatArray) -> float:
        return float(np.quantile(mine, margin)) if len(mine) >= FEW else 0.0

    return least(size[~unsafe]), least(size[unsafe])
