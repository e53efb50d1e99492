"""A worker whose clock is wrong: ``python -m brink.bench.chaos.wrong_clock AHEAD_S RATE WORKER_OPTIONS…``.

The time of day is ahead by `AHEAD_S`, and the monotonic clock, by which the worker renews its leases, goes at `RATE`.
"""

import sys
import time
from collections.abc import Sequence

from brink.worker.run import main as run_worker


def mistake_time(ahead_s: float, rate: float) -> None:
    """Have this process read another time from now on."""
    right_time, right_monotonic, began = time.time, time.monotonic, time.monotonic()
    time.time = lambda: right_time() + ahead_s
    time.monotonic = lambda: began + rate * (right_monotonic() - began)


def main(arguments: Sequence[str]) -> int:
    """Run a worker with a wrong clock."""
    ahead_s, rate, *options = arguments
    mistake_time(float(ahead_s), float(rate))
    return run_worker(options)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
