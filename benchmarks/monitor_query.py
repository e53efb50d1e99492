"""Time one question to a monitor, by how much it learned from: ``python benchmarks/monitor_query.py``."""

import argparse
import statistics
import time

import numpy as np

from brink.bench.distances import mixed_space
from brink.search.analysis.monitor import Monitor
from brink.search.streams import Stream, generator

SIZES = (300, 1_300, 5_000, 20_000)
TARGET_MS = {1_300: 1.0}
"""Most milliseconds that a question may take, by how much the monitor learned from."""


def main() -> None:
    """Print a table: solutions, shortest and median time, target."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=list(SIZES), help="solutions it learned from")
    parser.add_argument("--repeats", type=int, default=500, help="questions")
    arguments = parser.parse_args()
    space, rng = mixed_space(), generator(1, Stream.START)
    rows = np.array([space.join(space.sample(rng)) for _ in range(max(arguments.sizes))])
    unsafe = rng.random(len(rows)) < 0.35
    asked = [space.decode(space.sample(rng)) for _ in range(arguments.repeats)]
    print(f"{'solutions':>10} {'min ms':>8} {'median ms':>10} {'target ms':>10}")
    for size in arguments.sizes:
        monitor = Monitor.of(space, np.ones(space.dimension), rows[:size], unsafe[:size], threshold=0.1)
        times_ms = []
        for values in asked:
            start = time.perf_counter()
            monitor.ask(values)
            times_ms.append(1e3 * (time.perf_counter() - start))
        median, target = statistics.median(times_ms), TARGET_MS.get(size)
        verdict = "" if target is None else "met" if median <= target else "MISSED"
        shown = "-" if target is None else f"{target:g}"
        print(f"{size:>10} {min(times_ms):>8.3f} {median:>10.3f} {shown:>10} {verdict}")


if __name__ == "__main__":
    main()
