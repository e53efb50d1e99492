"""A custom algorithm: mutate the solutions that came closest to changing their verdict. Run it with

cd examples/plugins && brink --plugin edge_walk run edge_walk.yaml
"""

from dataclasses import dataclass

import numpy as np

from brink.search.algorithms.ledger import BoundaryConfig, BoundaryState, LedgerAlgorithm
from brink.search.operators import mutated
from brink.search.settings import setting
from brink.search.streams import Stream, generator
from brink.server.problems.catalogue import ALGORITHMS
from brink.sim.catalogue import register


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeWalkConfig(BoundaryConfig):
    """Settings of the walk."""

    step: int = setting(40, help="Candidates per generation.", ge=1, le=10_000)
    rate: float = setting(0.2, help="Probability that a gene mutates.", gt=0, le=1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgeWalkState(BoundaryState):
    """State of the walk: the ledger of candidates alone."""

    config: EdgeWalkConfig


class EdgeWalk(LedgerAlgorithm[EdgeWalkConfig, EdgeWalkState]):
    """Half of a generation around the smallest absolute robustness, half at random."""

    id = "edge-walk@1"
    summary = "Mutates what came closest to changing its verdict."
    config_type = EdgeWalkConfig

    def _min_budget(self, space, config):
        return config.step

    def _first_state(self, ledger, config):
        return self._plan(config, ledger)

    def tell(self, state, evaluations):
        return self._plan(state.config, state.ledger.tell(evaluations))

    def _restored(self, ledger, config, document):
        return EdgeWalkState(config=config, ledger=ledger)

    def _plan(self, config, ledger):
        rng, space = generator(ledger.seed, Stream.START, ledger.generation), ledger.space
        closest = np.argsort(np.abs(ledger.archive.robustness), kind="stable")[: config.step // 2]
        rows = [
            space.join(
                space.repair(
                    tuple(
                        mutated(part, vector, config.rate, rng)
                        for part, vector in zip(space.components, space.split(row), strict=True)
                    ),
                    rng,
                )
            )
            for row in ledger.archive.vectors[closest]
        ]
        rows += [space.join(space.sample(rng)) for _ in range(config.step - len(rows))]
        wanted = int(max(0, min(config.step, ledger.left)))
        return EdgeWalkState(config=config, ledger=ledger.plan(ledger.unseen(rows)[:wanted]))


register(ALGORITHMS, "edge-walk@1", EdgeWalk)
