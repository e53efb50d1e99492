"""Runs many episodes in a few processes, for measurements that need no coordinator."""

import contextlib
import hashlib
import json
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import TypeAlias

from brink.sim.catalogue import Simulator, make_simulator
from brink.sim.episode import EpisodeSpec, Json

Progress: TypeAlias = Callable[[int, int], None]
"""Called with the number of episodes done and the total."""

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
_CHUNK = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """The verdict of an episode.

    Attributes:
        unsafe: Whether the first requirement is violated.
        robustness: Robustness of the first requirement.
    """

    unsafe: bool
    robustness: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """The outcome of an episode or of a data-set evaluation, as plain JSON values.

    Attributes:
        robustness: Robustness of each requirement, by id.
        objectives: By name.
        features: By name.
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
        specs: The episodes.
        processes: Number of processes; 1 runs the episodes in this process.
    """
    if processes <= 1:
        yield from map(run_trial, specs)
        return
    context = multiprocessing.get_context("spawn")
    with single_threaded(), ProcessPoolExecutor(processes, mp_context=context) as pool:
        yield from pool.map(run_trial, specs, chunksize=_CHUNK)


def run_record(spec: EpisodeSpec) -> Record:
    """Run one specification in this process."""
    cpu_s, wall_s = time.process_time(), time.perf_counter()
    result = _simulator(spec.simulator).run(spec)
    return Record(
        robustness={name: verdict.robustness for name, verdict in result.verdicts.items()},
        objectives=dict(result.objectives),
        features=dict(result.features),
        cpu_s=time.process_time() - cpu_s,
        wall_s=time.perf_counter() - wall_s,
    )


def code_fingerprint(packages: Sequence[str]) -> str:
    """Return a fingerprint of the code and weights that decide an episode: 12 hexadecimal digits.

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
    """Runs specifications in a few processes and stores their outcomes in a file, so that nothing is run twice.

    Args:
        file: JSON-lines file; outcomes that it already holds are not run again.
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
                with contextlib.suppress(ValueError):  # the last line of a killed run
                    document = json.loads(line)
                    digest = document.pop("spec")
                    self._known[digest] = Record(**document)
            if text and not text.endswith("\n"):
                with file.open("a", encoding="utf-8") as out:
                    out.write("\n")

    def run(self, specs: Sequence[EpisodeSpec], on_progress: Progress | None = None) -> list[Record]:
        """Return the outcomes of specifications, in their order.

        Args:
            specs: The specifications; only new ones are run.
            on_progress: Called after each run.
        """
        missing = {spec.digest(): spec for spec in specs if spec.digest() not in self._known}
        done = len(specs) - len(missing)
        if missing:
            with single_threaded(), self._file.open("a", encoding="utf-8") as out:
                pool = self._started()
                waiting = {pool.submit(run_record, spec): digest for digest, spec in missing.items()}
                for future in as_completed(waiting):
                    record = future.result()
                    self._known[waiting[future]] = record
                    out.write(json.dumps({"spec": waiting[future], **asdict(record)}) + "\n")
                    out.flush()
                    done += 1
                    if on_progress is not None:
                        on_progress(done, len(specs))
        return [self._known[spec.digest()] for spec in specs]

    def _started(self) -> ProcessPoolExecutor:
        if self._pool is None:
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self._processes, mp_context=context)
        return self._pool

    def close(self) -> None:
        """Stop the processes and drop pending runs."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None


@contextmanager
def single_threaded() -> Iterator[None]:
    """Limit numerical libraries to one thread in processes started within the context."""
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
