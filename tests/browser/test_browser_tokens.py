"""Signing in: a wrong token, a right one, one that may only look, a worker's; and out again."""

import httpx
import pytest
from playwright.sync_api import Page
from playwright.sync_api import expect as shown

from brink.server.access.tokens import create_token
from brink.server.db.engine import open_engines
from brink.server.states import Scope
from browser.console import Console
from browser.served import SECRET, origin
from browser.visits import Visits


def token_of(database: str, scope: str) -> str:
    engines = open_engines(database)
    try:
        with engines.writer.begin() as connection:
            return create_token(connection, Scope(scope), "somebody")
    finally:
        engines.dispose()


def sign_in(page: Page, token: str, *, remember: bool = False) -> None:
    page.get_by_label("Token").fill(token)
    if remember:
        page.get_by_label("Remember it on this device").check()
    page.get_by_role("button", name="Sign in").click()


def test_without_a_token_nothing_is_shown_and_with_the_right_one_everything(
    guarded: httpx.Client, visit: Visits, console: Console
) -> None:
    console.expect_status(401)
    page = visit(origin(guarded))
    shown(page.get_by_role("heading", name="Sign in")).to_be_visible()
    shown(page.get_by_label("Token")).to_be_focused()
    sign_in(page, "battery-staple")
    shown(page.get_by_role("alert")).to_have_text("Token rejected: it is misspelt, revoked or expired.")
    shown(page.get_by_text("guarded")).to_have_count(0)
    sign_in(page, SECRET)
    shown(page.get_by_role("link", name="guarded")).to_be_visible()
    shown(page.get_by_text("scope admin")).to_be_visible()
    page.reload()
    shown(page.get_by_role("link", name="guarded")).to_be_visible()


@pytest.mark.long("the dashboard beyond a walk through it")
def test_signing_out_forgets_the_token(guarded: httpx.Client, visit: Visits, console: Console) -> None:
    console.expect_status(401)
    page = visit(origin(guarded))
    sign_in(page, SECRET, remember=True)
    assert page.evaluate("localStorage.getItem('brink.token')") == SECRET
    page.get_by_role("button", name="Sign out").click()
    shown(page.get_by_role("heading", name="Sign in")).to_be_visible()
    assert page.evaluate("[localStorage.getItem('brink.token'), sessionStorage.getItem('brink.token')]") == [
        None,
        None,
    ]
    page.reload()
    shown(page.get_by_role("heading", name="Sign in")).to_be_visible()


@pytest.mark.long("the dashboard beyond a walk through it")
def test_a_read_only_token_cannot_submit(guarded: httpx.Client, own_database: str, visit: Visits) -> None:
    page = visit(origin(guarded), token=token_of(own_database, "read"))
    shown(page.get_by_role("link", name="guarded")).to_be_visible()
    shown(page.get_by_text("scope read")).to_be_visible()
    for words in ("Pause", "Cancel", "Clone"):
        shown(page.get_by_role("button", name=words)).to_have_count(0)
    shown(page.get_by_role("link", name="New campaign")).to_have_count(0)
    page.get_by_role("link", name="guarded").click()
    shown(page.get_by_role("region", name="Finding")).to_contain_text("0 of 60")
    shown(page.get_by_role("button", name="Pause")).to_have_count(0)
    page.goto(f"{origin(guarded)}/#/new")
    shown(page.get_by_text("This token is read-only.")).to_be_visible()
    shown(page.get_by_role("button", name="Submit campaign")).to_have_count(0)


@pytest.mark.long("the dashboard beyond a walk through it")
def test_user_token_may_control_not_delete(guarded: httpx.Client, own_database: str, visit: Visits) -> None:
    page = visit(origin(guarded), token=token_of(own_database, "user"))
    page.get_by_role("link", name="guarded").click()
    page.get_by_role("button", name="Cancel guarded").click()
    page.get_by_role("button", name="Cancel campaign").click()
    shown(page.locator(".head .badge")).to_have_text("cancelled")
    shown(page.get_by_role("button", name="Delete")).to_have_count(0)


@pytest.mark.long("the dashboard beyond a walk through it")
def test_worker_token_is_refused(
    guarded: httpx.Client, own_database: str, visit: Visits, console: Console
) -> None:
    console.expect_status(401, 403)
    page = visit(origin(guarded))
    sign_in(page, token_of(own_database, "worker"))
    shown(page.get_by_role("alert")).to_contain_text("This is a worker token")
    shown(page.get_by_role("heading", name="Sign in")).to_be_visible()
