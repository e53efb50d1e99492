"""A campaign's results, fetched over the API: its archive, its pairs, and traces of its episodes."""

import asyncio
import contextlib
import io
from dataclasses import dataclass
from typing import Final

import numpy as np

from brink.api.client import Api, CoordinatorError, Missing
from brink.search.archive import ARRAYS, Archive
from brink.search.errors import TooManyPairs
from brink.search.space import BoolArray, IntArray
from brink.server.api.schemas import CampaignView, OutcomesView
from brink.server.campaigns.body import CampaignBody
from brink.server.campaigns.outcomes import deciding_requirements
from brink.server.campaigns.plan import Plan, make_plan
from brink.server.errors import ServerError
from brink.server.findings.pairs.views import MOST_PAIRS, PairsView, PairView
from brink.server.views import SolutionView
from brink.sim.errors import SimulatorError
from brink.sim.trace import Trace
from brink.worker.errors import WorkerError
from brink.worker.process import EpisodeProcess, episode_result
from brink.worker.wire import JobFailed

POLL_S = 0.5
EPISODE_TIMEOUT_S = 120.0
TRACE_TIMEOUT_S = 120.0


class NoTrace(ServerError):
    """The trace of a solution is not available."""


class NothingToReplay(NoTrace):
    """A solution was not simulated, or its simulator records no traces."""


UNDRAWABLE: Final = (
    NoTrace,
    CoordinatorError,
    SimulatorError,
    WorkerError,
    LookupError,
    ValueError,
    TypeError,
    ArithmeticError,
)
"""Why a drive has no picture: a simulator may record anything, so a picture that fails is noted and left out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FetchedArchive:
    """The archive of a campaign, fetched over the API.

    Attributes:
        id: Full id of the campaign.
        body: The campaign file.
        plan: Problem and algorithm of the campaign.
        archive: All evaluated solutions.
        active: Which parameters were active in each episode, shape ``(n, d)``; None from an older coordinator.
        seeds: Episode seed of each solution, shape ``(n,)``; None from an older coordinator.
        digests: Digest of the episode of each solution, empty if it had none; None from an older coordinator.
        generations: Size of the archive after each generation.
        outcomes: What the simulations showed about all requirements, for each solution of the archive.
        simulator: The simulator, such as ``brink-drive@3``; None if nothing was simulated, or from an older
            coordinator.
    """

    id: str
    body: CampaignBody
    plan: Plan
    archive: Archive
    active: BoolArray | None
    seeds: IntArray | None
    digests: tuple[str, ...] | None
    generations: tuple[int, ...]
    outcomes: OutcomesView
    simulator: str | None = None


async def fetch_archive(api: Api, campaign: str) -> FetchedArchive:
    """Return the archive of a campaign.

    Raises:
        CoordinatorError: The campaign does not exist.
    """
    view = await api.read(CampaignView, f"/campaigns/{campaign}")
    response = await api.request("GET", f"/campaigns/{campaign}/archive.npz")
    with np.load(io.BytesIO(response.content), allow_pickle=False) as npz:
        arrays = {name: npz[name] for name in npz.files}
    outcomes = await api.read(OutcomesView, f"/campaigns/{campaign}/outcomes", {"solutions": True})
    plan = make_plan(view.body)
    archive = Archive.restore(
        plan.problem.space, plan.neighbourhood, **{name: arrays[name] for name in ARRAYS}
    )
    generations = arrays["generations"]
    ends = np.searchsorted(generations, np.unique(generations), side="right")
    return FetchedArchive(
        id=view.id,
        body=view.body,
        plan=plan,
        archive=archive,
        active=arrays.get("active"),
        seeds=arrays.get("seeds"),
        digests=tuple(arrays["digests"].tolist()) if "digests" in arrays else None,
        generations=tuple(int(end) for end in ends),
        outcomes=outcomes,
        simulator=view.simulator,
    )


async def read_all_pairs(api: Api, campaign: str) -> PairsView | TooManyPairs:
    """Return the pairs of a campaign, up to the limit of a list, or a note that there are too many to tell apart.

    Raises:
        CoordinatorError: The campaign does not exist.
    """
    try:
        return await api.read(PairsView, f"/campaigns/{campaign}/pairs", {"limit": MOST_PAIRS})
    except CoordinatorError as error:
        for setting in ("eps", "d_th"):
            if [one.pointer for one in error.errors] == [f"/query/{setting}"]:  # neither was given
                return TooManyPairs(error.errors[0].message, setting=setting)
        raise


def find_pair(view: PairsView, number: int) -> PairView | None:
    """Return the pair with a number; None if it is not among the fetched ones."""
    return next((pair for pair in view.pairs if pair.place == number), None)


async def trace_of(api: Api, campaign: str, number: int, *, workers: bool) -> Trace:
    """Return the trace of a solution: the kept one, or else one from the coordinator's workers or from this machine.

    Raises:
        NoTrace: No worker ran the episode in time, or it failed on this machine.
        CoordinatorError: The solution does not exist, or its episode cannot be run again.
    """
    if workers:
        return await fetch_trace(api, campaign, number, TRACE_TIMEOUT_S)
    return await run_episode(api, campaign, number)


async def fetch_trace(api: Api, campaign: str, number: int, timeout_s: float) -> Trace:
    """Return the trace of a solution. If it was not kept, have a worker run the episode again.

    Args:
        api: Coordinator of the campaign.
        campaign: Id of the campaign.
        number: Number of the solution.
        timeout_s: How long to wait for a worker.

    Raises:
        NoTrace: No worker ran the episode in time.
        CoordinatorError: The solution does not exist, or its episode cannot be run again.
    """
    deadline = asyncio.get_running_loop().time() + timeout_s
    path = f"/campaigns/{campaign}/solutions/{number}/trace"
    while True:
        try:
            response = await api.request("GET", path, params={"wait_s": min(20.0, timeout_s)})
        except Missing:  # the trace, or the solution
            response = await api.request("POST", path)
        if response.status_code == 200:
            return Trace.from_bytes(response.content)
        if asyncio.get_running_loop().time() >= deadline:
            raise NoTrace(
                f"no worker provided the trace of solution {number} within {timeout_s:g} s; is a worker running?"
            )
        await asyncio.sleep(POLL_S)


async def run_episode(api: Api, campaign: str, number: int) -> Trace:
    """Return the trace of a solution. If it was not kept, run its episode on this machine.

    A kept trace is also that of a simulator that this machine no longer has.

    Args:
        api: Coordinator of the campaign.
        campaign: Id of the campaign.
        number: Number of the solution.

    Raises:
        NoTrace: The solution was not simulated, or its episode failed on this machine.
    """
    # The request is refused if no trace is kept, if none could be recorded, or if there is no such solution.
    with contextlib.suppress(CoordinatorError):
        kept = await api.request(
            "GET", f"/campaigns/{campaign}/solutions/{number}/trace", params={"wait_s": 0.0}
        )
        if kept.status_code == 200:
            return Trace.from_bytes(kept.content)
    body = (await api.read(CampaignView, f"/campaigns/{campaign}")).body
    spec = (await api.read(SolutionView, f"/campaigns/{campaign}/solutions/{number}")).spec
    problem = make_plan(body).problem
    if not (problem.records_traces or problem.records_signals):
        raise NothingToReplay(f"{problem.id} has no drives to replay")
    if spec is None:
        raise NothingToReplay(f"solution {number} was not simulated: it has no replay")

    def run() -> Trace:
        with contextlib.closing(EpisodeProcess()) as process:
            process.start()
            outcome = process.run(spec, record=True, timeout_s=EPISODE_TIMEOUT_S)
        if isinstance(outcome, JobFailed):
            raise NoTrace(f"the episode of solution {number} failed on this machine: {outcome.message}")
        trace = episode_result(outcome).trace
        if trace is None:
            raise NothingToReplay(f"the simulator of solution {number} records no traces")
        return Trace.from_bytes(trace)

    return await asyncio.to_thread(run)


async def fetch_requirements(api: Api, campaign: str) -> tuple[str, ...] | None:
    """Return the requirements that decide the verdicts of a campaign; None if they are unknown."""
    body = (await api.read(CampaignView, f"/campaigns/{campaign}")).body
    return deciding_requirements(body) or None
