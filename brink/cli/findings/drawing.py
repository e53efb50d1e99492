"""What drawing findings takes: the coordinator to ask for traces, a folder, and how long to wait."""

import asyncio
from dataclasses import dataclass
from pathlib import Path

from brink.api.client import Api


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawing:
    """Where pictures of findings come from and go to.

    Attributes:
        api: The coordinator.
        campaign: Whose findings.
        folder: Where pictures go.
        stop: Set when nothing more is wanted.
        patience_s: How long to wait for a trace.
    """

    api: Api
    campaign: str
    folder: Path
    stop: asyncio.Event
    patience_s: float
