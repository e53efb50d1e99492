"""A worker against a coordinator over real HTTP that fails in every way a coordinator can."""

import logging
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.api import eventually
from worker_harness import TIMEOUT_S, FakeCoordinator, Fault, running_worker, use_faulty_simulator

from brink.worker.backoff import Backoff
from brink.worker.wire import Completed, HeartbeatRequest, JobFailed, LeaseRequest, ResultsRequest


@pytest.fixture(autouse=True)
def _plugins(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    use_faulty_simulator(monkeypatch, tmp_path)


@pytest.fixture
def coordinator() -> Iterator[FakeCoordinator]:
    with FakeCoordinator() as coordinator:
        yield coordinator


def test_every_job_is_run_once_and_accepted(coordinator: FakeCoordinator) -> None:
    jobs = [coordinator.add() for _ in range(40)]
    with running_worker(coordinator.url):
        coordinator.wait_for_all()
    assert sorted(status.job for status in coordinator.statuses) == jobs
    assert {status.status for status in coordinator.statuses} == {"accepted"}
    for job in coordinator.jobs.values():
        assert job.attempt == 1
        assert isinstance(job.outcome, Completed)
        assert job.outcome.objectives["distance"] == pytest.approx(job.spec["behaviour"]["x"])


def test_a_worker_touches_its_alive_file_while_it_simulates_and_while_it_is_idle(
    coordinator: FakeCoordinator, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("brink.worker.alive_file.TOUCH_S", 0.0)
    alive, go_on = tmp_path / "alive", tmp_path / "go-on"
    with running_worker(coordinator.url, alive_file=alive):
        job = coordinator.add({"fault": "wait", "until": str(go_on)})
        coordinator.wait_until(lambda c: c.jobs[job].token is not None)
        for _ in ("simulating", "idle"):
            alive.unlink()
            eventually(alive.exists, "the file is touched again")
            go_on.touch()
            coordinator.wait_for_all()


def test_results_are_reported_in_batches_with_the_next_lease_request(coordinator: FakeCoordinator) -> None:
    for _ in range(60):
        coordinator.add()
    with running_worker(coordinator.url, max_jobs=8):
        coordinator.wait_for_all()
    reports = coordinator.served(ResultsRequest)
    assert len(reports) <= 30
    assert any(report.lease is not None and report.results for report in reports)
    assert all(report.lease is None or report.lease.wait_s == 0 for report in reports)


def test_the_last_results_of_a_generation_are_reported_at_once(coordinator: FakeCoordinator) -> None:
    with running_worker(coordinator.url, report_after_s=3600.0, prefetch_s=10.0):
        for _ in range(5):
            for _ in range(3):
                coordinator.add()
            coordinator.wait_for_all()


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("segfault", "crashed"),
        ("exit", "crashed"),
        ("out-of-memory", "out-of-memory"),
        ("invalid", "invalid"),
    ],
)
def test_a_faulty_job_is_reported_with_its_reason_and_its_neighbours_complete(
    coordinator: FakeCoordinator, fault: str, reason: str
) -> None:
    before = [coordinator.add() for _ in range(3)]
    faulty = coordinator.add({"fault": fault})
    after = [coordinator.add() for _ in range(3)]
    with running_worker(coordinator.url, prefetch_s=10.0):
        coordinator.wait_for_all()
    outcome = coordinator.jobs[faulty].outcome
    assert isinstance(outcome, JobFailed)
    assert outcome.reason == reason
    assert all(isinstance(coordinator.jobs[job].outcome, Completed) for job in before + after)


def test_a_drained_worker_finishes_what_it_holds_and_exits(
    coordinator: FakeCoordinator, tmp_path: Path
) -> None:
    go_on = tmp_path / "go-on"
    # The first outcomes show how short episodes are, so that the worker then holds several jobs.
    for _ in range(8):
        coordinator.add()
    with running_worker(coordinator.url, prefetch_s=10.0, max_jobs=4) as running:
        coordinator.wait_for_all()
        jobs = [coordinator.add({"fault": "wait", "until": str(go_on)}) for _ in range(12)]
        coordinator.wait_until(lambda c: len(c.delivered.intersection(jobs)) >= 2)
        coordinator.draining = True
        go_on.touch()
        assert running.join() == 0
    done = {job for job in jobs if coordinator.jobs[job].outcome is not None}
    assert done == coordinator.delivered.intersection(jobs)
    assert all(isinstance(coordinator.jobs[job].outcome, Completed) for job in done)
    assert set(coordinator.queued()) == set(jobs) - done, "nothing is lost, and others can run the rest"


def test_an_idle_worker_that_is_drained_exits(coordinator: FakeCoordinator) -> None:
    with running_worker(coordinator.url) as running:
        coordinator.wait_until(lambda c: bool(c.requests))
        coordinator.draining = True
        coordinator.add()
        assert running.join() == 0


def test_results_survive_a_coordinator_that_vanishes_and_returns(
    coordinator: FakeCoordinator, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    vanished = tmp_path / "vanished"
    with running_worker(coordinator.url, prefetch_s=10.0) as running:
        coordinator.add()
        coordinator.wait_for_all()
        jobs = [coordinator.add({"fault": "wait", "until": str(vanished)}) for _ in range(8)]
        coordinator.wait_until(lambda c: c.delivered.issuperset(jobs))
        with caplog.at_level(logging.INFO):
            coordinator.disappear()
            vanished.touch()
            _wait_for_line(caplog, "waiting for the coordinator")
            coordinator.appear()
            coordinator.wait_for_all()
            _wait_for_line(caplog, "is back")
            assert running.status is None
    assert all(job.attempt == 1 for job in coordinator.jobs.values())


def test_a_lost_reply_causes_a_duplicate_report_and_no_loss(coordinator: FakeCoordinator) -> None:
    coordinator.faults["results"].append(Fault.DROP_REPLY)
    job = coordinator.add()
    with running_worker(coordinator.url):
        coordinator.wait_until(lambda c: len(c.statuses) == 2)
    assert [(s.job, s.status) for s in coordinator.statuses] == [(job, "accepted"), (job, "duplicate")]


def test_a_lost_request_is_sent_again(coordinator: FakeCoordinator) -> None:
    coordinator.faults["results"] += [Fault.DROP_REQUEST, 500, 429, 503, 500, 500]
    coordinator.faults["lease"] += [500, Fault.DROP_REQUEST]
    coordinator.add()
    with running_worker(coordinator.url):
        coordinator.wait_for_all()
    assert [status.status for status in coordinator.statuses] == ["accepted"]


def test_an_outcome_whose_lease_was_lost_is_answered_stale_and_the_worker_continues(
    coordinator: FakeCoordinator, tmp_path: Path
) -> None:
    revoked = tmp_path / "revoked"
    lost = coordinator.add({"fault": "wait", "until": str(revoked)})
    with running_worker(coordinator.url):
        coordinator.wait_until(lambda c: c.jobs[lost].token is not None)
        coordinator.revoke(lost)
        revoked.touch()
        coordinator.wait_until(lambda c: bool(c.statuses))
        coordinator.wait_for_outcome(coordinator.add())
    assert (coordinator.statuses[0].job, coordinator.statuses[0].status) == (lost, "stale")
    assert coordinator.jobs[lost].outcome is None


def test_leases_are_renewed_during_a_long_episode(tmp_path: Path) -> None:
    renewed = tmp_path / "renewed"
    with FakeCoordinator(lease_s=3.0) as coordinator:
        job = coordinator.add({"fault": "wait", "until": str(renewed)})
        with running_worker(coordinator.url):
            # Four renewals at thirds of the lease: without them it would have expired by now.
            coordinator.wait_until(lambda c: len(c.served(HeartbeatRequest)) >= 4)
            renewed.touch()
            coordinator.wait_for_all()
        assert coordinator.jobs[job].attempt == 1
        assert [status.status for status in coordinator.statuses] == ["accepted"]


def test_jobs_missing_from_a_heartbeat_reply_are_dropped_and_a_long_one_is_abandoned() -> None:
    with FakeCoordinator(lease_s=0.6) as coordinator:
        # One quick job first: until it has measured an episode, a worker holds a single job.
        coordinator.add()
        with running_worker(coordinator.url, abandon_after_s=0.0, prefetch_s=10.0, max_jobs=3):
            coordinator.wait_for_all()
            lost = [coordinator.add({"fault": "hang"}, timeout_s=3600.0) for _ in range(3)]
            coordinator.wait_until(lambda c: all(c.jobs[job].token is not None for job in lost))
            for job in lost:
                coordinator.revoke(job)
            coordinator.wait_for_outcome(coordinator.add())
        assert [status.job for status in coordinator.statuses if status.job in lost] == []


def test_a_refused_outcome_becomes_an_error_and_the_others_are_accepted(coordinator: FakeCoordinator) -> None:
    with running_worker(coordinator.url, prefetch_s=10.0) as running:
        coordinator.add()
        coordinator.wait_for_all()
        with coordinator.changed:
            jobs = [coordinator.add() for _ in range(5)]
            coordinator.refused_jobs.add(jobs[2])
        good = [job for number, job in enumerate(jobs) if number != 2]
        coordinator.wait_until(lambda c: all(c.jobs[job].outcome is not None for job in good))
        # The error is refused too, so the job is dropped; the worker continues.
        coordinator.wait_for_outcome(coordinator.add())
        assert running.status is None
    sent = [
        result.outcome
        for request in coordinator.served(ResultsRequest)
        for result in request.results
        if result.job == jobs[2]
    ]
    assert isinstance(sent[0], Completed)
    assert isinstance(sent[-1], JobFailed)
    assert "too strange" in sent[-1].message
    assert "\n" not in sent[-1].message


def test_outcome_at_which_the_coordinator_fails_becomes_an_error_and_the_others_are_accepted(
    coordinator: FakeCoordinator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Backoff, "delay_s", lambda *_: 0.0)
    with running_worker(coordinator.url, prefetch_s=10.0):
        coordinator.add()
        coordinator.wait_for_all()
        with coordinator.changed:
            jobs = [coordinator.add() for _ in range(5)]
            coordinator.poisonous_jobs.add(jobs[2])
        coordinator.wait_for_all()
    failed = [job for job in jobs if isinstance(coordinator.jobs[job].outcome, JobFailed)]
    assert failed == [jobs[2]]


def test_stopping_finishes_the_episode_and_releases_the_rest(
    coordinator: FakeCoordinator, tmp_path: Path
) -> None:
    begun, stopped = tmp_path / "begun", tmp_path / "stopped"
    waits = {"fault": "wait", "until": str(stopped)}
    coordinator.add()
    with running_worker(coordinator.url, prefetch_s=10.0, report_after_s=0.0) as running:
        coordinator.wait_for_all()
        with coordinator.changed:
            jobs = [coordinator.add({"fault": "wait", "slow_s": 0.05})]
            jobs += [
                coordinator.add({**waits, "once": str(begun)}),
                *(coordinator.add(waits) for _ in range(3)),
            ]
        eventually(begun.exists, "the second episode has begun")
        coordinator.wait_for_outcome(jobs[0])
        running.worker.stop()
        stopped.touch()
        assert running.join() == 0
    done = [job for job in jobs if coordinator.jobs[job].outcome is not None]
    assert done == jobs[: len(done)]
    assert 2 <= len(done) < 5
    assert coordinator.queued() == jobs[len(done) :]
    assert all(coordinator.jobs[job].attempt == 0 for job in coordinator.queued())


def test_an_episode_that_exceeds_the_grace_period_is_released(coordinator: FakeCoordinator) -> None:
    job = coordinator.add({"fault": "hang"}, timeout_s=3600.0)
    with running_worker(coordinator.url, grace_s=0.2) as running:
        coordinator.wait_until(lambda c: c.jobs[job].token is not None)
        running.worker.stop()
        assert running.join() == 0
    assert coordinator.queued() == [job]


def test_a_worker_exits_when_idle(coordinator: FakeCoordinator) -> None:
    coordinator.add()
    with running_worker(coordinator.url, exit_when_idle_s=0.3) as running:
        assert running.join() == 0
    coordinator.wait_for_all()


def test_worker_without_a_coordinator_exits_when_idle_and_logs_why(caplog: pytest.LogCaptureFixture) -> None:
    with FakeCoordinator() as gone, caplog.at_level(logging.WARNING):
        gone.disappear()
        with running_worker(gone.url, exit_when_idle_s=0.3) as running:
            assert running.join() == 1
    assert "waiting for the coordinator" in caplog.text
    assert "no coordinator" in caplog.text


def test_a_worker_waits_for_a_coordinator_that_starts_later(caplog: pytest.LogCaptureFixture) -> None:
    with FakeCoordinator() as coordinator:
        coordinator.disappear()
        coordinator.add()
        with caplog.at_level(logging.WARNING), running_worker(coordinator.url):
            _wait_for_line(caplog, "waiting for the coordinator")
            coordinator.appear()
            coordinator.wait_for_all()


def test_a_worker_whose_token_is_rejected_exits_with_the_reason(caplog: pytest.LogCaptureFixture) -> None:
    with FakeCoordinator(token="right") as coordinator:
        with running_worker(coordinator.url, token="wrong") as running:
            assert running.join() == 1
        assert "leaving: token rejected: " in caplog.text
        coordinator.add()
        with running_worker(coordinator.url, token="right"):
            coordinator.wait_for_all()


def test_a_worker_leases_only_jobs_that_it_can_run(coordinator: FakeCoordinator) -> None:
    foreign = coordinator.add(simulator="elsewhere@1")
    coordinator.add()
    with running_worker(coordinator.url):
        coordinator.wait_until(lambda c: bool(c.statuses))
    assert coordinator.queued() == [foreign]
    assert all(
        "faulty@1" in request.capabilities and "elsewhere@1" not in request.capabilities
        for request in coordinator.served(LeaseRequest)
    )


def test_a_process_that_cannot_be_restarted_ends_the_worker_and_its_jobs_are_released(
    coordinator: FakeCoordinator, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = coordinator.add()
    with running_worker(coordinator.url, start_timeout_s=5.0) as running:
        coordinator.wait_for_outcome(first)
        monkeypatch.setenv("BRINK_PLUGINS", "no_such_plugin")
        crashing, after = coordinator.add({"fault": "segfault"}), coordinator.add()
        assert running.join() == 1
    assert isinstance(coordinator.jobs[crashing].outcome, JobFailed)
    assert coordinator.queued() == [after]


def _wait_for_line(caplog: pytest.LogCaptureFixture, text: str) -> None:
    """Wait until a line with this text is logged."""
    seen = threading.Event()

    class Listener(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if text in record.getMessage():
                seen.set()

    listener = Listener()
    logging.getLogger().addHandler(listener)
    try:
        assert text in caplog.text or seen.wait(TIMEOUT_S), f"nothing was logged with {text!r}"
    finally:
        logging.getLogger().removeHandler(listener)


def test_a_hanging_job_is_reported_as_a_timeout(coordinator: FakeCoordinator) -> None:
    hanging = coordinator.add({"fault": "hang"}, timeout_s=0.3)
    after = coordinator.add()
    with running_worker(coordinator.url):
        coordinator.wait_for_all()
    outcome = coordinator.jobs[hanging].outcome
    assert isinstance(outcome, JobFailed)
    assert outcome.reason == "timeout"
    assert isinstance(coordinator.jobs[after].outcome, Completed)
