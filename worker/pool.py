"""Pools of processes that run episodes without a coordinator.

The processes are spawned, use one thread each, and end when the process that started them ends, even if it is killed.
"""

import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager

from brink.worker.child import exit_with_parent

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")


def end_with_parent() -> None:
    """End this process, which `multiprocessing` started, when its parent ends.

    A process of a pool would otherwise wait for the next task forever: it holds both ends of the pool's queue.
    """
    parent = multiprocessing.parent_process()
    assert parent is not None, "only processes that multiprocessing started have a parent process"
    exit_with_parent(parent.sentinel)


def process_pool(processes: int) -> ProcessPoolExecutor:
    """Return a pool of fresh processes, spawned rather than forked, which end when this process does."""
    spawn = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(processes, mp_context=spawn, initializer=end_with_parent)


@contextmanager
def single_threaded() -> Iterator[None]:
    """Limit numerical libraries to one thread in processes that are started inside the block."""
    before = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
