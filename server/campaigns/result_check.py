"""Checks results when workers report them: whether a campaign can evaluate what was reported for it.

A result without the requirements of its campaign says nothing about them. Stored, it would only turn up as a failure
at the next generation step, when no worker can be asked again.
"""

import logging
from collections import OrderedDict
from dataclasses import dataclass, field
from threading import Lock
from typing import Final

from sqlalchemy import Connection

from brink.search.algorithm import Evaluation, NeedsObjectives, Scored
from brink.server.campaigns.plan import Plan, make_plan
from brink.server.campaigns.store import CAMPAIGNS
from brink.server.errors import InvalidInput
from brink.server.problems.base import InProcessProblem, MeasuresOnData, NamesRequirements, Problem
from brink.server.states import JobKind
from brink.worker.wire import Completed

UNREADABLE: Final = (LookupError, ValueError, TypeError, ArithmeticError)
"""What a problem raises for a result that it cannot evaluate."""
CACHED: Final = 64

log = logging.getLogger(__name__)


def evaluate(problem: Problem, kind: JobKind, result: Completed) -> Evaluation:
    """Return the evaluation of a result.

    Args:
        problem: The problem of its campaign, one that is simulated.
        kind: What its job was for.
        result: The result.

    Raises:
        LookupError, ValueError, TypeError, ArithmeticError: The problem cannot evaluate it.
    """
    assert not isinstance(problem, InProcessProblem)
    if kind is JobKind.DATASET:
        assert isinstance(problem, MeasuresOnData)  # checked when the candidate was asked for
        return problem.measurement(result)
    return problem.evaluation(result)


@dataclass(slots=True)
class ResultCheck:
    """Checks the results of all campaigns; keeps the plans of the last ones."""

    _plans: OrderedDict[str, Plan | None] = field(default_factory=OrderedDict)
    _lock: Lock = field(default_factory=Lock)

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
        plan = self._plan(connection, campaign_id)
        if plan is None or isinstance(plan.problem, InProcessProblem):
            return None
        try:
            evaluation = evaluate(plan.problem, JobKind(kind), result)
        except UNREADABLE as error:
            return _reason(plan, result, error)
        except Exception:  # a plug-in's fault must not fail the results of others; the step reports it
            log.exception("result cannot be checked", extra={"campaign": campaign_id})
            return None
        if isinstance(evaluation, Scored) and isinstance(plan.algorithm, NeedsObjectives):
            needed = plan.algorithm.needed_objectives
            missing = [name for name in needed if name not in evaluation.objectives]
            if missing:
                return f"{plan.body.algorithm.id} expects the objective {missing[0]}, which is missing"
        return None

    def _plan(self, connection: Connection, campaign_id: str) -> Plan | None:
        """Return the plan of a campaign; None if it is gone, or cannot be made here."""
        with self._lock:
            if campaign_id in self._plans:
                self._plans.move_to_end(campaign_id)
                return self._plans[campaign_id]
        campaign = CAMPAIGNS.find(connection, campaign_id)
        try:
            plan = None if campaign is None else make_plan(campaign.body)
        except InvalidInput:  # its plug-in is not installed here
            plan = None
        with self._lock:
            self._plans[campaign_id] = plan
            while len(self._plans) > CACHED:
                self._plans.popitem(last=False)
        return plan


def _reason(plan: Plan, result: Completed, error: Exception) -> str:
    if isinstance(plan.problem, NamesRequirements):
        missing = [name for name in plan.problem.requirements if name not in result.verdicts]
        if missing:
            return f"expected a verdict of {', '.join(plan.problem.requirements)}; {missing[0]} is missing"
    return f"{plan.problem.id} cannot evaluate it: {type(error).__name__}: {error}"
