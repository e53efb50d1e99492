"""What a worker costs: the gap between two episodes, and the processor time of the worker itself.

Runs ``python -m brink.worker`` against the tests' small coordinator, with episodes that compute for a set time, and
prints one line a setting. The gap is measured inside the simulation process, from the end of one run to the beginning
of the next; the processor time is that of the worker alone, without its simulation process, per job.

    .venv/bin/python benchmarks/worker_overhead.py --jobs 200 --episode-ms 70
"""

import argparse
import itertools
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests" / "integration" / "worker"), str(ROOT)]

from worker_harness import FakeCoordinator  # noqa: E402

from brink.worker.wire import Completed, ResultsRequest  # noqa: E402


def measure(jobs: int, episode_s: float, *, max_jobs: int, prefetch_s: float) -> dict[str, float]:
    """Return the measurements of one run of a worker."""
    with FakeCoordinator() as coordinator:
        command = [
            sys.executable,
            "-m",
            "brink.worker",
            "--server",
            coordinator.url,
            "--log-level",
            "warning",
        ]
        command += ["--max-jobs", str(max_jobs), "--prefetch", str(prefetch_s)]
        environment = {
            **os.environ,
            "PYTHONPATH": f"{ROOT / 'tests' / 'plugins'}{os.pathsep}{ROOT}",
            "BRINK_PLUGINS": "faulty_simulator",
        }
        with subprocess.Popen(command, env=environment, cwd=ROOT) as worker:
            # The first jobs teach the worker its pace, and warm its connection up.
            warm_up = max(10, max_jobs)
            for _ in range(warm_up):
                coordinator.add({"fault": "slow", "slow_s": episode_s})
            coordinator.wait_for_all()
            requests, cpu_s = len(coordinator.requests), processor_time_s(worker.pid)
            with coordinator.changed:
                for _ in range(jobs):
                    coordinator.add({"fault": "slow", "slow_s": episode_s}, timeout_s=600.0)
            began_s = time.monotonic()
            wait_for_all(coordinator)
            wall_s = time.monotonic() - began_s
            cpu_s = processor_time_s(worker.pid) - cpu_s
            worker.terminate()
        gaps_s, own_s = gaps(coordinator, after=warm_up)
        reports = [m for name, m in coordinator.requests[requests:] if isinstance(m, ResultsRequest)]
    return {
        "episode_ms": episode_s * 1e3,
        "max_jobs": max_jobs,
        "prefetch_s": prefetch_s,
        "jobs": jobs,
        "jobs_a_report": statistics.mean(len(report.results) for report in reports if report.results),
        "gap_median_ms": statistics.median(gaps_s) * 1e3,
        "own_gap_median_ms": statistics.median(own_s) * 1e3,
        "own_gap_p99_ms": statistics.quantiles(own_s, n=100)[98] * 1e3,
        "gap_p99_ms": statistics.quantiles(gaps_s, n=100)[98] * 1e3,
        "worker_cpu_a_job_ms": cpu_s / jobs * 1e3,
        "simulating_share": jobs * episode_s / wall_s,
    }


def wait_for_all(coordinator: FakeCoordinator) -> None:
    """Wait for every outcome, for as long as it takes, looking only now and then."""
    with coordinator.changed:
        while any(job.outcome is None for job in coordinator.jobs.values()):
            coordinator.changed.wait()


def gaps(coordinator: FakeCoordinator, *, after: int) -> tuple[list[float], list[float]]:
    """Return the times between the end of a run and the beginning of the next.

    Returns:
        The whole gaps, and the gaps without the time in which the simulation process was ready to go on but other
        programs had the processor: the second is what the worker itself causes, on a machine as busy as it may be.
    """
    told = [
        {name: float(value) for name, value in job.outcome.provenance.items()}
        for job in coordinator.jobs.values()
        if job.job > after and isinstance(job.outcome, Completed)
    ]
    runs = list(itertools.pairwise(sorted(told, key=lambda run: run["began_s"])))
    whole_s = [following["began_s"] - run["ended_s"] for run, following in runs]
    queued_s = [following["began_queued_s"] - run["ended_queued_s"] for run, following in runs]
    return whole_s, [max(0.0, gap_s - wait_s) for gap_s, wait_s in zip(whole_s, queued_s, strict=True)]


def processor_time_s(pid: int) -> float:
    """Return the processor time of all threads of a process, to the nanosecond."""
    threads = Path(f"/proc/{pid}/task").iterdir()
    return sum(int((thread / "schedstat").read_text().split()[0]) for thread in threads) / 1e9


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the measurements, as a table or as JSON lines."""
    parser = argparse.ArgumentParser(description="Measures what a worker costs.")
    parser.add_argument("--jobs", type=int, default=200)
    parser.add_argument("--episode-ms", type=float, default=70.0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(arguments)
    for max_jobs, prefetch_s in ((1, 0.0), (2, 1.0), (8, 0.25), (10, 10.0)):
        row = measure(options.jobs, options.episode_ms / 1e3, max_jobs=max_jobs, prefetch_s=prefetch_s)
        print(
            json.dumps(row) if options.json else "  ".join(f"{k} {v:.3g}" for k, v in row.items()), flush=True
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
