"""The figures of a campaign and replays of its solutions, as files."""

import asyncio
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from brink.api.client import Api, CoordinatorError
from brink.api.results import (
    FetchedArchive,
    NoTrace,
    fetch_requirements,
    fetch_trace,
    read_all_pairs,
    run_episode,
)
from brink.pictures import render
from brink.search.errors import TooManyPairs
from brink.server.errors import InvalidInput
from brink.server.findings.pairs.views import PairsView
from brink.server.states import OutcomeKind
from brink.sim.errors import SimulatorError
from brink.sim.trace import Trace
from brink.worker.errors import WorkerError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from brink.plots.inputs import CampaignFigures, VerdictWords


async def marked_pairs(api: Api, fetched: FetchedArchive) -> PairsView | TooManyPairs | None:
    """Return the pairs to mark in figures of a campaign; None if it did not search for them."""
    return await read_all_pairs(api, fetched.id) if fetched.plan.is_for("pairs") else None


def draw_figures(
    fetched: FetchedArchive,
    folder: Path,
    *,
    t_b: float,
    d_th: float,
    pairs: PairsView | TooManyPairs | None = None,
    formats: tuple[str, ...] = ("png",),
    only: Collection[str] | None = None,
    on_progress: Callable[[int, int], None] | None = None,
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
        only: Stems of the files to draw; None for all that suit the campaign.
        on_progress: Called with the number of figures drawn so far, and of all.

    Returns:
        The files.
    """
    # matplotlib takes half a second to load: only what draws waits for it.
    from brink.plots import FIGURES, write_campaign_figures

    return write_campaign_figures(
        _inputs(fetched, t_b, d_th, pairs),
        folder,
        formats=formats,
        only=FIGURES if only is None else only,
        on_progress=on_progress,
    )


VIOLATION_TYPES: Final = "violation-types"
"""Figure of the types of violations (`brink.report.violations.figure_types`)."""


def campaign_figure(
    name: str,
    fetched: FetchedArchive,
    *,
    t_b: float,
    d_th: float,
    pairs: PairsView | TooManyPairs | None = None,
) -> "Figure":
    """Return one of the figures that `draw_figures` draws.

    Args:
        name: Stem of its file name: ``map``, ``parameters``, ``dbs`` or ``fitness``.
        fetched: The campaign.
        t_b: Maximum fitness of a boundary solution.
        d_th: Minimum distance between two boundary solutions.
        pairs: As for `draw_figures`.

    Raises:
        InvalidInput: There is no such figure.
    """
    from brink.plots import FIGURES

    if name not in FIGURES:
        raise InvalidInput.at(
            "what", f"expected one of {', '.join([*FIGURES, VIOLATION_TYPES])}; got {name!r}"
        )
    return FIGURES[name](_inputs(fetched, t_b, d_th, pairs))


def _inputs(
    fetched: FetchedArchive, t_b: float, d_th: float, pairs: PairsView | TooManyPairs | None
) -> "CampaignFigures":
    from brink.plots import CampaignFigures

    return CampaignFigures(
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
        searched_boundary="boundary" in fetched.plan.finds,
    )


def _numbers_of(pairs: PairsView | TooManyPairs) -> tuple[tuple[int, int], ...]:
    if isinstance(pairs, TooManyPairs):
        return ()
    by_number = sorted(pairs.pairs, key=lambda pair: pair.place)  # the rings have the numbers of the pairs
    return tuple((pair.safe.number, pair.unsafe.number) for pair in by_number)


def _verdict_words(fetched: FetchedArchive) -> "VerdictWords":
    from brink.plots.inputs import VerdictWords

    view = fetched.outcomes
    kinds = {
        number: view.groups[group].kind
        for number, group in zip(view.number or (), view.group or (), strict=True)
    }
    numbers = fetched.archive.numbers.tolist()
    return VerdictWords(
        held=view.kinds[OutcomeKind.HELD],
        other=view.kinds[OutcomeKind.OTHER],
        violated=view.kinds[OutcomeKind.VIOLATED],
        others=np.array([kinds.get(number) is OutcomeKind.OTHER for number in numbers], np.bool_),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawing:
    """The campaign whose episodes are drawn, and the folder for the pictures.

    Attributes:
        api: Coordinator of the campaign.
        campaign: Id of the campaign.
        folder: Folder for the pictures.
        stop: Once set, no further picture is drawn.
        timeout_s: How long to wait for a trace.
        workers: Whether the coordinator's workers run episodes again; otherwise this machine does.
        show: Called with what is being drawn, how many are done, and how many there are; 0 if that is unknown.
        missing: Numbers of the solutions that had no trace when it was asked for.
    """

    api: Api
    campaign: str
    folder: Path
    stop: asyncio.Event
    timeout_s: float
    workers: bool = True
    show: Callable[[str, int, int], None] = lambda _what, _done, _total: None
    missing: set[int] = field(default_factory=set)

    async def trace(self, number: int) -> Trace | None:
        """Return the trace of a solution; None if it is not available."""
        try:
            if self.workers:
                return await fetch_trace(self.api, self.campaign, number, self.timeout_s)
            return await run_episode(self.api, self.campaign, number)
        except (NoTrace, CoordinatorError, SimulatorError, WorkerError):
            self.missing.add(number)
            return None


async def write_replays(drawing: Drawing, numbers: Sequence[int]) -> list[Path]:
    """Draw replays of solutions as PNG files, skipping solutions without a trace; return the files."""
    files = []
    requirement = await fetch_requirements(drawing.api, drawing.campaign)
    for done, number in enumerate(numbers):
        if drawing.stop.is_set():
            break
        drawing.show("drawing replays", done, len(numbers))
        trace = await drawing.trace(number)
        if trace is None:
            continue
        path = drawing.folder / f"replay-{number}.png"
        await asyncio.to_thread(render, trace, path, requirement=requirement)
        files.append(path)
    return files
