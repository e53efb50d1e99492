"""Breaks the coordinator that imports it: results are taken whatever their lease, as by queues without fences."""

from typing import Any

from brink.server.queue import report_store


def judge(row: Any, *_: Any) -> str:
    """Take every result of a job that there is."""
    return "stale" if row is None else "accepted"


vars(report_store)["_status_of"] = judge
