"""`brink pairs`: pairs of drives across the boundary, one safe and one unsafe, and the change between them."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from brink.api.client import Api
from brink.api.follow_ups import follow_up_requests
from brink.api.terminal import echo
from brink.cli.findings import show_kind
from brink.cli.follow_ups import follow_up
from brink.cli.options import (
    RESULTS,
    AsJson,
    CampaignId,
    ConfirmPairs,
    Database,
    Server,
    WithGroundTruth,
    Workers,
    check_out,
    console,
    named_values,
    print_json,
    program,
    with_api,
)
from brink.cli.pair_pictures import PICTURES, chosen_pair, draw_pair
from brink.report.limits import FILMS
from brink.server.campaigns.follow_ups.limits import MOST_PAIRS_FOLLOWED
from brink.server.errors import InvalidInput
from brink.server.findings.follow_ups import FollowUpView
from brink.server.findings.pairs.views import MOST_PAIRS, Minimality, PairsView
from brink.server.states import FollowUpKind

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
            help="Largest distance between the sides of a pair (default: that of the search for pairs, else 0.02).",
        ),
    ] = None,
    d_th: Annotated[
        float | None,
        typer.Option(
            "--d-th",
            min=0.0,
            max=1.0,
            show_default=False,
            help="Smallest distance between two distinct pairs (default: that of the search for pairs, else 0.2).",
        ),
    ] = None,
    limit: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=MOST_PAIRS,
            show_default=False,
            help=f"Maximum number of pairs to show (default: {PAIRS_SHOWN} in a table, {MOST_PAIRS} in a "
            "file), and to simulate "
            f"again (default: {MOST_PAIRS_FOLLOWED}).",
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
            help="Draw pair N: both drives at the decisive moment (.png).",
        ),
    ] = None,
    film: Annotated[
        tuple[int, Path] | None,
        typer.Option(metavar="N FILE", show_default=False, help="Film both drives of pair N (.mp4 or .gif)."),
    ] = None,
    confirm: ConfirmPairs = None,
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            show_default=False,
            help="With --confirm: simulate both sides with another value of a parameter of the problem, such as "
            "driving=idm:Idm, as a campaign of its own; may be repeated.",
        ),
    ] = None,
    component: WithGroundTruth = False,
    minimise: Annotated[
        bool,
        typer.Option("--minimise", help="Revert differences one by one first, to find those that matter."),
    ] = False,
    sharpen: Annotated[
        bool,
        typer.Option(
            "--sharpen",
            help="Find where exactly between the sides of each pair drives turn unsafe: thresholds.",
        ),
    ] = False,
    results: Annotated[
        Path, typer.Option(help="Folder given to brink run as --out, whose files are updated.")
    ] = RESULTS,
    workers: Workers = 2,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Show the pairs of a campaign: two neighbouring drives, one safe, one unsafe.

    Each pair says in words what the change between its two drives is, how far each number moved as a share of its
    range, and what the unsafe one did. What --confirm,
    --component and --minimise find out is stored and shown from then on; --sharpen finds thresholds, which are shown
    below the pairs. Without --server, the command runs a
    coordinator and workers until it is known; calling it again continues. It also brings the files that `brink run`
    wrote up to date.

    Example: brink pairs 3f2a

    Example: brink pairs 3f2a --confirm 30 --component --minimise

    Example: brink pairs 3f2a --sharpen --limit 10

    Example: brink --plugin idm pairs 3f2a --confirm 30 --set driving=idm:Idm

    Example: brink pairs 3f2a --out pairs.jsonl

    Example: brink pairs 3f2a --picture 1 pair.png --film 1 pair.mp4
    """
    wanted = _format(form, out, as_json=as_json)
    settings = {"eps": eps, "d_th": d_th}
    drawn = [
        (option, *chosen, endings)
        for option, chosen, endings in (("--picture", picture, PICTURES), ("--film", film, FILMS))
        if chosen is not None
    ]
    for option, _, path, endings in drawn:
        check_out(path, *endings, option=option)

    given = {name: value for name, value in settings.items() if value is not None}
    if changes:
        chosen = [
            name
            for name, one in (
                ("--component", component),
                ("--minimise", minimise),
                ("--sharpen", sharpen),
                ("--out", out),
                ("--format", form),
                ("--picture", picture),
                ("--film", film),
            )
            if one
        ]
        if chosen or confirm is None:
            expected = (
                "requires --confirm" if confirm is None else f"cannot be combined with {' and '.join(chosen)}"
            )
            raise InvalidInput.at("--set", expected)
        from brink.cli.changed_pairs import ChangedPairs

        changed = ChangedPairs(
            campaign,
            lambda api: fetch_asked(api, campaign, limit, **given),
            named_values("--set", changes, "driving=idm:Idm"),
            confirm,
            console(stderr=as_json),
        )
        raise typer.Exit(int(not changed.run(workers, database, server, as_json=as_json)))
    asked = follow_up_requests(
        given, confirm, component=component, minimise=minimise, sharpen=sharpen, limit=limit
    )
    if drawn:
        ignored = [
            name
            for name, chosen in (
                ("--out", out is not None),
                ("--format", form is not None),
                ("--json", as_json),
                ("--limit", limit is not None and not asked),
            )
            if chosen
        ]
        if ignored:
            raise InvalidInput.at(
                drawn[0][0], f"cannot be combined with {' and '.join(ignored)}: draw the pair alone"
            )
    complete = True
    screen = console(stderr=as_json or (wanted is not Format.TABLE and out is None))
    if asked:
        if limit is not None and limit > MOST_PAIRS_FOLLOWED:
            screen.print(f"only the first {MOST_PAIRS_FOLLOWED} pairs are simulated again")
        complete = follow_up(
            "pairs",
            campaign,
            asked,
            lambda api, request: _ask(api, campaign, request, screen),
            screen,
            workers=workers,
            server=server,
            database=database,
        )

    async def work(api: Api) -> None:
        params: dict[str, Any] = dict(given)
        if drawn:
            view = await fetch_pairs(api, campaign, **params, limit=MOST_PAIRS)
            for option, place, path, _ in drawn:
                await draw_pair(api, view, chosen_pair(view, place, option), path, workers=server is not None)
                echo(path)
            return
        if as_json:
            view = await (
                fetch_asked(api, campaign, limit, **params)
                if asked and limit is not None
                else fetch_pairs(api, campaign, **params, limit=limit or MOST_PAIRS)
            )
            print_json(view.model_dump(mode="json"))
            return
        if wanted is Format.TABLE:
            rows = {"rows": limit or PAIRS_SHOWN} | ({"first": limit} if asked and limit else {})
            await show_kind(api, campaign, "pairs", params | rows, more=f"--limit up to {MOST_PAIRS:,}")
            if sharpen:
                await _show_thresholds(api, campaign)
            return
        params |= {"limit": limit or MOST_PAIRS, "format": wanted.value}
        written = await api.request("GET", f"/campaigns/{campaign}/pairs", params=params)
        if out is None:
            echo(written.content.decode(), nl=False)
        else:
            out.write_bytes(written.content)
            view = await fetch_pairs(api, campaign, **{**params, "format": "json"})
            pairs = "pair" if view.distinct == 1 else "pairs"
            echo(f"{out}: {len(view.pairs)} of {view.distinct} distinct {pairs}")

    async def show(api: Api) -> None:
        await work(api)
        if asked and server is None and complete:
            from brink.cli.results_folder import update_pairs

            await update_pairs(api, campaign, results, screen)

    with_api(server, database, show)
    raise typer.Exit(int(not complete))


async def _show_thresholds(api: Api, campaign: str) -> None:
    """Print the thresholds that follow-ups found between the sides of a campaign's pairs."""
    view = await fetch_pairs(api, campaign, limit=1)
    for one in view.follow_ups:
        if one.kind is FollowUpKind.SHARPEN and one.simulations:
            command = f"{program()} findings {one.campaign} thresholds"
            console().print()
            await show_kind(api, one.campaign, "thresholds", {"rows": PAIRS_SHOWN}, more=command)
            console().print(f"campaign {one.campaign}: {command} --picture thresholds.png", soft_wrap=True)


async def _ask(api: Api, campaign: str, request: dict[str, Any], screen: Console) -> FollowUpView | None:
    """Start a follow-up, or return an identical one; return None, with a message, if there is nothing to do."""
    given = {name: request[name] for name in ("eps", "d_th") if name in request}
    view = await fetch_asked(api, campaign, request.get("limit"), **given)
    if view.complete and not view.pairs:
        return None  # the note says why
    if view.pairs and request["kind"] == FollowUpKind.MINIMISE and not _can_be_minimised(view, screen):
        return None
    return await api.send(FollowUpView, f"/campaigns/{campaign}/pairs/follow-ups", request)


def _can_be_minimised(view: PairsView, screen: Console) -> bool:
    """Return whether a difference of any pair can be reverted, and report the pairs that are left out."""
    states = [pair.minimality.state for pair in view.pairs]
    if left_out := states.count(Minimality.DIFFERENT_SEEDS):
        if len(states) == 1:
            pairs, sides = "the pair", "its sides"
        else:
            pairs, sides = f"{left_out} of {len(states)} pairs", "their sides"
        screen.print(
            f"{pairs} cannot be minimised: {sides} were simulated with different seeds, so chance may decide rather "
            "than a difference",
            soft_wrap=True,
        )
    one_seed = len(states) - left_out
    if one_seed and states.count(Minimality.MINIMAL) == one_seed:
        pairs = "the pair can go: it is" if one_seed == 1 else f"{one_seed} pairs can go: they are"
        screen.print(f"none of the differences of {pairs} minimal")
    return states.count(Minimality.MINIMAL) < one_seed


def _format(form: Format | None, out: Path | None, *, as_json: bool) -> Format:
    """Return the format to write.

    Raises:
        InvalidInput: The options contradict each other.
    """
    if as_json and (form is not None or out is not None):
        raise InvalidInput.at("--json", "cannot be combined with --format and --out: it prints all details")
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


async def fetch_asked(api: Api, campaign: str, limit: int | None, **params: Any) -> PairsView:
    """Return the pairs that a follow-up covers: those with the smallest numbers.

    Args:
        api: Coordinator of the campaign.
        campaign: Id of the campaign.
        limit: Most pairs to ask about; None for as many as a follow-up takes.
        params: Other parameters of the request.
    """
    most = min(limit or MOST_PAIRS_FOLLOWED, MOST_PAIRS_FOLLOWED)
    view = await fetch_pairs(api, campaign, **params, limit=MOST_PAIRS)
    return view.model_copy(update={"pairs": [pair for pair in view.pairs if pair.place <= most]})
