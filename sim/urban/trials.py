"""Owns running many episodes in a few processes, for measurements without a coordinator."""

import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache

from sim.catalogue import Simulator, make_simulator
from sim.episode import EpisodeSpec

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
_CHUNK = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """What a measurement needs of an episode.

    Attributes:
        unsafe: Whether the first requirement is violated.
        robustness: Of the first requirement.
    """

    unsafe: bool
    robustness: float


@cache
def _simulator(simulator_id: str) -> Simulator:
    return make_simulator(simulator_id)


def run_trial(spec: EpisodeSpec) -> Trial:
    """Run one episode in this process."""
    result = _simulator(spec.simulator).run(spec)
    verdict = result.verdicts[spec.requirements[0]]
    return Trial(unsafe=verdict.violated, robustness=verdict.robustness)


def run_trials(specs: Sequence[EpisodeSpec], *, processes: int = 2) -> Iterator[Trial]:
    """Run episodes and yield their outcomes in the order of the specifications.

    Args:
        specs: What to run.
        processes: In how many processes; 1 runs them in this one.
    """
    if processes <= 1:
        yield from map(run_trial, specs)
        return
    context = multiprocessing.get_context("spawn")
    with single_threaded(), ProcessPoolExecutor(processes, mp_context=context) as pool:
        yield from pool.map(run_trial, specs, chunksize=_CHUNK)


@contextmanager
def single_threaded() -> Iterator[None]:
    """Keep numerical libraries of the processes that are started meanwhile to one thread."""
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
