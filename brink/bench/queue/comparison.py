"""All queues in one run, on one machine, with the same durability."""

import contextlib
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Protocol, TypeAlias

from brink.bench.queue.brink import BrinkQueue
from brink.bench.queue.figures import BATCHES, WORKERS, Pickup, Throughput, medians, together
from brink.bench.telling import Told
from brink.bench.temporary.postgres import DURABLE, temporary_postgres
from brink.bench.temporary.redis import NoRedis, find_redis, temporary_redis

SQLITE, POSTGRES = "Brink, SQLite", "Brink, Postgres"
PROCRASTINATE, CELERY = "procrastinate, Postgres", "Celery, Redis"
SETTINGS = {
    SQLITE: "journal_mode WAL, synchronous FULL",
    POSTGRES: ", ".join(f"{name} {value}" for name, value in DURABLE.items()),
}
_Measured: TypeAlias = tuple[list[Throughput], list[Pickup]]
TARGET_BATCH = 8
TARGET_TIMES = 5.0
TARGET_PICKUP_MS = 10.0


class OtherQueue(Protocol):
    """A queue that Brink's is measured beside."""

    name: str

    def throughput(self, workers: int, jobs: int) -> Throughput:
        """Measure how many jobs go through so many workers."""

    def pickup(self) -> list[Pickup]:
        """Measure how soon an idle worker starts a job."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """What was measured.

    Attributes:
        throughput: Jobs a second.
        pickups: How soon idle workers start.
        settings: What makes each system durable.
        left_out: Systems that are not here, and why.
    """

    throughput: tuple[Throughput, ...]
    pickups: tuple[Pickup, ...]
    settings: dict[str, str]
    left_out: dict[str, str]

    def ratios(self) -> list[tuple[Throughput, Throughput, float]]:
        """Return, for each database and number of workers: ours at the target's batch, the best other, the ratio."""
        others = [one for one in self.throughput if not one.system.startswith("Brink")]
        found = []
        for ours in self.throughput:
            rivals = [other for other in others if other.workers == ours.workers]
            if ours.system in (SQLITE, POSTGRES) and ours.batch == TARGET_BATCH and rivals:
                best = max(rivals, key=lambda other: other.per_s)
                found.append((ours, best, ours.per_s / best.per_s))
        return found


def compare_queues(told: Told, *, jobs: int = 4_000, rounds: int = 3, quick: bool = False) -> Comparison:
    """Measure Brink on SQLite and Postgres, and Celery and procrastinate where they are installed.

    All of it in rounds, one system after the other in each: a machine that is slower for a minute is so for all of
    them, and the median of the rounds is kept.

    Args:
        told: Hears how far it is.
        jobs: Jobs of Brink's at the largest batches; the others and small batches get fewer.
        rounds: How often everything is measured.
        quick: Only one batch and one number of workers, for a look.

    Raises:
        NoPostgres: There is none.
        DidNotStart: A process did not come up.
    """
    left_out = {name: reason for name, reason in _absent().items() if reason}
    settings = dict(SETTINGS)
    throughput: list[Throughput] = []
    pickups: list[Pickup] = []
    plan = _Plan(
        numbers=(4,) if quick else WORKERS,
        batches=(TARGET_BATCH,) if quick else BATCHES,
        jobs=jobs,
        quick=quick,
    )
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="brink-bench-")))
        server = stack.enter_context(temporary_postgres())
        measures: list[Callable[[int], _Measured]] = [
            lambda turn: _of_brink(SQLITE, f"sqlite:///{folder}/queue-{turn}.db", folder, plan),
            lambda turn: _of_brink(POSTGRES, server.database(f"brink_{turn}"), folder, plan),
        ]
        if PROCRASTINATE not in left_out:
            from brink.bench.queue import procrastinate_postgres

            settings[PROCRASTINATE] = procrastinate_postgres.SETTINGS
            procrastinate = procrastinate_postgres.ProcrastinateQueue(
                server.database("procrastinate"), folder
            )
            measures.append(lambda _: _of_other(procrastinate, plan))
        if CELERY not in left_out:
            from brink.bench.queue import celery_redis

            settings[CELERY] = celery_redis.SETTINGS
            celery = celery_redis.CeleryQueue(stack.enter_context(temporary_redis()), folder)
            measures.append(lambda _: _of_other(celery, plan))
        total = rounds * len(measures)
        for place in range(total):
            told("measurements", place, total)
            turn, which = divmod(place, len(measures))
            jobs_a_second, soon = measures[which](turn)
            throughput += jobs_a_second
            pickups += soon
        told("measurements", total, total)
    return Comparison(
        throughput=tuple(medians(throughput)), pickups=tuple(together(pickups)), settings=settings,
        left_out=left_out,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class _Plan:
    """What is measured of each system."""

    numbers: tuple[int, ...]
    batches: tuple[int, ...]
    jobs: int
    quick: bool

    @property
    def few(self) -> int:
        """Jobs where each takes long."""
        return max(200, self.jobs // 3)


def _of_brink(system: str, database: str, folder: Path, plan: _Plan) -> _Measured:
    throughput: list[Throughput] = []
    with BrinkQueue(system, database, folder) as queue:
        pickups = queue.pickup()
        for workers in plan.numbers:
            throughput += [
                queue.throughput(workers, batch, plan.jobs if batch > 1 else plan.few)
                for batch in plan.batches
            ]
            if not plan.quick:
                throughput.append(queue.worker_throughput(workers, plan.few))
    return throughput, pickups


def _of_other(queue: OtherQueue, plan: _Plan) -> _Measured:
    return [queue.throughput(workers, plan.few) for workers in plan.numbers], queue.pickup()


def _absent() -> dict[str, str]:
    """Return why the other systems cannot be measured here; nothing where they can."""
    return {
        PROCRASTINATE: "" if find_spec("procrastinate") else "pip install 'brink[bench]'",
        CELERY: _no_celery(),
    }


def _no_celery() -> str:
    """Return why Celery cannot be measured here, or nothing."""
    if find_spec("celery") is None:
        return "pip install 'brink[bench]'"
    try:
        find_redis()
    except NoRedis as error:
        return str(error)
    return ""
