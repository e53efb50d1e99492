"""The jobs that a worker holds, from their lease to the acknowledgement of their outcome.

One condition guards everything here; the threads of a worker speak with each other through nothing else. A job is
in exactly one place: waiting, in the child (running or next), or finished and not yet acknowledged. An outcome
leaves only when the coordinator has answered for it.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from brink.worker.pace import Pace
from brink.worker.wire import Completed, HeldLease, JobFailed, JobResult, LeasedJob, LeaseReply, ResultStatus

log = logging.getLogger(__name__)

MAX_BATCH = 128
MAX_BATCH_BYTES = 16 * 1024 * 1024
"""Most results, and most bytes of them, in one report; a single larger one still goes."""

Key: TypeAlias = tuple[int, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What came out of a job, not yet acknowledged.

    Attributes:
        leased: The job and its lease.
        outcome: Its result, or why there is none.
        size_bytes: Size of the outcome as JSON.
        finished_s: When it finished, on the monotonic clock.
        replaced: Whether the coordinator refused the outcome that came first.
    """

    leased: LeasedJob
    outcome: Completed | JobFailed
    size_bytes: int
    finished_s: float
    replaced: bool = False

    def to_wire(self) -> JobResult:
        """Return the message."""
        return JobResult(job=self.leased.job, token=self.leased.token, outcome=self.outcome)


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """Report these outcomes, give these leases back, and ask for `room` more jobs without waiting."""

    outcomes: tuple[Outcome, ...]
    release: tuple[HeldLease, ...]
    room: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Poll:
    """Nothing is held: wait for up to `room` jobs, at most so long (None: as long as the settings say)."""

    room: int
    idle_left_s: float | None


Errand: TypeAlias = Report | Poll


class Holdings:
    """The jobs of one worker.

    Args:
        pace: What is known of the worker's speed at the start.
        report_after_s: A finished job is reported at the latest after this time.
        exit_when_idle_s: Leave after this time without a job, or None to stay.
        clock: Monotonic seconds.
    """

    def __init__(
        self,
        pace: Pace,
        *,
        report_after_s: float = 1.0,
        exit_when_idle_s: float | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        # Reentrant (Condition's default), since a signal handler may call `stop` inside any of these methods.
        self.changed = threading.Condition()
        self._report_after_s = report_after_s
        self._exit_when_idle_s = exit_when_idle_s
        self._clock = clock
        self._pace = pace
        self._waiting: deque[LeasedJob] = deque()
        self._in_child: list[LeasedJob] = []
        self._running_since_s = 0.0
        self._finished: list[Outcome] = []
        self._lost: set[Key] = set()
        self._one_by_one = 0
        self._nothing_new = False
        self._idle_since_s: float | None = None
        self._asked_in_vain = False
        self._retry_at_s = 0.0
        self._polling = False
        self._stopping = False
        self._runner_ended = False

    # What the runner does.

    def take(self, *, wait: bool) -> LeasedJob | None:
        """Return the next job for the child; None if there is none (now, or ever again).

        Args:
            wait: Whether to wait until there is one or the worker stops.
        """
        with self.changed:
            while wait and not self._waiting and not self._stopping:
                self.changed.wait()
            if self._stopping or not self._waiting:
                return None
            job = self._waiting.popleft()
            if not self._in_child:
                self._running_since_s = self._clock()
            self._in_child.append(job)
            self.changed.notify_all()
            return job

    def finish(
        self, job: LeasedJob, outcome: Completed | JobFailed, *, wall_s: float, size_bytes: int
    ) -> None:
        """Keep what came out of a job in the child until the coordinator has answered for it."""
        with self.changed:
            now_s = self._leave_child(job)
            if isinstance(outcome, Completed):
                self._pace = self._pace.after_episode(wall_s)
            if _key(job) in self._lost:
                self._lost.discard(_key(job))
                log.info("dropped the outcome of a job whose lease was lost", extra={"job": job.job})
            else:
                self._finished.append(
                    Outcome(leased=job, outcome=outcome, size_bytes=size_bytes, finished_s=now_s)
                )
            if not self._waiting and not self._in_child:
                self._nothing_new = False
            self._note_idle()
            self.changed.notify_all()

    def put_back(self, jobs: Iterable[LeasedJob]) -> None:
        """Take jobs back from the child that it did not finish, in their order, ahead of the others."""
        with self.changed:
            kept = []
            for job in jobs:
                self._leave_child(job)
                if _key(job) in self._lost:
                    self._lost.discard(_key(job))
                else:
                    kept.append(job)
            self._waiting.extendleft(reversed(kept))
            self._note_idle()
            self.changed.notify_all()

    def runner_ends(self) -> None:
        """Note that no more outcomes will come."""
        with self.changed:
            self._runner_ended = True
            self.changed.notify_all()

    # What the reporter does.

    def next_errand(self) -> Errand | None:
        """Wait until there is something to ask or tell the coordinator; None when the reporter may end."""
        with self.changed:
            self._polling = False
            if self._idle_since_s is None:
                self._idle_since_s = self._clock()
            while True:
                now_s = self._clock()
                if self._over(now_s):
                    return None
                if now_s >= self._retry_at_s and (errand := self._errand(now_s)) is not None:
                    self._polling = isinstance(errand, Poll)
                    return errand
                self.changed.wait(self._next_change_s(now_s))

    def granted(self, reply: LeaseReply) -> None:
        """Add newly leased jobs."""
        with self.changed:
            self._polling = False
            self._nothing_new = not reply.jobs
            self._asked_in_vain = not reply.jobs
            self._waiting.extend(reply.jobs)
            self.changed.notify_all()

    def acknowledged(self, report: Report, statuses: Sequence[ResultStatus], *, wall_s: float) -> None:
        """Let go of what a report carried: the coordinator has answered for all of it."""
        with self.changed:
            self._pace = self._pace.after_request(wall_s)
            del self._finished[: len(report.outcomes)]
            self._one_by_one = max(0, self._one_by_one - len(report.outcomes))
            released = {(lease.job, lease.token) for lease in report.release}
            self._waiting = deque(job for job in self._waiting if _key(job) not in released)
            self._note_idle()
            for outcome, status in zip(report.outcomes, statuses, strict=True):
                if status.status == "stale":
                    about = {"job": outcome.leased.job, "attempt": outcome.leased.attempt}
                    log.info("the lease was lost before the outcome arrived", extra=about)
            self.changed.notify_all()

    def refused(self, report: Report, reason: str) -> None:
        """Find the outcome that the coordinator will not take, and put a failure in its place.

        A report of several is sent again one by one. An outcome that is refused alone is reported as an error of
        its job; if that is refused too, it is dropped, and the lease will expire.
        """
        with self.changed:
            if len(report.outcomes) > 1 or report.room:
                self._one_by_one = max(1, len(report.outcomes))
                return
            refused = self._finished.pop(0)
            about = {"job": refused.leased.job, "reason": reason}
            if refused.replaced:
                log.error("the coordinator refuses even the failure of a job; dropped", extra=about)
                self._one_by_one = max(0, self._one_by_one - 1)
                self._note_idle()
                return
            log.error("the coordinator refuses an outcome; reporting an error instead", extra=about)
            failure = JobFailed(
                reason="error", message=f"the coordinator refused the outcome: {reason}"[:4000]
            )
            self._finished.insert(
                0,
                Outcome(
                    leased=refused.leased,
                    outcome=failure,
                    size_bytes=len(failure.message),
                    finished_s=refused.finished_s,
                    replaced=True,
                ),
            )

    def postpone(self, delay_s: float) -> None:
        """Run no errand for so long: the coordinator is away."""
        with self.changed:
            self._polling = False
            self._asked_in_vain = True
            self._retry_at_s = self._clock() + delay_s
            self.changed.notify_all()

    @property
    def unsent(self) -> int:
        """Outcomes that the coordinator has not answered for."""
        with self.changed:
            return len(self._finished)

    # What the heartbeat does.

    def leases(self) -> tuple[HeldLease, ...]:
        """Return every lease that is still needed, unsent outcomes included."""
        with self.changed:
            jobs = [*self._in_child, *self._waiting, *(outcome.leased for outcome in self._finished)]
            return tuple(HeldLease(job=job.job, token=job.token) for job in jobs)

    def renewed(self, asked: Iterable[HeldLease], held: Iterable[int]) -> None:
        """Drop the jobs that were asked for and are no longer held.

        Outcomes stay: what became of their lease is told when they are reported.
        """
        held_jobs = set(held)
        gone = {(lease.job, lease.token) for lease in asked if lease.job not in held_jobs}
        if not gone:
            return
        with self.changed:
            for job in [job for job in self._waiting if _key(job) in gone]:
                self._waiting.remove(job)
                log.info("dropped a job whose lease was lost", extra={"job": job.job})
            for job in self._in_child:
                if _key(job) in gone:
                    self._lost.add(_key(job))
                    log.info("lost the lease of a job in the simulation process", extra={"job": job.job})
            self._nothing_new = False
            self._note_idle()
            self.changed.notify_all()

    def lost_for_s(self) -> tuple[LeasedJob, float] | None:
        """Return the running job and how long it has run, if its lease is lost."""
        with self.changed:
            if self._in_child and _key(self._in_child[0]) in self._lost:
                return self._in_child[0], self._clock() - self._running_since_s
            return None

    # What the worker does.

    def stop(self) -> None:
        """Start nothing new; give everything back that does not run."""
        with self.changed:
            self._stopping = True
            self._retry_at_s = 0.0
            self.changed.notify_all()

    @property
    def stopping(self) -> bool:
        """Whether the worker was asked to stop."""
        return self._stopping

    @property
    def runner_ended(self) -> bool:
        """Whether no more outcomes will come."""
        return self._runner_ended

    @property
    def polling(self) -> bool:
        """Whether the reporter waits for a job while nothing is held, so that nothing is lost by leaving."""
        return self._polling

    def _errand(self, now_s: float) -> Errand | None:
        if self._stopping:
            if not self._finished and not self._waiting:
                return None
            release = tuple(HeldLease(job=job.job, token=job.token) for job in self._waiting)
            return Report(outcomes=self._batch(), release=release, room=0)
        room = max(0, self._pace.hold - len(self._waiting) - len(self._in_child))
        if not self._waiting and not self._in_child and not self._finished:
            return Poll(room=room, idle_left_s=self._idle_left_s(now_s))
        batch = self._batch()
        if self._one_by_one and batch:
            # Alone and without a lease request, so that a refusal can mean nothing but this outcome.
            return Report(outcomes=batch, release=(), room=0)
        ahead = len(self._waiting) + len(self._in_child) - 1
        # Where the queue was found empty, one report of all that is left will do: nobody waits for a part of it.
        running_low = ahead <= self._pace.low and not (self._nothing_new and ahead >= 0)
        if batch and (running_low or now_s >= batch[0].finished_s + self._report_after_s):
            return Report(outcomes=batch, release=(), room=room)
        if running_low and room:
            return Report(outcomes=batch, release=(), room=room)
        return None

    def _batch(self) -> tuple[Outcome, ...]:
        batch: list[Outcome] = []
        size_bytes = 0
        for outcome in self._finished[: 1 if self._one_by_one else MAX_BATCH]:
            size_bytes += outcome.size_bytes
            if batch and size_bytes > MAX_BATCH_BYTES:
                break
            batch.append(outcome)
        return tuple(batch)

    def _over(self, now_s: float) -> bool:
        if self._waiting or self._in_child or self._finished:
            return False
        if self._stopping:
            return self._runner_ended
        # However short the time, nobody leaves without having asked.
        idle_left_s = self._idle_left_s(now_s)
        return self._asked_in_vain and idle_left_s is not None and idle_left_s <= 0

    def _idle_left_s(self, now_s: float) -> float | None:
        if self._exit_when_idle_s is None or self._idle_since_s is None:
            return None
        return self._idle_since_s + self._exit_when_idle_s - now_s

    def _next_change_s(self, now_s: float) -> float | None:
        """Return when to look again though nobody has changed anything."""
        times_s = [self._retry_at_s] if self._retry_at_s > now_s else []
        if self._finished and not times_s:
            times_s.append(self._finished[0].finished_s + self._report_after_s)
        if (idle_left_s := self._idle_left_s(now_s)) is not None and not self._in_child:
            times_s.append(now_s + idle_left_s)
        return max(0.0, min(times_s) - now_s) if times_s else None

    def _leave_child(self, job: LeasedJob) -> float:
        """Take a job out of the child; return the time, from which the next one runs."""
        now_s = self._clock()
        if job in self._in_child:
            self._in_child.remove(job)
            self._running_since_s = now_s
        return now_s

    def _note_idle(self) -> None:
        if not self._waiting and not self._in_child and not self._finished:
            self._idle_since_s = self._clock()
            self._asked_in_vain = False


def _key(job: LeasedJob) -> Key:
    return job.job, job.token
