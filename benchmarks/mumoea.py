"""Comparison of muMOEA with its ablations and with MAP-Elites, MOSAT, NSGA-II and random search, at equal budgets.

All methods run on the same road with the same seeds, without a coordinator. Completed searches are stored. Two
methods take their seeds over the path of language models, from a stand-in that answers with hand-written patterns: no
trained model is part of this comparison (`benchmarks.stand_in`). Source of the measures: Tian et al., Tables 3 and 4
and Fig. 2b; types that reference drivers avoid are Brink's.
"""

import hashlib
import itertools
import math
import re
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from benchmarks.measurement import Progress, Row, at_least
from benchmarks.stand_in import StandInSeeds, serving
from benchmarks.trials import cached_simulator, code_fingerprint, mapped, stored
from brink.report.text import p_text
from brink.search.algorithm import AnyAlgorithm, Candidate, Evaluation, Failed, Origin, Seeded, ask_all
from brink.search.algorithms.multi_objective import Child
from brink.search.algorithms.mumoea import Mumoea, MumoeaConfig
from brink.search.algorithms.nsga2 import Mosat, Nsga2
from brink.search.algorithms.qd import Qd
from brink.search.algorithms.random_search import RandomSearch
from brink.search.analysis.avoidable import Avoidable, AvoidedBy, avoidable_of, avoided_by_of
from brink.search.analysis.statistics import compared
from brink.search.analysis.violations import STANDS_MPS, kinds_of
from brink.search.streams import episode_seed
from brink.search.traffic.motion import Distance, Rollouts, encounter_distances, positions
from brink.search.traffic.participants import MAX_PARTICIPANTS
from brink.search.traffic.variation import TrafficGenome
from brink.server.csv_text import csv_text
from brink.server.problems.npc_actions import NpcActions, NpcActionsParams
from brink.sim.errors import SimulatorError
from brink.worker.child_protocol import completed_document
from brink.worker.wire import Completed

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ADAPTIVE: Final = "muMOEA"
ALWAYS: Final = "differential seeds always"
STAND_IN: Final = "stand-in for a language model"
STAND_IN_ALWAYS: Final = f"{STAND_IN}, always"
NO_MODEL: Final = "no trained model: hand-written patterns over the path of a language model"
MAP_ELITES: Final = "MAP-Elites"
CODE: Final = (
    "benchmarks/stand_in.py",
    "search",
    "server/campaigns/violations.py",
    "server/llm",
    "server/problems",
    "sim/bullet",
    "sim/driving",
    "sim/encounter",
    "sim/requirements.py",
    "sim/urban",
    "sim/world",
)
"""Code that determines what a search finds; searches stored by other versions of the code are not used."""
MIN_TYPES: Final = 8
LOWER_IS_BETTER: Final = ("per_violation", "first", "last_type", "standing_share")
LABELS: Final[Mapping[str, str]] = {
    "types": "types of violations",
    "careful_types": "types that a careful driver avoids",
    "braking_types": "types that a careful driver avoids by braking",
    "ideal_types": "types that an ideal driver avoids",
    "standing_share": "share of violations with a standing ego",
    "per_violation": "solutions per violation",
    "first": "simulations to the first violation",
    "last_type": "simulations to the last new type",
    "between_types_m": "mean ED between types at equal times, m",
    "between_types_paper_m": "mean ED between types as in the paper, m",
}
"""Labels of `Measures`."""
_MOSAT: Final = "MOSAT"
PAPER: Final[Mapping[str, Mapping[str, float]]] = {
    "types": {ADAPTIVE: 10, "without differential seeds": 6, "random initial population": 10, _MOSAT: 6},
    "per_violation": {
        ADAPTIVE: 12,
        "without differential seeds": 24.3,
        "random initial population": 12.7,
        _MOSAT: 62.1,
    },
    "between_types_paper_m": {ADAPTIVE: 81, _MOSAT: 65},
}
"""The paper's values by measure and method: of Apollo, with seeds from a language model, types assigned by hand."""
_POINTS: Final = 40
_COLOURS: Final = ("#0072b2", "#56b4e9", "#cc79a7", "#000000", "#009e73", "#d55e00", "#e69f00", "#7f7f7f")
_LINES: Final = ("-", "--", ":")


class OnlyMutants(Mumoea):
    """muMOEA with major mutants in place of differential seeds."""

    def heuristic_seeds(self, genome: TrafficGenome, count: int, rng: np.random.Generator) -> list[Child]:
        """Return no seeds, so that major mutants take their place."""
        return []


AVOIDABLE: Final[Mapping[str, tuple[AnyAlgorithm, Any]]] = {
    MAP_ELITES: (Qd(), Qd.config_type()),
    "muMOEA, avoidable": (Mumoea(), MumoeaConfig()),
    "MOSAT, avoidable": (Mosat(), Mosat.config_type()),
    "NSGA-II, avoidable": (Nsga2(), Nsga2.config_type()),
}
"""Methods that search for violations that a careful driver avoids; random search finds the same in any case."""
METHODS: Final[Mapping[str, tuple[AnyAlgorithm, Any]]] = {
    ADAPTIVE: (Mumoea(), MumoeaConfig()),
    "without differential seeds": (Mumoea(), MumoeaConfig(differential="never")),
    ALWAYS: (Mumoea(), MumoeaConfig(differential="always")),
    "major mutants always": (OnlyMutants(), MumoeaConfig(differential="always")),
    "random initial population": (Mumoea(), MumoeaConfig(initial="random")),
    STAND_IN: (Mumoea(), MumoeaConfig(seeder="llm")),
    STAND_IN_ALWAYS: (Mumoea(), MumoeaConfig(seeder="llm", differential="always")),
    _MOSAT: (Mosat(), Mosat.config_type()),
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
        positions: Stations and offsets at equal times, a list for each participant.
        cpu_s: CPU time of the search up to and including its simulation.
    """

    number: int
    violations: list[dict[str, Any]]
    waypoints: list[list[list[float]]]
    positions: list[list[list[float]]]
    cpu_s: float

    @property
    def types(self) -> set[str]:
        """Types of the solution's violations, in words."""
        return set(kinds_of(self.violations))

    def types_avoided_by(self, drivers: Collection[Avoidable]) -> set[str]:
        """Return the types of the solution's violations that one of the given drivers would have avoided."""
        return set(kinds_of(one for one in self.violations if avoidable_of(one) in drivers))

    def types_avoided_by_braking(self) -> set[str]:
        """Return the types of the solution's violations that the careful driver avoids by braking."""
        return set(
            kinds_of(
                one
                for one in self.violations
                if avoidable_of(one) is Avoidable.CAREFUL and avoided_by_of(one) is AvoidedBy.BRAKING
            )
        )


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
        cpu_s: CPU time of the search and its simulations.
        simulations_cpu_s: CPU time of the simulations, including drives of reference drivers.
        reference_cpu_s: CPU time of the drives of reference drivers.
        calls: Calls to the stand-in for a language model.
        tokens: Tokens of these calls, estimated from numbers of characters.
        waited_s: Wall-clock time that these calls took.
    """

    method: str
    seed: int
    simulations: int
    failed: int
    origins: dict[str, int]
    found: list[Found]
    cpu_s: float
    simulations_cpu_s: float = 0.0
    reference_cpu_s: float = 0.0
    calls: int = 0
    tokens: int = 0
    waited_s: float = 0.0

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
        name = re.sub(r"\W+", "-", self.method.lower())
        return self.folder / f"{name}-{self.seed}-{self.simulations}.json.gz"


def run_or_read(task: Task) -> SearchRun:
    """Return the result of a search, from its file if the search has run before."""
    document = stored(task.file, lambda: asdict(run_search(task)))
    return SearchRun(**{**document, "found": [Found(**found) for found in document["found"]]})


def run_search(task: Task) -> SearchRun:
    """Run a search in this process."""
    problem = _problem(task)
    algorithm, config = METHODS[task.method]
    began_s = time.process_time()
    with _seeds(problem, config, task.seed) as seeds:
        run = SearchRun(
            method=task.method, seed=task.seed, simulations=0, failed=0, origins={}, found=[], cpu_s=0.0
        )
        state = algorithm.start(problem.space, replace(config), seed=task.seed, budget=task.simulations)
        while not algorithm.finished(state):
            if isinstance(algorithm, Seeded) and (request := algorithm.wanted(state)) is not None:
                assert seeds is not None
                state = algorithm.seeded(state, seeds.proposals(request))
                continue
            state, _ = ask_all(algorithm, state)
            # Origins of all candidates in flight, of which the pending ones come first.
            for origin in getattr(state, "queue_origins", ())[: len(state.pending)]:
                run.origins[origin.value] = run.origins.get(origin.value, 0) + 1
            simulated = {
                candidate.number: _simulate(problem, task.seed, candidate, run.found, began_s)
                for candidate in state.pending
            }
            run = replace(
                run,
                simulations=run.simulations + len(simulated),
                failed=run.failed + sum(isinstance(one.evaluation, Failed) for one in simulated.values()),
                simulations_cpu_s=run.simulations_cpu_s + sum(one.cpu_s for one in simulated.values()),
                reference_cpu_s=run.reference_cpu_s + sum(one.reference_cpu_s for one in simulated.values()),
            )
            state = algorithm.tell(state, {number: one.evaluation for number, one in simulated.items()})
        run = replace(run, cpu_s=time.process_time() - began_s)
        if seeds is None:
            return run
        spent = seeds.spent
        return replace(run, calls=spent.total_calls, tokens=spent.total_tokens, waited_s=seeds.waited_s)


@contextmanager
def _seeds(problem: NpcActions, config: Any, seed: int) -> Iterator[StandInSeeds | None]:
    """Yield the source of seeds for a search that asks for them; None if it asks for none."""
    if getattr(config, "seeder", None) != "llm":
        yield None
        return
    with serving(problem.road, problem.max_participants) as endpoint:
        yield StandInSeeds(problem, endpoint, seed)


def _problem(task: Task) -> NpcActions:
    return NpcActions(replace(task.params, count="avoidable") if task.method in AVOIDABLE else task.params)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Simulated:
    """A simulated candidate.

    Attributes:
        evaluation: What the search is told.
        cpu_s: CPU time; 0 if the simulation failed.
        reference_cpu_s: That of the drives of reference drivers among it.
    """

    evaluation: Evaluation
    cpu_s: float = 0.0
    reference_cpu_s: float = 0.0


def _simulate(
    problem: NpcActions, seed: int, candidate: Candidate, found: list[Found], began_s: float
) -> _Simulated:
    """Simulate a candidate; append it to ``found`` if it violates a requirement."""
    spec = problem.episode(candidate.vectors, episode_seed(seed, candidate.number))
    before_s = time.process_time()
    try:
        result = cached_simulator(spec.simulator).run(spec)
    except SimulatorError as error:
        return _Simulated(evaluation=Failed(reason=str(error)))
    after_s = time.process_time()
    outcome = Completed.model_validate(completed_document(result))
    listed = outcome.features["violations"]
    violations = [dict(one) for one in listed if isinstance(one, dict)] if isinstance(listed, list) else []
    if violations:
        participants = problem.participants(candidate.vectors)
        found.append(
            Found(
                number=candidate.number,
                violations=violations,
                waypoints=problem.waypoints(candidate.vectors),
                positions=[positions(one, problem.road).tolist() for one in participants],
                cpu_s=after_s - began_s,
            )
        )
    return _Simulated(
        evaluation=problem.evaluation(outcome),
        cpu_s=after_s - before_s,
        reference_cpu_s=float(str(outcome.provenance.get("reference_cpu_s", 0.0))),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Measures:
    """Measures of a search.

    Attributes:
        types: Number of distinct types of violations.
        careful_types: Number of types with a violation that the careful driver avoids.
        braking_types: Number of types with a violation that the careful driver avoids by braking.
        ideal_types: Number of types with a violation that the careful or the ideal driver avoids.
        standing_share: Share of violations that happen while the ego stands; NaN without any.
        per_violation: Simulations per violating solution; the whole budget if there is none.
        first: Simulations up to and including the first violation; the whole budget if there is none.
        last_type: Simulations up to and including the first solution of the last new type.
        between_types_m: Mean encounter distance (ED) between the types' first solutions, of positions at equal times;
            NaN for fewer than two.
        between_types_paper_m: The same with the paper's sum over actions.
    """

    types: int
    careful_types: int
    braking_types: int
    ideal_types: int
    standing_share: float
    per_violation: float
    first: int
    last_type: int
    between_types_m: float
    between_types_paper_m: float

    @classmethod
    def of(cls, run: SearchRun) -> "Measures":
        """Return the measures of a search."""
        firsts = run.first_of_each_type()
        return cls(
            types=len(firsts),
            careful_types=_avoided_types(run, (Avoidable.CAREFUL,)),
            braking_types=len(set().union(*(one.types_avoided_by_braking() for one in run.found))),
            ideal_types=_avoided_types(run, (Avoidable.CAREFUL, Avoidable.IDEAL)),
            standing_share=_standing_share(run),
            per_violation=run.simulations / max(1, len(run.found)),
            first=run.found[0].number + 1 if run.found else run.simulations,
            last_type=max((found.number + 1 for found in firsts.values()), default=run.simulations),
            between_types_m=_mean_distance([found.positions for found in firsts.values()], Distance.TIME),
            between_types_paper_m=_mean_distance(
                [found.waypoints for found in firsts.values()], Distance.PAPER
            ),
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


def _mean_distance(solutions: Sequence[list[list[list[float]]]], measure: Distance) -> float:
    """Return the mean ED between solutions, given the points of their participants."""
    if len(solutions) < 2:
        return math.nan
    rollouts = Rollouts.of_points(solutions, MAX_PARTICIPANTS, measure)
    return float(encounter_distances(rollouts, rollouts)[np.triu_indices(len(solutions), 1)].mean())


@dataclass(frozen=True, slots=True, kw_only=True)
class Overlap:
    """How many of a method's types of violations another method finds too.

    Attributes:
        method: The method.
        other: The other method.
        types: Types that all searches with the method found together.
        shared: Those of them that the other method's searches found together.
        single: Share of the types of a single search that a single search with the other method found: the mean over
            all pairs of searches with different seeds, since equal seeds may give equal first generations; NaN
            without any.
    """

    method: str
    other: str
    types: int
    shared: int
    single: float

    @property
    def share(self) -> float:
        """Share of the types that the other method finds too; NaN without types."""
        return self.shared / self.types if self.types else math.nan

    @classmethod
    def of(cls, runs: Sequence[SearchRun], others: Sequence[SearchRun]) -> "Overlap":
        """Return the overlap of the searches with one method with those with another, or with the same."""
        mine, theirs = ([set(run.first_of_each_type()) for run in found] for found in (runs, others))
        shares = [
            len(these & those) / len(these)
            for (these, run), (those, other) in itertools.product(
                zip(mine, runs, strict=True), zip(theirs, others, strict=True)
            )
            if these and run.seed != other.seed
        ]
        known = set().union(*mine)
        return cls(
            method=runs[0].method,
            other=others[0].method,
            types=len(known),
            shared=len(known & set().union(*theirs)),
            single=float(np.mean(shares)) if shares else math.nan,
        )


class Comparison:
    """Comparison of methods over several seeds, with tables and figures. Stored searches are not run again.

    Args:
        folder: Folder for searches, tables and figures.
        params: Parameters of the problem.
        seeds: Number of seeds.
        simulations: Simulations per search.
        processes: Number of processes.
        progress: Progress callback.
        methods: Names in `METHODS`; None for all.
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
        methods: Sequence[str] | None = None,
    ) -> None:
        self._folder = folder
        self._methods = tuple(METHODS if methods is None else methods)
        self._processes = processes
        self._progress = progress
        runs = folder / f"runs-{_fingerprint(params)}"
        self._tasks = [
            Task(method=method, seed=seed, simulations=simulations, params=params, folder=runs)
            for seed in range(1, seeds + 1)
            for method in self._methods
        ]
        self._simulations = simulations

    def rows(self) -> list[Row]:
        """Run the missing searches, write tables and figures, and return the figures of the comparison."""
        runs = self._run()
        by_method = {name: [run for run in runs if run.method == name] for name in self._methods}
        measures = {name: [Measures.of(run) for run in found] for name, found in by_method.items()}
        self._write_runs(runs)
        counts = {
            name: [kind for run in found for kind in run.first_of_each_type()]
            for name, found in by_method.items()
        }
        types = sorted({kind for kinds in counts.values() for kind in kinds})
        self._write(
            "types.csv",
            ["type", *self._methods],
            [[kind, *(counts[name].count(kind) for name in self._methods)] for kind in types],
        )
        overlaps = [Overlap.of(*pair) for pair in itertools.product(by_method.values(), repeat=2)]
        self._write_overlaps(overlaps)
        self._draw_types(by_method)
        self._draw_violations(by_method)
        what = "types of violations that all searches found together"
        variety = at_least(what, len(types), MIN_TYPES, "types.csv, types.png")
        return [
            *_summary(measures),
            *_reference_costs(by_method),
            *_of_stand_ins(runs),
            *_of_overlaps(overlaps),
            *_tests(measures),
            variety,
        ]

    def _run(self) -> list[SearchRun]:
        return mapped(
            run_or_read, self._tasks, processes=self._processes, part="searches", progress=self._progress
        )

    def _write_runs(self, runs: Sequence[SearchRun]) -> None:
        names = [field.name for field in fields(Measures)]
        header = ["method", "seed", "simulations", "failed", *names, *(f"from {origin}" for origin in Origin)]
        header += ["cpu_s", "simulations_cpu_s", "reference_cpu_s", "seeds by", "calls", "tokens", "waited_s"]
        rows = []
        for run in runs:
            measures = Measures.of(run)
            rows.append(
                [run.method, run.seed, run.simulations, run.failed, *(getattr(measures, n) for n in names)]
                + [run.origins.get(origin, 0) for origin in Origin]
                + [
                    run.cpu_s,
                    run.simulations_cpu_s,
                    run.reference_cpu_s,
                    "stand-in, no trained model" if run.calls else "",
                    run.calls,
                    run.tokens,
                    run.waited_s,
                ]
            )
        self._write("searches.csv", header, rows)

    def _write(self, name: str, header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
        (self._folder / name).write_text(csv_text([header, *rows]), encoding="utf-8", newline="")

    def _write_overlaps(self, overlaps: Sequence[Overlap]) -> None:
        header = ["method", "other", "types", "other found too", "share", "share in a single search"]
        self._write(
            "overlap.csv",
            header,
            [[one.method, one.other, one.types, one.shared, one.share, one.single] for one in overlaps],
        )

    def _draw_types(self, by_method: Mapping[str, Sequence[SearchRun]]) -> None:
        """Plot the number of types against the number of simulations: mean and range of each method."""
        # Imported here: matplotlib takes half a second to load.
        from brink.pictures.figure import LiteralFigure

        figure = LiteralFigure(figsize=(9, 4), layout="constrained")
        axes = figure.subplots()
        found = {
            name: [[one.number for one in run.first_of_each_type().values()] for run in runs]
            for name, runs in by_method.items()
        }
        _draw_counts(axes, found, dict.fromkeys(found, self._simulations))
        axes.set(xlabel="simulations", ylabel="types of violations found")
        figure.legend(
            *axes.get_legend_handles_labels(), loc="outside right center", frameon=False, fontsize=8
        )
        figure.savefig(self._folder / "types.png", dpi=120)

    def _draw_violations(self, by_method: Mapping[str, Sequence[SearchRun]]) -> None:
        """Plot the number of violating solutions against simulations and CPU time, like the paper's Fig. 2b."""
        from brink.pictures.figure import LiteralFigure

        figure = LiteralFigure(figsize=(12, 4), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        numbers = {
            name: [[one.number for one in run.found] for run in runs] for name, runs in by_method.items()
        }
        times_s = {
            name: [[one.cpu_s for one in run.found] for run in runs] for name, runs in by_method.items()
        }
        _draw_counts(left, numbers, dict.fromkeys(numbers, self._simulations))
        # Up to where every search with the method was still running.
        _draw_counts(
            right, times_s, {name: min(run.cpu_s for run in runs) for name, runs in by_method.items()}
        )
        left.set(xlabel="simulations", ylabel="violating solutions found")
        right.set(xlabel="CPU time of search and simulations, s")
        figure.legend(
            *left.get_legend_handles_labels(), loc="outside right center", frameon=False, fontsize=8
        )
        figure.savefig(self._folder / "violations.png", dpi=120)


def _draw_counts(
    axes: "Axes", found: Mapping[str, Sequence[Sequence[float]]], ends: Mapping[str, float]
) -> None:
    """Plot how many items each method has found: mean and range over its searches.

    Args:
        axes: Where to plot.
        found: For each method and search, the simulations or times at which something was found.
        ends: For each method, where its line ends.
    """
    for place, (name, searches) in enumerate(found.items()):
        at = np.linspace(0, ends[name], _POINTS)
        counts = np.array([np.searchsorted(np.sort(search), at) for search in searches])
        colour, line = _COLOURS[place % len(_COLOURS)], _LINES[place // len(_COLOURS)]
        axes.plot(at, counts.mean(axis=0), line, color=colour, label=name)
        axes.fill_between(at, counts.min(axis=0), counts.max(axis=0), color=colour, alpha=0.12, linewidth=0)
    axes.set(xlim=(0, max(ends.values())), ylim=(0, None))
    axes.spines[["top", "right"]].set_visible(False)


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
            if (paper := PAPER.get(name, {}).get(method)) is not None:
                spread += f"; paper {paper:g}"
            if method in (STAND_IN, STAND_IN_ALWAYS):
                spread += f"; {NO_MODEL}"
            rows.append(Row(what=f"{label}, {method}", value=mean, target="", met=None, note=spread))
    return rows


def _of_stand_ins(runs: Sequence[SearchRun]) -> list[Row]:
    """Return the mean cost of a search whose seeds come from the stand-in for a language model."""
    rows = []
    for method in (STAND_IN, STAND_IN_ALWAYS):
        asking = [run for run in runs if run.method == method]
        if not asking:
            continue
        for label, values in (
            ("calls", [run.calls for run in asking]),
            ("tokens of calls", [run.tokens for run in asking]),
            (
                "seeds taken",
                [run.origins.get(Origin.LLM, 0) + run.origins.get(Origin.LLM_REPAIR, 0) for run in asking],
            ),
            ("waiting for answers, s", [run.waited_s for run in asking]),
        ):
            spread = f"min {min(values):.4g}, max {max(values):.4g}; {NO_MODEL}"
            mean = float(np.mean(values))
            rows.append(Row(what=f"{label}, {method}", value=mean, target="", met=None, note=spread))
    return rows


def _of_overlaps(overlaps: Sequence[Overlap]) -> list[Row]:
    """Return the share of other methods' types that muMOEA also finds, and the reverse; overlap.csv has all pairs."""
    return [
        Row(
            what=f"share of types of {one.method} that {one.other} found too",
            value=one.share,
            target="",
            met=None,
            note=f"{one.shared} of {one.types}; in a single search {one.single:.0%}; overlap.csv",
        )
        for one in overlaps
        if ADAPTIVE in (one.method, one.other)
    ]


def _reference_costs(by_method: Mapping[str, Sequence[SearchRun]]) -> list[Row]:
    """Return the share of simulation time spent on drives of reference drivers, for every method."""
    rows = []
    for method, runs in by_method.items():
        reference_s, cpu_s = (
            sum(run.reference_cpu_s for run in runs),
            sum(run.simulations_cpu_s for run in runs),
        )
        rows.append(
            Row(
                what=f"share of simulation time for reference drivers, {method}",
                value=reference_s / cpu_s if cpu_s else math.nan,
                target="",
                met=None,
                note=f"{reference_s:.0f} of {cpu_s:.0f} s of CPU time",
            )
        )
    return rows


def _tests(measures: Mapping[str, Sequence[Measures]]) -> list[Row]:
    """Return A12, U and p-value of MAP-Elites, muMOEA and its variant `always` against each of the other methods."""
    avoidable = ("types", "careful_types", "braking_types", "ideal_types")
    subjects = {MAP_ELITES: (*avoidable, "standing_share"), ADAPTIVE: tuple(LABELS), ALWAYS: avoidable}
    pairs = [
        (subject, name, method)
        for subject, names in subjects.items()
        if subject in measures
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
                    what=f"A12 {LABELS[name]}: {subject} better than {method}",
                    value=tested.a12,
                    target="",
                    met=None,
                    note=f"Mann-Whitney U {tested.u:g}, p {p_text(tested.p_value)}, uncorrected",
                )
            )
    return rows
