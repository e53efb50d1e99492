"""Campaigns side by side, each with its control, from their archives."""

from collections.abc import Sequence

from brink.api.results import FetchedArchive
from brink.search.analysis.comparison import ComparedCampaign, Row
from brink.search.analysis.comparison import compare as compare_campaigns


def compared_archives(fetched: Sequence[FetchedArchive], *, control: bool) -> list[Row]:
    """Compare the archives of campaigns; a campaign given twice counts once."""
    fetched = list({item.id: item for item in fetched}.values())
    names = [item.body.name for item in fetched]
    return compare_campaigns(
        [
            ComparedCampaign(
                id=item.id,
                label=item.body.name if names.count(item.body.name) == 1 else f"{item.body.name} {item.id}",
                space=item.plan.problem.space,
                archive=item.archive,
                simulations=item.body.budget.simulations,
                seed=item.body.seed,
            )
            for item in fetched
        ],
        control=control,
    )
