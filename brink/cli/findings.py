"""`brink findings`: what a campaign found, whatever the kind, in the terminal or as files.

Commands of single kinds, such as `brink pairs`, print through the same functions.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from rich.console import Console
from rich.table import Table as TerminalTable
from rich.text import Text

from brink.api.client import Api
from brink.api.terminal import echo, plain_table
from brink.cli.options import (
    AsJson,
    CampaignId,
    Database,
    Server,
    check_picture,
    console,
    place_option,
    print_json,
    print_sentence,
    program,
    with_api,
)
from brink.report.rate import draw_rate
from brink.report.tables import finding_markdown
from brink.report.thresholds import draw_thresholds
from brink.server.errors import InvalidInput
from brink.server.findings.finding import Finding, Findings, Step
from brink.server.findings.table import FORMATS, Table
from brink.server.findings.words import full_sentence

CHAINS_SHOWN: Final = 10
DRAWN: Final[Mapping[str, Callable[[Finding, Path], None]]] = {
    "rate": draw_rate,
    "thresholds": draw_thresholds,
}
"""What draws findings of a kind to a file; other pictures have commands of their own."""


def findings(
    campaign: CampaignId,
    kind: Annotated[
        str | None, typer.Argument(help="Only this kind, with all rows; without it, all kinds.")
    ] = None,
    table: Annotated[
        str | None, typer.Option(help="Table to write, if the kind has several; by default the first.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="File to write: .md, or with a kind .csv, .jsonl or .parquet.")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(help="Draw it, for a kind that has a picture, such as thresholds (.png, .svg or .pdf)."),
    ] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Show the findings of a campaign: each kind as a sentence and a table, and next steps.

    Example: brink findings 3f2a

    Example: brink findings 3f2a pairs --out pairs.csv

    Example: brink findings 3f2a thresholds --picture thresholds.png
    """
    draw = None if picture is None else _drawn(picture, kind)
    path = f"/campaigns/{campaign}/findings" + (f"/{kind}" if kind else "")
    if out is not None:
        _check_file(out, kind)
        form = out.suffix.removeprefix(".")
        if form in FORMATS:
            params = {"format": form} | ({"table": table} if table else {})
            answer = with_api(server, database, lambda api: api.request("GET", path, params=params))
            out.write_bytes(answer.content)
            return
    document = with_api(server, database, lambda api: api.get(path))
    found = [Finding.model_validate(document)] if kind else Findings.model_validate(document).findings
    if draw is not None and picture is not None:
        draw(found[0], picture)
        echo(picture)
    elif out is not None:
        out.write_text("\n".join(finding_markdown(one) for one in found), encoding="utf-8")
    elif as_json:
        print_json(document)
    elif kind:
        print_finding(console(), found[0])
    else:
        everything, place = Findings.model_validate(document), place_option(server, database)
        print_findings(console(), everything, place)
        print_steps(console(), everything.steps, place)


def _drawn(picture: Path, kind: str | None) -> Callable[[Finding, Path], None]:
    """Return what draws findings of a kind.

    Raises:
        InvalidInput: The file cannot be written, or the kind has no picture.
    """
    check_picture(picture)
    draw = DRAWN.get(kind or "")
    if draw is None:
        known = ", ".join(sorted(DRAWN))
        raise InvalidInput.at(
            "--picture", f"expected a kind that has a picture ({known}), got {kind or 'none'}"
        )
    return draw


def _check_file(out: Path, kind: str | None) -> None:
    """Check that findings can be written to a file of this name.

    Raises:
        InvalidInput: They cannot.
    """
    form = out.suffix.removeprefix(".")
    if form not in ("md", *FORMATS):
        raise InvalidInput.at("--out", f"{out}: expected a name that ends in .md, .csv, .jsonl or .parquet")
    if form != "md" and kind is None:
        raise InvalidInput.at("--out", f"{out}: expected a kind, such as pairs, whose table to write")


def print_findings(screen: Console, found: Findings, place: str = "") -> None:
    """Print all kinds of findings of a campaign, and next steps.

    Args:
        screen: Where to print.
        found: The findings.
        place: The option that names the coordinator or database in commands.
    """
    print_sentence(screen, Text(found.words, "bold"))
    for words in found.more:
        print_sentence(screen, words)
    for finding in found.findings:
        screen.print()
        command = f"{program()} findings {found.campaign} {finding.kind}{place}"
        print_finding(screen, finding, more=command, said=found.more)


def print_finding(screen: Console, finding: Finding, *, more: str = "", said: Sequence[str] = ()) -> None:
    """Print one kind of findings: its sentence, its tables, what their words mean, and what it does not say.

    Args:
        screen: Where to print.
        finding: The finding.
        more: How to see all rows.
        said: Sentences that were printed before.
    """
    print_sentence(screen, Text.assemble((finding.title, "bold"), f": {finding.sentence}"))
    for words in map(full_sentence, finding.more):
        if words not in said:
            print_sentence(screen, words)
    for table in finding.tables:
        if table.rows and len(finding.tables) > 1:
            screen.print(table.title, style="dim")
        print_table(screen, table, more=more)
    if any(table.rows for table in finding.tables):
        for words in map(full_sentence, finding.legend):
            print_sentence(screen, words, style="dim")
    for words in map(full_sentence, finding.caveats):
        if words not in said:
            print_sentence(screen, words)


async def show_kind(
    api: Api, campaign: str, kind: str, settings: Mapping[str, Any], *, more: str = ""
) -> Finding:
    """Print one kind of findings of a campaign, and return it.

    Args:
        api: Coordinator of the campaign.
        campaign: Id of the campaign.
        kind: The kind.
        settings: What it is asked with, and the most rows of each table as ``rows``.
        more: How to see all rows.
    """
    finding = await api.read(Finding, f"/campaigns/{campaign}/findings/{kind}", settings)
    print_finding(console(), finding, more=more)
    return finding


def print_steps(screen: Console, steps: Sequence[Step], place: str = "") -> None:
    """Print what to do next: commands with the questions that they answer, and what takes no command, in words."""
    if not steps:
        return
    commands = [
        (f"{program()}{step.command.removeprefix('brink')}{place}", step.question)
        for step in steps
        if step.command
    ]
    screen.print()
    screen.print("next:")
    width = max((len(command) for command, _ in commands), default=0)
    for command, question in commands:  # not in a table, which would break commands that are to be pasted
        screen.print(Text.assemble(f"  {command:{width}}  ", (question, "dim")), soft_wrap=True)
    for step in steps:
        if not step.command:
            screen.print(Text(f"  {step.question} {step.words}", "dim"), soft_wrap=True)


def terminal_table(table: Table, shown: int | None = None) -> TerminalTable:
    """Return the first rows of a table for the terminal."""
    columns = table.shown
    drawn = plain_table(*(one.heading for one in columns))
    for place, column in enumerate(columns):
        drawn.columns[place].justify = "right" if column.format.is_numeric else "left"
    for row in table.texts(shown):
        drawn.add_row(*row)
    return drawn


def print_table(screen: Console, table: Table, shown: int | None = None, *, more: str = "") -> None:
    """Print the first rows of a table, and how many more there are.

    Args:
        screen: Where to print.
        table: The table.
        shown: Most rows to print.
        more: How to see the others.
    """
    if not table.rows:
        return
    screen.print(terminal_table(table, shown))
    hidden = len(table.rows[shown:] if shown is not None else []) + table.left_out
    if hidden:
        screen.print(f"… and {hidden:,} more{f': {more}' if more else ''}", style="dim", soft_wrap=True)


def combinations(
    campaign: CampaignId,
    shown: Annotated[int, typer.Option(min=1, help="Number of rows in each table.")] = CHAINS_SHOWN,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Show which techniques are hazardous alone, only together, or in one order but not in another.

    Example: brink combinations 3f2a
    """

    async def work(api: Api) -> None:
        if as_json:
            print_json(await api.get(f"/campaigns/{campaign}/combinations"))
        else:
            await show_kind(api, campaign, "combinations", {"rows": shown}, more="--shown N")

    with_api(server, database, work)
