"""How much a boundary depends on what it was scored with: the radius of neighbourhoods, and the probability sought.

The same evaluated solutions are scored again. What the search would have evaluated with other settings is another
question, which takes other searches: it was steered by the settings that it had, and its archive is densest where
these put the boundary.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from brink.search.archive import Archive
from brink.search.boundary import dbs, strict_dbs

RADII: Final = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5)
P_THS: Final = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rescored:
    """What a boundary is with other settings.

    Attributes:
        radius: Largest distance of a neighbour (delta).
        p_th: Probability of unsafe on the boundary.
        neighbours: Median number of neighbours, each solution counted among its own.
        near: Solutions with a fitness of at most t_b.
        dbs: Distinct ones among them.
        strict_dbs: Strict distinct ones.
    """

    radius: float
    p_th: float
    neighbours: float
    near: int
    dbs: int
    strict_dbs: int


def rescored(archive: Archive, *, radius: float | None = None, p_th: float | None = None) -> Archive:
    """Return the archive of the same solutions and verdicts with another radius or probability.

    Args:
        archive: What was evaluated.
        radius: Largest distance of a neighbour, >= 0; as it is if None.
        p_th: Probability of unsafe on the boundary, in (0, 1); as it is if None.

    Raises:
        ValueError: A setting is out of range.
    """
    near = archive.neighbourhood
    wanted = replace(
        near, radius=near.radius if radius is None else radius, p_th=near.p_th if p_th is None else p_th
    )
    if wanted.radius == near.radius:  # neighbours stay what they are
        return Archive.restore(
            archive.metric, wanted, numbers=archive.numbers, vectors=archive.vectors, unsafe=archive.unsafe,
            robustness=archive.robustness, neighbours=archive.neighbours,
            unsafe_neighbours=archive.unsafe_neighbours,
        )  # fmt: skip
    return Archive.empty(archive.metric, wanted).grown(
        archive.numbers, archive.vectors, archive.unsafe, archive.robustness, keep_rows=False
    )


def by_radius(archive: Archive, radii: Sequence[float], *, t_b: float, d_th: float) -> list[Rescored]:
    """Return what the boundary is with other radii."""
    return [_rescored(rescored(archive, radius=radius), t_b, d_th) for radius in radii]


def by_p_th(archive: Archive, p_ths: Sequence[float], *, t_b: float, d_th: float) -> list[Rescored]:
    """Return what the boundary is with other probabilities of unsafe on it."""
    return [_rescored(rescored(archive, p_th=p_th), t_b, d_th) for p_th in p_ths]


def _rescored(archive: Archive, t_b: float, d_th: float) -> Rescored:
    return Rescored(
        radius=archive.neighbourhood.radius, p_th=archive.neighbourhood.p_th,
        neighbours=float(np.median(archive.neighbours)) if len(archive) else 0.0,
        near=int((archive.fitness <= t_b).sum()), dbs=dbs(archive, t_b, d_th),
        strict_dbs=strict_dbs(archive, t_b, d_th),
    )  # fmt: skip
