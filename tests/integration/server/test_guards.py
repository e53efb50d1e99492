"""The guards before every request: bearer token, origin, size limit, request timeout, number of connections."""

import contextlib
import re
import socket
import sys
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path

import httpx
import pytest
from pydantic import SecretStr, ValidationError
from support.api import ball, eventually, expect, listening_coordinator, row_counts

from benchmarks.processes import Process, free_port
from brink.server.db.engine import Engines, parse_url
from brink.server.errors import DatabaseError
from brink.server.runtime import request_timeout
from brink.server.runtime.coordinator import CannotListen, listen
from brink.server.settings import Settings

SECRET = "correct-horse"

# A request that a guard turns away reaches no database.
pytestmark = pytest.mark.usefixtures("databases")


@pytest.fixture
def guarded(database_url: str, small_problems: None) -> Iterator[httpx.Client]:
    with listening_coordinator(database_url, token=SECRET) as client:
        yield client


def test_request_with_the_token_is_answered(guarded: httpx.Client) -> None:
    expect(guarded.post("/api/v1/campaigns", json=ball()), 201)
    assert guarded.get("/metrics").status_code == 200


def test_health_needs_no_token(guarded: httpx.Client) -> None:
    with httpx.Client(base_url=guarded.base_url) as stranger:
        assert stranger.get("/healthz").status_code == 200
        assert stranger.get("/readyz").status_code == 200


def test_api_description_needs_neither_token_nor_internet(guarded: httpx.Client) -> None:
    with httpx.Client(base_url=guarded.base_url, timeout=30.0) as stranger:
        assert "/api/v1/jobs/lease" in stranger.get("/openapi.json").json()["paths"]
        page = stranger.get("/docs").text
        files = re.findall(r'(?:src|href)="([^"]+)"', page)
        assert len(files) >= 2
        for file in files:
            assert file.startswith("/docs-files/")
            assert stranger.get(file).status_code == 200


@pytest.mark.parametrize("token", ["schlüssel", "two words", "line\n"])
def test_token_outside_printable_ascii_is_rejected(token: str) -> None:
    with pytest.raises(ValidationError, match="printable ASCII"):
        Settings(token=SecretStr(token))


@pytest.mark.parametrize("path", ["campaigns", "jobs/lease", "jobs/results"])
@pytest.mark.parametrize("chunked", [False, True])
def test_oversized_body_is_rejected(
    database_url: str, small_problems: None, chunked: bool, path: str
) -> None:
    with listening_coordinator(database_url, max_body_bytes=2000) as client:
        expect(client.post("/api/v1/campaigns", json=ball()), 201)
        body = b" " * 2001
        content = (body[start : start + 500] for start in range(0, len(body), 500)) if chunked else body
        answer = client.post(f"/api/v1/{path}", content=content, headers={"Content-Type": "application/json"})
        assert answer.status_code == 413, answer.text
        assert "2000 bytes" in answer.json()["detail"]
        assert len(expect(client.get("/api/v1/campaigns"))["campaigns"]) == 1


@pytest.mark.parametrize("token", [None, ""])
def test_listening_on_the_network_needs_a_token(monkeypatch: pytest.MonkeyPatch, token: str | None) -> None:
    if token is not None:
        monkeypatch.setenv("BRINK_TOKEN", token)
    with pytest.raises(CannotListen, match="BRINK_TOKEN"):
        listen(Settings(host="0.0.0.0", port=0))


def test_port_in_use_names_the_option_to_change_it() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(CannotListen, match="--port"):
        listen(Settings(port=taken.getsockname()[1]))


def test_listening_socket_disables_nagles_algorithm() -> None:
    with listen(Settings(port=0)) as listener:
        # asyncio disables it only on sockets that name their protocol.
        assert listener.proto == socket.IPPROTO_TCP


@pytest.mark.parametrize("url", ["brink.db", "mysql://x/y", "sqlite://", "sqlite:///:memory:", "://"])
def test_unsupported_database_url_is_rejected(url: str) -> None:
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
def test_message_about_a_malformed_database_url_hides_the_password(url: str) -> None:
    with pytest.raises(DatabaseError, match="database URL") as caught:
        parse_url(url)
    assert "s3cret" not in str(caught.value)


ELSEWHERE = {
    "another site's page sends a change": (403, "POST", {"Origin": "http://evil.example"}),
    "a page without an origin sends a change": (403, "POST", {"Origin": "null"}),
    "a page on another port sends a change": (403, "POST", {"Origin": "http://127.0.0.1:1"}),
    "another site's page embeds a picture": (
        403,
        "GET",
        {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"},
    ),
    "another host name": (421, "GET", {"Host": "evil.example"}),
    "a host name that begins with the loopback address": (421, "GET", {"Host": "127.0.0.1.evil.example"}),
    "no host name": (421, "GET", {"Host": ""}),
    "a link is followed": (200, "GET", {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}),
    "the dashboard sends a change": (201, "POST", {"Sec-Fetch-Site": "same-origin"}),
    "another loopback name": (200, "GET", {"Host": "localhost:1"}),
    "the loopback address of IPv6": (200, "GET", {"Host": "[::1]:1"}),
}


@pytest.mark.parametrize(("status", "method", "headers"), ELSEWHERE.values(), ids=ELSEWHERE)
def test_without_tokens_requests_from_other_sites_are_rejected(
    client: httpx.Client, status: int, method: str, headers: dict[str, str]
) -> None:
    answer = client.request(method, "/api/v1/campaigns", json=ball(), headers=headers)
    assert answer.status_code == status, answer.text
    assert len(expect(client.get("/api/v1/campaigns"))["campaigns"]) == (status == 201)


def test_change_from_the_same_origin_is_accepted(client: httpx.Client) -> None:
    own = {"Origin": str(client.base_url).rstrip("/")}
    expect(client.post("/api/v1/campaigns", json=ball(), headers=own), 201)


def test_with_tokens_any_host_name_is_accepted(guarded: httpx.Client) -> None:
    headers = {"Host": "brink.example", "Origin": "https://brink.example"}
    expect(guarded.post("/api/v1/campaigns", json=ball(), headers=headers), 201)


HEAD = b"POST /api/v1/campaigns HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
STALLED = {
    "nothing": (b"", b""),
    "half a head": (HEAD, b""),
    "half of a second request's head": (b"GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n" + HEAD, b"ok\n"),
    "a body shorter than its length": (HEAD + b"Content-Length: 100\r\n\r\n{", b" 408 "),
    "chunks without an end": (HEAD + b"Transfer-Encoding: chunked\r\n\r\n1\r\n{\r\n", b" 408 "),
    "an incomplete body for an unknown path": (
        HEAD.replace(b"campaigns", b"nothing") + b"Content-Length: 100\r\n\r\n{",
        b" 40",
    ),
}


@pytest.mark.parametrize(("sent", "answered"), STALLED.values(), ids=STALLED)
def test_stalled_request_times_out(
    database_url: str,
    engines: Engines,
    small_problems: None,
    monkeypatch: pytest.MonkeyPatch,
    sent: bytes,
    answered: bytes,
) -> None:
    monkeypatch.setattr(request_timeout, "LINGER_S", 0.2)
    with (
        listening_coordinator(database_url, stall_s=0.3) as client,
        socket.create_connection(("127.0.0.1", client.base_url.port or 0), timeout=20) as connection,
    ):
        connection.sendall(sent)
        received = b"".join(iter(lambda: connection.recv(65536), b""))  # until the coordinator closes
        assert answered in received
    assert row_counts(engines)["campaigns"] == 0


def test_long_poll_may_outlast_the_request_timeout(database_url: str, small_problems: None) -> None:
    with listening_coordinator(database_url, stall_s=1.0) as client:
        body = {"worker": {"id": "w"}, "capabilities": ["x"], "wait_s": 2.0}
        assert expect(client.post("/api/v1/jobs/lease", json=body))["jobs"] == []
        assert client.get("/healthz").status_code == 200


FEW = 128
MANY = 300


@pytest.mark.long("starts a coordinator process and opens hundreds of connections")
def test_coordinator_raises_its_limit_of_open_files(tmp_path: Path) -> None:
    port = free_port()
    serve = [
        str(Path(sys.executable).with_name("brink")),
        "serve",
        "--database",
        f"sqlite:///{tmp_path}/a.db",
        "--port",
        str(port),
    ]
    process = Process(["/bin/sh", "-c", f'ulimit -S -n {FEW}; exec "$@"', "sh", *serve], tmp_path / "log", {})
    process.start()

    def ready() -> bool:
        with contextlib.suppress(httpx.TransportError):
            return httpx.get(f"http://127.0.0.1:{port}/readyz").status_code == 200
        return False

    try:
        eventually(ready, "it serves")
        with contextlib.ExitStack() as stack:
            workers = [
                stack.enter_context(contextlib.closing(HTTPConnection("127.0.0.1", port, timeout=10)))
                for _ in range(MANY)
            ]
            for worker in workers:  # every connection stays open
                worker.request("GET", "/healthz")
                assert worker.getresponse().read() == b"ok\n"
    finally:
        process.kill()
