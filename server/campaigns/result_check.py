"""Checks results when workers report them: whether a campaign can evaluate what was reported for it.

A result without the requirements of its campaign says nothing about them. Stored, it would only turn up as a failure
at the next generation step, when no worker can be asked again.
"""

import logging
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Final

from sqlalchemy import Connection
from sqlalchemy.exc import SQLAlchemyError

from brink.search.algorithm import Evaluation, NeedsObjectives, Scored
from brink.server.campaigns.plan import Plan, make_plan
from brink.server.campaigns.store import CAMPAIGNS
from brink.server.errors import InvalidInput
from brink.server.problems.base import InProcessProblem, MeasuresOnData, NamesRequirements, SimulatedProblem
from brink.server.states import JobKind
from brink.worker.wire import Completed

UNREADABLE: Final = (LookupError, ValueError, TypeError, ArithmeticError)
"""What a problem raises for a result that it cannot evaluate."""
CACHED: Final = 1000
"""Number of campaigns whose expectations are kept; more hardly ever run at once."""

log = logging.getLogger(__name__)


def evaluate(problem: SimulatedProblem, kind: JobKind, result: Completed) -> Evaluation:
    """Return the evaluation of a result.

    Args:
        problem: The problem of its campaign.
        kind: What its job was for.
        result: The result.

    Raises:
        LookupError, ValueError, TypeError, ArithmeticError: The problem cannot evaluate it.
    """
    if kind is JobKind.DATASET:
        assert isinstance(problem, MeasuresOnData)  # checked when the candidate was asked for
        return problem.measurement(result)
    return problem.evaluation(result)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Expected:
    """What a campaign expects of its results.

    Attributes:
        problem: Its problem.
        algorithm: Id of its algorithm.
        objectives: The objectives that the algorithm needs.
    """

    problem: SimulatedProblem
    algorithm: str
    objectives: tuple[str, ...]


@dataclass(slots=True)
class ResultCheck:
    """Checks the results of all campaigns, on the writer's thread; keeps what the last ones expect."""

    _expected: OrderedDict[str, _Expected | None] = field(default_factory=OrderedDict)

    def __call__(self, connection: Connection, campaign_id: str, kind: str, result: Completed) -> str | None:
        """Return why a campaign cannot use a result, or None if it can.

        Args:
            connection: In any transaction.
            campaign_id: The campaign.
            kind: What the result's job was for.
            result: The result.
        """
        if kind == JobKind.TRACE:  # the trace is what counts, and it is checked when it is drawn
            return None
        expected = self._of(connection, campaign_id)
        if expected is None:
            return None
        try:
            evaluation = evaluate(expected.problem, JobKind(kind), result)
        except UNREADABLE as error:
            return _reason(expected.problem, result, error)
        except Exception:  # a plug-in's fault must not fail the results of others; the step reports it
            log.exception("result cannot be checked", extra={"campaign": campaign_id})
            return None
        if isinstance(evaluation, Scored):
            missing = [name for name in expected.objectives if name not in evaluation.objectives]
            if missing:
                return f"{expected.algorithm} expects the objective {missing[0]}, which is missing"
        return None

    def _of(self, connection: Connection, campaign_id: str) -> _Expected | None:
        """Return what a campaign expects; None if it is gone, or expects nothing that can be checked here."""
        if campaign_id in self._expected:
            self._expected.move_to_end(campaign_id)
            return self._expected[campaign_id]
        try:
            campaign = CAMPAIGNS.find(connection, campaign_id)
            expected = None if campaign is None else _expected(make_plan(campaign.body))
        except InvalidInput:  # its plug-in is not installed here
            expected = None
        except SQLAlchemyError:
            raise
        except (
            Exception
        ):  # a plug-in that does not load must not fail the results of others; the step reports it
            log.exception("results cannot be checked", extra={"campaign": campaign_id})
            expected = None
        self._expected[campaign_id] = expected
        while len(self._expected) > CACHED:
            self._expected.popitem(last=False)
        return expected


def _expected(plan: Plan) -> _Expected | None:
    if isinstance(plan.problem, InProcessProblem):
        return None
    needed = plan.algorithm.needed_objectives if isinstance(plan.algorithm, NeedsObjectives) else ()
    return _Expected(problem=plan.problem, algorithm=plan.body.algorithm.id, objectives=tuple(needed))


def _reason(problem: SimulatedProblem, result: Completed, error: Exception) -> str:
    if isinstance(problem, NamesRequirements):
        missing = [name for name in problem.requirements if name not in result.verdicts]
        if missing:
            return f"expected a verdict of {', '.join(problem.requirements)}; {missing[0]} is missing"
    return f"{problem.id} cannot evaluate it: {type(error).__name__}: {error}"
