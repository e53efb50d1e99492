"""Fixtures of all tests: a database of one's own on SQLite and on a real Postgres."""

import os
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from hypothesis import settings
from support import problems
from support.api import coordinator
from support.databases import BACKENDS, Databases, sqlite_template
from support.llm_endpoint import Endpoint, serving
from support.postgres import PostgresDatabases, running_postgres
from support.queue import Queue
from support.scheduling import ByFolder
from support.scratch import use_memory
from xdist.remote import Producer

from brink.bench.temporary.postgres import NoPostgres
from brink.server.db.engine import Engines, open_engines

# A check that everybody must pass tries the same examples each time; people's own runs go on looking for new ones.
settings.register_profile("ci", derandomize=True, deadline=None)
if os.environ.get("CI"):
    settings.load_profile("ci")

use_memory()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> ByFolder | None:
    """Have `--dist loadfile` distribute tests as `support.scheduling` says."""
    return ByFolder(config, log) if config.getoption("dist") == "loadfile" else None


@pytest.fixture(scope="session")
def postgres_databases() -> Iterator[PostgresDatabases]:
    """A Postgres server for the session; where none can be had, the tests that need one fail and say why."""
    try:
        with running_postgres() as url:
            databases = PostgresDatabases(url)
            yield databases
            databases.close()
    except NoPostgres as error:
        pytest.fail(str(error), pytrace=False)


@pytest.fixture(scope="session")
def sqlite_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A migrated SQLite file, to be copied."""
    return sqlite_template(tmp_path_factory.mktemp("sqlite"))


def databases_in(folder: Path, request: pytest.FixtureRequest) -> Databases:
    backend: str = request.param
    postgres = request.getfixturevalue("postgres_databases") if backend == "postgres" else None
    template = request.getfixturevalue("sqlite_file")
    return Databases(backend=backend, template=template, folder=folder, postgres=postgres)


@pytest.fixture(params=BACKENDS)
def databases(request: pytest.FixtureRequest, tmp_path: Path) -> Databases:
    """Databases of one kind: a test that uses them runs on SQLite and on Postgres."""
    return databases_in(tmp_path, request)


@pytest.fixture(scope="module", params=BACKENDS)
def databases_of_file(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Databases:
    """Databases of one kind for all tests of a file, which then runs on SQLite and on Postgres."""
    return databases_in(tmp_path_factory.mktemp("databases"), request)


@pytest.fixture
def database_url(databases: Databases) -> Iterator[str]:
    """The URL of a migrated database of the test's own."""
    with databases.database() as url:
        yield url


@pytest.fixture
def engines(database_url: str) -> Iterator[Engines]:
    """The engines of a migrated database of the test's own."""
    opened = open_engines(database_url)
    yield opened
    opened.dispose()


@pytest.fixture
def small_problems() -> Iterator[None]:
    """Register ``ball@1`` and ``line@1`` for the length of a test."""
    with problems.small_problems():
        yield


@pytest.fixture
def client(database_url: str, small_problems: None) -> Iterator[httpx.Client]:
    """A client of a coordinator in this process, on a database of the test's own."""
    with coordinator(database_url) as opened:
        yield opened


@pytest.fixture
def queue(engines: Engines) -> Queue:
    """The queue of a database of the test's own."""
    return Queue(engines=engines)


@pytest.fixture(scope="session")
def served_model() -> Iterator[Endpoint]:
    """A language model's endpoint for the session."""
    with serving() as served:
        yield served


@pytest.fixture
def endpoint(served_model: Endpoint) -> Iterator[Endpoint]:
    """The endpoint of a language model, as new."""
    served_model.reset()
    yield served_model
    served_model.reset()
