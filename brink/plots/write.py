"""All figures of a campaign, written to a folder."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from matplotlib.figure import Figure

from brink.plots.dbs import figure_dbs
from brink.plots.embedding import figure_embedding
from brink.plots.fitness import figure_fitness
from brink.plots.inputs import CampaignFigures
from brink.plots.parameters import figure_parameters
from brink.plots.style import DPI

FIGURES: Final[Mapping[str, Callable[[CampaignFigures], Figure]]] = {
    "map": figure_embedding,
    "dbs": figure_dbs,
    "fitness": figure_fitness,
    "parameters": figure_parameters,
}
"""Every figure by the stem of its file name."""

FORMATS: Final = ("png", "svg")
# A fixed date and no random ids: the same campaign gives the same files.
_METADATA: Final[Mapping[str, dict[str, Any]]] = {"png": {"Software": None}, "svg": {"Date": None}}


def write_campaign_figures(
    inputs: CampaignFigures, folder: Path, formats: Sequence[str] = ("png",)
) -> list[Path]:
    """Write all figures of a campaign; a folder that is not there is made, files that are there are replaced.

    Args:
        inputs: The campaign.
        folder: Where to.
        formats: ``png``, ``svg`` or both.

    Returns:
        The files, in the order of `FIGURES` and then of the formats.

    Raises:
        ValueError: A format is unknown.
        OSError: A file cannot be written.
    """
    for name in formats:
        if name not in FORMATS:
            raise ValueError(f"formats: expected some of {', '.join(FORMATS)}; got {name!r}")
    folder.mkdir(parents=True, exist_ok=True)
    files: list[Path] = []
    for stem, make in FIGURES.items():
        figure = make(inputs)
        for extension in formats:
            path = folder / f"{stem}.{extension}"
            figure.savefig(path, format=extension, dpi=DPI, metadata=_METADATA[extension])
            files.append(path)
    return files
