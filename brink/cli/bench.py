"""`brink bench`: measurements of this installation, each value beside its target."""

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import httpx
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table

from brink.api.client import TIMEOUT, Api
from brink.bench.figures import Row
from brink.bench.rate import TARGET_SHARE, ServiceRate, measure_service
from brink.cli.campaigns import follow
from brink.cli.compare import compared, print_rows, rows_json
from brink.cli.options import RESULTS, AsJson, console, fields, plain_table, print_json
from brink.search.analysis.comparison import Row as ComparisonRow
from brink.server.api.schemas import CampaignView
from brink.server.api.schemas import Progress as CampaignProgress
from brink.server.campaigns.body import CampaignBody, read_campaign_file
from brink.server.errors import FieldError, InvalidInput
from brink.server.runtime.coordinator import EmbeddedCoordinator, WorkerProcesses
from brink.server.runtime.database import prepare_database
from brink.server.settings import Settings

bench = typer.Typer(help="Measure this installation, each figure beside its target.", no_args_is_help=True)

PAPER_FILES = tuple(Path("examples") / f"paper-{name}.yaml" for name in ("mlcshe", "ga", "random"))
PAPER_TARGET_S = 180.0

Processes = Annotated[int, typer.Option(min=1, help="Number of processes to run in.")]
Report = Callable[[str, int, int], None]
"""Called with the name of a part of a measurement, its completed steps and all its steps."""


@contextmanager
def _progress() -> Iterator[Report]:
    """Yield a progress callback that draws bars on a terminal, and elsewhere prints a line every tenth."""
    screen = Console(stderr=True)
    bars = Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
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


def _conclude(document: Any, show: Callable[[Console], None], *, as_json: bool, missed: bool = False) -> None:
    """Print a measurement as JSON or for people, and exit with 1 if it misses a target.

    Args:
        document: JSON document of the measurement.
        show: Prints the measurement on a console.
        as_json: Print the document.
        missed: Whether a target is missed.
    """
    if as_json:
        print_json(document)
    else:
        show(console())
    if missed:
        raise typer.Exit(1)


def _conclude_rows(rows: list[Row], *, as_json: bool) -> None:
    """Print measured values beside their targets, and exit with 1 if one is missed."""

    def show(screen: Console) -> None:
        table = _table("what", "value", "target", "", "of")
        for row in rows:
            table.add_row(row.what, f"{row.value:.4g}", row.target, _met(row.met), row.note)
        screen.print(table)

    missed = any(row.met is False for row in rows)
    _conclude([fields(row) for row in rows], show, as_json=as_json, missed=missed)


def _table(*columns: str) -> Table:
    """Return a table whose values are aligned to the right."""
    return plain_table(*columns, right={*columns[1:]} - {"target", "", "of"})


def _met(met: bool | None) -> str:
    """Return whether a target is met; empty if there is no target."""
    return {None: "", True: "met", False: "MISSED"}[met]


@bench.command()
def difficulty(
    candidates: Annotated[int, typer.Option(min=100, help="Number of random candidates.")] = 2000,
    share: Annotated[
        float, typer.Option(min=0.01, max=1.0, help="Fraction of the other samples to run, for a quick look.")
    ] = 1.0,
    processes: Processes = 2,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    as_json: AsJson = False,
) -> None:
    """Measure how hard the urban problem is and what determines its verdicts.

    Example: brink bench difficulty --candidates 2000
    """
    # Imported here: it loads the simulator.
    from brink.bench.urban_difficulty import Sizes, measure

    full = Sizes()
    sizes = Sizes(
        candidates=candidates,
        **{
            name: max(20, round(share * getattr(full, name)))
            for name in ("scenarios", "reruns", "pairs", "redraws", "ends")
        },
    )
    with _progress() as report:
        rows = list(measure(sizes, seed=seed, processes=processes, progress=report))
    _conclude_rows(rows, as_json=as_json)


@bench.command()
def simood(
    criteria: Annotated[
        list[str] | None, typer.Argument(metavar="[A0 … A8]", help="Criteria to measure; all by default.")
    ] = None,
    processes: Processes = 2,
    out: Annotated[Path, typer.Option(help="Folder for tables, figures and runs.")] = RESULTS
    / "bench-simood",
    as_json: AsJson = False,
) -> None:
    """Measure the SiMOOD criteria: a safe baseline, hazards of perturbations, the search, and its cost.

    The full measurement takes hours. Completed runs are kept in the folder, so the same command continues after an
    interruption, and criteria share episodes.

    Example: brink bench simood A0 A2 --processes 2
    """
    # Imported here: it loads the simulator.
    from brink.bench.simood.criteria import CRITERIA, measure_simood

    wanted = [name.upper() for name in criteria or CRITERIA]
    for name in wanted:
        if name not in CRITERIA:
            message = f"expected some of {', '.join(CRITERIA)}, got {name!r}"
            raise InvalidInput([FieldError(pointer="criteria", message=message)])
    out.mkdir(parents=True, exist_ok=True)
    with _progress() as report:
        rows = measure_simood(wanted, out, processes=processes, told=report)
    _conclude_rows(rows, as_json=as_json)


@bench.command()
def mumoea(
    seeds: Annotated[int, typer.Option(min=2, help="Number of searches with each method.")] = 5,
    simulations: Annotated[int, typer.Option(min=100, help="Simulations per search.")] = 2000,
    road: Annotated[
        str, typer.Option(help="Shape of the road: crossroad, straight, right, left.")
    ] = "crossroad",
    processes: Processes = 2,
    out: Annotated[Path, typer.Option(help="Folder for tables, figures and runs.")] = RESULTS
    / "bench-mumoea",
    as_json: AsJson = False,
) -> None:
    """Compare muMOEA with its ablations, MOSAT, NSGA-II and random search, at equal simulations.

    The full comparison takes hours. Completed searches are kept in the folder, so the same command continues after
    an interruption.

    Example: brink bench mumoea --seeds 5 --simulations 2000
    """
    # Imported here: it loads the simulator.
    from brink.bench.mumoea.comparison import Comparison
    from brink.server.problems.catalogue import make_params
    from brink.server.problems.npc_actions import NpcActionsParams

    params = make_params(NpcActionsParams, {"road_curve": road}, "/problem/params")
    out.mkdir(parents=True, exist_ok=True)
    with _progress() as report:
        comparison = Comparison(
            out, params, seeds=seeds, simulations=simulations, processes=processes, told=report
        )
        rows = comparison.rows()
    _conclude_rows(rows, as_json=as_json)


@bench.command()
def search(as_json: AsJson = False) -> None:
    """Measure one generation step: the time to add 60 new solutions to archives of growing size.

    Example: brink bench search
    """
    from brink.bench.distances import measure

    rows = measure()

    def show(screen: Console) -> None:
        table = _table("archived", "new", "min ms", "median ms", "target ms", "")
        for row in rows:
            target = "" if row.target_ms is None else f"at most {row.target_ms:g}"
            table.add_row(
                f"{row.solutions:,}", str(row.new), f"{row.min_ms:.2f}", f"{row.median_ms:.2f}", target,
                _met(row.met),
            )  # fmt: skip
        screen.print(table)

    _conclude([fields(row) for row in rows], show, as_json=as_json)


@bench.command()
def sim(
    episodes: Annotated[int, typer.Option(min=20, help="Episodes per run.")] = 240,
    repeats: Annotated[int, typer.Option(min=1, help="Runs of each kind.")] = 3,
    as_json: AsJson = False,
) -> None:
    """Measure episodes: CPU time of one, and throughput of the whole service with 1 and 2 workers.

    Example: brink bench sim
    """
    from brink.bench.urban_costs import measure_costs

    rates = []
    with console(stderr=True).status(
        "measuring CPU time and memory of episodes; takes some minutes"
    ) as status:
        kinds = list(measure_costs())
        for algorithm in ("random@1", "mlcshe@1"):
            for workers in (1, 2):
                status.update(f"{algorithm} with {workers} workers against a bare loop")
                rates.append(measure_service(workers, algorithm, episodes=episodes, repeats=repeats))

    def show(screen: Console) -> None:
        table = _table("what", "value", "", "target", "")
        for kind in kinds:
            target = "" if kind.most is None else f"at most {kind.most:g}"
            table.add_row(kind.what, f"{kind.value:.1f}", kind.unit, target, _met(kind.met))
        screen.print(table)
        screen.print(_rate_table(rates))
        screen.print(
            "[dim]CPU time in ms per episode. The rest of the difference is waiting, for the last episodes of a "
            "generation and for the next one. Random search proposes all episodes at once, MLCSHE proposes "
            "generations.[/dim]"
        )

    document = {"episodes": [fields(kind) for kind in kinds], "service": [fields(rate) for rate in rates]}
    _conclude(document, show, as_json=as_json)


def _rate_table(rates: list[ServiceRate]) -> Table:
    table = _table(
        "algorithm", "workers", "service /s", "bare /s", "share", "target", "", "coordinator", "worker",
        "episode", "bare episode",
    )  # fmt: skip
    for rate in rates:
        table.add_row(
            rate.algorithm, str(rate.workers), f"{rate.service_per_s:.1f}", f"{rate.bare_per_s:.1f}",
            f"{rate.share:.1%}", f"at least {TARGET_SHARE:.0%}", _met(rate.share >= TARGET_SHARE),
            f"{rate.coordinator_ms:.2f}", f"{rate.worker_ms:.2f}", f"{rate.episode_ms:.1f}",
            f"{rate.bare_ms:.1f}",
        )  # fmt: skip
    return table


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
    """Run the paper's three campaigns and print their DBS tables, each beside its controls.

    Example: brink bench paper --workers 2
    """
    bodies = [read_campaign_file(path) for path in files or PAPER_FILES]
    settings = Settings(database=database, port=0)
    prepare_database(settings)
    coordinator = EmbeddedCoordinator(settings)
    coordinator.start()
    processes = WorkerProcesses(url=coordinator.url, log_file=RESULTS / "worker.log", token=None)
    try:
        processes.start(workers)
        times, rows = asyncio.run(_paper(coordinator.url, bodies, control=control, quiet=as_json))
    finally:
        processes.stop()
        coordinator.stop()

    def show(screen: Console) -> None:
        table = _table("campaign", "seconds", "target", "")
        for name, seconds in times.items():
            table.add_row(
                name, f"{seconds:.0f}", f"under {PAPER_TARGET_S:.0f}", _met(seconds < PAPER_TARGET_S)
            )
        screen.print(table, "")
        print_rows(screen, rows)

    _conclude({"seconds": times, "rows": rows_json(rows)}, show, as_json=as_json)


async def _paper(
    url: str, bodies: list[CampaignBody], *, control: bool, quiet: bool
) -> tuple[dict[str, float], list[ComparisonRow]]:
    """Run campaigns one after another; return their times in seconds and their comparison."""
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
def queue(
    jobs: Annotated[int, typer.Option(min=500, help="Jobs per measurement.")] = 4_000,
    rounds: Annotated[
        int, typer.Option(min=1, help="Repetitions of the whole measurement; medians are shown.")
    ] = 3,
    quick: Annotated[bool, typer.Option("--quick", help="Only 4 workers, batches of 8.")] = False,
    as_json: AsJson = False,
) -> None:
    """Measure queue throughput and pick-up times, beside Celery on Redis and procrastinate on Postgres.

    All queues run durably: acknowledged jobs survive a power cut. The other queues need pip install 'brink[bench]'
    and an installed redis-server; Postgres is started in a temporary folder. Use --quick for a quick look.

    Example: brink bench queue
    """
    # Imported here, and below: measurements need optional packages.
    from brink.bench.load import problem  # noqa: F401  (registers the problem)
    from brink.bench.queue.comparison import TARGET_PICKUP_MS, TARGET_TIMES, compare_queues

    with _progress() as report:
        found = compare_queues(report, jobs=jobs, rounds=rounds, quick=quick)
    ratios = found.ratios()
    missed = any(ratio < TARGET_TIMES for _, _, ratio in ratios) or any(
        pickup.p99_ms >= TARGET_PICKUP_MS for pickup in found.pickups if pickup.since == "stored"
    )
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

    def show(screen: Console) -> None:
        table = _table("queue", "workers", "batch", "jobs /s", "lease p50 ms", "p99 ms")
        for one in found.throughput:
            times = ["" if ms is None else f"{ms:.1f}" for ms in (one.lease_p50_ms, one.lease_p99_ms)]
            table.add_row(one.system, str(one.workers), str(one.batch), f"{one.per_s:,.0f}", *times)
        screen.print(table, "")
        table = _table("queue", "workers", "times as fast", "of", "target", "")
        for ours, best, ratio in ratios:
            table.add_row(
                ours.system, str(ours.workers), f"{ratio:.1f}", best.system, f"at least {TARGET_TIMES:g}",
                _met(ratio >= TARGET_TIMES),
            )  # fmt: skip
        screen.print(table, "")
        table = _table("an idle worker starts a job", "since it was", "p50 ms", "p99 ms", "target", "")
        for pickup in found.pickups:
            target, met = "", None
            if pickup.since == "stored":
                target, met = f"p99 under {TARGET_PICKUP_MS:g}", pickup.p99_ms < TARGET_PICKUP_MS
            table.add_row(
                pickup.system, pickup.since, f"{pickup.p50_ms:.1f}", f"{pickup.p99_ms:.1f}", target, _met(met)
            )
        screen.print(table, "")
        for system, setting in found.settings.items():
            screen.print(f"[dim]{system}: {setting}[/dim]")
        for system, reason in found.left_out.items():
            screen.print(f"[yellow]{system} was left out: {reason}[/yellow]")

    _conclude(document, show, as_json=as_json, missed=missed)


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
    be lost or counted twice, no job may get stuck, and every archive must equal that of the undisturbed campaign.

    Example: brink bench chaos --minutes 10
    """
    from brink.bench.chaos.trial import ChaosPlan, run_trial

    plan = ChaosPlan(minutes=minutes, faults=faults, simulations=simulations, drives=not idle, seed=seed)
    with _progress() as report:
        outcome = run_trial(plan, report)
    findings = outcome.findings
    wrong = {"lost": findings.lost, "counted twice": findings.doubled, "stuck": findings.stuck}
    undisturbed = outcome.same == len(outcome.digests)
    document = {
        "minutes": outcome.minutes,
        "broken": outcome.broken,
        "messages": outcome.requests,
        "messages_broken": outcome.messages,
        "results": outcome.statuses,
        "campaigns": outcome.campaigns,
        "digests": outcome.digests,
        "ended_by_themselves": outcome.own_ends,
        **{name.replace(" ", "_"): list(found) for name, found in wrong.items()},
    }

    def show(screen: Console) -> None:
        table = _table("what broke", "times")
        for name, count in (outcome.broken + outcome.messages).most_common():
            table.add_row(name, str(count))
        table.add_row("processes, connections, databases", str(outcome.broken.total()))
        table.add_row(f"messages, of {outcome.requests:,}", str(outcome.messages.total()))
        screen.print(table, "")
        answers = ", ".join(f"{count:,} {name}" for name, count in outcome.statuses.most_common())
        screen.print(f"answers to results: {answers}")
        for end in outcome.own_ends:
            screen.print(f"exited by itself and was restarted: {end}", markup=False)
        table = _table("in the end", "value", "target", "")
        for name, found in wrong.items():
            table.add_row(f"verdicts or jobs {name}", str(len(found)), "0", _met(not found))
        same = f"{outcome.same} of {len(outcome.digests)}"
        table.add_row("archives equal to the undisturbed ones", same, "all", _met(undisturbed))
        screen.print("", table)
        for name, found in wrong.items():
            for one in found[:10]:
                screen.print(f"[red]{name}: {one}[/red]")

    _conclude(document, show, as_json=as_json, missed=any(wrong.values()) or not undisturbed)


@bench.command()
def scale(
    workers: Annotated[
        int | None,
        typer.Option(
            min=2,
            max=5000,
            help="Measure only this many workers, with four jobs per worker in each generation.",
        ),
    ] = None,
    seconds: Annotated[float, typer.Option(min=5, help="Approximate duration of each measurement.")] = 30.0,
    shrunk: Annotated[
        float,
        typer.Option("--scale", min=0.01, max=1, help="Fraction of the full 5 s that an episode takes."),
    ] = 0.2,
    as_json: AsJson = False,
) -> None:
    """Measure the utilisation of 1 to 64 simulated workers, by one campaign and by several at once.

    Between two generations of a campaign, workers wait for its longest episodes; other campaigns fill the gap.

    Example: brink bench scale --workers 1000 --scale 1
    """
    from brink.bench.scale.utilisation import TARGET, measure_utilisation

    with _progress() as report:
        found = measure_utilisation(report, workers=workers, seconds=seconds, scale=shrunk)

    def show(screen: Console) -> None:
        table = _table(
            "workers", "campaigns", "generation", "jobs", "seconds", "used", "target", "", "coordinator CPU",
            "its writer", "step s",
        )  # fmt: skip
        for one in found:
            table.add_row(
                str(one.workers), str(one.campaigns), str(one.generation), f"{one.jobs:,}", f"{one.seconds:.0f}",
                f"{one.share:.1%}", "" if one.meets is None else f"at least {TARGET:.0%}", _met(one.meets),
                f"{one.coordinator_s / one.seconds:.0%}", f"{one.writing_s / one.seconds:.0%}",
                f"{one.step_s:.3f}",
            )  # fmt: skip
        screen.print(table)

    document = [{**fields(one), "share": one.share, "met": one.meets} for one in found]
    _conclude(document, show, as_json=as_json, missed=any(one.meets is False for one in found))


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
    from brink.bench.endurance.archive import GENERATION, TARGET_MS, measure_archive

    with _progress() as report:
        found = measure_archive(report, solutions=solutions, samples=samples)
    document = {
        "answers": [fields(one, "request", "first_ms", "p50_ms", "p95_ms") for one in found.answers],
        "bytes_a_solution": found.bytes_a_solution,
        "last_step_s": found.last_step_s,
    }

    def show(screen: Console) -> None:
        table = _table("request", "first ms", "p50 ms", "p95 ms", "target", "")
        for one in found.answers:
            table.add_row(
                one.request, f"{one.first_ms:.0f}", f"{one.p50_ms:.0f}", f"{one.p95_ms:.0f}",
                f"p95 under {TARGET_MS:g}", _met(one.p95_ms < TARGET_MS),
            )  # fmt: skip
        screen.print(table)
        screen.print(
            f"database: {found.bytes_a_solution / 1000:.1f} kB per solution, with its job and result"
        )
        screen.print(f"last generation step, {GENERATION} new solutions: {found.last_step_s:.2f} s")

    missed = any(one.p95_ms >= TARGET_MS for one in found.answers)
    _conclude(document, show, as_json=as_json, missed=missed)


@bench.command()
def soak(
    minutes: Annotated[float, typer.Option(min=1, help="Duration in minutes.")] = 60.0,
    as_json: AsJson = False,
) -> None:
    """Run one campaign after another and measure how the memory of coordinator and workers grows.

    Example: brink bench soak --minutes 60
    """
    from brink.bench.endurance.soak import TARGET_MIB_AN_HOUR, soak

    with _progress() as report:
        found = soak(report, minutes=minutes)

    def show(screen: Console) -> None:
        table = _table("process", "MiB first", "last", "most", "MiB an hour", "target", "")
        for one in found:
            table.add_row(
                one.process, f"{one.mib[0]:.1f}", f"{one.mib[-1]:.1f}", f"{max(one.mib):.1f}",
                f"{one.slope:+.2f}", f"under {TARGET_MIB_AN_HOUR:g}", _met(one.slope < TARGET_MIB_AN_HOUR),
            )  # fmt: skip
        screen.print(table)
        screen.print(f"{found[0].campaigns} campaigns of {found[0].simulations:,} simulations ended")

    columns = ("process", "campaigns", "simulations", "slope", "hours", "mib")
    missed = any(one.slope >= TARGET_MIB_AN_HOUR for one in found)
    _conclude([fields(one, *columns) for one in found], show, as_json=as_json, missed=missed)


@bench.command()
def dashboard(
    solutions: Annotated[
        int, typer.Option(min=2000, help="Number of solutions of the campaign on display.")
    ] = 20_000,
    polls: Annotated[
        int,
        typer.Option(min=100, help="Polls of a page that stays open; the default corresponds to one day."),
    ] = 8_640,
    as_json: AsJson = False,
) -> None:
    """Measure the dashboard in headless Chromium: first view, polling, dragging the map, staying open for a day.

    Needs pip install 'brink[dev]' and Chromium, for example from apt-get install chromium.

    Example: brink bench dashboard --polls 500
    """
    from brink.bench.dashboard.trial import measure_dashboard

    with _progress() as report:
        rows = measure_dashboard(report, solutions=solutions, polls=polls)
    _conclude_rows(rows, as_json=as_json)
