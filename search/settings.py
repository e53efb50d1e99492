"""Settings of algorithms and problems: fields of frozen dataclasses that carry their help, bounds and unit.

A catalogue turns such a dataclass into a JSON schema from `dataclasses.fields`: the metadata of each field holds
``help``, ``unit`` and whichever of ``ge``, ``gt``, ``le``, ``lt`` and ``choices`` bound it.
"""

import dataclasses
import sys
from typing import Any, TypeVar, cast, get_type_hints

from brink.search.errors import ConfigError

T = TypeVar("T")

BOUNDS = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}
"""Names of the bounds in a field's metadata, with the sign that messages print."""

_NOUNS: dict[Any, str] = {float: "a number", int: "a whole number", bool: "true or false", str: "a text"}


def setting(
    default: T,
    *,
    help: str,  # noqa: A002  (the word that catalogues and command lines use for it)
    ge: float | None = None,
    gt: float | None = None,
    le: float | None = None,
    lt: float | None = None,
    unit: str = "",
    choices: tuple[T, ...] | None = None,
) -> T:
    """Return a dataclass field with a default, a line of help, bounds and a unit.

    Args:
        default: The value if none is given; its field is annotated ``float``, ``int``, ``bool`` or ``str``.
        help: One line that says what the setting does.
        ge: Smallest value.
        gt: Value that it must exceed.
        le: Largest value.
        lt: Value that it must stay below.
        unit: Unit of the value.
        choices: The only values that it may have.
    """
    bounds = {"ge": ge, "gt": gt, "le": le, "lt": lt}
    metadata: dict[str, Any] = {"help": help, "unit": unit} | {
        name: bound for name, bound in bounds.items() if bound is not None
    }
    if choices is not None:
        metadata["choices"] = choices
    return dataclasses.field(default=default, metadata=metadata)


def _is_of(kind: Any, value: object) -> bool:
    if kind is float:
        # NaN fails the comparison; so do infinities and whole numbers that no float can hold.
        number = isinstance(value, int | float) and not isinstance(value, bool)
        return number and -sys.float_info.max <= cast(float, value) <= sys.float_info.max
    if kind is int:
        return isinstance(value, int) and not isinstance(value, bool)
    return isinstance(value, kind)


def _holds(bound: str, value: float, limit: float) -> bool:
    match bound:
        case "ge":
            return value >= limit
        case "gt":
            return value > limit
        case "le":
            return value <= limit
        case _:
            return value < limit


def check_settings(config: Any) -> None:
    """Check every setting of a config dataclass; call it from ``__post_init__``.

    Raises:
        ConfigError: A setting is of the wrong type or out of its bounds; names the field.
    """
    kinds = get_type_hints(type(config))
    for field in dataclasses.fields(config):
        kind = kinds[field.name]
        if kind not in _NOUNS:
            continue
        value = getattr(config, field.name)
        limits = {bound: field.metadata[bound] for bound in BOUNDS if bound in field.metadata}
        wanted = " and ".join(f"{BOUNDS[bound]} {limit:g}" for bound, limit in limits.items())
        expected = f"{_NOUNS[kind]} {wanted}".strip() + (
            f" ({field.metadata['unit']})" if field.metadata.get("unit") else ""
        )
        if not _is_of(kind, value) or not all(_holds(b, value, limit) for b, limit in limits.items()):
            raise ConfigError(field.name, f"expected {expected}, got {value!r}")
        choices = field.metadata.get("choices")
        if choices is not None and value not in choices:
            raise ConfigError(field.name, f"expected one of {', '.join(map(str, choices))}; got {value!r}")
