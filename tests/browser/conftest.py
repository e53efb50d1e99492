"""Fixtures of tests in a browser: one browser and one coordinator for all of them, a visitor of its own for each."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Browser, Page
from playwright.sync_api import expect as shown
from support.api import ball, eventually, listening_coordinator, progress, submit
from support.problems import small_problems

import brink.server.access.authentication
from benchmarks.chromium import NoChromium, chromium, executable
from browser.console import Console, silence
from browser.served import (
    ANY_PAIR,
    LOOSELY,
    NOBODYS,
    PATIENCE_S,
    SECRET,
    TRAFFIC,
    Served,
    a_pair,
    served,
    unsafe_one,
)
from browser.views import View, views_of
from browser.visits import PATIENCE_MS, Browse, Regular, Visits, visiting

shown.set_options(timeout=PATIENCE_MS)


@pytest.fixture(scope="package")
def browser() -> Iterator[Browser]:
    """Chromium; where there is none, the tests that need it fail and say how to get it."""
    try:
        executable()
        missing = ""
    except NoChromium as error:
        missing = str(error)
    if missing:
        pytest.fail(missing, pytrace=False)
    with chromium() as opened:
        yield opened


@pytest.fixture(scope="package")
def site(sqlite_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A coordinator with a worker and campaigns of every state, which tests look at and add to, but do not end."""
    folder = tmp_path_factory.mktemp("site")
    with served(f"sqlite:///{shutil.copyfile(sqlite_file, folder / 'brink.db')}", folder) as made:
        yield made


@pytest.fixture(scope="package")
def traffic(site: Served) -> str:
    """A finished campaign of the site in hostile traffic, whose worker is told to simulate it."""
    campaign = submit(site.client, TRAFFIC)
    eventually(
        lambda: progress(site.client, campaign)["status"] == "finished", "traffic is simulated", PATIENCE_S
    )
    return campaign


@pytest.fixture
def own_database(sqlite_file: Path, tmp_path: Path) -> str:
    """The URL of a database of the test's own."""
    return f"sqlite:///{shutil.copyfile(sqlite_file, tmp_path / 'own.db')}"


@pytest.fixture
def own(own_database: str) -> Iterator[httpx.Client]:
    """A coordinator of the test's own, without a worker; one that it has heard of stays live for the whole test."""
    with small_problems(), listening_coordinator(own_database, worker_seen_s=3600.0) as client:
        yield client


@pytest.fixture
def guarded(own_database: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[httpx.Client]:
    """A coordinator of the test's own that asks for a token, with a campaign that runs."""
    monkeypatch.setattr(brink.server.access.authentication, "TOKEN_CACHE_S", 0.0)
    with small_problems(), listening_coordinator(own_database, token=SECRET) as client:
        submit(client, ball(name="guarded", problem=NOBODYS))
        yield client


@pytest.fixture
def views(site: Served) -> list[View]:
    """Every view but that which asks for a token."""
    return views_of(
        site.urban,
        unsafe_one(site)["number"],
        (site.urban, site.ball),
        site.experiment,
        f"#/campaigns/{site.urban}/pairs{ANY_PAIR}",
        a_pair(site.client, site.urban)[1],
        LOOSELY,
    )


@pytest.fixture
def console() -> Iterator[Console]:
    """What the test's pages complain of; a test fails on anything that it did not expect."""
    with silence() as opened:
        yield opened


@pytest.fixture(scope="package")
def regular(browser: Browser) -> Iterator[Regular]:
    """The visitor of the site who stays."""
    visitor = Regular(browser)
    yield visitor
    visitor.end()


@pytest.fixture
def browse(
    site: Served, regular: Regular, console: Console, request: pytest.FixtureRequest
) -> Iterator[Browse]:
    """Goes to places of the site for a fraction of what a new visitor costs; one comes after a test that failed."""
    failed = request.session.testsfailed
    page = regular.come(site.url, console)

    def go(place: str = "#/") -> Page:
        page.goto(f"{site.url}/{place}")
        return page

    yield go
    if request.session.testsfailed > failed:
        regular.end()
    else:
        regular.go(console)


@pytest.fixture
def visit(browser: Browser, console: Console) -> Iterator[Visits]:
    """Opens pages."""
    with visiting(browser, console) as visits:
        yield visits
