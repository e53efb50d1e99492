"""Settings of algorithms and problems: fields of frozen dataclasses with help, bounds and unit.

The metadata of each field holds ``help``, ``unit``, and those of ``ge``, ``gt``, ``le``, ``lt`` and ``choices`` that
limit it, and of ``label`` and ``main`` that forms need. A catalogue builds a JSON schema from them with
`dataclasses.fields`.
"""

import dataclasses
import sys
from typing import Any, TypeVar, cast, get_type_hints

from brink.search.errors import ConfigError

T = TypeVar("T")

BOUNDS = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}
"""Keys of the bounds in a field's metadata, and their signs in messages."""

_NOUNS: dict[Any, str] = {float: "a number", int: "a whole number", bool: "true or false", str: "a string"}


def setting(
    default: T,
    *,
    help: str,  # noqa: A002  (the word of catalogues and command lines)
    ge: float | None = None,
    gt: float | None = None,
    le: float | None = None,
    lt: float | None = None,
    unit: str = "",
    label: str = "",
    main: bool = False,
    choices: tuple[T, ...] | None = None,
) -> T:
    """Declare a dataclass field annotated ``float``, ``int``, ``bool`` or ``str``.

    Args:
        default: Default value.
        help: One line that says what the setting does.
        ge: Inclusive lower bound.
        gt: Exclusive lower bound.
        le: Inclusive upper bound.
        lt: Exclusive upper bound.
        unit: Unit of the value.
        label: What forms call it, if its name is a symbol or an abbreviation.
        main: Whether forms show it at once, and not among the further settings.
        choices: The allowed values.
    """
    bounds = {"ge": ge, "gt": gt, "le": le, "lt": lt}
    metadata: dict[str, Any] = {"help": help, "unit": unit} | {
        name: bound for name, bound in bounds.items() if bound is not None
    }
    metadata |= {name: value for name, value in (("label", label), ("main", main)) if value}
    if choices is not None:
        metadata["choices"] = choices
    return dataclasses.field(default=default, metadata=metadata)


def _has_type(kind: Any, value: object) -> bool:
    if kind is float:
        # NaN fails the comparison, and so do infinities and integers too large for a float.
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
    """Check every setting of a config dataclass; call this from its ``__post_init__``.

    Raises:
        ConfigError: A setting has the wrong type or is out of bounds; names the field.
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
        if not _has_type(kind, value) or not all(_holds(b, value, limit) for b, limit in limits.items()):
            raise ConfigError(field.name, f"expected {expected}, got {value!r}")
        choices = field.metadata.get("choices")
        if choices is not None and value not in choices:
            raise ConfigError(field.name, f"expected one of {', '.join(map(str, choices))}; got {value!r}")
