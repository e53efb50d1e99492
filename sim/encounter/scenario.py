"""Owns the words of an encounter: where it is, and what everybody else does. Imports nothing heavy."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Self

from brink.sim.encounter.script import Script, scripts_from_json
from brink.sim.episode import Json
from brink.sim.errors import InvalidEpisode
from brink.sim.world.scenario import SCENARIO_CHOICES, UrbanScenario

PLACE_FIELDS: Final = tuple(name for name in SCENARIO_CHOICES if name != "pedestrians")
"""What a place is described by: the urban scenario's parameters, but for how many pedestrians are about."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EncounterScenario:
    """What an encounter is.

    Attributes:
        place: Road, task, time of day, weather.
        road_users: What everybody else does.
    """

    place: UrbanScenario
    road_users: tuple[Script, ...]

    @classmethod
    def from_json(cls, document: Mapping[str, Json]) -> Self:
        """Read a scenario from a JSON object.

        Raises:
            InvalidEpisode: A field is missing, unknown, or wrong.
        """
        if "road_users" not in document:
            raise InvalidEpisode(
                f"scenario.road_users: missing; expected {', '.join((*PLACE_FIELDS, 'road_users'))}"
            )
        if "pedestrians" in document:
            raise InvalidEpisode(
                "scenario: unknown field 'pedestrians'; people are road users of kind pedestrian"
            )
        place = {name: value for name, value in document.items() if name != "road_users"}
        return cls(
            place=UrbanScenario.from_json({**place, "pedestrians": 0}),
            road_users=scripts_from_json(document["road_users"]),
        )
