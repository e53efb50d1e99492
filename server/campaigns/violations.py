"""The violations of a campaign's unsafe solutions, read from their results, and the names people gave them."""

import logging
from collections.abc import Mapping
from typing import Any

from sqlalchemy import Connection, delete, insert, select

from brink.search.analysis.violations import (
    FoundViolation,
    Signature,
    is_at_fault,
    scaled_circumstances,
    signature_of,
)
from brink.server.db.models import ViolationNameRow
from brink.server.db.sql import database_now, note_change
from brink.server.problems.base import ReportsViolations
from brink.server.queue.job_store import unsafe_outcomes
from brink.worker.wire import Completed

log = logging.getLogger(__name__)


def read_violations(
    connection: Connection, campaign_id: str, problem: ReportsViolations
) -> list[FoundViolation]:
    """Return the violations of a campaign's unsafe solutions, ascending by number.

    Args:
        connection: Sees one snapshot.
        campaign_id: The campaign.
        problem: Its problem, which decides which violations count.
    """
    names = _read_names(connection, campaign_id)
    return [
        FoundViolation(
            number=outcome.number,
            circumstances=circumstances,
            signature=signature,
            name=names.get((outcome.number, str(circumstances["requirement"]))),
        )
        for outcome in unsafe_outcomes(connection, campaign_id)
        if outcome.result is not None
        for circumstances in problem.violations(Completed.model_validate_json(outcome.result))
        if (signature := _signature(outcome.number, circumstances)) is not None
    ]


def _signature(number: int, circumstances: Mapping[str, Any]) -> Signature | None:
    """Return the type of a violation, or None if a worker reported malformed circumstances."""
    try:
        scaled_circumstances(circumstances)
        is_at_fault(circumstances)
        return signature_of(circumstances)
    except (LookupError, TypeError, ValueError) as error:
        log.warning("solution %d: a violation that cannot be read: %r", number, error)
        return None


def _read_names(connection: Connection, campaign_id: str) -> Mapping[tuple[int, str], str]:
    """Return the names given by people, by number and requirement."""
    query = select(ViolationNameRow.__table__).where(ViolationNameRow.campaign_id == campaign_id)
    return {(row.number, row.requirement): row.name for row in connection.execute(query)}


def set_name(
    connection: Connection, campaign_id: str, number: int, requirement: str, name: str | None
) -> None:
    """Name a violation, or remove its name.

    Args:
        connection: In a write transaction.
        campaign_id: The campaign.
        number: Number of the solution.
        requirement: The violated requirement.
        name: The new name; None removes it.
    """
    note_change(connection, campaign_id)
    connection.execute(
        delete(ViolationNameRow).where(
            ViolationNameRow.campaign_id == campaign_id,
            ViolationNameRow.number == number,
            ViolationNameRow.requirement == requirement,
        )
    )
    if name is not None:
        connection.execute(
            insert(ViolationNameRow).values(
                campaign_id=campaign_id,
                number=number,
                requirement=requirement,
                name=name,
                named_at=database_now(connection),
            )
        )
