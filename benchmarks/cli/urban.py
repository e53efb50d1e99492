"""The urban problem and what an episode costs: `difficulty`, `drivers`, `driving`, `command`, `control`, `sim`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from benchmarks.cli.output import (
    Processes,
    conclude,
    conclude_rows,
    met_text,
    rows_table,
    show_progress,
    value_table,
)
from brink.api.live import Steps
from brink.cli.options import AsJson, console, fields
from brink.server.campaigns.body import read_campaign_file
from brink.server.errors import InvalidInput


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

    Example: python -m benchmarks difficulty --candidates 2000
    """
    from benchmarks.urban import Sizes, measure_difficulty

    full = Sizes()
    sizes = Sizes(
        candidates=candidates,
        **{
            name: max(20, round(share * getattr(full, name)))
            for name in ("scenarios", "reruns", "pairs", "redraws", "ends")
        },
    )
    with show_progress() as progress:
        rows = list(measure_difficulty(sizes, seed=seed, processes=processes, progress=progress))
    conclude_rows(rows, as_json=as_json)


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

    Example: python -m benchmarks drivers --candidates 50 --weather clear
    """
    from benchmarks.drivers import measure_drivers
    from brink.sim.world.scenario import Weather

    weathers = weather or [Weather.CLEAR.value, Weather.SOFT_RAIN.value, Weather.HARD_RAIN.value]
    known = [one.value for one in Weather]
    if unknown := [name for name in weathers if name not in known]:
        raise InvalidInput.at("--weather", f"expected one of {', '.join(known)}; got {unknown[0]!r}")
    with show_progress() as progress:
        rows = measure_drivers(
            candidates=candidates, weathers=weathers, seed=seed, processes=processes, progress=progress
        )
    conclude_rows(rows, as_json=as_json)


def driving(
    drives: Annotated[int, typer.Option(min=1, help="Drives by each driving system.")] = 40,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    as_json: AsJson = False,
) -> None:
    """Measure what it costs that a driving system is a process of its own, in C++ or Python. Needs cmake.

    Example: python -m benchmarks driving --drives 40
    """
    from benchmarks.driving import measure_driving

    with show_progress() as progress:
        rows = measure_driving(drives=drives, seed=seed, progress=progress)
    conclude_rows(rows, as_json=as_json)


def command(
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of each program in one process.")] = 200,
    simulations: Annotated[int, typer.Option(min=20, help="Simulations of each campaign.")] = 600,
    as_json: AsJson = False,
) -> None:
    """Measure what command@1 adds to a program of 20 ms and one of 2 ms. Needs a C++ compiler.

    Example: python -m benchmarks command --simulations 600
    """
    from benchmarks.command import measure_command

    with show_progress() as progress:
        rows = measure_command(episodes=episodes, simulations=simulations, progress=progress)
    conclude_rows(rows, as_json=as_json)


def control(
    simulations: Annotated[int, typer.Option(min=100, help="Simulations per campaign.")] = 1300,
    seeds: Annotated[int, typer.Option(min=1, help="Number of campaigns of each algorithm.")] = 2,
    behaviour: Annotated[int, typer.Option(min=0, help="Seed of the fixed behaviour.")] = 3,
    processes: Processes = 2,
    as_json: AsJson = False,
) -> None:
    """Calibrate the control on campaigns in which the behaviour has no effect.

    All candidates have the same behaviour, so the control should reach the same figures as the real verdicts.

    Example: python -m benchmarks control --seeds 2
    """
    from benchmarks.control import T_BS, calibrate

    with show_progress() as progress:
        found = list(
            calibrate(
                progress,
                simulations=simulations,
                seeds=range(1, seeds + 1),
                behaviour=behaviour,
                processes=processes,
            )
        )
    table = value_table(
        ("algorithm", "seed", "unsafe", "evaluations per scenario", "DBS of", *(f"t_b {t:g}" for t in T_BS)),
        (
            (
                one.algorithm,
                one.seed,
                f"{one.unsafe_share:.0%}",
                f"{one.repeats:.1f}",
                name,
                *(f"{dbs:.4g}" for dbs in values),
            )
            for one in found
            for name, values in (("real verdicts", one.real), ("control", one.control))
        ),
    )
    conclude([{**fields(one), "t_b": T_BS} for one in found], table, as_json=as_json)


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

    Example: python -m benchmarks sim --campaign examples/sumo.yaml
    """
    from benchmarks.service import TARGET_SHARE, URBAN, measure_service
    from benchmarks.urban import measure_costs

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
    costs = rows_table(kinds)
    service = value_table(
        (
            "algorithm",
            "workers",
            "service /s",
            "bare /s",
            "share",
            "target",
            "",
            "coordinator",
            "worker",
            "episode",
            "bare episode",
        ),
        (
            (
                rate.algorithm,
                rate.workers,
                f"{rate.service_per_s:.1f}",
                f"{rate.bare_per_s:.1f}",
                f"{rate.share:.1%}",
                f"at least {TARGET_SHARE:.0%}",
                met_text(rate.share >= TARGET_SHARE),
                f"{rate.coordinator_ms:.2f}",
                f"{rate.worker_ms:.2f}",
                f"{rate.episode_ms:.1f}",
                f"{rate.bare_ms:.1f}",
            )
            for rate in rates
        ),
    )
    note = Text(
        "CPU time in ms per episode. The rest of the difference is waiting for the last episodes of a generation"
        " and for the next one. Random search proposes all episodes at once, MLCSHE proposes generations.",
        "dim",
    )
    document = {"episodes": [fields(kind) for kind in kinds], "service": [fields(rate) for rate in rates]}
    conclude(document, *([costs] if kinds else []), service, note, as_json=as_json)
