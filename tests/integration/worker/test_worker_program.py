"""The worker as a program: its signals, its exit status, and that it leaves nothing behind."""

import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest
from fake_coordinator import FakeCoordinator
from working import ROOT, use_faulty_simulator, worker_program

from brink.worker.wire import LeaseRequest

PATIENCE_S = 30.0


@pytest.fixture(autouse=True)
def _plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    use_faulty_simulator(monkeypatch)


@pytest.fixture
def coordinator() -> Iterator[FakeCoordinator]:
    with FakeCoordinator() as coordinator:
        yield coordinator


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_lets_the_running_episode_end_and_the_program_exits_with_0(
    coordinator: FakeCoordinator, number: signal.Signals
) -> None:
    job = coordinator.add({"fault": "wait", "slow_s": 0.5})
    with worker_program(coordinator.url) as program:
        coordinator.wait_until(lambda c: c.jobs[job].token is not None)
        program.send_signal(number)
        assert program.wait(PATIENCE_S) == 0
    # It may have been granted and not begun; then it was given back.
    assert (coordinator.jobs[job].outcome is not None) or coordinator.queued() == [job]


def test_an_idle_program_exits_with_0_at_once(coordinator: FakeCoordinator) -> None:
    with worker_program(coordinator.url, "--wait", "60") as program:
        coordinator.wait_for_outcome(coordinator.add())
        program.terminate()
        assert program.wait(PATIENCE_S) == 0


def test_a_second_signal_ends_the_program_at_once(coordinator: FakeCoordinator) -> None:
    job = coordinator.add({"fault": "hang"}, timeout_s=3600.0)
    with worker_program(coordinator.url, "--grace", "3600") as program:
        coordinator.wait_until(lambda c: c.jobs[job].token is not None)
        children = _children(program.pid)
        program.terminate()
        assert program.stderr is not None
        _read_until(program, "stopping")
        program.terminate()
        assert program.wait(PATIENCE_S) == 128 + signal.SIGTERM
    _await_deaths(children)


def test_a_killed_program_leaves_no_process_behind(coordinator: FakeCoordinator) -> None:
    job = coordinator.add({"fault": "hang"}, timeout_s=3600.0)
    with worker_program(coordinator.url) as program:
        coordinator.wait_until(lambda c: c.jobs[job].token is not None)
        children = _children(program.pid)
        assert children
        program.kill()
        program.wait(PATIENCE_S)
        _await_deaths(children)


def test_a_program_that_lives_with_its_parent_leaves_when_standard_input_ends(
    coordinator: FakeCoordinator,
) -> None:
    job = coordinator.add({"fault": "hang"}, timeout_s=3600.0)
    with worker_program(coordinator.url, "--exit-with-parent", "--grace", "3600") as program:
        coordinator.wait_until(lambda c: c.jobs[job].token is not None)
        assert program.stdin is not None
        program.stdin.close()
        assert program.wait(PATIENCE_S) == 0
    assert coordinator.queued() == [job]


def test_the_log_names_worker_job_and_reason_on_one_line(coordinator: FakeCoordinator) -> None:
    job = coordinator.add({"fault": "exit"})
    with worker_program(coordinator.url, "--id", "w-17", "--exit-when-idle", "0") as program:
        _, log = program.communicate(timeout=PATIENCE_S)
    assert program.returncode == 0
    [line] = [line for line in log.splitlines() if "job failed" in line]
    for field in ("WARNING", "worker=w-17", f"job={job}", "attempt=1", "reason=crashed", "status 3"):
        assert field in line


def test_the_program_runs_what_there_is_and_leaves(coordinator: FakeCoordinator) -> None:
    for _ in range(5):
        coordinator.add()
    with worker_program(coordinator.url, "--exit-when-idle", "0") as program:
        assert program.wait(PATIENCE_S) == 0
    assert coordinator.queued() == []
    assert coordinator.of(LeaseRequest)


def test_a_bad_setting_is_a_usage_error() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "brink.worker", "--server", "localhost:8700"],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=False,
    )
    assert done.returncode == 2
    assert "expected a URL" in done.stderr


def _read_until(program: subprocess.Popen[str], text: str) -> None:
    assert program.stderr is not None
    for line in program.stderr:
        if text in line:
            return
    raise AssertionError(f"the program ended without saying {text!r}")


def _children(pid: int) -> list[int]:
    """Return handles of the processes that a process has started."""
    found = []
    for name in os.listdir(f"/proc/{pid}/task"):
        with open(f"/proc/{pid}/task/{name}/children", encoding="ascii") as children:
            found += [os.pidfd_open(int(child)) for child in children.read().split()]
    return found


def _await_deaths(handles: list[int]) -> None:
    for handle in handles:
        ended, _, _ = select.select([handle], [], [], PATIENCE_S)
        os.close(handle)
        assert ended, "a simulation process is still alive"
