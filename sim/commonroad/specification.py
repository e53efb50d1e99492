"""What determines a drive in recorded traffic, besides the errors: the scenario as JSON and in words."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Self

from brink.sim.episode import Json, check_fields, parse_number
from brink.sim.errors import InvalidEpisode

SIMULATOR_ID: Final = "commonroad@1"
START_SPEEDS: Final = (0.8, 1.2)
"""Range of the ego's speed at the start, as a share of that in the file."""
MAX_NAME_CHARS: Final = 100
_FIELDS: Final = ("file", "recording", "start_speed", "reacting")


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedScenario:
    """A drive in recorded traffic.

    Attributes:
        file: Name of the file, for people.
        recording: The packed recording; see `brink.sim.commonroad.recording`.
        start_speed: The ego's speed at the start, as a share of that in the file.
        reacting: Whether other vehicles keep their distance.
    """

    file: str
    recording: str
    start_speed: float
    reacting: bool

    @classmethod
    def from_json(cls, document: Mapping[str, Json]) -> Self:
        """Parse a scenario; what is packed in it is checked where it is read.

        Raises:
            InvalidEpisode: A field is missing, unknown or out of range.
        """
        check_fields("scenario", document, _FIELDS)
        for name in ("file", "recording"):
            if not isinstance(document[name], str):
                raise InvalidEpisode(f"scenario.{name}: expected text, got {document[name]!r:.80}")
        if not isinstance(document["reacting"], bool):
            raise InvalidEpisode(
                f"scenario.reacting: expected true or false, got {document['reacting']!r:.80}"
            )
        return cls(
            file=str(document["file"])[:MAX_NAME_CHARS],
            recording=str(document["recording"]),
            start_speed=parse_number("scenario.start_speed", document["start_speed"], *START_SPEEDS),
            reacting=document["reacting"],
        )

    @property
    def words(self) -> str:
        """The scenario in words."""
        reacting = ", others react" if self.reacting else ""
        return f"{self.file}, starts at {100.0 * self.start_speed:.0f}% of the recorded speed{reacting}"
