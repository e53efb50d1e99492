"""Advances campaigns: the generation step (evaluate, tell, ask, store), and when it is taken.

A step may be taken at any time, any number of times, in any process: it is only written if the campaign is still in
the state in which the step began. So no generation is told twice, and after a crash the step is taken again. The
state of a search is kept in memory between steps; after a restart it is restored from the checkpoint and the stored
solutions, bit for bit.

No transaction stores more than a piece of what a search asks for. Workers may lease the jobs of a piece at once. The
next generation is told only after all pieces have been stored. After a crash in between, the search is restored and
asks again, and what is not stored yet is stored then. See docs/adr/0064-work-in-pieces.md.
"""

import asyncio
import hashlib
import logging
import time
from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final

import numpy as np
from sqlalchemy import Connection
from sqlalchemy.exc import DBAPIError
from sqlalchemy.exc import TimeoutError as PoolTimeout

from brink.search.algorithm import Candidate, Evaluation, Failed, Measured, Question, Scored, Seeded, State
from brink.search.analysis.boundary import IndexArray, distinct_boundary, has_evidence
from brink.search.archive import Archive
from brink.search.document import Document
from brink.search.errors import OtherVersion
from brink.search.metric import METRIC_VERSION
from brink.server.campaigns import step_store, store
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.campaigns.follow_ups.follow_up import PlannedFollowUp
from brink.server.campaigns.follow_ups.kinds.confirm import plan_boundary_repeats
from brink.server.campaigns.follow_ups.store import store_follow_up
from brink.server.campaigns.known import read_known
from brink.server.campaigns.live_searches import MIB, LiveSearches
from brink.server.campaigns.others import OtherCoordinators
from brink.server.campaigns.plan import (
    LiveSearch,
    Plan,
    ask_more,
    make_plan,
    next_piece,
    of_state,
    restored_archive,
    seed_request,
    start_search,
    vector_bytes,
)
from brink.server.campaigns.result_check import UNREADABLE, evaluate
from brink.server.campaigns.simulators import other_simulator
from brink.server.campaigns.step_store import (
    PIECE,
    Asked,
    Checkpoint,
    DistanceBlock,
    GenerationSummary,
    SolutionResult,
    Step,
)
from brink.server.campaigns.store import CAMPAIGNS, Campaign
from brink.server.db.engine import Engines, read
from brink.server.db.sql import storable
from brink.server.db.writer import Writer, is_transient
from brink.server.errors import Damaged, InvalidInput, Unavailable
from brink.server.metrics import Metrics
from brink.server.problems.base import InProcessProblem, Problem, SimulatedProblem
from brink.server.problems.catalogue import uses_user_code
from brink.server.problems.driving_systems import users_part
from brink.server.queue import job_store
from brink.server.queue.job_store import JobOutcome, first_line
from brink.server.queue.wakeups import Wakeups
from brink.server.seeding import SeedSource
from brink.server.states import CampaignStatus, JobKind, JobStatus, SolutionVerdict
from brink.server.user_code import USER_CODE, CodeStalled
from brink.worker.wire import Completed

FEW_FAILURES = 3
"""This many failures or fewer never pause a campaign."""
FIRST_FAILURES = 5
"""This many failures before any success pause a campaign at once, unless it allows most simulations to fail."""

DRIVEN_TWICE: Final = 4
"""Solutions that are simulated a second time with a user's driving system or program: is it deterministic?"""
PLUGIN_STEPS_AT_ONCE: Final = 16
"""Maximum number of campaigns with user code whose steps run at a time. They mostly wait for it."""
KNOWN_CAMPAIGNS: Final = 10_000

log = logging.getLogger(__name__)


class _MovedOn(Exception):
    """Another coordinator has taken the step."""


class Stepper:
    """Takes generation steps; those of different campaigns may be taken at the same time, on different threads.

    Args:
        engines: The database.
        writer: Its writer.
        max_stored_distances: Number of solutions above which distances are not stored.
        seeds: Where seeds come from.
        metrics: Where step times are recorded.
        others: Other coordinators that may share the database; None to take all steps.
        live_searches_mib: Memory for searches between their steps, in MiB.
    """

    def __init__(
        self,
        engines: Engines,
        writer: Writer,
        *,
        max_stored_distances: int,
        seeds: SeedSource,
        metrics: Metrics | None = None,
        others: OtherCoordinators | None = None,
        live_searches_mib: int = 1024,
    ) -> None:
        self._others = others
        self._engines = engines
        self._metrics = metrics or Metrics()
        self._writer = writer
        self._seeds = seeds
        self._max_stored_distances = max_stored_distances
        self._live = LiveSearches(most_bytes=live_searches_mib * MIB, on_drop=self._on_drop)
        self._same_simulator: set[str] = set()
        self._starting: set[str] = set()
        self._user_code: OrderedDict[str, bool] = OrderedDict()

    def adopt(self, campaign_id: str, live: LiveSearch) -> None:
        """Keep the search of a new campaign in memory."""
        self._live.keep(campaign_id, live)

    def _on_drop(self, campaign_id: str) -> None:
        """Take the next step of a campaign despite its search being dropped here: no other coordinator has it."""
        log.info("search dropped from memory", extra={"campaign": campaign_id})
        self.take_over(campaign_id)

    def uses_user_code(self, campaign_id: str) -> bool:
        """Return whether a campaign runs user code; reads the database unless that `is_known`."""
        if not self.is_known(campaign_id):
            with self._engines.reader.connect() as connection:
                campaign = CAMPAIGNS.find(connection, campaign_id)
            self._user_code[campaign_id] = campaign is not None and uses_user_code(
                campaign.body.problem.id, campaign.body.algorithm.id
            )
            while len(self._user_code) > KNOWN_CAMPAIGNS:
                self._user_code.popitem(last=False)
        return self._user_code.get(campaign_id, True)

    def is_known(self, campaign_id: str) -> bool:
        """Return whether `uses_user_code` knows a campaign."""
        return campaign_id in self._user_code

    def take_over(self, campaign_id: str) -> None:
        """Take the next step of a campaign here: no coordinator has its search in memory."""
        if self._others is not None:
            self._others.take_over(campaign_id)

    def forget(self, campaign_id: str) -> None:
        """Drop the search of a campaign that has ended or is paused."""
        self._live.drop(campaign_id)
        self._same_simulator.discard(campaign_id)
        if self._others is not None:
            self._others.forget(campaign_id)

    @property
    def live_campaigns(self) -> tuple[str, ...]:
        """Ids of the campaigns whose searches are in memory."""
        return self._live.campaigns

    @property
    def live_bytes(self) -> int:
        """Memory of these searches, as estimated."""
        return self._live.size

    def archive(self, campaign_id: str, generation: int) -> Archive | None:
        """Return a campaign's archive if it is in memory and at the given generation."""
        live = self._live.get(campaign_id)
        if live is None or live.generation != generation:
            return None
        archive: Archive = of_state(live.plan, "archive", lambda: live.state.archive)
        return archive

    def start_later(self, campaign_id: str) -> None:
        """Start the large search of a new campaign together with its first step."""
        self._starting.add(campaign_id)
        self.take_over(campaign_id)

    def is_storing(self, campaign_id: str) -> bool:
        """Return whether a campaign's search is yet to be started, or has asked for something not stored yet."""
        live = self._live.get(campaign_id)
        return campaign_id in self._starting if live is None else not live.is_stored

    def advance(self, campaign_id: str) -> bool:
        """Take all due steps of a campaign, or store the next piece of what its search asks for.

        Returns:
            Whether it did anything. If a piece is left then, which `is_storing` tells, call this again, after the
            steps of other campaigns.

        Raises:
            Exception: A step failed. If the cause is not transient, the campaign was paused or has failed.
        """
        if not self.uses_user_code(campaign_id):
            return self._advance(campaign_id)
        with USER_CODE.on_behalf(campaign_id):
            return self._advance(campaign_id)

    def _advance(self, campaign_id: str) -> bool:
        moved = False
        while self._step(campaign_id):
            moved = True
            if self.is_storing(campaign_id):
                break
        return moved

    def _step(self, campaign_id: str) -> bool:
        self._starting.discard(campaign_id)
        with self._engines.reader.connect() as connection:
            campaign = CAMPAIGNS.find(connection, campaign_id)
            if campaign is None or campaign.status is not CampaignStatus.RUNNING:
                self.forget(campaign_id)
                return False
            outcomes = job_store.generation_outcomes(connection, campaign_id, campaign.generation)
        try:
            return self._take_step(campaign, outcomes)
        except _MovedOn:
            return False
        except InvalidInput as error:
            reason = f"generation {campaign.generation} cannot be completed here: {error}"
            self._end(campaign, CampaignStatus.PAUSED, f"{reason}. Resume when this is fixed.")
            return False
        except CodeStalled as error:
            reason = f"generation {campaign.generation} cannot be completed: {error}"
            self._end(campaign, CampaignStatus.PAUSED, f"{reason}. Resume when this is fixed.")
            return False
        except Exception as error:
            if _is_transient(error):
                self._live.drop(campaign_id)
                raise
            log.exception("generation cannot be completed", extra=_about(campaign))
            reason = f"generation {campaign.generation} cannot be completed: {type(error).__name__}: {error}"
            if isinstance(error, Damaged):
                self._end(campaign, CampaignStatus.FAILED, reason)
            else:  # nothing is lost, and the cause may be fixed
                self._end(campaign, CampaignStatus.PAUSED, f"{reason}. Resume when this is fixed.")
            raise

    def _take_step(self, campaign: Campaign, outcomes: Sequence[JobOutcome]) -> bool:
        """Take a campaign's step if it is due; return whether it was taken.

        Args:
            campaign: The campaign, which is running.
            outcomes: The outcomes of its current generation.

        Raises:
            CodeStalled: An earlier call of its code has not returned, or a call of this step did not in time.
        """
        if stalled := USER_CODE.stalled(campaign.id):
            raise CodeStalled(f"{stalled[-1].what} has not returned from an earlier call")
        if self._has_other_simulator(campaign):
            return False
        live = self._live.get(campaign.id)
        if live is not None and live.generation == campaign.generation and not live.is_stored:
            return self._store_piece(campaign, live)
        if _is_open(outcomes):
            self._pause_if_nothing_works(campaign, outcomes)
            return False
        if self._others is not None and not self._is_current(campaign) and self._others.leave_step(campaign):
            self._live.drop(campaign.id)
            return False
        live = self._state(campaign)
        if outcomes and seed_request(live.plan, live.state) is not None:
            # Since this state was made, another coordinator has received the seeds and called `ask`.
            live = self._restore(campaign)
        if not live.is_stored:
            return self._store_piece(campaign, live)
        if seed_request(live.plan, live.state) is not None:
            return self._seed(campaign, live)
        if not outcomes:
            # Another coordinator may have called `ask` after the outcomes were read, before the state was made.
            with self._engines.reader.connect() as connection:
                outcomes = job_store.generation_outcomes(connection, campaign.id, campaign.generation)
            if _is_open(outcomes):
                return False
        return self._tell(campaign, live, outcomes)

    def _store_piece(self, campaign: Campaign, live: LiveSearch) -> bool:
        """Store the next piece of what a search asks for; return False if the campaign has moved on."""
        after, asked = next_piece(live)
        if asked.generations:
            unit = partial(step_store.write_piece, campaign=campaign, asked=asked)
            following = self._writer.submit(unit).result()
            if following is None:
                self._live.drop(campaign.id)
                return False
            if following != asked.generations[-1][-1].number + 1:  # another coordinator stores them, too
                after = self._restore(campaign)
        self._live.keep(campaign.id, after.measured())
        if after.is_stored:
            log.info("solutions stored", extra={**_about(campaign), "generations": after.asked})
        return True

    def _pause_if_nothing_works(self, campaign: Campaign, outcomes: Sequence[JobOutcome]) -> None:
        """Pause a campaign whose first simulations all failed, instead of waiting for the rest of its generation."""
        errors = [outcome.error or "" for outcome in outcomes if outcome.status is JobStatus.QUARANTINED]
        if (
            len(errors) < FIRST_FAILURES
            or campaign.completed
            or campaign.failures_accepted
            or campaign.body.execution.max_failed_share > 0.5
            or any(outcome.status is JobStatus.DONE for outcome in outcomes)
        ):
            return
        reason = f"all of the first {len(errors)} simulations failed. {_advice(errors[0])}"
        self._end(campaign, CampaignStatus.PAUSED, reason, failures=len(errors))

    def _has_other_simulator(self, campaign: Campaign) -> bool:
        """Return whether a campaign was simulated with another simulator than its problem uses here, and pause it."""
        if campaign.id in self._same_simulator or self._live.get(campaign.id) is not None:
            return False
        with self._engines.reader.connect() as connection:
            why = other_simulator(connection, campaign)
        if why is not None:
            self._end(campaign, CampaignStatus.PAUSED, why)
            return True
        self._same_simulator.add(campaign.id)
        return False

    def _seed(self, campaign: Campaign, live: LiveSearch) -> bool:
        """Pass on the seeds that the algorithm waits for; return whether they have arrived.

        The state with the seeds is stored as the new checkpoint, so that they are never requested again.
        """
        plan, algorithm = live.plan, live.plan.algorithm
        request = seed_request(plan, live.state)
        assert isinstance(algorithm, Seeded)
        assert request is not None
        proposals = self._seeds.proposals(campaign.id, campaign.body.llm, plan.problem, request)
        if proposals is None:
            return False
        seeded = algorithm.seeded(live.state, proposals)
        checkpoint = of_state(
            plan,
            "state",
            lambda: _checkpoint(plan, seeded, campaign.generation, counted=plan.is_for("boundary")),
        )
        after, asked = next_piece(replace(live, state=seeded))
        written = self._writer.submit(
            lambda connection: step_store.write_seeded(connection, campaign, checkpoint, asked)
        ).result()
        if not written:
            self._live.drop(campaign.id)
            return False
        self._live.keep(campaign.id, after.measured())
        log.info("generation seeded", extra=_about(campaign))
        return True

    def _tell(self, campaign: Campaign, live: LiveSearch, outcomes: Sequence[JobOutcome]) -> bool:
        began = time.perf_counter()
        pending: Sequence[Candidate] = of_state(live.plan, "pending", lambda: live.state.pending)
        evaluations = _evaluations(live.plan.problem, pending, outcomes)
        failed = campaign.failed + sum(isinstance(e, Failed) for e in evaluations.values())
        pause = _too_many_failures(campaign, evaluations, failed, len(pending))
        if pause:
            self._end(campaign, CampaignStatus.PAUSED, pause, failures=failed)
            return False
        algorithm = live.plan.algorithm
        told = algorithm.tell(live.state, evaluations)
        finished = algorithm.finished(told)
        after, asked = next_piece(replace(live, generation=campaign.generation + 1, state=told))
        without_result = [one.number for one in outcomes if one.status is not JobStatus.DONE]
        make_step = partial(
            self._make_step, campaign, live.plan, evaluations, without_result, told, asked, finished, began
        )
        step, archive = of_state(live.plan, "state", lambda: (make_step(), told.archive))
        repeats = self._repeats(campaign, live.plan, archive) if finished else None

        if not self._write_early(step):
            self._live.drop(campaign.id)
            return False

        def unit(connection: Connection) -> bool:
            written = step_store.write_step(connection, step)
            if written and repeats is not None:
                store_follow_up(connection, repeats)
            return written

        if not self._writer.submit(unit).result():
            self._live.drop(campaign.id)
            return False
        self._metrics.steps.observe(time.perf_counter() - began)
        if finished:
            self._live.drop(campaign.id)
        else:
            self._live.keep(campaign.id, after.measured())
        counts = {"evaluated": step.summary.evaluated, "unsafe": step.summary.unsafe, "failed": failed}
        step_ms = round(1000 * step.summary.step_s, 1)
        log.info("generation told", extra={**_about(campaign), **counts, "step_ms": step_ms})
        if finished:
            log.info("campaign %s", step.status, extra={**_about(campaign), **counts})
        return True  # also for the last step, which may have started repeats

    def _write_early(self, step: Step) -> bool:
        """Write most results of a large generation before its step; return whether the campaign is still in it."""
        for results in step.early_results(PIECE):
            unit = partial(
                step_store.write_results,
                campaign_id=step.campaign,
                generation=step.generation,
                results=results,
            )
            if not self._writer.submit(unit).result():
                return False
        return True

    def _make_step(
        self,
        campaign: Campaign,
        plan: Plan,
        evaluations: Mapping[int, Evaluation],
        without_result: Sequence[int],
        told: State,
        asked: Asked,
        finished: bool,
        began: float,
    ) -> Step:
        archive: Archive = told.archive
        # Neighbours are counted with each generation only for a search that they guide.
        counted = plan.is_for("boundary") or finished
        boundary = distinct_boundary(archive, DEFAULT_T_B, DEFAULT_D_TH) if counted else None
        fitness = told.fitness
        summary = GenerationSummary(
            number=campaign.generation,
            evaluated=len(archive),
            unsafe=int(np.count_nonzero(archive.unsafe)),
            failed=campaign.failed + sum(isinstance(e, Failed) for e in evaluations.values()),
            measured=campaign.measured + sum(isinstance(e, Measured) for e in evaluations.values()),
            best_fitness=_finite(fitness.min()) if fitness.size else None,
            median_fitness=_finite(np.median(fitness)) if fitness.size else None,
            dbs=None if boundary is None else len(boundary),
            strict_dbs=None if boundary is None else int(np.count_nonzero(has_evidence(archive)[boundary])),
            step_s=time.perf_counter() - began,
        )
        status, reason = _status_after(summary, evaluations, finished=finished)
        return Step(
            campaign=campaign.id,
            generation=campaign.generation,
            results=[
                _solution_result(number, evaluation) for number, evaluation in sorted(evaluations.items())
            ],
            without_result=without_result,
            summary=summary,
            block=self._distance_block(archive) if plan.is_for("boundary") else None,
            checkpoint=_checkpoint(plan, told, campaign.generation + 1, counted=counted),
            asked=asked,
            traces=[
                *_driven_twice(campaign, evaluations),
                *([] if boundary is None or not finished else _evidence(campaign, plan, archive, boundary)),
            ],
            status=status,
            reason=reason,
        )

    def _distance_block(self, archive: Archive) -> DistanceBlock | None:
        rows = archive.counts.latest_rows
        if rows is None or len(archive) > self._max_stored_distances:
            return None
        data = rows.astype("<f4").tobytes()
        return DistanceBlock(
            first_row=len(archive) - rows.shape[0],
            rows=rows.shape[0],
            columns=rows.shape[1],
            metric_version=METRIC_VERSION,
            data=data,
            sha256=hashlib.sha256(data).hexdigest(),
        )

    def _repeats(self, campaign: Campaign, plan: Plan, archive: Archive) -> PlannedFollowUp | None:
        """Return the repeats that the campaign's body asks for after the search, if any."""
        repeats = campaign.body.repeats
        if not repeats:
            return None
        try:
            return plan_boundary_repeats(
                campaign, plan, archive, repeats=repeats, t_b=DEFAULT_T_B, d_th=DEFAULT_D_TH
            )
        except InvalidInput as error:  # the search has ended nevertheless
            log.warning("its boundary cannot be repeated: %s", error, extra=_about(campaign))
            return None

    def _is_current(self, campaign: Campaign) -> bool:
        """Return whether a campaign's search is in memory, and nobody else has taken a step since."""
        live = self._live.get(campaign.id)
        return live is not None and live.generation == campaign.generation

    def _state(self, campaign: Campaign) -> LiveSearch:
        live = self._live.get(campaign.id)
        return (
            live if live is not None and live.generation == campaign.generation else self._restore(campaign)
        )

    def _restore(self, campaign: Campaign) -> LiveSearch:
        """Restore a search from the database, and ask again for the generations that its checkpoint lacks."""
        plan = make_plan(campaign.body)
        with self._engines.reader.connect() as connection:
            now = CAMPAIGNS.find(connection, campaign.id)
            checkpoint = step_store.find_checkpoint(connection, campaign.id)
            stored = step_store.read_archive(connection, campaign.id, plan.problem.space.dimension)
            in_flight = step_store.read_vectors(connection, campaign.id, campaign.generation)
            known = read_known(connection, campaign.id) if checkpoint is None else ()
        if now is None or now.generation != campaign.generation:
            raise _MovedOn
        if checkpoint is None and campaign.generation == 0:
            begun = start_search(campaign.body, known)
        elif checkpoint is None or checkpoint.generation != campaign.generation:
            raise Damaged(f"campaign {campaign.id}: no checkpoint of generation {campaign.generation}")
        else:
            archive, document = restored_archive(plan, stored), Document.from_bytes(checkpoint.document)
            try:
                state = plan.algorithm.load(plan.problem.space, plan.config, document, archive)
            except OtherVersion:
                message = (
                    f"{campaign.body.algorithm.id} has changed since this campaign began, and would ask for other "
                    "candidates; continue with the version of Brink that began it, or submit it again"
                )
                raise InvalidInput.at("/algorithm/id", message) from None
            begun = LiveSearch(
                plan=plan, generation=campaign.generation, asked=campaign.generation, state=state
            )
        # What is not stored yet is asked for piece by piece.
        asking = ask_more(begun, sum(map(len, in_flight)))
        live = of_state(plan, "pending", lambda: _without_stored(campaign, asking, in_flight))
        log.info("campaign restored", extra=_about(campaign))
        return live

    def _end(
        self, campaign: Campaign, status: CampaignStatus, reason: str, *, failures: int | None = None
    ) -> None:
        self._live.drop(campaign.id)
        self._writer.submit(
            lambda connection: store.end_running(
                connection, campaign.id, campaign.generation, status, reason, failures=failures
            )
        ).result()
        log.warning("campaign %s", status, extra={**_about(campaign), "reason": reason})


def _about(campaign: Campaign) -> dict[str, object]:
    return {"campaign": campaign.id, "generation": campaign.generation}


def _is_open(outcomes: Iterable[JobOutcome]) -> bool:
    return any(outcome.status in (JobStatus.QUEUED, JobStatus.LEASED) for outcome in outcomes)


def _checkpoint(plan: Plan, state: State, generation: int, *, counted: bool) -> Checkpoint:
    """Return the checkpoint of a state on which `ask` has not been called since the last `tell`.

    Args:
        plan: The campaign's plan.
        state: The state.
        generation: Number of generations told.
        counted: Whether to store the neighbour counts of its archive.
    """
    archive: Archive = state.archive
    return Checkpoint(
        generation=generation,
        document=plan.algorithm.dump(state).to_bytes(),
        neighbours=archive.neighbours.astype("<i8").tobytes() if counted else b"",
        unsafe_neighbours=archive.unsafe_neighbours.astype("<i8").tobytes() if counted else b"",
    )


def _evidence(campaign: Campaign, plan: Plan, archive: Archive, boundary: IndexArray) -> list[int]:
    """Return the numbers of the best distinct boundary solutions, whose traces are recorded."""
    if isinstance(plan.problem, InProcessProblem):
        return []
    return [int(number) for number in archive.numbers[boundary][: campaign.body.execution.keep_traces]]


def _driven_twice(campaign: Campaign, evaluations: Mapping[int, Evaluation]) -> list[int]:
    """Return the solutions whose traces show whether what a user brought gives the same result again."""
    if campaign.generation or not users_part(campaign.body.problem.params):
        return []
    return sorted(number for number, one in evaluations.items() if isinstance(one, Scored))[:DRIVEN_TWICE]


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _without_stored(
    campaign: Campaign, live: LiveSearch, in_flight: Sequence[Mapping[int, bytes]]
) -> LiveSearch:
    """Return a restored search without those of its requests that are already stored.

    Args:
        campaign: The campaign.
        live: Its search, which has asked again for more than what is stored and its checkpoint lacks, unless there is
            nothing more to ask for.
        in_flight: The stored vectors of each generation in flight, by number.

    Raises:
        InvalidInput: It asked for different candidates than those that are stored.
    """
    again = live.unstored
    first = again[0][1].number if again else None
    before = sum(first is None or max(generation) < first for generation in in_flight)
    stored = {number: vector for generation in in_flight[before:] for number, vector in generation.items()}
    same = {candidate.number: vector_bytes(candidate) for _, candidate in again[: len(stored)]} == stored
    if before:
        oldest = {candidate.number: vector_bytes(candidate) for candidate in live.state.pending}
        same = same and oldest == in_flight[0]
    if not same:
        message = (
            f"the algorithm asked for different candidates than before: {campaign.body.algorithm.id} or "
            f"{campaign.body.problem.id} has changed since then, or the stored replies with its seeds have; continue "
            "with the version that started the campaign"
        )
        raise InvalidInput.at("/algorithm/id", message)
    left = tuple((number + before, candidate) for number, candidate in again[len(stored) :])
    return replace(live, asked=live.asked + before, unstored=left, is_stored=not left)


def _evaluations(
    problem: Problem, pending: Sequence[Candidate], outcomes: Sequence[JobOutcome]
) -> dict[int, Evaluation]:
    if isinstance(problem, InProcessProblem):
        return {candidate.number: problem.evaluate(candidate.vectors) for candidate in pending}
    questions = {candidate.number: candidate.question for candidate in pending}
    evaluations: dict[int, Evaluation] = {}
    for outcome in outcomes:
        if outcome.status is JobStatus.DONE:
            evaluations[outcome.number] = _evaluation(
                problem, questions[outcome.number], outcome.result or ""
            )
        else:
            evaluations[outcome.number] = Failed(reason=outcome.error or str(outcome.status))
    return evaluations


def _evaluation(problem: SimulatedProblem, question: Question, result: str) -> Evaluation:
    """Return the evaluation of a result; a result that the problem cannot read fails only its own candidate."""
    try:
        kind = JobKind.DATASET if question is Question.DATASET else JobKind.EPISODE
        return evaluate(problem, kind, Completed.model_validate_json(result))
    except UNREADABLE as error:
        reason = f"error: the result cannot be evaluated: {type(error).__name__}: {error}"
        return Failed(reason=storable(reason))


def _is_transient(error: Exception) -> bool:
    """Return whether a step failed because the database is unavailable, locked or busy: a retry may succeed."""
    cause = error.__cause__ if isinstance(error, Unavailable) else error
    if isinstance(cause, DBAPIError):
        return is_transient(cause)
    return cause is None or isinstance(cause, PoolTimeout)


def _solution_result(number: int, evaluation: Evaluation) -> SolutionResult:
    if isinstance(evaluation, Scored):
        return SolutionResult(
            number=number,
            verdict=SolutionVerdict.UNSAFE if evaluation.unsafe else SolutionVerdict.SAFE,
            robustness=evaluation.robustness,
            objectives=evaluation.objectives,
        )
    if isinstance(evaluation, Measured):
        return SolutionResult(
            number=number, verdict=SolutionVerdict.MEASURED, objectives=evaluation.objectives
        )
    return SolutionResult(number=number, verdict=SolutionVerdict.FAILED, failure=evaluation.reason)


def _status_after(
    summary: GenerationSummary, evaluations: Mapping[int, Evaluation], *, finished: bool
) -> tuple[CampaignStatus, str]:
    """Return the status of a campaign after a step, and the reason if it has failed: no simulation had a result.

    Args:
        summary: The campaign's counts after the step.
        evaluations: The results of the step.
        finished: Whether the search has ended.
    """
    if not finished:
        return CampaignStatus.RUNNING, ""
    if summary.evaluated or summary.measured or not summary.failed:
        return CampaignStatus.FINISHED, ""
    reason = next((e.reason for e in evaluations.values() if isinstance(e, Failed)), "")
    example = f". One of the errors: {first_line(reason)}" if reason else ""
    return CampaignStatus.FAILED, f"all {summary.failed:,} simulations failed{example}"


def _too_many_failures(
    campaign: Campaign, evaluations: Mapping[int, Evaluation], failed: int, pending: int
) -> str | None:
    """Return why a campaign must pause because of its failures, or None."""
    candidates = campaign.completed + pending
    limit = campaign.body.execution.max_failed_share
    if failed <= max(FEW_FAILURES, campaign.failures_accepted) or failed <= limit * candidates:
        return None
    first = next(e.reason for e in evaluations.values() if isinstance(e, Failed))
    allowed = f"more than max_failed_share {limit:g} allows"
    return f"{failed} of {candidates} candidates failed, {allowed}. {_advice(first)}"


def _advice(error: str) -> str:
    """Return what to do about failures, and the first of the errors."""
    return f"Retry their jobs, or resume to go on without them. First error: {first_line(error)}"


@dataclass(slots=True)
class Scheduler:
    """Decides when the campaigns of one coordinator process advance.

    Steps run off the event loop: one at a time, since they compute, but for those of campaigns that run code which a
    user brought. These run beside all others, so that nobody waits for that code but its own campaign. What large
    searches ask for is stored beside them as well, one piece at a time. A campaign is queued at most once.

    Attributes:
        engines: The database.
        stepper: Takes the steps.
        wakeups: The requests that wait for jobs, woken when a step has enqueued some.
    """

    engines: Engines
    stepper: Stepper
    wakeups: Wakeups
    _swept: bool = False
    _closing: bool = False
    _due: set[str] = field(default_factory=set)
    _tasks: set[asyncio.Task[None]] = field(default_factory=set)
    _last: dict[str, asyncio.Task[None]] = field(default_factory=dict)
    _began_s: dict[str, float] = field(default_factory=dict)
    _steps: ThreadPoolExecutor = field(
        default_factory=lambda: ThreadPoolExecutor(max_workers=1, thread_name_prefix="brink-step")
    )
    _pieces: ThreadPoolExecutor = field(
        default_factory=lambda: ThreadPoolExecutor(max_workers=1, thread_name_prefix="brink-piece")
    )
    _plugin_steps: ThreadPoolExecutor = field(
        default_factory=lambda: ThreadPoolExecutor(
            PLUGIN_STEPS_AT_ONCE, thread_name_prefix="brink-plugin-step"
        )
    )

    def advance_soon(self, campaigns: Iterable[str]) -> None:
        """Queue campaigns to be advanced, unless they are queued already."""
        for campaign in campaigns:
            if campaign in self._due:
                continue
            self._due.add(campaign)
            task = asyncio.get_running_loop().create_task(self._advance(campaign, self._last.get(campaign)))
            self._last[campaign] = task
            self._tasks.add(task)
            task.add_done_callback(partial(self._done, campaign))

    def advance_own(self, campaign: str) -> None:
        """Queue a campaign that another coordinator found due, if its search is in memory here."""
        if campaign in self.stepper.live_campaigns:
            self.advance_soon([campaign])

    @property
    def oldest_step_s(self) -> float:
        """How long the step has been running that began first, in seconds; 0 if none runs."""
        return max((time.monotonic() - began_s for began_s in list(self._began_s.values())), default=0.0)

    def _done(self, campaign: str, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if self._last.get(campaign) is task:
            del self._last[campaign]

    async def _advance(self, campaign: str, before: asyncio.Task[None] | None) -> None:
        """Advance a campaign.

        Args:
            campaign: The campaign.
            before: The task that advances it now, if any.
        """
        loop = asyncio.get_running_loop()

        def step() -> bool:
            # A campaign that becomes due from here on must be looked at again.
            loop.call_soon_threadsafe(self._due.discard, campaign)
            self._began_s[campaign] = time.monotonic()
            try:
                return self.stepper.advance(campaign)
            finally:
                self._began_s.pop(campaign, None)

        try:
            if before is not None:
                await asyncio.wait([before])
            if not self.stepper.is_known(campaign):
                await loop.run_in_executor(None, self.stepper.uses_user_code, campaign)
            threads = self._pieces if self.stepper.is_storing(campaign) else self._steps
            beside = self.stepper.uses_user_code(campaign)
            if self._closing:  # the next coordinator goes on, also between two pieces
                return
            moved = await loop.run_in_executor(self._plugin_steps if beside else threads, step)
        except Unavailable as error:
            self._due.discard(campaign)
            log.warning("the step was not taken: %s", error, extra={"campaign": campaign})
            return
        except Exception:
            self._due.discard(campaign)
            log.exception("the step failed; the sweeper will try again", extra={"campaign": campaign})
            return
        if moved:
            self.wakeups.wake()
        if self.stepper.is_storing(campaign):
            self.advance_soon([campaign])

    async def sweep(self) -> None:
        """Advance campaigns whose step is due, and drop searches that ended or were paused elsewhere.

        The first sweep looks at all running campaigns.
        """
        live = self.stepper.live_campaigns
        first, self._swept = not self._swept, True

        def look(connection: Connection) -> tuple[Sequence[str], frozenset[str]]:
            # Another version of Brink may have started any of them; see `other_simulator`.
            due = store.running(connection) if first else job_store.idle_campaigns(connection)
            return due, store.running_among(connection, live)

        idle, running = await read(self.engines, look)
        for campaign in set(live) - running:
            self.stepper.forget(campaign)
        self.advance_soon(idle)

    def close(self) -> None:
        """Finish the running steps, and start no more."""
        self._closing = True
        for threads in (self._steps, self._pieces, self._plugin_steps):
            threads.shutdown(wait=True, cancel_futures=True)
