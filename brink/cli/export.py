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
from brink.api.terminal import echo
from brink.cli.database import export as export_campaign
from brink.cli.options import AsJson, CampaignId, Database, Server, print_json, with_api
from brink.extras import install_command
from brink.scenarios.exportable import EXPORTED, MODULES, EgoControl, check_exportable
from brink.search.errors import MissingExtra
from brink.server.api.schemas import CampaignView
from brink.server.errors import InvalidInput
from brink.server.findings.pairs.views import MOST_PAIRS
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
    numbers: Annotated[
        list[int] | None,
        typer.Argument(metavar="[NUMBER]...", min=0, show_default=False, help="Numbers of solutions."),
    ] = None,
    pair: Annotated[
        int | None,
        typer.Option(metavar="PLACE", min=1, help="Both sides of a pair, as `brink pairs` numbers it."),
    ] = None,
    *,
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
    """Write simulated drives as scenarios that other simulators read, with their verdicts.

    Drives of command@1 are the files that its program read. Other drives are run again: by this machine or, with
    --server, by the coordinator's workers. Several solutions have a folder each.

    Example: brink export scenario 3f2a 17 --out scenario-17
    """
    from brink.cli.pair_pictures import chosen_pair
    from brink.cli.pairs import fetch_pairs

    if (pair is None) == (not numbers):
        raise InvalidInput.at("NUMBER", "expected numbers of solutions, or --pair")
    if out.exists() and not out.is_dir():
        raise InvalidInput.at("--out", f"{out}: expected a folder, or a name that is still free")
    if out.is_dir() and any(out.iterdir()) and not _is_export(out):
        raise InvalidInput.at("--out", f"{out}: expected a new or empty folder, or one of an earlier export")

    async def write(api: Api) -> list[Path]:
        chosen = [(number, str(number)) for number in dict.fromkeys(numbers or ())]
        if pair is not None:
            found = chosen_pair(await fetch_pairs(api, campaign, limit=MOST_PAIRS), pair, "--pair")
            sides = {"safe": found.safe, "unsafe": found.unsafe}
            chosen = [(side.number, f"{verdict}-{side.number}") for verdict, side in sides.items()]
        if len(chosen) == 1:
            chosen = [(chosen[0][0], "")]
        return await _export_scenarios(api, campaign, chosen, out, ego, format_, server)

    files = with_api(server, database, write)
    if as_json:
        print_json([str(path) for path in files])
    else:
        for path in files:
            echo(path)


def _is_export(folder: Path) -> bool:
    """Return whether a folder is that of an earlier export, of one solution or of several."""
    return any((one / name).is_file() for one in (folder, *folder.iterdir()) for name in EXPORTED)


async def _export_scenarios(
    api: Api,
    campaign: str,
    chosen: list[tuple[int, str]],
    out: Path,
    ego: EgoControl,
    format_: Format,
    server: str | None,
) -> list[Path]:
    """Write solutions, each given by its number and its folder; return the files."""
    from brink.scenarios.logical.folder import Exported, write_solutions
    from brink.server.problems.command import Command

    view = await api.read(CampaignView, f"/campaigns/{campaign}")
    solutions = [
        (await api.read(SolutionView, f"/campaigns/{campaign}/solutions/{number}"), folder)
        for number, folder in chosen
    ]
    if view.body.problem.id == Command.id:
        return await asyncio.to_thread(
            write_solutions,
            view.body.problem.params,
            [Exported(solution=solution, folder=folder) for solution, folder in solutions],
            out,
            campaign=view.id,
            name=view.body.name,
            created_at=datetime.now(UTC),
        )
    for solution, _ in solutions:
        check_exportable(None if solution.spec is None else str(solution.spec.get("simulator")))
    if missing := [module for module in MODULES if find_spec(module) is None]:
        raise MissingExtra(
            f"--format {format_} needs {missing[0]}, which is not installed: {install_command('exchange')}"
        )
    files = []
    for solution, folder in solutions:
        files += await _export_drive(api, view, solution, out / folder, ego, server)
    return files


async def _export_drive(
    api: Api, view: CampaignView, solution: SolutionView, out: Path, ego: EgoControl, server: str | None
) -> list[Path]:
    # Imported here: they need the extra.
    from brink.api.results import fetch_requirements, trace_of
    from brink.scenarios.folder import Origin, write_openscenario

    origin = Origin(
        campaign=view.id,
        name=view.body.name,
        number=solution.number,
        words=solution.words,
        deciding=await fetch_requirements(api, view.id) or (),
        odd=view.body.problem.params.get("odd", {}),
    )
    trace = await trace_of(api, view.id, solution.number, workers=server is not None)
    return await asyncio.to_thread(
        write_openscenario, trace, origin, out, ego=ego, created_at=datetime.now(UTC)
    )
