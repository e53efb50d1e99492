"""Reads the violations that a campaign found out of its stored results."""

import logging
from collections.abc import Iterable, Mapping
from typing import Any

from sqlalchemy import Row

from brink.search.analysis.violations import FoundViolation, Signature, scaled_circumstances, signature_of
from brink.server.problems.base import TellsViolations
from brink.worker.wire import Completed

log = logging.getLogger(__name__)


def found_violations(
    rows: Iterable[Row[*tuple[Any, ...]]], names: Mapping[tuple[int, str], str], problem: TellsViolations
) -> list[FoundViolation]:
    """Return the violations of unsafe solutions.

    Args:
        rows: Number and result of each, ascending by number.
        names: What people say, by number and requirement.
        problem: Says which violations count.
    """
    return [
        FoundViolation(
            number=row.number,
            circumstances=circumstances,
            signature=signature,
            name=names.get((row.number, str(circumstances["requirement"]))),
        )
        for row in rows
        if row.result is not None
        for circumstances in problem.violations(Completed.model_validate_json(row.result))
        if (signature := _signature(row.number, circumstances)) is not None
    ]


def _signature(number: int, circumstances: Mapping[str, Any]) -> Signature | None:
    """Return the type of a violation; None if a worker told its circumstances in another form."""
    try:
        scaled_circumstances(circumstances)
        return signature_of(circumstances)
    except (LookupError, TypeError, ValueError) as error:
        log.warning("solution %d: a violation that cannot be read: %r", number, error)
        return None
