"""The cost of `command@1`: an episode beside its bare command, and simulations a second with real workers.

The program is C++. It computes for a given CPU time and writes a log of 100 samples. Whatever the rest of the machine
does should hit both sides alike: episodes and bare commands take turns, and each campaign runs between two rounds of
bare commands, as many at a time as it has workers.
"""

import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final

import httpx
import yaml
from sqlalchemy import select

from benchmarks.measurement import Progress, Row, at_most, counted, untargeted
from benchmarks.processes import MeasurementFailed, Process, running_coordinator
from brink.server.campaigns.body import CampaignBody, read_campaign_file
from brink.server.campaigns.plan import make_checked_plan
from brink.server.db.engine import open_engines
from brink.server.db.models import JobRow
from brink.server.problems.command import Command
from brink.server.states import JobStatus
from brink.sim.adapters.command.simulator import CommandSimulator
from brink.sim.programs.installed import COMMANDS_VARIABLE

DURATIONS_MS: Final = (20, 2)
WORKERS: Final = (1, 2, 8)
TARGET: Final = (20, 2)
"""Duration of the program and number of workers for which there are targets."""
MOST_MS: Final = 5.0
MOST_SHARE: Final = 0.15
_WARM: Final = 0.1
"""Share of a campaign's simulations before those that are timed: workers start their simulation processes."""
_POLL_S: Final = 0.2
_TIMEOUT_S: Final = 300.0
_PROGRAM: Final = """
#include <cstdio>
#include <cstdlib>
#include <ctime>

int main(int, char** argv) {
  std::FILE* log = std::fopen("log.csv", "w");
  std::fprintf(log, "time,x\\n");
  for (int i = 0; i < 100; ++i) std::fprintf(log, "%g,%g\\n", i * 0.1, std::atof(argv[2]) + i);
  std::fclose(log);
  timespec now;
  do {
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  } while (now.tv_sec * 1e3 + now.tv_nsec / 1e6 < std::atof(argv[1]));
}
"""


def measure_command(*, episodes: int, simulations: int, progress: Progress) -> list[Row]:
    """Return the overhead of an episode, and of campaigns with 1, 2 and 8 workers.

    Args:
        episodes: Episodes and bare commands that take turns in one process, for each program.
        simulations: Simulations of each campaign.
        progress: Progress callback.

    Raises:
        OSError: There is no C++ compiler.
        subprocess.CalledProcessError: It failed.
        MeasurementFailed: A coordinator or a worker did not do what it should.
    """
    rows: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="brink-") as name:
        folder = Path(name)
        (folder / "busy.cpp").write_text(_PROGRAM)
        subprocess.run(["c++", "-O2", "-o", "busy", "busy.cpp"], cwd=folder, check=True)
        for duration_ms in DURATIONS_MS:
            body = _campaign(folder, duration_ms, simulations)
            with _commands_in(folder / "commands"):
                problem = make_checked_plan(body).problem
                assert isinstance(problem, Command)
                problem.install()
            rows += _episode_rows(folder, duration_ms, problem, episodes, progress)
            for workers in WORKERS:
                progress(f"campaigns, {duration_ms} ms", WORKERS.index(workers), len(WORKERS))
                before = _bare_rate(folder, duration_ms, workers, simulations)
                campaign = _campaign_rate(folder, body, workers)
                after = _bare_rate(folder, duration_ms, workers, simulations)
                rows += rate_rows(duration_ms, workers, (before, after), campaign)
    return rows


def _campaign(folder: Path, duration_ms: int, simulations: int) -> CampaignBody:
    file = folder / "campaign.yaml"
    params = {
        "command": ["./busy", str(duration_ms), "{x}", "{seed}"],
        "space": {"scenario": {"x": {"min": 0, "max": 1}}},
        "signals": {"file": "log.csv"},
        "requirements": {"small": {"signal": "x", "below": 99.5}},
    }
    document = {
        "name": f"{duration_ms} ms",
        "problem": {"id": "command@1", "params": params},
        "algorithm": {"id": "random@1"},
        "budget": {"simulations": simulations},
    }
    file.write_text(yaml.safe_dump(document))
    return read_campaign_file(file)


@contextmanager
def _commands_in(folder: Path) -> Iterator[None]:
    """Install definitions in a folder until the end of the block."""
    folder.mkdir(exist_ok=True)
    before = os.environ.get(COMMANDS_VARIABLE)
    os.environ[COMMANDS_VARIABLE] = str(folder)
    try:
        yield
    finally:
        del os.environ[COMMANDS_VARIABLE]
        if before is not None:
            os.environ[COMMANDS_VARIABLE] = before


def _run_bare(folder: Path, duration_ms: int) -> None:
    subprocess.run([folder / "busy", str(duration_ms), "0.5", "1"], cwd=folder, check=True)


def _episode_rows(
    folder: Path, duration_ms: int, problem: Command, episodes: int, progress: Progress
) -> Iterator[Row]:
    simulator = CommandSimulator(problem.definition, problem.params.program)
    spec = problem.episode(problem.space.encode({"scenario": {"x": 0.5}}), 1)
    times_s: Mapping[str, list[float]] = {"bare": [], "episode": []}
    cpu_s = 0.0
    for number in counted(progress, f"episodes, {duration_ms} ms", episodes + 1):
        began_s = time.perf_counter()
        _run_bare(folder, duration_ms)
        between_s, cpu_began_s = time.perf_counter(), time.process_time()
        simulator.run(spec)
        if number > 0:  # the first episode starts the supervisor
            times_s["bare"].append(between_s - began_s)
            times_s["episode"].append(time.perf_counter() - between_s)
            cpu_s += time.process_time() - cpu_began_s
    bare_ms, episode_ms = (1e3 * statistics.median(one) for one in times_s.values())
    note = f"medians {episode_ms:.2f} and {bare_ms:.2f} ms; {1e3 * cpu_s / episodes:.2f} ms of CPU time here"
    yield untargeted(f"{duration_ms} ms, one process: ms more than bare", episode_ms - bare_ms, note)


def _bare_rate(folder: Path, duration_ms: int, at_once: int, runs: int) -> float:
    """Return how many bare commands a second a number of threads get done."""
    left = iter(range(runs))
    lock = threading.Lock()

    def work(place: int) -> None:
        own = folder / f"bare-{place}"
        own.mkdir(exist_ok=True)
        while True:
            with lock:
                if next(left, None) is None:
                    return
            subprocess.run([folder / "busy", str(duration_ms), "0.5", "1"], cwd=own, check=True)

    threads = [threading.Thread(target=work, args=(place,)) for place in range(at_once)]
    began_s = time.perf_counter()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return runs / (time.perf_counter() - began_s)


def _campaign_rate(folder: Path, body: CampaignBody, workers: int) -> float:
    """Return how many simulations a second a campaign gets done by real workers, once all of them work."""
    with tempfile.TemporaryDirectory(prefix="brink-") as name, ExitStack() as stack:
        coordinator = stack.enter_context(running_coordinator(Path(name)))
        environment = {COMMANDS_VARIABLE: str(folder / "commands")}
        for number in range(workers):
            command = [sys.executable, "-m", "brink.worker", "--server", coordinator.url]
            worker = Process(command, Path(name) / f"worker-{number}.log", environment)
            worker.start()
            stack.callback(worker.kill)
        document = {**body.document(), "tags": [], "notes": ""}
        answer = httpx.post(f"{coordinator.url}/api/v1/campaigns", json=document, timeout=60.0)
        if answer.is_error:
            raise MeasurementFailed(f"the campaign was refused: {answer.text:.400}")
        return _rate(f"sqlite:///{name}/coordinator.db", body.budget.simulations)


def _rate(database: str, simulations: int) -> float:
    """Wait until a campaign has ended; return its simulations a second after the first few."""
    engines = open_engines(database)
    finished = select(JobRow.finished_at).where(JobRow.status == JobStatus.DONE).order_by(JobRow.finished_at)
    deadline_s = time.monotonic() + _TIMEOUT_S
    try:
        while time.monotonic() < deadline_s:
            with engines.reader.connect() as connection:
                times = [one for one in connection.execute(finished).scalars() if one is not None]
            if len(times) >= simulations:
                first = round(_WARM * simulations)
                between_s = (times[-1] - times[first]).total_seconds()
                return sum(one > times[first] for one in times) / between_s
            time.sleep(_POLL_S)
    finally:
        engines.dispose()
    raise MeasurementFailed(f"expected {simulations} simulations within {_TIMEOUT_S:g} s, got {len(times)}")


def rate_rows(duration_ms: int, workers: int, bare: Sequence[float], campaign: float) -> list[Row]:
    """Return the rows of a campaign beside bare commands.

    Args:
        duration_ms: CPU time of the program.
        workers: Number of workers, and of bare commands at a time.
        bare: Bare commands a second, in rounds before and after the campaign.
        campaign: Simulations a second.
    """
    mean = statistics.fmean(bare)
    targeted = (duration_ms, workers) == TARGET
    what = f"{duration_ms} ms, {workers} worker{'s' if workers > 1 else ''}"
    more_ms = 1e3 * workers * (1 / campaign - 1 / mean)
    note = f"bare commands: {bare[0]:.1f} and {bare[1]:.1f} a second"
    return [
        untargeted(f"{what}: simulations a second", campaign, note),
        at_most(f"{what}: ms a worker more than bare", more_ms, MOST_MS if targeted else None),
        at_most(f"{what}: share of the bare time", mean / campaign - 1, MOST_SHARE if targeted else None),
    ]
