"""The requirements that give a problem's verdict: how campaigns choose and state them."""

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final, TypeAlias

from brink.formula import FormulaError
from brink.search.errors import ConfigError
from brink.server.errors import nearest
from brink.sim.formula_requirement import RARE_SIGNALS, SIGNALS, stated_formulas

ANY: Final = "any"
"""Value of the parameter ``requirement`` that stands for all that a problem records."""

Stated: TypeAlias = str | list[str | dict[str, Any]] | dict[str, Any]
"""The parameter ``requirement``: an id, formulas by name, or a list of both."""


def requirement_setting(default: str | Sequence[str | dict[str, Any]], recorded: Sequence[str]) -> Any:
    """Return the field ``requirement`` of a problem's parameters, annotated `Stated`.

    Args:
        default: The requirement, or several.
        recorded: Requirements that every episode records, for which `ANY` stands.
    """
    words = (
        f"Id of the requirement that gives the verdict, a list of several, or {ANY} for "
        f"{', '.join(recorded[:-1])} and {recorded[-1]}, which are recorded in any case. Or your own as a formula: "
        "{NAME: {stl: FORMULA, unit: UNIT}}."
    )
    if isinstance(default, str):
        return dataclasses.field(default=default, metadata={"help": words})
    return dataclasses.field(default_factory=lambda: list(default), metadata={"help": words})


def _parts(given: Stated) -> list[str | dict[str, Any]]:
    return given if isinstance(given, list) else [given]


def formulas_in(given: Stated) -> dict[str, Any]:
    """Return the formulas that the parameter ``requirement`` states, by name."""
    return {name: one for part in _parts(given) if isinstance(part, dict) for name, one in part.items()}


def chosen_requirements(given: Stated, recorded: Sequence[str]) -> tuple[str, ...]:
    """Return the ids and names of the requirements in the parameter ``requirement``."""
    if given == ANY:
        return tuple(recorded)
    return tuple(name for part in _parts(given) for name in ([part] if isinstance(part, str) else part))


def check_requirements(
    given: Stated,
    known: Sequence[str],
    *,
    duration_s: float,
    not_recorded: Collection[str] = (),
    recorded: Collection[str] = (),
) -> None:
    """Check the parameter ``requirement``.

    Args:
        given: Its value.
        known: Requirements that the problem's simulator can evaluate.
        duration_s: Length of an episode.
        not_recorded: Signals that it does not measure.
        recorded: Those among `RARE_SIGNALS` that it measures.

    Raises:
        ConfigError: It names none, one that is unknown, or one more than once, or a formula is wrong.
    """
    chosen = chosen_requirements(given, known)
    if not chosen:
        raise ConfigError("requirement", "expected at least one requirement, got an empty list")
    if len(set(chosen)) < len(chosen):
        raise ConfigError("requirement", f"expected each requirement once, got {given!r}")
    formulas = formulas_in(given)
    lacking = {*not_recorded, *RARE_SIGNALS} - set(recorded)
    check_formulas(formulas, [name for name in SIGNALS if name not in lacking], duration_s)
    for name in formulas:
        if name == ANY or name in {one.partition("@")[0] for one in known}:
            raise ConfigError("requirement", f"expected a name of your own for a formula, got {name!r}")
    for name in chosen:
        if name not in known and name not in formulas:
            raise ConfigError(
                "requirement",
                f"expected {ANY}, or some of {', '.join(known)}, or a formula; got {name!r}",
                nearest=nearest(name, (ANY, *known)),
            )


def check_formulas(formulas: Mapping[str, Any], signals: Sequence[str], duration_s: float) -> None:
    """Check the formulas that the parameter ``requirement`` states.

    Args:
        formulas: The formulas by name.
        signals: The signals that are recorded.
        duration_s: Length of an episode.

    Raises:
        ConfigError: One is malformed, about something else, or looks beyond the end.
    """
    try:
        stated_formulas(formulas, signals, duration_s)
    except FormulaError as error:
        raise ConfigError("requirement", str(error)) from error
