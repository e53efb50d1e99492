"""Which simulator a campaign was simulated with, and whether this installation still has it.

The id of a simulator carries a version, which is raised when its results change. Results of two versions do not
belong in one archive: a campaign that was simulated with another version is shown as it is, but neither continued nor
repeated.
"""

from sqlalchemy import Connection, select

from brink.server.campaigns.plan import make_plan
from brink.server.campaigns.store import Campaign
from brink.server.db.models import JobRow
from brink.server.errors import InvalidInput
from brink.server.problems.base import SimulatedProblem
from brink.server.states import JobKind


def other_simulator(connection: Connection, campaign: Campaign) -> str | None:
    """Return why a campaign cannot be continued or repeated here, or None if its simulator is the problem's.

    Args:
        connection: To the database.
        campaign: The campaign; one whose plug-ins are missing is not checked.
    """
    try:
        problem = make_plan(campaign.body).problem
    except InvalidInput:
        return None
    if not isinstance(problem, SimulatedProblem):
        return None
    query = (
        select(JobRow.needs)
        .where(JobRow.campaign_id == campaign.id, JobRow.kind == JobKind.EPISODE)
        .order_by(JobRow.id)
        .limit(1)
    )
    began_with = connection.execute(query).scalar_one_or_none()
    if began_with is None or began_with == problem.needs:
        return None
    return (
        f"this campaign was simulated with {began_with}, but {campaign.body.problem.id} now uses {problem.needs}, "
        "whose results differ. Continue with the version of Brink that started the campaign, or submit it again."
    )
