"""`brink errors fit | compare`: from a recording of a detector to drives with its errors."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from brink.api.client import Api
from brink.api.terminal import echo
from brink.cli.options import (
    AsJson,
    Database,
    Server,
    check_ids,
    check_out,
    console,
    plain_table,
    print_json,
    with_api,
)
from brink.cli.recording_options import RecordingFormat, RecordingOptions, with_recording
from brink.recordings.choices import TYPES
from brink.server.errors import InvalidInput

if TYPE_CHECKING:
    from brink.report.errors import Violations

errors = typer.Typer(
    name="errors",
    help="Fit the errors of a recorded detector, and simulate drives with them.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@errors.command()
@with_recording
def fit(
    detections: Annotated[Path, typer.Argument(metavar="RECORDING", help="File or folder with detections.")],
    form: RecordingFormat = None,
    recording: RecordingOptions = RecordingOptions(),
    without: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TYPE",
            show_default=False,
            help=f"Leave out errors of a type, to see what they contribute: {', '.join(TYPES)}; may be repeated.",
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="File to write, with every number and its samples.")] = Path(
        "errors.yaml"
    ),
    campaign: Annotated[
        Path | None,
        typer.Option(
            show_default=False, help="Campaign file to write (default: campaign.yaml beside --out)."
        ),
    ] = None,
    simulations: Annotated[int, typer.Option(min=1, help="Drives of the campaign.")] = 2000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the campaign.")] = 1,
) -> None:
    """Fit the errors of a detector as a random process, and write a campaign that drives them.

    Example: brink errors fit detections.csv --out errors.yaml --campaign fitted.yaml

    Example: brink errors fit results --truth labels --format kitti --without misses
    """
    from brink.cli.recording_options import GivenRecording
    from brink.recordings.fit_errors import fit_errors
    from brink.recordings.measure import observe
    from brink.report.errors import COLUMNS, campaign_yaml, error_rows, error_sentences, errors_yaml

    for name in without or ():
        if name not in TYPES:
            raise InvalidInput.at("--without", f"expected some of {', '.join(TYPES)}, got {name!r}")
    file = campaign or out.with_name("campaign.yaml")
    if file == out:
        raise InvalidInput.at("--out", f"expected another file than that of the campaign, {file}")
    check_out(out)
    check_out(file, option="--campaign")
    given = GivenRecording.of(detections, form, recording)
    drives = given.read()
    observed = observe(drives, threshold=given.threshold, visibility=given.visibility)
    for line in given.words(drives):
        echo(line)
    fitted = fit_errors([drive.meter for drive in observed], drives.name, without=without or ())
    screen = console()
    screen.print(plain_table(*COLUMNS, right=COLUMNS[2:], rows=error_rows(fitted)))
    for line in error_sentences(fitted):
        screen.print(line, soft_wrap=True)
    out.write_text(errors_yaml(fitted), encoding="utf-8")
    file.write_text(campaign_yaml(fitted, simulations, seed), encoding="utf-8")
    echo(out)
    echo(f"{file} (next: brink run {file})")


@errors.command()
def compare(
    one: Annotated[str, typer.Argument(metavar="ID", help="Id of a campaign.", callback=check_ids)],
    other: Annotated[str, typer.Argument(metavar="ID", help="Id of another.", callback=check_ids)],
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Compare how often drives with fitted errors violate with another campaign, such as one on urban-camera@1.

    Example: brink errors compare 3f2a 91bc
    """
    from brink.api.results import fetch_archive
    from brink.report.errors import Violations, agreement_words, violations_of

    async def work(api: Api) -> list[Violations]:
        return [violations_of(await fetch_archive(api, campaign)) for campaign in (one, other)]

    found = with_api(server, database, work)
    words = agreement_words(*found)
    if as_json:
        print_json({"campaigns": [asdict(each) | {"share": each.share} for each in found], "words": words})
        return
    show_violations(found)
    console().print(words, soft_wrap=True)


def show_violations(found: "Sequence[Violations]") -> None:
    """Print how many drives violate, a row for each campaign."""
    fits = [f" (with the spread of {one.replicates} fits)" if one.replicates > 1 else "" for one in found]
    rows = [
        (one.name, one.problem, f"{one.drives:,}", f"{one.unsafe:,}", f"{one.words}{spread}")
        for one, spread in zip(found, fits, strict=True)
    ]
    numbers = ("drives", "violate")
    console().print(plain_table("campaign", "problem", *numbers, "share", right=numbers, rows=rows))
