"""The requirements that give a problem's verdict: how campaigns choose them, and how they appear in words."""

import dataclasses
from collections.abc import Sequence
from typing import Any, Final

from brink.search.errors import ConfigError
from brink.server.errors import nearest

ANY: Final = "any"
"""Value of the parameter ``requirement`` that stands for all that a problem records."""


def requirement_setting(default: str | Sequence[str], recorded: Sequence[str]) -> Any:
    """Return the field ``requirement`` of a problem's parameters, annotated ``str | list[str]``.

    Args:
        default: The requirement, or several.
        recorded: Requirements that every episode records, for which `ANY` stands.
    """
    words = (
        f"Id of the requirement that gives the verdict, a list of several, or {ANY} for "
        f"{', '.join(recorded[:-1])} and {recorded[-1]}, which are recorded in any case."
    )
    if isinstance(default, str):
        return dataclasses.field(default=default, metadata={"help": words})
    return dataclasses.field(default_factory=lambda: list(default), metadata={"help": words})


def chosen_requirements(given: str | Sequence[str], recorded: Sequence[str]) -> tuple[str, ...]:
    """Return the requirements that the parameter ``requirement`` names."""
    if given == ANY:
        return tuple(recorded)
    return (given,) if isinstance(given, str) else tuple(given)


def check_requirements(given: str | Sequence[str], known: Sequence[str]) -> None:
    """Check the parameter ``requirement``.

    Args:
        given: Its value.
        known: Requirements that the problem's simulator can evaluate.

    Raises:
        ConfigError: It names none, one that is unknown, or one more than once.
    """
    chosen = chosen_requirements(given, known)
    if not chosen:
        raise ConfigError("requirement", "expected at least one requirement, got an empty list")
    if len(set(chosen)) < len(chosen):
        raise ConfigError("requirement", f"expected each requirement once, got {given!r}")
    for name in chosen:
        if name not in known:
            raise ConfigError(
                "requirement",
                f"expected {ANY}, or some of {', '.join(known)}; got {name!r}",
                nearest=nearest(name, (ANY, *known)),
            )
