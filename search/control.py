"""The control of a DBS figure: the same landscape with verdicts that are blind to behaviour.

`ScenarioRisk` estimates from an archive how likely a scenario alone makes a solution unsafe. A control redraws
verdicts with that probability, each solution by itself. What can still be found then is owed to scenarios and to
chance; what the real verdicts give beyond it is owed to behaviour.

`blind_archive` keeps the solutions that a search evaluated and redraws their verdicts. The positions were chosen
under the real verdicts. A search of its own among blind verdicts was tried and dropped: where behaviour has no effect
at all, it found a quarter of MLCSHE's figure and twice the GA's.

What it does not say: that behaviour has no effect where the figures agree (DBS counts neighbourhoods, and can miss a
dependence that is real), nor how large the effect on any one solution is. It takes scenarios that were evaluated
several times: of one that was evaluated once, most of the estimate comes from similar ones, which flattens the
landscape, and the control reads far too low. `ScenarioRisk.repeats` tells, and `benchmarks/control_calibration.py`
measures it.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from brink.search.archive import Archive
from brink.search.component import FloatArray, frozen_array
from brink.search.fitness import IntArray
from brink.search.metric import Metric
from brink.search.space import SearchSpace
from brink.search.streams import Stream, generator

SHRINKAGE = 4.0
"""Evaluations that the estimate from similar scenarios weighs as much as."""

BANDWIDTH = 0.1
"""Distance between scenarios over which the weight of one for the other falls by a factor of e."""

_ROWS = 256


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScenarioRisk:
    """Probability that a solution is unsafe, given nothing but its scenario.

    Of a scenario with k unsafe among n evaluated solutions it is (k + s m) / (n + s): s is the shrinkage, m the mean
    over all other scenarios weighted by exp(-distance / bandwidth), itself drawn by one evaluation's weight towards
    the mean of everything.

    Attributes:
        metric: Distance between scenarios.
        part: Where the scenario lies in a row.
        scenarios: Different scenarios, shape ``(s, d)``.
        evaluated: Evaluated solutions of each, shape ``(s,)``.
        unsafe: Unsafe ones among them, shape ``(s,)``.
        shrinkage: See above, > 0.
        bandwidth: See above, > 0.
    """

    metric: Metric
    part: slice
    scenarios: FloatArray
    evaluated: IntArray
    unsafe: IntArray
    shrinkage: float
    bandwidth: float

    @classmethod
    def fitted(
        cls,
        archive: Archive,
        space: SearchSpace,
        *,
        scenario: int = 0,
        shrinkage: float = SHRINKAGE,
        bandwidth: float = BANDWIDTH,
    ) -> Self:
        """Estimate the risk of scenarios from an archive.

        Args:
            archive: At least one evaluated solution.
            space: The archive's space.
            scenario: Index of the component that is the scenario.
            shrinkage: Weight of similar scenarios, in evaluations, > 0.
            bandwidth: Reach of similarity, in distance between scenarios, > 0.

        Raises:
            ValueError: The archive is empty, or a setting is not positive.
        """
        if not len(archive):
            raise ValueError("archive: expected at least one evaluated solution")
        if not (shrinkage > 0 and bandwidth > 0):
            raise ValueError(f"expected shrinkage > 0 and bandwidth > 0, got {shrinkage!r} and {bandwidth!r}")
        part = space.slices[scenario]
        scenarios, which = np.unique(archive.vectors[:, part], axis=0, return_inverse=True)
        return cls(
            metric=Metric.of_component(space, scenario),
            part=part,
            scenarios=frozen_array(scenarios),
            evaluated=frozen_array(np.bincount(which, minlength=len(scenarios)), np.int64),
            unsafe=frozen_array(np.bincount(which[archive.unsafe], minlength=len(scenarios)), np.int64),
            shrinkage=shrinkage,
            bandwidth=bandwidth,
        )

    @property
    def repeats(self) -> float:
        """Evaluated solutions a scenario, on average."""
        return float(self.evaluated.mean())

    def probability(self, scenarios: FloatArray) -> FloatArray:
        """Return the probability of unsafe for scenarios, known or not, shape ``(m, d)`` to ``(m,)``."""
        different, which = np.unique(scenarios, axis=0, return_inverse=True)
        probability = np.empty(len(different))
        mean = self.unsafe.sum() / self.evaluated.sum()
        for top in range(0, len(different), _ROWS):
            rows = slice(top, top + _ROWS)
            distance = self.metric.between(different[rows], self.scenarios)
            own = distance == 0
            weight = np.where(own, 0.0, np.exp(-distance / self.bandwidth))
            prior = ((weight * self.unsafe).sum(axis=1) + mean) / (
                (weight * self.evaluated).sum(axis=1) + 1.0
            )
            unsafe = (own * self.unsafe).sum(axis=1)
            evaluated = (own * self.evaluated).sum(axis=1)
            probability[rows] = (unsafe + self.shrinkage * prior) / (evaluated + self.shrinkage)
        return probability[which]


def _chance(seed: int, draw: int, number: int) -> float:
    return float(generator(seed, Stream.CONTROL, draw, number).random())


def blind_archive(archive: Archive, risk: ScenarioRisk, *, seed: int, draw: int = 0) -> Archive:
    """Return the archive of the same solutions with behaviour-blind verdicts.

    The robustness of a solution becomes its uniform draw minus the probability of unsafe.

    Args:
        archive: What was evaluated.
        risk: Fitted to that archive.
        seed: Decides all verdicts, together with `draw` and the candidates' numbers.
        draw: Which of many controls.
    """
    chance = np.array([_chance(seed, draw, number) for number in archive.numbers.tolist()])
    robustness = chance - risk.probability(archive.vectors[:, risk.part])
    return archive.judged(robustness < 0, robustness)
