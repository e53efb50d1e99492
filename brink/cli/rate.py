"""`brink rate`: how often drives are unsafe in operation, with an interval that holds."""

from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from brink.api.client import Api
from brink.api.terminal import echo
from brink.cli.findings import show_kind
from brink.cli.options import (
    RESULTS,
    AsJson,
    Database,
    New,
    Resume,
    Server,
    check_ids,
    check_picture,
    console,
    print_json,
    with_api,
)
from brink.report.rate import draw_rate
from brink.server.api.schemas import Progress
from brink.server.errors import InvalidInput
from brink.server.findings.finding import Finding
from brink.server.findings.table import FORMATS

FILES: Final = (".yaml", ".yml", ".json")
KINDS: Final = ("rate", "levels")
"""Kinds of findings that are rates."""


def _checked(given: str) -> str:
    if not given.endswith(FILES):
        check_ids(given)
    elif not Path(given).is_file():
        raise typer.BadParameter(f"{given}: there is no such file")
    return given


def rate(
    campaign: Annotated[
        str,
        typer.Argument(
            metavar="ID|FILE",
            help="Campaign id or a prefix of it, or a file to run first.",
            callback=_checked,
        ),
    ],
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
    workers: Annotated[
        int | None, typer.Option(min=1, max=256, help="Worker processes, with a file. By default 2.")
    ] = None,
    resume: Resume = False,
    new: New = False,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Show how often drives are unsafe in operation, from a campaign of rate@1, random@1 or subset@1.

    A campaign file is run first, as with brink run but without its figures and files.

    The first interval holds at every number of simulations at once, so that one may stop whenever it is good enough.

    Example: brink rate 3f2a

    Example: brink rate 3f2a --at-most 0.01 --by scenario.weather+scenario.time_of_day

    Example: brink rate 3f2a --picture rate.png

    Example: brink rate examples/rate.yaml --workers 2
    """
    if picture is not None:
        check_picture(picture)
    form = "" if out is None else out.suffix.removeprefix(".")
    if out is not None and form not in FORMATS:
        raise InvalidInput.at("--out", f"{out}: expected a name that ends in .csv, .jsonl or .parquet")
    given: dict[str, Any] = {"by": by, "at_most": at_most, "confidence": confidence}
    settings = {name: value for name, value in given.items() if value is not None}

    async def show(api: Api, campaign: str) -> None:
        progress = await api.read(Progress, f"/campaigns/{campaign}/progress")
        kind = next((one for one in KINDS if one in progress.finds), KINDS[0])
        path = f"/campaigns/{campaign}/findings/{kind}"
        if picture is not None and kind != KINDS[0]:
            raise InvalidInput.at("--picture", f"expected a campaign of rate@1 or random@1, got {campaign}")
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
            await show_kind(api, campaign, kind, settings)

    is_file = campaign.endswith(FILES)
    for name, misplaced in (
        ("--server", is_file and server is not None),
        ("--workers", not is_file and workers is not None),
        ("--resume", not is_file and resume),
        ("--new", not is_file and new),
    ):
        if misplaced:
            wanted = "a campaign id" if is_file else "a campaign file"
            raise InvalidInput.at(name, f"expected {wanted} with {name}, got {campaign}")
    if not is_file:
        with_api(server, database, lambda api: show(api, campaign))
        return
    _run_first(Path(campaign), workers or 2, show, resume=resume, new=new, database=database)


def _run_first(
    file: Path,
    workers: int,
    show: Callable[[Api, str], Awaitable[None]],
    *,
    resume: bool,
    new: bool,
    database: str | None,
) -> None:
    """Run a campaign, and show its rate at the end.

    Raises:
        InvalidInput: Its algorithm estimates no rate.
    """
    # These load the coordinator, which takes longer than showing a rate.
    from brink.api.live import CampaignDisplay
    from brink.api.runs import CampaignRun
    from brink.cli.local import CommandSession, RunOptions, run_to_end
    from brink.cli.run import checked_body
    from brink.search.algorithm import declared_finds

    options = RunOptions(
        file=file,
        workers=workers,
        out=RESULTS,
        resume=resume,
        new=new,
        json=False,
        database=database,
        verb="rate",
    )
    body, plan = checked_body(options)
    if not set(KINDS) & set(declared_finds(plan.algorithm)):
        message = f"expected an algorithm that estimates a rate, such as rate@1, got {body.algorithm.id}"
        raise InvalidInput.at("/algorithm/id", message)

    async def finish(session: CommandSession, progress: Progress) -> bool:
        await show(session.api, progress.id)
        session.hint("see it again with", f"rate {progress.id}")
        return True

    screen = console(stderr=True)  # standard output has the rate alone
    complete = run_to_end(CampaignRun(body, pictures=False), options, screen, CampaignDisplay(screen), finish)
    raise typer.Exit(int(not complete))
