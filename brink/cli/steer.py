"""Commands that steer campaigns: pause, resume, cancel, delete, retry."""

from brink.api.client import Api, CoordinatorSaid
from brink.cli.options import (
    CampaignId,
    Database,
    Server,
    Sure,
    brink,
    change,
    database_option,
    delete_after_asking,
    look_at,
    say,
    settings_with,
    with_api,
)

PAGE = 1000
"""Jobs that are asked for at a time."""


def pause(campaign: CampaignId, database: Database = None, server: Server = None) -> None:
    """Hand out no more jobs of a campaign; what is running is still taken in.

    Example: brink pause 3f2a --server http://coordinator:8700
    """
    found = change(f"/campaigns/{campaign}", "pause", server, database)
    elsewhere = f" --server {server}" if server else database_option(settings_with(database=database))
    say(f"campaign {found['id']} is paused; go on with: {brink()} resume {found['id']}{elsewhere}")


def resume(campaign: CampaignId, database: Database = None, server: Server = None) -> None:
    """Go on with a paused campaign, without the candidates that failed so far.

    Example: brink resume 3f2a --server http://coordinator:8700
    """
    found = change(f"/campaigns/{campaign}", "resume", server, database)
    say(f"campaign {found['id']} is {found['status']}: a coordinator with workers goes on with it")


def cancel(campaign: CampaignId, database: Database = None, server: Server = None) -> None:
    """End a campaign for good; what it found stays.

    Example: brink cancel 3f2a --server http://coordinator:8700
    """
    found = change(f"/campaigns/{campaign}", "cancel", server, database)
    say(f"campaign {found['id']} is cancelled; what it found stays")


def delete(
    campaign: CampaignId,
    sure: Sure = False,
    database: Database = None,
    server: Server = None,
) -> None:
    """Delete a campaign that has ended, with everything that belongs to it.

    Example: brink delete 3f2a --yes
    """
    found = look_at(f"/campaigns/{campaign}/progress", server, database)
    what = f"campaign {found['id']} ({found['name']}) with {found['simulations']} simulations"
    delete_after_asking(f"/campaigns/{found['id']}", what, sure=sure, server=server, database=database)


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
    say(f"{back} jobs are in the queue again{rest}")
