"""Load and faults: `queue`, `chaos`, `stalls`, `scale`, `utilisation`, `turns`, `archive`, `soak`, `dashboard`."""

from typing import Annotated

import typer
from rich.console import RenderableType
from rich.text import Text

from benchmarks.cli.output import conclude, conclude_rows, met_text, show_progress, value_table
from brink.cli.options import AsJson, fields


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

    Example: python -m benchmarks queue
    """
    from benchmarks.queue import TARGET_PICKUP_MS, TARGET_RATIO, compare_queues

    with show_progress() as progress:
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
    throughput_table = value_table(
        ("queue", "workers", "batch", "jobs /s", "lease p50 ms", "p99 ms"),
        (
            (
                one.system,
                one.workers,
                one.batch,
                f"{one.per_s:,.0f}",
                *("" if ms is None else f"{ms:.1f}" for ms in (one.lease_p50_ms, one.lease_p99_ms)),
            )
            for one in found.throughput
        ),
    )
    ratio_table = value_table(
        ("queue", "workers", "times as fast", "of", "target", ""),
        (
            (
                ours.system,
                ours.workers,
                f"{ratio:.1f}",
                best.system,
                f"at least {TARGET_RATIO:g}",
                met_text(ratio >= TARGET_RATIO),
            )
            for ours, best, ratio in ratios
        ),
    )
    pickup_table = value_table(
        ("an idle worker starts a job", "since it was", "p50 ms", "p99 ms", "target", ""),
        (
            (
                one.system,
                one.since,
                f"{one.p50_ms:.1f}",
                f"{one.p99_ms:.1f}",
                "" if met is None else f"p99 under {TARGET_PICKUP_MS:g}",
                met_text(met),
            )
            for one, met in pickups
        ),
    )
    notes: list[RenderableType] = [
        Text(f"{system}: {setting}", "dim") for system, setting in found.settings.items()
    ]
    notes += [Text(f"{name} was not measured: {reason}", "yellow") for name, reason in found.left_out.items()]
    missed = any(ratio < TARGET_RATIO for *_, ratio in ratios) or any(met is False for _, met in pickups)
    shown = (throughput_table, "", ratio_table, "", pickup_table, "", *notes)
    conclude(document, *shown, as_json=as_json, missed=missed)


def stalls(
    seconds: Annotated[
        float, typer.Option(min=1, max=600, help="How long others are timed during each disturbance.")
    ] = 20.0,
    only: Annotated[
        list[str] | None,
        typer.Option("--only", help="Only disturbances whose title contains this text; may be repeated."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure the effect of a stalling campaign or request on all others.

    A health check, a heartbeat, a report with the next lease, the submission of another campaign, and a whole small
    search are timed, first alone and then beside each disturbance, such as a plug-in that hangs. Each time is the
    worst one. In the end, the disturbing campaign is cancelled, and the coordinator is told to exit.

    Example: python -m benchmarks stalls --only plug-in
    """
    from benchmarks.stalls import DISTURBANCES, MOST_EXIT_S, MOST_LATENCY_S, PROBES, measure_stalls

    chosen = [one for one in DISTURBANCES if not only or any(text in one.title for text in only)]
    if not chosen:
        expected = ", ".join(one.title for one in DISTURBANCES)
        raise typer.BadParameter(f"expected part of one of: {expected}", param_hint="--only")
    with show_progress() as progress:
        found = list(measure_stalls(progress, chosen, seconds=seconds))
    document = [
        {**fields(one), "latencies": [{**fields(each), "ratio": each.ratio} for each in one.latencies]}
        for one in found
    ]
    table = value_table(
        (
            "during it, worst ms (of idle)",
            *PROBES,
            "cancel s",
            "exit s",
            f"target: {MOST_LATENCY_S:g} s, exit {MOST_EXIT_S:g} s",
            "the campaign",
        ),
        (
            (
                one.title,
                *(f"{each.worst_ms:,.0f} ({each.ratio:,.1f}x)" for each in one.latencies),
                "" if one.cancel_s is None else f"{one.cancel_s:.2f}",
                f"{one.exit_s:.1f}",
                met_text(one.met),
                one.fate,
            )
            for one in found
        ),
    )
    conclude(document, table, as_json=as_json, missed=not all(one.met for one in found))


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

    Example: python -m benchmarks chaos --minutes 10
    """
    from benchmarks.chaos import ChaosPlan, run_trial

    plan = ChaosPlan(minutes=minutes, faults=faults, simulations=simulations, drives=not idle, seed=seed)
    with show_progress() as progress:
        outcome = run_trial(plan, progress)
    findings = outcome.findings
    wrong = {
        "verdicts or jobs lost": findings.lost,
        "verdicts or jobs counted twice": findings.doubled,
        "verdicts or jobs stuck": findings.stuck,
        "jobs charged for faults of others": findings.charged,
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
    injected = value_table(("fault", "times"), (outcome.broken + outcome.messages).most_common())
    injected.add_row("processes, connections, databases", str(outcome.broken.total()))
    injected.add_row(f"messages, of {outcome.requests:,}", str(outcome.messages.total()))
    answers = ", ".join(f"{count:,} {name}" for name, count in outcome.statuses.most_common())
    verdicts = value_table(
        ("in the end", "value", "target", ""),
        ((name, len(found), "0", met_text(not found)) for name, found in wrong.items()),
    )
    same = f"{outcome.same} of {len(outcome.digests)}"
    verdicts.add_row("archives identical to the undisturbed ones", same, "all", met_text(undisturbed))
    conclude(
        document,
        injected,
        "",
        f"responses to reported results: {answers}",
        *(Text(f"exited by itself and was restarted: {end}") for end in outcome.unexpected_exits),
        "",
        verdicts,
        *(Text(f"{name}: {one}", "red") for name, found in wrong.items() for one in found[:10]),
        as_json=as_json,
        missed=any(wrong.values()) or not undisturbed,
    )


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

    Example: python -m benchmarks scale --workers 1000 --scale 1
    """
    from benchmarks.scale import measure_utilisation

    with show_progress() as progress:
        found = measure_utilisation(
            progress,
            workers=workers,
            seconds=seconds,
            scale=shrunk,
            postgres=postgres,
            coordinators=coordinators,
        )
    table = value_table(
        (
            "workers",
            "coordinators",
            "campaigns",
            "algorithm",
            "generation",
            "in flight",
            "jobs",
            "a second",
            "used",
            "target",
            "",
            "coordinator CPU",
            "ms a job",
            "its writer",
            "step s",
        ),
        (
            (
                one.setup.workers,
                one.setup.coordinators,
                one.setup.campaigns,
                one.setup.algorithm,
                one.setup.generation,
                one.setup.in_flight,
                f"{one.jobs:,}",
                f"{one.jobs / one.seconds:.0f}",
                f"{one.share:.1%}",
                "" if one.setup.target_share is None else f"at least {one.setup.target_share:.0%}",
                met_text(one.met),
                f"{one.coordinator_s / one.seconds:.0%}",
                f"{one.cpu_ms:.2f}",
                f"{one.writing_s / one.seconds:.0%}",
                f"{one.step_s:.3f}",
            )
            for one in found
        ),
    )
    names = ("jobs", "seconds", "busy_s", "coordinator_s", "writing_s", "step_s", "share", "cpu_ms", "met")
    document = [{**fields(one, *names), **fields(one.setup)} for one in found]
    conclude(document, table, as_json=as_json, missed=any(one.met is False for one in found))


def utilisation(
    algorithm: Annotated[
        list[str] | None, typer.Option(help="Model only this search; may be given several times.")
    ] = None,
    workers: Annotated[
        list[int] | None, typer.Option(min=1, max=5000, help="Number of workers; may be given several times.")
    ] = None,
    simulations: Annotated[
        list[int] | None, typer.Option(min=100, help="Budget of a campaign; may be given several times.")
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Number of campaigns; means are shown.")] = 2,
    as_json: AsJson = False,
) -> None:
    """Model how much of their time 1, 8 and 64 workers spend in the simulations of one campaign of a search.

    The search runs; its drives only take a drawn time on the clock of the model, so no coordinator is needed. Each
    search has its default settings, and where these are not enough for most workers, more candidates in flight.

    Example: python -m benchmarks utilisation --algorithm edge@2 --simulations 1300
    """
    from benchmarks.utilisation import BUDGETS, IDS, WORKERS, model_searches

    with show_progress() as progress:
        rows = list(
            model_searches(
                progress,
                ids=algorithm or IDS,
                workers=workers or WORKERS,
                budgets=simulations or BUDGETS,
                seeds=seeds,
            )
        )
    conclude_rows(rows, as_json=as_json)


def turns(
    seeds: Annotated[int, typer.Option(min=1, help="Number of runs; means are shown.")] = 20,
    as_json: AsJson = False,
) -> None:
    """Model how the utilisation of workers depends on turns and on candidates in flight, without a coordinator.

    First, campaigns with one generation in flight take turns; then, one campaign has candidates in flight that make
    up one or several generations.

    Example: python -m benchmarks turns
    """
    from benchmarks.scale import model_in_flight, model_turns

    conclude_rows([*model_turns(seeds), *model_in_flight(max(1, seeds // 4))], as_json=as_json)


def archive(
    solutions: Annotated[int, typer.Option(min=2000, help="Number of solutions in the archive.")] = 100_000,
    samples: Annotated[int, typer.Option(min=20, help="Number of requests of each kind.")] = 100,
    as_json: AsJson = False,
) -> None:
    """Measure the response times of a coordinator with a large archive while a campaign runs.

    Filling the archive is slow: every solution passes through the queue and into the distance matrix.

    Example: python -m benchmarks archive --solutions 20000
    """
    from benchmarks.endurance import measure_archive

    with show_progress() as progress:
        rows = measure_archive(progress, solutions=solutions, samples=samples)
    conclude_rows(rows, as_json=as_json)


def soak(
    minutes: Annotated[float, typer.Option(min=1, help="Duration in minutes.")] = 60.0,
    as_json: AsJson = False,
) -> None:
    """Run one campaign after another and measure how the memory of coordinator and workers grows.

    Example: python -m benchmarks soak --minutes 60
    """
    from benchmarks.endurance import TARGET_MIB_PER_HOUR, measure_growth

    with show_progress() as progress:
        found = measure_growth(progress, minutes=minutes)
    target = f"under {TARGET_MIB_PER_HOUR:g}"
    table = value_table(
        ("process", "MiB first", "last", "most", "MiB per hour", "target", ""),
        (
            (
                one.process,
                f"{one.mib[0]:.1f}",
                f"{one.mib[-1]:.1f}",
                f"{max(one.mib):.1f}",
                f"{one.slope:+.2f}",
                target,
                met_text(one.slope < TARGET_MIB_PER_HOUR),
            )
            for one in found
        ),
    )
    finished = f"{found[0].campaigns} campaigns finished, with {found[0].simulations:,} simulations in all"
    columns = ("process", "campaigns", "simulations", "slope", "hours", "mib")
    missed = any(one.slope >= TARGET_MIB_PER_HOUR for one in found)
    conclude([fields(one, *columns) for one in found], table, finished, as_json=as_json, missed=missed)


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

    Example: python -m benchmarks dashboard --polls 500
    """
    from benchmarks.dashboard import measure_dashboard

    with show_progress() as progress:
        rows = measure_dashboard(progress, solutions=solutions, polls=polls)
    conclude_rows(rows, as_json=as_json)
