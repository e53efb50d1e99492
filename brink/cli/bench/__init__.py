"""`brink bench`: measurements of this installation, with a target for each figure.

Commands import their measurement when they are called: most load a simulator or need optional packages.
"""

import typer

from brink.cli.bench.errors import errors
from brink.cli.bench.monitors import guard, monitor, monitor_accuracy
from brink.cli.bench.perception import detector, perturbations, rendering, simood
from brink.cli.bench.searches import heredity, mumoea, paper, search
from brink.cli.bench.service import archive, chaos, dashboard, queue, scale, soak, stalls, turns
from brink.cli.bench.statistics import coverage
from brink.cli.bench.urban import control, difficulty, drivers, sim

bench = typer.Typer(
    help="Benchmark this installation and compare each figure with its target.", no_args_is_help=True
)
for _command in (
    difficulty, drivers, control, sim,
    errors, detector, simood, rendering, perturbations,
    search, paper, heredity, mumoea,
    monitor, monitor_accuracy, guard, coverage,
    queue, scale, turns, archive, soak, chaos, stalls, dashboard,
):  # fmt: skip
    bench.command()(_command)
