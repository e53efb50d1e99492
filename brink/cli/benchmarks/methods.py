"""`brink bench difficulty | simood | mumoea | search | sim | paper`: problems, methods and episodes, measured."""

import asyncio
from pathlib import Path
from typing import Annotated, Any

import httpx
import typer
from rich.console import Console
from rich.table import Table

from brink.api.client import TIMEOUT, Api
from brink.bench.rate import TARGET_SHARE, ServiceRate, measure_service
from brink.cli.benchmarks.figures import bars, figure_table, print_figures, said, teller
from brink.cli.compare import compared, print_rows, rows_json
from brink.cli.options import AsJson, console, print_json
from brink.cli.submit import follow
from brink.server.campaigns.body import CampaignBody, read_campaign_file
from brink.server.errors import FieldError, InvalidInput
from brink.server.runtime.coordinator import EmbeddedCoordinator, WorkerProcesses
from brink.server.runtime.database import prepare_database
from brink.server.settings import Settings

PAPER_FILES = tuple(Path("examples") / f"paper-{name}.yaml" for name in ("mlcshe", "ga", "random"))
PAPER_TARGET_S = 180.0
MUMOEA_RESULTS = Path("brink-results") / "bench-mumoea"
SIMOOD_RESULTS = Path("brink-results") / "bench-simood"


def difficulty(
    candidates: Annotated[int, typer.Option(min=100, help="Random candidates.")] = 2000,
    share: Annotated[
        float, typer.Option(min=0.01, max=1.0, help="Share of the other samples to run, for a quick look.")
    ] = 1.0,
    processes: Annotated[int, typer.Option(min=1, help="Processes to run episodes in.")] = 2,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    as_json: AsJson = False,
) -> None:
    """Measure how hard the urban problem is, and what decides its verdicts.

    Example: brink bench difficulty --candidates 2000
    """
    # Imported here: measuring runs episodes, which a coordinator never does.
    from brink.sim.urban.difficulty import Sizes, measure

    full = Sizes()
    sizes = Sizes(
        candidates=candidates,
        **{
            name: max(20, round(share * getattr(full, name)))
            for name in ("scenarios", "reruns", "pairs", "redraws", "ends")
        },
    )
    with bars(Console(stderr=True)) as progress:
        rows = list(measure(sizes, seed=seed, processes=processes, progress=teller(progress)))
    print_figures(rows, as_json=as_json)


def simood(
    criteria: Annotated[
        list[str] | None, typer.Argument(metavar="[A0 … A8]", help="Criteria to measure; all without it.")
    ] = None,
    processes: Annotated[int, typer.Option(min=1, help="Processes to run episodes in.")] = 2,
    out: Annotated[Path, typer.Option(help="Folder for tables, figures and what was run.")] = SIMOOD_RESULTS,
    as_json: AsJson = False,
) -> None:
    """Measure what SiMOOD must show: a safe baseline, hazards of perturbations, the search, what it costs.

    All of it takes long. What was run is kept in the folder, so that the same command goes on after an
    interruption and criteria share episodes.

    Example: brink bench simood A0 A2 --processes 2
    """
    # Imported here: measuring runs episodes, which a coordinator never does.
    from brink.bench.simood.criteria import CRITERIA, measure_simood

    wanted = [name.upper() for name in criteria or CRITERIA]
    for name in wanted:
        if name not in CRITERIA:
            message = f"expected some of {', '.join(CRITERIA)}, got {name!r}"
            raise InvalidInput([FieldError(pointer="criteria", message=message)])
    out.mkdir(parents=True, exist_ok=True)
    with bars(Console(stderr=True)) as progress:
        rows = measure_simood(wanted, out, processes=processes, told=teller(progress))
    print_figures(rows, as_json=as_json)


def mumoea(
    seeds: Annotated[int, typer.Option(min=2, help="Searches of each method.")] = 5,
    simulations: Annotated[int, typer.Option(min=100, help="Simulations of each search.")] = 2000,
    road: Annotated[
        str, typer.Option(help="Shape of the road: crossroad, straight, right, left.")
    ] = "crossroad",
    processes: Annotated[int, typer.Option(min=1, help="Processes to run searches in.")] = 2,
    out: Annotated[Path, typer.Option(help="Folder for tables, figures and what was run.")] = MUMOEA_RESULTS,
    as_json: AsJson = False,
) -> None:
    """Compare muMOEA with its ablations, MOSAT, NSGA-II and random search, at equal simulations.

    It takes long. Searches that ended are kept in the folder, so that the same command goes on after an
    interruption.

    Example: brink bench mumoea --seeds 5 --simulations 2000
    """
    # Imported here: measuring runs episodes, which a coordinator never does.
    from brink.bench.mumoea.comparison import Comparison
    from brink.server.problems.catalogue import make_params
    from brink.server.problems.npc_actions import NpcActionsParams

    params = make_params(NpcActionsParams, {"road_curve": road}, "/problem/params")
    out.mkdir(parents=True, exist_ok=True)
    with bars(Console(stderr=True)) as progress:
        comparison = Comparison(
            out, params, seeds=seeds, simulations=simulations, processes=processes, told=teller(progress)
        )
        rows = comparison.rows()
    print_figures(rows, as_json=as_json)


def search(as_json: AsJson = False) -> None:
    """Measure one generation step: 60 new solutions at growing archive sizes.

    Example: brink bench search
    """
    from brink.search.benchmark import measure

    rows = measure()
    if as_json:
        print_json([{name: getattr(row, name) for name in row.__slots__} for row in rows])
        return
    table = figure_table("archived", "new", "min ms", "median ms", "target ms", "")
    for row in rows:
        target = "" if row.target_ms is None else f"at most {row.target_ms:g}"
        table.add_row(
            f"{row.solutions:,}",
            str(row.new),
            f"{row.min_ms:.2f}",
            f"{row.median_ms:.2f}",
            target,
            said(row.met),
        )
    console().print(table)


def sim(
    episodes: Annotated[int, typer.Option(min=20, help="Episodes a run.")] = 240,
    repeats: Annotated[int, typer.Option(min=1, help="Runs of each kind.")] = 3,
    as_json: AsJson = False,
) -> None:
    """Measure episodes: CPU time of one, and how many a second with 1 and 2 workers through the whole service.

    Example: brink bench sim
    """
    from brink.sim.urban.benchmark import measure_costs

    rates = []
    with Console(stderr=True).status("CPU time and memory of episodes; takes some minutes") as status:
        kinds = list(measure_costs())
        for algorithm in ("random@1", "mlcshe@1"):
            for workers in (1, 2):
                status.update(f"{algorithm} with {workers} workers against a bare loop")
                rates.append(measure_service(workers, algorithm, episodes=episodes, repeats=repeats))
    if as_json:
        print_json(
            {
                "episodes": [{name: getattr(kind, name) for name in kind.__slots__} for kind in kinds],
                "service": [{name: getattr(rate, name) for name in rate.__slots__} for rate in rates],
            }
        )
        return
    screen = console()
    table = figure_table("what", "value", "", "target", "")
    for kind in kinds:
        target = "" if kind.most is None else f"at most {kind.most:g}"
        table.add_row(kind.what, f"{kind.value:.1f}", kind.unit, target, said(kind.met))
    screen.print(table)
    screen.print(_rate_table(rates))
    screen.print(
        "[dim]CPU ms an episode. The rest of the difference is waiting: for the last episodes of a generation, and "
        "for the next one. Random search proposes all episodes at once, MLCSHE in generations.[/dim]"
    )


def _rate_table(rates: list[ServiceRate]) -> Table:
    table = figure_table(
        "algorithm", "workers", "service /s", "bare /s", "share", "target", "", "coordinator", "worker",
        "episode", "bare episode",
    )  # fmt: skip
    for rate in rates:
        table.add_row(
            rate.algorithm, str(rate.workers), f"{rate.service_per_s:.1f}", f"{rate.bare_per_s:.1f}",
            f"{rate.share:.1%}", f"at least {TARGET_SHARE:.0%}", said(rate.share >= TARGET_SHARE),
            f"{rate.coordinator_ms:.2f}", f"{rate.worker_ms:.2f}", f"{rate.episode_ms:.1f}",
            f"{rate.bare_ms:.1f}",
        )  # fmt: skip
    return table


def paper(
    workers: Annotated[int, typer.Option(min=1)] = 2,
    database: Annotated[str, typer.Option(help="Database URL.")] = "sqlite:///brink-paper.db",
    files: Annotated[list[Path] | None, typer.Argument(help="Campaign files.")] = None,
    control: Annotated[bool, typer.Option(help="Add controls: verdicts that ignore behaviour.")] = True,
    as_json: AsJson = False,
) -> None:
    """Run the paper's three campaigns and print their DBS tables, each beside its controls.

    Example: brink bench paper --workers 2
    """
    bodies = [read_campaign_file(path) for path in files or PAPER_FILES]
    settings = Settings(database=database, port=0)
    prepare_database(settings)
    coordinator = EmbeddedCoordinator(settings)
    coordinator.start()
    processes = WorkerProcesses(url=coordinator.url, log_file=Path("brink-results/worker.log"), token=None)
    try:
        processes.start(workers)
        times, rows = asyncio.run(_paper(coordinator.url, bodies, control=control, quiet=as_json))
    finally:
        processes.stop()
        coordinator.stop()
    if as_json:
        print_json({"seconds": times, "rows": rows_json(rows)})
        return
    screen = console()
    table = figure_table("campaign", "seconds", "target", "")
    for name, seconds in times.items():
        table.add_row(name, f"{seconds:.0f}", f"under {PAPER_TARGET_S:.0f}", said(seconds < PAPER_TARGET_S))
    screen.print(table)
    screen.print()
    print_rows(screen, rows)


async def _paper(
    url: str, bodies: list[CampaignBody], *, control: bool, quiet: bool
) -> tuple[dict[str, float], list[Any]]:
    times: dict[str, float] = {}
    ids = []
    async with httpx.AsyncClient(base_url=url, timeout=TIMEOUT) as client:
        api = Api(client, url)
        for body in bodies:
            fresh = body.model_copy(update={"execution": body.execution.model_copy(update={"cache": False})})
            campaign = await api.post("/campaigns", fresh.model_dump(mode="json"))
            ids.append(campaign["id"])
            await follow(api, campaign["id"], as_json=False, quiet=quiet)
            times[body.name] = (await api.get(f"/campaigns/{campaign['id']}/progress"))["elapsed_s"]
        return times, await compared(api, ids, control=control)


COMMANDS = (difficulty, simood, mumoea, search, sim, paper)
