"""Whether fresh drives agree with the predictions of tolerances."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from brink.search.streams import Stream, generator
from brink.server.campaigns.plan import Plan
from brink.server.campaigns.store import Campaign
from brink.server.campaigns.tolerance import CampaignTolerance
from brink.server.errors import InvalidInput
from brink.server.findings.sources import Sources
from brink.server.findings.table import Column, Format, Table
from brink.server.findings.tolerances.analysis import error_words
from brink.server.findings.tolerances.views import AgreementCell, AgreementView

_FRESH: Final = "/query/fresh"


async def find_agreement(
    sources: Sources, campaign: Campaign, other: Campaign, confidence: float
) -> AgreementView:
    """Return whether the drives of another campaign, simulated afresh, are as tolerances predict.

    Args:
        sources: Where findings are read from.
        campaign: The campaign with the tolerances.
        other: The campaign with the fresh drives.
        confidence: Probability that an interval covers the number of caused violations.

    Raises:
        InvalidInput: The drives are the same, or cannot be compared.
    """
    _check_fresh(campaign, other)
    plan = (await sources.archives.get(campaign)).plan
    known, found = [
        await sources.tolerances.get(one, await sources.archives.get(one)) for one in (campaign, other)
    ]
    if found.layout.groups or found.config.fixed != known.config.fixed:
        raise InvalidInput.at(
            _FRESH,
            "expected a campaign that does not screen its drives, such as one with design: random, and with the same "
            "fixed parameters",
        )
    return await sources.analyses.run(lambda: agreement_view(campaign, plan, other, known, found, confidence))


def _check_fresh(campaign: Campaign, other: Campaign) -> None:
    if campaign.id == other.id:
        raise InvalidInput.at(_FRESH, f"expected another campaign than {campaign.id} itself")
    if campaign.body.seed == other.body.seed:
        raise InvalidInput.at(
            _FRESH,
            f"expected a campaign with another seed than {campaign.body.seed}: its drives are the same",
        )
    if campaign.body.problem != other.body.problem:
        raise InvalidInput.at(_FRESH, "expected a campaign on the same problem with the same parameters")


def agreement_view(
    campaign: Campaign,
    plan: Plan,
    other: Campaign,
    known: CampaignTolerance,
    found: CampaignTolerance,
    confidence: float,
) -> AgreementView:
    """Return whether fresh drives agree with the predictions of tolerances.

    Args:
        campaign: The campaign with the tolerances.
        plan: Its plan.
        other: The campaign with the fresh drives.
        known: The tolerances.
        found: What the fresh drives say.
        confidence: Probability that an interval covers the number of caused violations.

    Raises:
        InvalidInput: The campaigns have no cell in common.
    """
    places = {(cell.condition, cell.choices): place for place, cell in enumerate(found.layout.cells)}
    cells = []
    for place, (cell, curve) in enumerate(zip(known.layout.cells, known.curves, strict=True)):
        there = places.get((cell.condition, cell.choices))
        if there is None or known.layout.names != found.layout.names:
            continue
        fresh = found.curves[there]
        levels = np.repeat(np.arange(1, len(fresh.drives) + 1), fresh.drives)
        low, high = curve.predicted(
            levels, generator(campaign.body.seed, Stream.TOLERANCE, 3, place), confidence
        )
        caused = int(fresh.caused.sum())
        choices = dict(zip(known.layout.names, cell.choices, strict=True))
        cells.append(
            AgreementCell(
                place=place + 1,
                choices=choices,
                error=error_words(plan.problem, choices),
                condition=cell.condition,
                drives=len(levels),
                caused=caused,
                low=low,
                high=high,
                agrees=low <= caused <= high if len(levels) else None,
            )
        )
    if not cells:
        raise InvalidInput.at(_FRESH, f"campaign {other.id} has no cell in common with {campaign.id}")
    told = [cell.agrees for cell in cells if cell.agrees is not None]
    drives = sum(cell.drives for cell in cells)
    return AgreementView(
        campaign=campaign.id,
        fresh=other.id,
        confidence=confidence,
        drives=drives,
        agreeing=sum(told),
        note=_note(drives, told, len(cells) - len(told), confidence),
        cells=cells,
        table=_table(cells),
    )


def _note(drives: int, told: Sequence[bool], empty: int, confidence: float) -> str:
    """Say in how many cells fresh drives contradict a prediction, which few drives seldom do."""
    contrary = len(told) - sum(told)
    note = (
        f"{drives:,} fresh drives contradict the predictions in {contrary} of {len(told)} cells: there, the number "
        f"that violate because of the error is outside its interval of {confidence:.0%}. The fewer drives a cell "
        "has, the less it can contradict"
    )
    return f"{note}. {empty} cells have none" if empty else note


def _table(cells: Sequence[AgreementCell]) -> Table:
    return Table(
        name="agreement",
        title="Violations in fresh drives, and how many are predicted",
        columns=[
            Column(name="error", title="error"),
            Column(name="condition", title="condition"),
            Column(name="drives", title="drives", format=Format.COUNT),
            Column(name="caused", title="caused", format=Format.COUNT),
            Column(name="predicted", title="predicted"),
            Column(name="agrees", title="as predicted", format=Format.FLAG, optional=True),
        ],
        rows=[
            [one.error, one.condition, one.drives, one.caused, f"{one.low} to {one.high}", one.agrees]
            for one in cells
        ],
    )
