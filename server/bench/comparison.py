"""DBS and strict DBS of campaigns side by side, each with its control.

A control has verdicts that ignore behaviour (`search.control`), so what it reaches is owed to scenarios and chance.
Two forms: the same solutions judged anew, and a whole search of its own among such verdicts.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from search.archive import Archive
from search.boundary import PAPER_D_THS, PAPER_T_BS, DbsGrid, dbs_grid
from search.control import BlindProblem, ScenarioRisk, blind_archive
from server.campaigns.body import CampaignBody
from server.campaigns.plan import Plan

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
    """Return a row for each campaign, and two for its controls."""
    rows = []
    for campaign in campaigns:
        rows.append(_row(campaign.label, [campaign.archive]))
        if control and len(campaign.archive) and len(campaign.plan.problem.space.components) > 1:
            rows.append(_row(f"{campaign.label}, control: same solutions", same_solutions(campaign)))
            rows.append(_row(f"{campaign.label}, control: own search", own_search(campaign)))
    return rows


def same_solutions(campaign: ComparedCampaign, draws: int = DRAWS) -> list[Archive]:
    """Return the campaign's solutions with verdicts that ignore behaviour."""
    risk = _risk(campaign)
    return [
        blind_archive(campaign.archive, risk, seed=campaign.body.seed, draw=draw) for draw in range(draws)
    ]


def own_search(campaign: ComparedCampaign, draws: int = DRAWS) -> list[Archive]:
    """Return archives of the campaign's algorithm, run anew among verdicts that ignore behaviour."""
    risk = _risk(campaign)
    plan = campaign.plan
    archives = []
    for draw in range(draws):
        problem = BlindProblem(space=plan.problem.space, risk=risk, seed=campaign.body.seed, draw=draw)
        state = plan.algorithm.start(
            plan.problem.space,
            plan.config,
            seed=campaign.body.seed + draw,
            budget=campaign.body.budget.simulations,
        )
        while not plan.algorithm.finished(state):
            state, candidates = plan.algorithm.ask(state)
            state = plan.algorithm.tell(state, {c.number: problem.evaluate(c) for c in candidates})
        archives.append(state.archive)
    return archives


def _risk(campaign: ComparedCampaign) -> ScenarioRisk:
    return ScenarioRisk.fitted(campaign.archive, campaign.plan.problem.space)


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
