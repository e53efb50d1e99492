"""`brink export`: campaigns as files, and drives as scenarios that other simulators read."""

import asyncio
from datetime import UTC, datetime
from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from brink.api.client import Api
from brink.api.results import fetch_requirements, trace_of
from brink.api.terminal import echo
from brink.cli.database import export as export_campaign
from brink.cli.options import AsJson, CampaignId, Database, Server, print_json, with_api
from brink.extras import install_command
from brink.scenarios.exportable import EXPORTED, MODULES, EgoControl, check_exportable
from brink.search.errors import MissingExtra
from brink.server.api.schemas import CampaignView
from brink.server.errors import InvalidInput
from brink.server.views import SolutionView

CAMPAIGN = "campaign"


class ExportGroup(TyperGroup):
    """The commands of `brink export`; without the name of one, it exports a campaign."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Insert the name of the command that exports a campaign if there is none."""
        if args and args[0] not in (*self.commands, "--help"):
            args = [CAMPAIGN, *args]
        return super().parse_args(ctx, args)


class Format(StrEnum):
    """Format of an exported drive."""

    OPENSCENARIO = "openscenario"


export = typer.Typer(
    cls=ExportGroup,
    help="Write a campaign to a file, or a drive as a scenario. "
    "`brink export ID` is short for `brink export campaign ID`.",
    no_args_is_help=True,
)
export.command(CAMPAIGN)(export_campaign)


@export.command()
def scenario(
    campaign: CampaignId,
    number: Annotated[int, typer.Argument(metavar="NUMBER", min=0, help="Number of the solution.")],
    out: Annotated[Path, typer.Option(help="Folder to write to; created if missing.")],
    format_: Annotated[
        Format, typer.Option("--format", help="OpenSCENARIO XML 1.2 with OpenDRIVE 1.7.")
    ] = Format.OPENSCENARIO,
    ego: Annotated[
        EgoControl,
        typer.Option(help="Let the ego follow its recorded trajectory, or leave it to a controller."),
    ] = EgoControl.RECORDED,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Write a simulated drive as a scenario that other simulators read, with its boxes and verdicts.

    Without --server, this machine runs the episode again; with it, the coordinator's workers do.

    Example: brink export scenario 3f2a 17 --out scenario-17
    """
    if missing := [module for module in MODULES if find_spec(module) is None]:
        raise MissingExtra(
            f"--format {format_} needs {missing[0]}, which is not installed: {install_command('exchange')}"
        )
    if out.exists() and not out.is_dir():
        raise InvalidInput.at("--out", f"{out}: expected a folder, or a name that is still free")
    if out.is_dir() and any(out.iterdir()) and not (out / EXPORTED).is_file():
        raise InvalidInput.at("--out", f"{out}: expected a new or empty folder, or one of an earlier export")
    files = with_api(server, database, lambda api: _export_scenario(api, campaign, number, out, ego, server))
    if as_json:
        print_json([str(path) for path in files])
    else:
        for path in files:
            echo(path)


async def _export_scenario(
    api: Api, campaign: str, number: int, out: Path, ego: EgoControl, server: str | None
) -> list[Path]:
    # Imported here: they need the extra.
    from brink.scenarios.folder import Origin, write_openscenario

    view = await api.read(CampaignView, f"/campaigns/{campaign}")
    solution = await api.read(SolutionView, f"/campaigns/{campaign}/solutions/{number}")
    check_exportable(None if solution.spec is None else str(solution.spec.get("simulator")))
    origin = Origin(
        campaign=view.id,
        name=view.body.name,
        number=number,
        words=solution.words,
        deciding=await fetch_requirements(api, campaign) or (),
        odd=view.body.problem.params.get("odd", {}),
    )
    trace = await trace_of(api, campaign, number, workers=server is not None)
    return await asyncio.to_thread(
        write_openscenario, trace, origin, out, ego=ego, created_at=datetime.now(UTC)
    )
