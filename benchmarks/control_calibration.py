"""Calibrate the control where behaviour has no effect: ``python benchmarks/control_calibration.py``.

Every candidate is simulated with one fixed behaviour in place of its own, so whatever a search finds is owed to
scenarios and chance, and a control that can be believed reaches the same figures as the real verdicts.
"""

import argparse
import dataclasses
from multiprocessing import get_context

import numpy as np

from brink.bench.urban_candidates import draw_candidate
from brink.search.algorithm import Evaluation
from brink.search.analysis.boundary import PAPER_T_BS, dbs_grid
from brink.search.analysis.scores import ScenarioRisk, blind_archive
from brink.search.space import FloatArray
from brink.search.streams import episode_seed
from brink.server.campaigns.body import parse_body
from brink.server.campaigns.plan import make_plan
from brink.server.problems.base import SimulatedProblem
from brink.sim.catalogue import make_simulator
from brink.sim.episode import EpisodeSpec
from brink.worker.child_protocol import completed_document
from brink.worker.wire import Completed

ALGORITHMS = ("mlcshe@1", "ga@1", "random@1")
D_TH = 0.2
DRAWS = 5


def simulate(spec: EpisodeSpec) -> Completed:
    """Run an episode in this process."""
    return Completed.model_validate(completed_document(make_simulator(spec.simulator).run(spec)))


def main() -> None:
    """Print a table: algorithm, seed, DBS of the real verdicts and of the control at each t_b."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--simulations", type=int, default=1300)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--behaviour", type=int, default=3, help="seed of the fixed behaviour")
    parser.add_argument("--processes", type=int, default=2)
    arguments = parser.parse_args()
    fixed = draw_candidate(np.random.default_rng(arguments.behaviour)).spec(0, ("front-gap@1",)).behaviour
    print(f"{'algorithm':<10} {'seed':>4} {'unsafe':>7} {'':<8}" + "".join(f"{t:>8g}" for t in PAPER_T_BS))
    with get_context("spawn").Pool(arguments.processes) as pool:
        for algorithm_id in ALGORITHMS:
            for seed in arguments.seeds:
                plan = make_plan(
                    parse_body(
                        {
                            "name": "calibration",
                            "problem": {"id": "urban-injected@1"},
                            "algorithm": {"id": algorithm_id},
                            "budget": {"simulations": arguments.simulations},
                            "seed": seed,
                        }
                    )
                )
                problem, algorithm = plan.problem, plan.algorithm
                assert isinstance(problem, SimulatedProblem)
                state = algorithm.start(problem.space, plan.config, seed=seed, budget=arguments.simulations)
                while not algorithm.finished(state):
                    state, candidates = algorithm.ask(state)
                    specs = [
                        dataclasses.replace(
                            problem.episode(c.vectors, episode_seed(seed, c.number)), behaviour=fixed
                        )
                        for c in candidates
                    ]
                    outcomes = pool.map(simulate, specs)
                    evaluations: dict[int, Evaluation] = {
                        c.number: problem.evaluation(outcome)
                        for c, outcome in zip(candidates, outcomes, strict=True)
                    }
                    state = algorithm.tell(state, evaluations)
                archive = state.archive
                risk = ScenarioRisk.fitted(archive, problem.space)
                real = dbs_grid(archive, PAPER_T_BS, (D_TH,)).dbs[:, 0].astype(np.float64)
                blind = [
                    dbs_grid(blind_archive(archive, risk, seed=seed, draw=i), PAPER_T_BS, (D_TH,)).dbs[:, 0]
                    for i in range(DRAWS)
                ]
                share = float(np.mean(archive.unsafe))
                about = f"{algorithm_id:<10} {seed:>4} {share:>7.0%}"
                print(about, f"{'real':<8}" + cells(real))
                print(
                    f"{'':<10} {'':>4} {risk.repeats:>6.1f}x",
                    f"{'control':<8}" + cells(np.mean(blind, axis=0)),
                )


def cells(figures: FloatArray) -> str:
    """Return figures as table cells."""
    return "".join(f"{figure:>8.4g}" for figure in figures)


if __name__ == "__main__":
    main()
