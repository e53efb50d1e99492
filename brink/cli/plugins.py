"""`brink plugins`: which plug-ins are registered, their parameters, and whether they fulfil their contracts."""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Annotated, Any, Final

import typer

from brink.cli.options import AsJson, console, plain_table, print_json
from brink.search.errors import ConfigError, UnsupportedSpace
from brink.server.errors import nearest
from brink.sim.catalogue import (
    GROUPS,
    REQUIREMENTS,
    SHOWN_DIGITS,
    SIMULATORS,
    load_plugin,
    plugin_ids,
    plugin_source,
)

_BUDGET: Final = 130
"""Simulations of the campaigns that check an algorithm: enough for a few generations of most."""
_SHOWN_DEFAULT: Final = 80
"""Characters of a default that are shown: that of `commonroad@1` is a whole recording."""
_NO_CHECKS: Final = "Brink has no further checks of this kind"

plugins = typer.Typer(
    help="List plug-ins, show their parameters, and check that they fulfil their contracts.",
    no_args_is_help=True,
)


@plugins.command("list")
def list_(as_json: AsJson = False) -> None:
    """List all registered plug-ins; those that are not Brink's own have a source.

    Example: brink plugins list
    """
    found = [
        {"kind": _kind(group), "id": name, "source": plugin_source(group, name)}
        for group in GROUPS
        for name in plugin_ids(group)
    ]
    if as_json:
        print_json(found)
        return
    rows = [(one["kind"] or "", one["id"] or "", (one["source"] or "Brink")[:SHOWN_DIGITS]) for one in found]
    console().print(plain_table("kind", "id", "source", rows=rows))


@plugins.command()
def show(
    plugin_id: Annotated[str, typer.Argument(metavar="ID", help="A problem or an algorithm.")],
    as_json: AsJson = False,
) -> None:
    """Show the parameters of a problem or algorithm, and the search space that the problem has by default.

    Example: brink plugins show edge@2
    """
    from brink.server.findings.kind import reported_by
    from brink.server.problems.catalogue import ALGORITHMS, PROBLEMS, describe_algorithm, describe_problem

    if plugin_id in plugin_ids(ALGORITHMS):
        described = describe_algorithm(plugin_id)
    elif plugin_id in plugin_ids(PROBLEMS):
        described = describe_problem(plugin_id, reported_by)
    else:
        similar = nearest(plugin_id, [*plugin_ids(PROBLEMS), *plugin_ids(ALGORITHMS)])
        meant = f"; did you mean {similar!r}?" if similar else ""
        raise typer.BadParameter(f"no problem or algorithm {plugin_id!r}{meant}", param_hint="ID")
    if as_json:
        print_json(described)
        return
    screen = console()
    screen.print(f"{plugin_id}: {described['summary']}", soft_wrap=True)
    params = described["params"]["properties"]
    rows = [
        (name, _compact(one.get("default"))[:_SHOWN_DEFAULT], _allowed(one), one.get("description", ""))
        for name, one in params.items()
    ]
    _print_folded("parameter", "default", "values", "meaning", rows=rows)
    if space := described.get("space"):
        rows = [
            (f"{component['name']}.{one['name']}", _allowed(one), one.get("unit", ""), _resolution(one))
            for component in space["components"]
            for one in component["parameters"]
        ]
        _print_folded("searched by default", "values", "unit", "resolution", rows=rows)


def _print_folded(*columns: str, rows: Iterable[Sequence[str]]) -> None:
    table = plain_table(*columns, rows=rows)
    for column in table.columns:
        column.overflow = "fold"
    console().print("", table)


def _allowed(described: Mapping[str, Any]) -> str:
    """Return the values that a parameter may have, from its JSON schema or its description in a space."""
    choices = (
        described.get("enum")
        or described.get("choices")
        or [o["value"] for o in described.get("options", ())]
    )
    if choices:
        return ", ".join(str(choice) for choice in choices)
    least, greatest = (
        next((described[key] for key in keys if key in described), None)
        for keys in (("minimum", "low", "exclusiveMinimum"), ("maximum", "high", "exclusiveMaximum"))
    )
    if least is None and greatest is None:
        return str(described.get("type", ""))
    low = "" if least is None else f"{'above ' if 'exclusiveMinimum' in described else ''}{_compact(least)}"
    high = (
        ""
        if greatest is None
        else f"{'below ' if 'exclusiveMaximum' in described else ''}{_compact(greatest)}"
    )
    return f"{low} to {high}" if low and high else (low and f"at least {low}") or f"at most {high}"


def _resolution(described: Mapping[str, Any]) -> str:
    """Return the resolution of a searched parameter; one that depends on a category names it."""
    resolution = described.get("resolution")
    if isinstance(resolution, Mapping):
        return f"by {resolution['label']}"
    return "" if resolution is None else _compact(resolution)


def _compact(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else json.dumps(value, ensure_ascii=False).strip('"')


@plugins.command()
def check(
    ids: Annotated[
        list[str] | None, typer.Argument(metavar="[ID]...", help="Plug-ins; all but Brink's own by default.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Check that plug-ins fulfil their contracts; exit with 1 if one does not.

    Example: brink plugins check

    Example: brink --plugin brake_assist plugins check brake-assist@1
    """
    everything = [(group, name) for group in GROUPS for name in plugin_ids(group)]
    wanted = [
        (group, name)
        for group, name in everything
        if (name in ids if ids else plugin_source(group, name) is not None)
    ]
    if unknown := sorted({*(ids or ())} - {name for _, name in wanted}):
        expected = ", ".join(sorted({name for _, name in everything}))
        raise typer.BadParameter(f"no plug-in {unknown[0]!r}; expected one of {expected}", param_hint="ID")
    results = [{"kind": _kind(group), "id": name, **_checked(group, name)} for group, name in wanted]
    if as_json:
        print_json(results)
    else:
        screen = console()
        for one in results:
            screen.print(f"{one['kind']} {one['id']}: {one['words']}", soft_wrap=True)
        if not results:
            screen.print(
                "no plug-ins but Brink's own are registered: name a module with brink --plugin MODULE"
            )
    raise typer.Exit(int(any(not one["passed"] for one in results)))


def _kind(group: str) -> str:
    return group.removeprefix("brink.").removesuffix("s").replace("_", " ")


def _checked(group: str, name: str) -> dict[str, Any]:
    """Check one plug-in; return whether it passed, and a description of the result."""
    from brink.server.problems.catalogue import ALGORITHMS, PROBLEMS
    from brink.sim.driving_systems.option import DRIVING_SYSTEMS

    checks: Mapping[str, Callable[[str, str], str]] = {
        REQUIREMENTS: _check_requirement,
        PROBLEMS: _check_problem,
        ALGORITHMS: _check_algorithm,
        DRIVING_SYSTEMS: _check_driving_system,
    }
    try:
        words = checks.get(group, _check_loads)(group, name)
    except Exception as error:  # noqa: BLE001  (a plug-in may raise anything; that is what is checked)
        return {"passed": False, "words": f"{type(error).__name__}: {error}"}
    return {"passed": True, "words": words}


def _check_loads(group: str, name: str) -> str:
    load_plugin(group, name)
    checked = "it is checked with the problem that needs it" if group == SIMULATORS else _NO_CHECKS
    return f"loads; {checked}"


def _check_requirement(group: str, name: str) -> str:
    from brink.sim.testing import check_requirement

    check_requirement(load_plugin(group, name))  # type: ignore[arg-type]
    return "passed"


def _check_problem(group: str, name: str) -> str:
    from brink.server.problems.catalogue import make_problem
    from brink.server.problems.testing import check_problem

    check_problem(lambda: make_problem(name, {}))
    return "passed, with its simulator"


def _check_algorithm(group: str, name: str) -> str:
    from brink.search.testing import check_algorithm, example_spaces

    make: Any = load_plugin(group, name)
    searched = []
    for title, space in example_spaces().items():
        try:
            make().check(space, make().config_type(), budget=_BUDGET)
        except (UnsupportedSpace, ConfigError):
            continue
        check_algorithm(make(), space, budget=_BUDGET)
        searched.append(title)
    if not searched:
        return (
            f"loads; it searches no example space with {_BUDGET} simulations: call check_algorithm yourself"
        )
    return f"passed on the spaces {', '.join(searched)}"


def _check_driving_system(group: str, name: str) -> str:
    from brink.worker.driving_check import check_driving_system

    check = check_driving_system(name)
    return f"passed on {len(check.drives)} streets"
