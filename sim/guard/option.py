"""The option ``guard`` of an episode: which guard runs in the car, and what it triggers.

An episode without it is the one that it always was, with the same hash.

    {"guard": "ttc@1", "threshold": 0.5, "fallback": "safe-stop@1", "settings": {"decel_mps2": 4.0, …}}
    {"guard": "file:guard.json", "digest": "9f86…", …}

A guard is registered, or a file; its digest makes sure that every worker drives with the file that was meant. All
settings of the fallback are listed, so that the hash of an episode does not depend on what their defaults are.
"""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, Protocol, Self, cast

from brink.sim.catalogue import load_plugin, plugin_ids
from brink.sim.driving.interface import Driving, Route
from brink.sim.episode import Json, JsonObject, nearest, parse_number
from brink.sim.errors import InvalidEpisode
from brink.sim.guard.guarded import Guarded
from brink.sim.guard.interface import Fallback, Guard, KnownConditions, RangeScan
from brink.sim.guard.setting import Settings, settings_from_json, settings_to_json
from brink.user_file import read_file

GUARDS: Final = "brink.guards"
"""Entry points: `MakeGuard`."""
GUARD_FILES: Final = "brink.guard_files"
"""Entry points: functions that return the `MakeGuard` in a file."""
FITTED: Final = "fitted@1"
MAX_FILE_BYTES: Final = 64 * 1024**2
FALLBACKS: Final = "brink.fallbacks"
"""Entry points: classes that are made with their settings, whose type is the attribute ``settings_type``."""
DEFAULT_FALLBACK: Final = "safe-stop@1"
NO_FALLBACK: Final = "none@1"
OPTION: Final = "guard"
FILE: Final = "file:"
_FIELDS: Final = ("guard", "digest", "threshold", "fallback", "settings")


class MakeGuard(Protocol):
    """Makes a guard for one drive.

    Attributes:
        needs_scan: Whether the car needs a range sensor; without this attribute it does not.
        own_threshold: The threshold of its guards unless another one is given; without this attribute 0.5.
    """

    def __call__(self, route: Route, conditions: KnownConditions, threshold: float | None) -> Guard:
        """Return a new guard.

        Args:
            route: The route of the drive.
            conditions: What the car knows about the time of day and the weather.
            threshold: Probability from which it raises the alarm; None takes its own.
        """


@dataclass(frozen=True, slots=True, kw_only=True)
class GuardOption:
    """Which guard runs in the car, and what it triggers.

    Attributes:
        guard: Id of a registered guard, or ``file:`` and the path of a guard's file.
        digest: SHA-256 of the file, as 16 hexadecimal digits; empty for a registered guard.
        threshold: Probability from which the alarm is raised, in (0, 1]; None takes the guard's own.
        fallback: Id of the fallback.
        settings: Settings of the fallback.
    """

    guard: str
    digest: str = ""
    threshold: float | None = None
    fallback: str
    settings: Settings

    def to_json(self) -> JsonObject:
        """Return the option as a JSON object."""
        document: JsonObject = {"guard": self.guard}
        if self.digest:
            document["digest"] = self.digest
        if self.threshold is not None:
            document["threshold"] = self.threshold
        return {**document, "fallback": self.fallback, "settings": settings_to_json(self.settings)}

    @classmethod
    def of(
        cls,
        guard: str,
        *,
        threshold: float | None = None,
        fallback: str = DEFAULT_FALLBACK,
        settings: Mapping[str, Json] | None = None,
    ) -> Self:
        """Return an option, with the digest of the guard's file.

        Args:
            guard: Id of a registered guard, or ``file:`` and the path of a guard's file.
            threshold: Probability from which the alarm is raised; None takes the guard's own.
            fallback: Id of the fallback.
            settings: Settings of the fallback; the others have their defaults.

        Raises:
            InvalidEpisode: The guard or the fallback is unknown, or a setting is out of range.
        """
        document: JsonObject = {"guard": guard, "fallback": fallback, "settings": dict(settings or {})}
        if guard.startswith(FILE):
            document["digest"] = guard_digest(_path(guard))
        if threshold is not None:
            document["threshold"] = threshold
        return cls.from_json(document)

    @classmethod
    def from_json(cls, document: Json) -> Self:
        """Parse the option of an episode.

        Raises:
            InvalidEpisode: A field is missing, unknown or out of range, or the file is not the one that was meant.
        """
        where = f"options.{OPTION}"
        if not isinstance(document, dict):
            raise InvalidEpisode(f"{where}: expected an object, got {document!r:.80}")
        for name in document:
            if name not in _FIELDS:
                expected = f"expected {', '.join(_FIELDS)}"
                raise InvalidEpisode(f"{where}: unknown field {name!r}{nearest(name, _FIELDS)}; {expected}")
        guard, fallback = (_word(where, document, name) for name in ("guard", "fallback"))
        threshold = document.get("threshold")
        if threshold is not None:
            threshold = parse_number(f"{where}.threshold", threshold, 0.0, 1.0)
            if threshold == 0.0:
                raise InvalidEpisode(
                    f"{where}.threshold: expected a number in (0, 1], got 0: the alarm would always be on"
                )
        settings = document.get("settings", {})
        if not isinstance(settings, dict):
            raise InvalidEpisode(f"{where}.settings: expected an object, got {settings!r:.80}")
        return cls(
            guard=guard,
            digest=_checked_digest(where, guard, document.get("digest", "")),
            threshold=threshold,
            fallback=fallback,
            settings=fallback_settings(fallback, settings, f"{where}.settings"),
        )

    @property
    def needs_scan(self) -> bool:
        """Whether the car needs a range sensor."""
        return bool(getattr(_maker(self.guard, self.digest), "needs_scan", False))

    @property
    def waits_for_alarm(self) -> bool:
        """Whether the fallback changes nothing before the first alarm."""
        return bool(getattr(load_plugin(FALLBACKS, self.fallback), "waits_for_alarm", False))

    def watching(self) -> Self:
        """Return the option with the same guard, and a fallback that does nothing."""
        return replace(self, fallback=NO_FALLBACK, settings=fallback_settings(NO_FALLBACK, {}))

    @property
    def own_threshold(self) -> float:
        """The probability from which the guard raises the alarm if no threshold is given."""
        return float(getattr(_maker(self.guard, self.digest), "own_threshold", 0.5))

    def around(
        self,
        system: Driving,
        route: Route,
        conditions: KnownConditions,
        *,
        scan: Callable[[float], RangeScan] | None = None,
    ) -> Guarded:
        """Return a driving system with a new guard beside it and a new fallback around it.

        Args:
            system: The driving system.
            route: The route of the drive.
            conditions: What the car knows about the time of day and the weather.
            scan: Returns the range sensor's scan at a simulated time; None without a sensor.
        """
        guard = _maker(self.guard, self.digest)(route, conditions, self.threshold)
        fallback = make_fallback(self.fallback, self.settings)
        return Guarded(system, guard, fallback, fallback_id=self.fallback, scan=scan)


def option_of(options: Mapping[str, Json]) -> GuardOption | None:
    """Return the guard among the options of an episode; None if there is none.

    Raises:
        InvalidEpisode: The option is malformed.
    """
    return GuardOption.from_json(options[OPTION]) if OPTION in options else None


def guard_digest(file: Path) -> str:
    """Return the digest of a guard's file: 16 hexadecimal digits of its SHA-256.

    Raises:
        InvalidEpisode: The file cannot be read, is not a regular file, or is too large for a guard.
    """
    try:
        if file.exists() and not file.is_file():
            raise InvalidEpisode(f"guard: {file}: expected a file")
        if file.stat().st_size > MAX_FILE_BYTES:
            raise InvalidEpisode(f"guard: {file}: expected a guard of at most {MAX_FILE_BYTES} bytes")
        return hashlib.sha256(read_file(file, MAX_FILE_BYTES)).hexdigest()[:16]
    except (OSError, ValueError) as error:
        raise InvalidEpisode(f"guard: {file}: {getattr(error, 'strerror', None) or error}") from None


def _path(guard: str) -> Path:
    return Path(guard.removeprefix(FILE))


def _word(where: str, document: Mapping[str, Json], name: str) -> str:
    value = document.get(name)
    if not isinstance(value, str):
        raise InvalidEpisode(f"{where}.{name}: expected an id, got {value!r:.80}")
    return value


def _checked_digest(where: str, guard: str, digest: Json) -> str:
    """Return the digest of a guard after comparing it with the file; empty for a registered guard.

    Raises:
        InvalidEpisode: The guard is unknown, or its file is not the one that was meant.
    """
    if not guard.startswith(FILE):
        _maker(guard)
        return ""
    found = guard_digest(_path(guard))
    if digest != found:
        raise InvalidEpisode(f"{where}.digest: expected that of the file, {found}; got {digest!r:.80}")
    return found


def _maker(guard: str, digest: str = "") -> MakeGuard:
    """Return the factory of a guard.

    Raises:
        InvalidEpisode: The guard is unknown.
        GuardFileError: Its file is not a guard.
    """
    if guard.startswith(FILE):
        return _from_file(_path(guard), digest)
    try:
        return cast(MakeGuard, load_plugin(GUARDS, guard))
    except KeyError:
        known = plugin_ids(GUARDS)
        raise InvalidEpisode(
            f"guard: expected one of {', '.join([*known, FILE + 'FILE'])}; got {guard!r}{nearest(guard, known)}"
        ) from None


@lru_cache(maxsize=4)
def _from_file(file: Path, _digest: str) -> MakeGuard:
    """Return the factory of the guard in a file, which is read again only when its content changes."""
    return cast(Callable[[Path], MakeGuard], load_plugin(GUARD_FILES, FITTED))(file)


def fallback_settings(fallback_id: str, document: Mapping[str, Json], where: str = "settings") -> Settings:
    """Return the settings of a fallback; those that are not given have their defaults.

    Args:
        fallback_id: Its versioned id.
        document: The given settings.
        where: Name of the settings in error messages.

    Raises:
        InvalidEpisode: No fallback has this id, or a setting is unknown or out of range.
    """
    kind: type[Settings] = _factory(fallback_id).settings_type
    return settings_from_json(where, kind, document)


def make_fallback(fallback_id: str, settings: Settings) -> Fallback:
    """Return a new fallback for one drive.

    Raises:
        InvalidEpisode: No fallback has this id.
    """
    return cast(Callable[[Settings], Fallback], _factory(fallback_id))(settings)


def _factory(fallback_id: str) -> Any:
    try:
        return load_plugin(FALLBACKS, fallback_id)
    except KeyError:
        known = plugin_ids(FALLBACKS)
        raise InvalidEpisode(
            f"fallback: expected one of {', '.join(known)}; got {fallback_id!r}{nearest(fallback_id, known)}"
        ) from None
