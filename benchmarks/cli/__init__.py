"""`python -m benchmarks`: measurements of this installation, with a target for each figure.

Commands import their measurement when they are called: most load a simulator or need optional packages.
"""

import typer

from benchmarks.cli.errors import errors
from benchmarks.cli.monitors import guard, monitor_accuracy
from benchmarks.cli.perception import detector, perturbations, rendering, simood
from benchmarks.cli.searches import finders, mumoea, search
from benchmarks.cli.service import archive, chaos, dashboard, queue, scale, soak, stalls, turns, utilisation
from benchmarks.cli.statistics import coverage, rate
from benchmarks.cli.urban import command, control, difficulty, drivers, driving, sim
from brink.cli.commands import HelpfulGroup

bench = typer.Typer(
    name="python -m benchmarks",
    cls=HelpfulGroup,
    help="Benchmark this installation and compare each figure with its target.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for _command in (
    difficulty,
    drivers,
    driving,
    command,
    control,
    sim,
    errors,
    detector,
    simood,
    rendering,
    perturbations,
    search,
    finders,
    mumoea,
    monitor_accuracy,
    guard,
    coverage,
    rate,
    queue,
    scale,
    utilisation,
    turns,
    archive,
    soak,
    chaos,
    stalls,
    dashboard,
):
    bench.command()(_command)
