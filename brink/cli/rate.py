"""`brink rate`: how often drives are unsafe in operation, with an interval that holds."""

from pathlib import Path
from typing import Annotated, Any

import typer

from brink.api.client import Api
from brink.api.terminal import echo
from brink.cli.findings import show_kind
from brink.cli.options import AsJson, CampaignId, Database, Server, check_picture, print_json, with_api
from brink.report.rate import draw_rate
from brink.server.errors import InvalidInput
from brink.server.findings.finding import Finding
from brink.server.findings.table import FORMATS


def rate(
    campaign: CampaignId,
    by: Annotated[
        str | None,
        typer.Option(
            help="Categories to tell apart, such as scenario.weather,scenario.time_of_day; + crosses them. By "
            "default those of the distribution."
        ),
    ] = None,
    at_most: Annotated[
        float | None,
        typer.Option(help="Claim to check: the largest acceptable rate. By default the campaign's."),
    ] = None,
    confidence: Annotated[
        float | None,
        typer.Option(help="Confidence of intervals and claim. By default the campaign's, or 0.95."),
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Draw the interval against simulations (.png, .svg or .pdf).")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="File to write (.csv, .jsonl or .parquet).")] = None,
    table: Annotated[
        str | None, typer.Option(help="Table to write: rates, strata or looks. By default rates.")
    ] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Show how often drives are unsafe in operation, from a campaign of rate@1 or random@1.

    The first interval holds at every number of simulations at once, so that one may stop whenever it is good enough.

    Example: brink rate 3f2a

    Example: brink rate 3f2a --at-most 0.01 --by scenario.weather+scenario.time_of_day

    Example: brink rate 3f2a --picture rate.png
    """
    if picture is not None:
        check_picture(picture)
    form = "" if out is None else out.suffix.removeprefix(".")
    if out is not None and form not in FORMATS:
        raise InvalidInput.at("--out", f"{out}: expected a name that ends in .csv, .jsonl or .parquet")
    given: dict[str, Any] = {"by": by, "at_most": at_most, "confidence": confidence}
    settings = {name: value for name, value in given.items() if value is not None}
    path = f"/campaigns/{campaign}/findings/rate"

    async def work(api: Api) -> None:
        if out is not None:
            params = {**settings, "format": form} | ({"table": table} if table else {})
            out.write_bytes((await api.request("GET", path, params=params)).content)
            echo(out)
        if picture is not None:
            draw_rate(await api.read(Finding, path, settings), picture)
            echo(picture)
        if out is not None or picture is not None:
            return
        if as_json:
            print_json(await api.get(path, settings))
        else:
            await show_kind(api, campaign, "rate", settings)

    with_api(server, database, work)
