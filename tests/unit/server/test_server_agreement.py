"""Fresh drives and the predictions of tolerances: a cell without fresh drives has no verdict."""

from datetime import UTC, datetime
from typing import cast

import numpy as np
import pytest
from support.tolerance import body

from brink.search.algorithms.tolerance.counting import tally
from brink.search.algorithms.tolerance.layout import Layout
from brink.search.algorithms.tolerance.settings import ToleranceConfig
from brink.search.curves import LEVELS
from brink.server.campaigns.body import CampaignBody
from brink.server.campaigns.plan import Plan, make_plan
from brink.server.campaigns.store import Campaign
from brink.server.campaigns.tolerance import CampaignTolerance
from brink.server.findings.tolerances.agreement import agreement_view
from brink.server.states import CampaignStatus

pytestmark = pytest.mark.usefixtures("smaller_library")


def finished(seed: int) -> tuple[Campaign, Plan]:
    plan = make_plan(CampaignBody.model_validate(body(seed, 400, design="random")))
    now = datetime(2026, 1, 1, tzinfo=UTC)
    campaign = Campaign(
        id=f"campaign{seed}",
        body=plan.body,
        document_hash="",
        status=CampaignStatus.FINISHED,
        status_reason="",
        generation=1,
        generation_end=None,
        evaluated=0,
        unsafe=0,
        failed=0,
        measured=0,
        failures_accepted=0,
        sequence=1,
        created_at=now,
        finished_at=now,
    )
    return campaign, plan


def simulated(plan: Plan, cells: range, drives: int) -> CampaignTolerance:
    """Return tolerances from drives of some cells alone; those with a severity above a half are unsafe."""
    config = cast(ToleranceConfig, plan.config)
    layout = Layout(plan.problem.space, config)
    rows, unsafe, seeds = [], [], []
    for place in cells:
        cell = layout.cells[place]
        for drive in range(drives):
            level = 1 + drive * LEVELS // drives
            for choices in (None, cell.choices):
                rows.append(layout.row(plan.body.seed, cell.population, drive, choices, level))
                unsafe.append(choices is not None and level > LEVELS // 2)
                seeds.append(drive)
    known = tally(layout, np.array(rows), range(10_000, 10_000 + len(rows)), np.array(unsafe), seeds)
    found = known.curves(layout, limit=config.limit, confidence=config.confidence)
    return CampaignTolerance(config=config, layout=layout, tally=known, curves=tuple(found))


def test_a_cell_without_fresh_drives_neither_agrees_nor_contradicts() -> None:
    (campaign, plan), (other, other_plan) = finished(1), finished(2)
    known, fresh = simulated(plan, range(8), 32), simulated(other_plan, range(3), 16)
    view = agreement_view(campaign, plan, other, known, fresh, 0.9)
    assert [cell.drives for cell in view.cells] == [16] * 3 + [0] * 5
    assert [cell.agrees for cell in view.cells] == [True] * 3 + [None] * 5
    assert (view.agreeing, view.drives) == (3, 48)
    assert "contradict the predictions in 0 of 3 cells" in view.note
    assert view.note.endswith("5 cells have none")
    assert [row[-1] for row in view.table.rows] == [True] * 3 + [None] * 5
