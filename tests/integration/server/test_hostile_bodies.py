"""Bodies that are made to be expensive: what they cost a coordinator, and that `/healthz` is answered beside them."""

import json
import shutil
import statistics
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest
from support.api import eventually
from support.marks import mostly_long
from support.processes import Site, site

MIB = 1024 * 1024
JSON = {"Content-Type": "application/json"}
SLOWER = 100.0
"""Bound on the slowest answer of `/healthz` beside a hostile body, as a multiple of the usual one of an idle
coordinator. An event loop that parsed 60 MB itself took ten thousand times as long."""
TRIES = 3
"""A busy machine delays an answer now and then; a coordinator that is blocked delays one each time."""
SENDER = """
import http.client, sys
port, path, kind, file = sys.argv[1:]
connection = http.client.HTTPConnection("127.0.0.1", int(port), timeout=120)
connection.request("POST", path, open(file, "rb").read(), {"Content-Type": kind})
answer = connection.getresponse()
print(answer.status, answer.read(2000).decode())
"""
"""A client in a process of its own, so that what it does delays nothing here."""


def flood(size_bytes: int, field: str, item: bytes) -> bytes:
    """Return a message with the same item again and again."""
    head = b'{"worker":{"id":"w"},"' + field.encode() + b'":['
    return head + (item + b",") * (size_bytes // (len(item) + 1)) + item + b"]}"


def result(outcome: bytes) -> bytes:
    """Return one result."""
    return b'{"job":1,"token":"a","outcome":' + outcome + b"}"


def fields(count: int) -> bytes:
    """Return an object with many unknown fields."""
    return b"{" + b",".join(b'"a%d":1' % number for number in range(count)) + b"}"


def with_traces() -> bytes:
    """Return the largest report that is allowed."""
    outcome = b'{"kind":"completed","verdicts":{},"trace":"' + b"A" * 7_900_000 + b'"}'
    return b'{"worker":{"id":"w"},"results":[' + b",".join([result(outcome)] * 7) + b"]}"


def with_verdicts() -> bytes:
    """Return a result with an invalid verdict of each of very many requirements."""
    outcome = b'{"kind":"completed","verdicts":' + fields(90_000) + b"}"
    return b'{"worker":{"id":"w"},"results":[' + result(outcome) + b"]}"


BODIES: dict[str, tuple[str, Callable[[], bytes], int, float]] = {
    "a heartbeat of numbers": ("jobs/heartbeat", lambda: flood(60 * MIB, "leases", b"1"), 413, 1.1),
    "a heartbeat of objects": ("jobs/heartbeat", lambda: flood(60 * MIB, "leases", b"{}"), 413, 1.1),
    "results that are numbers": ("jobs/results", lambda: flood(60 * MIB, "results", b"1"), 413, 1.1),
    "results that are objects": ("jobs/results", lambda: flood(60 * MIB, "results", b"{}"), 413, 1.1),
    "results with large traces": ("jobs/results", with_traces, 200, 2.5),
    "verdicts by the thousand": ("jobs/results", with_verdicts, 422, 2.0),
    "a campaign with unknown fields": ("campaigns", lambda: fields(90_000), 422, 2.0),
    "a campaign file that is a list": ("campaigns/check", lambda: b"- a\n" * 250_000, 422, 2.0),
}
"""Path, body, the status that it gets, and a bound on the memory that it takes, as a multiple of an idle
coordinator's. One that parsed 60 MB of objects took twenty times as much."""


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    with site(tmp_path_factory.mktemp("hostile"), "sqlite:///brink.db") as one:
        yield one


class Healthz:
    """Asks for `/healthz` all the time, and notes how long each answer takes."""

    def __init__(self, url: str) -> None:
        self.taken_s: list[float] = []
        self._url = url
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._ask)

    def __enter__(self) -> "Healthz":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        self._thread.join()

    def _ask(self) -> None:
        with httpx.Client(base_url=self._url, timeout=120) as client:
            while not self._stopping.wait(0.01):
                began_s = time.perf_counter()
                assert client.get("/healthz").status_code == 200
                self.taken_s.append(time.perf_counter() - began_s)


def usual_s(url: str) -> float:
    """Return the usual time to an answer of an idle coordinator."""
    with Healthz(url) as idle:
        eventually(lambda: len(idle.taken_s) >= 20, "an idle coordinator answers")
    return statistics.median(idle.taken_s)


def memory_kib(process: int, entry: str) -> int:
    """Return an entry of what the kernel says of a process' memory."""
    for line in Path(f"/proc/{process}/status").read_text().splitlines():
        name, _, value = line.partition(":")
        if name == entry:
            return int(value.split()[0])
    raise AssertionError(f"no {entry}")


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="measures memory as Linux counts it")
@pytest.mark.parametrize(
    "name",
    mostly_long(BODIES, ["a heartbeat of objects", "verdicts by the thousand"], "measures another body"),
)
def test_a_hostile_body_neither_fills_the_memory_nor_delays_others(
    served: Site, tmp_path: Path, name: str
) -> None:
    path, body, status, memory_bound = BODIES[name]
    file = tmp_path / "body"
    file.write_bytes(body())
    kind = "application/yaml" if path.endswith("check") else JSON["Content-Type"]
    assert served.coordinator is not None
    process = served.coordinator.process.pid
    send = [sys.executable, "-c", SENDER, str(served.port), f"/api/v1/{path}", kind, str(file)]
    usual = usual_s(served.url)
    slowest = []
    for _ in range(TRIES):
        Path(f"/proc/{process}/clear_refs").write_text("5")  # the peak starts again
        before_kib = memory_kib(process, "VmRSS")
        with Healthz(served.url) as beside:
            answer = subprocess.run(send, capture_output=True, text=True, check=True).stdout
        assert answer.startswith(str(status)), answer
        assert memory_kib(process, "VmHWM") <= memory_bound * before_kib
        slowest.append(max(beside.taken_s))
        if slowest[-1] <= SLOWER * usual:
            return
    pytest.fail(f"{slowest} s beside it, {usual} s without")


def sent_by_httpx(url: str, body: bytes, *, chunked: bool) -> tuple[int, str]:
    """Post a body; return the status and the answer."""
    answer = httpx.post(url, content=parts(body) if chunked else body, headers=JSON, timeout=60)
    return answer.status_code, answer.text


def sent_by_requests(url: str, body: bytes, *, chunked: bool) -> tuple[int, str]:
    """Post a body; return the status and the answer."""
    requests = pytest.importorskip("requests", reason="others install it")
    answer = requests.post(url, data=parts(body) if chunked else body, headers=JSON, timeout=60)
    return answer.status_code, answer.text


def sent_by_urllib(url: str, body: bytes, *, chunked: bool) -> tuple[int, str]:
    """Post a body; return the status and the answer."""
    asked = urllib.request.Request(url, parts(body) if chunked else body, JSON, method="POST")
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(asked, timeout=60)
    with refused.value as answer:
        return answer.code, answer.read().decode()


def sent_by_curl(url: str, body: bytes, *, chunked: bool) -> tuple[int, str]:
    """Post a body; return the status and the answer."""
    if shutil.which("curl") is None:
        pytest.skip("needs curl")
    more = (
        ["-H", "Transfer-Encoding: chunked"] if chunked else ["-H", "Expect:"]
    )  # send it without asking first
    command = ["curl", "-sS", "-w", "\n%{http_code}", "-H", f"Content-Type: {JSON['Content-Type']}", *more]
    said = subprocess.run([*command, "--data-binary", "@-", url], input=body, capture_output=True, check=True)
    text, _, status = said.stdout.decode().rpartition("\n")
    return int(status), text


def parts(body: bytes) -> Iterator[bytes]:
    """Return a body in pieces, so that its length is not known beforehand."""
    return (body[start : start + 65536] for start in range(0, len(body), 65536))


@pytest.mark.parametrize("chunked", [False, True], ids=["with its length", "in chunks"])
@pytest.mark.parametrize(
    "send",
    mostly_long(
        [sent_by_httpx, sent_by_requests, sent_by_urllib, sent_by_curl], [sent_by_httpx], "another client"
    ),
)
def test_ordinary_clients_read_that_a_body_is_too_large(
    served: Site, send: Callable[..., tuple[int, str]], chunked: bool
) -> None:
    body = b" " * (70 * MIB)
    status, answer = send(f"{served.url}/api/v1/campaigns", body, chunked=chunked)
    assert status == 413
    assert "at most 4194304 bytes" in json.loads(answer)["detail"]
