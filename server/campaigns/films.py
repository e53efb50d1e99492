"""The pictures of films, one at a time: who plays an episode asks for many, and its trace is unpacked once."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, TypeAlias

from brink.server.campaigns.store import Campaign
from brink.server.campaigns.traces import find_trace, trace_key
from brink.server.db.engine import Engines, read
from brink.server.errors import NotFound
from brink.server.single_flight import SingleFlightCache
from brink.sim.errors import SimulatorError
from brink.sim.trace import Trace

KEPT: Final = 4
MOST_BYTES: Final = 32 * 1024**2
"""Of all pictures of a film: what is larger is no film that a worker of ours made."""
JPEG_BEGINS: Final = b"\xff\xd8"

Pictures: TypeAlias = Sequence[bytes]


@dataclass(slots=True)
class Films:
    """The pictures of the films that were looked at last.

    Attributes:
        engines: Where traces are.
    """

    engines: Engines
    _latest: SingleFlightCache[Pictures] = field(default_factory=lambda: SingleFlightCache(KEPT))

    async def picture(self, campaign: Campaign, number: int, index: int) -> bytes:
        """Return a picture of a solution's film, as JPEG.

        Raises:
            NotFound: No trace is kept, it has no film, or the film has no such picture.
        """
        key = await read(self.engines, lambda connection: trace_key(connection, campaign.id, number))
        if key is None:
            raise NotFound(
                f"campaign {campaign.id}: no trace of solution {number} is kept; ask for its episode"
            )
        pictures = await self._latest.get(key, 0, lambda: self._pictures(campaign.id, number))
        if index >= len(pictures):
            raise NotFound(
                f"solution {number}: its film has {len(pictures)} pictures, none is number {index}"
            )
        picture = pictures[index]
        if not picture.startswith(JPEG_BEGINS):
            raise NotFound(f"solution {number}: picture {index} of its film is no JPEG")
        return picture

    def _pictures(self, campaign_id: str, number: int) -> Pictures:
        """Return the pictures of a film, none if there is no film that can be shown."""
        with self.engines.reader.connect() as connection:
            kept = find_trace(connection, campaign_id, number)
        if kept is None:
            raise NotFound(f"campaign {campaign_id}: the trace of solution {number} was just removed")
        try:
            film = Trace.from_bytes(kept).film
        except (SimulatorError, LookupError, ValueError, TypeError, MemoryError):
            return ()  # a worker may send anything
        if film is None or sum(map(len, film.pictures)) > MOST_BYTES:
            return ()
        return film.pictures
