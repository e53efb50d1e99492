"""The simulation process: whatever an episode does, its failure is reported and the next episode runs."""

import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from worker_harness import ROOT, use_faulty_simulator

from brink.worker.errors import ChildFailedToStart, EpisodeAbandoned
from brink.worker.process import ONE_THREAD, Episode, EpisodeProcess
from brink.worker.wire import Completed, JobFailed


@pytest.fixture(autouse=True)
def _plugins(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    use_faulty_simulator(monkeypatch, tmp_path)


@pytest.fixture(scope="module")
def shared_processes() -> Iterator[list[EpisodeProcess]]:
    """Running processes that a test may use; at most one."""
    processes: list[EpisodeProcess] = []
    yield processes
    for process in processes:
        process.close()


@pytest.fixture
def process(shared_processes: list[EpisodeProcess]) -> Iterator[EpisodeProcess]:
    """A running process; the next test gets the same one unless this test fails or closes it."""
    process = shared_processes.pop() if shared_processes else EpisodeProcess(memory_mib=256)
    if process.pid is None:
        process.start()
    yield process
    if process.pending or process.pid is None:
        process.close()
    else:
        shared_processes.append(process)


def spec(**scenario: Any) -> dict[str, Any]:
    return {
        "simulator": "faulty@1",
        "scenario": scenario,
        "behaviour": {"x": 0.6},
        "requirements": ["distance@1"],
        "seed": 1,
        "duration_s": 1.0,
        "options": {},
    }


def run(process: EpisodeProcess, *, timeout_s: float = 20.0, **scenario: Any) -> Completed | JobFailed:
    return process.run(spec(**scenario), record=False, timeout_s=timeout_s)


def failure(process: EpisodeProcess, *, timeout_s: float = 20.0, **scenario: Any) -> JobFailed:
    outcome = run(process, timeout_s=timeout_s, **scenario)
    assert isinstance(outcome, JobFailed)
    return outcome


def works(process: EpisodeProcess) -> bool:
    outcome = run(process, y=0.8)
    assert isinstance(outcome, Completed)
    return outcome.verdicts["distance@1"].robustness == pytest.approx(0.0, abs=1e-12)


def await_death(pid: int) -> None:
    """Wait for the end of any process, child or not."""
    try:
        handle = os.pidfd_open(pid)
    except ProcessLookupError:
        return
    try:
        ended, _, _ = select.select([handle], [], [], 20.0)
        assert ended, f"process {pid} is still alive"
    finally:
        os.close(handle)


def test_a_recorded_episode_carries_its_trace(process: EpisodeProcess) -> None:
    outcome = process.run(spec(), record=True, timeout_s=20.0)
    assert isinstance(outcome, Completed)
    assert outcome.trace is not None


@pytest.mark.parametrize(
    ("fault", "reason", "words"),
    [
        ("segfault", "crashed", ("was killed by SIGSEGV", "faulty_simulator.py", "string_at")),
        ("exit", "crashed", ("exited with status 3",)),
        ("crashed", "crashed", ("the engine gave up",)),
        ("error", "error", ("RuntimeError: the physics came apart", "faulty_simulator.py")),
        ("out-of-memory", "out-of-memory", ("MemoryError",)),
        ("invalid", "invalid", ("there is no such road",)),
        ("nan", "error", ("cannot be sent", "verdicts.distance@1.robustness")),
    ],
)
def test_a_fault_is_reported_with_its_reason_and_the_next_episode_runs(
    process: EpisodeProcess, fault: str, reason: str, words: tuple[str, ...]
) -> None:
    outcome = failure(process, fault=fault)
    assert outcome.reason == reason
    for word in words:
        assert word in outcome.message
    assert works(process)


def test_a_hang_is_killed_and_reported_with_its_stack(process: EpisodeProcess) -> None:
    assert works(process), "the simulator is loaded"
    outcome = failure(process, fault="hang", timeout_s=1.5)
    assert outcome.reason == "timeout"
    assert "1.5 s" in outcome.message
    assert "in cause" in outcome.message
    assert works(process)


def test_a_malformed_specification_is_invalid(process: EpisodeProcess) -> None:
    outcome = process.run({"simulator": "faulty@1"}, record=False, timeout_s=20.0)
    assert isinstance(outcome, JobFailed)
    assert outcome.reason == "invalid"


def test_noise_on_standard_output_does_not_break_the_pipe(process: EpisodeProcess) -> None:
    assert isinstance(run(process, fault="print"), Completed)
    assert works(process)


def test_the_message_of_a_crash_is_bounded_however_much_was_printed(process: EpisodeProcess) -> None:
    process.send(Episode(ticket=1, spec=spec(fault="print"), record=False, timeout_s=20.0))
    process.send(Episode(ticket=2, spec=spec(fault="segfault"), record=False, timeout_s=20.0))
    assert isinstance(process.receive().outcome, Completed)
    outcome = process.receive().outcome
    assert isinstance(outcome, JobFailed)
    assert len(outcome.message) <= 4000
    assert outcome.message.startswith("the simulation process was killed by SIGSEGV")


def test_a_specification_larger_than_the_pipe_does_not_block(process: EpisodeProcess) -> None:
    for ticket in (1, 2):
        wide = spec(fault="wait", slow_s=0.05, padding="x" * 300_000)
        process.send(Episode(ticket=ticket, spec=wide, record=False, timeout_s=20.0))
    assert [process.receive().ticket for _ in range(2)] == [1, 2]


def test_episodes_sent_behind_a_crashing_one_run_in_the_next_process(process: EpisodeProcess) -> None:
    process.send(Episode(ticket=7, spec=spec(fault="segfault"), record=False, timeout_s=20.0))
    process.send(Episode(ticket=8, spec=spec(), record=False, timeout_s=20.0))
    first, second = process.receive(), process.receive()
    assert (first.ticket, second.ticket) == (7, 8)
    assert isinstance(first.outcome, JobFailed)
    assert isinstance(second.outcome, Completed)


def test_a_process_that_died_while_idle_is_not_blamed_on_the_next_episode(process: EpisodeProcess) -> None:
    assert works(process)
    assert process.pid is not None
    os.kill(process.pid, signal.SIGKILL)
    await_death(process.pid)
    assert works(process)


def test_an_abandoned_episode_has_no_outcome_and_the_next_one_runs(process: EpisodeProcess) -> None:
    process.send(Episode(ticket=1, spec=spec(fault="hang"), record=False, timeout_s=20.0))
    process.send(Episode(ticket=2, spec=spec(), record=False, timeout_s=20.0))
    process.abandon(2)
    process.abandon(1)
    with pytest.raises(EpisodeAbandoned):
        process.receive()
    assert isinstance(process.receive().outcome, Completed)


def test_closing_returns_the_episodes_without_an_outcome(process: EpisodeProcess) -> None:
    for ticket in (4, 5):
        process.send(Episode(ticket=ticket, spec=spec(fault="hang"), record=False, timeout_s=20.0))
    assert process.close() == (4, 5)


def test_unimportable_simulator_is_skipped_with_reason(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    installed = tmp_path / "lost-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: lost\nVersion: 1.0\n")
    (installed / "entry_points.txt").write_text("[brink.simulators]\nlost@1 = no_such_module:Simulator\n")
    process = EpisodeProcess()
    try:
        hello = process.start()
    finally:
        process.close()
    assert "faulty@1" in hello.simulators
    assert "no_such_module" in hello.left_out["lost@1"]


def test_a_plug_in_that_cannot_be_imported_is_named() -> None:
    process = EpisodeProcess(plugins=("no_such_plugin",))
    with pytest.raises(
        ChildFailedToStart, match="plug-in module 'no_such_plugin', which --plugin or BRINK_PLUGINS names"
    ):
        process.start()
    process.close()


def test_process_uses_one_thread_and_sees_no_token(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "environment_reader.py").write_text(
        "import os\n"
        "from brink.sim.catalogue import register\n"
        "from brink.sim.episode import EpisodeResult\n"
        "class Reader:\n"
        "    def run(self, spec, *, record=False):\n"
        "        return EpisodeResult(verdicts={}, objectives={}, provenance={}, features=dict(os.environ))\n"
        "register('brink.simulators', 'reader@1', Reader)\n"
    )
    monkeypatch.setenv("BRINK_PLUGINS", "environment_reader")
    monkeypatch.setenv("BRINK_TOKEN", "secret")
    monkeypatch.setenv("OMP_NUM_THREADS", "16")
    process = EpisodeProcess()
    try:
        process.start()
        outcome = process.run({**spec(), "simulator": "reader@1"}, record=False, timeout_s=20.0)
    finally:
        process.close()
    assert isinstance(outcome, Completed)
    assert "BRINK_TOKEN" not in outcome.features
    assert {name: outcome.features[name] for name in ONE_THREAD} == ONE_THREAD


def test_the_process_dies_with_its_parent_even_while_it_holds_the_interpreter_lock() -> None:
    parent = (
        "import os, sys\n"
        "from brink.worker.process import Episode, EpisodeProcess\n"
        "process = EpisodeProcess()\n"
        "process.start()\n"
        "spec = dict(simulator='faulty@1', scenario={'fault': 'hang'}, behaviour={}, requirements=[], seed=1,\n"
        "            duration_s=1.0)\n"
        "process.send(Episode(ticket=1, spec={**spec, 'scenario': {}}, record=False, timeout_s=60))\n"
        "process.send(Episode(ticket=2, spec=spec, record=False, timeout_s=60))\n"
        "process.receive()\n"
        "print(process.pid, flush=True)\n"
        "sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", parent], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT
    ) as program:
        assert program.stdout is not None
        pid = int(program.stdout.readline())
        handle = os.pidfd_open(pid)
        program.kill()
        ended, _, _ = select.select([handle], [], [], 20.0)
        os.close(handle)
    assert ended


def test_the_process_ignores_signals_of_the_terminal(process: EpisodeProcess) -> None:
    assert works(process)
    pid = process.pid
    assert pid is not None
    for number in (signal.SIGINT, signal.SIGTERM):
        os.kill(pid, number)
    assert works(process)
    assert process.pid == pid
