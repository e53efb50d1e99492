"""What stands before every request: the bearer token, and the bound on bodies."""

import re
import socket
from collections.abc import Iterator

import httpx
import pytest
from pydantic import SecretStr, ValidationError
from support.api import ball, coordinator, expect

from brink.server.db.engine import parse_url
from brink.server.errors import DatabaseError
from brink.server.runtime import request_timeout
from brink.server.runtime.coordinator import CannotListen, listen
from brink.server.settings import Settings

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


@pytest.mark.parametrize("path", ["campaigns", "jobs/lease", "jobs/results"])
@pytest.mark.parametrize("chunked", [False, True])
def test_a_body_past_the_bound_is_refused(
    database_url: str, small_problems: None, chunked: bool, path: str
) -> None:
    with coordinator(database_url, max_body_bytes=2000) as client:
        expect(client.post("/api/v1/campaigns", json=ball()), 201)
        body = b" " * 2001
        content = (body[start : start + 500] for start in range(0, len(body), 500)) if chunked else body
        answer = client.post(f"/api/v1/{path}", content=content, headers={"Content-Type": "application/json"})
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


ELSEWHERE = {
    "another site's page changes something": (403, "POST", {"Origin": "http://evil.example"}),
    "a page without a site does": (403, "POST", {"Origin": "null"}),
    "another port's page does": (403, "POST", {"Origin": "http://127.0.0.1:1"}),
    "another site's page asks for a picture": (
        403, "GET", {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"},
    ),
    "a name that points here": (421, "GET", {"Host": "evil.example"}),
    "a name that begins like ours": (421, "GET", {"Host": "127.0.0.1.evil.example"}),
    "no name": (421, "GET", {"Host": ""}),
    "somebody follows a link": (
        200, "GET", {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"},
    ),
    "our own page": (201, "POST", {"Sec-Fetch-Site": "same-origin"}),
    "another of our names": (200, "GET", {"Host": "localhost:1"}),
    "a name of version 6": (200, "GET", {"Host": "[::1]:1"}),
}  # fmt: skip


@pytest.mark.parametrize(("status", "method", "headers"), ELSEWHERE.values(), ids=ELSEWHERE)
def test_without_tokens_no_page_of_another_site_is_served(
    client: httpx.Client, status: int, method: str, headers: dict[str, str]
) -> None:
    answer = client.request(method, "/api/v1/campaigns", json=ball(), headers=headers)
    assert answer.status_code == status, answer.text
    assert len(expect(client.get("/api/v1/campaigns"))["campaigns"]) == (status == 201)


def test_our_own_origin_may_change_things(client: httpx.Client) -> None:
    own = {"Origin": str(client.base_url).rstrip("/")}
    expect(client.post("/api/v1/campaigns", json=ball(), headers=own), 201)


def test_with_tokens_a_proxy_may_call_the_coordinator_what_it_likes(guarded: httpx.Client) -> None:
    headers = {"Host": "brink.example", "Origin": "https://brink.example"}
    expect(guarded.post("/api/v1/campaigns", json=ball(), headers=headers), 201)


def test_a_path_with_a_slash_at_its_end_is_another_one(client: httpx.Client) -> None:
    answer = client.get("/api/v1/campaigns/", headers={"Host": "localhost:1"})
    assert answer.status_code in (404, 405), "and sends nobody to a host of the client's choice"
    assert "location" not in answer.headers


HEAD = b"POST /api/v1/campaigns HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
STALLED = {
    "nothing": (b"", b""),
    "half a head": (HEAD, b""),
    "half of a second head": (b"GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n" + HEAD, b"ok\n"),
    "less than was announced": (HEAD + b"Content-Length: 100\r\n\r\n{", b" 408 "),
    "chunks without an end": (HEAD + b"Transfer-Encoding: chunked\r\n\r\n1\r\n{\r\n", b" 408 "),
    "a body that nobody reads": (
        HEAD.replace(b"campaigns", b"nothing") + b"Content-Length: 100\r\n\r\n{", b" 40",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("sent", "answered"), STALLED.values(), ids=STALLED)
def test_a_request_that_does_not_come_is_not_waited_for(
    database_url: str, small_problems: None, monkeypatch: pytest.MonkeyPatch, sent: bytes, answered: bytes
) -> None:
    monkeypatch.setattr(request_timeout, "LINGER_S", 0.2)
    with (
        coordinator(database_url, stall_s=0.3) as client,
        socket.create_connection(("127.0.0.1", client.base_url.port or 0), timeout=20) as connection,
    ):
        connection.sendall(sent)
        said = b"".join(iter(lambda: connection.recv(65536), b""))  # until the coordinator hangs up
        assert answered in said
        assert expect(client.get("/api/v1/campaigns"))["campaigns"] == []


def test_who_waits_for_work_may_wait_longer_than_a_request_may_take(
    database_url: str, small_problems: None
) -> None:
    with coordinator(database_url, stall_s=0.2) as client:
        body = {"worker": {"id": "w"}, "capabilities": ["x"], "wait_s": 0.8}
        assert expect(client.post("/api/v1/jobs/lease", json=body))["jobs"] == []
        assert client.get("/healthz").status_code == 200
