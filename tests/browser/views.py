"""Every view of the dashboard, with something to look at, and how to see that it is all there."""

from collections.abc import Sequence
from dataclasses import dataclass

from playwright.sync_api import Page
from playwright.sync_api import expect as shown

PATIENCE_MS = 60_000
"""For what a worker has to simulate first."""


TABS = {
    "results": ".kind tbody tr",
    "parameters": ".panel svg",
    "search": ".chart canvas",
    "settings": "section[aria-label='Settings'] tbody tr",
}
"""What is there once a tab of a campaign is drawn, by tab."""


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """A view.

    Attributes:
        name: What it is called.
        place: The address from the ``#`` on.
        ready: Selectors of what is there once it is all drawn.
    """

    name: str
    place: str
    ready: tuple[str, ...]


def views_of(
    campaign: str,
    solution: int,
    compared: Sequence[str],
    experiment: str,
    pairs: str,
    pair: str,
    thresholds: str = "",
) -> list[View]:
    """Return all views but that which asks for a token.

    Args:
        campaign: With boundary solutions.
        solution: One of them.
        compared: Campaigns.
        experiment: That has finished.
        pairs: The address of a campaign's pairs.
        pair: The address of one of them.
        thresholds: The query of the campaign's address.
    """
    query = f"{thresholds}&" if thresholds else "?"
    return [
        View(name="campaigns", place="#/", ready=("table.campaigns tbody tr",)),
        View(
            name="campaign",
            place=f"#/campaigns/{campaign}{thresholds}",
            ready=("canvas.map", ".legend li", ".finding dd"),
        ),
        *(
            View(name=f"campaign, {tab}", place=f"#/campaigns/{campaign}{query}tab={tab}", ready=(ready,))
            for tab, ready in TABS.items()
        ),
        View(name="new-campaign", place="#/new", ready=("text=Submit campaign",)),
        View(
            name="solution",
            place=f"#/campaigns/{campaign}/solutions/{solution}",
            ready=("role=button[name='Play']", ".replay-map canvas"),
        ),
        View(name="pairs", place=pairs, ready=("table.finding tbody tr",)),
        View(
            name="pair",
            place=pair,
            ready=("role=button[name='Play']", ".drive canvas", "text=Both drives over time"),
        ),
        View(
            name="compare", place=f"#/compare?ids={','.join(compared)}", ready=(".chart canvas", ".chips li")
        ),
        View(name="experiments", place="#/experiments", ready=("table.experiments tbody tr",)),
        View(
            name="experiment",
            place=f"#/experiments/{experiment}",
            ready=("text=Campaigns finished", "main img, main canvas"),
        ),
        View(name="workers", place="#/workers", ready=("table.workers tbody tr",)),
        View(name="jobs", place="#/jobs?status=quarantined", ready=("table.jobs tbody tr",)),
    ]


def open_view(page: Page, url: str, view: View) -> None:
    """Go to a view, and wait until it is all there."""
    page.goto(f"{url}/{view.place}")
    for selector in view.ready:
        shown(page.locator(selector).first).to_be_visible(timeout=PATIENCE_MS)
