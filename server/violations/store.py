"""The SQL of violations: results of unsafe solutions, and the names that people give."""

from collections.abc import Mapping
from typing import Any

from sqlalchemy import Connection, Row, delete, insert, select

from brink.server.db.clock import database_now
from brink.server.db.locking import note_change
from brink.server.db.models import EVALUATES, JobRow, SolutionRow, ViolationNameRow
from brink.server.states import SolutionVerdict


def unsafe_results(connection: Connection, campaign_id: str) -> list[Row[*tuple[Any, ...]]]:
    """Return number, generation and result of every unsafe solution, ascending by number."""
    query = (
        select(SolutionRow.number, SolutionRow.generation, JobRow.result)
        .join(
            JobRow,
            (JobRow.campaign_id == SolutionRow.campaign_id)
            & (JobRow.number == SolutionRow.number)
            & EVALUATES,
        )
        .where(SolutionRow.campaign_id == campaign_id, SolutionRow.verdict == SolutionVerdict.UNSAFE)
        .order_by(SolutionRow.number)
    )
    return list(connection.execute(query))


def read_names(connection: Connection, campaign_id: str) -> Mapping[tuple[int, str], str]:
    """Return the names that people gave, by number and requirement."""
    query = select(ViolationNameRow.__table__).where(ViolationNameRow.campaign_id == campaign_id)
    return {(row.number, row.requirement): row.name for row in connection.execute(query)}


def give_name(
    connection: Connection, campaign_id: str, number: int, requirement: str, name: str | None
) -> None:
    """Name a violation, or take its name away."""
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
                campaign_id=campaign_id, number=number, requirement=requirement, name=name,
                named_at=database_now(connection),
            )
        )  # fmt: skip
