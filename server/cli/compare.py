"""`brink compare`: DBS tables of campaigns side by side, with their controls."""

from collections.abc import Sequence
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from search.boundary import PAPER_D_THS, PAPER_T_BS
from server.bench.comparison import DRAWS, ComparedCampaign, Row
from server.bench.comparison import compare as compare_campaigns
from server.cli.api import Api
from server.cli.options import AsJson, Database, Server, console, print_json, with_api
from server.cli.pictures import fetch_archive


def compare(
    campaigns: Annotated[list[str], typer.Argument(metavar="ID...", help="Campaigns to compare.")],
    control: Annotated[
        bool, typer.Option(help="Add controls: verdicts that ignore the component's behaviour.")
    ] = True,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Compare campaigns: DBS and strict DBS for the paper's thresholds, beside controls.

    Example: brink compare 3f2a 91bc 77d0
    """
    rows = with_api(server, database, lambda api: compared(api, campaigns, control=control))
    if as_json:
        print_json(rows_json(rows))
    else:
        print_rows(console(), rows)


async def compared(api: Api, campaigns: Sequence[str], *, control: bool) -> list[Row]:
    """Return the comparison of some campaigns."""
    fetched = [await fetch_archive(api, campaign) for campaign in campaigns]
    names = [item.body.name for item in fetched]
    labels = (
        names
        if len(set(names)) == len(names)
        else [f"{n} {c}" for n, c in zip(names, campaigns, strict=True)]
    )
    return compare_campaigns(
        [
            ComparedCampaign(label=label, body=item.body, plan=item.plan, archive=item.archive)
            for label, item in zip(labels, fetched, strict=True)
        ],
        control=control,
    )


def rows_json(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return a comparison for programs."""
    return [
        {
            "label": row.label,
            "unsafe_share": row.unsafe_share,
            "grid": [
                {"t_b": t, "d_th": d, "dbs": float(row.dbs[i, j]), "strict_dbs": float(row.strict[i, j])}
                for i, t in enumerate(PAPER_T_BS)
                for j, d in enumerate(PAPER_D_THS)
            ],
        }
        for row in rows
    ]


def print_rows(screen: Console, rows: Sequence[Row]) -> None:
    """Print a comparison for people: one table a d_th."""
    for column, d_th in enumerate(PAPER_D_THS):
        table = Table(
            title=f"d_th {d_th:g}: DBS (strict DBS)", title_justify="left", box=None, pad_edge=False
        )
        table.add_column("")
        table.add_column("unsafe", justify="right", header_style="dim")
        for t_b in PAPER_T_BS:
            table.add_column(f"t_b {t_b:g}", justify="right", header_style="dim")
        for row in rows:
            cells = [
                f"{row.dbs[i, column]:.4g} ({row.strict[i, column]:.4g})" for i in range(len(PAPER_T_BS))
            ]
            table.add_row(row.label, f"{row.unsafe_share:.0%}", *cells)
        screen.print(table)
        screen.print()
    screen.print(
        f"[dim]Controls have verdicts that ignore behaviour; means over {DRAWS} draws. t_b >= 1/9 counts all-safe "
        "neighbourhoods as boundary; strict DBS does not.[/dim]"
    )
