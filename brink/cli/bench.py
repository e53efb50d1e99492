"""`brink bench`: measures this installation, each figure beside its target."""

import asyncio
from collections import Counter
from collections.abc import Callable
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
from brink.cli.compare import compared, print_rows, rows_json
from brink.cli.options import AsJson, console, print_json
from brink.cli.submit import follow
from brink.server.campaigns.body import CampaignBody, read_campaign_file
from brink.server.errors import FieldError, InvalidInput
from brink.server.runtime.coordinator import EmbeddedCoordinator, WorkerProcesses
from brink.server.runtime.database import prepare_database
from brink.server.settings import Settings


def teller(progress: Progress) -> Callable[[str, int, int], None]:
    """Return what shows how far each part of a measurement is: bars, or lines where bars cannot be drawn."""
    parts: dict[str, TaskID] = {}
    tenths: dict[str, int] = {}
    bars = progress.console.is_terminal

    def tell(part: str, done: int, total: int) -> None:
        if part not in parts:
            parts[part] = progress.add_task(part, total=total)
        progress.update(parts[part], completed=done, visible=bars and done < total)
        tenth = 10 * done // max(1, total)
        if not bars and tenths.get(part) != tenth:
            progress.console.print(f"{part}: {done} of {total}", highlight=False)
        tenths[part] = tenth

    return tell


def print_figures(rows: list[Row], *, as_json: bool) -> None:
    """Print measured figures beside their targets; exit with 1 if one is missed."""
    if as_json:
        print_json([{name: getattr(row, name) for name in row.__slots__} for row in rows])
    else:
        table = figure_table("what", "value", "target", "", "of")
        for row in rows:
            table.add_row(row.what, f"{row.value:.4g}", row.target, said(row.met), row.note)
        console().print(table)
    if any(row.met is False for row in rows):
        raise typer.Exit(1)


def bars(screen: Console) -> Progress:
    """Return what shows how far measurements are."""
    return Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
        console=screen, transient=True,
    )  # fmt: skip


def figure_table(*columns: str) -> Table:
    """Return a table whose figures are aligned to the right."""
    table = Table(box=None, pad_edge=False, header_style="dim")
    for index, name in enumerate(columns):
        table.add_column(name, justify="left" if index == 0 or name in ("target", "", "of") else "right")
    return table


def said(met: bool | None) -> str:
    """Return whether a target is met, in words."""
    return {None: "", True: "met", False: "MISSED"}[met]


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
    from brink.bench.urban_difficulty import Sizes, measure

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
    from brink.bench.distances import measure

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
    from brink.bench.urban_costs import measure_costs

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


def queue(
    jobs: Annotated[int, typer.Option(min=500, help="Jobs a measurement.")] = 4_000,
    rounds: Annotated[
        int, typer.Option(min=1, help="How often all of it is measured; medians are shown.")
    ] = 3,
    quick: Annotated[bool, typer.Option("--quick", help="Only 4 workers, batches of 8.")] = False,
    as_json: AsJson = False,
) -> None:
    """Measure jobs a second and pick-up times, beside Celery on Redis and procrastinate on Postgres.

    All of them in one run, each durable: what was acknowledged survives a power cut. The others need
    pip install 'brink[bench]' and an installed redis-server; Postgres is started in a temporary folder. --quick is
    for a look.

    Example: brink bench queue
    """
    # Imported here, and below: not everybody has what measurements need.
    from brink.bench.load import problem  # noqa: F401  (registers it, to read campaigns of it)
    from brink.bench.queue.comparison import TARGET_PICKUP_MS, TARGET_TIMES, compare_queues

    with bars(Console(stderr=True)) as progress:
        found = compare_queues(teller(progress), jobs=jobs, rounds=rounds, quick=quick)
    ratios = found.ratios()
    missed = any(ratio < TARGET_TIMES for _, _, ratio in ratios) or any(
        pickup.p99_ms >= TARGET_PICKUP_MS for pickup in found.pickups if pickup.since == "stored"
    )
    if as_json:
        print_json(
            {
                "throughput": [
                    {**{name: getattr(one, name) for name in one.__slots__}, "per_s": one.per_s}
                    for one in found.throughput
                ],
                "ratios": [
                    {"system": ours.system, "workers": ours.workers, "beside": best.system, "ratio": ratio}
                    for ours, best, ratio in ratios
                ],
                "pickups": [
                    {"system": one.system, "since": one.since, "p50_ms": one.p50_ms, "p99_ms": one.p99_ms}
                    for one in found.pickups
                ],
                "settings": found.settings,
                "left_out": found.left_out,
            }
        )
        raise typer.Exit(int(missed))
    screen = console()
    table = figure_table("queue", "workers", "batch", "jobs /s", "lease p50 ms", "p99 ms")
    for one in found.throughput:
        times = ["" if ms is None else f"{ms:.1f}" for ms in (one.lease_p50_ms, one.lease_p99_ms)]
        table.add_row(one.system, str(one.workers), str(one.batch), f"{one.per_s:,.0f}", *times)
    screen.print(table, "")
    table = figure_table("queue", "workers", "times as fast", "of", "target", "")
    for ours, best, ratio in ratios:
        table.add_row(
            ours.system, str(ours.workers), f"{ratio:.1f}", best.system, f"at least {TARGET_TIMES:g}",
            said(ratio >= TARGET_TIMES),
        )  # fmt: skip
    screen.print(table, "")
    table = figure_table("an idle worker starts a job", "since it was", "p50 ms", "p99 ms", "target", "")
    for pickup in found.pickups:
        ours_stored = pickup.since == "stored"
        table.add_row(
            pickup.system, pickup.since, f"{pickup.p50_ms:.1f}", f"{pickup.p99_ms:.1f}",
            f"p99 under {TARGET_PICKUP_MS:g}" if ours_stored else "",
            said(pickup.p99_ms < TARGET_PICKUP_MS if ours_stored else None),
        )  # fmt: skip
    screen.print(table, "")
    for system, setting in found.settings.items():
        screen.print(f"[dim]{system}: {setting}[/dim]")
    for system, reason in found.left_out.items():
        screen.print(f"[yellow]{system} was left out: {reason}[/yellow]")
    if missed:
        raise typer.Exit(1)


def chaos(
    minutes: Annotated[float, typer.Option(min=0.1, max=600, help="How long things break, at least.")] = 10.0,
    faults: Annotated[int, typer.Option(min=1, help="Processes and connections to break, at least.")] = 200,
    simulations: Annotated[int, typer.Option(min=100, help="Simulations of each campaign.")] = 400,
    idle: Annotated[
        bool, typer.Option("--idle", help="Episodes that only wait for a moment, in place of drives.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Of campaigns and faults.")] = 1,
    as_json: AsJson = False,
) -> None:
    """Run campaigns on Postgres while everything breaks, and compare with the same ones undisturbed.

    Two coordinators and four workers; processes, episodes, the database and its connections are killed or stand
    still, messages are lost, cut, delayed and repeated, the clocks of two workers are wrong. No verdict may be lost
    or counted twice, no job may get stuck, and every archive must be the one that nothing disturbs.

    Example: brink bench chaos --minutes 10
    """
    from brink.bench.chaos.trial import ChaosPlan, run_trial

    plan = ChaosPlan(minutes=minutes, faults=faults, simulations=simulations, drives=not idle, seed=seed)
    with bars(Console(stderr=True)) as progress:
        outcome = run_trial(plan, teller(progress))
    findings = outcome.findings
    wrong = {"lost": findings.lost, "counted twice": findings.doubled, "stuck": findings.stuck}
    well = not any(wrong.values()) and outcome.same == len(outcome.digests)
    if as_json:
        print_json(
            {
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
        )
        raise typer.Exit(int(not well))
    screen = console()
    table = figure_table("what broke", "times")
    for name, count in (outcome.broken + outcome.messages).most_common():
        table.add_row(name, str(count))
    table.add_row("processes, connections, databases", str(outcome.broken.total()))
    table.add_row(f"messages, of {outcome.requests:,}", str(outcome.messages.total()))
    screen.print(table, "")
    screen.print(f"results answered: {_counts(outcome.statuses)}")
    for end in outcome.own_ends:
        screen.print(f"ended by itself and was started again: {end}", markup=False)
    table = figure_table("in the end", "value", "target", "")
    for name, found in wrong.items():
        table.add_row(f"verdicts or jobs {name}", str(len(found)), "0", said(not found))
    same = f"{outcome.same} of {len(outcome.digests)}"
    table.add_row("archives the same as undisturbed", same, "all", said(outcome.same == len(outcome.digests)))
    screen.print("", table)
    for name, found in wrong.items():
        for one in found[:10]:
            screen.print(f"[red]{name}: {one}[/red]")
    if not well:
        raise typer.Exit(1)


def scale(
    workers: Annotated[
        int | None,
        typer.Option(
            min=2, max=5000, help="So many instead, with generations of four jobs for each of them."
        ),
    ] = None,
    seconds: Annotated[float, typer.Option(min=5, help="About how long each measurement takes.")] = 30.0,
    shrunk: Annotated[
        float, typer.Option("--scale", min=0.01, max=1, help="What of its 5 s an episode takes here.")
    ] = 0.2,
    as_json: AsJson = False,
) -> None:
    """Measure how well 1 to 64 simulated workers are used, by one campaign and by several side by side.

    Between two generations of one campaign workers wait for its longest episodes; other campaigns fill the gap.

    Example: brink bench scale --workers 1000 --scale 1
    """
    from brink.bench.scale.utilisation import TARGET, measure_utilisation

    with bars(Console(stderr=True)) as progress:
        found = measure_utilisation(teller(progress), workers=workers, seconds=seconds, scale=shrunk)
    missed = any(one.meets is False for one in found)
    if as_json:
        print_json(
            [
                {**{name: getattr(one, name) for name in one.__slots__}, "share": one.share, "met": one.meets}
                for one in found
            ]
        )
        raise typer.Exit(int(missed))
    table = figure_table(
        "workers", "campaigns", "generation", "jobs", "seconds", "used", "target", "", "coordinator CPU",
        "its writer", "step s",
    )  # fmt: skip
    for one in found:
        table.add_row(
            str(one.workers), str(one.campaigns), str(one.generation), f"{one.jobs:,}", f"{one.seconds:.0f}",
            f"{one.share:.1%}", "" if one.meets is None else f"at least {TARGET:.0%}", said(one.meets),
            f"{one.coordinator_s / one.seconds:.0%}", f"{one.writing_s / one.seconds:.0%}", f"{one.step_s:.3f}",
        )  # fmt: skip
    console().print(table)
    if missed:
        raise typer.Exit(1)


def archive(
    solutions: Annotated[int, typer.Option(min=2000, help="Solutions of the archive.")] = 100_000,
    samples: Annotated[int, typer.Option(min=20, help="Requests of each kind.")] = 100,
    as_json: AsJson = False,
) -> None:
    """Measure how fast a coordinator with a large archive answers, while a campaign runs.

    Filling the archive takes long: every solution goes through the queue and into the distance matrix.

    Example: brink bench archive --solutions 20000
    """
    from brink.bench.endurance.archive import GENERATION, TARGET_MS, measure_archive

    with bars(Console(stderr=True)) as progress:
        found = measure_archive(teller(progress), solutions=solutions, samples=samples)
    missed = any(one.p95_ms >= TARGET_MS for one in found.answers)
    if as_json:
        figures = ("request", "first_ms", "p50_ms", "p95_ms")
        print_json(
            {
                "answers": [{name: getattr(one, name) for name in figures} for one in found.answers],
                "bytes_a_solution": found.bytes_a_solution,
                "last_step_s": found.last_step_s,
            }
        )
        raise typer.Exit(int(missed))
    table = figure_table("request", "first ms", "p50 ms", "p95 ms", "target", "")
    for one in found.answers:
        table.add_row(
            one.request, f"{one.first_ms:.0f}", f"{one.p50_ms:.0f}", f"{one.p95_ms:.0f}",
            f"p95 under {TARGET_MS:g}", said(one.p95_ms < TARGET_MS),
        )  # fmt: skip
    screen = console()
    screen.print(table)
    screen.print(f"database: {found.bytes_a_solution / 1000:.1f} kB a solution, with its job and result")
    screen.print(f"the last generation step, {GENERATION} new solutions: {found.last_step_s:.2f} s")
    if missed:
        raise typer.Exit(1)


def soak(
    minutes: Annotated[float, typer.Option(min=1, help="How long.")] = 60.0, as_json: AsJson = False
) -> None:
    """Run campaign after campaign, and measure how the memory of coordinator and workers grows.

    Example: brink bench soak --minutes 60
    """
    from brink.bench.endurance.soak import TARGET_MIB_AN_HOUR, soak

    with bars(Console(stderr=True)) as progress:
        found = soak(teller(progress), minutes=minutes)
    missed = any(one.slope >= TARGET_MIB_AN_HOUR for one in found)
    if as_json:
        figures = ("process", "campaigns", "simulations", "slope", "hours", "mib")
        print_json([{name: getattr(one, name) for name in figures} for one in found])
        raise typer.Exit(int(missed))
    table = figure_table("process", "MiB first", "last", "most", "MiB an hour", "target", "")
    for one in found:
        table.add_row(
            one.process, f"{one.mib[0]:.1f}", f"{one.mib[-1]:.1f}", f"{max(one.mib):.1f}", f"{one.slope:+.2f}",
            f"under {TARGET_MIB_AN_HOUR:g}", said(one.slope < TARGET_MIB_AN_HOUR),
        )  # fmt: skip
    console().print(table)
    console().print(f"{found[0].campaigns} campaigns of {found[0].simulations:,} simulations ended")
    if missed:
        raise typer.Exit(1)


def _counts(counter: Counter[str]) -> str:
    return ", ".join(f"{count:,} {name}" for name, count in counter.most_common())


def dashboard(
    solutions: Annotated[
        int, typer.Option(min=2000, help="Solutions of the campaign that is looked at.")
    ] = 20_000,
    polls: Annotated[
        int, typer.Option(min=100, help="Polls of a page that is left open; the default is a day's.")
    ] = 8_640,
    as_json: AsJson = False,
) -> None:
    """Measure the dashboard in a headless Chromium: first view, polls, dragging the map, a day of being left open.

    Needs pip install 'brink[dev]' and Chromium, such as by apt-get install chromium.

    Example: brink bench dashboard --polls 500
    """
    from brink.bench.dashboard.trial import measure_dashboard

    with bars(Console(stderr=True)) as progress:
        rows = measure_dashboard(teller(progress), solutions=solutions, polls=polls)
    print_figures(rows, as_json=as_json)


bench = typer.Typer(help="Measure this installation, each figure with its target.", no_args_is_help=True)


for command in (
    difficulty,
    simood,
    mumoea,
    search,
    sim,
    paper,
    queue,
    chaos,
    scale,
    archive,
    soak,
    dashboard,
):
    bench.command()(command)
