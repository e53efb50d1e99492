"""Which simulators and requirements there are: found by entry point, loaded when asked for.

Reading the catalogue never imports a simulator, so a coordinator can list them without their physics.
"""

import importlib
import os
from collections.abc import Callable, Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Protocol, cast

from brink.sim.episode import EpisodeResult, EpisodeSpec
from brink.sim.errors import InvalidEpisode, PluginMissing

SIMULATORS = "brink.simulators"
REQUIREMENTS = "brink.requirements"
PLUGINS_VARIABLE = "BRINK_PLUGINS"
"""Environment variable with comma-separated modules to import for their registrations."""

_registered: dict[str, dict[str, Callable[..., object]]] = {}


class Simulator(Protocol):
    """Runs episodes. Made once a process, used for many episodes, one at a time."""

    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        """Run one episode.

        Args:
            spec: What to run.
            record: Whether the result carries the trace.

        Raises:
            InvalidEpisode: The specification can never run.
            SimulationCrashed: This run broke down.
        """
        ...


def register(group: str, plugin_id: str, factory: Callable[..., object]) -> None:
    """Add a plug-in without an entry point, for modules named in ``BRINK_PLUGINS``.

    Args:
        group: Such as ``brink.simulators``.
        plugin_id: Versioned id, such as ``brink-drive@1``.
        factory: What an entry point would load: a class, or a function that makes one of its kind.
    """
    _registered.setdefault(group, {})[plugin_id] = factory


@cache
def _entry_points(group: str) -> Mapping[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=group)}


@cache
def _import_plugin_modules() -> None:
    for name in filter(None, os.environ.get(PLUGINS_VARIABLE, "").split(",")):
        try:
            importlib.import_module(name.strip())
        except Exception as error:  # (foreign code may raise anything)
            raise PluginMissing(
                f"plug-in {name.strip()!r} (--plugin, or {PLUGINS_VARIABLE}) cannot be imported from here: "
                f"{type(error).__name__}: {error}"
            ) from error


def plugin_ids(group: str) -> tuple[str, ...]:
    """Return the ids of all plug-ins of a group, sorted."""
    _import_plugin_modules()
    return tuple(sorted({*_entry_points(group), *_registered.get(group, {})}))


def load_plugin(group: str, plugin_id: str) -> object:
    """Return what a plug-in registered: a class or a factory without arguments.

    Raises:
        KeyError: Nothing of that id is registered.
    """
    _import_plugin_modules()
    if plugin_id in _registered.get(group, {}):
        return _registered[group][plugin_id]
    return _entry_points(group)[plugin_id].load()


def simulator_ids() -> tuple[str, ...]:
    """Return the ids of all registered simulators, sorted."""
    return plugin_ids(SIMULATORS)


def make_simulator(simulator_id: str) -> Simulator:
    """Return a new simulator.

    Raises:
        InvalidEpisode: No simulator of that id is registered.
    """
    try:
        factory = load_plugin(SIMULATORS, simulator_id)
    except KeyError:
        known = ", ".join(simulator_ids()) or "none"
        raise InvalidEpisode(f"simulator: unknown id {simulator_id!r}; registered here: {known}") from None
    return cast(Callable[[], Simulator], factory)()
