"""The jobs that a worker holds, from their lease until the coordinator acknowledges their outcome.

The threads of a worker communicate only through `HeldJobs`, which one condition guards. A job is in exactly one
place: waiting, in the simulation process (running or next), or finished and not yet acknowledged.

No other worker can run a job that is held here, and near the end of a generation that makes the others wait. So
`PrefetchPolicy` limits the held work by time rather than by number of jobs.
"""

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Self, TypeAlias

from brink.worker.child_protocol import failure_text
from brink.worker.wire import Completed, HeldLease, JobFailed, JobResult, LeasedJob, LeaseReply, ResultStatus

log = logging.getLogger(__name__)

MAX_BATCH = 128
MAX_BATCH_BYTES = 16 * 1024 * 1024
"""Limits of one report, in results and in bytes; a single larger result is still sent."""

_NEWEST_WEIGHT = 0.2
"""Weight of the newest measurement in the moving averages, which cover roughly the last ten."""

_SHORTEST_S = 1e-6
"""Lower bound of an episode's time, to avoid a division by zero; the cap on jobs takes over long before."""

Key: TypeAlias = tuple[int, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class PrefetchPolicy:
    """How many jobs to hold, from the measured times of episodes and requests.

    Attributes:
        max_jobs: Maximum number of jobs to hold, >= 1.
        prefetch_s: Work to hold, in seconds of simulation.
        episode_s: Moving average of an episode's wall-clock time, or None before the first.
        round_trip_s: Moving average of a request's time.
    """

    max_jobs: int
    prefetch_s: float
    episode_s: float | None = None
    round_trip_s: float = 0.005

    def after_episode(self, wall_s: float) -> Self:
        """Return the policy updated with the duration of one more episode."""
        if self.episode_s is None:
            return replace(self, episode_s=wall_s)
        return replace(self, episode_s=self.episode_s + _NEWEST_WEIGHT * (wall_s - self.episode_s))

    def after_request(self, wall_s: float) -> Self:
        """Return the policy updated with the duration of one more request."""
        return replace(self, round_trip_s=self.round_trip_s + _NEWEST_WEIGHT * (wall_s - self.round_trip_s))

    @property
    def capacity(self) -> int:
        """Number of jobs to hold, the running one included, in [1, max_jobs].

        It is 1 before the first measurement, and for episodes much longer than `prefetch_s`: fetching the next job
        then costs little, while a second job would wait here although another worker could run it.
        """
        if self.episode_s is None:
            return 1
        return 1 + min(self.max_jobs - 1, round(self.prefetch_s / max(self.episode_s, _SHORTEST_S)))

    @property
    def low_watermark(self) -> int:
        """Number of jobs behind the running one at which to lease more: two round trips' worth, at most half."""
        if self.episode_s is None:
            return 0
        two_trips = math.ceil(2 * self.round_trip_s / max(self.episode_s, _SHORTEST_S))
        return min(self.capacity // 2, max(1, two_trips))


@dataclass(frozen=True, slots=True, kw_only=True)
class FinishedJob:
    """A job with its outcome, not yet acknowledged.

    Attributes:
        leased: The job and its lease.
        outcome: The result, or why there is none.
        size_bytes: Size of the outcome as JSON.
        finished_s: When it finished, on the monotonic clock.
        original: What this is reported instead of, because the coordinator did not take it; None if this is it.
    """

    leased: LeasedJob
    outcome: Completed | JobFailed
    size_bytes: int
    finished_s: float
    original: "FinishedJob | None" = None

    def to_wire(self) -> JobResult:
        """Return the wire message."""
        return JobResult(job=self.leased.job, token=self.leased.token, outcome=self.outcome)


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """A request to make: report these outcomes, release these leases, and lease up to `room` jobs without waiting."""

    outcomes: tuple[FinishedJob, ...]
    release: tuple[HeldLease, ...]
    room: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Poll:
    """A request to make while no job is held: wait for up to `room` jobs.

    Attributes:
        room: Maximum number of jobs to lease.
        idle_left_s: Time until the worker exits for being idle, or None if it does not.
    """

    room: int
    idle_left_s: float | None


class HeldJobs:
    """The jobs of one worker.

    Args:
        policy: Decides how many jobs to hold; updated with every measurement.
        report_after_s: Longest time that an outcome waits before it is reported.
        exit_when_idle_s: Time without a job after which the worker exits, or None.
        clock: Monotonic clock, in seconds.

    Attributes:
        changed: Guards all state, and is notified of every change.
    """

    def __init__(
        self,
        policy: PrefetchPolicy,
        *,
        report_after_s: float = 1.0,
        exit_when_idle_s: float | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        # Reentrant, as Condition is by default: a signal handler may call `stop` inside any of these methods.
        self.changed = threading.Condition()
        self._report_after_s = report_after_s
        self._exit_when_idle_s = exit_when_idle_s
        self._clock = clock
        self._policy = policy
        self._waiting: deque[LeasedJob] = deque()
        self._in_process: list[LeasedJob] = []
        self._running_since_s = 0.0
        self._finished: list[FinishedJob] = []
        self._lost: set[Key] = set()
        self._max_batch = MAX_BATCH
        # After a refused report: how many outcomes are still to be reported one at a time.
        self._report_singly = 0
        self._queue_was_empty = False
        self._idle_since_s: float | None = None
        self._asked_while_idle = False
        self._retry_at_s = 0.0
        self._polling = False
        self._draining = False
        self._stopping = False
        self._runner_done = False

    # Called by the runner.

    def take(self, *, wait: bool) -> LeasedJob | None:
        """Move the next job to the simulation process and return it; None if there is none or the worker stops.

        Args:
            wait: Whether to wait until there is a job or the worker stops.
        """
        with self.changed:
            while wait and not self._waiting and not self._stopping:
                self.changed.wait()
            if self._stopping or not self._waiting:
                return None
            job = self._waiting.popleft()
            if not self._in_process:
                self._running_since_s = self._clock()
            self._in_process.append(job)
            self.changed.notify_all()
            return job

    def finish(
        self, job: LeasedJob, outcome: Completed | JobFailed, *, wall_s: float, size_bytes: int
    ) -> bool:
        """Store the outcome of a job until the coordinator acknowledges it. Return whether the worker is stopping.

        A worker that is told to stop after this still finishes the next episode, which has already begun.

        Args:
            job: A job in the simulation process.
            outcome: The result, or why there is none.
            wall_s: Wall-clock time of the episode.
            size_bytes: Size of the outcome as JSON.
        """
        with self.changed:
            now_s = self._leave_process(job)
            if isinstance(outcome, Completed):
                self._policy = self._policy.after_episode(wall_s)
            if _key(job) in self._lost:
                self._lost.discard(_key(job))
                log.info("dropped the outcome of a job whose lease was lost", extra={"job": job.job})
            else:
                self._finished.append(
                    FinishedJob(leased=job, outcome=outcome, size_bytes=size_bytes, finished_s=now_s)
                )
            if not self._waiting and not self._in_process:
                self._queue_was_empty = False
            self._note_if_idle()
            self.changed.notify_all()
            return self._stopping

    def put_back(self, jobs: Iterable[LeasedJob]) -> None:
        """Return unfinished jobs from the simulation process to the front of the queue, in order."""
        with self.changed:
            unfinished = []
            for job in jobs:
                self._leave_process(job)
                if _key(job) in self._lost:
                    self._lost.discard(_key(job))
                else:
                    unfinished.append(job)
            self._waiting.extendleft(reversed(unfinished))
            self._note_if_idle()
            self.changed.notify_all()

    def mark_runner_done(self) -> None:
        """Record that no further outcome will arrive."""
        with self.changed:
            self._runner_done = True
            self.changed.notify_all()

    # Called by the reporter.

    def next_request(self) -> Report | Poll | None:
        """Wait until a request is due and return it; None when the reporter can exit."""
        with self.changed:
            self._polling = False
            if self._idle_since_s is None:
                self._idle_since_s = self._clock()
            while True:
                now_s = self._clock()
                if self._all_done(now_s):
                    return None
                if now_s >= self._retry_at_s and (request := self._due_request(now_s)) is not None:
                    self._polling = isinstance(request, Poll)
                    return request
                self.changed.wait(self._wakeup_s(now_s))

    def add(self, reply: LeaseReply) -> None:
        """Add newly leased jobs; a reply that asks for it starts to drain the worker."""
        with self.changed:
            self._polling = False
            self._queue_was_empty = not reply.jobs
            self._asked_while_idle = not reply.jobs
            self._waiting.extend(reply.jobs)
            if reply.drain and not self._draining:
                self._draining = True
                log.info("draining: no more jobs are leased", extra={"held": len(self.leases())})
            self.changed.notify_all()

    def acknowledge(self, report: Report, statuses: Sequence[ResultStatus], *, wall_s: float) -> None:
        """Forget the outcomes and leases of a report that the coordinator has responded to.

        Args:
            report: The report.
            statuses: One for each outcome of the report, in order.
            wall_s: Time that the request took.
        """
        with self.changed:
            self._policy = self._policy.after_request(wall_s)
            del self._finished[: len(report.outcomes)]
            self._report_singly = max(0, self._report_singly - len(report.outcomes))
            released = {(lease.job, lease.token) for lease in report.release}
            self._waiting = deque(job for job in self._waiting if _key(job) not in released)
            self._note_if_idle()
            for outcome, status in zip(report.outcomes, statuses, strict=True):
                if status.status == "invalid":
                    fields = {"job": outcome.leased.job, "attempt": outcome.leased.attempt}
                    log.warning("the result lacks what its campaign needs", extra=fields)
                if status.status == "stale":
                    fields = {"job": outcome.leased.job, "attempt": outcome.leased.attempt}
                    log.info("the lease was lost before the outcome arrived", extra=fields)
            self.changed.notify_all()

    def handle_refusal(self, report: Report, reason: str, *, too_large: bool = False) -> None:
        """Isolate the outcome that the coordinator refuses, and replace it with a failure.

        The outcomes of a refused report are sent again one at a time. An outcome that is refused on its own is
        replaced with an error. If that is refused too, the job is dropped and its lease will expire. If the report
        was too large, it and all later ones have half as many outcomes instead.
        """
        with self.changed:
            if too_large and len(report.outcomes) > 1:
                self._max_batch = len(report.outcomes) // 2
                return
            if len(report.outcomes) > 1 or report.room:
                self._report_singly = max(1, len(report.outcomes))
                return
            refused = self._finished.pop(0)
            fields = {"job": refused.leased.job, "reason": reason}
            if refused.original is not None:
                log.error("the coordinator refused even the failure of a job; dropped", extra=fields)
                self._report_singly = max(0, self._report_singly - 1)
                self._note_if_idle()
                return
            log.error("the coordinator refused an outcome; reporting an error instead", extra=fields)
            self._finished.insert(0, _in_place_of(refused, f"the coordinator refused the outcome: {reason}"))

    def handle_fault(self, report: Report, reason: str) -> None:
        """Isolate the outcome at which the coordinator fails, and report an error in its place.

        The outcomes of the report are sent again one at a time. If the coordinator fails even at the error, the
        outcome is not the cause, and is sent again until the coordinator works.
        """
        with self.changed:
            if len(report.outcomes) > 1 or report.room:
                self._report_singly = max(1, len(report.outcomes))
                return
            suspect = self._finished[0]
            if suspect.original is not None:
                self._finished[0] = suspect.original
                return
            fields = {"job": suspect.leased.job, "reason": reason}
            log.error("the coordinator fails at an outcome; reporting an error instead", extra=fields)
            self._finished[0] = _in_place_of(suspect, f"the coordinator failed at the outcome: {reason}")

    def postpone(self, delay_s: float) -> None:
        """Make no request for this long: the coordinator is unavailable."""
        with self.changed:
            self._polling = False
            self._asked_while_idle = True
            self._retry_at_s = self._clock() + delay_s
            self.changed.notify_all()

    @property
    def unsent(self) -> int:
        """Number of outcomes that the coordinator has not acknowledged."""
        with self.changed:
            return len(self._finished)

    # Called by the heartbeat.

    def leases(self) -> tuple[HeldLease, ...]:
        """Return all leases still needed, those of unacknowledged outcomes included."""
        with self.changed:
            jobs = [*self._in_process, *self._waiting, *(outcome.leased for outcome in self._finished)]
            return tuple(HeldLease(job=job.job, token=job.token) for job in jobs)

    def apply_renewal(self, asked: Iterable[HeldLease], held: Iterable[int]) -> None:
        """Drop jobs whose lease could not be renewed.

        Outcomes stay: the reply to their report says what became of their lease.

        Args:
            asked: Leases that the heartbeat named.
            held: Jobs among them that are still held.
        """
        held_jobs = set(held)
        gone = {(lease.job, lease.token) for lease in asked if lease.job not in held_jobs}
        if not gone:
            return
        with self.changed:
            for job in [job for job in self._waiting if _key(job) in gone]:
                self._waiting.remove(job)
                log.info("dropped a job whose lease was lost", extra={"job": job.job})
            for job in self._in_process:
                if _key(job) in gone:
                    self._lost.add(_key(job))
                    log.info("lost the lease of a job in the simulation process", extra={"job": job.job})
            self._queue_was_empty = False
            self._note_if_idle()
            self.changed.notify_all()

    def lost_running_job(self) -> tuple[LeasedJob, float] | None:
        """Return the running job and the seconds it has run, if its lease is lost."""
        with self.changed:
            if self._in_process and _key(self._in_process[0]) in self._lost:
                return self._in_process[0], self._clock() - self._running_since_s
            return None

    # Called by the worker.

    def stop(self) -> None:
        """Start no more jobs, and release those that are not running."""
        with self.changed:
            self._stopping = True
            self._retry_at_s = 0.0
            self.changed.notify_all()

    @property
    def stopping(self) -> bool:
        """Whether the worker was asked to stop."""
        return self._stopping

    @property
    def runner_done(self) -> bool:
        """Whether no further outcome will arrive."""
        return self._runner_done

    @property
    def polling(self) -> bool:
        """Whether the reporter waits for a job while none is held, so that exiting would lose nothing."""
        return self._polling

    def _due_request(self, now_s: float) -> Report | Poll | None:
        if self._stopping:
            if not self._finished and not self._waiting:
                return None
            release = tuple(HeldLease(job=job.job, token=job.token) for job in self._waiting)
            return Report(outcomes=self._batch(), release=release, room=0)
        room = max(0, self._policy.capacity - len(self._waiting) - len(self._in_process))
        if self._draining:
            room = 0
        if not self._waiting and not self._in_process and not self._finished:
            return Poll(room=room, idle_left_s=self._idle_left_s(now_s))
        batch = self._batch()
        if self._report_singly and batch:
            # Alone and without a lease request, so that a refusal can only concern this outcome.
            return Report(outcomes=batch, release=(), room=0)
        ahead = len(self._waiting) + len(self._in_process) - 1
        # If the queue was empty, one report of all remaining outcomes will do: nobody waits for part of them.
        running_low = ahead <= self._policy.low_watermark and not (self._queue_was_empty and ahead >= 0)
        if batch and (running_low or now_s >= batch[0].finished_s + self._report_after_s):
            return Report(outcomes=batch, release=(), room=room)
        if running_low and room:
            return Report(outcomes=batch, release=(), room=room)
        return None

    def _batch(self) -> tuple[FinishedJob, ...]:
        batch: list[FinishedJob] = []
        size_bytes = 0
        for outcome in self._finished[: 1 if self._report_singly else self._max_batch]:
            size_bytes += outcome.size_bytes
            if batch and size_bytes > MAX_BATCH_BYTES:
                break
            batch.append(outcome)
        return tuple(batch)

    def _all_done(self, now_s: float) -> bool:
        if self._waiting or self._in_process or self._finished:
            return False
        if self._stopping:
            return self._runner_done
        if self._draining:
            return True
        # However short the idle time is, ask for jobs at least once before leaving.
        idle_left_s = self._idle_left_s(now_s)
        return self._asked_while_idle and idle_left_s is not None and idle_left_s <= 0

    def _idle_left_s(self, now_s: float) -> float | None:
        if self._exit_when_idle_s is None or self._idle_since_s is None:
            return None
        return self._idle_since_s + self._exit_when_idle_s - now_s

    def _wakeup_s(self, now_s: float) -> float | None:
        """Return the time until a request may become due without any other change, or None."""
        times_s = [self._retry_at_s] if self._retry_at_s > now_s else []
        if self._finished and not times_s:
            times_s.append(self._finished[0].finished_s + self._report_after_s)
        if (idle_left_s := self._idle_left_s(now_s)) is not None and not self._in_process:
            times_s.append(now_s + idle_left_s)
        return max(0.0, min(times_s) - now_s) if times_s else None

    def _leave_process(self, job: LeasedJob) -> float:
        """Remove a job from the simulation process and return the time, at which the next one starts to run."""
        now_s = self._clock()
        if job in self._in_process:
            self._in_process.remove(job)
            self._running_since_s = now_s
        return now_s

    def _note_if_idle(self) -> None:
        if not self._waiting and not self._in_process and not self._finished:
            self._idle_since_s = self._clock()
            self._asked_while_idle = False


def _in_place_of(finished: FinishedJob, why: str) -> FinishedJob:
    """Return a failure to report instead of an outcome."""
    message = failure_text(why)
    failure = JobFailed(reason="error", message=message)
    return replace(finished, outcome=failure, size_bytes=len(message), original=finished)


def _key(job: LeasedJob) -> Key:
    return job.job, job.token
