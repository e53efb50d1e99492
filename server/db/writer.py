"""The writer: one thread for each process, which commits several waiting units at once.

Callers submit *units*, functions of a connection. The thread runs all waiting units in one transaction and resolves
their futures after the commit. If a unit fails, the transaction is rolled back. If it refused what it was asked, as
with an unknown id, the others run again together, and it runs alone. After the third refusal, or any other error,
each unit runs again in a transaction of its own. So only the faulty one fails. Units must therefore depend on nothing
but the database and their arguments.
"""

import asyncio
import itertools
import logging
import queue
import threading
import time
from collections.abc import Awaitable, Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from sqlalchemy import Connection, Engine
from sqlalchemy.exc import DBAPIError, InterfaceError, OperationalError, SQLAlchemyError

from brink.server.errors import Conflict, InvalidInput, NotFound, Unavailable

T = TypeVar("T")
A = TypeVar("A")
Unit = Callable[[Connection], T]
MAX_UNITS_A_COMMIT = 256
TRIES = 3
REFUSALS = (Conflict, InvalidInput, NotFound)
"""Errors by which a unit refuses its request; the connection is fine."""
GROUP_TRIES = 3
"""How often a batch is run together, each time without the unit that refused before."""
CONFLICTS = frozenset({"40001", "40P01", "23505", "26000"})
"""SQLSTATE of errors after which the unit is run again. After serialization_failure, deadlock_detected and
unique_violation, it sees what another process wrote first; after invalid_sql_statement_name, because a connection
pooler dropped a prepared statement, it prepares that again."""
LOCKED = "55P03"
"""SQLSTATE of lock_not_available: another coordinator holds a row for too long."""
FRESH_S = 1.0
"""A connection idle for longer is returned to the pool, which tests it before handing it out again."""
STUCK_S = 10.0
"""If a unit has waited for longer, the database does not answer, and no more units are taken: each waiting one keeps
its request, and its worker soon sends another."""
TROUBLE_S = 30.0
"""Failures further apart than this belong to separate periods."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class BatchedUnit(Generic[A, T]):
    """A unit that is executed together with adjacent waiting units of the same kind.

    Attributes:
        run: Takes the arguments of one or more such units and returns a result for each.
        argument: The argument of this unit.
    """

    run: Callable[[Connection, Sequence[A]], Sequence[T]]
    argument: A

    def __call__(self, connection: Connection) -> T:
        """Run this unit alone."""
        return self.run(connection, [self.argument])[0]


@dataclass(frozen=True, slots=True)
class _Waiting:
    unit: Unit[Any]
    answer: Future[Any]
    since_s: float


class _Refusal(Exception):
    """A unit of a batch, or one of several that share a call, refused its request.

    Args:
        units: Place of the unit, or of those that share the call, in the batch.
    """

    def __init__(self, units: slice) -> None:
        super().__init__()
        self.units = units


@dataclass(frozen=True, slots=True, kw_only=True)
class Trouble:
    """A period in which the database rejects writes.

    It does not end with a successful transaction, since that one may have changed nothing, but when failures stop.

    Attributes:
        reason: The latest error message of the database.
        first_s: Monotonic time of the first failure, in seconds.
        last_s: Monotonic time of the latest failure, in seconds.
    """

    reason: str
    first_s: float
    last_s: float

    @property
    def span_s(self) -> float:
        """Time from the first to the latest failure, in seconds."""
        return self.last_s - self.first_s


class Writer:
    """Runs units on the writer engine, several in each commit.

    Args:
        engine: The writer engine of the database.
        on_commit: Called with the duration of each committed transaction, in seconds.

    Attributes:
        spacing_s: Shortest time between the beginnings of two transactions, in seconds, unless a full batch waits.
            Every transaction has fixed costs, so a busy coordinator saves time if more units share each of them.
    """

    def __init__(self, engine: Engine, on_commit: Callable[[float], None] | None = None) -> None:
        self._engine = engine
        self._on_commit = on_commit
        self._waiting: queue.SimpleQueue[_Waiting | None] = queue.SimpleQueue()
        self._closing = threading.Event()
        self._trouble: Trouble | None = None
        self._connection: Connection | None = None
        self._used_s = 0.0
        self._began_s = 0.0
        self._oldest_s: float | None = None
        self.spacing_s = 0.0
        # Guards the end of the queue: a unit submitted after the closing mark would never be resolved.
        self._closing_lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="brink-writer", daemon=True)
        self._thread.start()

    @property
    def trouble(self) -> Trouble | None:
        """The current write failure, or None if no write failed recently."""
        trouble = self._trouble
        return trouble if trouble is not None and time.monotonic() - trouble.last_s < TROUBLE_S else None

    def submit(self, unit: Unit[T]) -> Future[T]:
        """Queue a unit to be run and committed.

        Returns:
            A future for the unit's result or error. The error is `Unavailable` if the database is unavailable
            or does not answer, or the writer is closed.
        """
        answer: Future[T] = Future()
        now, oldest_s = time.monotonic(), self._oldest_s
        if oldest_s is not None and now - oldest_s > STUCK_S:
            reason = "database: no answer to earlier writes"
            self._note_trouble(reason)
            answer.set_exception(Unavailable(reason))
            return answer
        with self._closing_lock:
            if not self._closing.is_set():
                self._waiting.put(_Waiting(unit, answer, now))
                return answer
        answer.set_exception(Unavailable("the coordinator is stopping"))
        return answer

    def write(self, unit: Unit[T]) -> Awaitable[T]:
        """Queue a unit, and return an awaitable for its committed result."""
        return asyncio.wrap_future(self.submit(unit))

    def close(self) -> None:
        """Commit the waiting units, then stop the thread."""
        with self._closing_lock:
            if not self._closing.is_set():
                self._closing.set()
                self._waiting.put(None)
        self._thread.join()

    def _run(self) -> None:
        try:
            self._serve()
        finally:
            self._disconnect()

    def _serve(self) -> None:
        while True:
            first = self._waiting.get()
            if first is None:
                return
            self._oldest_s = first.since_s
            self._let_units_gather()
            batch, last = self._take_more(first)
            try:
                self._commit(batch)
            except BaseException as error:
                log.exception("writer: a batch failed outside its units")
                for waiting in batch:
                    if not waiting.answer.done():
                        waiting.answer.set_exception(error)
            self._oldest_s = None
            if last:
                return

    def _let_units_gather(self) -> None:
        """Wait until the next transaction may begin."""
        left_s = self._began_s + self.spacing_s - time.monotonic()
        if left_s > 0 and self._waiting.qsize() < MAX_UNITS_A_COMMIT:
            self._closing.wait(left_s)
        self._began_s = time.monotonic()

    def _take_more(self, first: _Waiting) -> tuple[list[_Waiting], bool]:
        batch = [first]
        while len(batch) < MAX_UNITS_A_COMMIT:
            try:
                waiting = self._waiting.get_nowait()
            except queue.Empty:
                break
            if waiting is None:
                return batch, True
            batch.append(waiting)
        return batch, False

    def _commit(self, batch: list[_Waiting]) -> None:
        batch = [waiting for waiting in batch if waiting.answer.set_running_or_notify_cancel()]
        tries = TRIES if len(batch) > 1 else 1 + TRIES
        refused: list[_Waiting] = []
        for _ in range(GROUP_TRIES):
            if len(batch) <= 1:
                break
            try:
                with self._transaction() as connection:
                    results = _run_all(connection, [waiting.unit for waiting in batch])
            except _Refusal as refusal:
                refused += batch[refusal.units]
                del batch[refusal.units]
            except Exception:  # noqa: BLE001  (each unit gets its own error)
                break
            else:
                for waiting, result in zip(batch, results, strict=True):
                    waiting.answer.set_result(result)
                batch = []
        for waiting in batch + refused:
            self._commit_alone(waiting, tries)

    def _commit_alone(self, waiting: _Waiting, tries: int) -> None:
        for tries_left in reversed(range(tries)):
            try:
                with self._transaction() as connection:
                    result = waiting.unit(connection)
            except Exception as error:  # noqa: BLE001  (passed on to the caller)
                if tries_left and _is_conflict(error):
                    continue
                self._fail(waiting, error)
            else:
                waiting.answer.set_result(result)
            return

    @contextmanager
    def _transaction(self) -> Iterator[Connection]:
        """Yield the connection in a transaction, reconnecting after an error or a long pause."""
        now = time.monotonic()
        if self._connection is not None and now - self._used_s > FRESH_S:
            self._disconnect()
        if self._connection is None:
            self._connection = self._engine.connect()
        try:
            with self._connection.begin():
                yield self._connection
        except (*REFUSALS, _Refusal):
            raise  # rolled back, and the connection is fine
        except BaseException:
            self._disconnect()
            raise
        self._used_s = time.monotonic()
        if self._on_commit is not None:
            self._on_commit(self._used_s - now)

    def _disconnect(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()

    def _fail(self, waiting: _Waiting, error: Exception) -> None:
        translated = _translated(error)
        if isinstance(error, OperationalError) and _sqlstate(error) != LOCKED:
            self._note_trouble(str(translated))
        waiting.answer.set_exception(translated)

    def _note_trouble(self, reason: str) -> None:
        now, before = time.monotonic(), self.trouble
        self._trouble = Trouble(reason=reason, first_s=before.first_s if before else now, last_s=now)


def _run_all(connection: Connection, units: Sequence[Unit[Any]]) -> list[Any]:
    """Run units in order; adjacent batched units of the same kind share one call.

    Raises:
        _Refusal: A unit refused; others may have run.
    """
    results: list[Any] = []
    for run, group in itertools.groupby(units, key=lambda unit: getattr(unit, "run", None)):
        neighbours = list(group)
        size = 1 if run is None else len(neighbours)
        try:
            if run is None:
                for unit in neighbours:
                    results.append(unit(connection))  # noqa: PERF401  (those before a refusal count)
            else:
                results += run(
                    connection, [unit.argument for unit in neighbours if isinstance(unit, BatchedUnit)]
                )
        except REFUSALS as error:
            raise _Refusal(slice(len(results), len(results) + size)) from error
    return results


def is_transient(error: DBAPIError) -> bool:
    """Return whether the same statement may succeed later: the database is unavailable, locked or full."""
    return error.connection_invalidated or isinstance(error, OperationalError | InterfaceError)


def _is_conflict(error: Exception) -> bool:
    return isinstance(error, DBAPIError) and _sqlstate(error) in CONFLICTS


def _sqlstate(error: DBAPIError) -> str | None:
    found: str | None = getattr(error.orig, "sqlstate", None)
    return found


def _translated(error: Exception) -> Exception:
    """Return a transient database error as `Unavailable`, and any other error unchanged."""
    if isinstance(error, DBAPIError) and is_transient(error):
        reason = (
            str(error.orig).strip().splitlines()[0] if str(error.orig).strip() else type(error.orig).__name__
        )
        translated = Unavailable(f"database: {reason}")
        translated.__cause__ = error
        return translated
    if isinstance(error, SQLAlchemyError):
        log.error("writer: %s", error)
    return error
