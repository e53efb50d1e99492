"""`python -m benchmarks search | paper | heredity | mumoea`: the cost of a search, and what its methods find."""

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import httpx
import typer
import yaml
from rich.console import RenderableType

from benchmarks.cli.output import (
    Processes,
    conclude,
    conclude_rows,
    conclude_times,
    met_text,
    show_progress,
    value_table,
)
from brink.api.client import TIMEOUT, Api
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
    console,
    file_name,
    write_json,
)
from brink.search.analysis.comparison import Row as ComparisonRow
from brink.server.api.schemas import CampaignView
from brink.server.api.schemas import Progress as CampaignProgress
from brink.server.campaigns.body import CampaignBody, read_campaign_file
from brink.server.errors import InvalidInput
from brink.server.experiments.body import read_experiment_file

if TYPE_CHECKING:
    from benchmarks.heredity import Heredity

HEREDITY_FILE = Path("examples") / "heredity.yaml"
PAPER_FILES = tuple(Path("examples") / f"paper-{name}.yaml" for name in ("mlcshe", "ga", "random"))
PAPER_TARGET_S = 180.0


def search(as_json: AsJson = False) -> None:
    """Measure one generation step: the time to add 60 new solutions to archives of growing size.

    Example: python -m benchmarks search
    """
    from benchmarks.search import measure_steps

    columns = {
        "archived": "{0.solutions:,}",
        "new": "{0.new}",
        "min ms": "{0.min_ms:.2f}",
        "median ms": "{0.median_ms:.2f}",
    }
    conclude_times(measure_steps(), columns, as_json=as_json)


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

    Example: python -m benchmarks paper --workers 2
    """
    from benchmarks.service import embedded_service

    bodies = [read_campaign_file(path) for path in files or PAPER_FILES]
    with embedded_service(database, RESULTS / "worker.log", workers) as (url, _):
        times, rows = asyncio.run(_paper(url, bodies, control=control, quiet=as_json))
    target = f"under {PAPER_TARGET_S:.0f}"
    table = value_table(
        ("campaign", "seconds", "target", ""),
        (
            (name, f"{seconds:.0f}", target, met_text(seconds < PAPER_TARGET_S))
            for name, seconds in times.items()
        ),
    )
    conclude({"seconds": times, "rows": rows_json(rows)}, table, "", as_json=as_json)
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

    Example: python -m benchmarks heredity

    Example: python -m benchmarks heredity --seeds 2 --simulations 200
    """
    from benchmarks.heredity import heredity_of, sized, twins_of
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
    from benchmarks.heredity import T_BS, figure_heredity
    from brink.plots.style import DPI
    from brink.report.experiment import NAMES

    columns = [f"t_b {t_b:g}" for t_b in T_BS]
    shown: list[RenderableType] = []
    write_json(folder / "heredity.json", study.document())
    for measure, words in NAMES.items():
        picture = figure_heredity(study, measure, f"{name}: what selection contributes")
        picture.savefig(folder / f"heredity-{measure}.png", dpi=DPI, metadata={"Software": None})
        shown += [
            value_table((words, *columns), study.rows(measure)),
            value_table((f"{words}: A12, corrected p", *columns), study.effect_rows(measure)),
            value_table((f"{words}, controls: A12, corrected p", *columns), study.control_rows(measure)),
            "",
        ]
    conclude(study.document(), *shown, *study.conclusions(), f"report and figures: {folder}", as_json=as_json)


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

    Example: python -m benchmarks mumoea --simulations 600 --method MAP-Elites --method "random search"
    """
    from benchmarks.mumoea import METHODS, Comparison
    from brink.server.problems.catalogue import make_params
    from brink.server.problems.npc_actions import NpcActionsParams

    methods = method or list(METHODS)
    if unknown := [name for name in methods if name not in METHODS]:
        raise InvalidInput.at("--method", f"expected one of {', '.join(METHODS)}; got {unknown[0]!r}")
    params = make_params(NpcActionsParams, {"road_curve": road}, "/problem/params")
    out.mkdir(parents=True, exist_ok=True)
    with show_progress() as progress:
        rows = Comparison(
            out,
            params,
            seeds=seeds,
            simulations=simulations,
            processes=processes,
            progress=progress,
            methods=methods,
        ).rows()
    conclude_rows(rows, as_json=as_json)
