"""The result of a search: the distinct solutions on the hazard boundary, and their number (DBS).

A solution is on the boundary if its fitness is at most t_b. Boundary solutions are taken in the order of fitness and
then number, each if its distance to all those taken before is at least d_th.

The *strict* DBS counts those of the distinct boundary solutions that have evidence of a boundary: their interval
contains p_th, and their neighbourhood holds both verdicts. It is a part of DBS by definition; a separate selection
among the solutions with evidence could exceed DBS, because both would be greedy. With p_th = 0.1, sufficiently many
safe neighbours without a single unsafe one reach fitness 1/9, so from t_b = 0.15 on the plain DBS also counts
neighbourhoods in which nothing unsafe was seen.

`by_radius` and `by_p_th` show how the figures depend on the settings they are computed with. They rescore the same
evaluated solutions. They cannot tell what a search with other settings would have evaluated: the search was guided by
its own settings, and its archive is densest where those put the boundary.

Source: Sharifi et al. 2023, post-processing and DBS; the strict DBS is ours.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.search.analysis.paper import PAPER_D_THS, PAPER_FRACTIONS, PAPER_T_BS
from brink.search.archive import ARRAYS, Archive
from brink.search.errors import BoundaryTooLarge
from brink.search.metric import Points
from brink.search.space import BoolArray, IntArray

IndexArray: TypeAlias = NDArray[np.intp]


MOST_COST: Final = 2_000_000_000
"""Cost of one request: a few seconds. Each distance costs its number of dimensions and `_OVERHEAD`, so 9,000
solutions in 40 dimensions never cost more."""
_OVERHEAD: Final = 8
_BLOCK: Final = 256
"""Solutions looked at in one go; bounds the memory."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DbsGrid:
    """DBS for several thresholds.

    Attributes:
        t_bs: Maximum fitness of a boundary solution, one per row.
        d_ths: Minimum distance between two distinct solutions, one per column.
        dbs: DBS, shape ``(len(t_bs), len(d_ths))``.
        strict: Strict DBS, same shape.
    """

    t_bs: tuple[float, ...]
    d_ths: tuple[float, ...]
    dbs: IntArray
    strict: IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BudgetPoint:
    """DBS at a share of the budget.

    Attributes:
        fraction: Share of the budget, in (0, 1].
        simulations: Number of simulations in that share.
        evaluated: Solutions evaluated by then; fewer than the simulations if some failed.
        grid: DBS of those solutions alone.
    """

    fraction: float
    simulations: int
    evaluated: int
    grid: DbsGrid


def has_evidence(archive: Archive) -> BoolArray:
    """Return which solutions have evidence of a boundary, shape ``(n,)``: an interval with p_th, both verdicts."""
    p_th = archive.neighbourhood.p_th
    straddles = (archive.interval[:, 0] <= p_th) & (p_th <= archive.interval[:, 1])
    mixed = (archive.unsafe_neighbours > 0) & (archive.unsafe_neighbours < archive.neighbours)
    return straddles & mixed


def distinct_boundary(
    archive: Archive, t_b: float, d_th: float, strict: bool = False, *, most_cost: int | None = None
) -> IndexArray:
    """Return the distinct boundary solutions as positions in the archive, best first.

    Args:
        archive: The evaluated solutions.
        t_b: Maximum fitness of a boundary solution.
        d_th: Minimum distance between two boundary solutions.
        strict: Whether to return only those of them that have evidence of a boundary.
        most_cost: Maximum cost; see `MOST_COST`. None for no limit.

    Raises:
        BoundaryTooLarge: It costs more.
    """
    positions = np.flatnonzero(archive.fitness <= t_b)
    order = positions[np.lexsort((archive.numbers[positions], archive.fitness[positions]))]
    try:
        taken = _spread(archive, order, d_th, most_cost)
    except BoundaryTooLarge:
        raise BoundaryTooLarge(
            f"{order.size:,} solutions have a fitness of at most t_b {t_b:g}, and too many of them are at least d_th "
            f"{d_th:g} apart to compare them all: choose a larger d_th or a smaller t_b"
        ) from None
    return taken[has_evidence(archive)[taken]] if strict else taken


def _spread(archive: Archive, order: IndexArray, d_th: float, most_cost: int | None) -> IndexArray:
    """Return the positions that greedy selection in the given order keeps, each at least d_th from all before it.

    Raises:
        BoundaryTooLarge: Comparing blocks of solutions costs more than `most_cost`.
    """
    if d_th <= 0:
        return order
    points = archive.metric.points(archive.vectors[order])
    taken, cost = np.empty(0, np.intp), 0
    for begin in range(0, order.size, _BLOCK):
        left = np.arange(begin, min(begin + _BLOCK, order.size))
        cost += left.size * taken.size * (archive.metric.dimension + _OVERHEAD)
        if most_cost is not None and cost > most_cost:
            raise BoundaryTooLarge
        left = left[_are_apart(archive, points.take(left), points.take(taken), d_th)]
        taken = np.concatenate([taken, left[_greedy(_near(archive, points.take(left), d_th))]])
    return order[taken]


def _are_apart(archive: Archive, some: Points, others: Points, d_th: float) -> BoolArray:
    """Return which of some points are at least d_th from all of the others, shape ``(len(some),)``."""
    apart = np.ones(len(some), np.bool_)
    for rows, _, block in archive.metric.blocks(some, others):
        apart[rows] &= (block >= d_th).all(axis=1)
    return apart


def _near(archive: Archive, points: Points, d_th: float) -> BoolArray:
    """Return which of some points are less than d_th apart, shape ``(len(points), len(points))``."""
    near = np.empty((len(points), len(points)), np.bool_)
    for rows, columns, block in archive.metric.blocks(points, points):
        near[rows, columns] = block < d_th
    return near


def _greedy(near: BoolArray) -> IndexArray:
    """Return the positions that a greedy selection in order keeps, skipping any near an earlier one."""
    is_left, taken = np.ones(len(near), np.bool_), []
    for place in range(len(near)):
        if is_left[place]:
            taken.append(place)
            is_left &= ~near[place]
    return np.array(taken, np.intp)


def dbs(archive: Archive, t_b: float, d_th: float) -> int:
    """Return the number of distinct boundary solutions.

    Args:
        archive: The evaluated solutions.
        t_b: Maximum fitness of a boundary solution.
        d_th: Minimum distance between two boundary solutions.
    """
    return int(distinct_boundary(archive, t_b, d_th).size)


def strict_dbs(archive: Archive, t_b: float, d_th: float) -> int:
    """Return the number of distinct boundary solutions with evidence of a boundary.

    Args:
        archive: The evaluated solutions.
        t_b: Maximum fitness of a boundary solution.
        d_th: Minimum distance between two boundary solutions.
    """
    return int(distinct_boundary(archive, t_b, d_th, strict=True).size)


def dbs_grid(
    archive: Archive,
    t_bs: Sequence[float] = PAPER_T_BS,
    d_ths: Sequence[float] = PAPER_D_THS,
    *,
    most_cost: int | None = None,
) -> DbsGrid:
    """Return DBS and strict DBS for all pairs of thresholds.

    Args:
        archive: The evaluated solutions.
        t_bs: Maximum fitness of a boundary solution.
        d_ths: Minimum distance between two boundary solutions.
        most_cost: Maximum cost of each of the `d_ths`; see `MOST_COST`. The first one, from the largest on,
            that costs more is left out of the grid, with all smaller ones. None for no limit.
    """
    evidence = has_evidence(archive)
    counts: dict[float, list[tuple[int, int]]] = {}
    for d_th in sorted(set(d_ths), reverse=True):  # the smaller, the more solutions are distinct
        # Solutions are taken in the order of fitness: those of a smaller t_b are the first of those of a larger one.
        try:
            taken = distinct_boundary(archive, max(t_bs, default=0.0), d_th, most_cost=most_cost)
        except BoundaryTooLarge:
            break
        near = [taken[archive.fitness[taken] <= t_b] for t_b in t_bs]
        counts[d_th] = [(place.size, int(np.count_nonzero(evidence[place]))) for place in near]
    counted = tuple(d_th for d_th in d_ths if d_th in counts)
    both = np.array([counts[d_th] for d_th in counted], np.int64).reshape(len(counted), len(t_bs), 2)
    return DbsGrid(t_bs=tuple(t_bs), d_ths=counted, dbs=both[:, :, 0].T, strict=both[:, :, 1].T)


def dbs_by_budget(
    archive: Archive,
    budget: int,
    fractions: Sequence[float] = PAPER_FRACTIONS,
    t_bs: Sequence[float] = PAPER_T_BS,
    d_ths: Sequence[float] = PAPER_D_THS,
) -> Iterator[BudgetPoint]:
    """Yield DBS at shares of the budget, each computed from the solutions known at that time.

    Candidate numbers count simulations, including failed ones. At a share f of the budget, the solutions with a
    number below f x budget are known, and only they count as neighbours.

    Args:
        archive: The evaluated solutions, ascending by number.
        budget: Simulations of the whole campaign.
        fractions: Shares in (0, 1], ascending.
        t_bs: Maximum fitness of a boundary solution.
        d_ths: Minimum distance between two boundary solutions.

    Raises:
        ValueError: The fractions do not ascend in (0, 1], or the archive does not ascend by number.
    """
    shares = np.asarray(fractions, np.float64)
    if not ((shares > 0).all() and (shares <= 1).all() and (np.diff(shares) > 0).all()):
        raise ValueError(f"fractions: expected ascending numbers in (0, 1], got {list(fractions)}")
    if (np.diff(archive.numbers) <= 0).any():
        raise ValueError("archive: expected solutions ascending by number")
    known = Archive.empty(archive.metric, archive.neighbourhood)
    for fraction in shares.tolist():
        simulations = round(fraction * budget)
        part = slice(len(known), int(np.searchsorted(archive.numbers, simulations)))
        known = known.grown(
            archive.numbers[part],
            archive.vectors[part],
            archive.unsafe[part],
            archive.robustness[part],
            keep_rows=False,
        )
        yield BudgetPoint(
            fraction=fraction,
            simulations=simulations,
            evaluated=len(known),
            grid=dbs_grid(known, t_bs, d_ths),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Rescored:
    """The boundary of an archive, rescored with other settings.

    Attributes:
        radius: Maximum distance of a neighbour (delta).
        p_th: Unsafe probability that defines the boundary.
        neighbours: Median number of solutions in a neighbourhood.
        near: Solutions with a fitness of at most t_b.
        dbs: DBS.
        strict_dbs: Strict DBS.
    """

    radius: float
    p_th: float
    neighbours: float
    near: int
    dbs: int
    strict_dbs: int


def rescored(archive: Archive, *, radius: float | None = None, p_th: float | None = None) -> Archive:
    """Return an archive of the same solutions and verdicts with another radius or probability.

    Args:
        archive: The evaluated solutions.
        radius: Maximum distance of a neighbour, >= 0; None keeps that of the archive.
        p_th: Unsafe probability that defines the boundary, in (0, 1); None keeps that of the archive.

    Raises:
        ValueError: A setting is out of range.
    """
    near = archive.neighbourhood
    wanted = replace(
        near, radius=near.radius if radius is None else radius, p_th=near.p_th if p_th is None else p_th
    )
    if wanted.radius == near.radius:  # the counts stay the same
        return Archive.restore(archive.metric, wanted, **{name: getattr(archive, name) for name in ARRAYS})
    return Archive.empty(archive.metric, wanted).grown(
        archive.numbers, archive.vectors, archive.unsafe, archive.robustness, keep_rows=False
    )


def by_radius(archive: Archive, radii: Sequence[float], *, t_b: float, d_th: float) -> list[Rescored]:
    """Return the boundary for each of several radii.

    Args:
        archive: The evaluated solutions.
        radii: Maximum distances of a neighbour, >= 0.
        t_b: Maximum fitness of a boundary solution.
        d_th: Minimum distance between two boundary solutions.

    Raises:
        ValueError: A radius is out of range.
    """
    return [_summary(rescored(archive, radius=radius), t_b, d_th) for radius in radii]


def by_p_th(archive: Archive, p_ths: Sequence[float], *, t_b: float, d_th: float) -> list[Rescored]:
    """Return the boundary for each of several unsafe probabilities p_th.

    Args:
        archive: The evaluated solutions.
        p_ths: Unsafe probabilities that define the boundary, in (0, 1).
        t_b: Maximum fitness of a boundary solution.
        d_th: Minimum distance between two boundary solutions.

    Raises:
        ValueError: A probability is out of range.
    """
    return [_summary(rescored(archive, p_th=p_th), t_b, d_th) for p_th in p_ths]


def _summary(archive: Archive, t_b: float, d_th: float) -> Rescored:
    return Rescored(
        radius=archive.neighbourhood.radius,
        p_th=archive.neighbourhood.p_th,
        neighbours=float(np.median(archive.neighbours)) if len(archive) else 0.0,
        near=int((archive.fitness <= t_b).sum()),
        dbs=dbs(archive, t_b, d_th),
        strict_dbs=strict_dbs(archive, t_b, d_th),
    )
