"""What one campaign reached: DBS and strict DBS at shares of its budget, beside those of its control.

A control has verdicts that ignore behaviour (`brink.search.control`); its figures are means of some draws. What an
algorithm simulated beyond its budget, to end a generation, is not counted.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from brink.search.archive import Archive
from brink.search.boundary import PAPER_FRACTIONS, dbs_by_budget
from brink.search.control import ScenarioRisk, blind_archive
from brink.search.space import SearchSpace

SCENARIO = "scenario"
"""Name of the component whose effect a control keeps."""
ENOUGH_REPEATS = 3.0
"""Evaluations a scenario from which on a control can be believed."""
DRAWS = 5
"""Controls a campaign: their figures are means."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Figures:
    """DBS and strict DBS at shares of the budget and the thresholds of the paper.

    Attributes:
        dbs: Shape ``(fractions, len(PAPER_T_BS), len(PAPER_D_THS))``.
        strict: The same for strict DBS.
    """

    dbs: NDArray[np.float64]
    strict: NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Control:
    """What the control of a campaign reached.

    Attributes:
        figures: Means of `DRAWS` draws.
        spread: Standard deviation of strict DBS over the draws at the whole budget, a t_b, a d_th.
        unsafe_share: Mean unsafe share of the draws.
        repeats: Evaluated behaviours a scenario.
    """

    figures: Figures
    unsafe_share: float
    spread: NDArray[np.float64]
    repeats: float

    @property
    def reads_low(self) -> bool:
        """Whether too few behaviours a scenario make the figures too low."""
        return self.repeats < ENOUGH_REPEATS


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scores:
    """What a campaign reached.

    Attributes:
        evaluated: Solutions within the budget that have a verdict.
        unsafe: Unsafe ones among them.
        figures: Of the campaign.
        control: Of its control; None where no component is a scenario.
    """

    evaluated: int
    unsafe: int
    figures: Figures
    control: Control | None


def scored(
    archive: Archive,
    space: SearchSpace,
    *,
    simulations: int,
    seed: int,
    fractions: Sequence[float] = PAPER_FRACTIONS,
    control: bool = True,
) -> Scores:
    """Return what a campaign reached.

    Args:
        archive: All its evaluated solutions, ascending by number.
        space: What it searched.
        simulations: Its budget.
        seed: Its seed, which decides the draws of its control.
        fractions: Shares of the budget, ascending, the last one 1.
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
        evaluated=len(within), unsafe=int(np.count_nonzero(within.unsafe)),
        figures=_figures(within, simulations, fractions), control=blind,
    )  # fmt: skip


def _figures(archive: Archive, simulations: int, fractions: Sequence[float]) -> Figures:
    points = list(dbs_by_budget(archive, simulations, fractions))
    return Figures(
        dbs=np.array([point.grid.dbs for point in points], np.float64),
        strict=np.array([point.grid.strict for point in points], np.float64),
    )
