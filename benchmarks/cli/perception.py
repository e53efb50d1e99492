"""`python -m benchmarks detector | simood | rendering | perturbations`: images, and detectors run on them."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import RenderableType
from rich.text import Text

from benchmarks.cli.output import (
    Processes,
    any_missed,
    conclude,
    conclude_rows,
    rows_table,
    show_progress,
    value_table,
)
from brink.cli.options import RESULTS, AsJson, check_picture
from brink.server.errors import InvalidInput
from brink.sim.perception.user_files import DEFAULT_DETECTOR

if TYPE_CHECKING:
    from benchmarks.detector import ClassAccuracy, DetectorAccuracy, StepAccuracy


def detector(
    detector_id: Annotated[
        str,
        typer.Option(
            "--detector",
            metavar="ID",
            help="Id of the detector, or a file: onnx:FILE, torchscript:FILE, ultralytics:FILE.",
        ),
    ] = DEFAULT_DETECTOR,
    images: Annotated[int, typer.Option(min=10, help="Number of images.")] = 1000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the images and of the perturbations.")] = 2,
    threshold: Annotated[
        float | None,
        typer.Option(
            min=0.01,
            max=0.99,
            help="Minimum score of detections that reach the brake; by default, that of aeb-crossing@1.",
        ),
    ] = None,
    processes: Processes = 2,
    picture: Annotated[Path | None, typer.Option(help="Also draw the figures: .png, .svg or .pdf.")] = None,
    as_json: AsJson = False,
) -> None:
    """Measure how well a detector sees, on fresh images of the simulator and under each perturbation.

    Reports mAP at an IoU of 0.5 by class, distance and visible share, mAP under each perturbation at three levels,
    and precision and recall of people at the brake's threshold.

    Example: python -m benchmarks detector --images 200 --picture detector.png
    """
    from benchmarks.detector import measure_detector
    from brink.server.problems.aeb_crossing import AebCrossingParams

    check_picture(picture)
    _check_detector(detector_id)
    with show_progress() as progress:
        found = measure_detector(
            detector_id,
            images=images,
            seed=seed,
            threshold=threshold or AebCrossingParams().threshold,
            processes=processes,
            progress=progress,
        )
    if picture is not None:
        from benchmarks.detector_figure import figure_detector

        figure_detector(found).savefig(picture)
    shown = _detector_tables(found)
    conclude(found.to_json(), *shown, as_json=as_json, missed=any_missed(found.rows))


def _detector_tables(found: "DetectorAccuracy") -> list[RenderableType]:
    """Return the figures with targets, then tables by perturbation, class, distance and visible share."""
    steps = {**found.genes, "mean": found.over_genes}
    genes = value_table(
        (
            "perturbation",
            *(f"mAP {step}" for step in found.over_genes),
            "people at first: precision",
            "recall",
        ),
        ((gene, *_gene_cells(tuple(by_step.values()))) for gene, by_step in steps.items()),
    )
    classes = value_table(
        ("class", "boxes", "AP", f"precision at {found.threshold:g}", "recall"),
        (
            (
                name,
                f"{one.boxes:,}",
                f"{one.average_precision:.3f}",
                f"{one.precision:.3f}",
                f"{one.recall:.3f}",
            )
            for name, one in found.clean.classes.items()
        ),
    )
    bins = (
        value_table(
            (
                header,
                "mAP",
                *(f"{name} {what}" for name in found.clean.classes for what in ("recall", "AP", "boxes")),
            ),
            (
                (
                    one.name,
                    "–" if accuracy.map is None else f"{accuracy.map:.3f}",
                    *(
                        cell
                        for name in found.clean.classes
                        for cell in _class_cells(accuracy.classes.get(name))
                    ),
                )
                for one, accuracy in by_bin.items()
            ),
        )
        for header, by_bin in (("distance", found.by_distance), ("visible share", found.by_visible_share))
    )
    tables: list[RenderableType] = [rows_table(found.rows, ".3f")]
    for table in (genes, classes, *bins):
        tables += ["", table]
    return [
        *tables,
        Text(
            "false detections count in every range, so average precision is low in a range with few boxes; recall "
            "can be compared",
            style="dim",
        ),
    ]


def _check_detector(detector: str) -> None:
    """Check the id or file of a detector, before any slow work starts.

    Raises:
        InvalidInput: There is no such detector.
    """
    from brink.server.problems.base import wrong_detector

    if wrong := wrong_detector(detector):
        raise InvalidInput.at("--detector", wrong[0][1])


def _gene_cells(steps: "Sequence[StepAccuracy]") -> Iterator[str]:
    """Yield the mAP at each level, and precision and recall of people at the first."""
    for value in (*(one.map for one in steps), steps[0].person_precision, steps[0].person_recall):
        yield f"{value:.3f}"


def _class_cells(one: "ClassAccuracy | None") -> tuple[str, str, str]:
    """Return recall, average precision and number of boxes of a class in a range; it may have none."""
    if one is None:
        return "–", "–", "0"
    return f"{one.recall:.3f}", f"{one.average_precision:.3f}", f"{one.boxes:,}"


def simood(
    criteria: Annotated[
        list[str] | None, typer.Argument(metavar="[A0 … A9]", help="Criteria to measure; all by default.")
    ] = None,
    detector: Annotated[
        str | None, typer.Option(help="Id or file of the detector; by default, that of the problem.")
    ] = None,
    threshold: Annotated[
        float | None,
        typer.Option(
            min=0.01, max=0.99, help="Minimum score of its detections; by default, that of the problem."
        ),
    ] = None,
    repeats: Annotated[
        int,
        typer.Option(
            min=1, help="Searches with each configuration in A6, and campaigns in A9; the paper has 10."
        ),
    ] = 3,
    seeds: Annotated[int, typer.Option(min=1, help="Searches of each kind in A5.")] = 10,
    processes: Processes = 2,
    out: Annotated[
        Path,
        typer.Option(help="Folder for tables, figures and runs; a detector's tables are in a folder below."),
    ] = RESULTS / "bench-simood",
    as_json: AsJson = False,
) -> None:
    """Measure the SiMOOD criteria: a safe baseline, hazards of perturbations, the search, its cost, and interaction.

    The full measurement takes hours. Completed runs are kept in the folder, so the same command continues after an
    interruption, and criteria share episodes. To compare detectors, run it once for each.

    Example: python -m benchmarks simood A0 A2 --detector brink-det@1 --threshold 0.5
    """
    from benchmarks.simood import CRITERIA, measure_simood

    wanted = [name.upper() for name in criteria or CRITERIA]
    for name in wanted:
        if name not in CRITERIA:
            raise InvalidInput.at("criteria", f"expected some of {', '.join(CRITERIA)}, got {name!r}")
    if detector is not None:
        _check_detector(detector)
    with show_progress() as progress:
        rows = measure_simood(
            wanted,
            out,
            processes=processes,
            progress=progress,
            detector=detector,
            threshold=threshold,
            repeats=repeats,
            seeds=seeds,
        )
    conclude_rows(rows, as_json=as_json)


def rendering(
    frames: Annotated[int, typer.Option(min=1, help="Number of frames; medians are shown.")] = 60,
    as_json: AsJson = False,
) -> None:
    """Measure the CPU time needed to render a frame and to compute its labels, for each size and lighting condition.

    Example: python -m benchmarks rendering --frames 60
    """
    from benchmarks.pictures import measure_rendering

    conclude_rows(measure_rendering(frames), as_json=as_json)


def perturbations(
    heights: Annotated[
        list[int] | None, typer.Option("--height", min=36, help="Height of 16:9 frames, in px.")
    ] = None,
    repeats: Annotated[int, typer.Option(min=1, help="Number of calls at each level.")] = 40,
    as_json: AsJson = False,
) -> None:
    """Measure the CPU time of every perturbation at its lowest, middle and highest level.

    If albumentations is installed, its equivalents are measured at the highest level.

    Example: python -m benchmarks perturbations --height 720
    """
    from benchmarks.pictures import measure_perturbations

    conclude_rows(measure_perturbations(heights or (360, 720), repeats), as_json=as_json)
