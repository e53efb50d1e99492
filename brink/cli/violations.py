"""`brink violations`: types of violations, and their names."""

from typing import Annotated

import typer

from brink.api.client import Api
from brink.cli.findings import show_kind
from brink.cli.options import AsJson, CampaignId, Database, Server, print_json, print_line, with_api
from brink.search.analysis.avoidable import Avoidable
from brink.server.errors import InvalidInput
from brink.server.findings.violations.views import Violations, ViolationView
from brink.server.states import SolutionVerdict
from brink.server.views import SolutionView
from brink.sim.verdict import clock_words


def violations(
    campaign: CampaignId,
    number: Annotated[
        int | None,
        typer.Option(min=0, help="Show only this solution; with --name or --unname, the solution to change."),
    ] = None,
    requirement: Annotated[
        str | None,
        typer.Option(
            help="Show only violations of this requirement; with --name or --unname, the violation to change."
        ),
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name the violation; the name becomes its type.")] = None,
    unname: Annotated[
        bool, typer.Option("--unname", help="Remove the name; the rules determine the type again.")
    ] = False,
    avoidable: Annotated[
        Avoidable | None,
        typer.Option(
            help="Show only violations that this driver would have avoided (no: neither would have), and the types "
            "with one."
        ),
    ] = None,
    shown: Annotated[
        int | None, typer.Option(min=1, help="Number of rows, or of violations; without it, all.")
    ] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Show all types of violations that a campaign found, and name violations.

    Example: brink violations 3f2a --number 71 --requirement no-collision@1 --name "overtakes into oncoming traffic"
    """
    if (name is not None or unname) and number is None:
        raise InvalidInput.at(
            "--number", "expected the number of the solution whose violation is to be named or unnamed"
        )
    if name is not None and unname:
        raise InvalidInput.at("--unname", "expected only one of --name and --unname, got both")

    async def work(api: Api) -> Violations | None:
        if number is not None and (name is not None or unname):
            await _name(api, campaign, number, requirement, name)
        if number is None and requirement is None and not as_json:
            settings = {} if avoidable is None else {"avoidable": avoidable.value}
            rows = {} if shown is None else {"rows": shown}
            await show_kind(
                api, campaign, "violations", {**settings, **rows}, more="without --shown, all of them"
            )
            return None
        found = await api.read(Violations, f"/campaigns/{campaign}/violations")
        selected = await _selected(api, campaign, found, number, requirement)
        if avoidable is not None:
            params = {"avoidable": avoidable.value, "types_only": True}
            found = await api.read(Violations, f"/campaigns/{campaign}/violations", params)
        return found.model_copy(
            update={"violations": [one for one in selected if avoidable in (None, one.avoidable)]}
        )

    found = with_api(server, database, work)
    if found is None:
        return
    if as_json:
        print_json(found.model_dump(mode="json"))
    else:
        for one in found.violations[:shown]:
            by = "" if one.avoidable is None else f"; {one.avoidable.words}"
            how = "" if one.avoided_by is None else f", who avoids it by {one.avoided_by}"
            print_line(f"{one.number} at {clock_words(one.time_s)}, {one.requirement}: {one.type}{by}{how}")
        more = len(found.violations) - len(found.violations[:shown])
        if more or not found.violations:
            print_line(f"… and {more:,} more" if more else "none of these violations")


async def _selected(
    api: Api, campaign: str, found: Violations, number: int | None, requirement: str | None
) -> list[ViolationView]:
    """Return the violations of a solution, of a requirement, or of both.

    Raises:
        InvalidInput: There are none.
        Missing: There is no such solution.
    """
    of_number = [one for one in found.violations if number in (None, one.number)]
    if not of_number and number is not None:
        solution = await api.read(SolutionView, f"/campaigns/{campaign}/solutions/{number}")
        safe = solution.verdict is SolutionVerdict.SAFE
        raise InvalidInput.at(
            "--number", f"solution {number} {'violates nothing' if safe else f'is {solution.verdict}'}"
        )
    chosen = [one for one in of_number if requirement in (None, one.requirement)]
    if not chosen and requirement is not None:
        violated = ", ".join(sorted({one.requirement for one in of_number}))
        raise InvalidInput.at(
            "--requirement",
            f"expected one of {violated or 'none, as nothing was violated'}; got {requirement!r}",
        )
    return chosen


async def _name(api: Api, campaign: str, number: int, requirement: str | None, name: str | None) -> None:
    """Name a violation; None removes the name."""
    if requirement is None:
        found = await api.read(Violations, f"/campaigns/{campaign}/violations")
        violated = [one.requirement for one in await _selected(api, campaign, found, number, None)]
        if len(violated) != 1:
            raise InvalidInput.at("--requirement", f"expected one of {', '.join(violated)}")
        requirement = violated[0]
    path = f"/campaigns/{campaign}/violations/{number}/{requirement}/name"
    if name is None:
        await api.request("DELETE", path)
    else:
        await api.request("PUT", path, json={"name": name})
