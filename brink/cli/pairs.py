"""`brink pairs`: pairs of drives across the boundary, one safe and one unsafe, and the change between them."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from brink.api.client import Api
from brink.cli.options import AsJson, CampaignId, Database, Server, console, plain_table, print_json, with_api
from brink.cli.pair_pictures import FILMS, PICTURES, check_file, chosen_pair, draw_pair
from brink.server.api.pairs import MOST_PAIRS, PairsView, PairView
from brink.server.errors import InvalidInput

PAIRS_SHOWN = 20


class Format(StrEnum):
    """How pairs are written."""

    TABLE = "table"
    CSV = "csv"
    JSONL = "jsonl"
    PARQUET = "parquet"


def pairs(
    campaign: CampaignId,
    eps: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            max=1.0,
            show_default=False,
            help="Largest distance between the sides of a pair (default: that of edge@1, else 0.02).",
        ),
    ] = None,
    d_th: Annotated[
        float | None,
        typer.Option(
            "--d-th",
            min=0.0,
            max=1.0,
            show_default=False,
            help="Smallest distance between two distinct pairs (default: that of edge@1, else 0.2).",
        ),
    ] = None,
    limit: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=MOST_PAIRS,
            show_default=False,
            help=f"Most pairs to show (default: {PAIRS_SHOWN} in a table, {MOST_PAIRS} in a file).",
        ),
    ] = None,
    form: Annotated[
        Format | None,
        typer.Option(
            "--format", help="Format (default: by the name of --out, else table).", show_default=False
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="File to write: .csv, .jsonl or .parquet.", show_default=False)
    ] = None,
    picture: Annotated[
        tuple[int, Path] | None,
        typer.Option(
            metavar="N FILE",
            show_default=False,
            help="Draw pair N: both drives at the moment that matters (.png).",
        ),
    ] = None,
    film: Annotated[
        tuple[int, Path] | None,
        typer.Option(metavar="N FILE", show_default=False, help="Film both drives of pair N (.mp4 or .gif)."),
    ] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Show the pairs of a campaign: two drives that are almost the same, one safe, one unsafe.

    Each pair says in words what the change between its two drives is, and what the unsafe one did.

    Example: brink pairs 3f2a

    Example: brink pairs 3f2a --out pairs.jsonl

    Example: brink pairs 3f2a --picture 1 pair.png --film 1 pair.mp4
    """  # fmt: skip
    wanted = _format(form, out, as_json=as_json)
    settings = {"eps": eps, "d_th": d_th}
    drawn = [
        (option, *chosen, endings)
        for option, chosen, endings in (("--picture", picture, PICTURES), ("--film", film, FILMS))
        if chosen is not None
    ]
    for option, _, path, endings in drawn:
        check_file(option, path, endings)

    async def work(api: Api) -> None:
        params = {name: value for name, value in settings.items() if value is not None}
        if drawn:
            view = await fetch_pairs(api, campaign, **params, limit=MOST_PAIRS)
            for option, place, path, _ in drawn:
                await draw_pair(api, view, chosen_pair(view, place, option), path, workers=server is not None)
                typer.echo(path)
            return
        if wanted is Format.TABLE:
            params["limit"] = limit or (MOST_PAIRS if as_json else PAIRS_SHOWN)
            view = await fetch_pairs(api, campaign, **params)
            if as_json:
                print_json(view.model_dump(mode="json"))
            else:
                print_pairs(console(), view)
            return
        params |= {"limit": limit or MOST_PAIRS, "format": wanted.value}
        written = await api.request("GET", f"/campaigns/{campaign}/pairs", params=params)
        if out is None:
            typer.echo(written.content.decode(), nl=False)
        else:
            out.write_bytes(written.content)
            view = await fetch_pairs(api, campaign, **{**params, "format": "json"})
            typer.echo(f"{out}: {len(view.pairs)} of {view.distinct} distinct pairs")

    with_api(server, database, work)


def _format(form: Format | None, out: Path | None, *, as_json: bool) -> Format:
    """Return the format to write.

    Raises:
        InvalidInput: The options contradict each other.
    """
    if as_json and (form is not None or out is not None):
        raise InvalidInput.at("--json", "expected --json without --format and --out: it prints all details")
    if out is None:
        if form is Format.PARQUET:
            raise InvalidInput.at("--out", "expected a file to write Parquet to, such as --out pairs.parquet")
        return form or Format.TABLE
    known = [one.value for one in Format if one is not Format.TABLE]
    named = out.suffix.removeprefix(".")
    if form is None:
        if named not in known:
            raise InvalidInput.at(
                "--out", f"{out}: expected a file name that ends in .csv, .jsonl or .parquet"
            )
        return Format(named)
    if form is Format.TABLE:
        raise InvalidInput.at("--format", f"expected one of {', '.join(known)} for a file, got table")
    return form


async def fetch_pairs(api: Api, campaign: str, **params: Any) -> PairsView:
    """Return the pairs of a campaign.

    Args:
        api: Its coordinator.
        campaign: Id of the campaign.
        params: Parameters of the request.
    """
    return await api.read(PairsView, f"/campaigns/{campaign}/pairs", params)


def print_pairs(screen: Console, view: PairsView) -> None:
    """Print what was found, and the first pairs."""
    screen.print(f"[bold]{escape(view.name)}[/bold] ({view.campaign}): {view.note}", soft_wrap=True)
    if not view.pairs:
        return
    screen.print(
        f"[dim]a safe and an unsafe drive at most {view.eps:g} apart, or one step; pairs at least {view.d_th:g} "
        f"apart[/dim]",
        soft_wrap=True,
    )
    screen.print(pairs_table(view))
    if view.distinct > len(view.pairs):
        screen.print(f"[dim]and {view.distinct - len(view.pairs)} more: --limit {view.distinct}[/dim]")


def pairs_table(view: PairsView, shown: int | None = None) -> Table:
    """Return a table of the first pairs in words."""
    table = plain_table(
        "", "safe", "unsafe", "apart", "evidence", "change", right=("", "safe", "unsafe", "apart")
    )
    for pair in view.pairs[:shown]:
        table.add_row(
            str(pair.place), str(pair.safe.number), str(pair.unsafe.number), f"{pair.distance:.3f}",
            evidence_words(view, pair), escape(f"{pair.words} [otherwise: {pair.safe.outcome}]"),
        )  # fmt: skip
    return table


def evidence_words(view: PairsView, pair: PairView) -> str:
    """Return what is known of a pair beyond one simulation of each side."""
    if view.computed:
        return "computed"
    again = pair.confirmation
    if again.safe.evaluated or again.unsafe.evaluated:
        counts = ", ".join(f"{one.unsafe} of {one.evaluated}" for one in (again.safe, again.unsafe))
        return f"{again.state}: unsafe {counts}"
    return "checked" if pair.checked else "found once"
