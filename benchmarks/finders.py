"""The searches for thresholds and pairs on one problem at equal budgets: `edge@2`, its rivals, and the baselines.

Each rival runs alone, and followed by the same estimation of thresholds on the same total budget (`finder_runs`).
What a search found is a `Tally`; a further way to count it is a further attribute. Completed runs are kept in a
folder, so the same comparison continues after an interruption.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from statistics import fmean
from typing import Any, Final, Self

import numpy as np
from rich.table import Table

from benchmarks.finder_runs import (
    FRESH,
    End,
    Estimated,
    Part,
    Run,
    Runner,
    estimated_thresholds,
    found_pairs,
    narrow_pairs,
    pairs_to_sharpen,
)
from benchmarks.measurement import Progress
from benchmarks.trials import code_fingerprint, mapped, stored
from brink.api.terminal import plain_table
from brink.report.text import p_text
from brink.search.analysis.comparison import difference
from brink.search.analysis.statistics import compared, effect_size, holm
from brink.search.analysis.threshold_comparison import close_ones, distinct_ones
from brink.search.space import SearchSpace
from brink.server.findings.words import counted
from brink.sim.episode import digest_of

FINDERS: Final[Mapping[str, str]] = {
    "edge@2": "edge@2",
    "edge@1": "edge@1",
    "nearest opposite": "nearest-opposite@1",
    "DeepJanus": "deepjanus@1",
    "straddle": "straddle@1",
    "BSV": "bsv@1",
    "MLCSHE": "mlcshe@1",
    "GA": "ga@1",
    "random search": "random@1",
}
"""The algorithms by their names in tables; each runs with its default settings."""
THRESHOLDS: Final = "edge@2"
"""The search that estimates thresholds itself."""
FOLLOWED: Final = " + estimation"
"""What follows the name of a search that the estimation of thresholds follows."""
SHARE: Final = 0.5
"""Share of the budget that a followed search spends itself."""
CODE: Final = (
    "benchmarks/finder_runs.py",
    "search",
    "server/campaigns/thresholds.py",
    "server/problems",
    "sim",
)
"""Code that determines what a run finds; runs stored by other versions of the code are not used."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A problem to compare on.

    Attributes:
        id: Its id.
        params: Its parameters.
        eps: Largest distance between the sides of a pair.
        d_th: Smallest distance between two distinct pairs, or thresholds of one kind.
    """

    id: str
    params: Mapping[str, Any] = field(default_factory=dict)
    eps: float = 0.02
    d_th: float = 0.2


CASES: Final[Mapping[str, Case]] = {
    "urban-errors": Case(id="urban-errors@1"),
    "front-gap": Case(id="urban-injected@1", params={"requirement": "front-gap@1"}),
    "lane-keeping": Case(id="urban-injected@1", params={"requirement": "lane-keeping@1"}),
    "mtq": Case(id="mtq@1", eps=0.002, d_th=0.05),
}
"""The problems by name."""


@cache
def runner_of(problem: str) -> Runner:
    """Return what runs searches on a problem in `CASES`."""
    return Runner(CASES[problem].id, CASES[problem].params)


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """A run of the comparison.

    Attributes:
        problem: Name in `CASES`.
        method: Name in `FINDERS`.
        followed: Whether the estimation of thresholds follows.
        seed: Seed of the search.
        budget: Simulations, those of the estimation included.
        folder: Folder for the result.
    """

    problem: str
    method: str
    followed: bool
    seed: int
    budget: int
    folder: Path

    @property
    def label(self) -> str:
        """Name in tables."""
        return self.method + (FOLLOWED if self.followed else "")

    @property
    def file(self) -> Path:
        """File for the result."""
        case = CASES[self.problem]
        chosen = [case.id, dict(case.params), FINDERS[self.method], self.followed, self.budget, SHARE]
        return self.folder / f"{self.problem}-{digest_of(repr(chosen))[:12]}-{self.seed}.json.gz"


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """What a run found.

    Attributes:
        task: The run.
        run: What was simulated.
        thresholds: The thresholds.
        pairs: Distinct pairs: those of the search, or of all solutions where verdicts are computed.
        narrow: Both ends of each pair of which one number moves, by at most 5% of its range; empty if followed.
    """

    task: Task
    run: Run
    thresholds: list[Estimated]
    pairs: int
    narrow: list[list[End]]


def run_or_read(task: Task) -> Found:
    """Return the result of a run, from its file if it has run before."""
    document = stored(task.file, lambda: _document(task))
    run = document["run"]
    return Found(
        task=task,
        run=Run(**{**run, "parts": [Part(**part) for part in run["parts"]]}),
        thresholds=[_estimated(one) for one in document["thresholds"]],
        pairs=document["pairs"],
        narrow=[[End(**end) for end in ends] for ends in document["narrow"]],
    )


def _estimated(document: dict[str, Any]) -> Estimated:
    return Estimated(**{**document, "ends": [End(**end) for end in document["ends"]]})


def _document(task: Task) -> dict[str, Any]:
    """Run a search, and return what it found as a document."""
    runner, case, run = runner_of(task.problem), CASES[task.problem], Run()
    space = runner.problem.space
    own = round(SHARE * task.budget) if task.followed else task.budget
    searched = runner.search(run, FINDERS[task.method], {}, seed=task.seed, budget=own)
    if task.followed:
        begun = pairs_to_sharpen(space, searched, eps=case.eps, d_th=case.d_th)
        runner.sharpen(run, begun, seed=task.seed, budget=task.budget - run.simulations)
    counted = run.whole() if runner.is_computed else searched
    found = found_pairs(space, counted, eps=case.eps, d_th=case.d_th)
    narrow: list[list[End]] = []
    for safe, unsafe in [] if task.followed else narrow_pairs(space, counted, found):
        first = 10**6 + 2 * FRESH * len(narrow)
        sides = ((safe, first, False), (unsafe, first + FRESH, True))
        narrow.append([runner.end(row, task.seed, at, unsafe=kind)[0] for row, at, kind in sides])
    return {
        "run": asdict(run),
        "thresholds": [asdict(one) for one in estimated_thresholds(runner, run)],
        "pairs": len(found.pairs),
        "narrow": [[asdict(end) for end in ends] for ends in narrow],
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class Tally:
    """The count of what a run found.

    Attributes:
        method: Name of the algorithm, with what follows it.
        seed: The seed.
        simulations: Simulations, without those of the ends.
        pairs: Distinct pairs.
        narrow: Pairs that the test confirmed of which one number moves, by at most 5% of its range; None if the
            estimation followed.
        thresholds: Thresholds.
        hold: Of these, those whose 20 fresh simulations an end show at most 20% and at least 80% unsafe.
        confirmed: Of these, those that the sequential test confirmed within these simulations.
        distinct: Confirmed ones of different kinds, or further apart than distinct pairs.
        kinds: Kinds of confirmed ones.
        search_cpu_s: CPU time of the search steps.
        search_s: Their wall-clock time.
        percent: Their CPU time in percent of that of the simulations; None where verdicts are computed.
    """

    method: str
    seed: int
    simulations: int
    pairs: int
    narrow: int | None
    thresholds: int
    hold: int
    confirmed: int
    distinct: int
    kinds: int
    search_cpu_s: float
    search_s: float
    percent: float | None

    @classmethod
    def of(cls, found: Found) -> Self:
        """Return the tally of a run."""
        case, run = CASES[found.task.problem], found.run
        confirmed = [one for one in found.thresholds if one.confirmed]
        runner = runner_of(found.task.problem)
        return cls(
            method=found.task.label,
            seed=found.task.seed,
            simulations=run.simulations,
            pairs=found.pairs,
            narrow=None
            if found.task.followed
            else sum(all(end.holds for end in ends) for ends in found.narrow),
            thresholds=len(found.thresholds),
            hold=sum(one.holds for one in found.thresholds),
            confirmed=len(confirmed),
            distinct=_distinct(confirmed, runner.problem.space, case.d_th),
            kinds=len({tuple(one.kind) for one in confirmed}),
            search_cpu_s=run.search_cpu_s,
            search_s=run.search_s,
            percent=None if runner.is_computed else 100 * run.search_cpu_s / run.drives_cpu_s,
        )


def _distinct(thresholds: Sequence[Estimated], space: SearchSpace, d_th: float) -> int:
    """Return how many thresholds differ in kind or are at least d_th apart; each counts the first that is new."""
    placed = [(one, row) for one in thresholds if (row := one.at(space, one.middle)) is not None]
    kinds = [tuple(one.kind) for one, _ in placed]
    close = close_ones(kinds, np.array([row for _, row in placed]), space, d_th)
    return len(distinct_ones(dict(enumerate(close))))


COLUMNS: Final[Mapping[str, tuple[str, str]]] = {
    "pairs": ("distinct pairs", ".1f"),
    "narrow": ("one number by at most 5%, confirmed", ".1f"),
    "thresholds": ("thresholds", ".1f"),
    "hold": ("hold at both ends", ".1f"),
    "confirmed": ("confirmed", ".1f"),
    "distinct": ("distinct", ".1f"),
    "kinds": ("kinds", ".1f"),
    "search_cpu_s": ("search, CPU s", ".2f"),
    "search_s": ("search, s", ".2f"),
    "percent": ("% of simulation", ".1f"),
}
"""Titles and formats of the columns, by attributes of `Tally`."""


class Comparison:
    """The runs of a comparison.

    Args:
        problem: Name in `CASES`.
        methods: Names in `FINDERS`.
        seeds: Searches with each method, with seeds from 1.
        budget: Simulations of each run, those of the estimation included.
        folder: Folder for runs.
        alone: Whether each rival also runs without the estimation.
    """

    def __init__(
        self,
        problem: str,
        methods: Sequence[str],
        *,
        seeds: int,
        budget: int,
        folder: Path,
        alone: bool = True,
    ) -> None:
        kept = folder / f"runs-{code_fingerprint(CODE)}"
        self.problem = problem
        self.tasks = [
            Task(problem=problem, method=method, followed=followed, seed=seed, budget=budget, folder=kept)
            for seed in range(1, seeds + 1)
            for method in methods
            for followed in ((False,) if method == THRESHOLDS else (False, True) if alone else (True,))
        ]

    @property
    def measure(self) -> str:
        """Attribute of `Tally` on which methods are compared: distinct pairs where verdicts are computed."""
        return "pairs" if runner_of(self.problem).is_computed else "distinct"

    def run(
        self, progress: Progress, *, processes: int = 1, run: Callable[[Task], Found] = run_or_read
    ) -> list[Found]:
        """Run what is missing, and return all runs in order."""
        return mapped(run, self.tasks, processes=processes, part=self.problem, progress=progress)


def standings(tallies: Sequence[Tally]) -> list[dict[str, Any]]:
    """Return the mean of each column over the runs of each method, in their order; None where it says nothing."""
    return [
        {"method": method, "runs": len(ours)} | {name: _mean(ours, name) for name in COLUMNS}
        for method, ours in _by_method(tallies).items()
    ]


def _mean(tallies: Sequence[Tally], name: str) -> float | None:
    values = [value for one in tallies if (value := getattr(one, name)) is not None]
    return fmean(values) if values else None


def _by_method(tallies: Sequence[Tally]) -> dict[str, list[Tally]]:
    grouped: dict[str, list[Tally]] = {}
    for one in tallies:
        grouped.setdefault(one.method, []).append(one)
    return grouped


def table(problem: str, tallies: Sequence[Tally]) -> Table:
    """Return the means as a table."""
    titles = [title for title, _ in COLUMNS.values()]
    seeds = len({one.seed for one in tallies})
    shown = plain_table("", *titles, right=titles, title=f"{problem}: means of {counted(seeds, 'seed')}")
    for row in standings(tallies):
        cells = [
            "–" if (value := row[name]) is None else format(value, form)
            for name, (_, form) in COLUMNS.items()
        ]
        shown.add_row(row["method"], *cells)
    return shown


def duels(tallies: Sequence[Tally], measure: str) -> list[str]:
    """Return how `edge@2` compares with each rival that the estimation followed, in sentences.

    Rivals alone are not compared: nobody else estimates thresholds. The p-values are corrected over all comparisons.

    Args:
        tallies: The runs.
        measure: Attribute of `Tally` to compare.
    """
    values = {
        name: [float(getattr(one, measure)) for one in ours] for name, ours in _by_method(tallies).items()
    }
    if (mine := values.get(THRESHOLDS)) is None:
        return []
    results = {name: compared(mine, theirs) for name, theirs in values.items() if name.endswith(FOLLOWED)}
    adjusted = holm([one.p_value for one in results.values()])
    return [
        f"{THRESHOLDS} and {name}: {fmean(mine):.1f} against {fmean(values[name]):.1f} "
        f"{'distinct pairs' if measure == 'pairs' else 'distinct confirmed thresholds'}"
        + (
            ""
            if p_value is None
            else f", A12 {result.a12:.2f} ({effect_size(result.a12)}), corrected p {p_text(p_value)}"
        )
        + f"; {difference(result, p_value, THRESHOLDS, name)}"
        for (name, result), p_value in zip(results.items(), adjusted, strict=True)
    ]
