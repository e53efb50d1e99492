"""All queues in one run, on one machine, with the same durability."""

import tempfile
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from server.bench.queue.brink import BrinkQueue
from server.bench.queue.figures import BATCHES, WORKERS, Pickup, Throughput
from server.bench.telling import Told
from server.bench.temporary.postgres import DURABLE, temporary_postgres
from server.bench.temporary.redis import NoRedis, find_redis, temporary_redis

SQLITE, POSTGRES = "Brink, SQLite", "Brink, Postgres"
SETTINGS = {
    SQLITE: "journal_mode WAL, synchronous FULL",
    POSTGRES: ", ".join(f"{name} {value}" for name, value in DURABLE.items()),
}
TARGET_BATCH = 8
TARGET_TIMES = 5.0
TARGET_PICKUP_MS = 10.0


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


def compare_queues(told: Told, *, jobs: int = 10_000, quick: bool = False) -> Comparison:
    """Measure Brink on SQLite and Postgres, and Celery and procrastinate where they are installed.

    Args:
        told: Hears how far it is.
        jobs: Jobs of Brink's at the largest batches; the others and small batches get fewer.
        quick: Only one batch and one number of workers, for a look.

    Raises:
        NoPostgres: There is none.
        DidNotStart: A process did not come up.
    """
    throughput: list[Throughput] = []
    pickups: list[Pickup] = []
    settings = dict(SETTINGS)
    left_out: dict[str, str] = {}
    numbers = (4,) if quick else WORKERS
    batches = (TARGET_BATCH,) if quick else BATCHES
    few = max(200, jobs // 5)
    with tempfile.TemporaryDirectory(prefix="brink-bench-") as name, temporary_postgres() as server:
        folder = Path(name)
        for system, database in (
            (SQLITE, f"sqlite:///{folder}/queue.db"),
            (POSTGRES, server.database("brink")),
        ):
            with BrinkQueue(system, database, folder) as queue:
                told(system, 0, len(numbers) + 1)
                pickups += queue.pickup()
                for place, workers in enumerate(numbers, start=1):
                    told(system, place, len(numbers) + 1)
                    throughput += [
                        queue.throughput(workers, batch, jobs if batch > 1 else few) for batch in batches
                    ]
                    if not quick:
                        throughput.append(queue.worker_throughput(workers, few))
                told(system, len(numbers) + 1, len(numbers) + 1)
        if find_spec("procrastinate") is None:
            left_out["procrastinate, Postgres"] = "pip install 'brink[bench]'"
        else:
            from server.bench.queue import procrastinate_postgres

            other = procrastinate_postgres.ProcrastinateQueue(server.database("procrastinate"), folder)
            settings[other.name] = procrastinate_postgres.SETTINGS
            for place, workers in enumerate(numbers):
                told(other.name, place, len(numbers))
                throughput.append(other.throughput(workers, few))
            pickups += other.pickup()
        if reason := _no_celery():
            left_out["Celery, Redis"] = reason
        else:
            with temporary_redis() as url:
                from server.bench.queue import celery_redis

                celery = celery_redis.CeleryQueue(url, folder)
                settings[celery.name] = celery_redis.SETTINGS
                for place, workers in enumerate(numbers):
                    told(celery.name, place, len(numbers))
                    throughput.append(celery.throughput(workers, few))
                pickups += celery.pickup()
    return Comparison(
        throughput=tuple(throughput), pickups=tuple(pickups), settings=settings, left_out=left_out
    )


def _no_celery() -> str:
    """Return why Celery cannot be measured here, or nothing."""
    if find_spec("celery") is None:
        return "pip install 'brink[bench]'"
    try:
        find_redis()
    except NoRedis as error:
        return str(error)
    return ""
