"""Hostile requests against a coordinator: what is sent, what it must get, and how to see that nothing changed."""

import socket
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
from sqlalchemy import select, update

from brink.server.access.tokens import create_token, parse_token_id, revoke_token
from brink.server.db.engine import Engines
from brink.server.db.models import Base, JobRow, TokenRow, WorkerRow
from brink.server.states import Scope
from brink.worker.wire import LeasedJob
from support.api import FakeWorker, ball, completes, eventually, expect, submit

SILENCE_S = 20.0
KEY = "the key of the campaign that has ended"


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What came back."""

    status: int
    headers: Mapping[str, str]
    text: str

    @property
    def whole(self) -> str:
        """All of it."""
        return f"{dict(self.headers)} {self.text}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A coordinator with tokens of each scope, a campaign that has ended, and two that run.

    Attributes:
        client: Of the coordinator; sends no token by itself.
        engines: Of its database.
        tokens: By scope, and one ``revoked`` and one ``expired``.
        finished: Campaign that has ended.
        running: Campaign with open jobs.
        mine: A job of it that the worker ``mine`` holds.
        theirs: A job of another campaign that the worker ``theirs`` holds.
        reported: A job that ``mine`` has reported.
        lost: A job whose lease ran out, and which another worker has leased since.
    """

    client: httpx.Client
    engines: Engines
    tokens: Mapping[str, str]
    finished: str
    running: str
    mine: LeasedJob
    theirs: LeasedJob
    reported: LeasedJob
    lost: LeasedJob

    def ask(self, method: str, path: str, scope: str | None = "admin", **options: Any) -> Answer:
        """Send a request with a token of a scope."""
        headers = dict(options.pop("headers", {}))
        if scope is not None:
            headers["Authorization"] = f"Bearer {self.tokens[scope]}"
        got = self.client.request(method, path, headers=headers, **options)
        return Answer(status=got.status_code, headers=got.headers, text=got.text)

    def submit(self, body: object, scope: str = "user") -> Answer:
        """Submit a campaign: an object, or the bytes of its JSON."""
        if isinstance(body, bytes):
            headers = {"Content-Type": "application/json"}
            return self.ask("POST", "/api/v1/campaigns", scope, content=body, headers=headers)
        return self.ask("POST", "/api/v1/campaigns", scope, json=body)

    def say(self, what: str, content: object) -> Answer:
        """Say something as a worker: an object, or the bytes of its JSON."""
        path, headers = f"/api/v1/jobs/{what}", {"Content-Type": "application/json"}
        if isinstance(content, bytes):
            return self.ask("POST", path, "worker", content=content, headers=headers)
        return self.ask("POST", path, "worker", json=content)

    def send(self, *parts: bytes, scope: str | None = "admin") -> Answer:
        """Send bytes as they are, with ``AUTH`` replaced by a token's header, and read until the other side ends."""
        token = b"" if scope is None else f"Authorization: Bearer {self.tokens[scope]}\r\n".encode()
        said = b""
        address = ("127.0.0.1", self.client.base_url.port or 0)
        with socket.create_connection(address, timeout=SILENCE_S) as connection:
            with suppress(ConnectionError):  # it may hang up while we are still speaking
                for part in parts:
                    connection.sendall(part.replace(b"AUTH\r\n", token))
            with suppress(ConnectionError):
                while came := connection.recv(65536):
                    said += came
        return _answer(said)


def _answer(said: bytes) -> Answer:
    if not said:
        return Answer(status=0, headers={}, text="")
    head, _, body = said.decode("latin-1").partition("\r\n\r\n")
    first, *lines = head.split("\r\n")
    headers = {name.lower(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
    return Answer(status=int(first.split(" ")[1]), headers=headers, text=body)


Send = Callable[[Target], Iterable[Answer]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Attack:
    """A row of the list.

    Attributes:
        name: What is tried, as `docs/reference/security.md` calls it.
        send: Tries it in each of its forms.
        gets: The statuses that may come; 0 is a connection that is closed without a word.
        says: What each answer's text holds.
        hides: What no answer holds.
        problem: Whether errors are problem+json; what is no HTTP at all is answered below that.
    """

    name: str
    send: Send
    gets: tuple[int, ...]
    says: str = ""
    hides: tuple[str, ...] = ()
    problem: bool = True


def row(name: str, *gets: int, **more: Any) -> Callable[[Send], Attack]:
    """Make an attack of a function."""
    return lambda send: Attack(name=name, send=send, gets=gets, **more)


def everything(engines: Engines) -> dict[str, list[str]]:
    """Return all rows of a database; of workers, which are noted at all."""
    with engines.reader.connect() as connection:
        found = {
            name: sorted(map(repr, connection.execute(select(table))))
            for name, table in Base.metadata.tables.items()
            if name != WorkerRow.__tablename__
        }
        found[WorkerRow.__tablename__] = sorted(connection.execute(select(WorkerRow.id)).scalars())
    return found


def prepare(client: httpx.Client, engines: Engines) -> Target:
    """Fill a coordinator, and then make tokens, so that from now on it serves nobody without."""
    mine, theirs = FakeWorker(client, id="mine"), FakeWorker(client, id="theirs")
    body = ball(seed=1, simulations=20, execution={"keep_traces": 0})
    finished = str(
        expect(client.post("/api/v1/campaigns", json=body, headers={"Idempotency-Key": KEY}), 201)["id"]
    )
    assert mine.work(finished)["status"] == "finished"
    running = submit(client, ball(seed=2, execution={"cache": False}))
    reported, lost, held = (mine.lease(max_jobs=1)[0] for _ in range(3))
    assert mine.report([reported]) == ["accepted"]
    past = datetime.now(UTC) - timedelta(hours=1)
    with engines.writer.begin() as connection:
        connection.execute(update(JobRow).where(JobRow.id == lost.job).values(lease_expires_at=past))

    def taken_back() -> bool:
        with engines.reader.connect() as connection:
            status = connection.execute(select(JobRow.status).where(JobRow.id == lost.job)).scalar_one()
        return status == "queued"

    eventually(taken_back, "the sweeper takes the lease back")
    (again,) = FakeWorker(client, id="third").lease(max_jobs=1)
    assert again.job == lost.job
    submit(client, ball(seed=3, priority=100, execution={"cache": False}))
    (other,) = theirs.lease(max_jobs=1)
    return Target(
        client=client,
        engines=engines,
        tokens=_tokens(engines),
        finished=finished,
        running=running,
        mine=held,
        theirs=other,
        reported=reported,
        lost=lost,
    )


def _tokens(engines: Engines) -> dict[str, str]:
    with engines.writer.begin() as connection:
        made = {str(scope): create_token(connection, scope, str(scope)) for scope in Scope}
        made["revoked"] = create_token(connection, Scope.ADMIN, "revoked")
        made["expired"] = create_token(connection, Scope.ADMIN, "expired")
        revoke_token(connection, parse_token_id(made["revoked"]) or "")
        ended = update(TokenRow).where(TokenRow.id == parse_token_id(made["expired"]))
        connection.execute(ended.values(expires_at=datetime.now(UTC) - timedelta(seconds=1)))
    return made


def outcome_of(job: LeasedJob) -> dict[str, Any]:
    """Return what the simulator makes of a job."""
    return completes(job).model_dump(mode="json")


def results(job: int, token: str, outcome: object, worker: str = "mine") -> dict[str, Any]:
    """Return the report of one outcome."""
    return {"worker": {"id": worker}, "results": [{"job": job, "token": token, "outcome": outcome}]}
