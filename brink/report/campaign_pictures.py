"""The pictures of a campaign's report, drawn anew: those that match the purpose of the campaign."""

import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from brink.api.client import Api, CoordinatorError
from brink.api.results import TRACE_TIMEOUT_S, NoTrace
from brink.report.campaign_facts import Facts, Show
from brink.report.combinations import draw_chains
from brink.report.figures import Drawing, campaign_figure, write_replays
from brink.report.pair_pictures import write_pair
from brink.report.violations import draw_gallery
from brink.search.errors import TooManyPairs
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.findings.pairs.views import PairsView, PairView
from brink.sim.errors import SimulatorError
from brink.worker.errors import WorkerError

OTHERS_PAIRS: Final = 2
"""Most pairs drawn where the search looked for something else."""
TYPES_DRAWN: Final = 4
CHAINS_DRAWN: Final = 1
"""A chain and its parts are up to six drives with a camera, each of which takes as long as in the search."""
REPLAYS_DRAWN: Final = 2
_AT_ONCE: Final = 2
_UNDRAWABLE: Final = (
    NoTrace,
    CoordinatorError,
    SimulatorError,
    WorkerError,
    LookupError,
    ValueError,
    TypeError,
    ArithmeticError,
)
"""A simulator may record anything, so a picture that fails is left out."""


def shown_pairs(facts: Facts, most: int) -> list[PairView]:
    """Return the pairs that the report shows in full.

    Args:
        facts: What is known of the campaign.
        most: Most pairs.
    """
    if isinstance(facts.pairs, TooManyPairs) or facts.tolerance is not None:
        return []
    if facts.searched_pairs:
        return facts.pairs.pairs[:most]
    if facts.searched_violations or facts.combinations is not None:
        return []
    return facts.pairs.pairs[: min(most, OTHERS_PAIRS)]


async def draw_pictures(
    api: Api, facts: Facts, folder: Path, *, most_pairs: int, workers: bool, show: Show
) -> Mapping[str, Path]:
    """Draw the pictures of a report; return those that could be drawn, by file name.

    Args:
        api: Coordinator of the campaign.
        facts: What is known of the campaign.
        folder: Folder for the pictures.
        most_pairs: Most pairs to draw.
        workers: Whether the coordinator's workers run episodes again; otherwise this machine does.
        show: Called with what is being drawn.
    """
    drawing = Drawing(
        api=api,
        campaign=facts.view.id,
        folder=folder,
        stop=asyncio.Event(),
        timeout_s=TRACE_TIMEOUT_S,
        workers=workers,
        show=show,
    )
    files: list[Path] = []
    if not isinstance(facts.pairs, TooManyPairs):
        files += await _draw_pairs(drawing, facts.pairs, shown_pairs(facts, most_pairs))
    if facts.tolerance is not None and facts.tolerance.cells:
        # matplotlib takes half a second to load: only what draws waits for it.
        from brink.plots.tolerance import figure_tolerance

        show("drawing curves", 0, 0)
        files.append(folder / "tolerance.png")
        await asyncio.to_thread(figure_tolerance(facts.tolerance).savefig, files[-1])
    elif facts.evaluated:
        show("drawing the map", 0, 0)
        pairs = facts.pairs if facts.searched_pairs else None
        files.append(folder / "map.png")
        await asyncio.to_thread(_draw_map, facts, pairs, files[-1])
    if facts.detector is not None:
        from brink.plots.detector import figure_detector

        files.append(folder / "detector.png")
        await asyncio.to_thread(figure_detector(facts.detector).savefig, files[-1])
    if facts.violations is not None:
        show("drawing violations", 0, 0)
        files += await draw_gallery(facts.violations, drawing, TYPES_DRAWN)
    if facts.combinations is not None:
        show("drawing combinations", 0, 0)
        files += await draw_chains(facts.combinations, drawing, CHAINS_DRAWN)
    if replayed := shown_replays(facts):
        show("drawing replays", 0, 0)
        files += await write_replays(drawing, replayed)
    return {file.name: file for file in files}


def shown_replays(facts: Facts) -> list[int]:
    """Return the numbers of the boundary solutions whose replays the report shows."""
    if facts.searched_pairs or "boundary" not in facts.progress.finds or facts.combinations is not None:
        return []
    simulated = [one.number for one in facts.boundary.solutions if one.spec is not None]
    return simulated[:REPLAYS_DRAWN]


def _draw_map(facts: Facts, pairs: PairsView | TooManyPairs | None, file: Path) -> None:
    figure = campaign_figure("map", facts.fetched, t_b=DEFAULT_T_B, d_th=DEFAULT_D_TH, pairs=pairs)
    figure.savefig(file, metadata={"Software": None})


async def _draw_pairs(drawing: Drawing, view: PairsView, pairs: list[PairView]) -> list[Path]:
    """Draw pairs, several at once; return the files of those that could be drawn."""
    slots, done = asyncio.Semaphore(_AT_ONCE), 0

    async def draw(pair: PairView) -> Path | None:
        nonlocal done
        path = drawing.folder / f"pair-{pair.place}.png"
        async with slots:
            try:
                await write_pair(drawing.api, view, pair, path, workers=drawing.workers)
            except _UNDRAWABLE:
                return None
            finally:
                done += 1
                drawing.show("drawing pairs", done, len(pairs))
        return path

    if pairs:
        drawing.show("drawing pairs", 0, len(pairs))
    return [path for path in await asyncio.gather(*map(draw, pairs)) if path is not None]
