"""The catalogue of plug-ins: finds them by entry point, loads them on demand, makes simulators and requirements.

Reading the catalogue never imports a simulator, so a coordinator can list simulators without loading their physics.
"""

import difflib
import importlib
import inspect
import json
import os
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Protocol, cast

from brink.extras import has_extra
from brink.sim.episode import COMMAND_PREFIX, FMU_PREFIX, EpisodeResult, EpisodeSpec, Json
from brink.sim.errors import ExtraMissing, InvalidEpisode, PluginMissing
from brink.sim.requirements import Requirement
from brink.sim.sources import distribution_digest, is_own, module_digest, modules_digest

SIMULATORS = "brink.simulators"
REQUIREMENTS = "brink.requirements"
EPISODE_GROUPS: Final = (
    SIMULATORS,
    REQUIREMENTS,
    "brink.detectors",
    "brink.driving_systems",
    "brink.fallbacks",
    "brink.guards",
    "brink.perturbations",
)
"""Groups of the plug-ins that workers run, which decide an episode's result."""
GROUPS: Final = (*EPISODE_GROUPS, "brink.algorithms", "brink.problems")
FUNCTION_PREFIX = "function-"
"""Beginning of the ids of simulators that call a Python function."""
PLUGINS_VARIABLE = "BRINK_PLUGINS"
"""Environment variable with a comma-separated list of modules to import for the plug-ins that they register."""

EXTRAS: Final[Mapping[str, str]] = {
    "brink-aeb@3": "vision",
    "brink-dataset@2": "vision",
    "brink-drive-camera@3": "vision",
    "brink-encounter-camera@3": "vision",
    "gymnasium@1": "gymnasium",
    "highway-env@1": "highway",
    "sumo@1": "sumo",
}
"""The optional extra that each of Brink's own simulators needs, if any."""

SHOWN_DIGITS: Final = 8
"""Digits of a source's digest in messages."""
_GROUP_PREFIX: Final = "brink."
_MODULES: Final = "modules"

PLAIN = "plain"
FUNCTION = "function"
OTHER = "other"
WORKER_KINDS: Final = (PLAIN, *sorted(set(EXTRAS.values())), FUNCTION, OTHER)
"""Kinds of workers; see `worker_kind`."""

_registered: dict[str, dict[str, Callable[..., object]]] = {}
_registered_by: dict[tuple[str, str], str] = {}
"""The plug-in module that registered a plug-in while it was imported."""
_importing: list[str] = []


class Simulator(Protocol):
    """Runs episodes one at a time. One instance serves a whole process."""

    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        """Run one episode.

        Args:
            spec: The episode.
            record: Whether the result includes the trace.

        Raises:
            InvalidEpisode: The specification can never run.
            SimulationCrashed: This run failed.
        """


def register(group: str, plugin_id: str, factory: Callable[..., object]) -> None:
    """Register a plug-in without an entry point, from a module listed in ``BRINK_PLUGINS``.

    Args:
        group: Entry-point group, such as ``brink.simulators``.
        plugin_id: Versioned id, such as ``brink-drive@3``.
        factory: What an entry point would load: a class, or a function that returns an instance.
    """
    _registered.setdefault(group, {})[plugin_id] = factory
    _registered_by.pop((group, plugin_id), None)
    if _importing:
        _registered_by[group, plugin_id] = _importing[-1]


@cache
def _entry_points(group: str) -> Mapping[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=group)}


def plugin_modules() -> list[str]:
    """Return the names of the modules to import for the plug-ins that they register."""
    names = (name.strip() for name in os.environ.get(PLUGINS_VARIABLE, "").split(","))
    return [name for name in names if name]


@cache
def import_plugin_modules() -> None:
    """Import the modules with plug-ins, once in a process.

    Raises:
        PluginMissing: A module cannot be imported; the message says what to do.
    """
    for name in plugin_modules():
        _importing.append(name)
        try:
            importlib.import_module(name)
        except Exception as error:  # (third-party code may raise anything)
            why = _why_not_imported(name, error)
            raise PluginMissing(
                f"plug-in module {name!r}, which --plugin or {PLUGINS_VARIABLE} names, {why}"
            ) from error
        finally:
            _importing.pop()
        module_digest(name)  # now, before anybody edits what was imported


def _why_not_imported(name: str, error: Exception) -> str:
    """Return why a plug-in's module cannot be imported, and what to do."""
    missing = error.name if isinstance(error, ModuleNotFoundError) else None
    if missing is None or not f"{name}.".startswith(f"{missing}."):
        needs = f"; install {missing!r} here" if missing else "; correct the module"
        return f"fails when it is imported: {type(error).__name__}: {error}{needs}, or leave the plug-in out"
    here = Path.cwd()
    top = name.partition(".")[0]
    if (here / f"{top}.py").is_file() or (here / top).is_dir():
        return (
            f"is not on Python's path, but in {here}: name it with --plugin, which searches that folder too"
        )
    return (
        f"is neither installed for {sys.executable} nor on Python's path (and not in {here}): install its package, "
        "call brink in the folder of the module with --plugin, or correct the name"
    )


def plugin_ids(group: str) -> tuple[str, ...]:
    """Return the ids of all plug-ins in a group, sorted."""
    import_plugin_modules()
    return tuple(sorted({*_entry_points(group), *_registered.get(group, {})}))


def load_plugin(group: str, plugin_id: str) -> object:
    """Return the class or factory that a plug-in registered.

    Raises:
        KeyError: No plug-in has this id.
        ExtraMissing: It is a simulator whose extra is not installed.
    """
    import_plugin_modules()
    if plugin_id in _registered.get(group, {}):
        return _registered[group][plugin_id]
    if group == SIMULATORS and plugin_id in EXTRAS and not has_extra(EXTRAS[plugin_id]):
        raise ExtraMissing(f"{plugin_id} needs the extra {EXTRAS[plugin_id]}, which is not installed")
    return _entry_points(group)[plugin_id].load()


def plugin_source(group: str, plugin_id: str) -> str | None:
    """Return the digest of a plug-in's source; None for Brink's own, and for one that is not registered here."""
    factory = _registered.get(group, {}).get(plugin_id)
    if factory is not None:
        modules = {_registered_by.get((group, plugin_id)), getattr(factory, "__module__", None)}
        return modules_digest(name for name in modules if name is not None)
    return _point_source(group, plugin_id) if plugin_id in _foreign_points(group) else None


@cache
def _point_source(group: str, plugin_id: str) -> str:
    point = _entry_points(group)[plugin_id]
    return (
        module_digest(point.module) if point.dist is None else distribution_digest(point.dist, point.module)
    )


def named_sources(document: object, groups: Sequence[str] = EPISODE_GROUPS) -> dict[str, str]:
    """Return the digests of the sources of the plug-ins that a document names, except Brink's own.

    Args:
        document: A JSON value. It names a plug-in if a string in it is its id, or names a function of its module.
        groups: Groups of the plug-ins.

    Returns:
        Digests by group and id, such as ``requirements/gentle@1``, and by ``modules/NAME``.
    """
    import_plugin_modules()
    known = {
        f"{group.removeprefix(_GROUP_PREFIX)}/{plugin_id}": (json.dumps(plugin_id), source)
        for group in groups
        for plugin_id in (*_foreign_points(group), *_registered.get(group, {}))
        if (source := plugin_source(group, plugin_id)) is not None
    }
    known |= {
        f"{_MODULES}/{name}": (f'"{name}:', module_digest(name))
        for name in plugin_modules()
        if not is_own(name)
    }
    if not known:
        return {}
    text = json.dumps(document)
    return {key: source for key, (word, source) in sorted(known.items()) if word in text}


@cache
def _foreign_points(group: str) -> tuple[str, ...]:
    return tuple(name for name, point in _entry_points(group).items() if not is_own(point.module))


def with_sources(spec: EpisodeSpec) -> EpisodeSpec:
    """Return an episode that also records the source digests of the plug-ins it names."""
    sources = named_sources(spec.to_json())
    return replace(spec, sources=sources) if sources else spec


def other_source(sources: Mapping[str, str]) -> str | None:
    """Return why an episode cannot run here with its recorded plug-in sources, or None if it can.

    Args:
        sources: Digests as `named_sources` returns them.
    """
    for key, wanted in sources.items():
        kind, _, name = key.partition("/")
        here = (
            (module_digest(name) if name in plugin_modules() else None)
            if kind == _MODULES
            else plugin_source(f"{_GROUP_PREFIX}{kind}", name)
        )
        if here != wanted:
            has = "is not here" if here is None else f"has source {here[:SHOWN_DIGITS]} here"
            return (
                f"plug-in {name} {has}, but the campaign uses source {wanted[:SHOWN_DIGITS]}: start this worker "
                "again with the code that the coordinator has"
            )
    return None


def is_own_plugin(group: str, plugin_id: str) -> bool:
    """Return whether a plug-in is part of Brink, and not code of users; loads nothing.

    Raises:
        KeyError: No plug-in has this id.
    """
    registered = _registered.get(group, {}).get(plugin_id)
    module = _entry_points(group)[plugin_id].module if registered is None else registered.__module__
    return is_own(module)


def load_function(where: str, name: str, own_modules: Sequence[str] = ()) -> Callable[..., Any]:
    """Return a function or class of a plug-in module that a specification names, such as ``my_policies:drive``.

    A specification may come from anybody who may submit campaigns, so it reaches no other modules, and nothing that
    such a module merely imports, unless the module lists it in `__all__`.

    Args:
        where: Where the name stands, for messages.
        name: Module and function, separated by a colon.
        own_modules: Modules of Brink that may be named as well.

    Raises:
        InvalidEpisode: The module is not a plug-in, or has no such function.
    """
    import_plugin_modules()
    module, _, function = name.partition(":")
    known = [*own_modules, *plugin_modules()]
    if module not in known:
        raise InvalidEpisode(
            f"{where}: expected MODULE:FUNCTION with a module that --plugin or {PLUGINS_VARIABLE} names, or one of "
            f"{', '.join(known) or 'none'}; got {name!r}"
        )
    source = importlib.import_module(module)
    found = getattr(source, function, None)
    if not callable(found) or function.startswith("_"):
        raise InvalidEpisode(f"{where}: {module} has no function {function!r}")
    if getattr(found, "__module__", None) != module and function not in getattr(source, "__all__", ()):
        raise InvalidEpisode(
            f"{where}: expected a function that {module} defines, or lists in __all__; {function!r} is from "
            "elsewhere"
        )
    return cast(Callable[..., Any], found)


def simulator_ids() -> tuple[str, ...]:
    """Return the ids of all registered simulators, sorted."""
    return plugin_ids(SIMULATORS)


def worker_kind(simulator_id: str) -> str:
    """Return which kind of worker runs a simulator, for scaling: one of `WORKER_KINDS`.

    Args:
        simulator_id: Id of the simulator, which need not be known here.

    Returns:
        ``plain`` if a worker without extras runs it; the extra that it needs; ``function`` for the Python program
        that called ``brink.search()``; ``other`` for simulators of plug-ins and of other versions of Brink.
    """
    if simulator_id in EXTRAS:
        return EXTRAS[simulator_id]
    if simulator_id.startswith(FUNCTION_PREFIX):
        return FUNCTION
    point = _entry_points(SIMULATORS).get(simulator_id)
    return PLAIN if point is not None and point.module.startswith("brink.") else OTHER


def worker_for(simulator_id: str) -> str:
    """Describe the kind of worker that can run a simulator, such as "a worker with the extra sumo (sumo@1)".

    Args:
        simulator_id: Id of the simulator, which need not be known here.
    """
    if simulator_id in EXTRAS:
        return f"a worker with the extra {EXTRAS[simulator_id]} ({simulator_id})"
    if worker_kind(simulator_id) == FUNCTION:
        return f"the Python program that called brink.search() ({simulator_id})"
    if simulator_id.startswith(COMMAND_PREFIX):
        return f"a worker with --commands FOLDER, which has the same command and program ({simulator_id})"
    if simulator_id.startswith(FMU_PREFIX):
        return f"a worker with the extra fmu and --commands FOLDER, which has the same FMU ({simulator_id})"
    if simulator_id in _entry_points(SIMULATORS):
        return f"a worker ({simulator_id})"
    if retired_words(simulator_id) is not None:
        return f"a worker of the version of Brink that has {simulator_id}"
    return f"a worker with the plug-in that provides {simulator_id}"


def start_words(simulator_id: str, server: str, program: str = "brink") -> str:
    """Describe how to start a worker that can run a simulator.

    Args:
        simulator_id: Id of the simulator, which need not be known here.
        server: Address of the coordinator.
        program: How to call Brink.
    """
    if simulator_id.startswith(FUNCTION_PREFIX):
        return f"run {worker_for(simulator_id)} again"
    return f"start {worker_for(simulator_id)} with: {program} worker --server {server}"


def make_simulator(simulator_id: str) -> Simulator:
    """Return a new simulator.

    Raises:
        InvalidEpisode: No simulator has this id.
    """
    try:
        factory = load_plugin(SIMULATORS, simulator_id)
    except KeyError:
        known = ", ".join(simulator_ids()) or "none"
        why = retired_words(simulator_id) or f"unknown id {simulator_id!r}"
        raise InvalidEpisode(f"simulator: {why}; registered here: {known}") from None
    return cast(Callable[[], Simulator], factory)()


def retired_words(simulator_id: str) -> str | None:
    """Return in words that this version of Brink has replaced a simulator by a later one; None if it has not."""
    name, _, number = simulator_id.partition("@")
    later = [
        one
        for one in EXTRAS.keys() | _entry_points(SIMULATORS).keys()
        if one.startswith(f"{name}@") and number.isdigit() and int(one.partition("@")[2]) > int(number)
    ]
    if not later:
        return None
    return (
        f"this version of Brink no longer runs {simulator_id}, it has {min(later)}; its results stay readable"
    )


def requirement_ids() -> tuple[str, ...]:
    """Return the ids of all registered requirements, sorted."""
    return plugin_ids(REQUIREMENTS)


def requirement_words(requirement_id: str) -> str:
    """Describe a registered requirement: the first line of its class's docstring."""
    line, *_ = (inspect.getdoc(load_plugin(REQUIREMENTS, requirement_id)) or "").splitlines() or [""]
    words = re.sub(r"^`[^`]*`: ", "", line)
    return words[:1].upper() + words[1:]


def make_requirement(requirement_id: str) -> Requirement:
    """Return a new requirement for one episode.

    Raises:
        InvalidEpisode: No requirement has this id; the message suggests the closest one.
    """
    try:
        factory = load_plugin(REQUIREMENTS, requirement_id)
    except KeyError:
        known = requirement_ids()
        close = difflib.get_close_matches(requirement_id, known, n=1, cutoff=0.4)
        hint = f"did you mean {close[0]!r}? " if close else ""
        raise InvalidEpisode(
            f"requirements: unknown id {requirement_id!r}; {hint}registered here: {', '.join(known) or 'none'}"
        ) from None
    return cast(Callable[[], Requirement], factory)()


def make_requirements(
    wanted_ids: Sequence[str], formulas: Mapping[str, Json] = MappingProxyType({})
) -> dict[str, Requirement]:
    """Return new requirements for one episode by id, in the given order.

    Args:
        wanted_ids: Ids of plug-ins, and names of formulas.
        formulas: Formulas as in `EpisodeSpec`.

    Raises:
        InvalidEpisode: An id is unknown or listed twice, or a formula is wrong.
    """
    from brink.sim.formula_requirement import formula_requirements  # clients know plug-ins without NumPy

    stated = formula_requirements(formulas)
    made: dict[str, Requirement] = {}
    for requirement_id in wanted_ids:
        if requirement_id in made:
            raise InvalidEpisode(f"requirements: {requirement_id!r} is listed twice")
        made[requirement_id] = stated.get(requirement_id) or make_requirement(requirement_id)
    return made
