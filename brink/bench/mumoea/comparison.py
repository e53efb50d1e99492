"""The comparison of muMOEA with its ablations and baselines: runs, Tables 3 and 4, figures, tests.

Every method gets the same number of simulations on the same road with the same seeds.
"""

import csv
import hashlib
import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import fields
from multiprocessing import get_context
from pathlib import Path
from typing import Final

import numpy as np

from brink.bench.figures import Row
from brink.bench.mumoea.measures import Measures, first_of_each_type, measured, types_over
from brink.bench.mumoea.runs import ADAPTIVE, ALWAYS, METHODS, SearchRun, Task, run_or_read
from brink.bench.telling import Told
from brink.bench.trials import code_fingerprint, single_threaded
from brink.search.algorithm import Origin
from brink.search.analysis.statistics import compared
from brink.server.problems.npc_actions import NpcActionsParams

"""Called with what is being measured, how much of it is done, and how much there is."""

DECIDING: Final = (
    "search", "server/campaigns/violations.py", "server/problems", "sim/bullet", "sim/driving", "sim/encounter",
    "sim/requirements.py", "sim/urban", "sim/world",
)  # fmt: skip
"""Parts of the code that decide what a search finds: searches of other code are not taken for this one's."""

LEAST_TYPES: Final = 8
_POINTS: Final = 40
_COLOURS: Final = ("#0072b2", "#56b4e9", "#cc79a7", "#000000", "#009e73", "#d55e00", "#e69f00", "#7f7f7f")
BETTER_IF_LESS: Final = ("per_violation", "first", "last_type")
WORDS: Final[Mapping[str, str]] = {
    "types": "types of violations",
    "fault_types": "types with the ego at fault",
    "per_violation": "solutions per violation",
    "first": "simulations to the first violation",
    "last_type": "simulations to the last new type",
    "between_types_m": "mean ED between types, m",
}


class Comparison:
    """Runs every method with every seed; what was run is kept in the folder.

    Args:
        folder: Where runs, tables and figures go.
        params: Of the problem.
        seeds: How many.
        simulations: Of each search.
        processes: In how many processes.
        told: Told how far it is.
    """

    def __init__(
        self,
        folder: Path,
        params: NpcActionsParams,
        *,
        seeds: int,
        simulations: int,
        processes: int,
        told: Told,
    ) -> None:
        self._folder = folder
        self._processes = processes
        self._told = told
        runs = folder / f"runs-{_identity(params)}"
        self._tasks = [
            Task(method=method, seed=seed, simulations=simulations, params=params, folder=runs)
            for seed in range(1, seeds + 1)
            for method in METHODS
        ]
        self._simulations = simulations

    def rows(self) -> list[Row]:
        """Run what was not run yet, write tables and figures, and return the figures."""
        runs = self._run()
        by_method = {name: [run for run in runs if run.method == name] for name in METHODS}
        measures = {name: [measured(run) for run in its] for name, its in by_method.items()}
        self._write_runs(runs)
        self._write_types(by_method)
        self._draw(by_method)
        return [*_summary(measures), *_tests(measures), _variety(by_method)]

    def _run(self) -> list[SearchRun]:
        done: dict[str, SearchRun] = {}
        context = get_context("spawn")
        with single_threaded(), ProcessPoolExecutor(self._processes, mp_context=context) as pool:
            waiting = {pool.submit(run_or_read, task): task for task in self._tasks}
            for future in as_completed(waiting):
                done[str(waiting[future].file)] = future.result()
                self._told("searches", len(done), len(self._tasks))
        return [done[str(task.file)] for task in self._tasks]

    def _write_runs(self, runs: Sequence[SearchRun]) -> None:
        names = [field.name for field in fields(Measures)]
        with (self._folder / "searches.csv").open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            origins = [f"from {origin}" for origin in Origin]
            writer.writerow(["method", "seed", "simulations", "failed", *names, *origins])
            for run in runs:
                figures = measured(run)
                writer.writerow(
                    [run.method, run.seed, run.simulations, run.failed, *(getattr(figures, n) for n in names)]
                    + [run.origins.get(origin, 0) for origin in Origin]
                )

    def _write_types(self, by_method: Mapping[str, Sequence[SearchRun]]) -> None:
        """Write how many searches of each method found each type."""
        found = {
            name: [set(first_of_each_type(run.found)) for run in runs] for name, runs in by_method.items()
        }
        every = sorted({kind for sets in found.values() for kinds in sets for kind in kinds})
        with (self._folder / "types.csv").open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["type", *METHODS])
            for kind in every:
                writer.writerow([kind, *(sum(kind in kinds for kinds in found[name]) for name in METHODS)])

    def _draw(self, by_method: Mapping[str, Sequence[SearchRun]]) -> None:
        # matplotlib takes half a second to load: only this needs it.
        from matplotlib.figure import Figure

        counts = np.unique(np.linspace(0, self._simulations, _POINTS).astype(int)).tolist()
        figure = Figure(figsize=(7, 4), layout="constrained")
        axes = figure.subplots()
        for (name, runs), colour in zip(by_method.items(), _COLOURS, strict=True):
            series = np.array([types_over(run, counts) for run in runs])
            axes.plot(counts, series.mean(axis=0), color=colour, label=name)
            axes.fill_between(
                counts, series.min(axis=0), series.max(axis=0), color=colour, alpha=0.12, linewidth=0
            )
        axes.set(xlabel="simulations", ylabel="types of violations found", ylim=(0, None), xlim=(0, None))
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, fontsize=8)
        figure.savefig(self._folder / "types.png", dpi=120)


def _identity(params: NpcActionsParams) -> str:
    """Return what tells searches of this code, these settings and this problem from others."""
    settings = [(name, algorithm.id, repr(config)) for name, (algorithm, config) in METHODS.items()]
    told = repr((settings, params, code_fingerprint(DECIDING)))
    return hashlib.sha256(told.encode()).hexdigest()[:12]


def _figures(measures: Sequence[Measures], name: str) -> list[float]:
    values = [float(getattr(one, name)) for one in measures]
    return [value for value in values if math.isfinite(value)]


def _summary(measures: Mapping[str, Sequence[Measures]]) -> list[Row]:
    """Return mean, least and greatest of every figure of every method."""
    rows = []
    for name, words in WORDS.items():
        for method, its in measures.items():
            values = _figures(its, name)
            mean = float(np.mean(values)) if values else math.nan
            spread = (
                f"min {min(values):.4g}, max {max(values):.4g}, {len(values)} searches" if values else "none"
            )
            rows.append(Row(what=f"{words}, {method}", value=mean, target="", met=None, note=spread))
    return rows


def _tests(measures: Mapping[str, Sequence[Measures]]) -> list[Row]:
    """Return how likely muMOEA is to be better than each other method, with the test's p; so for asking always."""
    pairs = [
        (subject, name, method)
        for subject, names in ((ADAPTIVE, tuple(WORDS)), (ALWAYS, ("types", "fault_types")))
        for name in names
        for method in measures
        if method != subject and not (subject == ALWAYS and method == ADAPTIVE)
    ]
    rows = []
    for subject, name, method in pairs:
        mine, theirs = _figures(measures[subject], name), _figures(measures[method], name)
        if mine and theirs:
            less = name in BETTER_IF_LESS
            tested = compared(theirs, mine) if less else compared(mine, theirs)
            rows.append(
                Row(
                    what=f"A12 {WORDS[name]}: {subject} better than {method}", value=tested.a12, target="", met=None,
                    note=f"Mann-Whitney p {tested.p_value:.2g}, uncorrected",
                )
            )  # fmt: skip
    return rows


def _variety(by_method: Mapping[str, Sequence[SearchRun]]) -> Row:
    """Return how many types all searches together found."""
    every = {kind for runs in by_method.values() for run in runs for kind in first_of_each_type(run.found)}
    return Row(
        what="types of violations that all searches found together", value=len(every),
        target=f"at least {LEAST_TYPES}", met=len(every) >= LEAST_TYPES, note="types.csv, types.png",
    )  # fmt: skip
