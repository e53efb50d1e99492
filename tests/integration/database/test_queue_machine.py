"""The queue against a small model in memory: whatever is done in whatever order, both are in the same state."""

from collections.abc import Iterator
from pathlib import Path
from shutil import copyfile

import pytest
from support.queue_faults import FAULTS, HISTORIES, NOTICED, RARE, injected, recorded
from support.queue_machine import replay, search

from brink.server.db.engine import Engines, open_engines

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def sqlite_engines(sqlite_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Engines]:
    """The engines of a SQLite database for all tests of faults, which empty it first."""
    engines = open_engines(
        f"sqlite:///{copyfile(sqlite_file, tmp_path_factory.mktemp('queue') / 'queue.db')}"
    )
    yield engines
    engines.dispose()


@pytest.mark.parametrize("histories", [4, pytest.param(120, marks=pytest.mark.long("tries many histories"))])
def test_queue_agrees_with_its_model(engines: Engines, histories: int) -> None:
    search(engines, histories=histories)


def test_recorded_histories_reveal_nothing_without_a_fault(engines: Engines) -> None:
    assert set(recorded()) == set(FAULTS), "record them again: python -m support.queue_faults"
    for history in recorded().values():
        replay(engines, history)


@pytest.mark.parametrize("name", FAULTS)
def test_recorded_history_reveals_its_fault(sqlite_engines: Engines, name: str) -> None:
    with injected(FAULTS[name]), pytest.raises(NOTICED):
        replay(sqlite_engines, recorded()[name])


@pytest.mark.long("searches for histories that reveal faults; recorded ones reveal each of them every time")
@pytest.mark.parametrize("name", [name for name in FAULTS if name not in RARE][::3])
def test_search_reveals_faults_that_are_not_rare(sqlite_engines: Engines, name: str) -> None:
    with injected(FAULTS[name]), pytest.raises(NOTICED):
        search(sqlite_engines, histories=HISTORIES, shrink=False)
