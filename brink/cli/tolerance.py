"""`brink tolerance`: how severe a component's errors may be, and the requirement that follows."""

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Final

import typer

from brink.api.client import Api
from brink.cli.detector import Check, EpisodesCheck, Format, Output, RecordingCheck, chosen_format
from brink.cli.findings import print_table, show_kind
from brink.cli.options import (
    AsJson,
    CampaignId,
    Database,
    Server,
    check_ids,
    check_picture,
    console,
    print_json,
    with_api,
)
from brink.cli.recording_options import RecordingOptions, with_recording
from brink.recordings.choices import format_names
from brink.report.tables import markdown_rows
from brink.report.tolerance import requirement_document, tolerances_beside
from brink.server.api.schemas import CampaignView
from brink.server.errors import InvalidInput
from brink.server.findings.tolerances.views import AgreementView, ToleranceView

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
            f"the format of --detections: {', '.join(format_names())} (default: recognised). Applies to both.",
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
    beside: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ID",
            show_default=False,
            callback=check_ids,
            help="Show the tolerances of another campaign beside, such as one with another driving system; may be "
            "repeated.",
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

    Example: brink tolerance 3f2a --beside 77d0 --beside 91bc --out planners.md

    Example: brink tolerance 3f2a --detections det/ --truth label_02/ --calibration camera.yaml --out check.html

    Example: brink tolerance 3f2a --episodes 9c01 --gate
    """
    from brink.cli.recording_options import GivenRecording

    if coco is not None:
        if detections is not None or recording.truth is not None:
            raise InvalidInput.at("--coco", "cannot be combined with --detections or --truth")
        recording = replace(recording, truth=coco[0])
        detections, forms = coco[1], [*(forms or ()), "coco"]
    given = [
        name
        for name, value in (
            ("--against", against),
            ("--beside", beside),
            ("--episodes", episodes),
            ("--detections", detections),
        )
        if value
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
    if beside:
        _show_beside(list(dict.fromkeys([campaign, *beside])), wanted, server, database)
        return
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
        is_recorded = detections is not None and name in format_names()
        if is_recorded and name in RESULTS_FORMATS:
            is_recorded = detections is not None and detections.suffix.lower() != f".{name}"
        if is_recorded and recording is None:
            recording = name
        elif name in RESULTS_FORMATS and written is None:
            written = Format(name)
        elif name in RESULTS_FORMATS or name in format_names():
            expected = "it once" if detections is not None else "the format of a recording with --detections"
            raise InvalidInput.at("--format", f"{name}: expected {expected}")
        else:
            raise InvalidInput.at(
                "--format",
                f"expected one of {', '.join(Format)}, or of a recording {', '.join(format_names())}; got "
                f"{name!r:.40}",
            )
    return written, recording


def _show(campaign: str, wanted: Output, server: str | None, database: str | None) -> None:
    """Print, write and draw the tolerances of a campaign."""

    async def work(api: Api) -> None:
        path = f"/campaigns/{campaign}/tolerance"
        view = await api.read(ToleranceView, path)
        if wanted.picture is not None:
            from brink.cli.kind_files import draw_tolerance

            await asyncio.to_thread(draw_tolerance, view, wanted.picture)
        match wanted.form:
            case Format.TABLE | Format.HTML:
                await show_kind(api, campaign, "tolerances", {})
            case Format.SENTENCES:
                wanted.write("".join(f"{cell.sentence}\n" for cell in view.cells))
            case Format.JSON:
                wanted.write_json(view.model_dump(mode="json"))
            case Format.MARKDOWN:
                wanted.write(
                    requirement_document(view, None if wanted.picture is None else wanted.picture.name)
                )
            case Format.CSV:
                wanted.write((await api.request("GET", path, params={"format": "csv"})).content.decode())
        wanted.name_files()

    with_api(server, database, work)


def _show_beside(campaigns: Sequence[str], wanted: Output, server: str | None, database: str | None) -> None:
    """Print or write the tolerances of campaigns side by side, named by their driving systems if these differ."""
    if wanted.picture is not None:
        raise InvalidInput.at("--picture", "cannot be combined with --beside")

    async def work(api: Api) -> None:
        views = [await api.read(ToleranceView, f"/campaigns/{one}/tolerance") for one in campaigns]
        bodies = [(await api.read(CampaignView, f"/campaigns/{one}")).body for one in campaigns]
        names = [str(body.problem.params.get("driving", "")) for body in bodies]
        if len(set(names)) < len(names):
            names = [f"{body.name} ({view.campaign})" for body, view in zip(bodies, views, strict=True)]
        table, words = tolerances_beside(dict(zip(names, views, strict=True)))
        match wanted.form:
            case Format.JSON:
                wanted.write_json({"words": words, "cells": table.records()})
            case Format.CSV:
                wanted.write(table.to_bytes("csv").decode())
            case Format.MARKDOWN:
                wanted.write("\n".join([*markdown_rows(table), "", f"{words}.", ""]))
            case Format.TABLE:
                print_table(console(), table)
                console().print(f"{words}.", soft_wrap=True)
            case _:
                raise InvalidInput.at("--format", "expected table, csv, json or md with --beside")
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
    print_table(console(), view.table)
    console().print(view.note, soft_wrap=True)
