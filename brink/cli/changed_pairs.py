"""`brink pairs ID --confirm R --set NAME=VALUE`: simulates pairs with one thing changed."""

from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from rich.console import Console

from brink.api.changed_pairs import changed_campaign, changed_shares, changed_table, changed_words
from brink.api.client import Api
from brink.api.follow_ups import OPEN
from brink.api.results import fetch_archive
from brink.api.runs import CampaignRun, resume_or_submit
from brink.cli.findings import print_table
from brink.cli.local import CommandSession, check_extra_of, run_locally, stopping
from brink.cli.options import print_json, settings_with, with_api
from brink.server.api.schemas import Progress
from brink.server.campaigns.plan import make_plan
from brink.server.errors import Conflict
from brink.server.findings.pairs.views import PairsView
from brink.server.states import CampaignStatus

ReadPairs = Callable[[Api], Awaitable[PairsView]]


class ChangedPairs:
    """The pairs of a campaign, simulated with other values of parameters of the problem.

    Args:
        campaign: The campaign.
        read_pairs: Returns the pairs.
        changes: The new values.
        repeats: Most simulations of each side.
        screen: Where progress and results are printed.
    """

    def __init__(
        self, campaign: str, read_pairs: ReadPairs, changes: Mapping[str, Any], repeats: int, screen: Console
    ) -> None:
        self._campaign = campaign
        self._read_pairs = read_pairs
        self._changes = changes
        self._repeats = repeats
        self._screen = screen

    def run(self, workers: int, database: str | None, server: str | None, *, as_json: bool) -> bool:
        """Simulate them and print what became of each; return whether all simulations have ended."""
        if server is not None:
            return with_api(server, database, lambda api: self._show(api, as_json=as_json))

        async def work(session: CommandSession) -> bool:
            name, *_, run = await self._found(session.api)
            make_plan(run.body).problem.install()
            progress = await session.api.read(Progress, f"/campaigns/{name}/progress")
            if progress.status in OPEN:
                await check_extra_of(session.api, name)
                async with stopping(session.stop):
                    session.processes.start(workers)
                    await session.follow_campaign(name)
            return await self._show(session.api, as_json=as_json)

        return run_locally(settings_with(database=database, port=0), self._screen, work)

    async def _found(self, api: Api) -> tuple[str, PairsView, tuple[int, ...], CampaignRun]:
        """Return the campaign that simulates the pairs, submitted or resumed: its id, pairs, sides and run."""
        view = await self._read_pairs(api)
        if not view.pairs:
            raise Conflict(f"campaign {self._campaign} has no pair to simulate again")
        fetched = await fetch_archive(api, self._campaign)
        body, numbers = changed_campaign(fetched, view.pairs, self._changes, self._repeats)
        run = CampaignRun(body, pictures=False)
        found = await run.latest(api, [*OPEN, CampaignStatus.FINISHED, CampaignStatus.FAILED])
        name, _ = await resume_or_submit(run, api, found)
        return name, view, numbers, run

    async def _show(self, api: Api, *, as_json: bool) -> bool:
        """Print what became of each pair; return whether all simulations have ended."""
        name, view, numbers, run = await self._found(api)
        progress = await api.read(Progress, f"/campaigns/{name}/progress")
        archive = (await fetch_archive(api, name)).archive
        is_over = progress.status not in OPEN
        judged = dict(zip(archive.numbers.tolist(), archive.unsafe.tolist(), strict=True))
        known = progress.simulations if is_over else max(judged, default=-1) + 1
        shares = changed_shares(run.body, numbers, {**dict.fromkeys(range(known)), **judged})
        table, words = changed_table(view.pairs, shares), changed_words(view.pairs, shares)
        if as_json:
            print_json(
                {"campaign": name, "status": progress.status, "words": words, "pairs": table.records()}
            )
        else:
            print_table(self._screen, table)
            self._screen.print(f"{words}.", soft_wrap=True)
            state = "simulated them" if is_over else "is simulating them; the same command shows its progress"
            self._screen.print(f"campaign {name} {state}", soft_wrap=True)
        return progress.status is CampaignStatus.FINISHED
