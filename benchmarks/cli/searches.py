"""`python -m benchmarks search | finders | mumoea`: the cost of a search, and what methods find."""

from pathlib import Path
from typing import Annotated

import typer

from benchmarks.cli.output import Processes, conclude, conclude_rows, show_progress
from brink.cli.options import RESULTS, AsJson, Database, Workers, console, fields
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
    budget: Annotated[int, typer.Option(min=120, help="Simulations of each search, checks included.")] = 1300,
    seeds: Annotated[int, typer.Option(min=1, max=60, help="Number of searches with each method.")] = 3,
    method: Annotated[
        list[str] | None, typer.Option(help="Compare only this method; may be given several times.")
    ] = None,
    workers: Workers = 2,
    database: Database = None,
    new: Annotated[bool, typer.Option("--new", help="Start anew even if there is an earlier run.")] = False,
    out: Annotated[Path, typer.Option(help="Folder for the experiment file.")] = RESULTS / "bench-finders",
    as_json: AsJson = False,
) -> None:
    """Compare the searches for pairs at equal budgets: edge@1, its rivals, and the baselines.

    Their pairs are confirmed with fresh seeds, up to 30 simulations a side, which the budget does not include. The
    same command continues after an interruption.

    Example: python -m benchmarks finders --problem mtq --budget 300 --seeds 2
    """
    from benchmarks.finders import CASES, FINDERS, experiment, run_finders, standings, table

    if problem not in CASES:
        raise InvalidInput.at("--problem", f"expected one of {', '.join(CASES)}; got {problem!r}")
    methods = list(dict.fromkeys(method or FINDERS))
    if unknown := [name for name in methods if name not in FINDERS]:
        raise InvalidInput.at("--method", f"expected one of {', '.join(FINDERS)}; got {unknown[0]!r}")
    body = experiment(problem, simulations=budget, seeds=seeds, methods=methods)
    screen = console(stderr=as_json)
    tallies = run_finders(body, screen, workers=workers, database=database, out=out, new=new)
    if tallies is None:
        raise typer.Exit(1)
    document = {"standings": standings(tallies), "campaigns": [fields(one) for one in tallies]}
    conclude(document, table(problem, tallies), as_json=as_json)


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
