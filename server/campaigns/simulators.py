"""Which simulator and plug-ins a campaign was simulated with, and whether they are still installed here.

The id of a simulator carries a version, which is raised when its results change. Plug-ins other than Brink's own are
edited under one id, so their sources count as well (`brink.sim.sources`). Results of two versions do not belong in
one archive: a campaign that was simulated with another one is shown as it is, but neither continued nor repeated.
"""

import logging
from collections.abc import Mapping

from sqlalchemy import Connection, select

from brink.server.campaigns.plan import make_plan
from brink.server.campaigns.store import Campaign
from brink.server.db.models import JobRow
from brink.server.errors import InvalidInput
from brink.server.problems.base import SimulatedProblem
from brink.server.states import JobKind
from brink.sim.catalogue import SHOWN_DIGITS

log = logging.getLogger(__name__)


def other_simulator(connection: Connection, campaign: Campaign) -> str | None:
    """Return why a campaign cannot be continued or repeated here, or None if simulator and plug-ins are the same.

    Args:
        connection: To the database.
        campaign: The campaign. Plug-ins that are missing here are not compared: this may be a coordinator beside
            that of the campaign, and workers are asked for what only they need.
    """
    try:
        plan = make_plan(campaign.body)
    except InvalidInput:
        return None
    here = plan.body.sources
    before = {key: digest for key, digest in campaign.body.sources.items() if key in here}
    if (changed := changed_sources(before, here)) is not None:
        return (
            f"this campaign was simulated with different code of {changed}, whose results may differ. "
            "Continue with the code that it began with, or submit it again."
        )
    if plan.body.sources and not campaign.body.sources:
        log.warning(
            "the version of Brink that started this campaign did not record the source of its plug-ins: edits since "
            "then cannot be detected",
            extra={"campaign": campaign.id},
        )
    problem = plan.problem
    if not isinstance(problem, SimulatedProblem):
        return None
    began_with = simulator_of(connection, campaign.id)
    if began_with is None or began_with == problem.needs:
        return None
    return (
        f"this campaign was simulated with {began_with}, but {campaign.body.problem.id} now uses {problem.needs}, "
        "whose results differ. Continue with the version of Brink that started the campaign, or submit it again."
    )


def simulator_of(connection: Connection, campaign_id: str) -> str | None:
    """Return the simulator that a campaign began with, such as ``brink-drive@3``; None if nothing was simulated."""
    query = (
        select(JobRow.needs)
        .where(JobRow.campaign_id == campaign_id, JobRow.kind == JobKind.EPISODE)
        .order_by(JobRow.id)
        .limit(1)
    )
    return connection.execute(query).scalar_one_or_none()


def changed_sources(before: Mapping[str, str], now: Mapping[str, str]) -> str | None:
    """Describe the plug-ins whose source has changed since then; None if none has.

    Args:
        before: Digests of a campaign's plug-ins, `CampaignBody.sources`; none in a campaign of an older version.
        now: Those of the same plug-ins here.
    """
    if not before:
        return None
    changed = [
        f"{key.partition('/')[2]} (source {before.get(key, 'unknown')[:SHOWN_DIGITS]}, here "
        f"{now.get(key, 'unknown')[:SHOWN_DIGITS]})"
        for key in sorted({*before, *now})
        if before.get(key) != now.get(key)
    ]
    return ", ".join(changed) or None
