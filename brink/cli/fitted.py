"""The campaigns on which a monitor or a guard is fitted or evaluated, and how its file records them."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from brink.api.client import Api
from brink.api.results import FetchedArchive, fetch_archive
from brink.cli.options import with_api
from brink.server.errors import Conflict


def fetch_archives(
    campaigns: Sequence[str], *, server: str | None, database: str | None
) -> list[FetchedArchive]:
    """Return the archives of campaigns on one problem, each once.

    Args:
        campaigns: Ids, at least one; two may name the same campaign.
        server: URL of the coordinator; None opens the database in this process.
        database: URL of the database; None takes the default one.

    Raises:
        Conflict: The campaigns have different problems.
        CoordinatorError: A campaign does not exist.
    """

    async def fetched(api: Api) -> list[FetchedArchive]:
        return [await fetch_archive(api, campaign) for campaign in campaigns]

    found = {one.id: one for one in with_api(server, database, fetched)}
    first, *others = found.values()
    for other in others:
        if other.body.problem != first.body.problem:
            raise Conflict(
                f"campaigns {first.id} and {other.id} have different problems; expected campaigns on one problem"
            )
    return [first, *others]


def fitted_among(about: object, campaigns: Iterable[FetchedArchive]) -> list[str]:
    """Return the ids of those campaigns to which a model was fitted.

    Args:
        about: The provenance in the model's file; of an unknown form, it names no campaigns.
        campaigns: The campaigns.
    """
    learned = about.get("campaigns") if isinstance(about, Mapping) else None
    return [one.id for one in campaigns if isinstance(learned, list) and one.id in learned]


def fitted_words(file: Path, campaigns: Sequence[str]) -> str:
    """Return the beginning of a message that a file's model was fitted to campaigns."""
    return f"{file} was fitted to {'campaign' if len(campaigns) == 1 else 'campaigns'} {', '.join(campaigns)}"
