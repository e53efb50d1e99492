"""What a measurement starts ends with it, even if it is killed."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from support.api import eventually

from benchmarks.lifeline import start_tied

PROGRAM = """
import multiprocessing, os, signal, sys, time
from pathlib import Path
from benchmarks.processes import Process
from brink.worker.pool import process_pool

idle, stopped = (Process(["sleep", "1000"], Path(name), {}) for name in ("idle", "stopped"))
for one in (idle, stopped):
    one.start()
stopped.signal(signal.SIGSTOP)
with process_pool(2) as pool:
    pool.submit(os.getpid).result()
    busy = pool.submit(time.sleep, 1000)
    waiting = pool.submit(os.getpid).result()
    children = [child.pid for child in multiprocessing.active_children()]
    print(idle.pid, stopped.pid, *children, flush=True)
    time.sleep(1000)
"""
"""Starts programs, one of them stopped, and a pool with a process that works and one that waits for work."""


def is_alive(pid: int) -> bool:
    """Return whether a process runs or is stopped; one that has ended may not have been waited for."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state not in "ZX"


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks processes up as Linux shows them")
def test_processes_of_a_killed_measurement_end(tmp_path: Path) -> None:
    command = [sys.executable, "-c", PROGRAM]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, start_new_session=True) as killed:
        assert killed.stdout is not None
        pids = [int(word) for word in killed.stdout.readline().split()]
        assert len(pids) == 4
        assert all(is_alive(pid) for pid in pids)
        killed.kill()
    eventually(lambda: not any(is_alive(pid) for pid in pids), "all processes end")


def test_a_tied_program_that_has_ended_leaves_no_descriptor_open() -> None:
    before = os.listdir("/dev/fd")
    process = start_tied(["true"])
    assert process.wait() == 0
    del process
    with pytest.raises(FileNotFoundError):
        start_tied(["/no/such/program"])
    assert os.listdir("/dev/fd") == before


def test_a_tied_program_can_be_stopped_as_any_other() -> None:
    process = start_tied(["sleep", "1000"])
    process.terminate()
    assert process.wait() == -signal.SIGTERM
