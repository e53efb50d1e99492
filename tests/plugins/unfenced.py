"""Breaks the coordinator that imports it: it then accepts results without a valid lease, like an unfenced queue."""

from typing import Any

from brink.server.queue import report_store


def judge(row: Any, *_: Any) -> str:
    """Accept every result of an existing job."""
    return "stale" if row is None else "accepted"


vars(report_store)["_judge"] = judge
