"""Follow-ups that simulate the very episodes of a campaign, with one thing changed."""

from collections.abc import Mapping, Sequence

from sqlalchemy import Connection

from brink.search.archive import Archive
from brink.search.space import FloatArray
from brink.search.streams import episode_seed
from brink.server.campaigns import view_store
from brink.server.campaigns.store import Campaign
from brink.server.errors import Conflict


def vectors_of(archive: Archive, numbers: Sequence[int]) -> FloatArray:
    """Return solutions of an archive, by number, shape ``(n, d)``."""
    places = {number: place for place, number in enumerate(archive.numbers.tolist())}
    rows: FloatArray = archive.vectors[[places[number] for number in numbers]]
    return rows


def seed_numbers(campaign: Campaign, numbers: Sequence[int], seeds: Mapping[int, int]) -> list[int]:
    """Return, for each solution, the number of the candidate whose episode seed it had.

    Args:
        campaign: The campaign.
        numbers: Numbers of the solutions.
        seeds: Their episode seeds, by number.

    Raises:
        Conflict: A seed is not that of any candidate.
    """
    known = {episode_seed(campaign.body.seed, number): number for number in numbers}
    if any(seeds[number] not in known for number in numbers):
        last = max(*numbers, campaign.completed)
        known |= {episode_seed(campaign.body.seed, number): number for number in range(last + 1)}
    for number in numbers:
        if seeds[number] not in known:
            raise Conflict(
                f"campaign {campaign.id}: solution {number} shares the episode of another campaign, so it cannot be "
                "followed up here: ask about that campaign's pairs instead"
            )
    return [known[seeds[number]] for number in numbers]


def read_seeds(connection: Connection, campaign_id: str, numbers: Sequence[int]) -> dict[int, int]:
    """Return the episode seeds of solutions, by number."""
    return {row.number: row.seed for row in view_store.read_solutions(connection, campaign_id, set(numbers))}
