"""Running a campaign on this machine from Python, with a coordinator and workers of its own."""

from collections.abc import Callable, Mapping, Sequence

from brink.api.follow_ups import OPEN
from brink.api.live import earlier_words
from brink.api.runs import CampaignRun, resume_or_submit
from brink.api.terminal import PlainConsole
from brink.python.campaign import CampaignLike, body_of
from brink.python.client import settings_of
from brink.python.connection import Connection, with_workers
from brink.python.display import display_of, in_notebook
from brink.python.result import AsyncResult, Result, check_finished
from brink.python.synchronous import synchronous
from brink.server.api.schemas import Progress
from brink.server.campaigns.body import CampaignBody
from brink.server.campaigns.plan import check_submission
from brink.server.problems.catalogue import check_extra
from brink.server.states import CampaignStatus


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
    checked.plan.problem.install()
    statuses = (*OPEN, CampaignStatus.FINISHED) if resume else ()
    return await run_body(body, workers=workers, database=database, statuses=statuses, progress=progress)


run = synchronous(run_async, Result)


async def run_body(
    body: CampaignBody,
    *,
    workers: int,
    database: str | None,
    statuses: Sequence[CampaignStatus],
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
    connection = Connection.local(settings_of(database, body.llm))
    work = CampaignRun(body)
    async with with_workers(connection, workers, environment) as session:
        found = await work.latest(session.api, statuses) if statuses else None
        campaign, _ = await resume_or_submit(work, session.api, found)
        with display_of(progress) as display:
            check(ended := await session.follow(campaign, display, [f"/campaigns/{campaign}"]))
    is_earlier = found is not None and found.status is CampaignStatus.FINISHED
    note = earlier_words(ended) if is_earlier else work.note
    result = await AsyncResult.fetch(connection, campaign, note)
    if note and progress and not in_notebook():  # a notebook shows the result, which says so itself
        PlainConsole(stderr=True).print(f"{result.name}: {note}", soft_wrap=True)
    return result
