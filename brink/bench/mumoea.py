"""Comparison of muMOEA with its ablations and with MAP-Elites, MOSAT, NSGA-II and random search, at equal budgets.

All methods run on the same road with the same seeds, without a coordinator. Completed searches are stored. Source of
the measures: Tian et al., Tables 3 and 4; types that reference drivers avoid are Brink's.
"""

import csv
import gzip
import hashlib
import json
import math
import time
from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from brink.bench.measurement import Progress, Row, at_least
from brink.bench.trials import code_fingerprint, process_pool, single_threaded
from brink.search.algorithm import Algorithm, Candidate, Evaluation, Failed, Origin, ask_all
from brink.search.algorithms.multi_objective import Child
from brink.search.algorithms.mumoea import Mumoea, MumoeaConfig
from brink.search.algorithms.nsga2 import Mosat, Nsga2
from brink.search.algorithms.qd import Qd
from brink.search.algorithms.random_search import RandomSearch
from brink.search.analysis.statistics import compared
from brink.search.analysis.violations import STANDS_MPS, Avoidable, avoidable_of, kinds_of
from brink.search.streams import episode_seed
from brink.search.traffic.motion import Rollouts, encounter_distances
from brink.search.traffic.participants import MAX_ACTIONS, MAX_PARTICIPANTS
from brink.search.traffic.variation import TrafficGenome
from brink.server.problems.npc_actions import NpcActions, NpcActionsParams
from brink.sim.catalogue import Simulator, make_simulator
from brink.sim.errors import SimulatorError
from brink.worker.child_protocol import completed_document
from brink.worker.wire import Completed

ADAPTIVE: Final = "muMOEA"
ALWAYS: Final = "differential seeds always"
MAP_ELITES: Final = "MAP-Elites"
CODE: Final = (
    "search", "server/campaigns/violations.py", "server/problems", "sim/bullet", "sim/driving", "sim/encounter",
    "sim/requirements.py", "sim/urban", "sim/world",
)  # fmt: skip
"""Code that determines what a search finds; searches stored by other versions of the code are not used."""
MIN_TYPES: Final = 8
LOWER_IS_BETTER: Final = ("per_violation", "first", "last_type", "standing_share")
LABELS: Final[Mapping[str, str]] = {
    "types": "types of violations",
    "careful_types": "types that a careful driver avoids",
    "ideal_types": "types that an ideal driver avoids",
    "standing_share": "share of violations with a standing ego",
    "per_violation": "solutions per violation",
    "first": "simulations to the first violation",
    "last_type": "simulations to the last new type",
    "between_types_m": "mean ED between types, m",
}
"""Labels of `Measures`."""
_POINTS: Final = 40
_COLOURS: Final = ("#0072b2", "#56b4e9", "#cc79a7", "#000000", "#009e73", "#d55e00", "#e69f00", "#7f7f7f")
_LINES: Final = ("-", "--", ":")


class OnlyMutants(Mumoea):
    """muMOEA with major mutants in place of differential seeds."""

    def heuristic_seeds(self, genome: TrafficGenome, count: int, rng: np.random.Generator) -> list[Child]:
        """Return no seeds, so that major mutants take their place."""
        return []


AVOIDABLE: Final[Mapping[str, tuple[Algorithm, Any]]] = {
    MAP_ELITES: (Qd(), Qd.config_type()),
    "muMOEA, avoidable": (Mumoea(), MumoeaConfig()),
    "MOSAT, avoidable": (Mosat(), Mosat.config_type()),
    "NSGA-II, avoidable": (Nsga2(), Nsga2.config_type()),
}
"""Methods that search for violations that a careful driver avoids; random search finds the same in any case."""
METHODS: Final[Mapping[str, tuple[Algorithm, Any]]] = {
    ADAPTIVE: (Mumoea(), MumoeaConfig()),
    "without differential seeds": (Mumoea(), MumoeaConfig(differential="never")),
    ALWAYS: (Mumoea(), MumoeaConfig(differential="always")),
    "major mutants always": (OnlyMutants(), MumoeaConfig(differential="always")),
    "random initial population": (Mumoea(), MumoeaConfig(initial="random")),
    "MOSAT": (Mosat(), Mosat.config_type()),
    "NSGA-II": (Nsga2(), Nsga2.config_type()),
    "random search": (RandomSearch(), RandomSearch.config_type()),
    **AVOIDABLE,
}
"""The methods and their configurations: the defaults, except for the change that the name states."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """A solution that violates a requirement.

    Attributes:
        number: Number of solutions that were simulated before it.
        violations: Circumstances of each violation.
        waypoints: Stations and offsets at the ends of actions, a list for each participant.
    """

    number: int
    violations: list[dict[str, Any]]
    waypoints: list[list[list[float]]]

    @property
    def types(self) -> set[str]:
        """Types of the solution's violations, in words."""
        return set(kinds_of(self.violations))

    def types_avoided_by(self, drivers: Collection[Avoidable]) -> set[str]:
        """Return the types of the solution's violations that one of the given drivers would have avoided."""
        return set(kinds_of(one for one in self.violations if avoidable_of(one) in drivers))


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchRun:
    """Result of a search.

    Attributes:
        method: Name in `METHODS`.
        seed: Seed of the search.
        simulations: Number of simulations.
        failed: Number of simulations without a verdict.
        origins: Number of solutions by origin, if the method records origins.
        found: Solutions that violate a requirement, in the order of simulation.
        cpu_s: CPU time of the simulations, including drives of reference drivers.
        reference_cpu_s: CPU time of the drives of reference drivers.
    """

    method: str
    seed: int
    simulations: int
    failed: int
    origins: dict[str, int]
    found: list[Found]
    cpu_s: float
    reference_cpu_s: float = 0.0

    def first_of_each_type(self) -> dict[str, Found]:
        """Return the first solution of each type of violation, in the order of discovery."""
        firsts: dict[str, Found] = {}
        for solution in self.found:
            for name in sorted(solution.types):
                firsts.setdefault(name, solution)
        return firsts


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """A search to run.

    Attributes:
        method: Name in `METHODS`.
        seed: Seed of the search.
        simulations: Budget.
        params: Parameters of the problem.
        folder: Folder for the result.
    """

    method: str
    seed: int
    simulations: int
    params: NpcActionsParams
    folder: Path

    @property
    def file(self) -> Path:
        """File for the result."""
        return self.folder / f"{self.method.replace(' ', '-').lower()}-{self.seed}-{self.simulations}.json.gz"


def run_or_read(task: Task) -> SearchRun:
    """Return the result of a search, from its file if the search has run before."""
    if task.file.exists():
        with gzip.open(task.file, "rt", encoding="utf-8") as file:
            document = json.load(file)
        return SearchRun(**{**document, "found": [Found(**found) for found in document["found"]]})
    run = run_search(task)
    task.folder.mkdir(parents=True, exist_ok=True)
    part = task.file.with_suffix(".part")
    with gzip.open(part, "wt", encoding="utf-8") as file:
        json.dump(asdict(run), file)
    part.replace(task.file)
    return run


def run_search(task: Task) -> SearchRun:
    """Run a search in this process."""
    problem = _problem(task)
    algorithm, config = METHODS[task.method]
    state = algorithm.start(problem.space, replace(config), seed=task.seed, budget=task.simulations)
    run = SearchRun(
        method=task.method, seed=task.seed, simulations=0, failed=0, origins={}, found=[], cpu_s=0.0
    )
    while not algorithm.finished(state):
        state, _ = ask_all(algorithm, state)
        # Origins of all candidates in flight, of which the pending ones come first.
        for origin in getattr(state, "queue_origins", ())[: len(state.pending)]:
            run.origins[origin.value] = run.origins.get(origin.value, 0) + 1
        answers: dict[int, Evaluation] = {}
        for candidate in state.pending:
            answers[candidate.number], cpu_s, reference_cpu_s = _simulate(
                problem, task.seed, candidate, run.found
            )
            run = replace(
                run,
                simulations=run.simulations + 1,
                failed=run.failed + isinstance(answers[candidate.number], Failed),
                cpu_s=run.cpu_s + cpu_s,
                reference_cpu_s=run.reference_cpu_s + reference_cpu_s,
            )
        state = algorithm.tell(state, answers)
    return run


def _problem(task: Task) -> NpcActions:
    return NpcActions(replace(task.params, count="avoidable") if task.method in AVOIDABLE else task.params)


@cache
def _simulator(simulator_id: str) -> Simulator:
    return make_simulator(simulator_id)


def _simulate(
    problem: NpcActions, seed: int, candidate: Candidate, found: list[Found]
) -> tuple[Evaluation, float, float]:
    """Simulate a candidate; append it to ``found`` if it violates a requirement.

    Returns:
        The evaluation, the CPU time, and that of reference drivers among it; 0 if the simulation failed.
    """
    spec = problem.episode(candidate.vectors, episode_seed(seed, candidate.number))
    began_s = time.process_time()
    try:
        result = _simulator(spec.simulator).run(spec)
    except SimulatorError as error:
        return Failed(reason=str(error)), 0.0, 0.0
    cpu_s = time.process_time() - began_s
    outcome = Completed.model_validate(completed_document(result))
    listed = outcome.features["violations"]
    violations = [dict(one) for one in listed if isinstance(one, dict)] if isinstance(listed, list) else []
    if violations:
        waypoints = problem.waypoints(candidate.vectors)
        found.append(Found(number=candidate.number, violations=violations, waypoints=waypoints))
    return problem.evaluation(outcome), cpu_s, float(str(outcome.provenance.get("reference_cpu_s", 0.0)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Measures:
    """Measures of a search.

    Attributes:
        types: Number of distinct types of violations.
        careful_types: Number of types with a violation that the careful driver avoids.
        ideal_types: Number of types with a violation that the careful or the ideal driver avoids.
        standing_share: Share of violations that happen while the ego stands; NaN without any.
        per_violation: Simulations per violating solution; the whole budget if there is none.
        first: Simulations up to and including the first violation; the whole budget if there is none.
        last_type: Simulations up to and including the first solution of the last new type.
        between_types_m: Mean encounter distance (ED) between the types' first solutions; NaN for fewer than two.
    """

    types: int
    careful_types: int
    ideal_types: int
    standing_share: float
    per_violation: float
    first: int
    last_type: int
    between_types_m: float

    @classmethod
    def of(cls, run: SearchRun) -> "Measures":
        """Return the measures of a search."""
        firsts = run.first_of_each_type()
        return cls(
            types=len(firsts),
            careful_types=_avoided_types(run, (Avoidable.CAREFUL,)),
            ideal_types=_avoided_types(run, (Avoidable.CAREFUL, Avoidable.IDEAL)),
            standing_share=_standing_share(run),
            per_violation=run.simulations / max(1, len(run.found)),
            first=run.found[0].number + 1 if run.found else run.simulations,
            last_type=max((found.number + 1 for found in firsts.values()), default=run.simulations),
            between_types_m=_mean_distance(list(firsts.values())),
        )


def _avoided_types(run: SearchRun, drivers: Collection[Avoidable]) -> int:
    return len(set().union(*(solution.types_avoided_by(drivers) for solution in run.found)))


def _standing_share(run: SearchRun) -> float:
    standing = [
        abs(violation["ego"]["speed_mps"]) < STANDS_MPS
        for solution in run.found
        for violation in solution.violations
    ]
    return float(np.mean(standing)) if standing else math.nan


def _mean_distance(solutions: Sequence[Found]) -> float:
    if len(solutions) < 2:
        return math.nan
    points = np.full((len(solutions), MAX_PARTICIPANTS, MAX_ACTIONS, 2), np.nan)
    actions = np.zeros((len(solutions), MAX_PARTICIPANTS))
    for row, solution in enumerate(solutions):
        for column, ends in enumerate(solution.waypoints):
            points[row, column, : len(ends)] = ends
            actions[row, column] = len(ends)
    rollouts = Rollouts(points=points, actions=actions)
    return float(encounter_distances(rollouts, rollouts)[np.triu_indices(len(solutions), 1)].mean())


class Comparison:
    """Comparison of all methods over several seeds, with tables and figures. Stored searches are not run again.

    Args:
        folder: Folder for searches, tables and figures.
        params: Parameters of the problem.
        seeds: Number of seeds.
        simulations: Simulations per search.
        processes: Number of processes.
        progress: Progress callback.
    """

    def __init__(
        self,
        folder: Path,
        params: NpcActionsParams,
        *,
        seeds: int,
        simulations: int,
        processes: int,
        progress: Progress,
    ) -> None:
        self._folder = folder
        self._processes = processes
        self._progress = progress
        runs = folder / f"runs-{_fingerprint(params)}"
        self._tasks = [
            Task(method=method, seed=seed, simulations=simulations, params=params, folder=runs)
            for seed in range(1, seeds + 1)
            for method in METHODS
        ]
        self._simulations = simulations

    def rows(self) -> list[Row]:
        """Run the missing searches, write tables and figures, and return the figures of the comparison."""
        runs = self._run()
        by_method = {name: [run for run in runs if run.method == name] for name in METHODS}
        measures = {name: [Measures.of(run) for run in found] for name, found in by_method.items()}
        self._write_runs(runs)
        counts = {
            name: [kind for run in found for kind in run.first_of_each_type()]
            for name, found in by_method.items()
        }
        types = sorted({kind for kinds in counts.values() for kind in kinds})
        self._write("types.csv", ["type", *METHODS], [
            [kind, *(counts[name].count(kind) for name in METHODS)] for kind in types
        ])  # fmt: skip
        self._draw(by_method)
        what = "types of violations that all searches found together"
        variety = at_least(what, len(types), MIN_TYPES, "types.csv, types.png")
        return [*_summary(measures), *_reference_costs(by_method), *_tests(measures), variety]

    def _run(self) -> list[SearchRun]:
        done: dict[str, SearchRun] = {}
        with single_threaded(), process_pool(self._processes) as pool:
            waiting = {pool.submit(run_or_read, task): task for task in self._tasks}
            for future in as_completed(waiting):
                done[str(waiting[future].file)] = future.result()
                self._progress("searches", len(done), len(self._tasks))
        return [done[str(task.file)] for task in self._tasks]

    def _write_runs(self, runs: Sequence[SearchRun]) -> None:
        names = [field.name for field in fields(Measures)]
        header = ["method", "seed", "simulations", "failed", *names, *(f"from {origin}" for origin in Origin)]
        header += ["simulations_cpu_s", "reference_cpu_s"]
        rows = []
        for run in runs:
            measures = Measures.of(run)
            rows.append(
                [run.method, run.seed, run.simulations, run.failed, *(getattr(measures, n) for n in names)]
                + [run.origins.get(origin, 0) for origin in Origin]
                + [run.cpu_s, run.reference_cpu_s]
            )
        self._write("searches.csv", header, rows)

    def _write(self, name: str, header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
        with (self._folder / name).open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(header)
            writer.writerows(rows)

    def _draw(self, by_method: Mapping[str, Sequence[SearchRun]]) -> None:
        """Plot the number of types against the number of simulations: mean and range of each method."""
        # Imported here: matplotlib takes half a second to load.
        from matplotlib.figure import Figure

        counts = np.unique(np.linspace(0, self._simulations, _POINTS).astype(int))
        figure = Figure(figsize=(7, 4), layout="constrained")
        axes = figure.subplots()
        for place, (name, runs) in enumerate(by_method.items()):
            colour, line = _COLOURS[place % len(_COLOURS)], _LINES[place // len(_COLOURS)]
            numbers = [sorted(one.number for one in run.first_of_each_type().values()) for run in runs]
            series = np.array([np.searchsorted(of_run, counts) for of_run in numbers])
            axes.plot(counts, series.mean(axis=0), line, color=colour, label=name)
            axes.fill_between(
                counts, series.min(axis=0), series.max(axis=0), color=colour, alpha=0.12, linewidth=0
            )
        axes.set(xlabel="simulations", ylabel="types of violations found", ylim=(0, None), xlim=(0, None))
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, fontsize=8)
        figure.savefig(self._folder / "types.png", dpi=120)


def _fingerprint(params: NpcActionsParams) -> str:
    """Return a fingerprint of the code, the configurations and the problem, which identifies stored searches."""
    settings = [(name, algorithm.id, repr(config)) for name, (algorithm, config) in METHODS.items()]
    text = repr((settings, params, code_fingerprint(CODE)))
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _finite(measures: Sequence[Measures], name: str) -> list[float]:
    values = [float(getattr(one, name)) for one in measures]
    return [value for value in values if math.isfinite(value)]


def _summary(measures: Mapping[str, Sequence[Measures]]) -> list[Row]:
    """Return the mean and the range of every measure for every method."""
    rows = []
    for name, label in LABELS.items():
        for method, found in measures.items():
            values = _finite(found, name)
            mean = float(np.mean(values)) if values else math.nan
            spread = (
                f"min {min(values):.4g}, max {max(values):.4g}, {len(values)} searches" if values else "none"
            )
            rows.append(Row(what=f"{label}, {method}", value=mean, target="", met=None, note=spread))
    return rows


def _reference_costs(by_method: Mapping[str, Sequence[SearchRun]]) -> list[Row]:
    """Return the share of simulation time that drives of reference drivers take, for every method."""
    rows = []
    for method, runs in by_method.items():
        reference_s, cpu_s = sum(run.reference_cpu_s for run in runs), sum(run.cpu_s for run in runs)
        rows.append(
            Row(
                what=f"share of simulation time for reference drivers, {method}",
                value=reference_s / cpu_s if cpu_s else math.nan, target="", met=None,
                note=f"{reference_s:.0f} of {cpu_s:.0f} s of CPU time",
            )
        )  # fmt: skip
    return rows


def _tests(measures: Mapping[str, Sequence[Measures]]) -> list[Row]:
    """Return A12, U and p-value of MAP-Elites, muMOEA and its variant `always` against each of the other methods."""
    avoidable = ("types", "careful_types", "ideal_types")
    subjects = {
        MAP_ELITES: (*avoidable, "standing_share"), ADAPTIVE: tuple(LABELS), ALWAYS: avoidable,
    }  # fmt: skip
    pairs = [
        (subject, name, method)
        for subject, names in subjects.items()
        for name in names
        for method in measures
        # No pair of subjects is tested twice.
        if method not in list(subjects)[: list(subjects).index(subject) + 1]
    ]
    rows = []
    for subject, name, method in pairs:
        ours, theirs = _finite(measures[subject], name), _finite(measures[method], name)
        if ours and theirs:
            tested = compared(theirs, ours) if name in LOWER_IS_BETTER else compared(ours, theirs)
            rows.append(
                Row(
                    what=f"A12 {LABELS[name]}: {subject} better than {method}", value=tested.a12, target="", met=None,
                    note=f"Mann-Whitney U {tested.u:g}, p {tested.p_value:.2g}, uncorrected",
                )
            )  # fmt: skip
    return rows
