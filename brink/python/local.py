"""Running a campaign on this machine from Python, with a coordinator and workers of its own."""

import asyncio
import contextlib
from collections.abc import Callable, Mapping
from typing import Final

from brink.api.client import Api, CoordinatorError
from brink.api.earlier import earlier_run
from brink.api.live import earlier_words
from brink.api.terminal import PlainConsole
from brink.python.campaign import CampaignLike, body_of
from brink.python.client import check_finished, settings_of
from brink.python.connection import LocalDatabase, local_workers
from brink.python.display import Display, display_of, in_notebook
from brink.python.result import AsyncResult, Result
from brink.python.synchronous import synchronous
from brink.server.api.schemas import CampaignView, Progress
from brink.server.campaigns.body import CampaignBody
from brink.server.campaigns.plan import check_submission
from brink.server.problems.catalogue import check_extra
from brink.server.runtime.coordinator import WorkerProcesses
from brink.server.states import CampaignStatus

POLL_S: Final = 0.3
_UNFINISHED: Final = (CampaignStatus.RUNNING, CampaignStatus.PAUSED)


async def run_async(
    campaign: CampaignLike,
    *,
    workers: int = 2,
    database: str | None = None,
    resume: bool = True,
    progress: bool = True,
) -> AsyncResult:
    """Run a campaign on this machine to its end, and return its result.

    Ctrl-C, or cancelling the task, pauses it, and nothing is lost: the same call continues it.

    Args:
        campaign: A `Campaign`, the path of a campaign file, or its content.
        workers: Number of worker processes.
        database: URL of the database, or the path of a SQLite file; by default ``BRINK_DATABASE``, else ``brink.db``.
        resume: Whether to continue the latest run of the same campaign, or return its result if it has finished;
            otherwise a new run starts.
        progress: Whether to show the progress.

    Raises:
        InvalidInput: A field is missing, unknown or invalid, or an extra is not installed.
        CampaignUnfinished: The campaign was cancelled, or paused after too many failures.
        DatabaseError: The database is unusable.

    Example:
        >>> import brink
        >>> campaign = brink.Campaign(problem="mtq@1", algorithm="random@1", simulations=60)
        >>> result = brink.run(campaign, progress=False)
        >>> len(result.to_pandas())
        60
    """
    body = body_of(campaign)
    checked, _ = check_submission(body)
    check_extra(checked.plan.problem)
    statuses = (*_UNFINISHED, CampaignStatus.FINISHED) if resume else ()
    return await run_body(body, workers=workers, database=database, statuses=statuses, progress=progress)


run = synchronous(run_async, Result)


async def run_body(
    body: CampaignBody,
    *,
    workers: int,
    database: str | None,
    statuses: tuple[CampaignStatus, ...],
    progress: bool,
    environment: Mapping[str, str] | None = None,
    check: Callable[[Progress], None] = check_finished,
) -> AsyncResult:
    """Run a checked campaign on this machine to its end.

    Args:
        body: The campaign.
        workers: Number of worker processes.
        database: Its database; None for the default one.
        statuses: An earlier run with one of these is continued, or returned if it has finished.
        progress: Whether to show the progress.
        environment: Environment variables for the workers.
        check: Raises `CampaignUnfinished` unless the campaign has finished.

    Raises:
        CampaignUnfinished: The campaign was cancelled, or paused after too many failures.
    """
    settings = settings_of(database, body.llm)
    async with local_workers(settings, workers, environment) as (api, processes):
        campaign, earlier, other = await _start(api, body, statuses)
        try:
            with display_of(progress) as display:
                check(found := await _watch(api, campaign, display, processes))
        except asyncio.CancelledError:
            await asyncio.shield(_pause(api, campaign))
            raise
    note = earlier_words(found) if earlier else other
    result = await AsyncResult.fetch(LocalDatabase(settings), campaign, note)
    if note and progress and not in_notebook():  # a notebook shows the result, which says so itself
        PlainConsole(stderr=True).print(f"{result.name}: {note}", soft_wrap=True)
    return result


async def _start(api: Api, body: CampaignBody, statuses: tuple[CampaignStatus, ...]) -> tuple[str, bool, str]:
    """Return the id of the campaign to watch, an earlier run or a new one, and whether it had finished before.

    The last value says that there is an earlier run with other code of a plug-in, if there is.
    """
    other = ""
    if statuses:
        found, other = await earlier_run(api, body, [body.document_hash()], statuses)
        if found is not None:
            if found.status is CampaignStatus.PAUSED:
                await api.post(f"/campaigns/{found.id}/resume")
            return found.id, found.status is CampaignStatus.FINISHED, ""
    campaign = await api.send(CampaignView, "/campaigns", body.model_dump(mode="json"))
    return campaign.id, False, other


async def _watch(api: Api, campaign: str, display: Display, processes: WorkerProcesses) -> Progress:
    """Show progress while the campaign runs, and replace workers that died."""
    while True:
        params = {"since": display.generations}
        progress = await api.read(Progress, f"/campaigns/{campaign}/progress", params)
        display.show(progress)
        if progress.status is not CampaignStatus.RUNNING:
            return progress
        processes.replace_dead()
        await asyncio.sleep(POLL_S)


async def _pause(api: Api, campaign: str) -> None:
    """Pause a campaign, which takes no workers until it is resumed."""
    with contextlib.suppress(CoordinatorError):
        await api.post(f"/campaigns/{campaign}/pause")
