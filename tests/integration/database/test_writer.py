"""The one writer: many units a commit, each answered for itself, none before its commit."""

import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from typing import Any

import pytest
from sqlalchemy import Connection, event, insert, select, text
from sqlalchemy.exc import DBAPIError, IntegrityError, OperationalError

from brink.server.db.engine import Engines, open_engines
from brink.server.db.models import TraceRow
from brink.server.db.sql import database_now
from brink.server.db.writer import MAX_UNITS_A_COMMIT, TRIES, BatchedUnit, Writer
from brink.server.errors import NotFound, Unavailable

WAIT_S = 30.0


@pytest.fixture
def writer(engines: Engines) -> Iterator[Writer]:
    opened = Writer(engines.writer)
    yield opened
    opened.close()


def writes(name: str) -> Callable[[Connection], str]:
    def unit(connection: Connection) -> str:
        connection.execute(
            insert(TraceRow).values(spec_hash=name, data=b"", created_at=database_now(connection))
        )
        return name

    return unit


def written(engines: Engines) -> set[str]:
    with engines.reader.connect() as connection:
        return set(connection.execute(select(TraceRow.spec_hash)).scalars())


class GoneFirst(Exception):
    """What a driver raises where the database had another transaction go first."""

    sqlstate = "40P01"


class Gate:
    """A unit that keeps the writer busy, so that others gather behind it."""

    def __init__(self) -> None:
        self.entered = threading.Event()
        self.open = threading.Event()

    def __call__(self, connection: Connection) -> None:
        self.entered.set()
        assert self.open.wait(WAIT_S)


def count_commits(engines: Engines) -> list[int]:
    commits = [0]

    @event.listens_for(engines.writer, "commit")
    def count(_: Any) -> None:
        commits[0] += 1

    return commits


def test_units_that_wait_share_one_commit(engines: Engines, writer: Writer) -> None:
    commits, gate = count_commits(engines), Gate()
    first = writer.submit(gate)
    assert gate.entered.wait(WAIT_S)
    answers = [writer.submit(writes(f"unit-{n}")) for n in range(50)]
    gate.open.set()
    assert [answer.result(WAIT_S) for answer in answers] == [f"unit-{n}" for n in range(50)]
    first.result(WAIT_S)
    assert commits[0] == 2
    assert len(written(engines)) == 50


def test_units_gather_until_the_next_transaction_may_begin(engines: Engines, writer: Writer) -> None:
    commits = count_commits(engines)
    writer.spacing_s = 0.5
    writer.submit(writes("first")).result(WAIT_S)
    answers = [writer.submit(writes(f"unit-{n}")) for n in range(3)]
    assert [answer.result(WAIT_S) for answer in answers] == ["unit-0", "unit-1", "unit-2"]
    assert commits[0] == 2


def test_a_full_batch_waits_for_no_more_units(engines: Engines, writer: Writer) -> None:
    gate = Gate()
    writer.submit(gate)
    assert gate.entered.wait(WAIT_S)
    writer.spacing_s = 10 * WAIT_S
    answers = [writer.submit(writes(f"unit-{n}")) for n in range(MAX_UNITS_A_COMMIT + 1)]
    gate.open.set()
    assert [answer.result(WAIT_S) for answer in answers[:MAX_UNITS_A_COMMIT]]
    assert not answers[-1].done()
    writer.close()
    assert answers[-1].result(WAIT_S) == f"unit-{MAX_UNITS_A_COMMIT}", (
        "a writer that ends waits for no more units"
    )


def test_a_failing_unit_fails_alone(engines: Engines, writer: Writer) -> None:
    def fails(connection: Connection) -> None:
        writes("half")(connection)
        raise RuntimeError("no")

    gate = Gate()
    writer.submit(gate)
    assert gate.entered.wait(WAIT_S)
    before, failing, after = (
        writer.submit(writes("before")),
        writer.submit(fails),
        writer.submit(writes("after")),
    )
    gate.open.set()
    assert before.result(WAIT_S) == "before"
    assert after.result(WAIT_S) == "after"
    with pytest.raises(RuntimeError, match="no"):
        failing.result(WAIT_S)
    assert written(engines) == {"before", "after"}


def refuses(connection: Connection) -> None:
    writes("half")(connection)
    raise NotFound("no such campaign")


@pytest.mark.parametrize(("refusals", "commits"), [(1, 2), (2, 2), (3, 6)])
def test_the_others_share_a_commit_where_units_refuse(
    engines: Engines, writer: Writer, refusals: int, commits: int
) -> None:
    counted, gate = count_commits(engines), Gate()
    writer.submit(gate)
    assert gate.entered.wait(WAIT_S)
    answers, refused = [], []
    for number in range(5):
        answers.append(writer.submit(writes(f"unit-{number}")))
        if number < refusals:
            refused.append(writer.submit(refuses))
    gate.open.set()
    assert [answer.result(WAIT_S) for answer in answers] == [f"unit-{number}" for number in range(5)]
    for answer in refused:
        with pytest.raises(NotFound, match="no such campaign"):
            answer.result(WAIT_S)
    assert counted[0] == commits
    assert written(engines) == {f"unit-{number}" for number in range(5)}


def test_a_refusal_costs_no_connection(engines: Engines, writer: Writer) -> None:
    taken = []
    writer.submit(writes("before")).result(WAIT_S)

    @event.listens_for(engines.writer, "checkout")
    def count(*_: Any) -> None:
        taken.append(1)

    with pytest.raises(NotFound):
        writer.submit(refuses).result(WAIT_S)
    writer.submit(writes("after")).result(WAIT_S)
    assert not taken
    assert written(engines) == {"before", "after"}


def test_those_that_share_a_call_run_alone_where_one_of_them_refuses(
    engines: Engines, writer: Writer
) -> None:
    def run(connection: Connection, names: Sequence[str]) -> list[str]:
        if "unknown" in names:
            raise NotFound("no such campaign")
        return [writes(name)(connection) for name in names]

    gate = Gate()
    writer.submit(gate)
    assert gate.entered.wait(WAIT_S)
    other = writer.submit(writes("other"))
    answers = [writer.submit(BatchedUnit(run, name)) for name in ("one", "unknown", "two")]
    gate.open.set()
    assert other.result(WAIT_S) == "other"
    assert [answers[place].result(WAIT_S) for place in (0, 2)] == ["one", "two"]
    with pytest.raises(NotFound):
        answers[1].result(WAIT_S)
    assert written(engines) == {"other", "one", "two"}


def test_a_statement_that_the_database_refuses_fails_alone(engines: Engines, writer: Writer) -> None:
    gate = Gate()
    writer.submit(gate)
    assert gate.entered.wait(WAIT_S)
    answers = [writer.submit(writes(name)) for name in ("one", "two", "one")]
    gate.open.set()
    assert [answer.result(WAIT_S) for answer in answers[:2]] == ["one", "two"]
    with pytest.raises(IntegrityError):
        answers[2].result(WAIT_S)
    assert written(engines) == {"one", "two"}


def test_a_unit_runs_again_where_another_process_went_first(engines: Engines, writer: Writer) -> None:
    runs = []

    def beaten_once(connection: Connection) -> str:
        runs.append(1)
        if len(runs) == 1:
            raise DBAPIError("INSERT", {}, GoneFirst("deadlock detected"))
        return writes("second try")(connection)

    assert writer.submit(beaten_once).result(WAIT_S) == "second try"
    assert written(engines) == {"second try"}


def test_a_unit_that_is_always_beaten_ends(engines: Engines, writer: Writer) -> None:
    runs = []

    def beaten(_: Connection) -> None:
        runs.append(1)
        raise DBAPIError("INSERT", {}, GoneFirst("deadlock detected"))

    with pytest.raises(DBAPIError, match="deadlock"):
        writer.submit(beaten).result(WAIT_S)
    assert len(runs) == 1 + TRIES


def test_an_answer_comes_after_the_commit(engines: Engines, writer: Writer) -> None:
    seen: list[set[str]] = []
    answer = writer.submit(writes("done"))
    answer.add_done_callback(lambda _: seen.append(written(engines)))
    answer.result(WAIT_S)
    writer.submit(lambda _: None).result(WAIT_S)  # the callback ran before the writer went on
    assert seen == [{"done"}]


def test_a_commit_that_fails_is_told_to_everybody(engines: Engines, writer: Writer) -> None:
    def fail(_: Any) -> None:
        raise OperationalError("COMMIT", {}, Exception("disk full"))

    event.listen(engines.writer, "commit", fail)
    answers = [writer.submit(writes(name)) for name in ("one", "two")]
    for answer in answers:
        with pytest.raises(Unavailable, match="disk full"):
            answer.result(WAIT_S)
    event.remove(engines.writer, "commit", fail)
    assert written(engines) == set()
    assert writer.submit(writes("three")).result(WAIT_S) == "three"


def test_no_units_are_taken_while_the_database_does_not_answer(
    engines: Engines, writer: Writer, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = Gate()
    answer = writer.submit(gate)
    assert gate.entered.wait(WAIT_S)
    waits = writer.submit(writes("waits"))
    with monkeypatch.context() as patched:
        patched.setattr("brink.server.db.writer.STUCK_S", 0.0)
        with pytest.raises(Unavailable, match="no answer to earlier writes"):
            writer.submit(writes("refused")).result(0)
        assert writer.trouble is not None
    gate.open.set()
    answer.result(WAIT_S)
    waits.result(WAIT_S)
    writer.submit(writes("taken again")).result(WAIT_S)
    assert written(engines) == {"waits", "taken again"}


def test_a_cancelled_unit_does_not_run(engines: Engines, writer: Writer) -> None:
    gate = Gate()
    writer.submit(gate)
    assert gate.entered.wait(WAIT_S)
    answer = writer.submit(writes("cancelled"))
    assert answer.cancel()
    gate.open.set()
    writer.submit(lambda _: None).result(WAIT_S)
    assert written(engines) == set()


def test_closing_commits_what_waits(engines: Engines) -> None:
    writer, gate = Writer(engines.writer), Gate()
    writer.submit(gate)
    assert gate.entered.wait(WAIT_S)
    answers = [writer.submit(writes(f"unit-{n}")) for n in range(300)]  # more than one commit takes
    closing = threading.Thread(target=writer.close)
    closing.start()
    gate.open.set()
    closing.join(WAIT_S)
    assert not closing.is_alive()
    assert {answer.result(0) for answer in answers} == written(engines)
    assert len(answers) == len(written(engines))


def test_a_closed_writer_takes_nothing_more(engines: Engines) -> None:
    writer = Writer(engines.writer)
    writer.close()
    with pytest.raises(Unavailable, match="stopping"):
        writer.submit(writes("late")).result(0)


def submit_at(begin: threading.Barrier, writer: Writer, answers: list[Future[int]]) -> None:
    begin.wait(WAIT_S)
    answers.extend(writer.submit(lambda c: c.execute(text("SELECT 1")).scalar_one()) for _ in range(20))


def test_every_unit_is_answered_however_close_to_the_end_it_comes(engines: Engines) -> None:
    for _ in range(20):
        writer, begin = Writer(engines.writer), threading.Barrier(2)
        answers: list[Future[int]] = []
        thread = threading.Thread(target=submit_at, args=(begin, writer, answers))
        thread.start()
        begin.wait(WAIT_S)
        writer.close()
        thread.join(WAIT_S)
        assert len(answers) == 20
        for answer in answers:
            assert answer.exception(WAIT_S) is None or isinstance(answer.exception(0), Unavailable)


def test_a_database_that_is_away_is_unavailable() -> None:
    engines = open_engines("postgresql://nobody@127.0.0.1:1/nothing")
    writer = Writer(engines.writer)
    with pytest.raises(Unavailable, match="database"):
        writer.submit(lambda _: None).result(WAIT_S)
    writer.close()
    engines.dispose()
