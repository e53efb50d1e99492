"""A worker with wrong clocks: ``python -m benchmarks.wrong_clock AHEAD_S RATE WORKER_OPTIONS…``.

Its time of day is ahead by `AHEAD_S`. Its monotonic clock, which times the renewal of leases, runs at `RATE`.
"""

import sys
import time
from collections.abc import Sequence

from brink.worker.run import main as run_worker


def skew_clocks(ahead_s: float, rate: float) -> None:
    """Replace the clocks of this process with wrong ones.

    Args:
        ahead_s: Offset of the time of day, in s.
        rate: Speed of the monotonic clock; 1 is right.
    """
    right_time, right_monotonic, start = time.time, time.monotonic, time.monotonic()
    time.time = lambda: right_time() + ahead_s
    time.monotonic = lambda: start + rate * (right_monotonic() - start)


def main(arguments: Sequence[str]) -> int:
    """Run a worker with wrong clocks."""
    ahead_s, rate, *options = arguments
    skew_clocks(float(ahead_s), float(rate))
    return run_worker(options)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
