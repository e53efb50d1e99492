"""Settings of guards and fallbacks: numbers with a unit and a range, read from JSON."""

from collections.abc import Mapping
from dataclasses import Field, asdict, dataclass, field, fields
from typing import Any, ClassVar, Protocol, TypeVar

from brink.sim.episode import Json, JsonObject, nearest, parse_number
from brink.sim.errors import InvalidEpisode


class Settings(Protocol):
    """A frozen dataclass whose fields are all made by `ranged`."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]


@dataclass(frozen=True, slots=True, kw_only=True)
class NoSettings:
    """Settings of a plug-in that has none."""


_Settings = TypeVar("_Settings", bound=Settings)


def ranged(default: float, *, low: float, high: float, unit: str) -> Any:
    """Return a field of settings.

    Args:
        default: Its default.
        low: Smallest number allowed.
        high: Largest number allowed.
        unit: Its unit.
    """
    return field(default=default, metadata={"low": low, "high": high, "unit": unit})


def settings_from_json(where: str, kind: type[_Settings], document: Mapping[str, Json]) -> _Settings:
    """Parse settings; those that are not given have their defaults.

    Args:
        where: Name of the object in error messages, such as ``options.guard.settings``.
        kind: Type of the settings.
        document: The given settings.

    Raises:
        InvalidEpisode: A setting is unknown, no number, or out of range.
    """
    known = {one.name: one.metadata for one in fields(kind)}
    values = {}
    for name, value in document.items():
        if name not in known:
            expected = ", ".join(known) or "none"
            raise InvalidEpisode(
                f"{where}: unknown setting {name!r}{nearest(name, tuple(known))}; expected {expected}"
            )
        about = known[name]
        values[name] = parse_number(f"{where}.{name}", value, about["low"], about["high"], about["unit"])
    return kind(**values)


def settings_to_json(settings: Settings) -> JsonObject:
    """Return settings as a JSON object, defaults included."""
    return asdict(settings)
