"""`brink try`: one episode of a campaign that runs a command or an FMU, to see whether it does what it should."""

import os
import shlex
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from brink.cli.options import CampaignFile, about_file, console, named_values, plain_table
from brink.search.errors import SpaceError
from brink.server.campaigns.body import read_campaign_file
from brink.server.errors import InvalidInput
from brink.sim.episode import EpisodeSpec, Verdict
from brink.sim.errors import SimulatorError
from brink.sim.programs.installed import COMMANDS_VARIABLE
from brink.worker.process import EpisodeProcess, episode_result
from brink.worker.wire import JobFailed

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from brink.search.space import SearchSpace
    from brink.server.problems.command import Command
    from brink.server.problems.fmu import Fmu
    from brink.sim.adapters.command.attempt import Attempt
    from brink.sim.adapters.command.simulator import CommandSimulator

FOLDER: Final = Path("brink-try")
_SHOWN_LINES: Final = 20
_MARK: Final = ".brink-try"
"""A folder with this file may be emptied."""


def try_(
    file: CampaignFile,
    values: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            show_default=False,
            help="Value of a parameter; may be repeated. Others are in the middle of their range.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the episode.")] = 1,
    folder: Annotated[
        Path,
        typer.Option(
            help="Working folder, which is emptied first; a plot of the signals is written beside it."
        ),
    ] = FOLDER,
) -> None:
    """Run one episode of a campaign with command@1 or fmu@1; show its signals and verdicts.

    Exits with 1 if the episode fails.

    Example: brink try cut-in.yaml --set delay=1.5
    """
    import numpy as np

    from brink.server.campaigns.plan import make_checked_plan
    from brink.server.problems.command import Command
    from brink.server.problems.fmu import Fmu
    from brink.sim.adapters.command.simulator import CommandSimulator

    body = read_campaign_file(file)
    with about_file(file):
        problem = make_checked_plan(body).problem
    if not isinstance(problem, Command | Fmu):
        raise InvalidInput.at(
            "/problem/id", f"expected {Command.id} or {Fmu.id}, which can be tried; got {problem.id}"
        )
    given = named_values("--set", values, "scenario.gap=12")
    chosen = _chosen(problem.space, given)
    try:
        spec = problem.episode(problem.space.encode(chosen), seed)
    except SpaceError as error:
        raise InvalidInput.at("--set", str(error)) from None
    if folder.exists() and not (folder / _MARK).exists() and any(folder.iterdir()):
        raise InvalidInput.at(
            "--folder", f"{folder} has files that brink try did not write: name another one"
        )
    screen = console()
    shown = ", ".join(f"{name}={value}" for part in chosen.values() for name, value in part.items())
    screen.print(f"values: {shown}; seed {seed}", soft_wrap=True, markup=False)
    title = f"{body.name}: {shown}"
    if isinstance(problem, Fmu):
        _try_fmu(problem, spec, folder, title)
        return
    screen.print(f"program: {problem.params.program}", soft_wrap=True, markup=False)
    screen.print(f"folder: {folder.absolute()}", soft_wrap=True, markup=False)
    simulator = CommandSimulator(problem.definition, problem.params.program)
    try:
        done = _attempt(simulator, spec, folder)
        again = None if problem.definition.takes_seed else _attempt(simulator, spec, folder)
    except SimulatorError as error:
        screen.print(f"no verdict: {error}", soft_wrap=True, markup=False, style="red")
        raise typer.Exit(1) from None
    screen.print(f"command: {shlex.join(done.command)}", soft_wrap=True, markup=False)
    if printed := done.output.strip():
        screen.print(
            "printed: " + "\n".join(printed.splitlines()[-_SHOWN_LINES:]), soft_wrap=True, markup=False
        )
    margins = {name: one.margins(done.time_s, done.signals) for name, one in done.requirements.items()}
    _show(done.time_s, done.signals, margins, done.verdicts, problem, folder, title)
    if again is not None:
        same = all(np.array_equal(one, again.signals[name]) for name, one in done.signals.items())
        what = "the same" if same else "OTHER"
        words = f"the command takes no {{seed}}; a second run with these values gave {what} signals"
        screen.print(words, markup=False)


def _attempt(simulator: "CommandSimulator", spec: EpisodeSpec, folder: Path) -> "Attempt":
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    (folder / _MARK).touch()
    return simulator.attempt(spec, folder.absolute())


def _chosen(space: "SearchSpace", given: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the values of all parameters, by component: those that were given, others from the middle.

    Those that are absent with the chosen ones are left out.

    Raises:
        InvalidInput: A name is unknown.
    """
    from brink.search.parameters import Categorical

    chosen: dict[str, dict[str, Any]] = {}
    left = dict(given)
    for component in space.components:
        part = chosen.setdefault(component.name, {})
        for parameter in component.parameters:
            if isinstance(parameter, Categorical):
                usual: Any = parameter.choices[0]
            else:
                usual = parameter.decode(parameter.clipped((parameter.least + parameter.most) / 2))
            value = left.pop(f"{component.name}.{parameter.name}", left.pop(parameter.name, usual))
            if all(part.get(label) in choices for label, choices in parameter.when):
                part[parameter.name] = str(value) if isinstance(parameter, Categorical) else value
    if left:
        names = ", ".join(name for part in chosen.values() for name in part)
        raise InvalidInput.at("--set", f"no parameter is called {min(left)!r}; expected one of {names}")
    return chosen


def _try_fmu(problem: "Fmu", spec: EpisodeSpec, folder: Path, title: str) -> None:
    """Run an episode of an FMU, twice unless it takes a seed, in a process of its own, and show it."""
    from brink.sim.trace import Trace

    screen = console()
    screen.print(f"fmu: {problem.params.fmu}", soft_wrap=True, markup=False)
    with tempfile.TemporaryDirectory(prefix="brink-") as commands:
        os.environ[COMMANDS_VARIABLE] = commands
        problem.install()
        process = EpisodeProcess()
        try:
            process.start()
            outcomes = [
                process.run(spec.to_json(), record=True, timeout_s=problem.timeout_s)
                for _ in range(2 if problem.ignores_seeds else 1)
            ]
        finally:
            process.close()
    results = []
    for outcome in outcomes:
        if isinstance(outcome, JobFailed):
            screen.print(f"no verdict: {outcome.message}", soft_wrap=True, markup=False, style="red")
            raise typer.Exit(1)
        results.append(episode_result(outcome))
    trace = Trace.from_bytes(results[0].trace or b"")
    _show(trace.time_s, trace.signals, trace.robustness, results[0].verdicts, problem, folder, title)
    if problem.ignores_seeds:
        what = "the same" if results[0].trace == results[1].trace else "OTHER"
        screen.print(f"a second run with these values gave {what} signals", markup=False)


def _show(
    time_s: "NDArray[Any]",
    signals: "Mapping[str, NDArray[Any]]",
    margins: "Mapping[str, NDArray[Any]]",
    verdicts: Mapping[str, Verdict],
    problem: "Command | Fmu",
    folder: Path,
    title: str,
) -> None:
    # matplotlib takes half a second to load.
    from brink.plots.signals import Recorded, figure_signals
    from brink.plots.style import INK

    screen = console()
    rows = [(name, f"{one.min():.4g}", f"{one.max():.4g}") for name, one in signals.items()]
    screen.print(f"{len(time_s):,} samples from {time_s[0]:g} to {time_s[-1]:g} s")
    screen.print(plain_table("signal", "least", "greatest", right=("least", "greatest"), rows=rows))
    for name, verdict in verdicts.items():
        when = "" if verdict.violated_at_s is None else f" at {verdict.violated_at_s:.2f} s"
        words = f"violated{when}" if verdict.violated else "held"
        screen.print(
            f"{name}: {words}, robustness {verdict.robustness:.4g} {verdict.unit}".rstrip(), markup=False
        )
    violated = {name: one.violated_at_s for name, one in verdicts.items() if one.violated_at_s is not None}
    side = Recorded(
        label="", colour=INK, time_s=time_s, signals=signals, margins=margins, violated_at_s=violated
    )
    path = folder.with_name(f"{folder.name}.png")
    figure_signals([side], problem.params.requirements, title, "").savefig(path)
    screen.print(f"plot: {path}", markup=False)
