"""`python -m benchmarks search | paper | mumoea`: the cost of a search, and what its methods find."""

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import httpx
import typer

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
from brink.cli.options import RESULTS, AsJson, console
from brink.search.analysis.comparison import Row as ComparisonRow
from brink.server.api.schemas import CampaignView
from brink.server.api.schemas import Progress as CampaignProgress
from brink.server.campaigns.body import CampaignBody, read_campaign_file
from brink.server.errors import InvalidInput

if TYPE_CHECKING:
    pass

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
