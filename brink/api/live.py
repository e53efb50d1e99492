"""Live progress displays: a panel updated in place on a terminal, an occasional line elsewhere."""

import time
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from brink.server.api.schemas import GenerationView, Progress
from brink.server.states import CampaignStatus

PLAIN_EVERY_S = 10.0
BARS = "▁▂▃▄▅▆▇█"
SERIES_WIDTH = 40


class LiveDisplay:
    """A panel updated in place on a terminal; elsewhere a line every ten seconds."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._live = (
            Live(console=console, refresh_per_second=4, transient=True) if console.is_terminal else None
        )
        self._printed_at = float("-inf")

    def __enter__(self) -> Self:
        """Start the display."""
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the display and restore the terminal."""
        if self._live is not None:
            self._live.stop()

    def _update(self, panel: Callable[[], RenderableType], line: Callable[[], str]) -> None:
        """Show the panel on a terminal; elsewhere print the line, unless one was printed recently."""
        if self._live is not None:
            self._live.update(panel())
        elif time.monotonic() - self._printed_at >= PLAIN_EVERY_S:
            self._printed_at = time.monotonic()
            self._console.print(line(), highlight=False)


class CampaignDisplay(LiveDisplay):
    """Progress display of a campaign."""

    def __init__(self, console: Console) -> None:
        super().__init__(console)
        self._series: list[GenerationView] = []

    @property
    def generations(self) -> int:
        """Number of generations shown so far, which is the cursor of the next request."""
        return len(self._series)

    def show(self, progress: Progress) -> None:
        """Show the progress of a campaign, including the generations that are new."""
        self._series += [one for one in progress.generations if one.number >= len(self._series)]
        self._update(lambda: self._panel(progress), lambda: self._line(progress))

    def _panel(self, progress: Progress) -> Group:
        kind = "evaluations" if progress.measured else "simulations"
        facts = Table.grid(padding=(0, 2))
        for name, value, series in self._facts(progress):
            facts.add_row(Text(name, style="dim"), value, Text(series, style="cyan"))
        return Group(budget_bar(progress.name, progress.simulations, progress.budget, kind), facts)

    def _facts(self, progress: Progress) -> list[tuple[str, str, str]]:
        """Return the name, value and sparkline of each line of the panel."""
        last = self._series[-1] if self._series else None
        shares = [one.unsafe / one.evaluated for one in self._series if one.evaluated]
        best = [one.best_fitness for one in self._series if one.best_fitness is not None]
        # Searches for diverse violations minimise criticality and do not look for the boundary.
        diverse = not progress.looks_for_boundary
        rows = [
            ("unsafe", f"{shares[-1]:.0%}" if shares else "–", spark(shares)),
            (
                "criticality" if diverse else "best fitness",
                f"{last.best_fitness:.3f}" if last and last.best_fitness is not None else "–",
                spark(best),
            ),
            ("rate", f"{rate_of(progress.rate_per_s)}   remaining {duration(progress.remaining_s)}", ""),
            (
                "workers",
                f"{progress.workers or 'none yet'}   running {progress.leased}   queued {progress.queued}",
                "",
            ),
        ]
        if (
            diverse and not best
        ):  # nothing that is rated yet, or nothing to rate, as when solutions are simulated again
            rows = [row for row in rows if row[0] != "criticality"]
        if progress.looks_for_tolerances:  # it rates no solution
            rows = [row for row in rows if row[0] != "criticality"]
        if progress.looks_for_pairs:  # fitness and boundary are not what it looks for
            rows = [row for row in rows if row[0] != "best fitness"]
        elif not diverse:
            boundary = f"{last.dbs} distinct, {last.strict_dbs} strict" if last else "–"
            rows.insert(2, ("boundary", boundary, spark([one.dbs for one in self._series])))
        if progress.measured:
            rows.append(("on data", f"{progress.measured} measured   simulated {progress.evaluated}", ""))
        if progress.quarantined or progress.failed:
            rows.append(("failed", f"{progress.failed}   quarantined {progress.quarantined}", ""))
        # Before the first worker connects, every job is unrunnable: nothing worth reporting.
        for needs, count in progress.unrunnable.items() if progress.workers else ():
            rows.append(("waiting", f"{count} jobs need {needs}, which no worker provides", ""))
        if progress.asking:
            rows.append(("seeds", progress.asking, ""))
        if progress.trouble:
            rows.append(("trouble", progress.trouble, ""))
        if progress.status is not CampaignStatus.RUNNING:
            rows.append(("status", f"{progress.status} {progress.status_reason}", ""))
        return rows

    def _line(self, progress: Progress) -> str:
        facts = {name: value for name, value, _ in self._facts(progress)}
        shown = ("unsafe", "best fitness", "criticality", "boundary")
        parts = [
            f"{progress.simulations}/{progress.budget} simulations",
            *(f"{name} {facts[name]}" for name in shown if name in facts),
            rate_of(progress.rate_per_s),
            f"remaining {duration(progress.remaining_s)}",
            f"workers {progress.workers}",
        ]
        return ", ".join([*parts, progress.asking] if progress.asking else parts)


def budget_bar(name: str, simulations: int, budget: int, kind: str = "simulations") -> Table:
    """Return a progress bar with the name of a campaign or an experiment.

    Args:
        name: Name shown in front of the bar.
        simulations: Completed so far; may exceed the budget.
        budget: Simulations in all.
        kind: What is counted, in words.
    """
    bar = Table.grid(padding=(0, 1))
    bar.add_row(
        Text(name, style="bold"),
        ProgressBar(total=budget, completed=min(simulations, budget), width=SERIES_WIDTH),
        f"{simulations:,} of {budget:,} {kind}",
    )
    return bar


def spark(values: Sequence[float]) -> str:
    """Return the last values of a series as a sparkline, newest on the right."""
    shown = values[-SERIES_WIDTH:]
    if len(shown) < 2:
        return ""
    low, high = min(shown), max(shown)
    if high == low:
        return BARS[0] * len(shown)
    return "".join(BARS[round((value - low) / (high - low) * (len(BARS) - 1))] for value in shown)


def rate_of(rate: float | None) -> str:
    """Return a rate in simulations per second as text."""
    if rate is None:
        return "–"
    return f"{rate:.1f} a second" if rate >= 1 else f"{60 * rate:.1f} a minute"


def duration(seconds: float | None) -> str:
    """Return a duration as text."""
    if seconds is None:
        return "–"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02} min"
    return f"{minutes} min {rest:02} s" if minutes else f"{rest} s"
