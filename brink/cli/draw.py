"""`brink plot` and `brink replay`, and how other commands fetch and draw archives and traces."""

import asyncio
import contextlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.markup import escape
from rich.progress import Progress

from brink.api.client import Api, CoordinatorError
from brink.cli.options import (
    RESULTS,
    AsJson,
    CampaignId,
    Database,
    DistanceThreshold,
    FitnessThreshold,
    Server,
    console,
    print_json,
    with_api,
    write_json,
)
from brink.search.archive import ARRAYS, Archive
from brink.search.errors import TooManyPairs
from brink.search.space import BoolArray
from brink.server.api.outcomes import OutcomesView
from brink.server.api.pair_views import MOST_PAIRS, PairsView
from brink.server.api.schemas import Boundary, CampaignView, SolutionView
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B, CampaignBody
from brink.server.campaigns.outcomes import deciding_requirements
from brink.server.campaigns.pairs import searches_for_pairs
from brink.server.campaigns.plan import Plan, make_plan
from brink.server.errors import InvalidInput, ServerError
from brink.server.states import OutcomeKind
from brink.sim.replay import render
from brink.sim.trace import Trace
from brink.worker.process import EpisodeProcess, episode_result
from brink.worker.wire import JobFailed

if TYPE_CHECKING:
    from brink.plots.inputs import VerdictWords

POLL_S = 0.5
EPISODE_TIMEOUT_S = 120.0
TRACE_TIMEOUT_S = 120.0


def plot(
    campaign: CampaignId,
    out: Annotated[Path | None, typer.Option(help="Folder for the figures.")] = None,
    t_b: FitnessThreshold = DEFAULT_T_B,
    d_th: DistanceThreshold = DEFAULT_D_TH,
    svg: Annotated[bool, typer.Option("--svg", help="Write SVG too.")] = False,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Draw the figures of a campaign.

    They show the archive embedded in two dimensions, how the verdict depends on each parameter and, unless the
    campaign searched for pairs, DBS against simulations for several thresholds, and fitness over generations.

    Example: brink plot 3f2a --out figures
    """

    async def work(api: Api) -> list[Path]:
        fetched = await fetch_archive(api, campaign)
        folder = out or RESULTS / f"plots-{campaign}"
        folder.mkdir(parents=True, exist_ok=True)
        formats = ("png", "svg") if svg else ("png",)
        pairs = None
        if searches_for_pairs(fetched.body.algorithm.id):
            pairs = await read_all_pairs(api, fetched.id)
        if isinstance(pairs, TooManyPairs):
            console(stderr=True).print(
                f"[yellow]no pair is marked: {escape(str(pairs))}[/yellow]", soft_wrap=True
            )
        return await asyncio.to_thread(
            draw_figures, fetched, folder, t_b=t_b, d_th=d_th, pairs=pairs, formats=formats
        )

    files = with_api(server, database, work)
    if as_json:
        print_json([str(path) for path in files])
    else:
        for path in files:
            typer.echo(path)


def replay(
    campaign: CampaignId,
    number: Annotated[int, typer.Argument(metavar="NUMBER", min=0, help="Number of the solution.")],
    out: Annotated[Path, typer.Option(help="File to write: .png, .gif or .mp4.")],
    database: Database = None,
    server: Server = None,
) -> None:
    """Draw one episode: the top view, the camera image, and the detections given to the driving system.

    Without --server, this machine runs the episode again; with it, the coordinator's workers do.

    Example: brink replay 3f2a 17 --out replay.mp4
    """
    if out.suffix not in (".png", ".gif", ".mp4"):
        raise InvalidInput.at("--out", f"{out}: expected a file name that ends in .png, .gif or .mp4")
    if not out.parent.is_dir():
        raise InvalidInput.at("--out", f"{out.parent}: no such folder")

    async def work(api: Api) -> None:
        requirement = await fetch_requirements(api, campaign)
        if server is None:
            trace = await run_episode(api, campaign, number)
        else:
            trace = await fetch_trace(api, campaign, number, TRACE_TIMEOUT_S)
        with Progress(console=console(), transient=True) as progress:
            task = progress.add_task(f"drawing {out}", total=None)
            await asyncio.to_thread(
                render,
                trace,
                out,
                requirement=requirement,
                on_progress=lambda done, total: progress.update(task, completed=done, total=total),
            )

    with_api(server, database, work)
    typer.echo(out)


@dataclass(frozen=True, slots=True, kw_only=True)
class FetchedArchive:
    """The archive of a campaign, fetched over the API.

    Attributes:
        id: Full id of the campaign.
        body: The campaign file.
        plan: Problem and algorithm of the campaign.
        archive: All evaluated solutions.
        active: Which parameters had a part in each episode, shape ``(n, d)``; None from an older coordinator.
        generations: Size of the archive after each generation.
        outcomes: What the simulations showed about all requirements, for each solution of the archive.
    """

    id: str
    body: CampaignBody
    plan: Plan
    archive: Archive
    active: BoolArray | None
    generations: tuple[int, ...]
    outcomes: OutcomesView


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
        id=view.id, body=view.body, plan=plan, archive=archive, active=arrays.get("active"),
        generations=tuple(int(end) for end in ends), outcomes=outcomes,
    )  # fmt: skip


async def read_all_pairs(api: Api, campaign: str) -> PairsView | TooManyPairs:
    """Return the pairs of a campaign, as far as they are shown, or that there are too many to tell apart.

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


async def write_results(api: Api, campaign: str, folder: Path, *, t_b: float, d_th: float) -> Boundary:
    """Write the boundary (CSV and JSON) and the archive of a campaign.

    Args:
        api: Coordinator of the campaign.
        campaign: Id of the campaign.
        folder: Folder to write to; created if missing.
        t_b: Maximum fitness of a boundary solution.
        d_th: Minimum distance between two boundary solutions.

    Returns:
        The boundary.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path, params = f"/campaigns/{campaign}/boundary", {"t_b": t_b, "d_th": d_th}
    document = await api.get(path, params)
    write_json(folder / "boundary.json", document)
    table = await api.request("GET", path, params={**params, "format": "csv"})
    (folder / "boundary.csv").write_bytes(table.content)
    archive = await api.request("GET", f"/campaigns/{campaign}/archive.npz")
    (folder / "archive.npz").write_bytes(archive.content)
    return Boundary.model_validate(document)


def draw_figures(
    fetched: FetchedArchive,
    folder: Path,
    *,
    t_b: float,
    d_th: float,
    pairs: PairsView | TooManyPairs | None = None,
    formats: tuple[str, ...] = ("png",),
) -> list[Path]:
    """Draw the figures of a campaign.

    Args:
        fetched: The campaign.
        folder: Folder to write to.
        t_b: Maximum fitness of a boundary solution.
        d_th: Minimum distance between two boundary solutions.
        pairs: The pairs to mark in place of boundary solutions, if the campaign searched for them; none are marked
            if there are too many.
        formats: File formats.

    Returns:
        The files.
    """
    # matplotlib takes half a second to load: only commands that draw wait for it.
    from brink.plots import CampaignFigures, write_campaign_figures

    figures = CampaignFigures(
        archive=fetched.archive,
        active=fetched.active,
        space=fetched.plan.problem.space,
        title=fetched.body.name,
        generation_ends=fetched.generations,
        t_b=t_b,
        d_th=d_th,
        words=_verdict_words(fetched),
        pairs=None if pairs is None else _numbers_of(pairs),
        too_many_pairs=isinstance(pairs, TooManyPairs),
    )
    return write_campaign_figures(figures, folder, formats=formats)


def _numbers_of(pairs: PairsView | TooManyPairs) -> tuple[tuple[int, int], ...]:
    if isinstance(pairs, TooManyPairs):
        return ()
    return tuple((pair.safe.number, pair.unsafe.number) for pair in pairs.pairs)


def _verdict_words(fetched: FetchedArchive) -> "VerdictWords":
    from brink.plots.inputs import VerdictWords

    view = fetched.outcomes
    kinds = {
        number: view.groups[group].kind
        for number, group in zip(view.number or (), view.group or (), strict=True)
    }
    numbers = fetched.archive.numbers.tolist()
    return VerdictWords(
        held=view.kinds[OutcomeKind.HELD], other=view.kinds[OutcomeKind.OTHER],
        violated=view.kinds[OutcomeKind.VIOLATED],
        others=np.array([kinds.get(number) is OutcomeKind.OTHER for number in numbers], np.bool_),
    )  # fmt: skip


class NoTrace(ServerError):
    """The trace of a solution is not available."""


class NothingToReplay(NoTrace):
    """A solution was not simulated, or its simulator records no traces."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawing:
    """The campaign whose episodes are drawn, and the folder for the pictures.

    Attributes:
        api: Coordinator of the campaign.
        campaign: Id of the campaign.
        folder: Folder for the pictures.
        stop: Once set, no further picture is drawn.
        timeout_s: How long to wait for a trace.
    """

    api: Api
    campaign: str
    folder: Path
    stop: asyncio.Event
    timeout_s: float

    async def trace(self, number: int) -> Trace | None:
        """Return the trace of a solution; None if it is not available."""
        try:
            return await fetch_trace(self.api, self.campaign, number, self.timeout_s)
        except (NoTrace, CoordinatorError):
            return None


async def fetch_trace(api: Api, campaign: str, number: int, timeout_s: float) -> Trace:
    """Return the trace of a solution. If it was not kept, a worker runs the episode again.

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
        response = await api.request("GET", path, params={"wait_s": min(20.0, timeout_s)})
        if response.status_code == 200:
            return Trace.from_bytes(response.content)
        if asyncio.get_running_loop().time() >= deadline:
            raise NoTrace(
                f"no worker provided the trace of solution {number} within {timeout_s:g} s; is a worker running?"
            )
        await asyncio.sleep(POLL_S)


async def run_episode(api: Api, campaign: str, number: int) -> Trace:
    """Return the trace of a solution by running its episode on this machine.

    Args:
        api: Coordinator of the campaign.
        campaign: Id of the campaign.
        number: Number of the solution.

    Raises:
        NoTrace: The solution was not simulated, or its episode failed on this machine.
    """
    spec = (await api.read(SolutionView, f"/campaigns/{campaign}/solutions/{number}")).spec
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


async def write_replays(drawing: Drawing, numbers: Sequence[int]) -> list[Path]:
    """Draw replays of solutions as PNG files, skipping solutions without a trace; return the files."""
    files = []
    requirement = await fetch_requirements(drawing.api, drawing.campaign)
    for number in numbers:
        if drawing.stop.is_set():
            break
        trace = await drawing.trace(number)
        if trace is None:
            continue
        path = drawing.folder / f"replay-{number}.png"
        await asyncio.to_thread(render, trace, path, requirement=requirement)
        files.append(path)
    return files


async def fetch_requirements(api: Api, campaign: str) -> tuple[str, ...] | None:
    """Return the requirements that decide the verdicts of a campaign; None if they are unknown."""
    body = (await api.read(CampaignView, f"/campaigns/{campaign}")).body
    return deciding_requirements(body) or None
