"""The folder of results that `brink run` writes, and how follow-ups update it."""

import asyncio
import logging
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from rich.console import Console

from brink.api.client import Api
from brink.api.live import Steps
from brink.api.results import TRACE_TIMEOUT_S, fetch_archive
from brink.cli.kind_files import PairFiles
from brink.cli.options import file_name
from brink.report.campaign import campaign_report, write_page
from brink.report.figures import Drawing
from brink.server.findings.finding import Finding

PAIRS_DRAWN: Final = 1
"""Pairs that the report of a run shows in full; `brink report` draws more."""
_PAIRS: Final = "pairs.jsonl"
_REPORT: Final = "report.html"

log = logging.getLogger(__name__)


def results_folder(out: Path, name: str, campaign: str) -> Path:
    """Return the folder to which `brink run` writes the results of a campaign.

    Args:
        out: Folder for results.
        name: Name of the campaign.
        campaign: Full id of the campaign.
    """
    return out / f"{file_name(name)}-{campaign}"


async def write_report(
    api: Api, campaign: str, folder: Path, files: Sequence[Path], *, show: Callable[[str, int, int], None]
) -> Path:
    """Write the report to hand on, reusing the pictures that are already written; return its file.

    Args:
        api: Coordinator of the campaign.
        campaign: Id of the campaign.
        folder: Folder to write to.
        files: Files that are written already.
        show: Called with what is being done, how much of it is done, and how much there is; 0 if that is unknown.
    """
    pictures = {path.name: path for path in files if path.suffix == ".png"}
    began = time.monotonic()
    page = await campaign_report(api, campaign, pictures=pictures, most_pairs=PAIRS_DRAWN, show=show)
    write_page(folder / _REPORT, page)
    log.info("writing the report took %.1f s", time.monotonic() - began)
    return folder / _REPORT


async def update_pairs(api: Api, campaign: str, out: Path, screen: Console) -> None:
    """Rewrite the pairs in a campaign's folder of results if there is new evidence.

    The tables, the pictures of pairs and the report are replaced, as far as the run wrote them. What was replaced is
    printed; so is that there is no folder.

    Args:
        api: Coordinator of the campaign.
        campaign: Id of the campaign, or a unique prefix of it.
        out: Folder for results, as `brink run` was given it.
        screen: Console for progress and for what was replaced.

    Raises:
        CoordinatorError: The campaign does not exist.
        OSError: A file cannot be written.
    """
    fetched = await fetch_archive(api, campaign)
    folder = results_folder(out, fetched.body.name, fetched.id)
    if not (folder / _PAIRS).is_file():
        screen.print(
            f"no files of a run to update in {folder}; --results names another folder than {out}",
            soft_wrap=True,
            style="dim",
        )
        return
    with Steps(screen, "updating the files of the run") as steps:
        pairs = PairFiles(fetched, await api.read(Finding, f"/campaigns/{fetched.id}/findings/pairs"))
        await pairs.read(api)
        if not pairs.differs_from(folder / _PAIRS):
            return
        there = {path.name for path in folder.iterdir()}
        written = await pairs.write(api, folder)
        drawing = Drawing(
            api=api,
            campaign=fetched.id,
            folder=folder,
            stop=asyncio.Event(),
            timeout_s=TRACE_TIMEOUT_S,
            workers=False,
            show=steps.show,
        )
        if any(name.startswith("pair-") for name in there):
            written += await pairs.draw(drawing)
        if _REPORT in there:
            others = [path for path in folder.glob("*.png") if not path.name.startswith("pair-")]
            written.append(await write_report(api, fetched.id, folder, [*written, *others], show=steps.show))
    names = ", ".join(path.name for path in written)
    screen.print(f"updated in {folder}: {names}", soft_wrap=True)
