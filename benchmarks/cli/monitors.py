"""`python -m benchmarks monitor | monitor-accuracy | guard`: the models that are fitted to drives."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmarks.cli.output import Processes, any_missed, conclude, rows_table, show_progress, value_table
from brink.cli.options import RESULTS, AsJson, check_picture, fields
from brink.search.analysis.monitor import Answer
from brink.server.errors import InvalidInput

if TYPE_CHECKING:
    from benchmarks.guard import Judged


def monitor_accuracy(
    drives: Annotated[
        int, typer.Option(min=100, help="Random drives to which each monitor is fitted.")
    ] = 1300,
    fresh: Annotated[int, typer.Option(min=100, help="Fresh random drives.")] = 2000,
    seeds: Annotated[int, typer.Option(min=1, help="Number of training sets.")] = 4,
    processes: Processes = 2,
    out: Annotated[Path, typer.Option(help="Folder for verdicts, which are not simulated again.")] = RESULTS
    / "bench-monitor",
    picture: Annotated[
        Path | None,
        typer.Option(help="PNG or SVG file for a plot of trees fitted to the first training set."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare the models of safety monitors on fresh random drives of the urban problem (front gap).

    Example: python -m benchmarks monitor-accuracy --seeds 4
    """
    from benchmarks.monitor_accuracy import MonitorAccuracy, mean_rows

    check_picture(picture)
    out.mkdir(parents=True, exist_ok=True)
    with show_progress() as progress:
        found, evaluation = MonitorAccuracy(
            out, drives=drives, fresh=fresh, seeds=range(1, seeds + 1), processes=processes, progress=progress
        ).measure()
    if picture is not None:
        from brink.plots.evidence import figure_monitor

        figure_monitor(evaluation).savefig(picture)
    rows = mean_rows(found)
    each = value_table(
        (
            "model",
            "seed",
            "AUROC",
            "Brier",
            "calibration error",
            "bins within",
            *(f"{answer} (were)" for answer in Answer),
            "unlike",
            "agreement",
            "fit s",
            "query ms",
        ),
        (
            (
                one.model,
                one.seed,
                f"{one.metrics.auroc:.3f}",
                f"{one.metrics.brier:.3f}",
                f"{one.metrics.calibration_error:.3f}",
                sum(bin_.within for bin_ in one.metrics.bins),
                *(
                    f"{count:,}" + (f" ({unsafe / count:.1%})" if count else "")
                    for count, unsafe in one.answers.values()
                ),
                one.unlike,
                "" if one.agreement is None else f"{one.agreement:.0%}",
                f"{one.fit_s:.1f}",
                f"{one.query_ms:.2f}",
            )
            for one in found
        ),
    )
    document = {"each": [asdict(one) for one in found], "means": [fields(row) for row in rows]}
    conclude(document, each, rows_table(rows, ".3f"), as_json=as_json, missed=any_missed(rows))


def guard(
    drives: Annotated[int, typer.Option(min=100, help="Fresh random drives.")] = 2000,
    training: Annotated[int, typer.Option(min=100, help="Drives to which each guard is fitted.")] = 1300,
    sets: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME",
            show_default=False,
            help="Training set: random, MLCSHE, edge or mixture; may be repeated (default: all).",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the training sets.")] = 1,
    requirement: Annotated[
        str, typer.Option(help="Requirement whose violation the guards predict.")
    ] = "front-gap@1",
    processes: Processes = 2,
    out: Annotated[Path, typer.Option(help="Folder for drives, which are not simulated again.")] = RESULTS
    / "bench-guard",
    picture: Annotated[
        Path | None,
        typer.Option(help="PNG or SVG file for a plot of the guard of the first training set, boxes alone."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure how early guards warn on fresh drives, for each training set and sensor, beside baselines.

    Example: python -m benchmarks guard --drives 2000 --picture guard.png
    """
    from benchmarks.guard import SETS, GuardBench, baseline_rows

    check_picture(picture)
    chosen = tuple(sets or SETS)
    for one in chosen:
        if one not in SETS:
            raise InvalidInput.at("--set", f"expected some of {', '.join(SETS)}, got {one!r}")
    with show_progress() as progress:
        measured = GuardBench(
            out,
            training=training,
            fresh=drives,
            seed=seed,
            requirement=requirement,
            sets=chosen,
            processes=processes,
            progress=progress,
        ).measure()
    if picture is not None:
        from brink.plots.guard import figure_guard

        figure_guard(measured.judged[0].evaluation).savefig(picture)
    rows = list(measured.rows())
    each = value_table(_GUARD_COLUMNS, map(_guard_row, measured.judged))
    unseen = value_table(_GUARD_COLUMNS, map(_guard_row, measured.unseen))
    baselines = value_table(
        ("baseline", "predicted", "false alarms", "at 10%", "at 20%"),
        baseline_rows(measured.judged[-1].evaluation),
    )
    shown = (rows_table(rows, ".3f"), each, baselines, unseen)
    conclude(measured.to_json(), *shown, as_json=as_json, missed=any_missed(rows))


_GUARD_COLUMNS = (
    "fitted to",
    "sensor",
    "judged on",
    "drives",
    "violations",
    "predicted",
    "interval",
    "at 10%",
    "at 20%",
    "own: predicted",
    "recent",
    "false alarms",
    "an hour",
    "lead s",
    "AUROC",
    "Brier",
    "fit s",
)


def _guard_row(one: "Judged") -> tuple[object, ...]:
    evaluation = one.evaluation
    compared, own, last = evaluation.guard.compared, evaluation.own, evaluation.horizons[-1]
    low, high = evaluation.guard.interval
    lead = "" if own.median_lead_s is None else f"{own.median_lead_s:.1f}"
    return (
        one.trained_on,
        one.sensor,
        one.judged_on,
        f"{evaluation.drives:,}",
        f"{evaluation.violations:,}",
        f"{compared.recall:.2f}",
        f"{low:.2f} to {high:.2f}",
        *(f"{point.recall:.2f}" for point in evaluation.guard.more),
        f"{own.point.recall:.2f}",
        f"{own.recent:.2f}",
        f"{own.point.false_alarms:.1%}",
        f"{own.false_per_hour:.1f}",
        lead,
        f"{last.auroc:.3f}",
        f"{last.brier:.4f}",
        f"{one.fit_s:.0f}",
    )
