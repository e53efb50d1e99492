"""How `brink pairs` draws a pair: it checks the file first, and shows progress."""

from pathlib import Path
from typing import Final

from brink.api.client import Api
from brink.api.live import Steps
from brink.cli.options import console
from brink.server.errors import InvalidInput
from brink.server.findings.pairs.views import PairsView, PairView

PICTURES: Final = (".png",)


def chosen_pair(view: PairsView, number: int, option: str) -> PairView:
    """Return a pair by its number.

    Raises:
        InvalidInput: There is no such pair; the message says what there is.
    """
    from brink.api.results import find_pair

    if not view.pairs:
        raise InvalidInput.at(option, f"expected the number of a pair, but there is none: {view.note}")
    if not 1 <= number <= view.distinct:
        raise InvalidInput.at(
            option, f"expected the number of a pair from 1 to {view.distinct}, got {number}"
        )
    found = find_pair(view, number)
    if found is None:
        raise InvalidInput.at(
            option, f"expected one of the {len(view.pairs):,} pairs with the best evidence, got {number}"
        )
    return found


async def draw_pair(api: Api, view: PairsView, pair: PairView, path: Path, *, workers: bool) -> None:
    """Draw a pair to a file.

    Args:
        api: Coordinator of the campaign.
        view: The pairs of the campaign.
        pair: The pair.
        path: A picture (.png) or a film (.mp4, .gif).
        workers: Whether the coordinator's workers run the drives again; otherwise this machine does.

    Raises:
        NoTrace: A drive cannot be run again; for a picture only if that failed, not if there is nothing to replay.
    """
    from brink.report.pair_pictures import write_pair

    # On stderr: the output of this command is the names of the files.
    with Steps(console(stderr=True), f"drawing {path}") as steps:
        await write_pair(api, view, pair, path, workers=workers, show=steps.show)
