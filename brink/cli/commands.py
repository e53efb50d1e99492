"""The commands of `brink`, and the options that come before a command.

`brink --help` needs only the table below. The module of a command is imported when the command is called, because
most commands only talk to a server and should not wait for numpy, scipy and a web server to load.
"""

import difflib
import logging
import os
import sys
from collections.abc import Mapping
from importlib import import_module
from typing import Annotated, Any, Final

import typer
from typer.core import TyperCommand, TyperGroup
from typer.models import DefaultPlaceholder

from brink import __version__
from brink.api.terminal import echo
from brink.worker.log import LogLevel, configure_logging, environment_format

SECTIONS: Final[Mapping[str, Mapping[str, tuple[str, str]]]] = {
    "Run": {
        "examples": ("brink.cli.examples:examples", "List, print and copy the examples"),
        "run": ("brink.cli.run:run", "Run a campaign: coordinator, workers, results, pictures"),
        "init": ("brink.cli.init:init", "Write a campaign file for a program, or an OpenSCENARIO file"),
        "try": ("brink.cli.try_:try_", "Run one episode of a command or FMU, and show its signals"),
        "submit": ("brink.cli.campaigns:submit", "Submit a campaign to a coordinator"),
        "experiment": ("brink.cli.experiment:experiment", "Compare algorithms over problems and seeds"),
    },
    "Inspect": {
        "status": ("brink.cli.campaigns:status", "Show campaigns, or the progress of one"),
        "findings": ("brink.cli.findings:findings", "Show the findings of a campaign, or one kind"),
        "results": ("brink.cli.campaigns:results", "Show or export distinct boundary solutions"),
        "thresholds": ("brink.cli.thresholds:thresholds", "Show where exactly drives turn unsafe"),
        "pairs": ("brink.cli.pairs:pairs", "Show or export safe and unsafe drives side by side"),
        "rate": ("brink.cli.rate:rate", "Show how often drives are unsafe in operation"),
        "tolerance": ("brink.cli.tolerance:tolerance", "Show how severe a component's errors may be"),
        "violations": ("brink.cli.violations:violations", "Show the types of violations found"),
        "combinations": ("brink.cli.findings:combinations", "Show hazardous chains of perturbations"),
        "compare": ("brink.cli.compare:compare", "Compare campaigns, each with its control"),
        "plot": ("brink.cli.draw:plot", "Draw the figures of a campaign"),
        "report": ("brink.cli.draw:report", "Write a report to hand on: one HTML file"),
        "replay": ("brink.cli.draw:replay", "Draw one episode as PNG, GIF or MP4"),
    },
    "Trust": {
        "evidence": ("brink.cli.evidence:evidence", "Export a boundary as tables, rules and replays"),
        "suite": ("brink.cli.suite:suite", "Simulate hazards again that were found earlier"),
        "repeats": ("brink.cli.repeats:repeats", "Simulate boundary solutions again with other seeds"),
        "sensitivity": ("brink.cli.sensitivity:sensitivity", "Measure how settings change a boundary"),
        "monitor": ("brink.cli.monitor:monitor", "Turn a campaign into a safety monitor"),
        "errors": ("brink.cli.errors:errors", "Fit the errors of a recorded detector and simulate them"),
        "guard": ("brink.cli.guard:guard", "Turn a campaign into a runtime monitor in the car"),
    },
    "Control": {
        "tag": ("brink.cli.campaigns:tag", "Add or remove tags of a campaign"),
        "note": ("brink.cli.campaigns:note", "Write notes on a campaign"),
        "pause": ("brink.cli.campaigns:pause", "Pause a campaign"),
        "resume": ("brink.cli.campaigns:resume", "Resume a paused campaign"),
        "cancel": ("brink.cli.campaigns:cancel", "Cancel a campaign and keep its results"),
        "retry": ("brink.cli.campaigns:retry", "Retry the quarantined jobs of a campaign"),
        "delete": ("brink.cli.campaigns:delete", "Delete a campaign and its results"),
    },
    "Operate": {
        "serve": ("brink.cli.serve:serve", "Run a coordinator"),
        "worker": ("brink.cli.worker:worker", "Run a worker"),
        "token": ("brink.cli.database:token", "Create, list and revoke tokens"),
        "db": ("brink.cli.database:db", "Upgrade or prune the database"),
        "doctor": ("brink.cli.database:doctor", "Check the database, campaigns, jobs and workers"),
        "export": ("brink.cli.export:export", "Write a campaign to a file, or a drive as a scenario"),
        "import": ("brink.cli.database:import_", "Read a campaign from a file"),
    },
    "Tools": {
        "plugins": ("brink.cli.plugins:plugins", "List and check plug-ins"),
        "driving": ("brink.cli.driving:driving", "Check a driving system"),
        "perturbations": ("brink.cli.perturbations:perturbations", "List and show image perturbations"),
        "llm": ("brink.cli.llm:llm", "Check and preview language models"),
    },
}
"""By section and name: the ``module:attribute`` that defines the command, and its line in ``brink --help``."""


class PlainCommand(TyperCommand):
    """A command that rejects a repeated multi-value option, which would otherwise lose all but its last values."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments of the command."""
        if any(one.nargs > 1 for one in self.params):
            _, _, given = self.make_parser(ctx).parse_args(list(args))
            for one in {one.name: one for one in given if one.nargs > 1}.values():
                if given.count(one) > 1:
                    name = f"'{one.opts[0]}'"
                    raise typer.BadParameter(
                        "may be given only once; use one call for each", ctx=ctx, param_hint=name
                    )
        return super().parse_args(ctx, args)


MOST_NAMED = 12
"""Commands of a group that an error names; of a larger one, only the nearest."""


class HelpfulGroup(TyperGroup):
    """A command group whose error for an unknown command suggests the closest one."""

    def resolve_command(self, ctx: Any, args: Any) -> Any:
        """Return the command that the arguments begin with, and its arguments."""
        name, known = args[0], self.list_commands(ctx)
        if self.get_command(ctx, name) is None and not name.startswith("-"):
            close = difflib.get_close_matches(name, known, n=1)
            meant = f"did you mean {close[0]!r}? " if close else ""
            expected = "" if len(known) > MOST_NAMED else f"expected one of {', '.join(known)}; "
            ctx.fail(f"no command {name!r}; {meant}{expected}see {ctx.command_path} --help")
        return super().resolve_command(ctx, args)


class LazyGroup(HelpfulGroup):
    """A command group that imports the module of a command when the command is called."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands."""
        return [name for section in SECTIONS.values() for name in section]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command by name; None if it does not exist."""
        for section in SECTIONS.values():
            if cmd_name in section:
                return load(cmd_name, section[cmd_name][0])
        return None

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """List the commands by section, without importing them."""
        for title, section in SECTIONS.items():
            with formatter.section(title):
                formatter.write_dl([(f"{name:13}", line) for name, (_, line) in section.items()])


def load(name: str, target: str) -> Any:
    """Import a command or a group of commands.

    Args:
        name: Name of the command.
        target: The ``module:attribute`` that defines it: a function or a `typer.Typer`.
    """
    module, _, attribute = target.partition(":")
    found: Any = getattr(import_module(module), attribute)
    if not isinstance(found, typer.Typer):
        single = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
        single.command(name, cls=PlainCommand)(found)
        found = single
    elif isinstance(vars(found.info)["cls"], DefaultPlaceholder):
        found.info.cls = HelpfulGroup
    found.rich_markup_mode = None  # square brackets in help and errors are not markup
    command = typer.main.get_command(found)
    command.name = name
    return command


app = typer.Typer(
    name="brink",
    cls=LazyGroup,
    help="Find where a driving system with a machine-learned component stops being safe.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _print_version(wanted: bool) -> None:
    if wanted:
        echo(f"brink {__version__}")
        raise typer.Exit


@app.callback()
def options(
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log to stderr.")] = False,
    plugin: Annotated[
        list[str] | None, typer.Option(help="Python module with plug-ins; may be repeated.", metavar="MODULE")
    ] = None,
    show_version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Find where a driving system with a machine-learned component stops being safe."""
    if plugin:
        from brink.sim.catalogue import PLUGINS_VARIABLE

        named = [*filter(None, os.environ.get(PLUGINS_VARIABLE, "").split(",")), *plugin]
        os.environ[PLUGINS_VARIABLE] = ",".join(named)  # read by the workers of this command as well
        sys.path.insert(0, os.getcwd())
    if not logging.getLogger().handlers:
        configure_logging(LogLevel.INFO if verbose else LogLevel.WARNING, environment_format())
