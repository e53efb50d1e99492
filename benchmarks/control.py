"""Calibration of the behaviour-blind control, on campaigns in which the behaviour has no effect.

Every candidate is simulated with the same fixed behaviour instead of its own, so all that a search finds is due to
scenarios and chance. A control that can be trusted then reaches the same figures as the real verdicts.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from benchmarks.measurement import Progress
from benchmarks.urban import draw_candidate, spec_of
from brink.search.algorithm import Evaluation, ask_all
from brink.search.analysis.boundary import dbs_grid
from brink.search.analysis.paper import PAPER_T_BS
from brink.search.analysis.scores import ScenarioRisk, blind_archive
from brink.search.archive import Archive
from brink.search.streams import episode_seed
from brink.server.campaigns.body import parse_body
from brink.server.campaigns.plan import make_plan
from brink.server.problems.base import SimulatedProblem
from brink.sim.catalogue import make_simulator
from brink.sim.episode import EpisodeSpec, Json
from brink.worker.child_protocol import completed_document
from brink.worker.pool import process_pool, single_threaded
from brink.worker.wire import Completed

ALGORITHMS: Final = ("mlcshe@1", "ga@1", "random@1")
D_TH: Final = 0.2
DRAWS: Final = 5
T_BS: Final = PAPER_T_BS


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """DBS of a campaign's real verdicts and of its control.

    Attributes:
        algorithm: Id of the algorithm.
        seed: Seed of the campaign.
        unsafe_share: Unsafe fraction of its solutions.
        repeats: Mean number of evaluations per scenario.
        real: DBS of the real verdicts at each of `T_BS`.
        control: Mean DBS of `DRAWS` controls at each of `T_BS`.
    """

    algorithm: str
    seed: int
    unsafe_share: float
    repeats: float
    real: tuple[float, ...]
    control: tuple[float, ...]


def calibrate(
    progress: Progress,
    *,
    simulations: int = 1300,
    seeds: Sequence[int],
    behaviour: int = 3,
    processes: int = 2,
) -> Iterator[Calibration]:
    """Run campaigns with a fixed behaviour; yield each calibration as soon as its campaign has finished.

    Args:
        progress: Progress callback.
        simulations: Simulations per campaign.
        seeds: Seeds of the campaigns of each algorithm.
        behaviour: Seed of the fixed behaviour.
        processes: Number of processes.
    """
    fixed = spec_of(draw_candidate(np.random.default_rng(behaviour)), 0).behaviour
    for algorithm in ALGORITHMS:
        for seed in seeds:
            archive, risk = _search(progress, algorithm, seed, simulations, fixed, processes)
            controls = [_dbs(blind_archive(archive, risk, seed=seed, draw=draw)) for draw in range(DRAWS)]
            yield Calibration(
                algorithm=algorithm,
                seed=seed,
                unsafe_share=float(np.mean(archive.unsafe)),
                repeats=risk.repeats,
                real=tuple(_dbs(archive)),
                control=tuple(np.mean(controls, axis=0).tolist()),
            )


def _dbs(archive: Archive) -> list[float]:
    return [float(count) for count in dbs_grid(archive, T_BS, (D_TH,)).dbs[:, 0]]


def _search(
    progress: Progress,
    algorithm_id: str,
    seed: int,
    simulations: int,
    behaviour: Mapping[str, Json],
    processes: int,
) -> tuple[Archive, ScenarioRisk]:
    plan = make_plan(
        parse_body(
            {
                "name": "calibration",
                "problem": {"id": "urban-injected@1"},
                "algorithm": {"id": algorithm_id},
                "budget": {"simulations": simulations},
                "seed": seed,
            }
        )
    )
    problem, algorithm = plan.problem, plan.algorithm
    assert isinstance(problem, SimulatedProblem)
    state = algorithm.start(problem.space, plan.config, seed=seed, budget=simulations)
    done = 0
    with single_threaded(), process_pool(processes) as pool:
        while not algorithm.finished(state):
            state, _ = ask_all(algorithm, state)
            candidates = state.pending
            specs = [
                replace(problem.episode(c.vectors, episode_seed(seed, c.number)), behaviour=behaviour)
                for c in candidates
            ]
            evaluations: dict[int, Evaluation] = {}
            for candidate, outcome in zip(candidates, pool.map(_simulate, specs, chunksize=8), strict=True):
                evaluations[candidate.number] = problem.evaluation(outcome)
            state = algorithm.tell(state, evaluations)
            done += len(candidates)
            progress(f"{algorithm_id}, seed {seed}", done, max(done, simulations))
    return state.archive, ScenarioRisk.fitted(state.archive, problem.space)


def _simulate(spec: EpisodeSpec) -> Completed:
    return Completed.model_validate(completed_document(make_simulator(spec.simulator).run(spec)))
