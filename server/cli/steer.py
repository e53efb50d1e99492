"""Commands that steer campaigns: pause, resume, cancel, delete, retry."""

from typing import Annotated, Any

import typer

from server.cli.api import Api, CoordinatorSaid
from server.cli.options import (
    CampaignId,
    Database,
    Server,
    brink,
    console,
    database_option,
    settings_with,
    with_api,
)

PAGE = 1000
"""Jobs that are asked for at a time."""


def pause(campaign: CampaignId, database: Database = None, server: Server = None) -> None:
    """Hand out no more jobs of a campaign; what is running is still taken in.

    Example: brink pause 3f2a --server http://coordinator:8700
    """
    found = _change(campaign, "pause", database, server)
    elsewhere = f" --server {server}" if server else database_option(settings_with(database=database))
    _say(f"campaign {found['id']} is paused; go on with: {brink()} resume {found['id']}{elsewhere}")


def resume(campaign: CampaignId, database: Database = None, server: Server = None) -> None:
    """Go on with a paused campaign, without the candidates that failed so far.

    Example: brink resume 3f2a --server http://coordinator:8700
    """
    found = _change(campaign, "resume", database, server)
    _say(f"campaign {found['id']} is {found['status']}: a coordinator with workers goes on with it")


def cancel(campaign: CampaignId, database: Database = None, server: Server = None) -> None:
    """End a campaign for good; what it found stays.

    Example: brink cancel 3f2a --server http://coordinator:8700
    """
    found = _change(campaign, "cancel", database, server)
    _say(f"campaign {found['id']} is cancelled; what it found stays")


def delete(
    campaign: CampaignId,
    sure: Annotated[bool, typer.Option("--yes", help="Do not ask.")] = False,
    database: Database = None,
    server: Server = None,
) -> None:
    """Delete a campaign that has ended, with everything that belongs to it.

    Example: brink delete 3f2a --yes
    """

    async def look(api: Api) -> dict[str, Any]:
        found: dict[str, Any] = await api.get(f"/campaigns/{campaign}/progress")
        return found

    found = with_api(server, database, look)
    what = f"campaign {found['id']} ({found['name']}) with {found['simulations']} simulations"
    if not sure:
        typer.confirm(f"delete {what}? Nothing brings it back", abort=True)
    with_api(server, database, lambda api: api.request("DELETE", f"/campaigns/{found['id']}"))
    _say(f"{what} is deleted")


def retry(campaign: CampaignId, database: Database = None, server: Server = None) -> None:
    """Put the jobs of a campaign that are in quarantine back into the queue, with new attempts.

    Those of earlier generations stay there: the search went on without them.

    Example: brink retry 3f2a
    """

    async def work(api: Api) -> tuple[int, str]:
        found = await api.get(f"/campaigns/{campaign}/progress")
        back, stay, reason = 0, 0, ""
        wanted = {"campaign": found["id"], "status": "quarantined", "limit": PAGE, "after": 0}
        while jobs := (await api.get("/jobs", wanted))["jobs"]:
            for job in jobs:
                try:
                    await api.post(f"/jobs/{job['id']}/retry")
                    back += 1
                except CoordinatorSaid as error:
                    stay, reason = stay + 1, str(error)
            wanted["after"] = jobs[-1]["id"]
        return back, f"; {stay} stay in quarantine: {reason}" if stay else ""

    back, rest = with_api(server, database, work)
    _say(f"{back} jobs are in the queue again{rest}")


def _change(campaign: str, verb: str, database: str | None, server: str | None) -> dict[str, Any]:
    async def work(api: Api) -> dict[str, Any]:
        found: dict[str, Any] = await api.post(f"/campaigns/{campaign}/{verb}")
        return found

    return with_api(server, database, work)


def _say(words: str) -> None:
    console().print(words, soft_wrap=True, markup=False)
