"""Checks a detector against the tolerances of a campaign, and prints, writes and draws the result."""

import asyncio
import math
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

from rich.console import Console
from rich.text import Text

from brink.api.client import Api
from brink.api.terminal import echo
from brink.cli.options import check_out, console, plain_table, print_json, write_json
from brink.server.csv_text import csv_text
from brink.server.documents import parse_document
from brink.server.errors import InvalidInput
from brink.server.findings.tolerances.views import DetectorView
from brink.server.states import CheckResult

if TYPE_CHECKING:
    from brink.cli.recording_options import GivenRecording
    from brink.recordings.measure import ObservedDrive
    from brink.recordings.recording import Recording
    from brink.server.api.tolerance import DetectorBody

MOST_THRESHOLDS: Final = 50
AUTOMATIC: Final = "auto"
AUTOMATIC_THRESHOLDS: Final = 9


class Format(StrEnum):
    """How results are printed or written."""

    TABLE = "table"
    SENTENCES = "sentences"
    CSV = "csv"
    JSON = "json"
    MARKDOWN = "md"
    HTML = "html"


@dataclass(frozen=True, slots=True, kw_only=True)
class Output:
    """Where results go.

    Attributes:
        form: How they are written.
        out: File to write; None to print.
        picture: File to draw; None for none.
    """

    form: Format
    out: Path | None = None
    picture: Path | None = None

    def write(self, text: str) -> None:
        """Write text that ends with a line feed to the file, or print it."""
        from brink.report.campaign import write_page

        if self.out is None:
            echo(text, nl=False)
        else:
            write_page(self.out, text)

    def write_json(self, document: Any) -> None:
        """Write a document as JSON to the file, or print it."""
        if self.out is None:
            print_json(document)
        else:
            write_json(self.out, document)

    def name_files(self) -> None:
        """Print the names of the files that were written."""
        for path in (self.out, self.picture):
            if path is not None:
                echo(path)


def chosen_format(form: Format | None, out: Path | None, *, as_json: bool, pages: bool) -> Format:
    """Return the format to write.

    Args:
        form: What the user said.
        out: The file to write.
        as_json: Whether the user said --json.
        pages: Whether there is a page in HTML.

    Raises:
        InvalidInput: The options contradict each other.
    """
    if as_json:
        if form is not None or out is not None:
            raise InvalidInput.at("--json", "cannot be combined with --format and --out")
        return Format.JSON
    if form is Format.HTML and not pages:
        raise InvalidInput.at("--format", "html: requires --detections or --episodes, or: brink report ID")
    if out is None:
        return form or Format.TABLE
    named = out.suffix.removeprefix(".").lower()
    files = [Format.CSV, Format.JSON, Format.MARKDOWN, *([Format.HTML] if pages else ())]
    if form is not None and form not in files:
        raise InvalidInput.at("--format", f"expected one of {', '.join(files)} for a file, got {form}")
    check_out(out, *(f".{one}" for one in files if form in (None, one)))
    return Format(named)


class Check(Protocol):
    """A check of a detector."""

    async def run(self, api: Api) -> bool:
        """Run the check, and print, write and draw the result; return whether no cell is *not met*."""


@dataclass(frozen=True, slots=True)
class EpisodesCheck:
    """Checks the detector of another campaign.

    Attributes:
        campaign: The campaign with the tolerances.
        episodes: The other campaign.
        output: Where the result goes.
    """

    campaign: str
    episodes: str
    output: Output

    async def run(self, api: Api) -> bool:
        """Run the check, and print, write and draw the result; return whether no cell is *not met*."""
        from brink.report.detector import detector_page

        view = await api.read(DetectorView, _path(self.campaign), {"episodes": self.episodes})
        about = [
            f"The drives are those of campaign {self.episodes}; watch one with: brink replay {self.episodes} DRIVE."
        ]
        await _give(view, self.output, about, lambda: detector_page(view, about))
        return _is_met(view)


@dataclass(frozen=True, slots=True)
class RecordingCheck:
    """Checks a detector by a recording.

    Attributes:
        campaign: The campaign with the tolerances.
        given: The recording.
        thresholds: Thresholds to compare, as the user said them; None for that of the recording alone.
        images: Folder with pictures of the drives, to show the worst episodes on; None for boxes alone.
        output: Where the result goes.
    """

    campaign: str
    given: "GivenRecording"
    thresholds: str | None
    images: Path | None
    output: Output

    async def run(self, api: Api) -> bool:
        """Run the check, and print, write and draw the result; return whether no cell is *not met*."""
        from brink.report.detector import detector_page
        from brink.report.episode_strips import worst_strips

        shows_many = (
            self.output.form in (Format.TABLE, Format.CSV, Format.JSON) and self.output.picture is None
        )
        if self.thresholds is not None and not shows_many:
            raise InvalidInput.at(
                "--thresholds", "expected a table, .csv or .json, and no picture: these show one threshold"
            )
        recording = await asyncio.to_thread(self.given.read)
        if self.thresholds is not None:
            await self._sweep(api, recording, self.thresholds)
            return True
        observed = await self._observe(recording, self.given.threshold)
        about = self._say(recording)
        view = await self._judge(api, recording, observed)
        await _give(
            view,
            self.output,
            about,
            lambda: detector_page(
                view, about, worst_strips(view, observed, recording.camera, self.given.threshold, self.images)
            ),
        )
        return _is_met(view)

    async def _observe(self, recording: "Recording", threshold: float) -> "list[ObservedDrive]":
        from brink.recordings.measure import observe

        return await asyncio.to_thread(
            observe, recording, threshold=threshold, visibility=self.given.visibility
        )

    async def _judge(
        self, api: Api, recording: "Recording", observed: "Iterable[ObservedDrive]"
    ) -> DetectorView:
        body = _body(recording.name, observed)
        return await api.send(DetectorView, _path(self.campaign), body.model_dump(mode="json"))

    def _say(self, recording: "Recording") -> list[str]:
        """Print the measurements to standard error, and return them."""
        about = self.given.words(recording)
        for words in about:
            echo(words, err=True)
        return about

    async def _sweep(self, api: Api, recording: "Recording", thresholds: str) -> None:
        """Compare thresholds."""
        from brink.cli.recording_options import detection_scores

        views = {}
        for threshold in parse_thresholds(thresholds, detection_scores(recording)):
            views[threshold] = await self._judge(api, recording, await self._observe(recording, threshold))
        self._say(recording)
        match self.output.form:
            case Format.JSON:
                self.output.write_json(
                    [
                        {"threshold": threshold, "check": view.model_dump(mode="json")}
                        for threshold, view in views.items()
                    ]
                )
            case Format.CSV:
                self.output.write(_sweep_csv(views))
            case _:
                show_sweep(console(), views)
        self.output.name_files()


def _path(campaign: str) -> str:
    return f"/campaigns/{campaign}/tolerance/detector"


def _is_met(view: DetectorView) -> bool:
    from brink.report.detector import tally

    return tally(view)["not met"] == 0


def _body(name: str, observed: "Iterable[ObservedDrive]") -> "DetectorBody":
    """Return the errors of a detector in its drives.

    Raises:
        InvalidInput: There are too many drives, or a name is too long.
    """
    from brink.server.api.tolerance import DetectorBody

    drives = [
        {
            "name": one.measured.name,
            "condition": one.measured.condition,
            "measures": {
                target.value: {kind.value: magnitude for kind, magnitude in errors.items()}
                for target, errors in one.measured.errors.magnitudes.items()
            },
            "at_least": {
                target.value: sorted(kind.value for kind in kinds)
                for target, kinds in one.measured.errors.at_least.items()
            },
        }
        for one in observed
    ]
    return parse_document({"detector": name, "drives": drives}, DetectorBody, "errors of a detector")


async def _give(view: DetectorView, output: Output, about: Sequence[str], page: Callable[[], str]) -> None:
    """Print, write and draw a check.

    Args:
        view: The check.
        output: Where it goes.
        about: What was measured, in sentences.
        page: Makes the page in HTML.
    """
    from brink.report.detector import detector_csv, detector_markdown, evidence

    if output.picture is not None:
        await asyncio.to_thread(draw_detector, view, output.picture)
    match output.form:
        case Format.TABLE:
            show_detector(console(), view)
        case Format.SENTENCES:
            output.write("".join(f"{cell.sentence}\n" for cell in evidence(view)) + f"{view.no_data}\n")
        case Format.JSON:
            output.write_json(view.model_dump(mode="json"))
        case Format.CSV:
            output.write(detector_csv(view))
        case Format.MARKDOWN:
            output.write(
                detector_markdown(view, about, None if output.picture is None else output.picture.name)
            )
        case Format.HTML:
            output.write(await asyncio.to_thread(page))
    output.name_files()


def draw_detector(view: DetectorView, path: Path) -> None:
    """Draw a check to a file."""
    from brink.plots.detector import figure_detector

    figure_detector(view).savefig(path)


_STYLES: Final = {
    CheckResult.NOT_MET: "red",
    CheckResult.MET: "green",
    CheckResult.TOO_LITTLE: "yellow",
    CheckResult.NO_DATA: "dim",
}


def show_detector(screen: Console, view: DetectorView) -> None:
    """Print the verdict, a row for each cell with evidence, and what to record next."""
    from brink.report.detector import COLUMNS, NUMBERS, evidence, row_of, small_print

    screen.print(f"{view.note}.", soft_wrap=True, style="bold")
    screen.print(view.meaning, soft_wrap=True, style="dim")
    cells = evidence(view)
    if cells:
        table = plain_table(*COLUMNS, right=NUMBERS)
        for cell in cells:
            result, *others = row_of(cell)
            table.add_row(Text(result, _STYLES[cell.result]), *others)
        screen.print(table)
    for words in small_print(view):
        screen.print(words, soft_wrap=True)
    if view.next:
        screen.print("What to record next:", style="bold")
    for words in view.next:
        screen.print(f"- {words}.", soft_wrap=True)


def parse_thresholds(given: str, scores: Iterable[float]) -> list[float]:
    """Return thresholds in ascending order.

    Args:
        given: Numbers with commas between them, or ``auto`` for nine that are spread evenly over the scores.
        scores: The scores of all detections.

    Raises:
        InvalidInput: Something is not a number, or there are too many.
    """
    if given.strip().lower() == AUTOMATIC:
        different = list(scores)
        if len(set(different)) < 2:
            raise InvalidInput.at("--thresholds", "expected detections with scores, got none that differ")
        tenths = statistics.quantiles(different, n=AUTOMATIC_THRESHOLDS + 1)
        return sorted({round(value, 3) for value in tenths})
    try:
        found = sorted({float(one) for one in given.split(",")})
    except ValueError:
        found = []
    if not (1 <= len(found) <= MOST_THRESHOLDS and all(map(math.isfinite, found))):
        raise InvalidInput.at(
            "--thresholds",
            f"expected 1 to {MOST_THRESHOLDS} numbers such as 0.3,0.5,0.7, or auto; got {given!r:.80}",
        )
    return found


def show_sweep(screen: Console, views: Mapping[float, DetectorView]) -> None:
    """Print a row for each threshold, and the cells whose result depends on it."""
    from brink.report.detector import tally

    table = plain_table(
        "threshold", "not met", "unknown", "met", right=("threshold", "not met", "unknown", "met")
    )
    for threshold, view in views.items():
        table.add_row(f"{threshold:g}", *map(str, tally(view).values()))
    screen.print(table)
    results = _by_cell(views)
    changing = {cell: found for cell, found in results.items() if len(set(found)) > 1}
    if changing:
        screen.print(f"The threshold decides {len(changing)} of {len(results)} cells:", style="bold")
        columns = [f"{threshold:g}" for threshold in views]
        changes = plain_table("error", "condition", *columns)
        for cell, found in changing.items():
            changes.add_row(*cell[:2], *(Text(_SHORT[result], _STYLES[result]) for result in found))
        screen.print(changes)
    else:
        screen.print(f"The threshold decides none of {len(results)} cells.")
    screen.print(
        "A threshold that was chosen by these drives must be checked by others.", soft_wrap=True, style="dim"
    )


_SHORT: Final = {
    CheckResult.NOT_MET: "not met",
    CheckResult.MET: "met",
    CheckResult.TOO_LITTLE: "unknown",
    CheckResult.NO_DATA: "no data",
}


def _by_cell(views: Mapping[float, DetectorView]) -> dict[tuple[str, ...], list[CheckResult]]:
    """Return the results of each cell by its error, condition and choices, in the order of the thresholds."""
    found: dict[tuple[str, ...], list[CheckResult]] = {}
    for view in views.values():
        for cell in view.cells:
            found.setdefault((cell.error, cell.condition, *cell.choices.values()), []).append(cell.result)
    return found


def _sweep_csv(views: Mapping[float, DetectorView]) -> str:
    rows: list[Sequence[object]] = [
        ("threshold", "error", "condition", "result", "drives", "share", "low", "high")
    ]
    rows += [
        (
            threshold,
            cell.error,
            cell.condition,
            cell.result.value,
            cell.drives,
            cell.share,
            cell.low,
            cell.high,
        )
        for threshold, view in views.items()
        for cell in view.cells
    ]
    return csv_text(rows)
