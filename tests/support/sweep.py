"""A toy algorithm of thresholds, ``sweep@1``, which visits given places along given lines, and drives with chance."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from brink.search.algorithm import Evaluation
from brink.search.algorithms.ledger import Ledger, LedgerAlgorithm, LedgerState
from brink.search.document import Document
from brink.search.space import SearchSpace
from brink.worker.wire import Completed, LeasedJob, WireVerdict
from support.problems import REQUIREMENT, simulated


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepConfig:
    """Settings of the sweep."""

    rows: list[list[float]] = field(
        default_factory=list, metadata={"help": "Solutions, in the order of asking."}
    )
    shared: int = field(default=0, metadata={"help": "How many of the first ones share an episode seed."})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SweepState(LedgerState):
    """State of the sweep: the ledger alone."""

    config: SweepConfig


class Sweep(LedgerAlgorithm[SweepConfig, SweepState]):
    """Simulates given solutions, each with an episode seed of its own but for the first few."""

    id = "sweep@1"
    finds = ("thresholds",)
    summary = "Solutions along lines."
    config_type = SweepConfig

    def _min_budget(self, space: SearchSpace, config: SweepConfig) -> int:
        return len(config.rows)

    def _first_state(self, ledger: Ledger, config: SweepConfig) -> SweepState:
        rows = [np.asarray(row, np.float64) for row in config.rows]
        seeds = [0 if 0 < place < config.shared else None for place in range(len(rows))]
        return SweepState(config=config, ledger=ledger.plan(rows, seed_numbers=seeds))

    def tell(self, state: SweepState, evaluations: Mapping[int, Evaluation]) -> SweepState:
        """Return the state with nothing left to ask for."""
        return SweepState(config=state.config, ledger=state.ledger.tell(evaluations).plan([]))

    def _restored(self, ledger: Ledger, config: SweepConfig, document: Document) -> SweepState:
        return SweepState(config=config, ledger=ledger)


def by_seed(job: LeasedJob, spread_m: float = 0.1) -> Completed:
    """Return the outcome on the ball if its radius depends on the seed, uniformly within `spread_m` of 1 m.

    Along a radius, the probability of a violation is 50% at 1 m, and from 20 to 80% within 1.2 times `spread_m`.
    """
    drawn = np.random.Generator(np.random.PCG64(job.spec["seed"])).uniform(-1.0, 1.0)
    robustness = simulated(job.spec).verdicts[REQUIREMENT].robustness + spread_m * drawn
    return Completed(verdicts={REQUIREMENT: WireVerdict(robustness=robustness, unit="m", violated_at_s=None)})


def along_x(y: float, places: list[float]) -> list[list[float]]:
    """Return solutions on the ball with the same y."""
    return [[x, y] for x in places]
