"""`brink tolerance`: how severe a component's errors may be, and the requirement that follows."""

import asyncio
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from brink.api.client import Api
from brink.cli.detector import Check, EpisodesCheck, Format, Output, RecordingCheck, chosen_format
from brink.cli.options import (
    AsJson,
    CampaignId,
    Database,
    Server,
    check_ids,
    check_picture,
    console,
    plain_table,
    print_json,
    with_api,
    write_json,
)
from brink.cli.recording_options import GivenRecording, RecordingOptions, with_recording
from brink.recordings.reading import formats_by_name
from brink.report.figures import Drawing
from brink.report.tolerance import requirement_document
from brink.server.errors import InvalidInput
from brink.server.findings.tolerances.kind import KEY
from brink.server.findings.tolerances.views import AgreementView, CellView, ToleranceView

ROWS_SHOWN: Final = 30
"""Maximum number of rows of the table at the end of a run."""
MOST_CONDITIONS: Final = 4
"""Conditions beside which their tolerances fit."""


RESULTS_FORMATS: Final = {one.value for one in Format}


@with_recording
def tolerance(
    campaign: CampaignId,
    forms: Annotated[
        list[str] | None,
        typer.Option(
            "--format",
            metavar="NAME",
            show_default=False,
            help=f"What is printed or written: {', '.join(Format)} (default: by the name of --out, else table). Or "
            f"the format of --detections: {', '.join(formats_by_name())} (default: recognised). Applies to both.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="File to write: .csv, .json or .md; of a detector, .html too.", show_default=False),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            help="Draw the curves, or how a detector does (.png, .svg or .pdf).", show_default=False
        ),
    ] = None,
    against: Annotated[
        str | None,
        typer.Option(
            metavar="ID",
            show_default=False,
            callback=check_ids,
            help="Compare with the fresh drives of another campaign instead: does it find what these predict?",
        ),
    ] = None,
    episodes: Annotated[
        str | None,
        typer.Option(
            metavar="ID",
            show_default=False,
            callback=check_ids,
            help="Check a detector against it: that of a campaign with a camera, such as urban-camera@1.",
        ),
    ] = None,
    detections: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            show_default=False,
            help="Check a detector against it: what it reported in recorded drives, as a file or folder.",
        ),
    ] = None,
    recording: RecordingOptions = RecordingOptions(),
    coco: Annotated[
        tuple[Path, Path] | None,
        typer.Option(
            metavar="TRUTH RESULTS",
            show_default=False,
            help="Short for --truth TRUTH --detections RESULTS --format coco.",
        ),
    ] = None,
    thresholds: Annotated[
        str | None,
        typer.Option(
            metavar="LIST",
            show_default=False,
            help="Check the detector of a recording with each of these thresholds, such as 0.3,0.5,0.7; auto takes "
            "nine that are spread over its scores.",
        ),
    ] = None,
    images: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            show_default=False,
            help="Pictures of the recording, as FOLDER/DRIVE/*.png or .jpg, to show the worst episodes of a page on.",
        ),
    ] = None,
    gate: Annotated[
        bool, typer.Option("--gate", help="Exit with status 1 if a detector does not meet the requirement.")
    ] = False,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Show how severe errors may be, by type of error, target and condition, or check a detector against that.

    The campaign must be a search for tolerances, such as that of examples/tolerance.yaml. It may still be running.

    Example: brink tolerance 3f2a

    Example: brink tolerance 3f2a --out requirement.csv --picture requirement.png

    Example: brink tolerance 3f2a --against 9c01

    Example: brink tolerance 3f2a --detections det/ --truth label_02/ --calibration camera.yaml --out check.html

    Example: brink tolerance 3f2a --episodes 9c01 --gate
    """
    if coco is not None:
        if detections is not None or recording.truth is not None:
            raise InvalidInput.at("--coco", "cannot be combined with --detections or --truth")
        recording = replace(recording, truth=coco[0])
        detections, forms = coco[1], [*(forms or ()), "coco"]
    given = [
        name
        for name, value in (("--against", against), ("--episodes", episodes), ("--detections", detections))
        if value is not None
    ]
    if len(given) > 1:
        raise InvalidInput.at(given[1], f"cannot be combined with {given[0]}")
    form, recording_format = _formats(forms or (), detections)
    options = {**dict.fromkeys(recording.given(), True), "--thresholds": thresholds}
    _refuse_unused(detections is not None, "--detections", options)
    is_check = detections is not None or episodes is not None
    _refuse_unused(is_check, "--detections or --episodes", {"--gate": gate})
    if gate and thresholds is not None:
        raise InvalidInput.at("--gate", "cannot be combined with --thresholds: it takes one threshold")
    check_picture(picture)
    if against is not None:
        for name, value in (("--format", form), ("--out", out), ("--picture", picture)):
            if value is not None:
                raise InvalidInput.at(name, "cannot be combined with --against")
        _compare(campaign, against, server, database, as_json=as_json)
        return
    form = chosen_format(form, out, as_json=as_json, pages=is_check)
    _refuse_unused(
        detections is not None and form is Format.HTML, "--detections and a page", {"--images": images}
    )
    wanted = Output(form=form, out=out, picture=picture)
    if detections is not None:
        files = GivenRecording.of(detections, recording_format, recording)
        check: Check = RecordingCheck(campaign, files, thresholds, images, wanted)
    elif episodes is not None:
        check = EpisodesCheck(campaign, episodes, wanted)
    else:
        _show(campaign, wanted, server, database)
        return
    is_met = with_api(server, database, check.run)
    if gate and not is_met:
        raise typer.Exit(1)


def _refuse_unused(is_used: bool, by: str, options: Mapping[str, object]) -> None:
    """Reject options that would have no effect.

    Raises:
        InvalidInput: One is given.
    """
    unused = [name for name, value in options.items() if value]
    if unused and not is_used:
        raise InvalidInput.at(unused[0], f"requires {by}")


def _formats(given: Sequence[str], detections: Path | None) -> tuple[Format | None, str | None]:
    """Return the output format, and the format of the recording.

    ``csv`` is that of the recording if the detections are no .csv file.

    Raises:
        InvalidInput: A format is unknown, does not apply, or is given twice.
    """
    written: Format | None = None
    recording: str | None = None
    for name in given:
        is_recorded = detections is not None and name in formats_by_name()
        if is_recorded and name in RESULTS_FORMATS:
            is_recorded = detections is not None and detections.suffix.lower() != f".{name}"
        if is_recorded and recording is None:
            recording = name
        elif name in RESULTS_FORMATS and written is None:
            written = Format(name)
        elif name in RESULTS_FORMATS or name in formats_by_name():
            expected = "it once" if detections is not None else "the format of a recording with --detections"
            raise InvalidInput.at("--format", f"{name}: expected {expected}")
        else:
            raise InvalidInput.at(
                "--format",
                f"expected one of {', '.join(Format)}, or of a recording {', '.join(formats_by_name())}; got "
                f"{name!r:.40}",
            )
    return written, recording


def _show(campaign: str, wanted: Output, server: str | None, database: str | None) -> None:
    """Print, write and draw the tolerances of a campaign."""

    async def work(api: Api) -> None:
        view = await fetch_tolerance(api, campaign)
        if wanted.picture is not None:
            await asyncio.to_thread(draw_tolerance, view, wanted.picture)
        match wanted.form:
            case Format.TABLE | Format.HTML:
                show_tolerance(console(), view)
            case Format.SENTENCES:
                wanted.write("".join(f"{cell.sentence}\n" for cell in view.cells))
            case Format.JSON:
                wanted.write_json(view.model_dump(mode="json"))
            case Format.MARKDOWN:
                wanted.write(
                    requirement_document(view, None if wanted.picture is None else wanted.picture.name)
                )
            case Format.CSV:
                wanted.write((await fetch_csv(api, campaign)).decode())
        wanted.name_files()

    with_api(server, database, work)


def _compare(campaign: str, fresh: str, server: str | None, database: str | None, *, as_json: bool) -> None:
    """Print whether fresh drives agree with the predictions."""

    async def work(api: Api) -> AgreementView:
        return await api.read(AgreementView, f"/campaigns/{campaign}/tolerance/agreement", {"fresh": fresh})

    view = with_api(server, database, work)
    if as_json:
        print_json(view.model_dump(mode="json"))
        return
    table = plain_table(
        "error", "condition", "drives", "caused", "predicted", "", right=("drives", "caused", "predicted")
    )
    for cell in view.cells:
        table.add_row(
            cell.error,
            cell.condition,
            str(cell.drives),
            str(cell.caused),
            f"{cell.low} to {cell.high}",
            "" if cell.agrees else Text("not as predicted", "yellow"),
        )
    screen = console()
    screen.print(table)
    screen.print(view.note, soft_wrap=True)


async def fetch_tolerance(api: Api, campaign: str) -> ToleranceView:
    """Return the tolerances of a campaign."""
    return await api.read(ToleranceView, f"/campaigns/{campaign}/tolerance")


async def fetch_csv(api: Api, campaign: str) -> bytes:
    """Return the tolerances of a campaign as CSV."""
    response = await api.request("GET", f"/campaigns/{campaign}/tolerance", params={"format": "csv"})
    return response.content


def draw_tolerance(view: ToleranceView, path: Path) -> None:
    """Draw the curves of a campaign to a file."""
    from brink.plots.tolerance import figure_tolerance

    figure_tolerance(view).savefig(path)


def show_tolerance(screen: Console, view: ToleranceView, *, briefly: bool = False) -> None:
    """Print the requirement: the tolerances, where a larger error is safer, and the drives without error.

    Args:
        screen: Where to print.
        view: The tolerances.
        briefly: Whether a row has all conditions of an error, without the numbers of drives.
    """
    screen.print(Text.assemble((view.name, "bold"), f" ({view.campaign}): {view.note}"), soft_wrap=True)
    screen.print(view.caveat, soft_wrap=True)
    screen.print(
        f"tolerated: the magnitude at which {view.limit:.0%} of drives violate because of the error, with an "
        f"interval of {view.confidence:.0%}; mean width of the intervals: {view.mean_width:.3f} of the scale",
        soft_wrap=True,
        style="dim",
    )
    if briefly and len(view.conditions) <= MOST_CONDITIONS:
        _show_matrix(screen, view)
    else:
        cells = view.cells[: ROWS_SHOWN if briefly else None]
        screen.print(KEY, soft_wrap=True, style="dim")
        screen.print(tolerance_table(cells))
        _show_rest(screen, len(view.cells) - len(cells))
    for cell in view.cells:
        if cell.fall is not None:
            screen.print(f"{cell.error}, {cell.condition}: {cell.fall.words}", soft_wrap=True)
    screen.print("without any error, these shares of drives violate:")
    table = plain_table("condition", "drives", "violate")
    for one in view.baseline:
        only = " or ".join(" ".join(choices.values()) for choices in one.choices if choices)
        share = one.share
        table.add_row(
            f"{one.condition}{f' ({only})' if only else ''}",
            str(share.evaluated),
            f"{share.unsafe / share.evaluated:.0%} [{share.low:.0%}, {share.high:.0%}]"
            if share.evaluated
            else "–",
        )
    screen.print(table)
    if view.audited:
        screen.print(
            f"drives that hold with the most severe error are assumed to hold with milder ones; of {view.audited} "
            f"that were simulated nevertheless, {view.leaks} violated",
            soft_wrap=True,
            style="dim",
        )
    if view.open:
        screen.print(
            f"of {view.open} violations it is not known yet whether the error caused them; they count as caused",
            soft_wrap=True,
            style="dim",
        )


def _show_matrix(screen: Console, view: ToleranceView) -> None:
    """Print a row for each error, with a column for each condition."""
    rows: dict[tuple[str, ...], dict[str, CellView]] = {}
    for cell in view.cells:
        rows.setdefault(tuple(cell.choices.values()), {})[cell.condition] = cell
    table = plain_table("error", *view.conditions)
    for cells in list(rows.values())[:ROWS_SHOWN]:
        table.add_row(
            next(iter(cells.values())).error,
            *(cells[one].tolerated_words if one in cells else "–" for one in view.conditions),
        )
    screen.print(table)
    _show_rest(screen, len(rows) - ROWS_SHOWN)


def _show_rest(screen: Console, rows: int) -> None:
    if rows > 0:
        screen.print(f"… and {rows} more in tolerance.csv", style="dim")


def tolerance_table(cells: Sequence[CellView]) -> Table:
    """Return a table of cells."""
    table = plain_table(
        "error",
        "condition",
        "tolerated",
        "screened",
        "vulnerable",
        "drives",
        "caused",
        right=("screened", "vulnerable", "drives", "caused"),
    )
    for cell in cells:
        table.add_row(
            cell.error,
            cell.condition,
            cell.tolerated_words,
            str(cell.screened or ""),
            str(cell.vulnerable if cell.screened else ""),
            str(cell.drives),
            str(cell.caused),
        )
    return table


class ToleranceFindings:
    """The tolerances of a campaign at the end of `brink run`.

    Args:
        view: The tolerances.
        table: The same as CSV.
    """

    name = "tolerances"

    def __init__(self, view: ToleranceView, table: bytes) -> None:
        self._view = view
        self._table = table
        self._missing: Collection[int] = ()
        self.examples: Sequence[int] = [cell.examples[0].number for cell in view.cells if cell.examples]

    def sentence(self) -> str:
        """Return the findings in one sentence."""
        return self._view.note

    def show(self, screen: Console) -> None:
        """Print the requirement."""
        show_tolerance(screen, self._view, briefly=True)

    def write(self, folder: Path) -> list[Path]:
        """Write the requirement to files; return the files."""
        files = [folder / f"tolerance.{ending}" for ending in ("csv", "json", "md")]
        files[0].write_bytes(self._table)
        write_json(files[1], self._view.model_dump(mode="json"))
        files[2].write_text(requirement_document(self._view, "tolerance.png"), encoding="utf-8")
        return files

    async def draw(self, drawing: Drawing) -> list[Path]:
        """Draw the curves; return the file."""
        self._missing = drawing.missing  # of the replays, which are drawn later
        path = drawing.folder / "tolerance.png"
        await asyncio.to_thread(draw_tolerance, self._view, path)
        return [path]

    def hints(self, campaign: str, database: str) -> list[tuple[str, str]]:
        """Return commands to suggest to the user next, each with its purpose."""
        hints = [(f"tolerance {campaign} --format sentences{database}", "the requirement in sentences")]
        if self.examples and self.examples[0] not in self._missing:
            replay = f"replay {campaign} {self.examples[0]} --out replay.mp4{database}"
            hints.append((replay, "watch an error cause a violation"))
        return hints


async def fetch_tolerance_findings(api: Api, campaign: str) -> ToleranceFindings:
    """Return the tolerances of a campaign, and their table."""
    return ToleranceFindings(await fetch_tolerance(api, campaign), await fetch_csv(api, campaign))
