"""Fixtures of all tests: databases on SQLite and on a real Postgres, coordinators, a language model's endpoint.

``make test`` leaves out the tests that are marked ``long``; ``make test-all`` runs them too.
"""

import gc
import logging
import os
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from hypothesis import settings
from support import problems
from support.api import coordinator, listening_coordinator
from support.databases import (
    BACKENDS,
    Databases,
    PostgresDatabases,
    databases_for,
    share_statements,
    sqlite_template,
)
from support.llm_endpoint import Endpoint, serving
from support.queue import Queue
from support.sessions import LongestFirst, SharedPostgres, slowest_files, use_memory
from xdist.remote import Producer
from xdist.workermanage import WorkerController

from brink.search import curves, exploration, surrogate
from brink.search.algorithms import pool
from brink.search.algorithms.tolerance import results
from brink.search.analysis import boosted_trees
from brink.server.db.engine import Engines, open_engines

# The checks that everybody must pass try the same examples each time; people's own runs keep looking for new ones.
settings.register_profile("ci", derandomize=True, deadline=None)
if os.environ.get("CI"):
    settings.load_profile("ci")

os.environ.setdefault(
    "OMP_NUM_THREADS", "1"
)  # the processes of a run share the cores; waiting threads would spin
use_memory()
share_statements()
shared_postgres = SharedPostgres()


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Skip the files that need torch, which is slow to load, unless their tests, all of them long, are to run."""
    unwanted = config.option.markexpr == "not long"
    return True if unwanted and collection_path.name.endswith("_torch.py") else None


def pytest_collection() -> None:
    """Collect no garbage while the tests are collected: nearly everything that is made there stays."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Exempt modules and tests from garbage collection, which would otherwise scan them again and again."""
    gc.freeze()
    gc.enable()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> LongestFirst | None:
    """Have ``--dist loadfile`` start with the files that take longest."""
    return LongestFirst(config, log) if config.getoption("dist") == "loadfile" else None


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: WorkerController) -> None:
    """Have all processes of a run use one Postgres."""
    node.workerinput["postgres"] = shared_postgres.address()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """List the files whose tests took longest, so that growth is seen."""
    reports = (one for found in terminalreporter.stats.values() for one in found)
    lines = slowest_files(one for one in reports if isinstance(one, pytest.TestReport))
    if lines:
        terminalreporter.section("slowest files")
        terminalreporter.write_line("\n".join(lines))


def pytest_unconfigure() -> None:
    """Stop the Postgres of this run."""
    shared_postgres.stop()


@pytest.fixture(autouse=True)
def _loggers_of_commands() -> Iterator[None]:
    """Remove the log handlers of a command that a test runs in this process: they write to its captured output.

    Once that output is closed, each message of a later test would be a complaint in the output of its commands.
    """
    yield
    root = logging.getLogger()
    for handler in [one for one in root.handlers if type(one) is logging.StreamHandler]:
        root.removeHandler(handler)


@pytest.fixture(autouse=True)
def _settings_of_commands() -> Iterator[None]:
    """Restore the settings that a command of a test makes for its workers, which are this process's from then on."""
    before = {name: value for name, value in os.environ.items() if name.startswith("BRINK_")}
    yield
    for name in [one for one in os.environ if one.startswith("BRINK_") and one not in before]:
        del os.environ[name]
    os.environ.update(before)


@pytest.fixture(scope="session")
def postgres_databases(request: pytest.FixtureRequest) -> Iterator[PostgresDatabases]:
    """Databases of a Postgres server; where there is no Postgres, the tests that need it fail and say why."""
    workerinput = getattr(request.config, "workerinput", None)
    found = workerinput["postgres"] if workerinput else shared_postgres.address()
    if "missing" in found:
        pytest.fail(found["missing"], pytrace=False)
    databases = PostgresDatabases(found["url"])
    yield databases
    databases.close()


@pytest.fixture
def few_trees(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the search for pairs grow small forests, where the quality of its choices does not matter."""
    monkeypatch.setattr(surrogate, "TREES", 6)
    monkeypatch.setattr(exploration, "TREES", 6)


@pytest.fixture(scope="module")
def fewer_trees() -> Iterator[None]:
    """Let the searches of a file grow a quarter of the trees, of which small problems do not need more."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(surrogate, "TREES", 15)
        patched.setattr(exploration, "TREES", 10)
        yield


@pytest.fixture(scope="module")
def smaller_library() -> Iterator[None]:
    """Compare tolerances with a fifth of the curves, and their searches with a quarter: enough for few drives."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(curves, "LIBRARY", 60_000)
        patched.setattr(results, "_CURVES", 5_000)
        yield


@pytest.fixture
def small_pools(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let searches choose among few draws, where the quality of their choices does not matter."""
    monkeypatch.setattr(pool, "FRESH", 15)


@pytest.fixture
def short_forests(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let monitors fit few trees, which suffice for what is easy to tell apart."""
    monkeypatch.setattr(boosted_trees, "TREES", 20)


@pytest.fixture(scope="session")
def sqlite_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A migrated SQLite file, to be copied."""
    return sqlite_template(tmp_path_factory.mktemp("sqlite"))


@pytest.fixture(params=BACKENDS[:1])
def databases(request: pytest.FixtureRequest, tmp_path: Path) -> Databases:
    """Databases on SQLite, unless a test asks for Postgres too."""
    return databases_for(request, tmp_path)


@pytest.fixture(scope="module", params=BACKENDS[:1])
def module_databases(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Databases:
    """Databases that all tests of a file share, on SQLite unless a test asks for Postgres too."""
    return databases_for(request, tmp_path_factory.mktemp("databases"))


@pytest.fixture
def database_url(databases: Databases) -> Iterator[str]:
    """The URL of a migrated database."""
    with databases.database() as url:
        yield url


@pytest.fixture
def engines(database_url: str) -> Iterator[Engines]:
    """The engines of the test's database."""
    opened = open_engines(database_url)
    yield opened
    opened.dispose()


@pytest.fixture
def small_problems() -> Iterator[None]:
    """Register the small problems of `support.problems`, such as ``ball@1``, for the length of a test."""
    with problems.small_problems():
        yield


@pytest.fixture
def client(database_url: str, small_problems: None) -> Iterator[httpx.Client]:
    """A client of a coordinator in this process, without a socket, on the test's database."""
    with coordinator(database_url) as opened:
        yield opened


@pytest.fixture
def listening_client(database_url: str, small_problems: None) -> Iterator[httpx.Client]:
    """A client of a coordinator in this process that listens on a socket, on the test's database."""
    with listening_coordinator(database_url) as opened:
        yield opened


@pytest.fixture
def queue(engines: Engines) -> Queue:
    """The queue of the test's database."""
    return Queue(engines=engines)


@pytest.fixture(scope="session")
def llm_server() -> Iterator[Endpoint]:
    """The endpoint of a language model, one for all tests."""
    with serving() as served:
        yield served


@pytest.fixture
def endpoint(llm_server: Endpoint) -> Iterator[Endpoint]:
    """The endpoint of a language model, without any script or memory of earlier tests."""
    llm_server.reset()
    yield llm_server
    llm_server.reset()
