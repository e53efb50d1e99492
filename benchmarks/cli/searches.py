"""`python -m benchmarks search | finders | mumoea`: the cost of a search, and what methods find."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import RenderableType

from benchmarks.cli.output import Processes, conclude, conclude_rows, show_progress
from brink.cli.options import RESULTS, AsJson, fields
from brink.server.errors import InvalidInput


def search(as_json: AsJson = False) -> None:
    """Measure the time to add 60 new solutions to archives of growing size, and the CPU time of whole searches.

    Example: python -m benchmarks search
    """
    from benchmarks.search import measure_searches, measure_steps

    conclude_rows([*measure_steps(), *measure_searches()], as_json=as_json)


def finders(
    problem: Annotated[
        str, typer.Option(help="Problem: urban-errors, front-gap, lane-keeping, mtq.")
    ] = "urban-errors",
    budget: Annotated[
        int, typer.Option(min=120, help="Simulations of each run, those of the estimation included.")
    ] = 1300,
    seeds: Annotated[int, typer.Option(min=1, max=60, help="Number of searches with each method.")] = 3,
    method: Annotated[
        list[str] | None, typer.Option(help="Compare only this method; may be given several times.")
    ] = None,
    alone: Annotated[
        bool, typer.Option(help="Whether each rival also runs without the estimation of thresholds.")
    ] = True,
    curves: Annotated[
        int,
        typer.Option(min=0, help="Thresholds of edge@2 to drive again, 200 simulations along the unit each."),
    ] = 0,
    processes: Processes = 2,
    out: Annotated[Path, typer.Option(help="Folder for runs and pictures.")] = RESULTS / "bench-finders",
    as_json: AsJson = False,
) -> None:
    """Compare searches at equal budgets: edge@2, and its rivals alone and followed by the estimation of thresholds.

    Both ends of each threshold are simulated with 20 fresh seeds, which the budget does not include. Completed runs
    are kept in the folder, so the same command continues after an interruption.

    Example: python -m benchmarks finders --problem mtq --budget 300 --seeds 2

    Example: python -m benchmarks finders --problem front-gap --budget 600 --method edge@2 --curves 12
    """
    from benchmarks.finder_curves import curves_document, curves_table, draw_curves, driven
    from benchmarks.finders import (
        CASES,
        FINDERS,
        THRESHOLDS,
        Comparison,
        Tally,
        duels,
        runner_of,
        standings,
        table,
    )

    if problem not in CASES:
        raise InvalidInput.at("--problem", f"expected one of {', '.join(CASES)}; got {problem!r}")
    methods = list(dict.fromkeys(method or FINDERS))
    if unknown := [name for name in methods if name not in FINDERS]:
        raise InvalidInput.at("--method", f"expected one of {', '.join(FINDERS)}; got {unknown[0]!r}")
    if curves and THRESHOLDS not in methods:
        raise InvalidInput.at(
            "--curves", f"expected --method {THRESHOLDS} among the methods; its thresholds are driven"
        )
    if curves and runner_of(problem).is_computed:
        raise InvalidInput.at("--curves", f"expected a problem with chance; {problem} has none")
    comparison = Comparison(problem, methods, seeds=seeds, budget=budget, folder=out, alone=alone)
    with show_progress() as progress:
        found = comparison.run(progress, processes=processes)
        tallies = [Tally.of(one) for one in found]
        again = (
            driven([one for one in found if one.task.method == THRESHOLDS], curves, out, progress)
            if curves
            else []
        )
    sentences = duels(tallies, comparison.measure)
    document: dict[str, object] = {
        "standings": standings(tallies),
        "comparison": sentences,
        "runs": [fields(one) for one in tallies],
    }
    shown: list[RenderableType] = [table(problem, tallies), *sentences]
    if curves and not again:
        shown.append(f"{THRESHOLDS} found no threshold to drive again")
    if again:
        picture = out / f"curves-{problem}.png"
        draw_curves(again, f"Thresholds driven again: {problem}", picture)
        document["curves"] = curves_document(again)
        shown += [curves_table(again), f"picture: {picture}"]
    conclude(document, *shown, as_json=as_json)


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
