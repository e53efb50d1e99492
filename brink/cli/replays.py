"""Replays: an episode's trace, from the coordinator or from a run in this process, drawn to a file."""

import asyncio
import contextlib
from pathlib import Path
from typing import Any

from brink.api.client import Api, CoordinatorSaid
from brink.server.errors import ServerError
from brink.sim.replay import render
from brink.sim.trace import Trace
from brink.worker.codec import from_wire
from brink.worker.process import EpisodeProcess
from brink.worker.wire import JobFailed

ASK_AGAIN_S = 0.5
EPISODE_S = 120.0


class NoTrace(ServerError):
    """The trace of a solution cannot be had."""


async def fetch_trace(api: Api, campaign_id: str, number: int, patience_s: float) -> Trace:
    """Return the trace of a solution, which workers make if it was not kept.

    Raises:
        NoTrace: No worker made it in time.
        CoordinatorSaid: There is no such solution, or its trace cannot be made.
    """
    deadline = asyncio.get_running_loop().time() + patience_s
    path = f"/campaigns/{campaign_id}/solutions/{number}/trace"
    while True:
        response = await api.request("GET", path, params={"wait_s": min(20.0, patience_s)})
        if response.status_code == 200:
            return Trace.from_bytes(response.content)
        if asyncio.get_running_loop().time() >= deadline:
            raise NoTrace(
                f"no worker made the trace of solution {number} in {patience_s:g} s; is one running?"
            )
        await asyncio.sleep(ASK_AGAIN_S)


async def run_again(api: Api, campaign_id: str, number: int) -> Trace:
    """Return the trace of a solution by running its episode on this machine.

    Raises:
        NoTrace: The problem has no episodes, or this one failed here.
    """
    solution: dict[str, Any] = await api.get(f"/campaigns/{campaign_id}/solutions/{number}")
    if solution["spec"] is None:
        raise NoTrace(f"solution {number} was not simulated: there is nothing to replay")

    def run() -> Trace:
        with contextlib.closing(EpisodeProcess()) as process:
            process.start()
            outcome = process.run(solution["spec"], record=True, timeout_s=EPISODE_S)
        if isinstance(outcome, JobFailed):
            raise NoTrace(f"the episode of solution {number} failed here: {outcome.message}")
        trace = from_wire(outcome).trace
        if trace is None:
            raise NoTrace(f"the simulator of solution {number} records no trace")
        return Trace.from_bytes(trace)

    return await asyncio.to_thread(run)


async def write_replays(
    api: Api, campaign_id: str, numbers: list[int], folder: Path, *, stop: asyncio.Event, patience_s: float
) -> list[Path]:
    """Draw the replays of some solutions as PNG; those that cannot be had are left out."""
    files = []
    requirement = await requirement_of(api, campaign_id)
    for number in numbers:
        if stop.is_set():
            break
        try:
            trace = await fetch_trace(api, campaign_id, number, patience_s)
        except (NoTrace, CoordinatorSaid):
            continue
        path = folder / f"replay-{number}.png"
        await asyncio.to_thread(render, trace, path, requirement=requirement)
        files.append(path)
    return files


async def requirement_of(api: Api, campaign_id: str) -> str | None:
    """Return the requirement that gives a campaign's verdict; None if several do."""
    params = (await api.get(f"/campaigns/{campaign_id}"))["body"]["problem"]["params"]
    return str(params["requirement"]) if "requirement" in params else None
