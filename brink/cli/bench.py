"""`brink bench`: benchmarks of this installation, with a target for each figure."""

import asyncio
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import httpx
import typer
import yaml
from rich.console import RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as ProgressBars
from rich.table import Table
from rich.text import Text

from brink.api.client import TIMEOUT, Api
from brink.api.live import Steps
from brink.bench.measurement import Progress, Row
from brink.cli.campaigns import follow
from brink.cli.compare import compared, print_rows, rows_json
from brink.cli.local import RunOptions
from brink.cli.options import (
    RESULTS,
    AsJson,
    Database,
    New,
    Resume,
    Workers,
    about_file,
    check_picture,
    console,
    fields,
    file_name,
    plain_table,
    print_json,
    write_json,
)
from brink.search.analysis.comparison import Row as ComparisonRow
from brink.search.analysis.monitor import Answer
from brink.server.api.schemas import CampaignView
from brink.server.api.schemas import Progress as CampaignProgress
from brink.server.campaigns.body import CampaignBody, read_campaign_file
from brink.server.errors import InvalidInput
from brink.server.experiments.body import read_experiment_file
from brink.sim.perception.user_files import DEFAULT_DETECTOR

if TYPE_CHECKING:
    from brink.bench.detector import ClassAccuracy, DetectorAccuracy, StepAccuracy
    from brink.bench.guard import Judged
    from brink.bench.heredity import Heredity

bench = typer.Typer(
    help="Benchmark this installation and compare each figure with its target.", no_args_is_help=True
)

PAPER_FILES = tuple(Path("examples") / f"paper-{name}.yaml" for name in ("mlcshe", "ga", "random"))
PAPER_TARGET_S = 180.0
HEREDITY_FILE = Path("examples") / "heredity.yaml"

Processes = Annotated[int, typer.Option(min=1, help="Number of processes.")]

# Commands import their measurement themselves: most load a simulator or need optional packages.


@contextmanager
def _progress() -> Iterator[Progress]:
    """Yield a progress callback that draws bars on a terminal, and otherwise prints a line every 10%."""
    screen = console(stderr=True)
    bars = ProgressBars(
        TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
        console=screen, transient=True,
    )  # fmt: skip
    parts: dict[str, TaskID] = {}
    tenths: dict[str, int] = {}

    def report(part: str, done: int, total: int) -> None:
        if part not in parts:
            parts[part] = bars.add_task(part, total=total)
        bars.update(parts[part], completed=done, visible=screen.is_terminal and done < total)
        tenth = 10 * done // max(1, total)
        if not screen.is_terminal and tenths.get(part) != tenth:
            screen.print(f"{part}: {done} of {total}", highlight=False)
        tenths[part] = tenth

    with bars:
        yield report


def _conclude(document: Any, *shown: RenderableType, as_json: bool, missed: bool = False) -> None:
    """Print a measurement as JSON or as text, and exit with 1 if it misses a target.

    Args:
        document: JSON document of the measurement.
        shown: Tables and lines of the text output.
        as_json: Whether to print the document.
        missed: Whether a target is missed.
    """
    if as_json:
        print_json(document)
    else:
        screen = console()
        for part in shown:
            screen.print(part)
    if missed:
        raise typer.Exit(1)


def _conclude_rows(rows: list[Row], *, as_json: bool) -> None:
    """Print measured figures with their targets, and exit with 1 if a target is missed."""
    table = _table(
        ("what", "value", "target", "", "of"),
        ((row.what, f"{row.value:.4g}", row.target, _met(row.met), row.note) for row in rows),
    )
    missed = any(row.met is False for row in rows)
    _conclude([fields(row) for row in rows], table, as_json=as_json, missed=missed)


def _conclude_times(rows: Iterable[Any], columns: Mapping[str, str], *names: str, as_json: bool) -> None:
    """Print measured times with their targets in ms, and exit with 1 if a target is missed.

    Args:
        rows: Measurements with the attributes `target_ms` and `met`.
        columns: Format of each column's value, by header.
        names: Fields of the JSON document; all by default.
        as_json: Whether to print the document.
    """
    found = list(rows)
    table = _table(
        (*columns, "target ms", ""),
        ((*(form.format(row) for form in columns.values()), _bound(row.target_ms), _met(row.met)) for row in found),
    )  # fmt: skip
    _conclude([fields(row, *names) for row in found], table, as_json=as_json)


def _table(columns: Sequence[str], rows: Iterable[Sequence[object]] = ()) -> Table:
    """Return a table whose values are aligned to the right."""
    table = plain_table(*columns, right={*columns[1:]} - {"target", "", "of"})
    for row in rows:
        table.add_row(*map(str, row))
    return table


def _met(met: bool | None) -> str:
    """Return whether a target is met; empty if there is none."""
    return {None: "", True: "met", False: "MISSED"}[met]


def _bound(bound: float | None, words: str = "at most") -> str:
    """Return a target in words; empty without one."""
    return "" if bound is None else f"{words} {bound:g}"


@bench.command()
def difficulty(
    candidates: Annotated[int, typer.Option(min=100, help="Number of random candidates.")] = 2000,
    share: Annotated[
        float, typer.Option(min=0.01, max=1.0, help="Fraction by which to scale the other sample sizes.")
    ] = 1.0,
    processes: Processes = 2,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    as_json: AsJson = False,
) -> None:
    """Measure how hard the urban problem is and what determines its verdicts.

    Example: brink bench difficulty --candidates 2000
    """
    from brink.bench.urban import Sizes, measure_difficulty

    full = Sizes()
    sizes = Sizes(
        candidates=candidates,
        **{
            name: max(20, round(share * getattr(full, name)))
            for name in ("scenarios", "reruns", "pairs", "redraws", "ends")
        },
    )
    with _progress() as progress:
        rows = list(measure_difficulty(sizes, seed=seed, processes=processes, progress=progress))
    _conclude_rows(rows, as_json=as_json)


@bench.command()
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

    Example: brink bench simood A0 A2 --detector brink-det@1 --threshold 0.5
    """
    from brink.bench.simood import CRITERIA, measure_simood
    from brink.server.problems.base import wrong_detector

    wanted = [name.upper() for name in criteria or CRITERIA]
    for name in wanted:
        if name not in CRITERIA:
            raise InvalidInput.at("criteria", f"expected some of {', '.join(CRITERIA)}, got {name!r}")
    if detector is not None and (wrong := wrong_detector(detector)):
        raise InvalidInput.at("--detector", wrong[0][1])
    with _progress() as progress:
        rows = measure_simood(
            wanted, out, processes=processes, progress=progress, detector=detector, threshold=threshold,
            repeats=repeats,
        )  # fmt: skip
    _conclude_rows(rows, as_json=as_json)


@bench.command()
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

    Example: brink bench detector --images 200 --picture detector.png
    """
    from brink.bench.detector import measure_detector
    from brink.server.problems.aeb_crossing import AebCrossingParams
    from brink.server.problems.base import wrong_detector

    check_picture(picture)
    if wrong := wrong_detector(detector_id):
        raise InvalidInput.at("--detector", wrong[0][1])
    with _progress() as progress:
        found = measure_detector(
            detector_id, images=images, seed=seed, threshold=threshold or AebCrossingParams().threshold,
            processes=processes, progress=progress,
        )  # fmt: skip
    if picture is not None:
        from brink.bench.detector_figure import figure_detector

        picture.parent.mkdir(parents=True, exist_ok=True)
        figure_detector(found).savefig(picture)
    missed = any(row.met is False for row in found.rows)
    _conclude(found.to_json(), *_detector_tables(found), as_json=as_json, missed=missed)


def _detector_tables(found: "DetectorAccuracy") -> list[RenderableType]:
    """Return the figures with targets, then tables by perturbation, class, distance and visible share."""
    targets = _table(
        ("what", "value", "target", "", "of"),
        ((row.what, f"{row.value:.3f}", row.target, _met(row.met), row.note) for row in found.rows),
    )
    steps = {**found.genes, "mean": found.over_genes}
    genes = _table(
        (
            "perturbation",
            *(f"mAP {step}" for step in found.over_genes),
            "people at first: precision",
            "recall",
        ),
        ((gene, *_gene_cells(tuple(by_step.values()))) for gene, by_step in steps.items()),
    )
    classes = _table(
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
        _table(
            (header, "mAP", *(f"{name} {what}" for name in found.clean.classes for what in ("AP", "boxes"))),
            (
                (one.name, "–" if accuracy.map is None else f"{accuracy.map:.3f}",
                 *(cell for name in found.clean.classes for cell in _class_cells(accuracy.classes.get(name))))
                for one, accuracy in by_bin.items()
            ),
        )
        for header, by_bin in (("distance", found.by_distance), ("visible share", found.by_visible_share))
    )  # fmt: skip
    tables: list[RenderableType] = [targets]
    for table in (genes, classes, *bins):
        tables += ["", table]
    return tables


def _gene_cells(steps: "Sequence[StepAccuracy]") -> Iterator[str]:
    """Yield the mAP at each level, and precision and recall of people at the first."""
    for value in (*(one.map for one in steps), steps[0].person_precision, steps[0].person_recall):
        yield f"{value:.3f}"


def _class_cells(one: "ClassAccuracy | None") -> tuple[str, str]:
    """Return average precision and number of boxes of a class in a range; it may have none."""
    return ("–", "0") if one is None else (f"{one.average_precision:.3f}", f"{one.boxes:,}")


@bench.command()
def mumoea(
    seeds: Annotated[int, typer.Option(min=2, help="Number of searches with each method.")] = 5,
    simulations: Annotated[int, typer.Option(min=100, help="Simulations per search.")] = 2000,
    road: Annotated[
        str, typer.Option(help="Shape of the road: crossroad, straight, right, left.")
    ] = "crossroad",
    method: Annotated[
        list[str] | None, typer.Option(help="Compare only this method; may be given several times.")
    ] = None,
    processes: Processes = 2,
    out: Annotated[Path, typer.Option(help="Folder for tables, figures and runs.")] = RESULTS
    / "bench-mumoea",
    as_json: AsJson = False,
) -> None:
    """Compare MAP-Elites, muMOEA with its ablations, MOSAT, NSGA-II and random search, at equal budgets.

    Two methods get their seeds from a stand-in for a language model, which answers with hand-written patterns: no
    trained model is used. The full comparison takes hours. Completed searches are kept in the folder, so the same
    command continues after an interruption.

    Example: brink bench mumoea --simulations 600 --method MAP-Elites --method "random search"
    """
    from brink.bench.mumoea import METHODS, Comparison
    from brink.server.problems.catalogue import make_params
    from brink.server.problems.npc_actions import NpcActionsParams

    methods = method or list(METHODS)
    if unknown := [name for name in methods if name not in METHODS]:
        raise InvalidInput.at("--method", f"expected one of {', '.join(METHODS)}; got {unknown[0]!r}")
    params = make_params(NpcActionsParams, {"road_curve": road}, "/problem/params")
    out.mkdir(parents=True, exist_ok=True)
    with _progress() as progress:
        rows = Comparison(
            out, params, seeds=seeds, simulations=simulations, processes=processes, progress=progress,
            methods=methods,
        ).rows()  # fmt: skip
    _conclude_rows(rows, as_json=as_json)


@bench.command()
def drivers(
    candidates: Annotated[int, typer.Option(min=20, help="Random candidates in each weather.")] = 220,
    weather: Annotated[
        list[str] | None,
        typer.Option(help="Weather; may be given several times. [clear, soft_rain, hard_rain]"),
    ] = None,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    processes: Processes = 2,
    as_json: AsJson = False,
) -> None:
    """Check the reference drivers: do they collide on empty roads, or where the driving system is safe?

    Example: brink bench drivers --candidates 50 --weather clear
    """
    from brink.bench.drivers import measure_drivers
    from brink.sim.world.scenario import Weather

    weathers = weather or [Weather.CLEAR.value, Weather.SOFT_RAIN.value, Weather.HARD_RAIN.value]
    known = [one.value for one in Weather]
    if unknown := [name for name in weathers if name not in known]:
        raise InvalidInput.at("--weather", f"expected one of {', '.join(known)}; got {unknown[0]!r}")
    with _progress() as progress:
        rows = measure_drivers(
            candidates=candidates, weathers=weathers, seed=seed, processes=processes, progress=progress
        )
    _conclude_rows(rows, as_json=as_json)


@bench.command()
def control(
    simulations: Annotated[int, typer.Option(min=100, help="Simulations per campaign.")] = 1300,
    seeds: Annotated[int, typer.Option(min=1, help="Number of campaigns of each algorithm.")] = 2,
    behaviour: Annotated[int, typer.Option(min=0, help="Seed of the fixed behaviour.")] = 3,
    processes: Processes = 2,
    as_json: AsJson = False,
) -> None:
    """Calibrate the control on campaigns in which the behaviour has no effect.

    All candidates have the same behaviour, so the control should reach the same figures as the real verdicts.

    Example: brink bench control --seeds 2
    """
    from brink.bench.control import T_BS, calibrate

    with _progress() as progress:
        found = list(
            calibrate(
                progress, simulations=simulations, seeds=range(1, seeds + 1), behaviour=behaviour,
                processes=processes,
            )
        )  # fmt: skip
    table = _table(
        ("algorithm", "seed", "unsafe", "evaluations per scenario", "DBS of", *(f"t_b {t:g}" for t in T_BS)),
        (
            (one.algorithm, one.seed, f"{one.unsafe_share:.0%}", f"{one.repeats:.1f}", name,
             *(f"{dbs:.4g}" for dbs in values))
            for one in found
            for name, values in (("real verdicts", one.real), ("control", one.control))
        ),
    )  # fmt: skip
    _conclude([{**fields(one), "t_b": T_BS} for one in found], table, as_json=as_json)


@bench.command()
def search(as_json: AsJson = False) -> None:
    """Measure one generation step: the time to add 60 new solutions to archives of growing size.

    Example: brink bench search
    """
    from brink.bench.search import measure_steps

    columns = {
        "archived": "{0.solutions:,}", "new": "{0.new}", "min ms": "{0.min_ms:.2f}", "median ms": "{0.median_ms:.2f}",
    }  # fmt: skip
    _conclude_times(measure_steps(), columns, as_json=as_json)


@bench.command()
def monitor(as_json: AsJson = False) -> None:
    """Measure the time of a query to safety monitors fitted to archives of growing size.

    Example: brink bench monitor
    """
    from brink.bench.search import measure_monitor

    columns = {
        "learned from": "{0.solutions:,}", "min ms": "{0.min_ms:.3f}", "median ms": "{0.median_ms:.3f}",
    }  # fmt: skip
    names = ("solutions", "min_ms", "median_ms", "target_ms")
    _conclude_times(measure_monitor(), columns, *names, as_json=as_json)


@bench.command(name="monitor-accuracy")
def monitor_accuracy(
    drives: Annotated[
        int, typer.Option(min=100, help="Random drives that each monitor is fitted to.")
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

    Example: brink bench monitor-accuracy --seeds 4
    """
    from brink.bench.monitor_accuracy import MonitorAccuracy, mean_rows

    check_picture(picture)

    out.mkdir(parents=True, exist_ok=True)
    with _progress() as progress:
        found, evaluation = MonitorAccuracy(
            out, drives=drives, fresh=fresh, seeds=range(1, seeds + 1), processes=processes, progress=progress
        ).measure()  # fmt: skip
    if picture is not None:
        from brink.plots.evidence import figure_monitor

        picture.parent.mkdir(parents=True, exist_ok=True)
        figure_monitor(evaluation).savefig(picture)
    rows = mean_rows(found)
    each = _table(
        ("model", "seed", "AUROC", "Brier", "calibration error", "bins within",
         *(f"{answer} (were)" for answer in Answer), "unlike", "agreement", "fit s", "query ms"),
        (
            (one.model, one.seed, f"{one.metrics.auroc:.3f}", f"{one.metrics.brier:.3f}",
             f"{one.metrics.calibration_error:.3f}", sum(bin_.within for bin_ in one.metrics.bins),
             *(f"{count:,}" + (f" ({unsafe / count:.1%})" if count else "")
               for count, unsafe in one.answers.values()),
             one.unlike, "" if one.agreement is None else f"{one.agreement:.0%}",
             f"{one.fit_s:.1f}", f"{one.query_ms:.2f}")
            for one in found
        ),
    )  # fmt: skip
    means = _table(
        ("what", "value", "target", "", "of"),
        ((row.what, f"{row.value:.3f}", row.target, _met(row.met), row.note) for row in rows),
    )
    _conclude(
        {"each": [asdict(one) for one in found], "means": [fields(row) for row in rows]}, each, means,
        as_json=as_json, missed=any(row.met is False for row in rows),
    )  # fmt: skip


@bench.command()
def guard(
    drives: Annotated[int, typer.Option(min=100, help="Fresh random drives.")] = 2000,
    training: Annotated[int, typer.Option(min=100, help="Drives that each guard is fitted to.")] = 1300,
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

    Example: brink bench guard --drives 2000 --picture guard.png
    """
    from brink.bench.guard import SETS, GuardBench, baseline_rows

    check_picture(picture)
    chosen = tuple(sets or SETS)
    for one in chosen:
        if one not in SETS:
            raise InvalidInput.at("--set", f"expected some of {', '.join(SETS)}, got {one!r}")
    with _progress() as progress:
        measured = GuardBench(
            out, training=training, fresh=drives, seed=seed, requirement=requirement, sets=chosen,
            processes=processes, progress=progress,
        ).measure()  # fmt: skip
    if picture is not None:
        from brink.plots.guard import figure_guard

        picture.parent.mkdir(parents=True, exist_ok=True)
        figure_guard(measured.judged[0].evaluation).savefig(picture)
    rows = list(measured.rows())
    figures = _table(
        ("what", "value", "target", "", "of"),
        ((row.what, f"{row.value:.3f}", row.target, _met(row.met), row.note) for row in rows),
    )
    each = _table(_GUARD_COLUMNS, map(_guard_row, measured.judged))
    unseen = _table(_GUARD_COLUMNS, map(_guard_row, measured.unseen))
    baselines = _table(("baseline", "warned", "false alarms"), baseline_rows(measured.judged[-1].evaluation))
    _conclude(
        measured.to_json(), figures, each, baselines, unseen, as_json=as_json,
        missed=any(row.met is False for row in rows),
    )  # fmt: skip


_GUARD_COLUMNS = (
    "fitted to", "sensor", "judged on", "drives", "violations", "warned", "interval", "own: warned", "recent",
    "false alarms", "an hour", "lead s", "AUROC", "Brier", "fit s",
)  # fmt: skip


def _guard_row(one: "Judged") -> tuple[object, ...]:
    evaluation = one.evaluation
    compared, own, last = evaluation.guard.compared, evaluation.own, evaluation.horizons[-1]
    low, high = evaluation.guard.interval
    lead = "" if own.median_lead_s is None else f"{own.median_lead_s:.1f}"
    return (
        one.trained_on, one.sensor, one.judged_on, f"{evaluation.drives:,}", f"{evaluation.violations:,}",
        f"{compared.recall:.2f}", f"{low:.2f} to {high:.2f}", f"{own.point.recall:.2f}", f"{own.recent:.2f}",
        f"{own.point.false_alarms:.1%}", f"{own.false_per_hour:.1f}", lead, f"{last.auroc:.3f}",
        f"{last.brier:.4f}", f"{one.fit_s:.0f}",
    )  # fmt: skip


@bench.command()
def sim(
    campaign: Annotated[
        Path | None,
        typer.Option(
            help="Campaign file: measure only the service, with the file's problem and random search."
        ),
    ] = None,
    episodes: Annotated[int, typer.Option(min=20, help="Episodes per run.")] = 240,
    repeats: Annotated[
        int, typer.Option(min=1, help="Number of runs of the service, and of the bare loop.")
    ] = 3,
    as_json: AsJson = False,
) -> None:
    """Measure the CPU time of an episode, and the throughput of the whole service with 1 and 2 workers.

    Example: brink bench sim --campaign examples/sumo.yaml
    """
    from brink.bench.service import TARGET_SHARE, URBAN, measure_service
    from brink.bench.urban import measure_costs

    problem = URBAN if campaign is None else read_campaign_file(campaign).problem
    rates = []
    with Steps(
        console(stderr=True), "measuring CPU time and memory of episodes; takes some minutes"
    ) as steps:
        kinds = list(measure_costs()) if campaign is None else []
        for algorithm in ("random@1", "mlcshe@1") if campaign is None else ("random@1",):
            for workers in (1, 2):
                steps.show(f"{algorithm} with {workers} workers against a bare loop")
                rates.append(
                    measure_service(workers, algorithm, problem=problem, episodes=episodes, repeats=repeats)
                )
    costs = _table(
        ("what", "value", "", "target", ""),
        ((kind.what, f"{kind.value:.1f}", kind.unit, _bound(kind.most), _met(kind.met)) for kind in kinds),
    )
    service = _table(
        ("algorithm", "workers", "service /s", "bare /s", "share", "target", "", "coordinator", "worker", "episode",
         "bare episode"),
        (
            (rate.algorithm, rate.workers, f"{rate.service_per_s:.1f}", f"{rate.bare_per_s:.1f}",
             f"{rate.share:.1%}", f"at least {TARGET_SHARE:.0%}", _met(rate.share >= TARGET_SHARE),
             f"{rate.coordinator_ms:.2f}", f"{rate.worker_ms:.2f}", f"{rate.episode_ms:.1f}", f"{rate.bare_ms:.1f}")
            for rate in rates
        ),
    )  # fmt: skip
    note = Text(
        "CPU time in ms per episode. The rest of the difference is waiting for the last episodes of a generation"
        " and for the next one. Random search proposes all episodes at once, MLCSHE proposes generations.",
        "dim",
    )
    document = {"episodes": [fields(kind) for kind in kinds], "service": [fields(rate) for rate in rates]}
    _conclude(document, *([costs] if kinds else []), service, note, as_json=as_json)


@bench.command()
def rendering(
    frames: Annotated[int, typer.Option(min=1, help="Number of frames; medians are shown.")] = 60,
    as_json: AsJson = False,
) -> None:
    """Measure the CPU time needed to render a frame and to compute its labels, for each size and lighting condition.

    Example: brink bench rendering --frames 60
    """
    from brink.bench.pictures import measure_rendering

    columns = {
        "size": "{0.width_px} x {0.height_px}", "light": "{0.light}", "frame ms": "{0.frame_ms:.2f}",
        "labels ms": "{0.labels_ms:.2f}",
    }  # fmt: skip
    _conclude_times(measure_rendering(frames), columns, as_json=as_json)


@bench.command()
def perturbations(
    heights: Annotated[
        list[int] | None, typer.Option("--height", min=36, help="Height of 16:9 frames, in px.")
    ] = None,
    repeats: Annotated[int, typer.Option(min=1, help="Number of calls at each level.")] = 40,
    as_json: AsJson = False,
) -> None:
    """Measure the CPU time of every perturbation at its lowest, middle and highest level.

    If albumentations is installed, its equivalents are measured at the highest level.

    Example: brink bench perturbations --height 720
    """
    from brink.bench.pictures import measure_perturbations

    rows = measure_perturbations(heights or (360, 720), repeats)
    table = _table(
        ("height px", "gene", "low ms", "middle ms", "top ms", "target ms", "", "albumentations ms", "ratio"),
        (
            (row.height_px, row.gene, f"{row.low_ms:.2f}", f"{row.middle_ms:.2f}", f"{row.top_ms:.2f}",
             _bound(row.target_ms), _met(row.met),
             *(("", "") if row.ratio is None else (f"{row.albumentations_ms:.2f}", f"{row.ratio:.1f}")))
            for row in rows
        ),
    )  # fmt: skip
    _conclude([fields(row) for row in rows], table, as_json=as_json)


@bench.command()
def paper(
    workers: Annotated[int, typer.Option(min=1, help="Number of worker processes.")] = 2,
    database: Annotated[str, typer.Option(help="Database URL.")] = "sqlite:///brink-paper.db",
    files: Annotated[list[Path] | None, typer.Argument(help="Campaign files.")] = None,
    control: Annotated[
        bool, typer.Option(help="Add controls: verdicts redrawn independently of behaviour.")
    ] = True,
    as_json: AsJson = False,
) -> None:
    """Run the paper's three campaigns and print their DBS tables, each campaign with its control.

    Example: brink bench paper --workers 2
    """
    from brink.bench.service import embedded_service

    bodies = [read_campaign_file(path) for path in files or PAPER_FILES]
    with embedded_service(database, RESULTS / "worker.log", workers) as (url, _):
        times, rows = asyncio.run(_paper(url, bodies, control=control, quiet=as_json))
    target = f"under {PAPER_TARGET_S:.0f}"
    table = _table(
        ("campaign", "seconds", "target", ""),
        ((name, f"{seconds:.0f}", target, _met(seconds < PAPER_TARGET_S)) for name, seconds in times.items()),
    )
    _conclude({"seconds": times, "rows": rows_json(rows)}, table, "", as_json=as_json)
    if not as_json:
        print_rows(console(), rows)


async def _paper(
    url: str, bodies: list[CampaignBody], *, control: bool, quiet: bool
) -> tuple[dict[str, float], list[ComparisonRow]]:
    """Run campaigns one after another; return their durations in seconds and their comparison."""
    times: dict[str, float] = {}
    ids = []
    async with httpx.AsyncClient(base_url=url, timeout=TIMEOUT) as client:
        api = Api(client, url)
        for body in bodies:
            fresh = body.model_copy(update={"execution": body.execution.model_copy(update={"cache": False})})
            campaign = (await api.send(CampaignView, "/campaigns", fresh.model_dump(mode="json"))).id
            ids.append(campaign)
            await follow(api, campaign, as_json=False, quiet=quiet)
            times[body.name] = (await api.read(CampaignProgress, f"/campaigns/{campaign}/progress")).elapsed_s
        return times, await compared(api, ids, control=control)


@bench.command()
def heredity(
    file: Annotated[
        Path, typer.Argument(metavar="[FILE]", help="Experiment file of the study.")
    ] = HEREDITY_FILE,
    seeds: Annotated[
        int | None, typer.Option(min=1, max=100, help="Number of seeds (default: those of the file, 10).")
    ] = None,
    simulations: Annotated[
        int | None, typer.Option(min=100, help="Simulations a campaign (default: those of the file, 1,300).")
    ] = None,
    workers: Workers = 2,
    database: Database = None,
    resume: Resume = False,
    new: New = False,
    out: Annotated[Path, typer.Option(help="Folder for the experiment file, report and figures.")] = RESULTS,
    as_json: AsJson = False,
) -> None:
    """Measure what selection contributes to MLCSHE at several mutation rates: DBS at t_b .05, .10 and .15.

    Every search of the file runs with and without selection, and each has its behaviour-blind control. Ctrl-C stops
    cleanly; the same command with --resume continues.

    Example: brink bench heredity

    Example: brink bench heredity --seeds 2 --simulations 200
    """
    from brink.bench.heredity import heredity_of, sized, twins_of
    from brink.cli.experiment_run import repeats_of, run_experiment

    with about_file(file):
        body = sized(read_experiment_file(file), seeds=seeds, simulations=simulations)
        twins = twins_of(body)
    out.mkdir(parents=True, exist_ok=True)
    copy = out / f"{file_name(body.name)}.yaml"  # of the chosen size: what --resume looks for
    copy.write_text(yaml.safe_dump(body.document(), sort_keys=False), encoding="utf-8")
    options = RunOptions(
        file=copy, workers=workers, out=out, resume=resume, new=new, json=as_json, database=database
    )
    if (
        run_experiment(
            body,
            options,
            show=lambda results, files: _show_heredity(
                heredity_of(repeats_of(results), twins), results.name, files[0].parent, as_json=as_json
            ),
        )
        is None
    ):
        raise typer.Exit(1)


def _show_heredity(study: "Heredity", name: str, folder: Path, *, as_json: bool) -> None:
    """Print the study of heredity, and write it and its figures to the folder of the report."""
    from brink.bench.heredity import NAMES, T_BS, figure_heredity
    from brink.plots.style import DPI

    columns = [f"t_b {t_b:g}" for t_b in T_BS]
    shown: list[RenderableType] = []
    write_json(folder / "heredity.json", study.document())
    for measure, words in NAMES.items():
        picture = figure_heredity(study, measure, f"{name}: what selection contributes")
        picture.savefig(folder / f"heredity-{measure}.png", dpi=DPI, metadata={"Software": None})
        shown += [
            _table((words, *columns), study.rows(measure)),
            _table((f"{words}: A12, corrected p", *columns), study.effect_rows(measure)), "",
        ]  # fmt: skip
    _conclude(
        study.document(), *shown, *study.conclusions(), f"report and figures: {folder}", as_json=as_json
    )


@bench.command()
def queue(
    jobs: Annotated[int, typer.Option(min=500, help="Jobs per measurement.")] = 4_000,
    rounds: Annotated[
        int, typer.Option(min=1, help="Repetitions of the whole measurement; medians are shown.")
    ] = 3,
    quick: Annotated[bool, typer.Option("--quick", help="Only 4 workers, batches of 8.")] = False,
    as_json: AsJson = False,
) -> None:
    """Measure queue throughput and pick-up times, compared with Celery on Redis and procrastinate on Postgres.

    All queues run durably: acknowledged jobs survive a power cut. The other queues need the extra
    `bench` and an installed redis-server; Postgres is started in a temporary folder. Use --quick for a short
    measurement.

    Example: brink bench queue
    """
    from brink.bench.queue import TARGET_PICKUP_MS, TARGET_RATIO, compare_queues

    with _progress() as progress:
        found = compare_queues(progress, jobs=jobs, rounds=rounds, quick=quick)
    ratios = found.ratios()
    # Only the time since a job was stored has a target.
    pickups = [
        (one, one.p99_ms < TARGET_PICKUP_MS if one.since == "stored" else None) for one in found.pickups
    ]
    document = {
        "throughput": [{**fields(one), "per_s": one.per_s} for one in found.throughput],
        "ratios": [
            {"system": ours.system, "workers": ours.workers, "beside": best.system, "ratio": ratio}
            for ours, best, ratio in ratios
        ],
        "pickups": [fields(one, "system", "since", "p50_ms", "p99_ms") for one in found.pickups],
        "settings": found.settings,
        "left_out": found.left_out,
    }
    throughput_table = _table(
        ("queue", "workers", "batch", "jobs /s", "lease p50 ms", "p99 ms"),
        (
            (one.system, one.workers, one.batch, f"{one.per_s:,.0f}",
             *("" if ms is None else f"{ms:.1f}" for ms in (one.lease_p50_ms, one.lease_p99_ms)))
            for one in found.throughput
        ),
    )  # fmt: skip
    ratio_table = _table(
        ("queue", "workers", "times as fast", "of", "target", ""),
        (
            (ours.system, ours.workers, f"{ratio:.1f}", best.system, f"at least {TARGET_RATIO:g}",
             _met(ratio >= TARGET_RATIO))
            for ours, best, ratio in ratios
        ),
    )  # fmt: skip
    pickup_table = _table(
        ("an idle worker starts a job", "since it was", "p50 ms", "p99 ms", "target", ""),
        (
            (one.system, one.since, f"{one.p50_ms:.1f}", f"{one.p99_ms:.1f}",
             "" if met is None else f"p99 under {TARGET_PICKUP_MS:g}", _met(met))
            for one, met in pickups
        ),
    )  # fmt: skip
    notes: list[RenderableType] = [
        Text(f"{system}: {setting}", "dim") for system, setting in found.settings.items()
    ]
    notes += [Text(f"{name} was not measured: {reason}", "yellow") for name, reason in found.left_out.items()]
    missed = any(ratio < TARGET_RATIO for *_, ratio in ratios) or any(met is False for _, met in pickups)
    shown = (throughput_table, "", ratio_table, "", pickup_table, "", *notes)
    _conclude(document, *shown, as_json=as_json, missed=missed)


@bench.command()
def chaos(
    minutes: Annotated[float, typer.Option(min=0.1, max=600, help="Minimum duration in minutes.")] = 10.0,
    faults: Annotated[int, typer.Option(min=1, help="Minimum number of faults.")] = 200,
    simulations: Annotated[int, typer.Option(min=100, help="Simulations per campaign.")] = 400,
    idle: Annotated[
        bool, typer.Option("--idle", help="Use episodes that only wait briefly instead of simulated drives.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of campaigns and faults.")] = 1,
    as_json: AsJson = False,
) -> None:
    """Inject faults into campaigns on Postgres, and compare the archives with those of undisturbed campaigns.

    Two coordinators and four workers run. Processes, episodes, the database and its connections are killed or
    suspended; messages are lost, truncated, delayed and repeated; the clocks of two workers are wrong. No verdict may
    be lost or counted twice, no job may get stuck or be charged for an outage, no request may meet an internal error,
    and every archive must match that of the undisturbed campaign.

    Example: brink bench chaos --minutes 10
    """
    from brink.bench.chaos import ChaosPlan, run_trial

    plan = ChaosPlan(minutes=minutes, faults=faults, simulations=simulations, drives=not idle, seed=seed)
    with _progress() as progress:
        outcome = run_trial(plan, progress)
    findings = outcome.findings
    wrong = {
        "verdicts or jobs lost": findings.lost,
        "verdicts or jobs counted twice": findings.doubled,
        "verdicts or jobs stuck": findings.stuck,
        "jobs charged for what is nobody's fault": findings.charged,
        "internal errors": findings.errors,
    }
    undisturbed = outcome.same == len(outcome.digests)
    document = {
        "minutes": outcome.minutes,
        "broken": outcome.broken,
        "messages": outcome.requests,
        "messages_broken": outcome.messages,
        "results": outcome.statuses,
        "campaigns": outcome.campaigns,
        "digests": outcome.digests,
        "ended_by_themselves": outcome.unexpected_exits,
        "lost": findings.lost,
        "counted_twice": findings.doubled,
        "stuck": findings.stuck,
        "charged": findings.charged,
        "internal_errors": findings.errors,
    }
    injected = _table(("fault", "times"), (outcome.broken + outcome.messages).most_common())
    injected.add_row("processes, connections, databases", str(outcome.broken.total()))
    injected.add_row(f"messages, of {outcome.requests:,}", str(outcome.messages.total()))
    answers = ", ".join(f"{count:,} {name}" for name, count in outcome.statuses.most_common())
    verdicts = _table(
        ("in the end", "value", "target", ""),
        ((name, len(found), "0", _met(not found)) for name, found in wrong.items()),
    )
    same = f"{outcome.same} of {len(outcome.digests)}"
    verdicts.add_row("archives identical to the undisturbed ones", same, "all", _met(undisturbed))
    _conclude(
        document, injected, "", f"responses to reported results: {answers}",
        *(Text(f"exited by itself and was restarted: {end}") for end in outcome.unexpected_exits), "", verdicts,
        *(Text(f"{name}: {one}", "red") for name, found in wrong.items() for one in found[:10]),
        as_json=as_json, missed=any(wrong.values()) or not undisturbed,
    )  # fmt: skip


@bench.command()
def scale(
    workers: Annotated[
        int | None,
        typer.Option(
            min=2,
            max=5000,
            help="Measure only with this many workers, with four jobs per worker in each generation.",
        ),
    ] = None,
    seconds: Annotated[float, typer.Option(min=5, help="Approximate duration of each measurement.")] = 30.0,
    shrunk: Annotated[
        float,
        typer.Option(
            "--scale", min=0.01, max=1, help="Mean duration of an episode as a fraction of the full 5 s."
        ),
    ] = 0.2,
    postgres: Annotated[bool, typer.Option(help="Use Postgres instead of SQLite.")] = False,
    coordinators: Annotated[
        int,
        typer.Option(
            min=1, max=8, help="Compare up to this many coordinators on Postgres, with one campaign."
        ),
    ] = 1,
    as_json: AsJson = False,
) -> None:
    """Measure the utilisation of 1 to 64 simulated workers, by one campaign and by two at once.

    With one generation in flight, workers wait for its longest episodes, unless another campaign fills the gap. The
    target for a thousand workers includes the coordinator's CPU time: at most 2.5 ms a job, which is half a core at
    200 jobs a second.

    Example: brink bench scale --workers 1000 --scale 1
    """
    from brink.bench.scale import measure_utilisation

    with _progress() as progress:
        found = measure_utilisation(
            progress,
            workers=workers,
            seconds=seconds,
            scale=shrunk,
            postgres=postgres,
            coordinators=coordinators,
        )
    table = _table(
        ("workers", "coordinators", "campaigns", "algorithm", "generation", "in flight", "jobs", "a second", "used",
         "target", "", "coordinator CPU", "ms a job", "its writer", "step s"),
        (
            (one.setup.workers, one.setup.coordinators, one.setup.campaigns, one.setup.algorithm,
             one.setup.generation, one.setup.in_flight,
             f"{one.jobs:,}", f"{one.jobs / one.seconds:.0f}", f"{one.share:.1%}",
             "" if one.setup.target_share is None else f"at least {one.setup.target_share:.0%}", _met(one.met),
             f"{one.coordinator_s / one.seconds:.0%}", f"{one.cpu_ms:.2f}", f"{one.writing_s / one.seconds:.0%}",
             f"{one.step_s:.3f}")
            for one in found
        ),
    )  # fmt: skip
    names = ("jobs", "seconds", "busy_s", "coordinator_s", "writing_s", "step_s", "share", "cpu_ms", "met")
    document = [{**fields(one, *names), **fields(one.setup)} for one in found]
    _conclude(document, table, as_json=as_json, missed=any(one.met is False for one in found))


@bench.command()
def turns(
    seeds: Annotated[int, typer.Option(min=1, help="Number of runs; means are shown.")] = 20,
    as_json: AsJson = False,
) -> None:
    """Model how the utilisation of workers depends on turns and on candidates in flight, without a coordinator.

    The first table has 64 workers and campaigns with one generation in flight, which take turns; the second has one
    campaign, with candidates in flight that make up one or several generations.

    Example: brink bench turns
    """
    from brink.bench.scale import model_in_flight, model_turns

    found = model_turns(seeds)
    in_flight = model_in_flight(max(1, seeds // 4))
    table = _table(
        ("generation", "campaigns", "generations", "job by job", "four jobs per worker"),
        (
            (one.generation, one.campaigns, one.generations, f"{one.single:.1%}", f"{one.four_per_worker:.1%}")
            for one in found
        ),
    )  # fmt: skip
    flights = _table(
        ("workers", "candidates in flight", "in generations", "used"),
        ((one.workers, one.a_worker * one.workers, one.generations, f"{one.share:.1%}") for one in in_flight),
    )
    document = {
        "turns": [fields(one) for one in found], "in_flight": [fields(one) for one in in_flight],
    }  # fmt: skip
    _conclude(document, table, "", flights, as_json=as_json)


@bench.command()
def archive(
    solutions: Annotated[int, typer.Option(min=2000, help="Number of solutions in the archive.")] = 100_000,
    samples: Annotated[int, typer.Option(min=20, help="Number of requests of each kind.")] = 100,
    as_json: AsJson = False,
) -> None:
    """Measure the response times of a coordinator with a large archive while a campaign runs.

    Filling the archive is slow: every solution passes through the queue and into the distance matrix.

    Example: brink bench archive --solutions 20000
    """
    from brink.bench.endurance import GENERATION, TARGET_MS, measure_archive

    with _progress() as progress:
        found = measure_archive(progress, solutions=solutions, samples=samples)
    document = {
        "answers": [fields(one, "request", "first_ms", "p50_ms", "p95_ms") for one in found.answers],
        "bytes_a_solution": found.bytes_a_solution,
        "last_step_s": found.last_step_s,
    }
    target = f"p95 under {TARGET_MS:g}"
    table = _table(
        ("request", "first ms", "p50 ms", "p95 ms", "target", ""),
        (
            (one.request, f"{one.first_ms:.0f}", f"{one.p50_ms:.0f}", f"{one.p95_ms:.0f}",
             target, _met(one.p95_ms < TARGET_MS))
            for one in found.answers
        ),
    )  # fmt: skip
    size = f"database: {found.bytes_a_solution / 1000:.1f} kB per solution, with its job and result"
    step = f"last generation step, {GENERATION} new solutions: {found.last_step_s:.2f} s"
    missed = any(one.p95_ms >= TARGET_MS for one in found.answers)
    _conclude(document, table, size, step, as_json=as_json, missed=missed)


@bench.command()
def soak(
    minutes: Annotated[float, typer.Option(min=1, help="Duration in minutes.")] = 60.0,
    as_json: AsJson = False,
) -> None:
    """Run one campaign after another and measure how the memory of coordinator and workers grows.

    Example: brink bench soak --minutes 60
    """
    from brink.bench.endurance import TARGET_MIB_PER_HOUR, measure_growth

    with _progress() as progress:
        found = measure_growth(progress, minutes=minutes)
    target = f"under {TARGET_MIB_PER_HOUR:g}"
    table = _table(
        ("process", "MiB first", "last", "most", "MiB per hour", "target", ""),
        (
            (one.process, f"{one.mib[0]:.1f}", f"{one.mib[-1]:.1f}", f"{max(one.mib):.1f}",
             f"{one.slope:+.2f}", target, _met(one.slope < TARGET_MIB_PER_HOUR))
            for one in found
        ),
    )  # fmt: skip
    finished = f"{found[0].campaigns} campaigns finished, with {found[0].simulations:,} simulations in all"
    columns = ("process", "campaigns", "simulations", "slope", "hours", "mib")
    missed = any(one.slope >= TARGET_MIB_PER_HOUR for one in found)
    _conclude([fields(one, *columns) for one in found], table, finished, as_json=as_json, missed=missed)


@bench.command()
def dashboard(
    solutions: Annotated[
        int, typer.Option(min=2000, help="Number of solutions in the displayed campaign.")
    ] = 20_000,
    polls: Annotated[
        int,
        typer.Option(
            min=100, help="Number of polls by a page that stays open; the default corresponds to one day."
        ),
    ] = 8_640,
    as_json: AsJson = False,
) -> None:
    """Measure the dashboard in headless Chromium: first view, polling, dragging the map, memory over a simulated day.

    Needs the extra `dev` and Chromium, for example from apt-get install chromium.

    Example: brink bench dashboard --polls 500
    """
    from brink.bench.dashboard import measure_dashboard

    with _progress() as progress:
        rows = measure_dashboard(progress, solutions=solutions, polls=polls)
    _conclude_rows(rows, as_json=as_json)
