"""Submitting a campaign, and following it to its end."""

import asyncio
from typing import Annotated

import typer

from brink.api.client import Api
from brink.cli.live import CampaignDisplay
from brink.cli.options import AsJson, CampaignFile, brink, console, print_json, with_api
from brink.server.campaigns.body import read_campaign_file

WATCH_S = 0.5


def submit(
    file: CampaignFile,
    server: Annotated[
        str, typer.Option("--server", envvar="BRINK_SERVER", help="URL of the coordinator.")
    ] = "http://127.0.0.1:8700",
    watch: Annotated[bool, typer.Option("--watch", help="Show progress until the campaign ends.")] = False,
    key: Annotated[
        str | None, typer.Option(help="Idempotency key: the same key again submits nothing new.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Submit a campaign to a coordinator.

    Example: brink submit examples/paper-mlcshe.yaml --server http://coordinator:8700 --watch
    """
    body = read_campaign_file(file)

    async def work(api: Api) -> bool:
        headers = {"Idempotency-Key": key} if key else {}
        response = await api.request("POST", "/campaigns", json=body.model_dump(mode="json"), headers=headers)
        campaign = response.json()
        if as_json and not watch:
            print_json(campaign)
        elif not as_json:
            known = "" if response.status_code == 201 else " (submitted before with this key)"
            console().print(f"campaign {campaign['id']}{known}")
            if not watch:
                hint = f"see how it goes with: {brink()} status {campaign['id']} --server {server}"
                console().print(hint, soft_wrap=True)
        return await follow(api, campaign["id"], as_json=as_json) if watch else True

    if not with_api(server, None, work):
        raise typer.Exit(1)


async def follow(api: Api, campaign_id: str, *, as_json: bool, quiet: bool = False) -> bool:
    """Show progress until a campaign ends; return whether it finished."""
    screen = console()
    with CampaignDisplay(screen) as display:
        while True:
            progress = await api.get(f"/campaigns/{campaign_id}/progress", {"since": display.generations})
            if not (as_json or quiet):
                display.show(progress)
            if progress["status"] != "running":
                break
            await asyncio.sleep(WATCH_S)
    if as_json:
        print_json(progress)
    elif not quiet:
        screen.print(
            f"campaign {campaign_id} is {progress['status']}: {progress['simulations']} simulations, "
            f"{progress['unsafe']} unsafe {progress['status_reason']}"
        )
        screen.print(f"archive sha256 {progress['digest']}")
    return bool(progress["status"] == "finished")
