"""Tokens: made and ended by command, kept as digests, each good for its scope and for so many requests."""

import itertools
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
import yaml
from sqlalchemy import text
from support.api import FakeWorker, ball, coordinator, eventually, expect, listening_coordinator, submit
from support.databases import Databases, sqlite_then_postgres
from typer.testing import CliRunner

import brink.server.access.authentication
from brink.cli.commands import app
from brink.server.access.authentication import Authenticator, Caller
from brink.server.access.tokens import create_token, parse_token_id, token_digest
from brink.server.db.engine import Engines, open_engines
from brink.server.db.upgrade import current_revision
from brink.server.runtime.coordinator import CannotListen, check_exposed
from brink.server.settings import Settings
from brink.server.states import Scope

BRINK = Path(sys.executable).with_name("brink")
UNKNOWN = "brink_admin_00000000_" + "0" * 48
NO_TOKENS = (
    None,
    "",
    "Bearer",
    "Basic {admin}",
    "bearer {admin}",
    "Bearer {admin}x",
    "Bearer {admin} x",
    "{admin}",
    f"Bearer {UNKNOWN}",
    "Bearer {forged}",
    "Bearer \u00fc",
    "Bearer " + "x" * 8000,
)
SMALL = {
    "name": "small",
    "problem": {"id": "onemax@1"},
    "algorithm": {"id": "random@1"},
    "budget": {"simulations": 40},
}

ALLOWED = {
    ("GET", "/api/v1/campaigns"): {"read", "user", "admin"},
    ("GET", "/api/v1/workers"): {"read", "user", "admin"},
    ("GET", "/api/v1/access"): {"read", "user", "admin"},
    ("GET", "/metrics"): {"read", "user", "admin"},
    ("POST", "/api/v1/campaigns"): {"user", "admin"},
    ("PATCH", "/api/v1/campaigns/{campaign}"): {"user", "admin"},
    ("POST", "/api/v1/campaigns/{campaign}/pause"): {"user", "admin"},
    ("POST", "/api/v1/campaigns/{campaign}/resume"): {"user", "admin"},
    ("POST", "/api/v1/jobs/1/retry"): {"user", "admin"},
    ("POST", "/api/v1/jobs/lease"): {"worker", "admin"},
    ("POST", "/api/v1/jobs/heartbeat"): {"worker", "admin"},
    ("POST", "/api/v1/jobs/results"): {"worker", "admin"},
    ("GET", "/api/v1/jobs/lease"): {"worker", "admin"},
    ("PUT", "/api/v1/campaigns/{campaign}/violations/1/x/name"): {"user", "admin"},
    ("DELETE", "/api/v1/campaigns/{campaign}/violations/1/x/name"): {"user", "admin"},
    ("DELETE", "/api/v1/campaigns/{campaign}"): {"admin"},
    ("GET", "/api/v1/experiments"): {"read", "user", "admin"},
    ("POST", "/api/v1/experiments"): {"user", "admin"},
    ("POST", "/api/v1/experiments/3f2a/pause"): {"user", "admin"},
    ("DELETE", "/api/v1/experiments/3f2a"): {"admin"},
    ("POST", "/api/v1/campaigns/{campaign}/monitor/score"): {"user", "admin"},
}


@pytest.fixture(autouse=True)
def _at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(brink.server.access.authentication, "TOKEN_CACHE_S", 0.0)


def made(engines: Engines, scope: str, name: str = "somebody") -> str:
    with engines.writer.begin() as connection:
        return create_token(connection, Scope(scope), name)


@pytest.fixture
def tokens(engines: Engines) -> dict[str, str]:
    return {str(scope): made(engines, scope) for scope in Scope}


@pytest.fixture
def web(database_url: str, small_problems: None) -> Iterator[httpx.Client]:
    """A client of a coordinator that listens; it sends no token by itself."""
    with listening_coordinator(database_url) as client:
        yield client


@pytest.fixture
def url(web: httpx.Client) -> str:
    return str(web.base_url)


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


@sqlite_then_postgres
def test_each_scope_may_do_what_it_is_for(web: httpx.Client, tokens: dict[str, str]) -> None:
    campaign = expect(web.post("/api/v1/campaigns", json=ball(), headers=bearer(tokens["user"])), 201)["id"]
    for (method, path), scopes in ALLOWED.items():
        for scope, token in tokens.items():
            answer = web.request(method, path.format(campaign=campaign), headers=bearer(token))
            refused = answer.status_code in (401, 403)
            assert refused == (scope not in scopes), f"{scope}: {method} {path}: {answer.status_code}"
            if refused:
                assert answer.status_code == 403
                assert f"scope is {scope}" in answer.json()["detail"]


@sqlite_then_postgres
def test_a_worker_runs_a_campaign_with_its_token(url: str, tokens: dict[str, str]) -> None:
    with (
        httpx.Client(base_url=url, headers=bearer(tokens["user"])) as user,
        httpx.Client(base_url=url, headers=bearer(tokens["worker"])) as worker,
    ):
        campaign = submit(user, ball(simulations=20))
        hands = FakeWorker(worker)
        while jobs := hands.lease():
            assert set(hands.report(jobs)) == {"accepted"}
        eventually(
            lambda: user.get(f"/api/v1/campaigns/{campaign}").json()["status"] == "finished", "it ends"
        )


@sqlite_then_postgres
def test_nothing_secret_is_stored(engines: Engines, tokens: dict[str, str]) -> None:
    with engines.reader.connect() as connection:
        rows = [tuple(row) for row in connection.execute(text("SELECT * FROM tokens"))]
    kept = repr(rows)
    for token in tokens.values():
        assert token not in kept
        assert token.rpartition("_")[2] not in kept
        assert token_digest(token) in kept


@sqlite_then_postgres
def test_a_revoked_or_ended_token_opens_nothing_and_the_last_one_leaves_it_closed(
    web: httpx.Client, engines: Engines, database_url: str
) -> None:
    run = CliRunner().invoke
    assert web.get("/api/v1/campaigns").status_code == 200, "on this machine, while there is no token"
    created = run(app, ["token", "create", "a colleague", "--scope", "user", "--database", database_url])
    assert created.exit_code == 0, created.output
    token = created.stdout.strip().splitlines()[0]
    token_id = parse_token_id(token)
    assert token_id is not None
    assert web.get("/api/v1/campaigns").status_code == 401
    assert web.get("/api/v1/campaigns", headers=bearer(token)).status_code == 200
    other = made(engines, "read")
    listed = run(app, ["token", "list", "--json", "--database", database_url])
    assert {one["name"] for one in json.loads(listed.stdout)} == {"a colleague", "somebody"}
    assert token.rpartition("_")[2] not in listed.stdout
    assert run(app, ["token", "revoke", token_id, "--database", database_url]).exit_code == 0
    assert web.get("/api/v1/campaigns", headers=bearer(token)).status_code == 401
    assert "revoked" in run(app, ["token", "list", "--database", database_url]).stdout
    with engines.writer.begin() as connection:
        connection.execute(
            text("UPDATE tokens SET expires_at = '2020-01-01 00:00:00+00' WHERE name = 'somebody'")
        )
    for headers in ({}, bearer(other)):
        assert web.get("/api/v1/campaigns", headers=headers).status_code == 401, "it does not open again"


@sqlite_then_postgres
def test_other_machines_are_let_in_where_there_are_tokens(engines: Engines, database_url: str) -> None:
    exposed = Settings(database=database_url, host="0.0.0.0")
    with pytest.raises(CannotListen, match="brink token create"):
        check_exposed(exposed)
    made(engines, "worker")
    check_exposed(exposed)


@sqlite_then_postgres
def test_looking_for_tokens_does_not_touch_a_database_of_an_older_schema(databases: Databases) -> None:
    with databases.database("old", migrated=False) as url:
        with pytest.raises(CannotListen, match="brink token create"):
            check_exposed(Settings(database=url, host="0.0.0.0"))
        looked = open_engines(url)
        try:
            assert current_revision(looked) is None
        finally:
            looked.dispose()


@sqlite_then_postgres
def test_a_token_makes_so_many_requests_a_second(engines: Engines) -> None:
    now = 100.0
    gate = Authenticator(engines, token=None, exposed=False, rate_limit=10.0, clock=lambda: now)
    one, other = Caller("one", Scope.READ), Caller("other", Scope.READ)
    assert [gate.wait_s(one) for _ in range(10)] == [0.0] * 10
    assert gate.wait_s(one) == pytest.approx(0.1)
    assert gate.wait_s(other) == 0.0
    now += 0.25
    assert [gate.wait_s(one) == 0.0 for _ in range(3)] == [True, True, False]
    now += 1e6
    assert sum(gate.wait_s(one) == 0.0 for _ in range(20)) == 10
    free = Authenticator(engines, token=None, exposed=False, rate_limit=0.0, clock=lambda: now)
    assert {free.wait_s(one) for _ in range(100)} == {0.0}


@sqlite_then_postgres
def test_every_answer_has_the_headers_that_browsers_heed(web: httpx.Client) -> None:
    for path in ("/api/v1/campaigns", "/healthz", "/docs", "/nothing", "/metrics"):
        headers = web.get(path, headers={"Origin": "http://evil.example"}).headers
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert headers["X-Frame-Options"] == "DENY"
        assert "default-src 'self'" in headers["Content-Security-Policy"]
        assert not any(name.startswith("access-control") for name in headers)


@pytest.mark.long("runs a campaign")
def test_a_run_works_on_a_database_with_tokens(engines: Engines, database_url: str, tmp_path: Path) -> None:
    made(engines, "user")
    file = tmp_path / "small.yaml"
    file.write_text(yaml.safe_dump(SMALL))
    given = [str(file), "--no-pictures", "--workers", "1", "--database", database_url, "--out", str(tmp_path)]
    ran = subprocess.run([BRINK, "run", *given], capture_output=True, text=True, timeout=100, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "boundary.csv" in ran.stdout


@sqlite_then_postgres
def test_what_is_no_token_opens_nothing(web: httpx.Client, tokens: dict[str, str]) -> None:
    forged = tokens["read"][:-1] + ("0" if tokens["read"][-1] != "0" else "1")
    for given in NO_TOKENS:
        header = None if given is None else given.format(admin=tokens["admin"], forged=forged).encode()
        answer = web.get(
            "/api/v1/campaigns", headers={b"Authorization": header} if header is not None else {}
        )
        assert answer.status_code == 401, f"{given}: {answer.text}"
        assert answer.headers["WWW-Authenticate"] == "Bearer"


def test_no_spelling_of_a_path_evades_scopes(web: httpx.Client, tokens: dict[str, str]) -> None:
    body = {"worker": {"id": "w"}, "capabilities": ["x"], "wait_s": 0}
    for path, after, scope in itertools.product(
        ("lease", "heartbeat", "results"),
        ("%0A", "%0D", "%00", "%E2%80%A8", "/", "%2F", "//"),
        ("read", "user"),
    ):
        answer = web.post(f"/api/v1/jobs/{path}{after}", json=body, headers=bearer(tokens[scope]))
        said = f"{scope}, {path}{after}: {answer.status_code} {answer.text}"
        assert answer.status_code in (403, 404, 405), said


@sqlite_then_postgres
def test_a_scope_cannot_be_changed_by_changing_the_token(web: httpx.Client, tokens: dict[str, str]) -> None:
    widened = tokens["read"].replace("_read_", "_admin_")
    assert web.get("/api/v1/campaigns", headers=bearer(widened)).status_code == 401


@sqlite_then_postgres
def test_too_many_requests_get_a_retry_time(
    database_url: str, engines: Engines, small_problems: None
) -> None:
    token = made(engines, "read")
    with coordinator(database_url, rate_limit=3.0) as client:
        answers = [client.get("/api/v1/campaigns", headers=bearer(token)) for _ in range(12)]
        codes = [answer.status_code for answer in answers]
        assert codes[:3] == [200] * 3
        assert 429 in codes
        late = next(answer for answer in answers if answer.status_code == 429)
        assert int(late.headers["Retry-After"]) >= 1
        guesses = [client.get("/api/v1/campaigns", headers=bearer(UNKNOWN)).status_code for _ in range(60)]
        assert guesses[0] == 401
        assert 429 in guesses, "tokens cannot be guessed fast"
