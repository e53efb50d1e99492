"""The thread that keeps the simulation process busy."""

import logging
from random import Random
from typing import Final

from brink.worker.backoff import Backoff
from brink.worker.errors import ChildFailedToStart, EpisodeAbandoned
from brink.worker.holdings import Holdings
from brink.worker.process import Episode, EpisodeProcess, Finished
from brink.worker.wire import JobFailed, LeasedJob

log = logging.getLogger(__name__)

AHEAD: Final = 2
"""Episodes in the process: the running one, and the next, so that it never waits for its parent between two."""

START_ATTEMPTS: Final = 3
"""Failed starts in a row after which the worker gives up."""


class Runner:
    """Moves jobs from the holdings through the process and back.

    Args:
        holdings: Where jobs come from and outcomes go to.
        process: Already started; this thread alone uses and closes it.
        rng: Spreads the waits between failed starts.
    """

    def __init__(self, holdings: Holdings, process: EpisodeProcess, rng: Random) -> None:
        self._holdings = holdings
        self._process = process
        self._rng = rng
        self._backoff = Backoff(first_s=1.0, cap_s=30.0)
        self._jobs: dict[int, LeasedJob] = {}
        self._next_ticket = 0
        self._failed_starts = 0

    def run(self) -> None:
        """Run jobs until the worker stops; then end the process and put back what it has not finished.

        Raises:
            ChildFailedToStart: The process died and did not come up again.
        """
        try:
            while self._feed() and self._advance():
                pass
        finally:
            self._process.close()
            self._holdings.put_back(tuple(self._jobs.values()))
            self._holdings.runner_ends()

    def ticket_of(self, job: LeasedJob) -> int | None:
        """Return the ticket under which a job is in the process; safe from any thread."""
        return next((ticket for ticket, other in self._jobs.copy().items() if other == job), None)

    def _feed(self) -> bool:
        """Fill the process up; wait for a job if it has none. False if there is none and will be none."""
        while self._process.pending < AHEAD:
            job = self._holdings.take(wait=self._process.pending == 0)
            if job is None:
                break
            ticket, self._next_ticket = self._next_ticket, self._next_ticket + 1
            # Known before it is sent, so that it is put back whatever happens on the way.
            self._jobs[ticket] = job
            episode = Episode(ticket=ticket, spec=job.spec, record=job.record, timeout_s=job.timeout_s)
            try:
                self._process.send(episode)
            except ChildFailedToStart as error:
                self._holdings.put_back([self._jobs.pop(ticket)])
                self._bear(error)
            except EpisodeAbandoned:
                return False
        return self._process.pending > 0 and not self._holdings.stopping

    def _advance(self) -> bool:
        """Wait for one outcome. False if the process was ended on purpose."""
        try:
            finished = self._process.receive()
        except EpisodeAbandoned as abandoned:
            if abandoned.ticket is None:
                return False
            self._holdings.put_back([self._jobs.pop(abandoned.ticket)])
            return True
        except ChildFailedToStart as error:
            self._bear(error)
            return True
        self._failed_starts = 0
        job = self._jobs.pop(finished.ticket)
        _log_outcome(job, finished)
        self._holdings.finish(job, finished.outcome, wall_s=finished.wall_s, size_bytes=finished.size_bytes)
        return True

    def _bear(self, error: ChildFailedToStart) -> None:
        self._failed_starts += 1
        if self._failed_starts >= START_ATTEMPTS:
            raise error
        delay_s = self._backoff.delay_s(self._failed_starts, self._rng)
        log.warning("%s; trying again", error, extra={"in_s": round(delay_s, 1)})
        with self._holdings.changed:
            self._holdings.changed.wait_for(lambda: self._holdings.stopping, delay_s)


def _log_outcome(job: LeasedJob, finished: Finished) -> None:
    about: dict[str, object] = {"campaign": job.campaign, "job": job.job, "attempt": job.attempt}
    if isinstance(finished.outcome, JobFailed):
        about["reason"] = finished.outcome.reason
        log.warning("job failed: %s", finished.outcome.message.partition("\n")[0], extra=about)
    elif log.isEnabledFor(logging.DEBUG):
        about["wall_s"] = round(finished.wall_s, 4)
        log.debug("job completed", extra=about)
