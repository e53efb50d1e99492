"""What stands before every request: the bearer token, and the bound on bodies."""

import re
import socket
from collections.abc import Iterator

import httpx
import pytest
from pydantic import SecretStr, ValidationError
from support.api import ball, coordinator, expect

from server.cli.coordinator import CannotListen, listen
from server.db.engine import parse_url
from server.errors import DatabaseError
from server.settings import Settings

SECRET = "correct-horse"


@pytest.fixture
def guarded(database_url: str, small_problems: None) -> Iterator[httpx.Client]:
    with coordinator(database_url, token=SECRET) as client:
        yield client


@pytest.mark.parametrize("header", [None, "Bearer wrong", "Basic correct-horse", "bearer", SECRET])
def test_without_the_token_nothing_is_answered(guarded: httpx.Client, header: str | None) -> None:
    with httpx.Client(base_url=guarded.base_url) as stranger:
        headers = {"Authorization": header} if header else {}
        for path in ("/api/v1/campaigns", "/metrics", "/nothing", "/docs-files", "/docs/x"):
            answer = stranger.get(path, headers=headers)
            assert answer.status_code == 401, path
            assert answer.headers["WWW-Authenticate"] == "Bearer"
            assert answer.headers["content-type"] == "application/problem+json"
        assert stranger.post("/api/v1/campaigns", json=ball(), headers=headers).status_code == 401


def test_with_the_token_everything_is_answered(guarded: httpx.Client) -> None:
    expect(guarded.post("/api/v1/campaigns", json=ball()), 201)
    assert guarded.get("/metrics").status_code == 200


def test_health_needs_no_token(guarded: httpx.Client) -> None:
    with httpx.Client(base_url=guarded.base_url) as stranger:
        assert stranger.get("/healthz").status_code == 200
        assert stranger.get("/readyz").status_code == 200


def test_the_description_of_the_api_needs_neither_token_nor_internet(guarded: httpx.Client) -> None:
    with httpx.Client(base_url=guarded.base_url) as stranger:
        assert "/api/v1/jobs/lease" in stranger.get("/openapi.json").json()["paths"]
        page = stranger.get("/docs").text
        files = re.findall(r'(?:src|href)="([^"]+)"', page)
        assert len(files) >= 2
        for file in files:
            assert file.startswith("/docs-files/")
            assert stranger.get(file).status_code == 200


@pytest.mark.parametrize("token", ["schlüssel", "two words", "line\n"])
def test_a_token_that_no_header_can_carry_is_refused(token: str) -> None:
    with pytest.raises(ValidationError, match="printable ASCII"):
        Settings(token=SecretStr(token))


@pytest.mark.parametrize("chunked", [False, True])
def test_a_body_past_the_bound_is_refused(database_url: str, small_problems: None, chunked: bool) -> None:
    with coordinator(database_url, max_body_bytes=2000) as client:
        expect(client.post("/api/v1/campaigns", json=ball()), 201)
        body = b" " * 2001
        content = (body[start : start + 500] for start in range(0, len(body), 500)) if chunked else body
        answer = client.post(
            "/api/v1/campaigns", content=content, headers={"Content-Type": "application/json"}
        )
        assert answer.status_code == 413, answer.text
        assert "2000 bytes" in answer.json()["detail"]
        assert len(expect(client.get("/api/v1/campaigns"))["campaigns"]) == 1


@pytest.mark.parametrize("token", [None, ""])
def test_other_machines_are_not_let_in_without_a_token(
    monkeypatch: pytest.MonkeyPatch, token: str | None
) -> None:
    if token is not None:
        monkeypatch.setenv("BRINK_TOKEN", token)
    with pytest.raises(CannotListen, match="BRINK_TOKEN"):
        listen(Settings(host="0.0.0.0", port=0))


def test_a_port_in_use_is_told() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(CannotListen, match="--port"):
        listen(Settings(port=taken.getsockname()[1]))


def test_answers_do_not_wait_for_acknowledgements() -> None:
    with listen(Settings(port=0)) as listener:
        # asyncio turns Nagle's algorithm off only on sockets that name their protocol.
        assert listener.proto == socket.IPPROTO_TCP


@pytest.mark.parametrize("url", ["brink.db", "mysql://x/y", "sqlite://", "sqlite:///:memory:", "://"])
def test_a_database_that_cannot_be_used_is_told(url: str) -> None:
    with pytest.raises(DatabaseError, match="database URL"):
        parse_url(url)


@pytest.mark.parametrize(
    "url",
    [
        "postgres//brink:s3cret:s3cret@s3cret@db/brink",
        "postgresql://brink:s3cret@db:port/brink",
        "mysql://brink:s3cret@db/brink",
        "postgresql:/db/brink?password=s3cret",
    ],
)
def test_a_url_that_cannot_be_read_is_told_without_its_password(url: str) -> None:
    with pytest.raises(DatabaseError, match="database URL") as told:
        parse_url(url)
    assert "s3cret" not in str(told.value)
