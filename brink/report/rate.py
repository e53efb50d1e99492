"""The picture of a rate for files and reports."""

from pathlib import Path

from brink.server.errors import InvalidInput
from brink.server.findings.finding import Finding
from brink.server.findings.rate.views import RateView


def draw_rate(finding: Finding, path: Path) -> None:
    """Draw the interval of a rate against the simulations that it took.

    Args:
        finding: The finding of the kind `rate`.
        path: File to write (.png, .svg or .pdf).

    Raises:
        InvalidInput: There are no simulations to draw.
    """
    # matplotlib takes half a second to load: only what draws waits for it.
    from brink.plots.rate import figure_rate

    if finding.view is None:
        raise InvalidInput.at("--picture", f"there is nothing to draw: {finding.sentence}")
    figure = figure_rate(RateView.model_validate(finding.view), finding.sentence)
    figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)
