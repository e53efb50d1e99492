"""What is broken on purpose: coordinators, workers, their episode processes, the database and its connections."""

import asyncio
import os
import random
import signal
import sys
from collections import Counter
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from contextlib import suppress
from pathlib import Path

import psycopg
from sqlalchemy.engine import make_url

from brink.bench.processes import children_of
from brink.bench.temporary.coordinator import CoordinatorProcess, Process
from brink.bench.temporary.postgres import TemporaryPostgres

COORDINATORS = 2
WORKERS = 4
PAUSE_S = (1.0, 6.0)
"""How long a process stands still; leases hold for less than the longest."""
DOWN_S = (0.0, 3.0)
"""How long a killed process is away."""
CLOCKS = ((7200.0, 0.4), (0.0, 1.0), (-86400.0, 1.0), (0.0, 1.0))
"""Of each worker: by how much its time of day is ahead, and how fast its monotonic clock goes."""


class Site:
    """Two coordinators and four workers on one Postgres; one worker's clocks are wrong, another's day.

    Args:
        server: The Postgres.
        database: URL of the database on it.
        folder: For logs.
        env: Environment of coordinators and workers.
        rng: Decides.
    """

    def __init__(
        self,
        server: TemporaryPostgres,
        database: str,
        folder: Path,
        env: Mapping[str, str],
        rng: random.Random,
    ) -> None:
        self.faults: Counter[str] = Counter()
        self.own_ends: list[str] = []
        self.folder = folder
        self.coordinators = [
            CoordinatorProcess(database, folder / f"coordinator-{index}.log", env)
            for index in range(COORDINATORS)
        ]
        self.workers: list[Process] = []
        self._server = server
        self.database = database
        self._env = dict(env)
        self._rng = rng
        self._away: set[Process] = set()
        self._restarts: set[asyncio.Task[None]] = set()
        self._breaks: dict[str, tuple[int, Callable[[], Awaitable[bool]]]] = {
            "coordinator killed": (3, lambda: self._kill(self.coordinators, signal.SIGKILL)),
            "coordinator told to stop": (1, lambda: self._kill(self.coordinators, signal.SIGTERM)),
            "coordinator stands still": (3, lambda: self._halt(self.coordinators)),
            "worker killed": (4, lambda: self._kill(self.workers, signal.SIGKILL)),
            "worker told to stop": (2, lambda: self._kill(self.workers, signal.SIGTERM)),
            "worker stands still": (3, lambda: self._halt(self.workers)),
            "episode process killed": (6, self._kill_episode),
            "database connection cut": (6, lambda: self._cut(1)),
            "all database connections cut": (2, lambda: self._cut(None)),
            "database crashed": (1, self._crash_database),
        }

    def start(self, proxy_url: str) -> None:
        """Start all."""
        for index in range(WORKERS):
            ahead_s, rate = CLOCKS[index]
            options = ("--server", proxy_url, "--wait", "5", "--grace", "3", "--memory", "0")
            wrong = (ahead_s, rate) != (0.0, 1.0)
            clock = ["brink.bench.chaos.wrong_clock", str(ahead_s), str(rate)]
            command = [sys.executable, "-m", *(clock if wrong else ["brink.worker"]), *options]
            self.workers.append(Process(command, self.folder / f"worker-{index}.log", self._env))
        for process in (*self.coordinators, *self.workers):
            process.start()

    def stop(self) -> None:
        """Stop all."""
        for process in (*self.workers, *self.coordinators):
            process.kill()

    async def break_something(self) -> None:
        """Break one thing, chosen by chance; it is mended soon."""
        names = list(self._breaks)
        (name,) = self._rng.choices(names, weights=[self._breaks[n][0] for n in names])
        self.faults[name] += await self._breaks[name][1]()

    def revive(self) -> None:
        """Start again what ended by itself."""
        for kind, processes in (("coordinator", self.coordinators), ("worker", self.workers)):
            for process in processes:
                if not process.alive and process not in self._away:
                    self.own_ends.append(f"{kind}, exit {process.exit_status}: {process.last_words}")
                    process.start()

    async def mend(self) -> None:
        """Wait until all that was broken is mended."""
        await asyncio.gather(*self._restarts)

    def _later(self, restart: Callable[[], Coroutine[None, None, None]]) -> None:
        task = asyncio.create_task(restart())
        self._restarts.add(task)
        task.add_done_callback(self._restarts.discard)

    def _one_of(self, processes: "list[CoordinatorProcess] | list[Process]") -> Process | None:
        up = [process for process in processes if process.alive and process not in self._away]
        return self._rng.choice(up) if up else None

    async def _kill(
        self, processes: "list[CoordinatorProcess] | list[Process]", number: signal.Signals
    ) -> bool:
        process = self._one_of(processes)
        if process is None:
            return False
        self._away.add(process)
        down_s = self._rng.uniform(*DOWN_S)

        async def restart() -> None:
            if number is signal.SIGTERM:
                await asyncio.to_thread(process.stop)
            else:
                await asyncio.to_thread(process.kill)
            await asyncio.sleep(down_s)
            process.start()
            self._away.discard(process)

        self._later(restart)
        return True

    async def _halt(self, processes: "list[CoordinatorProcess] | list[Process]") -> bool:
        process = self._one_of(processes)
        if process is None:
            return False
        self._away.add(process)
        process.signal(signal.SIGSTOP)
        still_s = self._rng.uniform(*PAUSE_S)

        async def go_on() -> None:
            await asyncio.sleep(still_s)
            process.signal(signal.SIGCONT)
            self._away.discard(process)

        self._later(go_on)
        return True

    async def _kill_episode(self) -> bool:
        worker = self._one_of(self.workers)
        children = children_of(worker.pid) if worker is not None and worker.pid is not None else []
        for child in children:
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
        return bool(children)

    async def _cut(self, most: int | None) -> bool:
        def cut() -> bool:
            with psycopg.connect(self._server.url, autocommit=True, connect_timeout=5) as connection:
                query = "SELECT pid FROM pg_stat_activity WHERE datname = %s"
                rows = connection.execute(query, [make_url(self.database).database]).fetchall()
                pids = [pid for (pid,) in rows]
                chosen = pids if most is None else self._rng.sample(pids, min(most, len(pids)))
                for pid in chosen:
                    connection.execute("SELECT pg_terminate_backend(%s)", [pid])
                return bool(chosen)

        return await asyncio.to_thread(cut)

    async def _crash_database(self) -> bool:
        def crash() -> None:
            self._server.stop()
            self._server.start()

        await asyncio.to_thread(crash)
        return True
