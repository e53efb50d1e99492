"""Checks reported results: whether their campaign can evaluate them.

A result without the requirements of its campaign says nothing about them. Stored, it would only turn up as a failure
at the next generation step, when no worker can be asked again.
"""

import asyncio
import logging
import time
from collections import Counter, OrderedDict
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from threading import Lock
from typing import Final

from brink.search.algorithm import Evaluation, NeedsObjectives, Scored
from brink.server.campaigns.plan import Plan, make_plan
from brink.server.campaigns.store import CAMPAIGNS, Campaign
from brink.server.db.engine import Engines, read
from brink.server.errors import InvalidInput, Unavailable
from brink.server.problems.base import InProcessProblem, MeasuresOnData, SimulatedProblem
from brink.server.problems.catalogue import PROBLEMS, uses_user_code
from brink.server.queue.report_store import Judgement, UnjudgedResult
from brink.server.states import JobKind
from brink.server.user_code import USER_CODE
from brink.sim.catalogue import is_own_plugin
from brink.worker.wire import Completed

UNREADABLE: Final = (LookupError, ValueError, TypeError, ArithmeticError)
"""Errors that a problem raises for a result that it cannot evaluate."""
CACHED: Final = 1000
"""Number of campaigns whose expectations are kept; more hardly ever run at once."""
CHECK_S: Final = 1.0
"""How long a worker's request waits for a plug-in's code."""
MOST_LATE: Final = 3
"""After this many checks that took longer, the results of a campaign are not checked for `UNCHECKED_S`."""
UNCHECKED_S: Final = 60.0
"""How long the results of a campaign are stored unchecked after its code has failed to check one."""
CHECKS_AT_ONCE: Final = 4

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
    """A campaign's expectations of its results.

    Attributes:
        problem: Its problem.
        algorithm: Id of its algorithm.
        objectives: The objectives that the algorithm needs.
        user_code: Whether the problem is user code.
    """

    problem: SimulatedProblem
    algorithm: str
    objectives: tuple[str, ...]
    user_code: bool


@dataclass(frozen=True, slots=True)
class _Unchecked:
    """The results of a campaign are stored unchecked, until its code is tried again.

    Attributes:
        until: When that is, on the monotonic clock.
    """

    until: float = field(default_factory=lambda: time.monotonic() + UNCHECKED_S)


@dataclass(slots=True)
class ResultChecks:
    """Checks the results of all campaigns; caches the latest expectations. Safe to use from several threads.

    Brink's own problems check a result in the write transaction that stores it. A plug-in's code may take long, so it
    is called before that, on threads of its own, and nobody waits longer than `CHECK_S`: a result that is not checked
    by then is stored unchecked. If it turns out to be of no use, the generation step says so.

    Attributes:
        engines: The database.
    """

    engines: Engines
    _expected: OrderedDict[str, _Expected | _Unchecked] = field(default_factory=OrderedDict)
    _late: Counter[str] = field(default_factory=Counter)
    _running: Counter[str] = field(default_factory=Counter)
    _lock: Lock = field(default_factory=Lock)
    _threads: ThreadPoolExecutor = field(
        default_factory=lambda: ThreadPoolExecutor(CHECKS_AT_ONCE, thread_name_prefix="brink-result-check")
    )

    def __call__(self, campaign_id: str, kind: str, result: Completed) -> Judgement | None:
        """Return whether a campaign can use a result; None if that cannot be decided in a transaction.

        Args:
            campaign_id: The campaign.
            kind: What the result's job was for.
            result: The result.
        """
        if kind == JobKind.TRACE:  # the trace is what counts, and it is checked when it is drawn
            return Judgement()
        expected = self._known(campaign_id)
        if isinstance(expected, _Unchecked):
            return Judgement()
        if expected is None or expected.user_code:
            return None
        return self._judgement(expected, campaign_id, kind, result)

    async def judge(self, results: Sequence[UnjudgedResult]) -> Sequence[Judgement]:
        """Return whether campaigns can use results, within `CHECK_S`."""
        campaigns = list(dict.fromkeys(result.campaign for result in results))
        found = await asyncio.gather(
            *(
                self._judge([result for result in results if result.campaign == name], name)
                for name in campaigns
            )
        )
        judged = {name: iter(judgements) for name, judgements in zip(campaigns, found, strict=True)}
        return [next(judged[result.campaign]) for result in results]

    def close(self) -> None:
        """End the threads."""
        self._threads.shutdown(wait=True, cancel_futures=True)

    async def _judge(self, results: Sequence[UnjudgedResult], campaign_id: str) -> Sequence[Judgement]:
        """Return whether a campaign can use results. If the check is too slow, or was earlier, accept all of them."""
        unchecked = [Judgement()] * len(results)
        if self._late[campaign_id] and self._running[campaign_id]:
            return unchecked
        campaign = await read(self.engines, lambda connection: CAMPAIGNS.find(connection, campaign_id))
        if campaign is None:
            return unchecked
        loop = asyncio.get_running_loop()
        if not uses_user_code(campaign.body.problem.id, campaign.body.algorithm.id):
            return await loop.run_in_executor(None, self._look, results, campaign)
        self._running[campaign_id] += 1
        judging = loop.run_in_executor(self._threads, self._look, results, campaign)
        judging.add_done_callback(lambda _: self._end(campaign_id))
        done, _ = await asyncio.wait([judging], timeout=CHECK_S)
        if done:
            return judging.result()
        judging.add_done_callback(_ignore)
        self._late[campaign_id] += 1
        log.warning("results are stored unchecked: the plug-in is slow", extra={"campaign": campaign_id})
        if self._late[campaign_id] >= MOST_LATE:
            self._keep(campaign_id, _Unchecked())
        return unchecked

    def _end(self, campaign_id: str) -> None:
        self._running[campaign_id] -= 1
        if not self._running[campaign_id]:
            del self._running[campaign_id]

    def _look(self, results: Sequence[UnjudgedResult], campaign: Campaign) -> Sequence[Judgement]:
        with USER_CODE.on_behalf(f"results of {campaign.id}"):
            expected = self._find(campaign)
            if isinstance(expected, _Unchecked):
                return [Judgement()] * len(results)
            judged: list[Judgement] = []
            for result in results:
                if isinstance(self._known(campaign.id), _Unchecked):
                    break  # the check of an earlier one failed or was late
                judged.append(self._judgement(expected, campaign.id, result.kind, result.result))
            return judged + [Judgement()] * (len(results) - len(judged))

    def _judgement(self, expected: _Expected, campaign_id: str, kind: str, result: Completed) -> Judgement:
        try:
            evaluation = evaluate(expected.problem, JobKind(kind), result)
        except UNREADABLE as error:
            return Judgement(_reason(expected.problem, result, error))
        except Unavailable as error:  # its code did not return, or the coordinator is stopping
            log.warning("results are stored unchecked: %s", error, extra={"campaign": campaign_id})
            self._keep(campaign_id, _Unchecked())
            return Judgement()
        except Exception:  # a plug-in's fault must not fail the results of others; the step reports it
            log.exception("result cannot be checked", extra={"campaign": campaign_id})
            self._keep(campaign_id, _Unchecked())
            return Judgement()
        if isinstance(evaluation, Scored):
            missing = [name for name in expected.objectives if name not in evaluation.objectives]
            if missing:
                return Judgement(f"{expected.algorithm} expects the objective {missing[0]}, which is missing")
        return Judgement()

    def _known(self, campaign_id: str) -> _Expected | _Unchecked | None:
        """Return the cached expectations of a campaign; None if there are none, or its code is to be tried again."""
        with self._lock:
            found = self._expected.get(campaign_id)
            if found is None or (isinstance(found, _Unchecked) and time.monotonic() >= found.until):
                return None
            self._expected.move_to_end(campaign_id)
            return found

    def _find(self, campaign: Campaign) -> _Expected | _Unchecked:
        """Return a campaign's expectations, or that its results cannot be checked here at present."""
        known = self._known(campaign.id)
        if known is not None:
            return known
        expected: _Expected | _Unchecked = _Unchecked()
        try:
            expected = _expected(make_plan(campaign.body)) or _Unchecked()
        except InvalidInput:  # its plug-in is not installed here
            pass
        except Unavailable as error:
            log.warning("results are stored unchecked: %s", error, extra={"campaign": campaign.id})
        except (
            Exception
        ):  # a plug-in that does not load must not fail the results of others; the step reports it
            log.exception("results cannot be checked", extra={"campaign": campaign.id})
        self._keep(campaign.id, expected)
        return expected

    def _keep(self, campaign_id: str, expected: _Expected | _Unchecked) -> None:
        with self._lock:
            self._expected[campaign_id] = expected
            self._expected.move_to_end(campaign_id)
            while len(self._expected) > CACHED:
                dropped, _ = self._expected.popitem(last=False)
                del self._late[dropped]


def _ignore(judging: asyncio.Future[Sequence[Judgement]]) -> None:
    """Consume a result that nobody waits for any more; otherwise its error would be logged as never retrieved."""
    if not judging.cancelled():
        judging.exception()


def _expected(plan: Plan) -> _Expected | None:
    if isinstance(plan.problem, InProcessProblem):
        return None
    needed = plan.algorithm.needed_objectives if isinstance(plan.algorithm, NeedsObjectives) else ()
    return _Expected(
        problem=plan.problem,
        algorithm=plan.body.algorithm.id,
        objectives=tuple(needed),
        user_code=not is_own_plugin(PROBLEMS, plan.body.problem.id),
    )


def _reason(problem: SimulatedProblem, result: Completed, error: Exception) -> str:
    missing = [name for name in problem.requirements if name not in result.verdicts]
    if missing:
        return f"expected a verdict of {', '.join(problem.requirements)}; {missing[0]} is missing"
    return f"{problem.id} cannot evaluate it: {type(error).__name__}: {error}"
