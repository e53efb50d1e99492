"""`brink compare`: pairs and DBS of campaigns side by side, each with its control."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from brink.api.client import Api
from brink.api.live import failures_of
from brink.api.results import FetchedArchive, fetch_archive, read_all_pairs
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
from brink.report.comparison import compared_archives, simulator_words
from brink.search.analysis.comparison import Row, control_summaries
from brink.search.analysis.paper import D_THS, PAPER_D_THS, PAPER_T_BS
from brink.search.analysis.scores import DRAWS
from brink.search.errors import TooManyPairs
from brink.server.api.schemas import Progress
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.errors import InvalidInput
from brink.server.findings.pairs.views import PairsView


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
    """Compare campaigns: their pairs, and DBS and strict DBS at the paper's thresholds, each with its control.

    DBS is shown for campaigns that search for the boundary it measures, not for searches for pairs.

    Example: brink compare 3f2a 91bc 77d0

    Example: brink compare 3f2a 91bc --d-th 0.2 --d-th 0.5
    """
    for value in d_th or ():
        if value not in D_THS:
            raise InvalidInput.at("--d-th", f"expected one of {', '.join(map(str, D_THS))}, got {value:g}")
    unique = list(dict.fromkeys(campaigns))

    async def work(
        api: Api,
    ) -> tuple[list[FetchedArchive], list[Progress], dict[str, PairsView | TooManyPairs]]:
        fetched = [await fetch_archive(api, campaign) for campaign in unique]
        since = {"since": ALL_GENERATIONS}
        progress = [await api.read(Progress, f"/campaigns/{one}/progress", since) for one in unique]
        return fetched, progress, {one.id: await read_all_pairs(api, one.id) for one in progress}

    fetched, progress, pairs = with_api(server, database, work)
    rows, simulators = compared_archives(fetched, control=control), {one.id: one.simulator for one in fetched}
    if as_json:
        print_json(
            [
                row | {"simulator": simulators[row["campaign"]], "pairs": _counts(pairs[row["campaign"]])}
                for row in rows_json(rows)
            ]
        )
        return
    screen = console()
    if words := simulator_words(fetched):
        screen.print(words, soft_wrap=True, style="yellow")
        screen.print()
    screen.print(_pairs_table(progress, pairs))
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


def _pairs_table(progress: Sequence[Progress], pairs: Mapping[str, PairsView | TooManyPairs]) -> Table:
    columns = ("simulations", "failed", "distinct pairs", "simulated again", "confirmed")
    table = plain_table("", *columns, right=columns, title="Pairs across the boundary")
    names = [one.name for one in progress]
    for one in progress:
        label = one.name if names.count(one.name) == 1 else f"{one.name} {one.id}"
        cells = f"{one.simulations:,}", f"{failures_of(one):,}"
        if (counts := _counts(pairs[one.id])) is None:
            table.add_row(label, *cells, "too many to tell apart", "–", "–")
        else:
            confirmed = f"{counts['confirmed']:,}" if counts["tried"] else "–"
            table.add_row(label, *cells, f"{counts['distinct']:,}", f"{counts['tried']:,}", confirmed)
    return table


def rows_json(rows: Sequence[Row]) -> list[dict[str, Any]]:
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


def print_rows(screen: Console, rows: Sequence[Row], d_ths: Sequence[float] = PAPER_D_THS) -> None:
    """Print a comparison, with one table for each d_th, all of them in `D_THS`."""
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
