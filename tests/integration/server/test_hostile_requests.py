"""Hostile requests: what each gets, that nothing of it is stored, and that nothing secret is told.

The list is in `support.attacks`; those below it need a coordinator of their own.
`docs/reference/security.md` names them all.
"""

import base64
import logging
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from support.api import FakeWorker, ball, coordinator, expect, listening_coordinator, progress, submit
from support.attacks import ATTACKS
from support.attacks.bodies import MOST_BYTES
from support.databases import Databases, module_sqlite_then_postgres, sqlite_then_postgres
from support.hostile import Attack, Target, everything, outcome_of, prepare, results
from support.problems import small_problems

import brink.server.access.authentication
from brink.server.access.tokens import create_token, parse_token_id
from brink.server.db.engine import Engines, open_engines
from brink.server.states import Scope

SECURITY = Path(__file__).parents[3] / "docs" / "reference" / "security.md"
INSIDES = ("Traceback", "site-packages", "sqlalchemy", "psycopg", "[SQL", "postgresql://", "sqlite:///")
NOT_THE_COORDINATORS = ("httpx", "httpcore", "uvicorn.access")
"""Loggers of the client, and one that the coordinator has turned off, whatever pytest hangs on it."""
LARGEST_REFUSAL = 32 * 1024
OWN_TESTS: dict[str, tuple[int, ...]] = {}
"""What the tests below try, and the statuses that it gets."""


def named(name: str, *gets: int) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Put a test on the list."""
    OWN_TESTS[name] = gets
    return lambda test: test


@pytest.fixture(scope="module")
def target(module_databases: Databases) -> Iterator[Target]:
    """A coordinator with tokens and campaigns, for the whole list."""
    with pytest.MonkeyPatch.context() as patched, small_problems(), module_databases.database() as url:
        patched.setattr(brink.server.access.authentication, "TOKEN_CACHE_S", 0.0)
        patched.setattr(brink.server.access.authentication, "UNAUTHENTICATED_PER_S", 1e6)
        engines = open_engines(url)
        try:
            with listening_coordinator(
                url, lease_s=3600, stall_s=1.0, max_body_bytes=MOST_BYTES, rate_limit=0
            ) as client:
                yield prepare(client, engines)
        finally:
            engines.dispose()


@module_sqlite_then_postgres
@pytest.mark.parametrize("attack", [pytest.param(one, id=one.name) for one in ATTACKS])
def test_a_hostile_request_gets_what_it_should_and_changes_nothing(
    target: Target, attack: Attack, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    caplog.set_level(logging.INFO, "httpcore")  # thousands of lines of the client
    before = everything(target.engines)
    answers = list(attack.send(target))
    assert answers
    for answer in answers:
        assert answer.status in attack.gets, answer.whole
        assert attack.says in answer.text, answer.whole
        if answer.status >= 400 and attack.problem:
            assert answer.headers["content-type"] == "application/problem+json", answer.whole
        assert answer.status < 400 or len(answer.text) <= LARGEST_REFUSAL, "the input is repeated at length"
        whole = answer.whole
        for hidden in (*INSIDES, *attack.hides, *map(secret, target.tokens.values())):
            assert hidden not in whole
    assert everything(target.engines) == before, "something was stored"
    assert target.ask("GET", "/readyz", None).status == 200
    records = [one for one in caplog.records if not one.name.startswith(NOT_THE_COORDINATORS)]
    told = "\n".join(f"{record.getMessage()} {record.exc_text}" for record in records)
    for token in (*target.tokens.values(), target.mine.token, target.theirs.token):
        assert secret(token) not in told, "a secret is in the log"
    assert [record.getMessage() for record in records if record.levelno >= logging.ERROR] == []


def secret(token: str) -> str:
    """Return what is secret of a token."""
    return token.rpartition("_")[2]


def test_every_one_is_named_in_the_documentation_with_what_it_gets() -> None:
    rows = re.findall(r"^\| ([^|]+?) \| ([^|]+?) \|$", SECURITY.read_text("utf-8"), re.MULTILINE)
    table = {name: cell for names, cell in rows for name in names.split("; ")}
    known = {attack.name: attack.gets for attack in ATTACKS} | OWN_TESTS
    assert len(known) == len(ATTACKS) + len(OWN_TESTS) >= 30
    listed = {name: cell for name, cell in table.items() if re.search(r"\d{3}|closed", cell)}
    assert set(listed) == set(known)
    for name, gets in known.items():
        told = {
            0 if word == "closed" else int(word) for word in re.findall(r"\b\d{3}\b|closed", listed[name])
        }
        assert told == set(gets), name


@pytest.fixture
def guarded(database_url: str, engines: Engines, small_problems: None) -> Iterator[tuple[httpx.Client, str]]:
    with engines.writer.begin() as connection:
        token = create_token(connection, Scope.READ, "somebody")
    with coordinator(database_url, rate_limit=5.0) as client:
        yield client, token


@named("a flood of requests with a token", 200, 429)
def test_a_flood_is_told_to_come_again_later(guarded: tuple[httpx.Client, str]) -> None:
    client, token = guarded
    headers = {"Authorization": f"Bearer {token}"}
    answers = [client.get("/api/v1/campaigns", headers=headers) for _ in range(100)]
    assert {answer.status_code for answer in answers} == {200, 429}
    assert sum(answer.status_code == 200 for answer in answers) < 50
    for answer in answers:
        assert answer.status_code == 200 or int(answer.headers["Retry-After"]) >= 1
    assert client.get("/readyz").status_code == 200


@named("a flood of guessed tokens", 401, 429)
def test_token_guesses_must_wait(guarded: tuple[httpx.Client, str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(brink.server.access.authentication, "UNAUTHENTICATED_PER_S", 20.0)
    client, token = guarded
    guesses = [f"brink_admin_{parse_token_id(token)}_{number:048x}" for number in range(100)]
    answers = [client.get("/api/v1/jobs", headers={"Authorization": f"Bearer {guess}"}) for guess in guesses]
    assert {answer.status_code for answer in answers} == {401, 429}
    late = [answer for answer in answers if answer.status_code == 429]
    assert all(int(answer.headers["Retry-After"]) >= 1 for answer in late)


@sqlite_then_postgres
@named("a result without the verdict of a requirement", 200)
def test_a_result_without_the_verdict_counts_as_failed(client: httpx.Client) -> None:
    campaign = submit(client, ball(simulations=20, execution={"max_attempts": 1}))
    worker = FakeWorker(client)
    while jobs := worker.lease():
        told: list[dict[str, Any]] = [{**outcome_of(job), "verdicts": {}} for job in jobs]
        for job, outcome in zip(jobs, told, strict=True):
            body = results(job.job, job.token, outcome)
            answer = expect(client.post("/api/v1/jobs/results", json=body))
            assert answer["statuses"] == [{"job": job.job, "status": "invalid"}]
    stands = worker.work(campaign)
    assert (stands["status"], stands["evaluated"], stands["unsafe"]) == ("paused", 0, 0)
    assert "KeyError: 'distance@1'" in stands["status_reason"]


@named("a result with verdicts that were not requested", 200)
def test_verdicts_that_nobody_asked_for_decide_nothing(client: httpx.Client) -> None:
    def with_more(campaign: str, extra: dict[str, Any]) -> dict[str, Any]:
        worker = FakeWorker(client, capabilities=("faulty@1",))
        while jobs := worker.lease():
            for job in jobs:
                outcome = outcome_of(job)
                outcome["verdicts"] |= extra
                expect(client.post("/api/v1/jobs/results", json=results(job.job, job.token, outcome)))
        return worker.work(campaign)

    verdict = {"robustness": -99.0, "unit": "m", "violated_at_s": 0.0}
    body = ball(simulations=20, execution={"cache": False, "keep_traces": 0})
    plain = with_more(submit(client, body), {})
    more = with_more(submit(client, body), {"no-collision@1": verdict, "distance@2": verdict})
    assert more["digest"] == plain["digest"]
    assert more["unsafe"] == plain["unsafe"]


@named("SQL, quotes and markup in a name", 201)
def test_a_name_is_text_and_nothing_else(client: httpx.Client) -> None:
    names = [
        "x'; DROP TABLE campaigns; --",
        '"><script>alert(1)</script>',
        "../../etc/passwd",
        "${7*7}",
        "%s%n",
        "\u202e?",
    ]
    for name in (name for name in names if name.isprintable()):
        made = expect(client.post("/api/v1/campaigns", json={**ball(), "name": name}), 201)
        answer = client.get(f"/api/v1/campaigns/{made['id']}")
        assert expect(answer)["name"] == name
        assert answer.headers["content-type"] == "application/json"
        csv = client.get(f"/api/v1/campaigns/{made['id']}/boundary", params={"format": "csv"})
        assert csv.headers["Content-Disposition"] == f'attachment; filename="boundary-{made["id"]}.csv"'


@named("a trace that is a zip bomb, or not a trace", 409)
def test_a_trace_that_is_none_is_not_drawn(client: httpx.Client, engines: Engines) -> None:
    bomb = base64.b64encode(b"PK\x03\x04" + bytes(100)).decode()
    worker = FakeWorker(client)
    campaign = submit(client, ball(simulations=20, execution={"keep_traces": 0}))
    worker.work(campaign)
    path = f"/api/v1/campaigns/{campaign}/solutions/3"
    assert client.post(f"{path}/trace").status_code == 202
    (job,) = worker.lease()
    body = results(job.job, job.token, {**outcome_of(job), "trace": bomb}, worker.id)
    expect(client.post("/api/v1/jobs/results", json=body))
    for extension in ("png", "gif", "mp4"):
        assert "not a trace" in expect(client.get(f"{path}/replay.{extension}"), 409)["detail"]


@named("a page of another site, without tokens", 403)
def test_no_page_of_another_site_changes_anything(client: httpx.Client) -> None:
    campaign = submit(client, ball())
    for verb in ("pause", "cancel"):
        headers = {"Origin": "http://evil.example"}
        expect(client.post(f"/api/v1/campaigns/{campaign}/{verb}", headers=headers), 403)
    assert progress(client, campaign)["status"] == "running"


@named("a foreign host name that resolves here, without tokens", 421)
def test_no_other_name_is_served_without_tokens(client: httpx.Client) -> None:
    for path in ("/api/v1/campaigns", "/metrics", "/api/v1/jobs"):
        expect(client.get(path, headers={"Host": "evil.example"}), 421)
