"""Running episodes in a process pool without a coordinator, and storing outcomes so that none is computed twice."""

import contextlib
import gzip
import hashlib
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from benchmarks.lifeline import start_tied
from benchmarks.measurement import Progress, memory_mib, silent
from brink.sim.catalogue import Simulator, make_simulator
from brink.sim.episode import EpisodeSpec, Json
from brink.worker.pool import process_pool, single_threaded

Task = TypeVar("Task")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """The outcome of an episode or of a data-set evaluation, as plain JSON values.

    Attributes:
        robustness: Robustness by requirement id.
        objectives: Objectives by name.
        features: Features by name.
        cpu_s: CPU time.
        wall_s: Wall-clock time.
    """

    robustness: dict[str, float]
    objectives: dict[str, float]
    features: dict[str, Json]
    cpu_s: float
    wall_s: float

    @property
    def unsafe(self) -> bool:
        """Whether any requirement is violated."""
        return any(value < 0 for value in self.robustness.values())


@cache
def cached_simulator(simulator_id: str) -> Simulator:
    """Return a simulator, the same one in each call."""
    return make_simulator(simulator_id)


def mapped(
    run: Callable[[Task], Result],
    tasks: Sequence[Task],
    *,
    processes: int,
    part: str,
    progress: Progress = silent,
    chunk: int = 1,
) -> list[Result]:
    """Return the results of tasks, in order.

    Args:
        run: What runs a task; a function of a module.
        tasks: The tasks.
        processes: Number of processes; 1 runs the tasks in this process.
        part: Name of the part, for the progress callback.
        progress: Progress callback, called after each task.
        chunk: Tasks that a process is given at a time.
    """
    results: list[Result] = []
    with contextlib.ExitStack() as stack:
        found: Iterator[Result] = map(run, tasks)
        if processes > 1:
            stack.enter_context(single_threaded())
            found = stack.enter_context(process_pool(processes)).map(run, tasks, chunksize=chunk)
        for result in found:
            results.append(result)
            progress(part, len(results), len(tasks))
    return results


def process_memory_mb(specs: Sequence[EpisodeSpec], settle: int = 20) -> tuple[float, float]:
    """Return the memory of a fresh process after its first episodes, and after all of them.

    Args:
        specs: Episodes to run.
        settle: Number of episodes before the first value.
    """
    # A new interpreter, because a spawned process would import the main module of this one.
    command = [sys.executable, "-m", "benchmarks.trials", str(settle)]
    with single_threaded():
        process = start_tied(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        answer, _ = process.communicate(json.dumps([spec.to_json() for spec in specs]).encode())
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    first_mb, last_mb = json.loads(answer.splitlines()[-1])
    return first_mb, last_mb


def _memory_after(specs: Iterable[EpisodeSpec], settle: int) -> tuple[float, float]:
    first_mb = 0.0
    for index, spec in enumerate(specs, 1):
        run_record(spec)
        if index == settle:
            first_mb = memory_mib("self")
    return first_mb, memory_mib("self")


def run_record(spec: EpisodeSpec) -> Record:
    """Run one episode or data-set evaluation in this process."""
    cpu_s, wall_s = time.process_time(), time.perf_counter()
    result = cached_simulator(spec.simulator).run(spec)
    return Record(
        robustness={name: verdict.robustness for name, verdict in result.verdicts.items()},
        objectives=dict(result.objectives),
        features=dict(result.features),
        cpu_s=time.process_time() - cpu_s,
        wall_s=time.perf_counter() - wall_s,
    )


def stored(file: Path, compute: Callable[[], Any]) -> Any:
    """Return a JSON document from a compressed file, or compute it and store it there."""
    if not file.exists():
        file.parent.mkdir(parents=True, exist_ok=True)
        partial = file.with_suffix(".partial")
        with gzip.open(partial, "wt", encoding="utf-8") as out:
            json.dump(compute(), out)
        partial.replace(file)
    with gzip.open(file, "rt", encoding="utf-8") as source:
        return json.load(source)


def code_fingerprint(packages: Sequence[str]) -> str:
    """Return a fingerprint of the code and model weights that determine an episode: 12 hexadecimal digits.

    Args:
        packages: Folders or modules of the project, such as ``sim/aeb`` or ``sim/requirements.py``.

    Raises:
        FileNotFoundError: A folder or module does not exist.
    """
    digest = hashlib.sha256()
    root = Path(__file__).parent.parent
    for package in packages:
        path = root / package
        if not path.exists():
            raise FileNotFoundError(f"expected a folder or module of the project, got {package!r}")
        for file in sorted(path.rglob("*")) if path.is_dir() else (path,):
            if file.suffix in (".py", ".onnx"):
                digest.update(str(file.relative_to(root)).encode())
                digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


class Records:
    """A process pool that stores the outcomes of episodes in a file, so that no episode runs twice.

    Args:
        file: JSON-lines file. Episodes whose outcomes it already holds are not run again.
        processes: Number of processes.
    """

    def __init__(self, file: Path, *, processes: int = 2) -> None:
        self._file = file
        self._processes = processes
        self._known: dict[str, Record] = {}
        self._pool: ProcessPoolExecutor | None = None
        file.parent.mkdir(parents=True, exist_ok=True)
        if file.exists():
            text = file.read_text(encoding="utf-8")
            for line in text.splitlines():
                with contextlib.suppress(ValueError):  # a killed run may leave its last line incomplete
                    document = json.loads(line)
                    digest = document.pop("spec")
                    self._known[digest] = Record(**document)
            if text and not text.endswith("\n"):
                with file.open("a", encoding="utf-8") as out:
                    out.write("\n")

    def run(self, specs: Sequence[EpisodeSpec], part: str = "", progress: Progress = silent) -> list[Record]:
        """Return the outcomes of episodes, in order.

        Args:
            specs: Episodes; only those without a stored outcome are run.
            part: Name of the part, for the progress callback.
            progress: Progress callback, called after each episode.
        """
        missing = {spec.digest(): spec for spec in specs if spec.digest() not in self._known}
        done = len(specs) - len(missing)
        if missing:
            with single_threaded(), self._file.open("a", encoding="utf-8") as out:
                if self._pool is None:
                    self._pool = process_pool(self._processes)
                pool = self._pool
                waiting = {pool.submit(run_record, spec): digest for digest, spec in missing.items()}
                for future in as_completed(waiting):
                    record = future.result()
                    self._known[waiting[future]] = record
                    out.write(json.dumps({"spec": waiting[future], **asdict(record)}) + "\n")
                    out.flush()
                    done += 1
                    progress(part, done, len(specs))
        return [self._known[spec.digest()] for spec in specs]

    def close(self) -> None:
        """Stop the processes and cancel pending episodes."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None


if __name__ == "__main__":
    _given = map(EpisodeSpec.from_json, json.load(sys.stdin))
    sys.stdout.write(json.dumps(_memory_after(_given, int(sys.argv[1]))) + "\n")
