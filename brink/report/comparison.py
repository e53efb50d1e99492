"""Campaigns side by side, each with its control, from their archives."""

from collections.abc import Sequence

from brink.api.results import FetchedArchive
from brink.search.analysis.comparison import ComparedCampaign, Row
from brink.search.analysis.comparison import compare as compare_campaigns


def compared_archives(fetched: Sequence[FetchedArchive], *, control: bool) -> list[Row]:
    """Compare the archives of campaigns; a campaign given twice counts once."""
    fetched = list({item.id: item for item in fetched}.values())
    labels = _labels(fetched)
    return compare_campaigns(
        [
            ComparedCampaign(
                id=item.id,
                label=labels[item.id],
                space=item.plan.problem.space,
                archive=item.archive,
                simulations=item.body.budget.simulations,
                seed=item.body.seed,
            )
            for item in fetched
        ],
        control=control,
    )


def simulator_words(fetched: Sequence[FetchedArchive]) -> str:
    """Warn of campaigns that were simulated with different simulators; empty if all have the same one.

    Args:
        fetched: The campaigns; those without any simulation count as having none, not another one.
    """
    labels = _labels(fetched)
    campaigns: dict[str, list[str]] = {}
    for item in {item.id: item for item in fetched}.values():
        if item.simulator is not None:
            campaigns.setdefault(item.simulator, []).append(labels[item.id])
    if len(campaigns) < 2:
        return ""
    told = "; ".join(f"{simulator}: {', '.join(names)}" for simulator, names in campaigns.items())
    return (
        f"Simulated with different simulators, which may explain differences between the campaigns: {told}. "
        "Simulate them again with one simulator to compare anything else."
    )


def _labels(fetched: Sequence[FetchedArchive]) -> dict[str, str]:
    """Return the name of each campaign, by id, with the id appended where two have the same name."""
    names = {item.id: item.body.name for item in fetched}
    shared = [name for name in names.values() if list(names.values()).count(name) > 1]
    return {one: f"{name} {one}" if name in shared else name for one, name in names.items()}
