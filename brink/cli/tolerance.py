"""`brink tolerance`: how gross a component's errors may be, and the requirement that follows."""

import asyncio
from collections.abc import Collection, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from brink.api.client import Api
from brink.api.terminal import echo
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
from brink.report.figures import Drawing
from brink.report.tolerance import KEY, requirement_document, tolerated_words
from brink.server.api.tolerance import (
    AgreementView,
    CellView,
    DetectorBody,
    DetectorView,
    DriveBody,
    ToleranceView,
)
from brink.server.campaigns.detector_check import CheckResult
from brink.server.errors import InvalidInput
from brink.sim.urban.detection_files import CameraModel, read_coco, read_csv

ROWS_SHOWN: Final = 30
"""Most rows of the table at the end of a run."""
MOST_CONDITIONS: Final = 4
"""Conditions beside which their tolerances fit."""


class Format(StrEnum):
    """How tolerances are written."""

    TABLE = "table"
    SENTENCES = "sentences"
    CSV = "csv"
    JSON = "json"
    MARKDOWN = "md"


def tolerance(
    campaign: CampaignId,
    form: Annotated[
        Format | None,
        typer.Option(
            "--format", help="Format (default: by the name of --out, else table).", show_default=False
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="File to write: .csv, .json or .md.", show_default=False)
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Draw the curves (.png or .svg).", show_default=False)
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
            metavar="FILE.csv",
            show_default=False,
            help="Check a detector against it: its boxes beside the truth as CSV.",
        ),
    ] = None,
    coco: Annotated[
        tuple[Path, Path] | None,
        typer.Option(
            metavar="TRUTH RESULTS",
            show_default=False,
            help="Check a detector against it: sequences in COCO format, and the detections (.json).",
        ),
    ] = None,
    camera: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(
            metavar="WIDTH HEIGHT FOV ABOVE",
            show_default=False,
            help="Camera of --detections or --coco: size in px, horizontal field of view in degrees, height in m "
            "(default: 800 600 90 1.7).",
        ),
    ] = None,
    threshold: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Smallest score of detections in --coco that count.")
    ] = 0.5,
    frames_per_s: Annotated[
        float | None,
        typer.Option(
            min=1.0, show_default=False, help="Frames per second of --coco, without times in the images."
        ),
    ] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Show how gross errors may be, by type of error, target and condition, with intervals.

    The campaign must be a search for tolerances, such as that of examples/tolerance.yaml. It may still be running.

    Example: brink tolerance 3f2a

    Example: brink tolerance 3f2a --format sentences

    Example: brink tolerance 3f2a --out requirement.csv --picture requirement.png

    Example: brink tolerance 3f2a --against 9c01

    Example: brink tolerance 3f2a --detections my-detector.csv --camera 1920 1080 60 1.4
    """
    given = [name for name, value in (("--against", against), ("--episodes", episodes), ("--detections", detections),
                                      ("--coco", coco)) if value is not None]  # fmt: skip
    if len(given) > 1:
        raise InvalidInput.at(given[1], f"expected it without {given[0]}")
    if episodes is not None or detections is not None or coco is not None:
        body = None
        if episodes is None:
            body = _read_detector(detections, coco, camera, threshold, frames_per_s)
        _hold_against(campaign, episodes, body, server, database, as_json=as_json)
        return
    if against is not None:
        _compare(campaign, against, server, database, as_json=as_json)
        return
    wanted = _format(form, out, as_json=as_json)
    check_picture(picture)

    async def work(api: Api) -> None:
        view = await fetch_tolerance(api, campaign)
        if picture is not None:
            await asyncio.to_thread(draw_tolerance, view, picture)
        match wanted:
            case Format.TABLE:
                show_tolerance(console(), view)
            case Format.SENTENCES:
                for cell in view.cells:
                    echo(cell.sentence)
            case Format.JSON:
                document = view.model_dump(mode="json")
                if out is None:
                    print_json(document)
                else:
                    write_json(out, document)
            case Format.MARKDOWN:
                text = requirement_document(view, None if picture is None else picture.name)
                if out is None:
                    echo(text, nl=False)
                else:
                    out.write_text(text, encoding="utf-8")
            case Format.CSV:
                table = await fetch_csv(api, campaign)
                if out is None:
                    echo(table.decode(), nl=False)
                else:
                    out.write_bytes(table)
        for path in (out, picture):
            if path is not None:
                echo(path)

    with_api(server, database, work)


def _read_detector(
    detections: Path | None,
    coco: tuple[Path, Path] | None,
    camera: tuple[float, float, float, float] | None,
    threshold: float,
    frames_per_s: float | None,
) -> DetectorBody:
    """Return the errors of a detector from files.

    Raises:
        DetectionFileError: A file cannot be used.
    """
    model = None
    if camera is not None:
        width_px, height_px, fov_deg, height_m = camera
        model = CameraModel(width_px=width_px, height_px=height_px, fov_deg=fov_deg, height_m=height_m)
    if coco is not None:
        drives = read_coco(*coco, threshold=threshold, frames_per_s=frames_per_s, camera=model)
        name = coco[1].stem
    elif detections is not None:
        drives = read_csv(detections, model)
        name = detections.stem
    else:
        raise InvalidInput.at("--detections", "expected a file")
    return DetectorBody(
        detector=name,
        drives=[
            DriveBody(
                name=drive.name,
                condition=drive.condition,
                measures={
                    target.value: {kind.value: magnitude for kind, magnitude in errors.items()}
                    for target, errors in drive.errors.magnitudes.items()
                },
                at_least={
                    target.value: sorted(kind.value for kind in kinds)
                    for target, kinds in drive.errors.at_least.items()
                },
            )
            for drive in drives
        ],
    )


def _hold_against(
    campaign: str,
    episodes: str | None,
    body: DetectorBody | None,
    server: str | None,
    database: str | None,
    *,
    as_json: bool,
) -> None:
    """Print whether a detector meets the requirement of a campaign."""
    path = f"/campaigns/{campaign}/tolerance/detector"

    async def work(api: Api) -> DetectorView:
        if body is None:
            return await api.read(DetectorView, path, {"episodes": episodes})
        return await api.send(DetectorView, path, body.model_dump(mode="json"))

    view = with_api(server, database, work)
    if as_json:
        print_json(view.model_dump(mode="json"))
    else:
        show_detector(console(), view)


_RESULT_STYLES: Final = {
    CheckResult.MET: "green", CheckResult.NOT_MET: "red", CheckResult.TOO_LITTLE: "yellow",
    CheckResult.NO_DATA: "dim",
}  # fmt: skip


def show_detector(screen: Console, view: DetectorView) -> None:
    """Print a row for each cell, and how often the detector's own drives violated."""
    screen.print(view.note, soft_wrap=True, style="bold")
    screen.print(
        f"met: with {view.confidence:.0%} confidence, errors of this size make at most {view.limit:.0%} of "
        "drives violate; each type of error for itself",
        soft_wrap=True,
        style="dim",
    )
    table = plain_table(
        "error", "condition", "drives", "median", "95% within", "beyond", "violate", "", "requirement", "worst",
        right=("drives", "median", "95% within", "beyond", "violate"),
    )  # fmt: skip
    for cell in view.cells:
        if cell.result is CheckResult.NO_DATA:
            continue
        share, interval = "–", ""
        if cell.share is not None and cell.low is not None and cell.high is not None:
            share, interval = f"{cell.share:.1%}", f"[{cell.low:.1%}, {cell.high:.1%}]"
        table.add_row(
            cell.error, cell.condition, str(cell.drives),
            _with_unit(cell.typical, cell.unit), _with_unit(cell.grossest, cell.unit), str(cell.beyond), share,
            interval, Text(cell.result, _RESULT_STYLES[cell.result]), " ".join(cell.worst[:3]),
        )  # fmt: skip
    screen.print(table)
    for words in (view.no_data, *view.next):
        if words:
            screen.print(words, soft_wrap=True)
    for one in view.conditions:
        if one.violations is not None:
            screen.print(
                f"{one.condition}: {one.violations} of {one.drives} drives with this detector violate",
                soft_wrap=True,
            )


def _with_unit(magnitude: float | None, unit: str) -> str:
    if magnitude is None:
        return "–"
    return f"{magnitude:.0f}%" if unit == "%" else f"{magnitude:.1f} {unit}".rstrip()


def _compare(campaign: str, fresh: str, server: str | None, database: str | None, *, as_json: bool) -> None:
    """Print whether fresh drives are as predicted."""

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
            cell.error, cell.condition, str(cell.drives), str(cell.caused),
            f"{cell.low} to {cell.high}", "" if cell.agrees else Text("not as predicted", "yellow"),
        )  # fmt: skip
    screen = console()
    screen.print(table)
    screen.print(view.note, soft_wrap=True)


def _format(form: Format | None, out: Path | None, *, as_json: bool) -> Format:
    """Return the format to write.

    Raises:
        InvalidInput: The options contradict each other.
    """
    if as_json:
        if form is not None or out is not None:
            raise InvalidInput.at("--json", "expected --json without --format and --out")
        return Format.JSON
    if out is None:
        return form or Format.TABLE
    named = out.suffix.removeprefix(".")
    files = (Format.CSV.value, Format.JSON.value, Format.MARKDOWN.value)
    if named not in files or (form is not None and form != named):
        raise InvalidInput.at(
            "--out", f"{out}: expected a file name that ends in .{form or 'csv, .json or .md'}"
        )
    return Format(named)


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
    """Print the requirement: the tolerances, then where more error is safer, and the drives without error.

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
            f"{one.condition}{f' ({only})' if only else ''}", str(share.evaluated),
            f"{share.unsafe / share.evaluated:.0%} [{share.low:.0%}, {share.high:.0%}]" if share.evaluated else "–",
        )  # fmt: skip
    screen.print(table)
    if view.audited:
        screen.print(
            f"drives that hold with the grossest error are taken to hold with milder ones; of {view.audited} "
            f"that were simulated all the same, {view.leaks} violated",
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
            *(" ".join(tolerated_words(cells[one])) if one in cells else "–" for one in view.conditions),
        )
    screen.print(table)
    _show_rest(screen, len(rows) - ROWS_SHOWN)


def _show_rest(screen: Console, rows: int) -> None:
    if rows > 0:
        screen.print(f"… and {rows} more in tolerance.csv", style="dim")


def tolerance_table(cells: Sequence[CellView]) -> Table:
    """Return a table of cells."""
    table = plain_table(
        "error", "condition", "tolerated", "", "screened", "vulnerable", "drives", "caused",
        right=("tolerated", "screened", "vulnerable", "drives", "caused"),
    )  # fmt: skip
    for cell in cells:
        table.add_row(
            cell.error, cell.condition, *tolerated_words(cell), str(cell.screened or ""),
            str(cell.vulnerable if cell.screened else ""), str(cell.drives), str(cell.caused),
        )  # fmt: skip
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
