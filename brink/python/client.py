"""Campaigns of a coordinator, or of a database on this machine: submitting, watching and fetching them.

`AsyncClient` does the work; `Client` is its synchronous form.
"""

import math
import os
import time
from typing import Final

from brink.api.following import follow
from brink.python.campaign import CampaignLike, body_of
from brink.python.connection import Connection
from brink.python.display import display_of
from brink.python.result import AsyncResult, Result, check_finished
from brink.python.synchronous import Synchronous, synchronous_method
from brink.server.api.schemas import CampaignList, CampaignView, Progress
from brink.server.seeding import SeederSettings
from brink.server.settings import Settings

_PAGE: Final = 200


class AsyncSubmitted:
    """A campaign of a coordinator: the methods of `Submitted`, with ``await``."""

    def __init__(self, connection: Connection, campaign: str, name: str) -> None:
        self._connection = connection
        self.id = campaign
        self.name = name

    def __repr__(self) -> str:
        return f"<campaign {self.id}, {self.name}>"

    async def progress(self) -> Progress:
        """Return its progress: counts, rates, status.

        Raises:
            CoordinatorError: Nobody answers, or the campaign was deleted.
        """
        async with self._connection.open() as api:
            return await api.read(Progress, f"/campaigns/{self.id}/progress")

    async def wait(self, *, timeout_s: float | None = None, progress: bool = True) -> AsyncResult:
        """Wait until it has finished, and return its result. Ctrl-C stops the waiting, not the campaign.

        Args:
            timeout_s: How long to wait; None waits for ever.
            progress: Whether to show the progress.

        Raises:
            CampaignUnfinished: It was cancelled, or paused.
            TimeoutError: It still runs after that time.
        """
        deadline = math.inf if timeout_s is None else time.monotonic() + timeout_s

        def check(found: Progress) -> None:
            if time.monotonic() >= deadline:
                raise TimeoutError(
                    f"campaign {self.id} still runs after {timeout_s:g} s: {found.simulations:,} of "
                    f"{found.budget:,} simulations, {found.workers or 'no'} workers"
                )

        async with self._connection.open() as api:
            with display_of(progress) as display:
                check_finished(await follow(api, self.id, display, check=check))
        return await self.result()

    async def result(self) -> AsyncResult:
        """Return its results so far."""
        return await AsyncResult.fetch(self._connection, self.id)

    async def pause(self) -> None:
        """Pause it: no further simulation begins."""
        await self._post("pause")

    async def resume(self) -> None:
        """Resume it."""
        await self._post("resume")

    async def cancel(self) -> None:
        """Cancel it. Its results so far are kept."""
        await self._post("cancel")

    async def _post(self, action: str) -> None:
        async with self._connection.open() as api:
            await api.post(f"/campaigns/{self.id}/{action}")


class AsyncClient:
    """The campaigns of a coordinator or a database: the methods of `Client`, with ``await``."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def __repr__(self) -> str:
        return f"<campaigns of {self._connection.where}>"

    async def submit(self, campaign: CampaignLike) -> AsyncSubmitted:
        """Submit a campaign, and return it. Workers elsewhere simulate it; `brink.run` does so here.

        Args:
            campaign: The campaign, its file, or the content of its file.

        Raises:
            InvalidInput: A field is missing, unknown or invalid.
            CoordinatorError: The coordinator rejects it, or nobody answers.
        """
        body = body_of(campaign)
        async with self._connection.open() as api:
            view = await api.send(CampaignView, "/campaigns", body.model_dump(mode="json"))
        return AsyncSubmitted(self._connection, view.id, view.name)

    async def campaign(self, campaign: str) -> AsyncSubmitted:
        """Return a campaign by its id, or a unique prefix of it.

        Raises:
            CoordinatorError: There is none.
        """
        async with self._connection.open() as api:
            view = await api.read(CampaignView, f"/campaigns/{campaign}")
        return AsyncSubmitted(self._connection, view.id, view.name)

    async def campaigns(self, status: str | None = None) -> list[AsyncSubmitted]:
        """Return all campaigns, newest first.

        Args:
            status: ``running``, ``paused``, ``finished``, ``cancelled`` or ``failed``; None for all.
        """
        params: dict[str, str | int] = {"limit": _PAGE} | ({} if status is None else {"status": status})
        async with self._connection.open() as api:
            return [
                AsyncSubmitted(self._connection, view.id, view.name)
                async for page in api.pages(CampaignList, "/campaigns", params)
                for view in page.campaigns
            ]


class Submitted(Synchronous[AsyncSubmitted]):
    """A campaign of a coordinator. `AsyncSubmitted` has the same methods with ``await``."""

    @property
    def id(self) -> str:
        """Its id."""
        return self._async.id

    @property
    def name(self) -> str:
        """Its name."""
        return self._async.name

    progress = synchronous_method(AsyncSubmitted.progress)
    wait = synchronous_method(AsyncSubmitted.wait, Result)
    result = synchronous_method(AsyncSubmitted.result, Result)
    pause = synchronous_method(AsyncSubmitted.pause)
    resume = synchronous_method(AsyncSubmitted.resume)
    cancel = synchronous_method(AsyncSubmitted.cancel)


def _each(campaigns: list[AsyncSubmitted]) -> list[Submitted]:
    return [Submitted(campaign) for campaign in campaigns]


class Client(Synchronous[AsyncClient]):
    """The campaigns of a coordinator, or of a database on this machine.

    `AsyncClient` has the same methods with ``await``.
    """

    submit = synchronous_method(AsyncClient.submit, Submitted)
    campaign = synchronous_method(AsyncClient.campaign, Submitted)
    campaigns = synchronous_method(AsyncClient.campaigns, _each)


def connect_async(
    url: str | None = None, token: str | None = None, *, database: str | None = None
) -> AsyncClient:
    """Return the campaigns of a coordinator or a database, for asynchronous code; see `connect`."""
    return AsyncClient(_connection(url, token, database))


def connect(url: str | None = None, token: str | None = None, *, database: str | None = None) -> Client:
    """Return the campaigns of a coordinator, or of a database on this machine.

    Args:
        url: Address of the coordinator, such as ``http://127.0.0.1:8700``; by default that in ``BRINK_SERVER``, and
            without one the database.
        token: Its token; by default that in ``BRINK_TOKEN``.
        database: URL of a database to open instead; by default that in ``BRINK_DATABASE``, else ``./brink.db``.

    Example:
        >>> import brink
        >>> campaign = brink.Campaign(problem="onemax@1", algorithm="random@1", simulations=60, name="bits")
        >>> brink.run(campaign, progress=False, database="bits.db").status.value
        'finished'
        >>> [campaign.name for campaign in brink.connect(database="bits.db").campaigns()]
        ['bits']
    """
    return Client(connect_async(url, token, database=database))


def _connection(url: str | None, token: str | None, database: str | None) -> Connection:
    chosen = url or (None if database else os.environ.get("BRINK_SERVER"))
    if chosen:
        return Connection(chosen, token or os.environ.get("BRINK_TOKEN") or None)
    return Connection.local(settings_of(database))


def settings_of(database: str | None, model: SeederSettings | None = None) -> Settings:
    """Return the settings of a local coordinator.

    Args:
        database: URL of its database, or the path of a SQLite file; None for the default one.
        model: Language model of the campaign that the user runs with it, which is allowed without a key.
    """
    settings = Settings().allowing([] if model is None else [model.endpoint])
    if database is None:
        return settings
    url = database if "://" in database else f"sqlite:///{database}"
    return settings.model_copy(update={"database": url})
