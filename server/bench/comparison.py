"""DBS and strict DBS of campaigns side by side, each with its control.

A control has verdicts that ignore behaviour (`search.control`), so what it reaches is owed to scenarios and chance.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from search.archive import Archive
from search.boundary import PAPER_D_THS, PAPER_T_BS, DbsGrid, dbs_grid
from search.control import ScenarioRisk, blind_archive
from server.campaigns.body import CampaignBody
from server.campaigns.plan import Plan

SCENARIO = "scenario"
"""Name of the component whose effect a control keeps."""
ENOUGH_REPEATS = 3.0
"""Evaluations a scenario from which on a control can be believed."""
DRAWS = 5
"""Controls a campaign: their figures are means."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparedCampaign:
    """A campaign to compare."""

    label: str
    body: CampaignBody
    plan: Plan
    archive: Archive


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Row:
    """One line of the comparison.

    Attributes:
        label: What the figures are of.
        unsafe_share: Unsafe share of the archive.
        dbs: Shape ``(len(PAPER_T_BS), len(PAPER_D_THS))``; means for a control.
        strict: The same for strict DBS.
    """

    label: str
    unsafe_share: float
    dbs: NDArray[np.float64]
    strict: NDArray[np.float64]


def compare(campaigns: Sequence[ComparedCampaign], *, control: bool = True) -> list[Row]:
    """Return a row for each campaign, and one for its control if its space has a scenario.

    What an algorithm simulated beyond its budget, to end a generation, is not counted.
    """
    rows = []
    for campaign in campaigns:
        archive = campaign.archive
        within = archive.first(int(np.searchsorted(archive.numbers, campaign.body.budget.simulations)))
        rows.append(_row(campaign.label, [within]))
        names = [component.name for component in campaign.plan.problem.space.components]
        if control and len(within) and SCENARIO in names and len(names) > 1:
            risk = ScenarioRisk.fitted(within, campaign.plan.problem.space, scenario=names.index(SCENARIO))
            label = f"{campaign.label}, control"
            if risk.repeats < ENOUGH_REPEATS:
                label += f" (reads low: {risk.repeats:.1f} behaviours a scenario)"
            blind = [blind_archive(within, risk, seed=campaign.body.seed, draw=draw) for draw in range(DRAWS)]
            rows.append(_row(label, blind))
    return rows


def _row(label: str, archives: Sequence[Archive]) -> Row:
    grids: list[DbsGrid] = [dbs_grid(archive, PAPER_T_BS, PAPER_D_THS) for archive in archives]
    return Row(
        label=label,
        unsafe_share=float(
            np.mean([np.mean(archive.unsafe) if len(archive) else 0.0 for archive in archives])
        ),
        dbs=np.mean([grid.dbs for grid in grids], axis=0),
        strict=np.mean([grid.strict for grid in grids], axis=0),
    )
