"""The commands of `brink driving`: check a driving system."""

import ast
import os
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Final

import typer

from brink.cli.options import AsJson, console, named_values, plain_table, print_json
from brink.server.errors import InvalidInput
from brink.sim.catalogue import plugin_ids
from brink.sim.errors import DefinitionError
from brink.sim.programs.installed import COMMANDS_VARIABLE
from brink.user_file import read_file

MAX_SOURCE_BYTES: Final = 4 * 1024**2
STREETS: Final = 10

driving = typer.Typer(help="Check driving systems.", no_args_is_help=True)


@driving.callback()
def _group() -> None:
    """Check driving systems."""


@driving.command()
def check(
    file: Annotated[
        str,
        typer.Argument(
            metavar="FILE[:CLASS]",
            help="Driving system: a Python file, with :CLASS if it has several; the YAML file of a program or "
            "FMU; or the id of an installed one.",
            show_default=False,
        ),
    ],
    setting: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE",
            show_default=False,
            help="Number that the driving system gets in start.settings; may be repeated.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Drive ten streets with a driving system, and say what it does wrong.

    Nothing is detected wrongly here. Each street is driven several times, in two orders and two processes. A wrong
    decision, an exception, a crash, a late answer, or a drive that differs from the same drive before is a FAULT, and
    the exit status is then 1. Violations in the table are not: they show how it drives.

    Example: brink driving check my_planner.py

    Example: brink driving check my_planner.py:Planner --setting headway_s=1.2

    Example: brink driving check examples/driving/fmu/acc.yaml --json
    """
    from brink.worker.driving_check import drive_streets

    settings = named_values("--setting", setting, "headway_s=1.2")
    with tempfile.TemporaryDirectory(prefix="brink-") as folder:
        system, module = _system(file, folder)
        plugins = () if module is None else (module,)
        found = drive_streets(system, settings, plugins=plugins, streets=STREETS)
    if as_json:
        print_json(asdict(found))
        raise typer.Exit(int(bool(found.faults)))
    rows = [
        (str(number), one.street, "-", "no verdict", "")
        if one.failed is not None
        else (
            str(number),
            one.street,
            f"{one.way_m:.0f}",
            one.ended,
            ", ".join(f"{name} at {time_s:.1f} s" for name, time_s in one.violated_s.items()),
        )
        for number, one in enumerate(found.drives, start=1)
    ]
    screen = console()
    screen.print(
        plain_table("", "street", "m driven", "ended", "violated", right=("", "m driven"), rows=rows)
    )
    for remark in found.remarks:
        screen.print(f"{system}: {remark}", soft_wrap=True, markup=False)
    for fault in found.faults:
        screen.print(f"FAULT: {fault}", soft_wrap=True, markup=False)
    if not found.faults:
        screen.print(
            f"{system} keeps its contract in these streets: each drive was the same in other orders and processes"
        )
    raise typer.Exit(int(bool(found.faults)))


def _system(given: str, folder: str) -> tuple[str, str | None]:
    """Return the name of a driving system, and the module to load for it; None if it is registered or a program.

    Args:
        given: What the user named.
        folder: Folder in which a program is installed.

    Raises:
        InvalidInput: There is no such file, or it has not one driving system.
    """
    from brink.sim.driving_systems.command import Definition, install
    from brink.sim.driving_systems.option import DRIVING_SYSTEMS, OWN

    if given.endswith((".yaml", ".yml")):
        os.environ[COMMANDS_VARIABLE] = folder
        try:
            install(definition := Definition.of(Path(given)))
            return definition.id(), None
        except DefinitionError as error:
            raise InvalidInput.at("FILE", str(error)) from None
    if ".py" not in given:
        known = tuple(dict.fromkeys((OWN, *plugin_ids(DRIVING_SYSTEMS))))
        if given in known:
            return given, None
        raise InvalidInput.at(
            "FILE", f"expected a Python or YAML file, or one of {', '.join(known)}; got {given!r}"
        )
    path, _, name = given.partition(".py:")
    file = Path(path if name else given)
    file = file.with_name(file.name + ".py") if name else file
    if not file.is_file():
        raise InvalidInput.at("FILE", f"{file}: no such file")
    if not file.stem.isidentifier():
        raise InvalidInput.at(
            "FILE", f"{file}: expected a file name that Python can import, such as my_planner.py"
        )
    names = _classes_with_step(file)
    if not name and len(names) != 1:
        found = f"has {', '.join(names)}" if names else "has no class with a method step"
        raise InvalidInput.at("FILE", f"{file} {found}: name the class or function, such as {file}:Planner")
    folder = str(file.resolve().parent)
    # For the processes that drive; this one never runs the file.
    os.environ["PYTHONPATH"] = os.pathsep.join([folder, *filter(None, [os.environ.get("PYTHONPATH", "")])])
    return f"{file.stem}:{name or names[0]}", file.stem


def _classes_with_step(file: Path) -> list[str]:
    """Return the names of the classes in a file that have a method ``step``; the file is not run.

    Raises:
        InvalidInput: It is not Python.
    """
    try:
        tree = ast.parse(read_file(file, MAX_SOURCE_BYTES))
    except (SyntaxError, ValueError) as error:
        raise InvalidInput.at("FILE", f"{file}: not a Python file: {error}") from None
    return [
        node.name
        for node in tree.body
        if isinstance(node, ast.ClassDef)
        and any(isinstance(one, ast.FunctionDef) and one.name == "step" for one in node.body)
    ]
