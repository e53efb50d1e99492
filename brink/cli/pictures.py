"""Files of a campaign: its boundary, its archive, its figures, replays of its best solutions."""

import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from brink.api.client import Api
from brink.search.archive import Archive
from brink.server.campaigns.body import CampaignBody
from brink.server.campaigns.plan import Plan, make_plan


@dataclass(frozen=True, slots=True, kw_only=True)
class FetchedArchive:
    """A campaign's archive, fetched over the API."""

    id: str
    body: CampaignBody
    plan: Plan
    archive: Archive
    generations: tuple[int, ...]


async def fetch_archive(api: Api, campaign_id: str) -> FetchedArchive:
    """Return the archive of a campaign.

    Raises:
        CoordinatorSaid: There is no such campaign.
    """
    campaign = await api.get(f"/campaigns/{campaign_id}")
    body = CampaignBody.model_validate(campaign["body"])
    response = await api.request("GET", f"/campaigns/{campaign_id}/archive.npz")
    with np.load(io.BytesIO(response.content), allow_pickle=False) as npz:
        arrays = {name: npz[name] for name in npz.files}
    plan = make_plan(body)
    archive = Archive.restore(
        plan.problem.space,
        plan.neighbourhood,
        **{
            name: arrays[name]
            for name in ("numbers", "vectors", "unsafe", "robustness", "neighbours", "unsafe_neighbours")
        },
    )
    generations = arrays["generations"]
    ends = np.searchsorted(generations, np.unique(generations), side="right")
    return FetchedArchive(
        id=campaign["id"], body=body, plan=plan, archive=archive, generations=tuple(int(end) for end in ends)
    )


def draw_figures(
    fetched: FetchedArchive, folder: Path, *, t_b: float, d_th: float, formats: tuple[str, ...] = ("png",)
) -> list[Path]:
    """Write all figures of a campaign; return their files."""
    # matplotlib takes half a second to load: only those who draw wait for it.
    from brink.plots import CampaignFigures, write_campaign_figures

    figures = CampaignFigures(
        archive=fetched.archive,
        space=fetched.plan.problem.space,
        title=fetched.body.name,
        generation_ends=fetched.generations,
        t_b=t_b,
        d_th=d_th,
    )
    return write_campaign_figures(figures, folder, formats=formats)


async def write_results(
    api: Api, campaign_id: str, folder: Path, *, t_b: float, d_th: float
) -> dict[str, Any]:
    """Write boundary (CSV and JSON) and archive of a campaign; return the boundary."""
    folder.mkdir(parents=True, exist_ok=True)
    params = {"t_b": t_b, "d_th": d_th}
    boundary: dict[str, Any] = await api.get(f"/campaigns/{campaign_id}/boundary", params)
    (folder / "boundary.json").write_text(json.dumps(boundary, indent=2) + "\n", encoding="utf-8")
    table = await api.request("GET", f"/campaigns/{campaign_id}/boundary", params={**params, "format": "csv"})
    (folder / "boundary.csv").write_bytes(table.content)
    archive = await api.request("GET", f"/campaigns/{campaign_id}/archive.npz")
    (folder / "archive.npz").write_bytes(archive.content)
    return boundary
