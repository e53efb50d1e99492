"""One writer a process: a thread that commits for several waiting requests at once.

Callers submit *units*, functions of a connection. The thread takes all that wait, runs them in one transaction,
commits once and answers each. If a unit fails, the transaction is rolled back and each unit runs again in one of
its own, so that only the faulty one fails: units must therefore depend on nothing but the database and their
arguments. A unit is answered only after its commit.
"""

import itertools
import logging
import queue
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from sqlalchemy import Connection, Engine
from sqlalchemy.exc import DBAPIError, InterfaceError, OperationalError, SQLAlchemyError

from brink.server.errors import Unavailable

T = TypeVar("T")
A = TypeVar("A")
Unit = Callable[[Connection], T]
MAX_UNITS_A_COMMIT = 256
TRIES = 3
ANOTHER_WENT_FIRST = frozenset({"40001", "40P01", "23505"})
"""SQLSTATE of serialization_failure, deadlock_detected, unique_violation: run again, a unit sees what the other
process has written."""
FRESH_S = 1.0
"""A connection that was not used for this long is handed back and asked for anew: the pool looks whether it lives."""
TROUBLE_S = 30.0
"""Failures with a longer pause between them are not the same trouble."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Joint(Generic[A, T]):
    """A unit that is run in one go with others of its kind that wait behind it.

    Attributes:
        run: Takes the arguments of one or more such units, and returns an answer for each.
        argument: This unit's own.
    """

    run: Callable[[Connection, Sequence[A]], Sequence[T]]
    argument: A

    def __call__(self, connection: Connection) -> T:
        """Run it alone."""
        return self.run(connection, [self.argument])[0]


@dataclass(frozen=True, slots=True)
class _Waiting:
    unit: Unit[Any]
    answer: Future[Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Trouble:
    """A database that takes no writes.

    Transactions that change nothing may well go through meanwhile, so what counts is that failures go on.

    Attributes:
        reason: Of the latest failure, in the database's words.
        first_s: Monotonic time of the first failure.
        last_s: Monotonic time of the latest one.
    """

    reason: str
    first_s: float
    last_s: float

    @property
    def span_s(self) -> float:
        """For how long writes have failed."""
        return self.last_s - self.first_s


class Writer:
    """Runs units on the writer engine, many a commit.

    Args:
        engine: Where it writes.
        took: Hears how long each committed transaction took, in seconds.
    """

    def __init__(self, engine: Engine, took: Callable[[float], None] | None = None) -> None:
        self._engine = engine
        self._took = took
        self._waiting: queue.SimpleQueue[_Waiting | None] = queue.SimpleQueue()
        self._closing = False
        self._trouble: Trouble | None = None
        self._connection: Connection | None = None
        self._used_s = 0.0
        # Nothing may slip in behind the end of the queue: nobody would answer it.
        self._door = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="brink-writer", daemon=True)
        self._thread.start()

    @property
    def trouble(self) -> Trouble | None:
        """Why the database takes no writes now, or None if none has failed lately."""
        trouble = self._trouble
        return trouble if trouble is not None and time.monotonic() - trouble.last_s < TROUBLE_S else None

    def submit(self, unit: Unit[T]) -> Future[T]:
        """Have a unit run and committed.

        Returns:
            A future with what the unit returned, or with its error. `Unavailable` if the database is away or the
            writer is closed.
        """
        answer: Future[T] = Future()
        with self._door:
            if not self._closing:
                self._waiting.put(_Waiting(unit, answer))
                return answer
        answer.set_exception(Unavailable("the coordinator is stopping"))
        return answer

    def close(self) -> None:
        """Commit what waits, then stop."""
        with self._door:
            if not self._closing:
                self._closing = True
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
            batch, last = self._take_more(first)
            try:
                self._commit(batch)
            except BaseException as error:
                log.exception("writer: a batch failed outside its units")
                for waiting in batch:
                    if not waiting.answer.done():
                        waiting.answer.set_exception(error)
            if last:
                return

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
        if not batch:
            return
        try:
            with self._transaction() as connection:
                results = _run_all(connection, [waiting.unit for waiting in batch])
        except Exception as error:  # noqa: BLE001  (every unit gets its own answer)
            if len(batch) == 1 and not _another_went_first(error):
                self._fail(batch[0], error)
                return
            for waiting in batch:
                self._commit_alone(waiting)
            return
        for waiting, result in zip(batch, results, strict=True):
            waiting.answer.set_result(result)

    def _commit_alone(self, waiting: _Waiting) -> None:
        for tries_left in reversed(range(TRIES)):
            try:
                with self._transaction() as connection:
                    result = waiting.unit(connection)
            except Exception as error:  # noqa: BLE001  (answered to the one who asked)
                if tries_left and _another_went_first(error):
                    continue
                self._fail(waiting, error)
            else:
                waiting.answer.set_result(result)
            return

    @contextmanager
    def _transaction(self) -> Iterator[Connection]:
        """Give the writer's connection in a transaction; one that broke, or may have meanwhile, is made anew."""
        now = time.monotonic()
        if self._connection is not None and now - self._used_s > FRESH_S:
            self._disconnect()
        if self._connection is None:
            self._connection = self._engine.connect()
        try:
            with self._connection.begin():
                yield self._connection
        except BaseException:
            self._disconnect()
            raise
        self._used_s = time.monotonic()
        if self._took is not None:
            self._took(self._used_s - now)

    def _disconnect(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()

    def _fail(self, waiting: _Waiting, error: Exception) -> None:
        translated = _translated(error)
        if isinstance(error, OperationalError):
            now = time.monotonic()
            before = self.trouble
            self._trouble = Trouble(
                reason=str(translated), first_s=before.first_s if before else now, last_s=now
            )
        waiting.answer.set_exception(translated)


def _run_all(connection: Connection, units: Sequence[Unit[Any]]) -> list[Any]:
    """Run units in their order, neighbours of one kind in one go."""
    results: list[Any] = []
    for run, neighbours in itertools.groupby(units, key=lambda unit: getattr(unit, "run", None)):
        if run is None:
            results += [unit(connection) for unit in neighbours]
        else:
            results += run(connection, [unit.argument for unit in neighbours if isinstance(unit, Joint)])
    return results


def passes(error: DBAPIError) -> bool:
    """Whether the same may work later: the database is away, locked or full, or had another one go first."""
    return error.connection_invalidated or isinstance(error, OperationalError | InterfaceError)


def _another_went_first(error: Exception) -> bool:
    return isinstance(error, DBAPIError) and getattr(error.orig, "sqlstate", None) in ANOTHER_WENT_FIRST


def _translated(error: Exception) -> Exception:
    """Name the database's own troubles in the coordinator's words."""
    if isinstance(error, DBAPIError) and passes(error):
        reason = (
            str(error.orig).strip().splitlines()[0] if str(error.orig).strip() else type(error.orig).__name__
        )
        translated = Unavailable(f"database: {reason}")
        translated.__cause__ = error
        return translated
    if isinstance(error, SQLAlchemyError):
        log.error("writer: %s", error)
    return error
