"""The option ``driving`` of an episode: which driving system drives the car.

An episode without it is driven by Brink's own, and is the one that it always was, with the same hash.

    {"driving": {"system": "my_planner:Planner", "settings": {"headway_s": 1.2}}}

A system is registered in the group ``brink.driving_systems``, or is a class or function of a plug-in module, or a
program (`brink.sim.driving_systems.command`). Only workers make one: the coordinator checks its name.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Self, cast

from brink.sim.catalogue import load_function, load_plugin, plugin_ids
from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import CONTROL_STEP_S, PERCEPTION_STEP_S, Route
from brink.sim.driving_systems.command import OPTION, PREFIX, is_id, process_of
from brink.sim.driving_systems.interface import CarLimits, DrivingSystem, MakeDrivingSystem, Start
from brink.sim.driving_systems.own import OwnSystem
from brink.sim.driving_systems.seam import SystemUnderTest
from brink.sim.episode import MAX_SEED, Json, JsonObject, nearest
from brink.sim.errors import InvalidEpisode
from brink.sim.world.ego import CarModel
from brink.sim.world.streams import Stream, generator

DRIVING_SYSTEMS: Final = "brink.driving_systems"
"""Entry points: `MakeDrivingSystem`."""
OWN: Final = "modular@1"
"""Brink's own driving system, which drives unless another one is chosen."""
MAX_SETTINGS_CHARS: Final = 20_000
_FIELDS: Final = ("system", "settings")


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivingOption:
    """Which driving system drives the car.

    Attributes:
        system: Id of a registered driving system, or ``module:Factory``.
        settings: What its factory gets as `Start.settings`.
    """

    system: str = OWN
    settings: Mapping[str, Json] = field(default_factory=dict)

    @classmethod
    def of(cls, options: Mapping[str, Json]) -> Self:
        """Return the driving system among the options of an episode.

        Raises:
            InvalidEpisode: The option is malformed, or names a system that is not registered here.
        """
        if OPTION not in options:
            return cls()
        document, where = options[OPTION], f"options.{OPTION}"
        if not isinstance(document, dict) or "system" not in document or set(document) - set(_FIELDS):
            raise InvalidEpisode(
                f"{where}: expected an object with {', '.join(_FIELDS)}; got {document!r:.80}"
            )
        system, settings = document["system"], document.get("settings", {})
        if not isinstance(system, str) or not isinstance(settings, dict):
            raise InvalidEpisode(f"{where}: expected a name and an object of settings, got {document!r:.80}")
        factory_of(system)
        return cls(system=system, settings=settings)

    def to_options(self) -> JsonObject:
        """Return the option as it stands among the options of an episode: nothing for Brink's own system."""
        if self.is_own:
            return {}
        settings: JsonObject = {"settings": dict(self.settings)} if self.settings else {}
        return {OPTION: {"system": self.system, **settings}}

    @property
    def is_own(self) -> bool:
        """Whether Brink's own driving system drives."""
        return self.system == OWN and not self.settings

    def provenance(self) -> dict[str, Json]:
        """Return the entries in the provenance of a result: none for Brink's own system."""
        if self.is_own:
            return {}
        hello = process_of(self.system).hello if is_id(self.system) else None
        words = {} if hello is None else {"driving_name": hello.name, "driving_version": hello.version}
        return {"driving": self.system, **words}

    def start(self, route: Route, car: CarModel, camera: Camera, seed: int) -> SystemUnderTest:
        """Return a new driving system for one drive.

        Args:
            route: The ego's route.
            car: The ego.
            camera: The obstacle detector's camera.
            seed: The episode's seed.

        Raises:
            DrivingSystemFailed: It cannot be made.
        """
        start = Start(
            route=route,
            car=CarLimits(
                length_m=car.length_m,
                width_m=car.width_m,
                wheelbase_m=car.wheelbase_m,
                steer_limit_rad=car.steer_limit_rad,
                steer_rate_radps=car.steer_rate_radps,
                engine_mps2=car.engine_mps2,
                brake_mps2=car.brake_mps2,
                delay_s=car.delay_s,
            ),
            camera=camera,
            control_s=CONTROL_STEP_S,
            perception_s=PERCEPTION_STEP_S,
            settings=self.settings,
            seed=int(generator(seed, Stream.DRIVING_SYSTEM).integers(MAX_SEED)),
        )
        return SystemUnderTest(self.system, factory_of(self.system), start)


def factory_of(system: str, where: str = f"options.{OPTION}.system") -> MakeDrivingSystem:
    """Return the factory of a driving system; runs none of its code.

    Args:
        system: Id of a registered driving system, or ``module:Factory``.
        where: Where the name stands, for messages.

    Raises:
        InvalidEpisode: It is unknown.
    """
    if system == OWN:
        return OwnSystem
    if is_id(system):
        return lambda start: cast(DrivingSystem, process_of(system).start(start))
    if system.startswith(PREFIX):
        raise InvalidEpisode(
            f"{where}: expected command:NAME@DIGEST, which brink driving check FILE.yaml shows; got {system!r:.80}"
        )
    if ":" in system:
        return cast(MakeDrivingSystem, load_function(where, system))
    try:
        return cast(MakeDrivingSystem, load_plugin(DRIVING_SYSTEMS, system))
    except KeyError:
        known = tuple(dict.fromkeys((OWN, *plugin_ids(DRIVING_SYSTEMS))))
        expected = ", ".join([*known, "MODULE:CLASS", "command:FILE.yaml"])
        raise InvalidEpisode(
            f"{where}: expected one of {expected}; got {system!r:.80}{nearest(system, known)}"
        ) from None


def wrong_settings(settings: Mapping[str, object]) -> str | None:
    """Return what is wrong with the settings of a driving system; None if they are JSON of a limited size."""
    try:
        size = len(json.dumps(settings, allow_nan=False))
    except (TypeError, ValueError, RecursionError) as error:
        return f"expected an object of JSON values without NaN: {error}"
    return (
        None
        if size <= MAX_SETTINGS_CHARS
        else f"expected at most {MAX_SETTINGS_CHARS} characters, got {size}"
    )
