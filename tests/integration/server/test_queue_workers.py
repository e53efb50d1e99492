"""What is known of workers: which of them are dead, and which are forgotten."""

import os
import subprocess
import sys

import pytest
from support.queue import Queue

from server.queue import lease_store, workers
from worker.machine import machine_name
from worker.wire import WorkerIdentity


@pytest.fixture
def dead_pid() -> int:
    """The id of a process that is no more."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def noted(queue: Queue, machine: str, pid: int, worker: str = "w1") -> None:
    identity = WorkerIdentity(id=worker, host="here", pid=pid, machine=machine)
    queue.run(lambda connection: workers.note(connection, identity, ["x"], done=0, failed=0))


def test_leases_of_a_dead_process_of_this_machine_are_found(queue: Queue, dead_pid: int) -> None:
    queue.campaign(2)
    (lost,) = queue.lease("w1", max_jobs=1)
    queue.lease("w2", max_jobs=1)
    noted(queue, machine_name(), dead_pid)
    noted(queue, machine_name(), os.getpid(), "w2")
    found = queue.run(lambda connection: workers.leases_of(connection, workers.process_is_gone))
    assert [(lease.job, lease.token) for lease in found] == [(lost.job, lost.token)]
    queue.run(lambda connection: lease_store.cut_short(connection, found))
    assert queue.expire()[1] == 1


@pytest.mark.parametrize("machine", ["", "another-boot pid:[4026531836]"])
def test_a_process_id_of_another_machine_is_not_looked_up(queue: Queue, dead_pid: int, machine: str) -> None:
    queue.campaign(1)
    queue.lease("w1")
    noted(queue, machine, dead_pid)
    assert queue.run(lambda connection: workers.leases_of(connection, workers.process_is_gone)) == []


def test_a_machine_is_this_boot_seen_from_this_pid_namespace() -> None:
    with open("/proc/sys/kernel/random/boot_id") as file:
        assert file.read().strip() in machine_name()
    assert os.readlink("/proc/self/ns/pid") in machine_name()
    child = subprocess.run(
        [sys.executable, "-c", "from worker.machine import machine_name; print(machine_name())"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert child.stdout.strip() == machine_name()
