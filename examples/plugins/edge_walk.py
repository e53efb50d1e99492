"""An algorithm as a plug-in: mutates the solutions closest to a change of verdict. Run it with

cd examples/plugins && brink --plugin edge_walk run edge_walk.yaml
"""

from dataclasses import dataclass, replace

import numpy as np

from brink.search.algorithms.ledger import BoundaryConfig, Ledger, check_budget
from brink.search.operators import mutated
from brink.search.settings import setting
from brink.search.streams import Stream, generator
from brink.server.problems.catalogue import ALGORITHMS
from brink.sim.catalogue import register


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeWalkConfig(BoundaryConfig):
    """Settings of the algorithm."""

    step: int = setting(40, help="Candidates per generation.", ge=1, le=10_000)
    rate: float = setting(0.2, help="Probability that a gene mutates.", gt=0, le=1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgeWalkState:
    """State of the algorithm: just the ledger of candidates."""

    config: EdgeWalkConfig
    ledger: Ledger
    generation = property(lambda self: self.ledger.generation)
    archive = property(lambda self: self.ledger.archive)
    fitness = property(lambda self: self.ledger.archive.fitness)
    pending = property(lambda self: self.ledger.pending)


class EdgeWalk:
    """Draws half of each generation around the smallest absolute robustness, and half at random."""

    id, summary, config_type = (
        "edge-walk@1",
        "Mutates the solutions closest to a change of verdict.",
        EdgeWalkConfig,
    )

    def check(self, space, config, *, budget):
        check_budget(budget, config.step)

    def start(self, space, config, *, seed, budget):
        return self._plan(config, Ledger.opened(space, config, seed=seed, budget=budget))

    def ask(self, state):
        ledger = state.ledger.handed_out()
        return replace(state, ledger=ledger), ledger.pending

    def tell(self, state, evaluations):
        return self._plan(state.config, state.ledger.told(evaluations))

    def finished(self, state):
        return not state.ledger.queue

    def dump(self, state):
        return state.ledger.dump(self.id, 1, {}, {})

    def load(self, space, config, document, archive):
        ledger = Ledger.load(space, config, document.expect(self.id, 1), archive)
        return EdgeWalkState(config=config, ledger=ledger)

    def _plan(self, config, ledger):
        rng, space = generator(ledger.seed, Stream.START, ledger.generation), ledger.space
        closest = np.argsort(np.abs(ledger.archive.robustness), kind="stable")[: config.step // 2]
        rows = [
            space.join(space.repair(tuple(
                mutated(part, vector, config.rate, rng)
                for part, vector in zip(space.components, space.split(row), strict=True)
            ), rng))
            for row in ledger.archive.vectors[closest]
        ]  # fmt: skip
        rows += [space.join(space.sample(rng)) for _ in range(config.step - len(rows))]
        wanted = int(max(0, min(config.step, ledger.left)))
        return EdgeWalkState(config=config, ledger=ledger.planned(ledger.unseen(rows)[:wanted]))


register(ALGORITHMS, "edge-walk@1", EdgeWalk)
