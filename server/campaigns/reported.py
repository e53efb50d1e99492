"""Reported results that a search has not received yet: it receives whole generations.

They are preliminary only in that the search has not scored them. Their verdicts do not change any more.
"""

import logging
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from threading import Lock
from typing import Any, Final

import numpy as np
from pydantic import ValidationError
from sqlalchemy import Connection, select
from sqlalchemy.exc import SQLAlchemyError

from brink.search.algorithm import Scored
from brink.search.space import FloatArray
from brink.server.campaigns.outcomes import OutcomeGroup, outcome_of
from brink.server.campaigns.plan import make_plan
from brink.server.campaigns.store import Campaign
from brink.server.db.models import JobRow, SolutionRow
from brink.server.errors import InvalidInput
from brink.server.problems.base import InProcessProblem, SimulatedProblem
from brink.server.states import ENDED, JobKind, JobStatus
from brink.worker.wire import Completed

MOST: Final = 2_000
"""Maximum number of results of one campaign that are read: a generation can be larger, but a page need not be."""
CACHED: Final = 8

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReportedResult:
    """The result of one simulation.

    Attributes:
        number: Number of the solution.
        vector: The solution, shape ``(d,)``.
        unsafe: Its verdict.
        robustness: Its robustness.
        outcome: What it showed, without moments.
    """

    number: int
    vector: FloatArray
    unsafe: bool
    robustness: float
    outcome: OutcomeGroup


@dataclass(frozen=True, kw_only=True, eq=False)
class Reported:
    """Results of a campaign that its search has not received yet, in order of number.

    Attributes:
        results: Those with a verdict.
    """

    results: Sequence[ReportedResult] = ()

    @property
    def unsafe(self) -> int:
        """Number of unsafe ones."""
        return sum(one.unsafe for one in self.results)

    @cached_property
    def vectors(self) -> FloatArray:
        """The solutions, shape ``(n, d)``."""
        return np.array([one.vector for one in self.results], np.float64)


@dataclass(slots=True)
class _Parsed:
    """Results of one campaign that its search had not received when they were last read.

    Attributes:
        problem: The problem of the campaign; None if its results cannot be read here.
        results: Results by number; None where there is no verdict.
    """

    problem: SimulatedProblem | None
    results: dict[int, ReportedResult | None] = field(default_factory=dict)


@dataclass(slots=True)
class ReportedResults:
    """Reads reported results; each is parsed once."""

    _parsed: OrderedDict[str, _Parsed] = field(default_factory=OrderedDict)
    _lock: Lock = field(default_factory=Lock)

    def read(self, connection: Connection, campaign: Campaign) -> Reported:
        """Return the results of a campaign that its search has not received yet; none once it has ended.

        Args:
            connection: Sees one snapshot.
            campaign: The campaign.
        """
        numbers = [] if campaign.status in ENDED else _read_numbers(connection, campaign)
        if not numbers:
            return Reported()
        parsed = self._of(campaign)
        known, problem = parsed.results, parsed.problem
        new = [number for number in numbers if number not in known]
        if new and problem is not None:
            try:
                known = {**known, **_read_new(connection, campaign, problem, new)}
            except SQLAlchemyError:
                raise
            except Exception:  # a plug-in's fault, or code that hangs, must not hide the campaign's progress
                log.exception("reported results cannot be read", extra={"campaign": campaign.id})
                parsed.problem = None
        # Another thread may read the same campaign: replaced, not changed in place.
        parsed.results = found = {number: known[number] for number in numbers if number in known}
        return Reported(results=[one for one in found.values() if one is not None])

    def _of(self, campaign: Campaign) -> _Parsed:
        parsed = self._parsed.get(campaign.id)
        if parsed is None:  # made without the lock: it may be user code
            parsed = _Parsed(problem=_problem_of(campaign))
        with self._lock:
            parsed = self._parsed.setdefault(campaign.id, parsed)
            self._parsed.move_to_end(campaign.id)
            while len(self._parsed) > CACHED:
                self._parsed.popitem(last=False)
            return parsed


def _problem_of(campaign: Campaign) -> SimulatedProblem | None:
    try:
        problem = make_plan(campaign.body).problem
    except InvalidInput:  # its plug-in is not installed here
        return None
    except Exception:  # a plug-in's fault must not hide the campaign's progress, which says what is wrong
        log.exception("reported results cannot be read", extra={"campaign": campaign.id})
        return None
    return None if isinstance(problem, InProcessProblem) else problem


def read_asked(connection: Connection, campaign: Campaign, dimension: int) -> FloatArray:
    """Return the solutions that a search waits for, reported or not, shape ``(n, dimension)``.

    Args:
        connection: Sees one snapshot.
        campaign: The campaign.
        dimension: Dimension of its search space.
    """
    query = (
        select(SolutionRow.vector)
        .where(SolutionRow.campaign_id == campaign.id, SolutionRow.generation >= campaign.generation)
        .order_by(SolutionRow.number)
        .limit(MOST)
    )
    vectors = [np.frombuffer(vector, dtype="<f8") for vector in connection.execute(query).scalars()]
    return np.array(vectors, np.float64).reshape(-1, dimension)


def _read_numbers(connection: Connection, campaign: Campaign) -> list[int]:
    query = (
        select(JobRow.number)
        .join(
            SolutionRow,
            (SolutionRow.campaign_id == JobRow.campaign_id) & (SolutionRow.number == JobRow.number),
        )
        .where(
            SolutionRow.campaign_id == campaign.id,
            SolutionRow.generation >= campaign.generation,
            JobRow.kind == JobKind.EPISODE,
            JobRow.status == JobStatus.DONE,
        )
        .order_by(JobRow.number)
        .limit(MOST)
    )
    return list(connection.execute(query).scalars())


def _read_new(
    connection: Connection, campaign: Campaign, problem: SimulatedProblem, numbers: Sequence[int]
) -> Mapping[int, ReportedResult | None]:
    """Return results by number; None where there is no verdict."""
    query = (
        select(SolutionRow.number, SolutionRow.vector, JobRow.result)
        .join(JobRow, (JobRow.campaign_id == SolutionRow.campaign_id) & (JobRow.number == SolutionRow.number))
        .where(
            SolutionRow.campaign_id == campaign.id,
            SolutionRow.number.in_(numbers),
            JobRow.kind == JobKind.EPISODE,
        )
    )
    return {
        row.number: _parsed(problem, row.number, row.vector, row.result)
        for row in connection.execute(query).all()  # read to the end, whatever the problem raises
    }


def _parsed(problem: SimulatedProblem, number: int, vector: bytes, text: str | None) -> ReportedResult | None:
    try:
        result = Completed.model_validate_json(text or "")
        evaluation = problem.evaluation(result)
    except (ValidationError, LookupError, ValueError, TypeError, ArithmeticError):
        return None  # the search is told that it failed
    if not isinstance(evaluation, Scored):
        return None
    document: dict[str, Any] = result.model_dump(mode="json")
    outcome = outcome_of(problem, document, safe=not evaluation.unsafe, robustness=evaluation.robustness)
    return ReportedResult(
        number=number,
        vector=np.frombuffer(vector, dtype="<f8"),
        unsafe=evaluation.unsafe,
        robustness=evaluation.robustness,
        outcome=OutcomeGroup.of(outcome),
    )
