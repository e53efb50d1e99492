"""`brink compare`: thresholds, pairs and DBS of campaigns side by side, the last with their controls."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeAlias

import typer
from rich.console import Console
from rich.table import Table

from brink.api.client import Api
from brink.api.live import failures_of
from brink.cli.campaigns import ALL_GENERATIONS
from brink.cli.options import (
    AsJson,
    Database,
    Server,
    check_ids,
    console,
    place_option,
    plain_table,
    print_json,
    program,
    with_api,
)
from brink.search.analysis.confirmation import Confirmation
from brink.search.analysis.paper import D_THS, PAPER_D_THS, PAPER_T_BS
from brink.search.conclusions import Outcome
from brink.search.errors import TooManyPairs
from brink.server.api.schemas import Progress
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.errors import InvalidInput
from brink.server.findings.finding import Finding
from brink.server.findings.pairs.views import PairsView
from brink.server.findings.table import MOST_ROWS
from brink.server.findings.thresholds.views import ThresholdsView

if TYPE_CHECKING:
    from brink.search.analysis.comparison import Row

Pairs: TypeAlias = Mapping[str, PairsView | TooManyPairs]
"""The pairs of each campaign."""
Thresholds: TypeAlias = Mapping[str, Mapping[str, int]]
"""The counts of each campaign's thresholds; empty if no campaign searches for any."""
_PAIR_COLUMNS: Final = ("distinct pairs", "simulated again", "confirmed")
_THRESHOLD_COLUMNS: Final = ("thresholds", "kinds", "ends simulated again", "confirmed")
DASH: Final = "–"


def compare(
    campaigns: Annotated[
        list[str], typer.Argument(metavar="ID...", help="Ids of the campaigns.", callback=check_ids)
    ],
    control: Annotated[
        bool, typer.Option(help="Add controls: verdicts redrawn independently of the component's behaviour.")
    ] = True,
    d_th: Annotated[
        list[float] | None,
        typer.Option(
            "--d-th",
            show_default=False,
            help="Minimum distance between distinct solutions: 0.1, 0.2, 0.3, 0.4 or 0.5; may be repeated "
            "(default: the three of the paper's tables).",
        ),
    ] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Compare campaigns by what their searches are for: thresholds, pairs, or the boundary.

    Thresholds of all campaigns are counted if one of them searches for thresholds, pairs if one does not. DBS and
    strict DBS, at the paper's thresholds and each with its control, are shown for searches for the boundary.

    Example: brink compare 3f2a 91bc 77d0

    Example: brink compare 3f2a 91bc --d-th 0.2 --d-th 0.5
    """
    from brink.api.results import FetchedArchive, fetch_archive, read_all_pairs
    from brink.report.comparison import compared_archives, simulator_words

    for value in d_th or ():
        if value not in D_THS:
            raise InvalidInput.at("--d-th", f"expected one of {', '.join(map(str, D_THS))}, got {value:g}")
    unique = list(dict.fromkeys(campaigns))

    async def work(api: Api) -> tuple[list[FetchedArchive], list[Progress], Pairs, Thresholds]:
        fetched = [await fetch_archive(api, campaign) for campaign in unique]
        since = {"since": ALL_GENERATIONS}
        progress = [await api.read(Progress, f"/campaigns/{one}/progress", since) for one in unique]
        thresholds = {}
        if any(one.is_for("thresholds") for one in progress):
            thresholds = {one.id: await _read_thresholds(api, one.id) for one in progress}
        return fetched, progress, {one.id: await read_all_pairs(api, one.id) for one in progress}, thresholds

    fetched, progress, pairs, thresholds = with_api(server, database, work)
    rows, simulators = compared_archives(fetched, control=control), {one.id: one.simulator for one in fetched}
    if as_json:
        print_json(
            [
                row
                | {
                    "simulator": simulators[row["campaign"]],
                    "pairs": _counts(pairs[row["campaign"]]),
                    "thresholds": thresholds.get(row["campaign"]),
                }
                for row in rows_json(rows)
            ]
        )
        return
    screen = console()
    if words := simulator_words(fetched):
        screen.print(words, soft_wrap=True, style="yellow")
        screen.print()
    others = [one for one in progress if not one.is_for("thresholds")]
    if thresholds:
        screen.print(_table("Thresholds", progress, _THRESHOLD_COLUMNS, _threshold_cells(thresholds)))
        if others:
            screen.print(
                "A threshold takes at least eight simulations along one number, which only a search for thresholds "
                f"makes on purpose. To look for some between the sides of pairs: {program()} pairs ID --sharpen",
                soft_wrap=True,
                style="dim",
            )
        screen.print()
    if others:
        screen.print(_table("Pairs across the boundary", progress, _PAIR_COLUMNS, _pair_cells(pairs)))
        screen.print()
    boundary = {one.id for one in progress if one.is_for("boundary")}
    if shown := [row for row in rows if row.campaign in boundary]:
        print_rows(screen, shown, d_th or PAPER_D_THS)
    place = place_option(server, database)
    for one in progress:
        screen.print(f"{one.name}: {program()} findings {one.id}{place} shows what it found", soft_wrap=True)


def _counts(pairs: PairsView | TooManyPairs) -> dict[str, int] | None:
    """Return the numbers of distinct pairs by evidence; None if there are too many to tell apart."""
    if isinstance(pairs, TooManyPairs):
        return None
    names = {"distinct", "checked", "tried", "confirmed", "not_confirmed"}
    return pairs.model_dump(mode="json", include=names)


def _table(
    title: str, progress: Sequence[Progress], columns: Sequence[str], cells: Mapping[str, Sequence[str]]
) -> Table:
    columns = ("simulations", "failed", *columns)
    table = plain_table("", *columns, right=columns, title=title)
    names = [one.name for one in progress]
    for one in progress:
        label = one.name if names.count(one.name) == 1 else f"{one.name} {one.id}"
        table.add_row(label, f"{one.simulations:,}", f"{failures_of(one):,}", *cells[one.id])
    return table


def _pair_cells(pairs: Pairs) -> dict[str, tuple[str, ...]]:
    cells: dict[str, tuple[str, ...]] = {}
    for campaign, found in pairs.items():
        if (counts := _counts(found)) is None:
            cells[campaign] = ("too many to tell apart", DASH, DASH)
        else:
            confirmed = f"{counts['confirmed']:,}" if counts["tried"] else DASH
            cells[campaign] = (f"{counts['distinct']:,}", f"{counts['tried']:,}", confirmed)
    return cells


async def _read_thresholds(api: Api, campaign: str) -> dict[str, int]:
    """Return the numbers of a campaign's thresholds, of their kinds, and of those with both ends confirmed."""
    found = await api.read(Finding, f"/campaigns/{campaign}/findings/thresholds", {"rows": MOST_ROWS})
    if found.view is None:
        return dict.fromkeys(("thresholds", "kinds", "tried", "confirmed"), 0)
    view = ThresholdsView.model_validate(found.view)
    lines = [one for one in view.thresholds if one.outcome is Outcome.THRESHOLD]
    states = [one.pair.confirmation for one in lines if one.pair is not None]
    untried = states.count(Confirmation.NOT_TRIED) + states.count(Confirmation.PENDING)
    return {
        "thresholds": len(lines),
        "kinds": view.kinds,
        "tried": len(states) - untried,
        "confirmed": states.count(Confirmation.CONFIRMED),
    }


def _threshold_cells(thresholds: Thresholds) -> dict[str, tuple[str, ...]]:
    return {
        campaign: (
            f"{counts['thresholds']:,}",
            f"{counts['kinds']:,}",
            f"{counts['tried']:,}",
            f"{counts['confirmed']:,}" if counts["tried"] else DASH,
        )
        for campaign, counts in thresholds.items()
    }


def rows_json(rows: "Sequence[Row]") -> list[dict[str, Any]]:
    """Return a comparison as a JSON document."""
    return [
        {
            "campaign": row.campaign,
            "label": row.label,
            "control": row.repeats is not None,
            "behaviours_a_scenario": row.repeats,
            "unsafe_share": row.unsafe_share,
            "grid": [
                {"t_b": t, "d_th": d, "dbs": float(row.dbs[i, j]), "strict_dbs": float(row.strict[i, j])}
                for i, t in enumerate(PAPER_T_BS)
                for j, d in enumerate(D_THS)
            ],
        }
        for row in rows
    ]


def print_rows(screen: Console, rows: "Sequence[Row]", d_ths: Sequence[float] = PAPER_D_THS) -> None:
    """Print a comparison, with one table for each d_th, all of them in `D_THS`."""
    from brink.search.analysis.comparison import control_summaries
    from brink.search.analysis.scores import DRAWS

    for d_th in d_ths:
        column = D_THS.index(d_th)
        columns = ("unsafe", *(f"t_b {t_b:g}" for t_b in PAPER_T_BS))
        table = plain_table("", *columns, right=columns, title=f"d_th {d_th:g}: DBS (strict DBS)")
        for row in rows:
            cells = [
                f"{row.dbs[i, column]:.4g} ({row.strict[i, column]:.4g})" for i in range(len(PAPER_T_BS))
            ]
            label = f"{row.label} (reads low)" if row.reads_low else row.label
            table.add_row(label, f"{row.unsafe_share:.0%}", *cells)
        screen.print(table)
        screen.print()
    if any(row.repeats is not None for row in rows):
        screen.print(f"At t_b {DEFAULT_T_B:g}, d_th {DEFAULT_D_TH:g}:")
        for sentence in control_summaries(rows, DEFAULT_T_B, DEFAULT_D_TH):
            screen.print(f"  {sentence}")
        screen.print(
            f"Controls: verdicts redrawn independently of behaviour; means of {DRAWS} draws.", style="dim"
        )
    screen.print(
        "At t_b >= 1/9, DBS also counts all-safe neighbourhoods; strict DBS, a part of it, does not.",
        style="dim",
    )
