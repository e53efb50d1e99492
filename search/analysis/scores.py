"""Scores of a campaign: DBS and strict DBS at shares of its budget, and those of a behaviour-blind control.

A control has the same solutions with verdicts that ignore the behaviour. `ScenarioRisk` estimates from an archive the
probability that a solution is unsafe, given its scenario alone; a control redraws every verdict independently with
that probability. Its DBS is due to scenarios and chance; the excess of the real figure is due to the behaviour.

`blind_archive` keeps the solutions of a search, which were chosen under the real verdicts. Running a new search on
blind verdicts was tried and rejected: where the behaviour has no effect at all, it found a quarter of MLCSHE's figure
and twice the GA's.

Limits: equal figures do not prove that the behaviour has no effect, because DBS counts neighbourhoods and can miss a
real dependence, and a difference says nothing about the effect on any single solution. Scenarios must have been
evaluated several times. The estimate for a scenario evaluated once comes mostly from similar ones, which flattens the
landscape, so that the control reads far too low; see `Control.reads_low` and `python -m benchmarks control`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from brink.search.analysis.boundary import dbs_by_budget
from brink.search.analysis.paper import D_THS, PAPER_FRACTIONS, PAPER_T_BS
from brink.search.archive import Archive
from brink.search.deadline import check_time
from brink.search.metric import Metric
from brink.search.space import FloatArray, IntArray, SearchSpace, frozen_array
from brink.search.streams import Stream, generator

SCENARIO: Final = "scenario"
"""Name of the component whose effect a control keeps."""
ENOUGH_REPEATS: Final = 3.0
"""Smallest mean number of evaluations per scenario for a reliable control."""
DRAWS: Final = 5
"""Number of controls per campaign; their figures are averaged."""

SHRINKAGE = 4.0
"""Weight of the estimate from similar scenarios, in evaluations."""

BANDWIDTH = 0.1
"""Distance between scenarios at which their mutual weight has fallen by a factor of e."""

_BLOCK_ROWS = 256


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScenarioRisk:
    """Probability that a solution is unsafe, given its scenario alone.

    For a scenario with k unsafe among n evaluated solutions it is (k + s m) / (n + s). s is the shrinkage. m is the
    mean over all other scenarios, weighted by exp(-distance / bandwidth) and shrunk towards the overall mean with the
    weight of one evaluation.

    Attributes:
        metric: Distance between scenarios.
        part: Columns of the scenario in a row.
        scenarios: Distinct scenarios, shape ``(s, d)``.
        evaluated: Evaluated solutions per scenario, shape ``(s,)``.
        unsafe: Unsafe solutions per scenario, shape ``(s,)``.
        shrinkage: Weight of similar scenarios, in evaluations, > 0.
        bandwidth: Distance at which the similarity of scenarios has fallen by a factor of e, > 0.
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
        """Fit the risk of scenarios to an archive.

        Args:
            archive: An archive with at least one solution.
            space: The archive's space.
            scenario: Position of the scenario component.
            shrinkage: Weight of similar scenarios, in evaluations, > 0.
            bandwidth: Distance at which the similarity of scenarios has fallen by a factor of e, > 0.

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
        """Mean number of evaluated solutions per scenario."""
        return float(self.evaluated.mean())

    def probability(self, scenarios: FloatArray) -> FloatArray:
        """Return the unsafe probability of known or new scenarios, shape ``(m, d)`` to ``(m,)``."""
        different, which = np.unique(scenarios, axis=0, return_inverse=True)
        probability = np.empty(len(different))
        mean = self.unsafe.sum() / self.evaluated.sum()
        for top in range(0, len(different), _BLOCK_ROWS):
            rows = slice(top, top + _BLOCK_ROWS)
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


def blind_archive(archive: Archive, risk: ScenarioRisk, *, seed: int, draw: int = 0) -> Archive:
    """Return an archive of the same solutions with redrawn verdicts that ignore the behaviour.

    The robustness of a solution becomes a uniform draw minus its unsafe probability.

    Args:
        archive: The evaluated solutions.
        risk: Risk fitted to that archive.
        seed: Determines the verdicts, together with `draw` and the candidate numbers.
        draw: Number of the control, >= 0.
    """
    check_time()
    uniform = [generator(seed, Stream.CONTROL, draw, number).random() for number in archive.numbers.tolist()]
    robustness = np.array(uniform) - risk.probability(archive.vectors[:, risk.part])
    return archive.with_verdicts(robustness < 0, robustness)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Figures:
    """DBS and strict DBS at shares of the budget, for all pairs of thresholds.

    Attributes:
        dbs: DBS, shape ``(fractions, len(PAPER_T_BS), len(D_THS))``.
        strict: Strict DBS, same shape.
    """

    dbs: FloatArray
    strict: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Control:
    """Scores of a campaign's control.

    Attributes:
        figures: Means over `DRAWS` draws.
        spread: Standard deviation of strict DBS over the draws at the whole budget, shape
            ``(len(PAPER_T_BS), len(D_THS))``.
        unsafe_share: Mean unsafe share of the draws.
        repeats: Mean number of evaluated behaviours per scenario.
    """

    figures: Figures
    unsafe_share: float
    spread: FloatArray
    repeats: float

    @property
    def reads_low(self) -> bool:
        """Whether the figures are too low, because too few behaviours were evaluated per scenario."""
        return self.repeats < ENOUGH_REPEATS


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scores:
    """Scores of a campaign.

    Attributes:
        evaluated: Solutions with a verdict within the budget.
        unsafe: Unsafe solutions among them.
        figures: The campaign's figures.
        control: Those of its control; None if no component is a scenario.
        beyond: Solutions with a verdict beyond the budget, which complete the last generation and do not count.
    """

    evaluated: int
    unsafe: int
    figures: Figures
    control: Control | None
    beyond: int = 0


def scored(
    archive: Archive,
    space: SearchSpace,
    *,
    simulations: int,
    seed: int,
    fractions: Sequence[float] = PAPER_FRACTIONS,
    control: bool = True,
) -> Scores:
    """Return the scores of a campaign, ignoring simulations beyond its budget.

    Args:
        archive: All evaluated solutions, ascending by number.
        space: The search space.
        simulations: The campaign's budget.
        seed: The campaign's seed, which determines its controls.
        fractions: Shares of the budget, ascending, ending with 1.
        control: Whether to draw controls.
    """
    within = archive.first(int(np.searchsorted(archive.numbers, simulations)))
    names = [component.name for component in space.components]
    blind: Control | None = None
    if control and len(within) and SCENARIO in names and len(names) > 1:
        risk = ScenarioRisk.fitted(within, space, scenario=names.index(SCENARIO))
        archives = [blind_archive(within, risk, seed=seed, draw=draw) for draw in range(DRAWS)]
        draws = [_figures(drawn, simulations, fractions) for drawn in archives]
        blind = Control(
            figures=Figures(
                dbs=np.mean([draw.dbs for draw in draws], axis=0),
                strict=np.mean([draw.strict for draw in draws], axis=0),
            ),
            unsafe_share=float(np.mean([drawn.unsafe for drawn in archives])),
            spread=np.std([draw.strict[-1] for draw in draws], axis=0),
            repeats=risk.repeats,
        )
    return Scores(
        evaluated=len(within),
        unsafe=int(np.count_nonzero(within.unsafe)),
        beyond=len(archive) - len(within),
        figures=_figures(within, simulations, fractions),
        control=blind,
    )


def _figures(archive: Archive, simulations: int, fractions: Sequence[float]) -> Figures:
    points = list(dbs_by_budget(archive, simulations, fractions, PAPER_T_BS, D_THS))
    return Figures(
        dbs=np.array([point.grid.dbs for point in points], np.float64),
        strict=np.array([point.grid.strict for point in points], np.float64),
    )
