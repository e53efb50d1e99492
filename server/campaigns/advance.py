"""The generation step: tell, grow, ask, store, enqueue.

`Stepper.advance` may run at any time, any number of times, in any process: a step is written only if the campaign
stands where the step began, so a crash anywhere is mended by running it again, and no generation is told twice.
The live state is kept in memory between steps; after a restart it is restored from the checkpoint and the stored
solutions, and is the same, bit for bit.
"""

import logging
import threading
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from sqlalchemy import Connection, Row
from sqlalchemy.exc import DBAPIError
from sqlalchemy.exc import TimeoutError as PoolTimeout

from brink.search.algorithm import Candidate, Evaluation, Failed, Measured, Question, Scored, Seeded
from brink.search.analysis.boundary import distinct_boundary
from brink.search.archive import Archive
from brink.search.document import Document
from brink.search.metric import METRIC_VERSION
from brink.server.campaigns import step_store, store
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.campaigns.plan import (
    Live,
    Plan,
    asked,
    first_generation,
    make_plan,
    new_solutions,
    restored_archive,
    vector_bytes,
    wanted_seeds,
)
from brink.server.campaigns.repeats import PlannedRepeats, plan_repeats, store_repeats
from brink.server.campaigns.seeding import SeedSource
from brink.server.campaigns.values import (
    Block,
    Campaign,
    Checkpoint,
    GenerationSummary,
    Judged,
    NewSolution,
    Step,
)
from brink.server.db.engine import Engines
from brink.server.db.writer import Writer, passes
from brink.server.errors import Damaged, FieldError, InvalidInput, Unavailable
from brink.server.metrics import Metrics
from brink.server.problems.base import InProcessProblem, MeasuresOnData, Problem, SimulatedProblem
from brink.server.states import CampaignStatus, JobStatus, SolutionVerdict
from brink.worker.wire import Completed

FEW_FAILURES = 3
"""A campaign is not paused for this many failures or fewer."""

log = logging.getLogger(__name__)


class _MovedOn(Exception):
    """Another coordinator took the step meanwhile."""


class Stepper:
    """Advances campaigns, one at a time."""

    def __init__(
        self,
        engines: Engines,
        writer: Writer,
        *,
        max_stored_distances: int,
        seeds: SeedSource,
        metrics: Metrics | None = None,
    ) -> None:
        self._engines = engines
        self._metrics = metrics or Metrics()
        self._writer = writer
        self._seeds = seeds
        self._max_stored_distances = max_stored_distances
        self._live: dict[str, Live] = {}
        self._lock = threading.Lock()

    def adopt(self, campaign_id: str, live: Live) -> None:
        """Keep the state of a campaign that was just submitted."""
        self._live[campaign_id] = live

    def forget(self, campaign_id: str) -> None:
        """Drop the state of a campaign that has ended, or waits."""
        self._live.pop(campaign_id, None)

    @property
    def kept(self) -> tuple[str, ...]:
        """The campaigns whose states are in memory."""
        return tuple(self._live)

    def archive(self, campaign_id: str, generation: int) -> Archive | None:
        """Return a campaign's archive if it is in memory and at that generation."""
        live = self._live.get(campaign_id)
        if live is None or live.generation != generation:
            return None
        archive: Archive = live.state.archive
        return archive

    def advance(self, campaign_id: str) -> bool:
        """Take as many steps as can be taken now; return whether any was."""
        moved = False
        with self._lock:
            while self._step(campaign_id):
                moved = True
        return moved

    def _step(self, campaign_id: str) -> bool:
        with self._engines.reader.connect() as connection:
            campaign = store.find_campaign(connection, campaign_id)
            if campaign is None or campaign.status is not CampaignStatus.RUNNING:
                self._live.pop(campaign_id, None)
                return False
            jobs = step_store.generation_jobs(connection, campaign_id, campaign.generation)
        if _open(jobs):
            return False
        try:
            live = self._state(campaign)
            if jobs and wanted_seeds(live.plan, live.state) is not None:
                # Another coordinator had its seeds, and asked, since this state was made.
                live = self._restore(campaign)
            if wanted_seeds(live.plan, live.state) is not None:
                return self._seed(campaign, live)
            if not jobs:
                # Another coordinator may have had its seeds, and asked, between the look at the jobs and the state.
                with self._engines.reader.connect() as connection:
                    jobs = step_store.generation_jobs(connection, campaign_id, campaign.generation)
                if _open(jobs):
                    return False
            return self._tell(campaign, live, jobs)
        except _MovedOn:
            return False
        except InvalidInput as error:
            reason = (
                f"generation {campaign.generation} cannot be told here: {error}. Resume once that is mended."
            )
            self._end(campaign, CampaignStatus.PAUSED, reason)
            return False
        except Exception as error:
            if _passes(error):
                self._live.pop(campaign_id, None)
                raise
            log.exception("generation cannot be told", extra=_about(campaign))
            reason = f"generation {campaign.generation} cannot be told: {type(error).__name__}: {error}"
            if isinstance(error, Damaged):
                self._end(campaign, CampaignStatus.FAILED, reason)
            else:  # nothing is lost; whatever it was may be mended
                self._end(campaign, CampaignStatus.PAUSED, f"{reason}. Resume once that is mended.")
            raise

    def _seed(self, campaign: Campaign, live: Live) -> bool:
        """Take the seeds that the algorithm waits for, if they have come; return whether they had.

        The state with them is the new checkpoint: whatever happens then, nobody needs to be asked again.
        """
        plan, algorithm = live.plan, live.plan.algorithm
        request = wanted_seeds(plan, live.state)
        assert isinstance(algorithm, Seeded)
        assert request is not None
        proposals = self._seeds.proposals(campaign.id, campaign.body.llm, plan.problem, request)
        if proposals is None:
            return False
        seeded = algorithm.seeded(live.state, proposals)
        checkpoint = _checkpoint(plan, seeded, campaign.generation)
        state, candidates = asked(plan, seeded)
        solutions = new_solutions(plan.problem, candidates, state, campaign.body.seed)
        written = self._writer.submit(
            lambda connection: step_store.write_seeded(connection, campaign, checkpoint, solutions)
        ).result()
        if not written:
            self._live.pop(campaign.id, None)
            return False
        self._live[campaign.id] = Live(plan=plan, generation=campaign.generation, state=state)
        log.info("generation seeded", extra=_about(campaign))
        return True

    def _tell(self, campaign: Campaign, live: Live, jobs: Sequence[Row[*tuple[Any, ...]]]) -> bool:
        began = time.perf_counter()
        evaluations = _evaluations(live.plan.problem, live.state.pending, jobs)
        failed = campaign.failed + sum(isinstance(e, Failed) for e in evaluations.values())
        pause = _too_many_failures(campaign, evaluations, failed, len(live.state.pending))
        if pause:
            self._end(campaign, CampaignStatus.PAUSED, pause, failures=failed)
            return False
        algorithm = live.plan.algorithm
        told = algorithm.tell(live.state, evaluations)
        finished = algorithm.finished(told)
        asked_state, candidates = asked(live.plan, told)
        solutions = new_solutions(live.plan.problem, candidates, asked_state, campaign.body.seed)
        step = self._write_up(campaign, live.plan, evaluations, told, solutions, finished, began)
        again = self._repeats(campaign, live.plan, told.archive) if finished else None

        def unit(connection: Connection) -> bool:
            written = step_store.write_step(connection, step)
            if written and again is not None:
                store_repeats(connection, again)
            return written

        if not self._writer.submit(unit).result():
            self._live.pop(campaign.id, None)
            return False
        self._metrics.steps.observe(time.perf_counter() - began)
        if finished:
            self._live.pop(campaign.id, None)
        else:
            self._live[campaign.id] = Live(
                plan=live.plan, generation=campaign.generation + 1, state=asked_state
            )
        told_about = {"evaluated": step.summary.evaluated, "unsafe": step.summary.unsafe, "failed": failed}
        step_ms = round(1000 * step.summary.step_s, 1)
        log.info("generation told", extra={**_about(campaign), **told_about, "step_ms": step_ms})
        if finished:
            log.info("campaign finished", extra={**_about(campaign), **told_about})
        return True  # also when it was the last one: repeats may have begun

    def _write_up(
        self,
        campaign: Campaign,
        plan: Plan,
        evaluations: Mapping[int, Evaluation],
        told: Any,
        solutions: Sequence[NewSolution],
        finished: bool,
        began: float,
    ) -> Step:
        archive: Archive = told.archive
        failed = campaign.failed + sum(isinstance(e, Failed) for e in evaluations.values())
        measured = campaign.measured + sum(isinstance(e, Measured) for e in evaluations.values())
        boundary = distinct_boundary(archive, DEFAULT_T_B, DEFAULT_D_TH)
        strict = distinct_boundary(archive, DEFAULT_T_B, DEFAULT_D_TH, strict=True)
        fitness = told.fitness
        return Step(
            campaign=campaign.id,
            generation=campaign.generation,
            judged=[_judged(number, evaluation) for number, evaluation in sorted(evaluations.items())],
            summary=GenerationSummary(
                number=campaign.generation,
                evaluated=len(archive),
                unsafe=int(np.count_nonzero(archive.unsafe)),
                failed=failed,
                measured=measured,
                best_fitness=_finite(fitness.min()) if fitness.size else None,
                median_fitness=_finite(np.median(fitness)) if fitness.size else None,
                dbs=len(boundary),
                strict_dbs=len(strict),
                step_s=time.perf_counter() - began,
            ),
            block=self._block(archive),
            checkpoint=_checkpoint(plan, told, campaign.generation + 1),
            asked=solutions,
            traces=self._evidence(campaign, plan, archive, boundary) if finished else (),
            status=CampaignStatus.FINISHED if finished else CampaignStatus.RUNNING,
            reason="",
        )

    def _block(self, archive: Archive) -> Block | None:
        rows = archive.latest_rows
        if rows is None or len(archive) > self._max_stored_distances:
            return None
        return Block(
            first_row=len(archive) - rows.shape[0],
            rows=rows.shape[0],
            columns=rows.shape[1],
            metric_version=METRIC_VERSION,
            data=rows.astype("<f4").tobytes(),
        )

    def _evidence(self, campaign: Campaign, plan: Plan, archive: Archive, boundary: Any) -> list[int]:
        """Return the numbers of the solutions whose traces are kept: the best distinct boundary solutions."""
        if isinstance(plan.problem, InProcessProblem):
            return []
        return [int(number) for number in archive.numbers[boundary][: campaign.body.execution.keep_traces]]

    def _repeats(self, campaign: Campaign, plan: Plan, archive: Archive) -> PlannedRepeats | None:
        """Return the repeats that the campaign asks for after its search, if any."""
        if not campaign.body.repeats:
            return None
        try:
            return plan_repeats(
                campaign, plan, archive, repeats=campaign.body.repeats, t_b=DEFAULT_T_B, d_th=DEFAULT_D_TH
            )
        except InvalidInput as error:  # the search has ended all the same
            log.warning("its boundary cannot be repeated: %s", error, extra=_about(campaign))
            return None

    def _state(self, campaign: Campaign) -> Live:
        live = self._live.get(campaign.id)
        if live is not None and live.generation == campaign.generation:
            return live
        return self._restore(campaign)

    def _restore(self, campaign: Campaign) -> Live:
        """Return the state from the database, with its pending generation asked again."""
        plan = make_plan(campaign.body)
        with self._engines.reader.connect() as connection:
            now = store.find_campaign(connection, campaign.id)
            checkpoint = step_store.find_checkpoint(connection, campaign.id)
            stored = step_store.read_archive(connection, campaign.id, plan.problem.space.dimension)
            stored_vectors = step_store.read_vectors(connection, campaign.id, campaign.generation)
        if now is None or now.generation != campaign.generation:
            raise _MovedOn
        if checkpoint is None and campaign.generation == 0:
            live, _ = first_generation(campaign.body)
        elif checkpoint is None or checkpoint.generation != campaign.generation:
            raise Damaged(f"campaign {campaign.id}: no checkpoint of generation {campaign.generation}")
        else:
            state = plan.algorithm.load(
                plan.problem.space,
                plan.config,
                Document.from_bytes(checkpoint.document),
                restored_archive(plan, stored),
            )
            live = Live(plan=plan, generation=campaign.generation, state=asked(plan, state)[0])
        _check_same(campaign, live.state.pending, stored_vectors)
        log.info("campaign restored", extra=_about(campaign))
        return live

    def _end(
        self, campaign: Campaign, status: CampaignStatus, reason: str, *, failures: int | None = None
    ) -> None:
        self._live.pop(campaign.id, None)
        self._writer.submit(
            lambda connection: store.end_running(
                connection, campaign.id, campaign.generation, status, reason, failures=failures
            )
        ).result()
        log.warning("campaign %s", status, extra={**_about(campaign), "reason": reason})


def _about(campaign: Campaign) -> dict[str, object]:
    return {"campaign": campaign.id, "generation": campaign.generation}


def _open(jobs: Sequence[Row[*tuple[Any, ...]]]) -> bool:
    return any(job.status in (JobStatus.QUEUED, JobStatus.LEASED) for job in jobs)


def _checkpoint(plan: Plan, state: Any, generation: int) -> Checkpoint:
    """Return a state that has asked nothing yet, as it is stored."""
    archive: Archive = state.archive
    return Checkpoint(
        generation=generation,
        document=plan.algorithm.dump(state).to_bytes(),
        neighbours=archive.neighbours.astype("<i8").tobytes(),
        unsafe_neighbours=archive.unsafe_neighbours.astype("<i8").tobytes(),
    )


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _check_same(campaign: Campaign, candidates: Sequence[Candidate], asked: Mapping[int, bytes]) -> None:
    """Raise InvalidInput unless the candidates asked again are those that are being simulated."""
    if {candidate.number: vector_bytes(candidate) for candidate in candidates} != asked:
        message = (
            f"expected the candidates that were asked for, got others: {campaign.body.algorithm.id} or "
            f"{campaign.body.problem.id} has changed since, or the stored replies that its seeds were read from; "
            "go on with the version that the campaign began with"
        )
        raise InvalidInput([FieldError(pointer="/algorithm/id", message=message)])


def _evaluations(
    problem: Problem, pending: Sequence[Candidate], jobs: Sequence[Row[*tuple[Any, ...]]]
) -> dict[int, Evaluation]:
    if isinstance(problem, InProcessProblem):
        return {candidate.number: problem.evaluate(candidate.vectors) for candidate in pending}
    questions = {candidate.number: candidate.question for candidate in pending}
    evaluations: dict[int, Evaluation] = {}
    for job in jobs:
        if job.status == JobStatus.DONE:
            evaluations[job.number] = _evaluation(problem, questions[job.number], job.result)
        else:
            evaluations[job.number] = Failed(reason=job.last_error or str(job.status))
    return evaluations


def _evaluation(problem: SimulatedProblem, question: Question, result: str) -> Evaluation:
    """Return what a result says; one that the problem cannot read says nothing, and must not stop the others."""
    try:
        outcome = Completed.model_validate_json(result)
        if question is Question.DATASET:
            assert isinstance(problem, MeasuresOnData)  # checked when it was asked
            return problem.measurement(outcome)
        return problem.evaluation(outcome)
    except (LookupError, ValueError, TypeError, ArithmeticError) as error:
        return Failed(reason=f"error: the result cannot be judged: {type(error).__name__}: {error}")


def _passes(error: Exception) -> bool:
    """Whether a step failed for the database's sake: away, locked, busy, stopping. It is then taken again."""
    cause = error.__cause__ if isinstance(error, Unavailable) else error
    if isinstance(cause, DBAPIError):
        return passes(cause)
    return cause is None or isinstance(cause, PoolTimeout)


def _judged(number: int, evaluation: Evaluation) -> Judged:
    if isinstance(evaluation, Scored):
        return Judged(
            number=number,
            verdict=SolutionVerdict.UNSAFE if evaluation.unsafe else SolutionVerdict.SAFE,
            robustness=evaluation.robustness,
            objectives=evaluation.objectives,
            failure=None,
        )
    if isinstance(evaluation, Measured):
        return Judged(
            number=number,
            verdict=SolutionVerdict.MEASURED,
            robustness=None,
            objectives=evaluation.objectives,
            failure=None,
        )
    return Judged(
        number=number,
        verdict=SolutionVerdict.FAILED,
        robustness=None,
        objectives=None,
        failure=evaluation.reason,
    )


def _too_many_failures(
    campaign: Campaign, evaluations: Mapping[int, Evaluation], failed: int, pending: int
) -> str | None:
    """Return why a campaign must pause for its failures, or None."""
    asked = campaign.told + pending
    limit = campaign.body.execution.max_failed_share
    if failed <= max(FEW_FAILURES, campaign.failures_accepted) or failed <= limit * asked:
        return None
    last = next(e.reason for e in reversed(list(evaluations.values())) if isinstance(e, Failed))
    return (
        f"{failed} of {asked} candidates failed, more than max_failed_share {limit:g} allows. Retry their jobs, "
        f"or resume to go on without them. Last error: {last.strip().splitlines()[0] if last.strip() else last}"
    )
