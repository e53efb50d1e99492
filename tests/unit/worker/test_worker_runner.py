"""The thread that keeps the simulation process busy, when the worker is told to stop between two episodes."""

from collections import deque
from random import Random
from typing import Any

import pytest

from brink.worker.held_jobs import HeldJobs, PrefetchPolicy
from brink.worker.loop import Runner
from brink.worker.process import Episode, FinishedEpisode
from brink.worker.wire import JobFailed, LeasedJob, LeaseReply


class Process:
    """Runs the episodes that it is sent in turn, each within one call of `receive`."""

    def __init__(self) -> None:
        self.sent: deque[int] = deque()

    @property
    def pending(self) -> int:
        return len(self.sent)

    def send(self, episode: Episode) -> None:
        self.sent.append(episode.ticket)

    def receive(self) -> FinishedEpisode:
        outcome = JobFailed(reason="error", message="of no interest")
        return FinishedEpisode(ticket=self.sent.popleft(), outcome=outcome, wall_s=0.1, size_bytes=1)

    def close(self) -> None:
        self.sent.clear()


class StoppedAfter(HeldJobs):
    """Jobs of a worker that is told to stop just before or just after the outcome of a job is stored."""

    def __init__(self, job: int, *, before: bool) -> None:
        super().__init__(PrefetchPolicy(prefetch_s=1.0, max_jobs=8))
        self._job, self._before = job, before
        self.done: list[int] = []

    def finish(self, job: LeasedJob, *args: Any, **kwargs: Any) -> bool:
        here = job.job == self._job
        if here and self._before:
            self.stop()
        stopping = super().finish(job, *args, **kwargs)
        self.done.append(job.job)
        if here and not self._before:
            self.stop()
        return stopping


@pytest.mark.parametrize(("before", "done"), [(True, [1]), (False, [1, 2])])
def test_the_episode_that_has_begun_when_the_worker_is_told_to_stop_is_finished(
    before: bool, done: list[int]
) -> None:
    held = StoppedAfter(1, before=before)
    jobs = [LeasedJob(job=n, token=f"t{n}", attempt=1, spec={}, timeout_s=1.0) for n in (1, 2, 3, 4)]
    held.add(LeaseReply(jobs=jobs, lease_s=60.0))
    Runner(held, Process(), Random(1)).run()  # type: ignore[arg-type]
    assert held.done == done
    assert held.runner_done
    assert {one.job for one in held.leases()} == {1, 2, 3, 4}, "nothing is lost"
