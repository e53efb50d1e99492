"""Workers as programs: signals, exit status and processes of Brink's worker; the example of the worker guide."""

import json
import os
import re
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from worker_harness import ROOT, TIMEOUT_S, FakeCoordinator, Fault, use_faulty_simulator, worker_program

from brink.sim.catalogue import PLUGINS_VARIABLE
from brink.worker.wire import (
    Completed,
    HeartbeatReply,
    HeartbeatRequest,
    JobFailed,
    LeaseReply,
    LeaseRequest,
    Message,
    ResultsReply,
    ResultsRequest,
)

DOCS = ROOT / "docs"
GUIDE = (DOCS / "how-to" / "write-a-worker.md").read_text(encoding="utf-8")
PROTOCOL = (DOCS / "reference" / "worker-protocol.md").read_text(encoding="utf-8")


@pytest.fixture(autouse=True)
def _plugins(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    use_faulty_simulator(monkeypatch, tmp_path)


@pytest.fixture
def coordinator() -> Iterator[FakeCoordinator]:
    with FakeCoordinator() as coordinator:
        yield coordinator


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_after_a_signal_the_program_finishes_the_running_episode_and_exits_with_0(
    coordinator: FakeCoordinator, number: signal.Signals, tmp_path: Path
) -> None:
    stopping = tmp_path / "stopping"
    job = coordinator.add({"fault": "wait", "until": str(stopping)})
    with worker_program(coordinator.url) as program:
        coordinator.wait_until(lambda c: c.jobs[job].token is not None)
        program.send_signal(number)
        _read_until(program, "stopping")
        stopping.touch()
        assert program.wait(TIMEOUT_S) == 0
    # If the job was granted but had not begun, it was released.
    assert (coordinator.jobs[job].outcome is not None) or coordinator.queued() == [job]


def test_a_program_says_which_simulators_it_cannot_run(
    coordinator: FakeCoordinator, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    site = tmp_path / "site"
    site.mkdir()
    (site / "sitecustomize.py").write_text("import sys\nsys.modules['libsumo'] = None\n")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(map(str, (site, ROOT))))
    monkeypatch.delenv(PLUGINS_VARIABLE)
    with worker_program(coordinator.url) as program:
        _read_until(program, "cannot run sumo@1; to change that: ")
        program.terminate()
        assert program.wait(TIMEOUT_S) == 0


def test_a_second_signal_ends_the_program_at_once(coordinator: FakeCoordinator) -> None:
    job = coordinator.add({"fault": "hang"}, timeout_s=3600.0)
    with worker_program(coordinator.url, "--grace", "3600") as program:
        coordinator.wait_until(lambda c: c.jobs[job].token is not None)
        children = _children(program.pid)
        program.terminate()
        assert program.stderr is not None
        _read_until(program, "stopping")
        program.terminate()
        assert program.wait(TIMEOUT_S) == 128 + signal.SIGTERM
    _await_deaths(children)


def test_a_killed_program_leaves_no_process_behind(coordinator: FakeCoordinator) -> None:
    job = coordinator.add({"fault": "hang"}, timeout_s=3600.0)
    with worker_program(coordinator.url) as program:
        coordinator.wait_until(lambda c: c.jobs[job].token is not None)
        children = _children(program.pid)
        assert children
        program.kill()
        program.wait(TIMEOUT_S)
        _await_deaths(children)


def test_program_told_to_exit_with_its_parent_ends_at_end_of_input(coordinator: FakeCoordinator) -> None:
    job = coordinator.add({"fault": "hang"}, timeout_s=3600.0)
    with worker_program(coordinator.url, "--exit-with-parent", "--grace", "3600") as program:
        coordinator.wait_until(lambda c: c.jobs[job].token is not None)
        assert program.stdin is not None
        program.stdin.close()
        assert program.wait(TIMEOUT_S) == 0
    assert coordinator.queued() == [job]


def test_a_failed_job_is_logged_on_one_line_with_worker_job_and_reason(coordinator: FakeCoordinator) -> None:
    job = coordinator.add({"fault": "exit"})
    with worker_program(coordinator.url, "--id", "w-17", "--exit-when-idle", "0") as program:
        _, log = program.communicate(timeout=TIMEOUT_S)
    assert program.returncode == 0
    [line] = [line for line in log.splitlines() if "job failed" in line]
    for field in ("WARNING", "worker=w-17", f"job={job}", "attempt=1", "reason=crashed", "status 3"):
        assert field in line


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


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page, flags=re.DOTALL)


def test_every_message_in_the_reference_is_valid() -> None:
    kinds: list[type[Message]] = [
        LeaseRequest,
        LeaseReply,
        HeartbeatRequest,
        HeartbeatReply,
        ResultsRequest,
        ResultsReply,
    ]
    examples = blocks(PROTOCOL, "json")
    assert len(examples) == len(kinds)
    for kind, example in zip(kinds, examples, strict=True):
        message = kind.model_validate_json(example)
        assert message.model_dump(exclude_unset=True) == json.loads(example)


def test_the_example_in_the_guide_is_a_worker(tmp_path: Path) -> None:
    [source] = blocks(GUIDE, "python")
    program_file = tmp_path / "minimal.py"
    program_file.write_text(source, encoding="utf-8")
    # The lost reply carried a lease too: that job is queued again when its lease expires.
    with FakeCoordinator(lease_s=3.0) as coordinator:
        coordinator.faults["results"] += [Fault.DROP_REPLY, 503]
        good = [coordinator.add({"fog": fog}, simulator="my-simulator@1") for fog in (0.25, 1.5)]
        bad = coordinator.add({}, simulator="my-simulator@1")
        with subprocess.Popen([sys.executable, str(program_file), coordinator.url]) as program:
            try:
                coordinator.wait_for_all()
            finally:
                program.kill()
        outcomes = [coordinator.jobs[job].outcome for job in good]
        robustness = [o.verdicts["distance@1"].robustness for o in outcomes if isinstance(o, Completed)]
        assert robustness == [0.75, -0.5]
        failure = coordinator.jobs[bad].outcome
        assert isinstance(failure, JobFailed)
        assert "fog" in failure.message


def test_the_example_in_the_guide_exits_when_its_token_is_rejected(tmp_path: Path) -> None:
    [source] = blocks(GUIDE, "python")
    program_file = tmp_path / "minimal.py"
    program_file.write_text(source, encoding="utf-8")
    with FakeCoordinator(token="secret") as coordinator:
        done = subprocess.run(
            [sys.executable, str(program_file), coordinator.url],
            capture_output=True,
            text=True,
            timeout=30,
            check=False,
        )
    assert done.returncode == 1
    assert "a bearer token is needed" in done.stderr


def _read_until(program: subprocess.Popen[str], text: str) -> None:
    assert program.stderr is not None
    for line in program.stderr:
        if text in line:
            return
    raise AssertionError(f"the program ended without logging {text!r}")


def _children(pid: int) -> list[int]:
    """Return handles of the child processes of a process."""
    found = []
    for name in os.listdir(f"/proc/{pid}/task"):
        with open(f"/proc/{pid}/task/{name}/children", encoding="ascii") as children:
            found += [os.pidfd_open(int(child)) for child in children.read().split()]
    return found


def _await_deaths(handles: list[int]) -> None:
    for handle in handles:
        ended, _, _ = select.select([handle], [], [], TIMEOUT_S)
        os.close(handle)
        assert ended, "a simulation process is still alive"
