"""The result of a search: distinct solutions on the hazard boundary, and how many there are (DBS).

A solution is on the boundary if its fitness is at most t_b. Of those, sorted by fitness and then by number, each
is taken whose distance to all taken before is at least d_th.

The *strict* DBS takes only solutions for which there is evidence of a boundary: their interval contains p_th and
their neighbourhood holds both verdicts. With p_th = 0.1 enough safe neighbours and not one unsafe reach fitness 1/9,
so from t_b = 0.15 on the plain figure counts surroundings in which nothing unsafe was ever seen.

Source: Sharifi et al. 2023, post-processing and DBS; the strict DBS is ours.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.search.archive import Archive
from brink.search.component import BoolArray, FloatArray
from brink.search.metric import Points

IndexArray: TypeAlias = NDArray[np.intp]
CountArray: TypeAlias = NDArray[np.int64]

PAPER_T_BS = (0.01, 0.03, 0.05, 0.10, 0.15, 0.20)
PAPER_D_THS = (0.1, 0.2, 0.3)
PAPER_FRACTIONS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
PAPER_BUDGET = 1_300
PAPER_REPEATS = 10


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DbsGrid:
    """DBS for several thresholds.

    Attributes:
        t_bs: Largest fitness of a boundary solution, one a row.
        d_ths: Least distance between two that count, one a column.
        dbs: Distinct boundary solutions, shape ``(len(t_bs), len(d_ths))``.
        strict: Those with evidence of a boundary, same shape.
    """

    t_bs: tuple[float, ...]
    d_ths: tuple[float, ...]
    dbs: CountArray
    strict: CountArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BudgetPoint:
    """DBS as it was at a share of the budget.

    Attributes:
        fraction: Share of the budget, in (0, 1].
        simulations: Simulations that it allows.
        evaluated: Solutions evaluated by then; fewer than the simulations if some failed.
        grid: DBS with only what was known then.
    """

    fraction: float
    simulations: int
    evaluated: int
    grid: DbsGrid


def has_evidence(archive: Archive) -> BoolArray:
    """Return which solutions' intervals contain p_th with both verdicts among the neighbours."""
    p_th = archive.neighbourhood.p_th
    straddles = (archive.interval[:, 0] <= p_th) & (p_th <= archive.interval[:, 1])
    mixed = (archive.unsafe_neighbours > 0) & (archive.unsafe_neighbours < archive.neighbours)
    return straddles & mixed


def distinct_boundary(archive: Archive, t_b: float, d_th: float, strict: bool = False) -> IndexArray:
    """Return the distinct boundary solutions, as positions in the archive, best first.

    Args:
        archive: All evaluated solutions.
        t_b: Largest fitness of a boundary solution.
        d_th: Least distance between two of them.
        strict: Whether to take only solutions with evidence of a boundary.
    """
    eligible = archive.fitness <= t_b
    if strict:
        eligible &= has_evidence(archive)
    positions = np.flatnonzero(eligible)
    order = positions[np.lexsort((archive.numbers[positions], archive.fitness[positions]))]
    return _spread(archive, order, d_th)


def _spread(archive: Archive, order: IndexArray, d_th: float) -> IndexArray:
    """Return those positions that lie at least d_th from all taken before them."""
    points = archive.metric.points(archive.vectors[order])
    left = np.arange(order.size)
    taken: list[int] = []
    while left.size:
        first, left = left[:1], left[1:]
        taken.append(int(first[0]))
        left = left[_one_to_many(archive, points, first, left) >= d_th]
    return order[np.array(taken, np.intp)]


def _one_to_many(archive: Archive, points: Points, one: IndexArray, many: IndexArray) -> FloatArray:
    distances = np.empty(many.size)
    for _, columns, block in archive.metric.blocks(points.take(one), points.take(many)):
        distances[columns] = block[0]
    return distances


def dbs(archive: Archive, t_b: float, d_th: float) -> int:
    """Return the number of distinct boundary solutions."""
    return int(distinct_boundary(archive, t_b, d_th).size)


def strict_dbs(archive: Archive, t_b: float, d_th: float) -> int:
    """Return the number of distinct boundary solutions with evidence of a boundary."""
    return int(distinct_boundary(archive, t_b, d_th, strict=True).size)


def dbs_grid(
    archive: Archive, t_bs: Sequence[float] = PAPER_T_BS, d_ths: Sequence[float] = PAPER_D_THS
) -> DbsGrid:
    """Return DBS and strict DBS for all pairs of thresholds."""
    return DbsGrid(
        t_bs=tuple(t_bs),
        d_ths=tuple(d_ths),
        dbs=_counts(archive, t_bs, d_ths, strict=False),
        strict=_counts(archive, t_bs, d_ths, strict=True),
    )


def _counts(archive: Archive, t_bs: Sequence[float], d_ths: Sequence[float], *, strict: bool) -> CountArray:
    # Solutions are taken in order of fitness, so what a smaller t_b takes is the beginning of what a larger takes.
    counts = np.zeros((len(t_bs), len(d_ths)), np.int64)
    for column, d_th in enumerate(d_ths):
        taken = archive.fitness[distinct_boundary(archive, max(t_bs, default=0.0), d_th, strict)]
        counts[:, column] = [np.count_nonzero(taken <= t_b) for t_b in t_bs]
    return counts


def dbs_by_budget(
    archive: Archive,
    budget: int,
    fractions: Sequence[float] = PAPER_FRACTIONS,
    t_bs: Sequence[float] = PAPER_T_BS,
    d_ths: Sequence[float] = PAPER_D_THS,
) -> Iterator[BudgetPoint]:
    """Yield DBS at shares of the budget, each scored with only what was known then.

    Candidate numbers count simulations, failed ones included; so at a share f of the budget those solutions are
    known whose number is below f x budget, and their neighbours are counted among themselves.

    Args:
        archive: All evaluated solutions, ascending by number.
        budget: Simulations of the whole campaign.
        fractions: Shares in (0, 1], ascending.
        t_bs: Largest fitness of a boundary solution.
        d_ths: Least distance between two that count.

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
