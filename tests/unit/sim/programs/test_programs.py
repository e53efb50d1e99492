"""Programs of users: how they are started, and that nothing of them stays."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.running import assert_gone, new_mark, parent_of, running

from brink.sim.errors import SimulationCrashed
from brink.sim.programs import Program, Supervisor, plain_environment
from brink.sim.programs import program as module
from brink.sim.programs.program import PRINTED_BYTES

PATIENCE_S = 30.0
FORKS = {
    "child": "sleep {mark} & wait",
    "left behind": "sleep {mark} & exit 4",
    "own session": "(setsid sleep {mark} &) ; sleep {mark}",
    "orphans of orphans": "for i in 1 2; do (setsid sh -c 'sleep {mark} & setsid sleep {mark}' &); done; exit 4",
    "no environment": "(env -i setsid nohup sleep {mark} &) ; exit 4",
}
CHAIN = """
import os, sys
while True:
    if os.fork():
        os._exit(0)
    os.setsid()
"""


@pytest.fixture
def supervisor() -> Iterator[Supervisor]:
    with Supervisor() as supervisor:
        yield supervisor


def start(supervisor: Supervisor, *command: str) -> Program:
    return supervisor.start(command, folder=Path("/"), environment=plain_environment())


def soon() -> float:
    return time.monotonic() + PATIENCE_S


@pytest.mark.parametrize("script", FORKS.values(), ids=FORKS)
def test_nothing_that_a_program_started_outlives_it(supervisor: Supervisor, script: str) -> None:
    mark = new_mark()
    with start(supervisor, "sh", "-c", script.format(mark=mark)) as program:
        if "exit" in script:
            ending = program.wait(soon())
        else:
            while not running(mark):
                time.sleep(0.001)
            ending = program.kill()
    assert not running(mark)
    assert ending is not None
    assert ending.left >= 1
    assert (ending.status, ending.was_killed) == ((4, False) if "exit" in script else (-9, True))


def test_a_program_that_forks_for_ever_is_caught(supervisor: Supervisor) -> None:
    with start(supervisor, sys.executable, "-c", CHAIN, mark := new_mark()) as program:
        ending = program.wait(soon())
    assert ending is not None
    assert ending.status == 0
    assert not running(mark)


def test_programs_die_with_the_process_that_runs_them_and_with_their_supervisor(tmp_path: Path) -> None:
    for whom, setpriv in (
        ("parent", module._SETPRIV),
        ("supervisor", module._SETPRIV),
        ("supervisor", "/no/setpriv"),
    ):
        mark = new_mark()
        script = "sleep {0}" if whom == "supervisor" else "(setsid sleep {0} &) ; sleep {0}"
        code = f"""
import json, time
from pathlib import Path
from brink.sim.programs import Supervisor, plain_environment, program as module
module._SETPRIV = {setpriv!r}
program = Supervisor().start(["sh", "-c", "exec " + {script.format(mark)!r}] if {whom == "supervisor"} else
    ["sh", "-c", {script.format(mark)!r}], folder=Path("/"), environment=plain_environment())
print(program.pid, flush=True)
try:
    program.wait(time.monotonic() + 100)
except Exception as error:
    print(type(error).__name__, error, flush=True)
"""
        with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as parent:
            assert parent.stdout is not None
            pid = int(parent.stdout.readline())
            while not running(mark):
                time.sleep(0.001)
            if whom == "parent":
                parent.kill()
            else:
                os.kill(parent_of(pid), signal.SIGKILL)
                assert parent.stdout.readline() == "SimulationCrashed the supervisor of programs was killed\n"
        assert_gone(mark)


def test_a_program_starts_with_default_signals_its_own_descriptors_and_limits(supervisor: Supervisor) -> None:
    code = """
import json, os, resource, signal
ignored = [n for n in signal.valid_signals() if signal.getsignal(n) is signal.SIG_IGN]
print(json.dumps({"fds": sorted(map(int, os.listdir("/proc/self/fd")))[:-1], "ignored": ignored,
    "blocked": [int(n) for n in signal.pthread_sigmask(signal.SIG_BLOCK, ())], "leads": os.getsid(0) == os.getpid(),
    "files": resource.getrlimit(resource.RLIMIT_FSIZE), "names": sorted(os.environ)}))
"""
    os.environ["BRINK_TOKEN"] = "secret"
    before = signal.signal(signal.SIGTERM, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGUSR2})
    try:
        with (
            Supervisor({"RLIMIT_FSIZE": 4096}) as cautious,
            start(cautious, sys.executable, "-I", "-c", code) as program,
        ):
            assert program.wait(soon()) is not None
            said = json.loads(program.output())
    finally:
        signal.signal(signal.SIGTERM, before)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGUSR2})
        del os.environ["BRINK_TOKEN"]
    assert "BRINK_TOKEN" not in said.pop("names")
    # Python itself ignores SIGPIPE and SIGXFSZ.
    assert set(said.pop("ignored")) <= {signal.SIGPIPE, signal.SIGXFSZ}
    assert said == {"fds": [0, 1, 2], "blocked": [], "leads": True, "files": [4096, 4096]}


def test_endless_output_neither_blocks_nor_fills_the_memory(supervisor: Supervisor) -> None:
    with start(supervisor, "sh", "-c", "yes | head -c 30000000; echo the end; exit 3") as program:
        ending = program.wait(soon())
        assert ending is not None
        assert ending.status == 3
        assert program.output().endswith("y\nthe end\n")
        assert len(program.output()) <= PRINTED_BYTES
    with start(supervisor, "yes") as program:
        assert program.wait(time.monotonic() + 0.05) is None
        assert program.kill().was_killed


@pytest.mark.parametrize(
    ("command", "error"),
    [
        (["no-such-program"], FileNotFoundError),
        (["/etc/passwd"], PermissionError),
        (["/"], PermissionError),
        (["sh", "x" * 3_000_000], OSError),
    ],
)
def test_what_cannot_be_started_is_said_and_the_next_program_runs(
    supervisor: Supervisor, command: list[str], error: type[OSError]
) -> None:
    with pytest.raises(error):
        start(supervisor, *command)
    with start(supervisor, "true") as program:
        ending = program.wait(soon())
        assert ending is not None
        assert ending.status == 0


def test_a_supervisor_that_was_killed_is_an_error_of_its_own(supervisor: Supervisor) -> None:
    with start(supervisor, "sleep", "100") as program:
        os.kill(parent_of(program.pid), signal.SIGKILL)
        with pytest.raises(SimulationCrashed, match="was killed"):
            program.wait(soon())
        with pytest.raises(SimulationCrashed, match="was killed"):
            start(supervisor, "true")
