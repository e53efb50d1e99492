"""Workers without a simulator: clients that lease and report over HTTP as fast as the coordinator answers.

A small client over asyncio's streams: a full one costs more than the coordinator that is to be measured.
"""

import asyncio
import json
import os
import time
from types import TracebackType
from typing import Any, Self
from urllib.parse import urlsplit

from brink.bench.load.problem import LOAD, REQUIREMENT
from brink.worker.wire import machine_name

OUTCOME = {
    "kind": "completed",
    "verdicts": {REQUIREMENT: {"robustness": 0.5, "unit": "m", "violated_at_s": None}},
    "objectives": {"distance": 1.5},
}


class LoadClient:
    """One worker with one kept-alive connection.

    Args:
        url: Of the coordinator.
        name: Id of the worker.
        max_jobs: Most jobs that it asks for.
        wait_s: How long it lets the coordinator wait for jobs.
    """

    def __init__(self, url: str, name: str, *, max_jobs: int = 1, wait_s: float = 20.0) -> None:
        parts = urlsplit(url)
        self._host, self._port = parts.hostname or "", parts.port or 80
        worker = {"id": name, "host": "bench", "machine": machine_name(), "pid": os.getpid()}
        self._lease = {
            "worker": worker, "capabilities": [LOAD], "max_jobs": max_jobs, "wait_s": wait_s,
        }  # fmt: skip
        self.times_s: list[float] = []

    async def __aenter__(self) -> Self:
        self._reader, self._writer = await asyncio.open_connection(self._host, self._port)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, stack: TracebackType | None
    ) -> None:
        self._writer.close()

    async def lease(self) -> list[dict[str, Any]]:
        """Ask for jobs."""
        reply = await self._post("lease", self._lease)
        jobs: list[dict[str, Any]] = reply["jobs"]
        return jobs

    async def report(
        self, jobs: list[dict[str, Any]], outcome: dict[str, Any] = OUTCOME
    ) -> list[dict[str, Any]]:
        """Report jobs as completed, and ask for the next; note how long that took if it gave some.

        Raises:
            RuntimeError: The coordinator did not take them.
        """
        results = [{"job": job["job"], "token": job["token"], "outcome": outcome} for job in jobs]
        began = time.perf_counter()
        reply = await self._post(
            "results", {"worker": self._lease["worker"], "results": results, "lease": self._lease}
        )
        statuses = {status["status"] for status in reply["statuses"]}
        if statuses - {"accepted"}:
            raise RuntimeError(f"expected that all results are accepted, got {statuses}")
        granted: list[dict[str, Any]] = reply["lease"]["jobs"]
        if granted:
            self.times_s.append(time.perf_counter() - began)
        return granted

    async def _post(self, name: str, message: dict[str, Any]) -> Any:
        body = json.dumps(message, separators=(",", ":")).encode()
        head = (
            f"POST /api/v1/jobs/{name} HTTP/1.1\r\nHost: {self._host}\r\nContent-Type: application/json\r\n"
            f"Content-Length: {len(body)}\r\n\r\n"
        )
        self._writer.write(head.encode() + body)
        headers = (await self._reader.readuntil(b"\r\n\r\n")).lower()
        length = int(headers.partition(b"content-length:")[2].partition(b"\r\n")[0])
        answer = await self._reader.readexactly(length)
        if not headers.startswith(b"http/1.1 200"):
            raise RuntimeError(f"expected 200, got {headers.splitlines()[0]!r}: {answer[:500]!r}")
        return json.loads(answer)
