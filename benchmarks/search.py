"""CPU time of a generation step by the size of the archive, and of whole searches beside their simulations."""

import statistics
import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from benchmarks.finders import FINDERS
from benchmarks.measurement import Row, at_most, under
from brink.search.algorithm import AnyAlgorithm, Evaluation, ask_all
from brink.search.archive import Archive, Neighbourhood
from brink.search.space import SearchSpace
from brink.search.streams import Stream, episode_seed, generator
from brink.search.testing import synthetic_verdicts
from brink.server.problems.catalogue import make_algorithm
from brink.server.problems.urban_errors import UrbanErrors, UrbanErrorsParams
from brink.server.problems.urban_injected import UrbanInjected, UrbanInjectedParams
from brink.sim.catalogue import SIMULATORS, load_plugin

SIZES = (200, 1_300, 5_000, 20_000)
NEW_SOLUTIONS = 60
UNSAFE = 0.35
TARGETS_MS = {1_300: 5.0, 20_000: 80.0}
"""Longest allowed median time of a generation step, by archive size."""
DRIVES = 40
"""Random drives that are simulated before each search, and as many after it."""
MOST_PERCENT = 5.0
"""Largest CPU time of a search, in percent of that of its simulations."""


def measure_searches(
    ids: Sequence[str] = tuple(dict.fromkeys(("edge@2", *FINDERS.values()))),
    budget: int = 1_300,
    drives: int = DRIVES,
) -> Iterator[Row]:
    """Time whole searches with synthetic verdicts, in percent of the CPU time that their simulations would take.

    Drives are simulated right before and after each search, so that a busy machine slows down both alike. Loading
    programs does not count.

    Args:
        ids: Ids of the algorithms.
        budget: Simulations of each search.
        drives: Random drives before, and after, each search.
    """
    problem = UrbanErrors(UrbanErrorsParams())
    _drives_cpu_s(problem, 1)
    for name in ids:
        algorithm: AnyAlgorithm = make_algorithm(name)
        _search_cpu_s(algorithm, problem.space, 150)
        drives_s = _drives_cpu_s(problem, drives)
        spent_s, generations = _search_cpu_s(algorithm, problem.space, budget)
        drive_s = (drives_s + _drives_cpu_s(problem, drives)) / (2 * drives)
        yield under(
            f"% of the CPU time of {budget:,} simulations: {name}",
            100 * spent_s / (budget * drive_s),
            MOST_PERCENT,
            f"{spent_s:.2f} s in {generations} generations; {1e3 * drive_s:.1f} ms a drive",
        )


def _drives_cpu_s(problem: UrbanErrors, count: int) -> float:
    """Return the CPU time of simulating random drives."""
    drawn = [problem.space.sample(generator(1, Stream.START, number)) for number in range(count)]
    specs = [problem.episode(vectors, episode_seed(1, number)) for number, vectors in enumerate(drawn)]
    made: Any = load_plugin(SIMULATORS, specs[0].simulator)
    simulator = made()
    started_s = time.process_time()
    for spec in specs:
        simulator.run(spec)
    return time.process_time() - started_s


def _search_cpu_s(algorithm: AnyAlgorithm, space: SearchSpace, budget: int) -> tuple[float, int]:
    """Return the CPU time of a search without that of its verdicts, and the number of generations."""
    verdicts = synthetic_verdicts(space)
    started_s, judged_s = time.process_time(), 0.0
    state: Any = algorithm.start(space, algorithm.config_type(), seed=1, budget=budget)
    while not algorithm.finished(state):
        state, _ = ask_all(algorithm, state)
        before_s = time.process_time()
        evaluations: dict[int, Evaluation] = {one.number: verdicts(one) for one in state.pending}
        judged_s += time.process_time() - before_s
        state = algorithm.tell(state, evaluations)
    return time.process_time() - started_s - judged_s, state.generation


def measure_steps(sizes: Sequence[int] = SIZES, repeats: int = 15, seed: int = 1) -> Iterator[Row]:
    """Time a generation step (computing distances, counts and fitness for 60 new solutions) at several archive sizes.

    Args:
        sizes: Archive sizes before the step.
        repeats: Number of measurements of each step, >= 1.
        seed: Seed of the solutions.
    """
    space, rng = UrbanInjected(UrbanInjectedParams()).space, generator(seed, Stream.START)
    rows = np.array([space.join(space.sample(rng)) for _ in range(max(sizes) + NEW_SOLUTIONS)])
    unsafe = rng.random(len(rows)) < UNSAFE
    robustness, numbers = np.where(unsafe, -1.0, 1.0), np.arange(len(rows))
    for size in sizes:
        before, new = slice(size), slice(size, size + NEW_SOLUTIONS)
        archive = Archive.empty(space, Neighbourhood(radius=0.3, p_th=0.1)).grown(
            numbers[before], rows[before], unsafe[before], robustness[before], keep_rows=False
        )
        times_ms = []
        for _ in range(repeats):
            start = time.perf_counter()
            archive.grown(numbers[new], rows[new], unsafe[new], robustness[new])
            times_ms.append(1e3 * (time.perf_counter() - start))
        yield at_most(
            f"ms of {NEW_SOLUTIONS} new solutions beside {size:,}",
            statistics.median(times_ms),
            TARGETS_MS.get(size),
            f"median of {repeats}; shortest {min(times_ms):.2f}",
        )
