"""`brink findings`: all findings of a campaign, whatever their kind, in the terminal or as files."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.text import Text

from brink.cli.options import (
    AsJson,
    CampaignId,
    Database,
    Server,
    console,
    place_option,
    print_json,
    print_sentence,
    program,
    with_api,
)
from brink.cli.tables import print_table
from brink.report.tables import finding_markdown
from brink.server.errors import InvalidInput
from brink.server.findings.finding import Finding, Findings, Step
from brink.server.findings.table import FORMATS
from brink.server.findings.words import full_sentence


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
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Show the findings of a campaign: each kind as a sentence and a table, and next steps.

    Example: brink findings 3f2a

    Example: brink findings 3f2a pairs --out pairs.csv
    """
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
    if out is not None:
        out.write_text("\n".join(finding_markdown(one) for one in found), encoding="utf-8")
    elif as_json:
        print_json(document)
    elif kind:
        print_finding(console(), found[0])
    else:
        print_findings(console(), Findings.model_validate(document), place_option(server, database))


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
    print_steps(screen, found.steps, place)


def print_finding(screen: Console, finding: Finding, *, more: str = "", said: Sequence[str] = ()) -> None:
    """Print one kind of findings: its sentence, its details, and its tables.

    Args:
        screen: Where to print.
        finding: The finding.
        more: The command that prints all rows.
        said: Sentences that were printed before.
    """
    print_sentence(screen, Text.assemble((finding.title, "bold"), f": {finding.sentence}"))
    for words in map(full_sentence, finding.more):
        if words not in said:
            print_sentence(screen, words, style="dim")
    for table in finding.tables:
        print_table(screen, table, more=more)


def print_steps(screen: Console, steps: list[Step], place: str = "") -> None:
    """Print next steps as commands, with the questions that they answer."""
    commands = [
        (f"{program()}{step.command.removeprefix('brink')}", step.question) for step in steps if step.command
    ]
    if not commands:
        return
    screen.print()
    screen.print("next:")
    width = max(len(command) for command, _ in commands) + len(place)
    for command, question in commands:
        screen.print(Text.assemble(f"  {command + place:{width}}  ", (question, "dim")), soft_wrap=True)
