"""Hundreds of workers wait on a connection each."""

import contextlib
import sys
from http.client import HTTPConnection
from pathlib import Path

import httpx
from support.api import eventually

from brink.bench.temporary.coordinator import Process, free_port

FEW = 128
MANY = 300


def test_more_connections_are_served_than_files_may_be_open_unasked(tmp_path: Path) -> None:
    port = free_port()
    serve = [
        str(Path(sys.executable).with_name("brink")), "serve", "--database", f"sqlite:///{tmp_path}/a.db",
        "--port", str(port),
    ]  # fmt: skip
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
            for worker in workers:  # each keeps its connection
                worker.request("GET", "/healthz")
                assert worker.getresponse().read() == b"ok\n"
    finally:
        process.kill()
