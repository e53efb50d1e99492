"""One search of the comparison: run in one process without a coordinator, kept in a file."""

import gzip
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from brink.bench.trials import run_record
from brink.search.algorithm import Algorithm, Candidate, Evaluation, Failed, Scored
from brink.search.algorithms.multi_objective import Child
from brink.search.algorithms.mumoea import Mumoea, MumoeaConfig
from brink.search.algorithms.nsga2 import Mosat, Nsga2
from brink.search.algorithms.random_search import RandomSearch
from brink.search.analysis.violations import kinds_of
from brink.search.streams import episode_seed
from brink.search.traffic.variation import TrafficGenome
from brink.server.problems.npc_actions import NpcActions, NpcActionsParams
from brink.sim.errors import SimulatorError

ADAPTIVE: Final = "muMOEA"
ALWAYS: Final = "differential seeds always"


class OnlyMutants(Mumoea):
    """Has no patterns to get unstuck with: major mutants alone take the place of differential seeds."""

    def heuristic_seeds(self, genome: TrafficGenome, count: int, rng: np.random.Generator) -> list[Child]:
        """Return none."""
        return []


METHODS: Final[Mapping[str, tuple[Algorithm, Any]]] = {
    ADAPTIVE: (Mumoea(), MumoeaConfig()),
    "without differential seeds": (Mumoea(), MumoeaConfig(differential="never")),
    ALWAYS: (Mumoea(), MumoeaConfig(differential="always")),
    "major mutants always": (OnlyMutants(), MumoeaConfig(differential="always")),
    "random initial population": (Mumoea(), MumoeaConfig(initial="random")),
    "MOSAT": (Mosat(), Mosat.config_type()),
    "NSGA-II": (Nsga2(), Nsga2.config_type()),
    "random search": (RandomSearch(), RandomSearch.config_type()),
}
"""What is compared, with its settings: the defaults, but for what the name says."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """A solution that violated something.

    Attributes:
        number: How many solutions were simulated before it.
        violations: Circumstances of each violation.
        waypoints: Stations and offsets at the ends of actions, a list for each participant.
    """

    number: int
    violations: list[dict[str, Any]]
    waypoints: list[list[list[float]]]

    @property
    def types(self) -> set[str]:
        """The types of its violations, in words."""
        return set(kinds_of(self.violations))


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchRun:
    """What came out of a search.

    Attributes:
        method: A name of `METHODS`.
        seed: Its seed.
        simulations: How many there were.
        failed: How many of them gave no verdict.
        origins: How many solutions each origin gave, where the method keeps them.
        found: Solutions that violated something, in the order of simulation.
        cpu_s: CPU time of the simulations.
    """

    method: str
    seed: int
    simulations: int
    failed: int
    origins: dict[str, int]
    found: list[Found]
    cpu_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """A search to be run.

    Attributes:
        method: A name of `METHODS`.
        seed: Its seed.
        simulations: Its budget.
        params: Of the problem.
        folder: Where what came out is kept.
    """

    method: str
    seed: int
    simulations: int
    params: NpcActionsParams
    folder: Path

    @property
    def file(self) -> Path:
        """Where what came out is kept."""
        return self.folder / f"{self.method.replace(' ', '-').lower()}-{self.seed}-{self.simulations}.json.gz"


def run_or_read(task: Task) -> SearchRun:
    """Return what a search gave, from its file if it was run before."""
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
    """Run a search to the end of its budget."""
    problem = NpcActions(task.params)
    algorithm, config = METHODS[task.method]
    state = algorithm.start(problem.space, replace(config), seed=task.seed, budget=task.simulations)
    run = SearchRun(
        method=task.method, seed=task.seed, simulations=0, failed=0, origins={}, found=[], cpu_s=0.0
    )
    while not algorithm.finished(state):
        for origin in getattr(state, "queue_origins", ()):
            run.origins[origin.value] = run.origins.get(origin.value, 0) + 1
        state, candidates = algorithm.ask(state)
        answers: dict[int, Evaluation] = {}
        for candidate in candidates:
            try:
                answers[candidate.number], cpu_s = _answer(problem, task.seed, candidate, run.found)
            except SimulatorError as error:
                answers[candidate.number], cpu_s = Failed(reason=str(error)), 0.0
                run = replace(run, failed=run.failed + 1)
            run = replace(run, simulations=run.simulations + 1, cpu_s=run.cpu_s + cpu_s)
        state = algorithm.tell(state, answers)
    return run


def _answer(
    problem: NpcActions, seed: int, candidate: Candidate, found: list[Found]
) -> tuple[Evaluation, float]:
    """Simulate a candidate; add it to what was found if it violates something."""
    record = run_record(problem.episode(candidate.vectors, episode_seed(seed, candidate.number)))
    told = record.features["violations"]
    violations = [dict(one) for one in told if isinstance(one, dict)] if isinstance(told, list) else []
    if violations:
        points = problem.waypoints(candidate.vectors)
        found.append(Found(number=candidate.number, violations=violations, waypoints=points))
    scored = Scored(
        unsafe=record.unsafe,
        robustness=min(record.robustness.values()),
        objectives=record.objectives,
        kinds=kinds_of(violations),
    )
    return scored, record.cpu_s
