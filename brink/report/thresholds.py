"""The picture of thresholds for files and reports."""

from pathlib import Path

from brink.server.errors import InvalidInput
from brink.server.findings.finding import Finding
from brink.server.findings.thresholds.views import ThresholdsView


def draw_thresholds(finding: Finding, path: Path) -> None:
    """Draw how likely a violation is along the unit of each threshold.

    Args:
        finding: The finding of the kind `thresholds`.
        path: File to write (.png, .svg or .pdf).

    Raises:
        InvalidInput: There is no line to draw.
    """
    # matplotlib takes half a second to load: only what draws waits for it.
    from brink.plots.thresholds import figure_thresholds

    if finding.view is None:
        raise InvalidInput.at("--picture", f"there is nothing to draw: {finding.sentence}")
    figure = figure_thresholds(ThresholdsView.model_validate(finding.view))
    figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)
