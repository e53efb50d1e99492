"""DBS and strict DBS of campaigns side by side, each with its control.

A control has verdicts that ignore behaviour (`brink.search.control`), so what it reaches is owed to scenarios
and chance.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from brink.search.analysis.scores import ENOUGH_REPEATS, Scores, scored
from brink.search.archive import Archive
from brink.search.boundary import PAPER_D_THS, PAPER_T_BS
from brink.search.space import SearchSpace

SPREADS = 2.0
"""Standard deviations of its draws by which a campaign must exceed its control, to owe anything to behaviour."""
CALIBRATION = 0.15
"""Share of a control by which it can read low though behaviour has no effect (docs/explanation/mlcshe-results.md)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparedCampaign:
    """A campaign to compare.

    Attributes:
        id: Its id.
        label: Its name in the table.
        space: What it searched.
        archive: All its evaluated solutions.
        simulations: Its budget.
        seed: Its seed, which decides the draws of its control.
    """

    id: str
    label: str
    space: SearchSpace
    archive: Archive
    simulations: int
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Row:
    """One line of the comparison.

    Attributes:
        label: What the figures are of.
        campaign: Id of the campaign, its own or that of its control.
        unsafe_share: Unsafe share of the archive.
        dbs: Shape ``(len(PAPER_T_BS), len(PAPER_D_THS))``; means for a control.
        strict: The same for strict DBS.
        strict_spread: Standard deviation of strict DBS over a control's draws, same shape; zero for a campaign.
        repeats: Evaluated behaviours a scenario, for a control; None for a campaign.
    """

    label: str
    campaign: str
    unsafe_share: float
    dbs: NDArray[np.float64]
    strict: NDArray[np.float64]
    strict_spread: NDArray[np.float64]
    repeats: float | None

    @property
    def reads_low(self) -> bool:
        """Whether this is a control that too few behaviours a scenario make too low."""
        return self.repeats is not None and self.repeats < ENOUGH_REPEATS


def compare(campaigns: Sequence[ComparedCampaign], *, control: bool = True) -> list[Row]:
    """Return a row for each campaign, followed by one for its control if its space has a scenario."""
    rows = []
    for campaign in campaigns:
        scores = scored(
            campaign.archive, campaign.space, simulations=campaign.simulations, seed=campaign.seed,
            fractions=(1.0,), control=control,
        )  # fmt: skip
        rows += rows_of(scores, campaign=campaign.id, label=campaign.label)
    return rows


def rows_of(scores: Scores, *, campaign: str, label: str) -> list[Row]:
    """Return the row of a campaign at its whole budget, followed by that of its control if it has one."""
    figures = scores.figures
    own = Row(
        label=label, campaign=campaign, unsafe_share=scores.unsafe / scores.evaluated if scores.evaluated else 0.0,
        dbs=figures.dbs[-1], strict=figures.strict[-1], strict_spread=np.zeros_like(figures.strict[-1]),
        repeats=None,
    )  # fmt: skip
    if (blind := scores.control) is None:
        return [own]
    control = Row(
        label=f"{label}, control", campaign=campaign, unsafe_share=blind.unsafe_share,
        dbs=blind.figures.dbs[-1], strict=blind.figures.strict[-1], strict_spread=blind.spread,
        repeats=blind.repeats,
    )  # fmt: skip
    return [own, control]


def in_words(rows: Sequence[Row], t_b: float, d_th: float) -> list[str]:
    """Return, for each campaign that has a control, what the two say together, in a sentence.

    Args:
        rows: From `compare`.
        t_b: One of the paper's thresholds.
        d_th: One of the paper's thresholds.
    """
    place = PAPER_T_BS.index(t_b), PAPER_D_THS.index(d_th)
    return [
        f"{row.label}: {said(row, control, place)}"
        for row, control in itertools.pairwise(rows)
        if row.repeats is None and control.repeats is not None
    ]


def said(row: Row, control: Row, place: tuple[int, int]) -> str:
    """Return what a campaign and its control say together.

    Args:
        row: Of the campaign.
        control: Of its control.
        place: Of t_b in `PAPER_T_BS`, of d_th in `PAPER_D_THS`.
    """
    found, blind = float(row.strict[place]), float(control.strict[place])
    facts = (
        f"strict DBS {found:g} within its budget, {blind:.3g} if verdicts ignored the component's behaviour"
    )
    if control.reads_low:
        return f"{facts}; with {control.repeats:.1f} behaviours a scenario that figure reads low and proves nothing"
    if not found:
        return f"{facts}: nothing that could be owed to it"
    beyond = found - blind
    if beyond > max(SPREADS * float(control.strict_spread[place]), CALIBRATION * blind):
        return f"{facts}: about {beyond:.0f} of {found:g} are owed to how the component behaves"
    return f"{facts}: no more than scenarios and chance give, so it does not show that the component matters"
