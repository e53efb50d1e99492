"""CPU time of a generation step of a search, by the size of its archive."""

import statistics
import time
from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks.measurement import Row, at_most
from brink.search.archive import Archive, Neighbourhood
from brink.search.streams import Stream, generator
from brink.server.problems.urban_injected import UrbanInjected, UrbanInjectedParams

SIZES = (200, 1_300, 5_000, 20_000)
NEW_SOLUTIONS = 60
UNSAFE = 0.35
TARGETS_MS = {1_300: 5.0, 20_000: 80.0}
"""Longest allowed median time of a generation step, by archive size."""


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
