"""The distinct boundary solutions of a campaign."""

from collections.abc import Collection, Sequence
from typing import Final

import numpy as np
from sqlalchemy import Connection

from brink.search.analysis.boundary import DbsGrid, has_evidence
from brink.search.archive import Archive
from brink.search.odd import with_odd
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.boundaries import CampaignBoundary
from brink.server.campaigns.store import Campaign
from brink.server.findings.boundary.views import Boundary, BudgetBoundary, DbsCell, KnownBoundary
from brink.server.findings.solutions import solutions_of
from brink.server.findings.sources import Sources
from brink.server.findings.table import Column, Format, Table
from brink.server.findings.words import listed_words
from brink.server.views import SolutionView

COLUMNS: Final = [
    Column(name="number", title="solution", format=Format.SOLUTION),
    Column(name="strict", title="strict", below=True),
    Column(name="verdict", title="verdict", format=Format.STATE),
    Column(name="outcome", title="outcome", below=True),
    Column(name="fitness", title="fitness", format=Format.NUMBER),
    Column(name="robustness", title="robustness", format=Format.NUMBER),
    Column(name="unsafe_neighbours", title="unsafe neighbours", format=Format.COUNT),
    Column(name="neighbours", title="of", format=Format.COUNT),
    Column(name="interval", title="interval of the unsafe share", below=True),
    Column(name="words", title="description"),
]


async def find_boundary(
    sources: Sources, campaign: Campaign, *, t_b: float, d_th: float, limit: int
) -> Boundary:
    """Return the distinct boundary solutions of a campaign, best fitness first; see `boundary_view`.

    Raises:
        InvalidInput: Too many solutions would have to be compared with each other.
    """
    read = await sources.archives.get(campaign)
    boundary = await sources.boundaries.get(campaign, read, t_b, d_th)
    grid = await sources.boundaries.grid(campaign, read)
    return await sources.pages.read(
        sources.engines,
        lambda c: boundary_view(c, campaign, read, boundary, grid, t_b=t_b, d_th=d_th, limit=limit),
    )


def boundary_view(
    connection: Connection,
    campaign: Campaign,
    read: ReadArchive,
    boundary: CampaignBoundary,
    grid: DbsGrid,
    *,
    t_b: float,
    d_th: float,
    limit: int,
) -> Boundary:
    """Return the distinct boundary solutions of a campaign, best fitness first.

    Args:
        connection: Read connection.
        campaign: The campaign.
        read: Its archive.
        boundary: Its boundary at the thresholds.
        grid: DBS at all thresholds.
        t_b: Maximum fitness of a boundary solution.
        d_th: Minimum distance between two boundary solutions.
        limit: Maximum number of solutions to list.
    """
    archive, chosen = read.archive, boundary.chosen
    is_strict = has_evidence(archive)[chosen]
    numbers = [int(number) for number in archive.numbers[chosen[:limit]]]
    return Boundary(
        t_b=t_b,
        d_th=d_th,
        dbs=boundary.counts.dbs,
        strict_dbs=boundary.counts.strict,
        words=listed_words(len(numbers), len(chosen)),
        note=boundary_note(campaign, read, boundary, t_b),
        grid=[
            DbsCell(t_b=t, d_th=d, dbs=int(grid.dbs[row, column]), strict_dbs=int(grid.strict[row, column]))
            for row, t in enumerate(grid.t_bs)
            for column, d in enumerate(grid.d_ths)
        ],
        solutions=solutions_of(connection, campaign, read, numbers, full=True, rated=True),
        strict=[number for number, strict in zip(numbers, is_strict[:limit], strict=True) if strict],
        within_budget=_within_budget(campaign, archive, boundary),
        with_known=_with_known(read, boundary),
    )


def boundary_table(
    solutions: Sequence[SolutionView], strict: Collection[int], distinct: int, file: str
) -> Table:
    """Return boundary solutions as a table.

    Args:
        solutions: The solutions, best first.
        strict: Numbers of those that the strict DBS counts.
        distinct: How many there are.
        file: Path of a file with all their parameters.
    """
    return Table(
        name="boundary",
        title="Distinct boundary solutions, best first",
        columns=COLUMNS,
        rows=[
            [
                one.number,
                "strict" if one.number in strict else "",
                str(one.verdict),
                one.outcome,
                one.fitness,
                one.robustness,
                one.unsafe_neighbours,
                one.neighbours,
                "{:.0%} to {:.0%}".format(*one.interval) if one.interval else "",
                one.words,
            ]
            for one in solutions
        ],
        left_out=distinct - len(solutions),
        file=file,
    )


def grid_table(grid: DbsGrid) -> Table:
    """Return DBS and strict DBS over the paper's thresholds as a table, with a row for each distance."""
    return Table(
        name="thresholds",
        title="DBS (strict DBS) at other thresholds",
        columns=[
            Column(name="d_th", title="d_th", format=Format.NUMBER),
            *(Column(name=f"t_b {t_b:g}", title=f"t_b {t_b:g}") for t_b in grid.t_bs),
        ],
        rows=[
            [
                d_th,
                *(f"{grid.dbs[row, column]} ({grid.strict[row, column]})" for row in range(len(grid.t_bs))),
            ]
            for column, d_th in enumerate(grid.d_ths)
        ],
    )


def boundary_words(distinct: int, strict: int, *, t_b: float, d_th: float) -> str:
    """Count boundary solutions in words, such as ``3 distinct boundary solutions (…), 1 of them strict``."""
    noun = "solution" if distinct == 1 else "solutions"
    return (
        f"{distinct} distinct boundary {noun} (fitness at most {t_b:g}, at least {d_th:g} apart), {strict} of them "
        "strict"
    )


def _within_budget(campaign: Campaign, archive: Archive, boundary: CampaignBoundary) -> BudgetBoundary | None:
    """Return the boundary without the simulations beyond the budget; None if there are none."""
    if boundary.within is None:
        return None
    beyond = len(archive) - int(np.searchsorted(archive.numbers, campaign.budget))
    return BudgetBoundary(
        simulations=campaign.budget, beyond=beyond, dbs=boundary.within.dbs, strict_dbs=boundary.within.strict
    )


def _with_known(read: ReadArchive, boundary: CampaignBoundary) -> KnownBoundary | None:
    """Return the boundary with the known results; None if the campaign did not start from any."""
    if boundary.with_known is None:
        return None
    return KnownBoundary(
        results=len(read.known), dbs=boundary.with_known.dbs, strict_dbs=boundary.with_known.strict
    )


def boundary_note(campaign: Campaign, read: ReadArchive, boundary: CampaignBoundary, t_b: float) -> str:
    """Return how to read DBS at this threshold, in sentences."""
    within, known = _within_budget(campaign, read.archive, boundary), _with_known(read, boundary)
    p_th = read.plan.neighbourhood.p_th
    all_safe = p_th / max(p_th, 1 - p_th)
    note = (
        "Strict DBS counts only those whose interval contains p_th and whose neighbourhood has both verdicts."
    )
    if t_b >= all_safe:
        note = (
            f"At t_b {t_b:g}, DBS also counts neighbourhoods without a single unsafe solution (their fitness falls "
            f"to {all_safe:.3f}); strict DBS does not."
        )
    if within is not None:
        note += (
            f" Without the {within.beyond:,} solutions beyond the budget of {within.simulations:,} simulations, as "
            f"in comparisons: {within.dbs} distinct, {within.strict_dbs} strict."
        )
    if known is not None:
        note += (
            f" Together with the {known.results:,} known results that the campaign started from: {known.dbs} "
            f"distinct, {known.strict_dbs} strict."
        )
    return with_odd(note, read.plan.problem.space)
