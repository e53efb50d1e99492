"""`brink monitor fit | score | judge`: a campaign as a safety monitor."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from brink import __version__
from brink.api.client import Api
from brink.cli.draw import FetchedArchive, fetch_archive
from brink.cli.options import AsJson, Database, Server, check_picture, console, print_json, with_api
from brink.search.analysis.monitor import Answer, Monitor
from brink.search.analysis.monitor_evaluation import MonitorEvaluation, evaluate_monitor, fewest_false_alarms
from brink.search.archive import Archive
from brink.search.errors import DocumentError, SpaceError
from brink.server.documents import read_yaml
from brink.server.errors import Conflict, FieldError, InvalidInput

MISSED = (0.01, 0.05, 0.1)
"""Shares of missed hazards at which false alarms are shown."""

monitor = typer.Typer(
    name="monitor",
    help="Use what was simulated as a safety monitor: how likely is a solution unsafe?",
    no_args_is_help=True,
    rich_markup_mode=None,
)
MonitorFile = Annotated[
    Path, typer.Argument(metavar="MONITOR", help="File that `brink monitor fit` wrote.", show_default=False)
]
Campaigns = Annotated[list[str], typer.Argument(metavar="ID...", help="Campaigns.", show_default=False)]


def fit(
    campaigns: Campaigns,
    out: Annotated[Path, typer.Option(help="File to write.")] = Path("monitor.json"),
    threshold: Annotated[
        float | None,
        typer.Option(
            min=0.001, max=0.999, help="Probability above which unsafe is the answer (default: p_th)."
        ),
    ] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Make a safety monitor of campaigns on the same problem.

    Example: brink monitor fit 3f2a --out monitor.json
    """
    fetched = with_api(server, database, lambda api: _fetched(api, campaigns))
    vectors, unsafe = _together(fetched)
    if len(vectors) < 2:
        raise Conflict(f"a monitor needs two evaluated solutions, there are {len(vectors)}")
    plan = fetched[0].plan
    level = threshold if threshold is not None else plan.neighbourhood.p_th
    made = Monitor.fitted(
        plan.problem.space,
        vectors,
        unsafe,
        threshold=level,
        z=plan.neighbourhood.z,
        seed=fetched[0].body.seed,
    )
    about = {
        "campaigns": [one.id for one in fetched],
        "problem": fetched[0].body.problem.model_dump(mode="json"),
        "brink": __version__,
    }
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(made.to_json(about) + "\n", encoding="utf-8")
    if as_json:
        print_json(
            {
                "file": str(out),
                "solutions": len(made),
                "threshold": level,
                "weights": made.informative_weights,
            }
        )
        return
    tell = ", ".join(f"{name} {weight:g}" for name, weight in made.informative_weights.items()) or "nothing"
    console().print(
        f"{out}: {len(made):,} solutions, {made.unsafe_share:.0%} unsafe; unsafe above {level:g}\n"
        f"what tells, by weight: {tell}",
        soft_wrap=True, markup=False,
    )  # fmt: skip


def score(
    file: MonitorFile,
    solutions: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            show_default=False,
            help="A solution, or a list of them (JSON or YAML): {component: {parameter: value}}.",
        ),
    ],
    as_json: AsJson = False,
) -> None:
    """Say how likely solutions are unsafe, without any server.

    Example: brink monitor score monitor.json solutions.json
    """  # fmt: skip
    known = _read(file)
    document = read_yaml(solutions)
    asked = document if isinstance(document, list) else [document]
    risks = []
    for place, values in enumerate(asked):
        if not isinstance(values, dict):
            raise _wrong(place, f"expected parameters by component, got {values!r}"[:200])
        try:
            risks.append(known.ask(values.get("parameters", values)))
        except (SpaceError, AttributeError) as error:
            raise _wrong(place, str(error)) from None
    if as_json:
        print_json([asdict(risk) for risk in risks])
        return
    table = Table(box=None, pad_edge=False)
    for name in ("", "unsafe", "interval", "neighbours", "answer"):
        table.add_column(name, justify="left" if name == "answer" else "right", header_style="dim")
    for place, risk in enumerate(risks):
        table.add_row(
            str(place), f"{risk.probability:.2f}", f"{risk.low:.2f} to {risk.high:.2f}",
            f"{risk.neighbours:.1f}", str(risk.answer),
        )  # fmt: skip
    console().print(table)


def judge(
    file: MonitorFile,
    campaigns: Campaigns,
    picture: Annotated[
        Path | None, typer.Option("--picture", help="PNG or SVG to draw calibration and alarms into.")
    ] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Judge a monitor by campaigns that it has not seen, best a random search with a seed of its own.

    Example: brink monitor judge monitor.json 91bc --picture monitor.png
    """
    check_picture(picture)
    known = _read(file)
    fetched = with_api(server, database, lambda api: _fetched(api, campaigns))
    vectors, unsafe = _together(fetched)
    if fetched[0].plan.problem.space.column_names() != known.space.column_names():
        raise Conflict(f"{file} knows another search space than campaign {fetched[0].id}")
    try:
        trial = evaluate_monitor(known, vectors, unsafe)
    except ValueError as error:
        raise Conflict(str(error)) from None
    if picture is not None:
        # matplotlib takes half a second to load: only those who draw wait for it.
        from brink.plots.monitor import figure_monitor

        picture.parent.mkdir(parents=True, exist_ok=True)
        figure_monitor(trial, f"Monitor of {trial.learned:,} simulations").savefig(picture)
    if as_json:
        print_json(trial.to_json())
        return
    _print(trial)
    if picture is not None:
        console().print(f"picture: {picture}", soft_wrap=True)


def _read(file: Path) -> Monitor:
    try:
        return Monitor.load(file)
    except DocumentError as error:
        raise InvalidInput([FieldError(pointer="", message=f"{file}: {error}")]) from None


def _wrong(place: int, message: str) -> InvalidInput:
    return InvalidInput([FieldError(pointer=f"/{place}", message=message)])


async def _fetched(api: Api, campaigns: Sequence[str]) -> list[FetchedArchive]:
    found = [await fetch_archive(api, campaign) for campaign in campaigns]
    first = found[0]
    for other in found[1:]:
        if other.body.problem != first.body.problem:
            raise Conflict(
                f"campaigns {first.id} and {other.id} have different problems; a monitor is of one"
            )
    return list({one.id: one for one in found}.values())


def _together(fetched: Sequence[FetchedArchive]) -> tuple[Any, Any]:
    archives: list[Archive] = [one.archive for one in fetched]
    return (
        np.concatenate([archive.vectors for archive in archives]),
        np.concatenate([archive.unsafe for archive in archives]),
    )


def _print(trial: MonitorEvaluation) -> None:
    screen = console()
    screen.print(f"learned from {trial.learned:,} simulations, judged by {trial.fresh:,} others")
    table = Table(box=None, pad_edge=False)
    for name in ("", "AUROC", "Brier", *(f"false alarms at {missed:.0%} missed" for missed in MISSED)):
        table.add_column(name, justify="right" if name else "left", header_style="dim")
    for witness in trial.predictors:
        costs = [f"{fewest_false_alarms(witness.operating_points, missed).false:.0%}" for missed in MISSED]
        table.add_row(witness.name, f"{witness.metrics.auroc:.3f}", f"{witness.metrics.brier:.3f}", *costs)
    screen.print(table, "")
    bins = trial.predictors[0].metrics.bins
    table = Table(title="the monitor's calibration", title_justify="left", box=None, pad_edge=False)
    for name in ("solutions", "foretold", "stated", "unsafe share", "within"):
        table.add_column(name, justify="right", header_style="dim")
    for one in bins:
        table.add_row(
            f"{one.solutions:,}", f"{one.predicted:.2f}", f"{one.low:.2f} to {one.high:.2f}", f"{one.observed:.2f}",
            "yes" if one.within else "no",
        )  # fmt: skip
    screen.print(table, "")
    for verdicts in trial.answers:
        share = f", {verdicts.unsafe / verdicts.solutions:.0%} of them unsafe" if verdicts.solutions else ""
        unknown = verdicts.answer is Answer.UNKNOWN
        reason = ": too little was simulated around them, or it is too mixed" if unknown else ""
        screen.print(f"  {verdicts.answer}: {verdicts.solutions:,}{share}{reason}")
    for name, reason in trial.left_out.items():
        screen.print(f"[yellow]{name} are left out: {reason}[/yellow]")


for command in (fit, score, judge):
    monitor.command()(command)
