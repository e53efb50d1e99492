"""All commands of `brink`, and the options that they share."""

import logging
import os
import sys
from typing import Annotated

import typer

from brink import __version__
from brink.cli import inspect, llm, operate, perturbations, steer
from brink.cli.benchmarks import methods, service
from brink.cli.benchmarks.figures import bench
from brink.cli.compare import compare
from brink.cli.evidence import evidence
from brink.cli.experiments.commands import experiment
from brink.cli.findings.combinations import combinations
from brink.cli.findings.violations import violations
from brink.cli.monitor import monitor
from brink.cli.operations import doctor, export, import_, prune_
from brink.cli.repeats import repeats
from brink.cli.run import run
from brink.cli.sensitivity import sensitivity
from brink.cli.tokens import token
from brink.sim.catalogue import PLUGINS_VARIABLE
from brink.worker.log import LogLevel, configure_logging, environment_format

app = typer.Typer(
    name="brink",
    help="Find where a driving system with a machine-learned component stops being safe.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.command()(run)
app.command()(operate.serve)
app.command()(operate.worker)
app.command()(operate.submit)
app.command()(inspect.status)
app.command()(inspect.results)
for steering in (steer.pause, steer.resume, steer.cancel, steer.retry, steer.delete):
    app.command()(steering)
app.command()(combinations)
app.command()(violations)
app.command()(evidence)
app.command()(repeats)
app.command()(inspect.plot)
app.command()(inspect.replay)
app.command()(compare)
app.command()(doctor)
app.command()(export)
app.command("import")(import_)
operate.db.command("prune")(prune_)
app.add_typer(operate.db, name="db")
app.add_typer(token, name="token")
for measurement in (*methods.COMMANDS, *service.COMMANDS):
    bench.command()(measurement)
app.add_typer(experiment, name="experiment")
app.add_typer(monitor, name="monitor")
app.add_typer(sensitivity, name="sensitivity")
app.add_typer(bench, name="bench")
app.add_typer(perturbations.perturbations, name="perturbations")
app.add_typer(llm.llm, name="llm")


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"brink {__version__}")
        raise typer.Exit


@app.callback()
def options(
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log what happens to stderr.")] = False,
    plugin: Annotated[
        list[str] | None,
        typer.Option(
            help="Module with plug-ins, importable from here; may be given again.", metavar="MODULE"
        ),
    ] = None,
    show_version: Annotated[
        bool,
        typer.Option("--version", help="Say which version this is.", callback=_print_version, is_eager=True),
    ] = False,
) -> None:
    """Find where a driving system with a machine-learned component stops being safe."""
    if plugin:
        named = [*filter(None, os.environ.get(PLUGINS_VARIABLE, "").split(",")), *plugin]
        os.environ[PLUGINS_VARIABLE] = ",".join(named)  # for the workers that this command starts, too
        sys.path.insert(0, os.getcwd())
    if not logging.getLogger().handlers:
        configure_logging(LogLevel.INFO if verbose else LogLevel.WARNING, environment_format())
