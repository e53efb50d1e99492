"""`python -m benchmarks search | mumoea`: the cost of a search, and what its methods find."""

from pathlib import Path
from typing import Annotated

import typer

from benchmarks.cli.output import Processes, conclude_rows, show_progress
from brink.cli.options import RESULTS, AsJson
from brink.server.errors import InvalidInput


def search(as_json: AsJson = False) -> None:
    """Measure one generation step: the time to add 60 new solutions to archives of growing size.

    Example: python -m benchmarks search
    """
    from benchmarks.search import measure_steps

    conclude_rows(measure_steps(), as_json=as_json)


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
