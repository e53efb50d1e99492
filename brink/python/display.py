"""Progress of a campaign where Python runs: in a terminal, in a notebook, or as log lines."""

import html
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from brink.api.following import Display, Silent
from brink.api.live import CampaignDisplay, duration, failures_of, failures_words, rate_of
from brink.api.terminal import PlainConsole
from brink.server.api.schemas import Progress


class NotebookDisplay(Silent):
    """A progress bar in the output of a notebook's cell, updated in place."""

    def __init__(self) -> None:
        from IPython.display import HTML, display

        self._html: Any = HTML
        self._handle: Any = display(HTML(""), display_id=True)  # type: ignore[no-untyped-call]

    def show(self, progress: Progress) -> None:
        """Show the progress of a campaign."""
        self.generations = max([self.generations, *(one.number + 1 for one in progress.generations)])
        self._handle.update(self._html(progress_html(progress)))


def progress_html(progress: Progress) -> str:
    """Return a progress bar with counts as HTML, in colours that suit a light and a dark page."""
    done = min(1.0, progress.simulations / progress.budget) if progress.budget else 1.0
    facts = [
        f"{progress.simulations:,} of {progress.budget:,} simulations",
        f"{progress.unsafe:,} unsafe",
        f"failed: {failures_words(progress)}" if failures_of(progress) else "",
        progress.status.value if progress.status.value != "running" else rate_of(progress.rate_per_s),
        f"{duration(progress.remaining_s)} left" if progress.remaining_s is not None else "",
        progress.status_reason,
    ]
    words = html.escape(" · ".join(filter(None, facts)))
    return (
        f"<div><b>{html.escape(progress.name)}</b> "
        '<span style="display:inline-block;vertical-align:middle;width:16em;height:0.7em;border:1px solid #8a8f98;'
        'border-radius:0.35em;overflow:hidden">'
        f'<span style="display:block;height:100%;width:{100 * done:.1f}%;background:#0072b2"></span></span> '
        f"{words}</div>"
    )


def display_of(wanted: bool) -> AbstractContextManager[Display[Progress]]:
    """Return the display that suits the environment of this process.

    Args:
        wanted: Whether to show anything.
    """
    if not wanted:
        return nullcontext(Silent())
    if in_notebook():
        return nullcontext(NotebookDisplay())
    return CampaignDisplay(PlainConsole(stderr=True))


def in_notebook() -> bool:
    """Return whether this process is the kernel of a notebook."""
    try:
        from IPython import get_ipython
    except ImportError:
        return False
    return bool(get_ipython().__class__.__name__ == "ZMQInteractiveShell")
