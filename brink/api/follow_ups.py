"""Follow-ups of pairs in clients: what they simulate, and how they are resumed."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from brink.api.client import Api
from brink.server.campaigns.follow_ups.limits import MOST_PAIRS_FOLLOWED
from brink.server.findings.boundary.repeat_views import RepeatsView
from brink.server.findings.follow_ups import FollowUpView
from brink.server.states import CampaignStatus, FollowUpKind

OPEN: Final = (CampaignStatus.RUNNING, CampaignStatus.PAUSED)


def follow_up_requests(
    settings: Mapping[str, float],
    confirm: int | None,
    *,
    component: bool,
    minimise: bool = False,
    sharpen: bool = False,
    limit: int | None = None,
) -> list[dict[str, Any]]:
    """Return the request bodies of follow-ups.

    Args:
        settings: ``eps`` and ``d_th``, where they are not the campaign's own.
        confirm: Most simulations of each side with other seeds; None or 0 for none.
        component: Whether to ask if the component is to blame.
        minimise: Whether to revert differences.
        sharpen: Whether to bring pairs to thresholds.
        limit: Most pairs to ask about, first ones first; None for as many as a follow-up takes.
    """
    shared: dict[str, Any] = dict(settings)
    if limit is not None:
        shared["limit"] = min(limit, MOST_PAIRS_FOLLOWED)
    requests: list[dict[str, Any]] = []
    if confirm:
        requests.append({"kind": FollowUpKind.CONFIRM.value, "repeats": confirm, **shared})
    if component:
        requests.append({"kind": FollowUpKind.COMPONENT.value, **shared})
    if minimise:
        requests.append({"kind": FollowUpKind.MINIMISE.value, **shared})
    if sharpen:
        requests.append({"kind": FollowUpKind.SHARPEN.value, **shared})
    return requests


def follow_up_options(requests: Sequence[dict[str, Any]]) -> str:
    """Return the command-line options of follow-ups, for hints."""
    words = [f"--{one['kind']}" + (f" {one['repeats']}" if "repeats" in one else "") for one in requests]
    words += [
        f"--{name.replace('_', '-')} {requests[0][name]:g}"
        for name in ("eps", "d_th", "limit")
        if name in requests[0]
    ]
    return " ".join(words)


async def continue_follow_up(api: Api, found: FollowUpView | RepeatsView) -> None:
    """Resume a follow-up that was paused by a user, rather than by failures."""
    if found.status is CampaignStatus.PAUSED and not found.status_reason:
        await api.post(f"/campaigns/{found.campaign}/resume")
