"""The live display of a campaign: a few lines that change on a terminal, a line now and then elsewhere."""

import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

PLAIN_EVERY_S = 10.0
BARS = "▁▂▃▄▅▆▇█"
SERIES_WIDTH = 40


class LiveDisplay:
    """Lines that change in their place on a terminal; elsewhere a line now and then."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._live = (
            Live(console=console, refresh_per_second=4, transient=True) if console.is_terminal else None
        )
        self._said_at = float("-inf")

    def __enter__(self) -> Self:
        """Begin to show."""
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the terminal as it was."""
        if self._live is not None:
            self._live.stop()

    def _update(self, panel: Callable[[], RenderableType], line: Callable[[], str]) -> None:
        """Show what stands now: the panel on a terminal, or else the line, unless one was printed just before."""
        if self._live is not None:
            self._live.update(panel())
        elif time.monotonic() - self._said_at >= PLAIN_EVERY_S:
            self._said_at = time.monotonic()
            self._console.print(line(), highlight=False)


class CampaignDisplay(LiveDisplay):
    """Shows progress documents of ``GET /campaigns/{id}/progress``."""

    def __init__(self, console: Console) -> None:
        super().__init__(console)
        self._series: list[dict[str, Any]] = []

    @property
    def generations(self) -> int:
        """How many generations were shown: what to ask for next."""
        return len(self._series)

    def show(self, progress: dict[str, Any]) -> None:
        """Show where a campaign stands."""
        self._series += [g for g in progress["generations"] if g["number"] >= len(self._series)]
        self._update(lambda: self._panel(progress), lambda: self._line(progress))

    def _panel(self, progress: dict[str, Any]) -> Group:
        done, budget = progress["simulations"], progress["budget"]
        head = Table.grid(padding=(0, 1))
        head.add_row(
            Text(progress["name"], style="bold"),
            ProgressBar(total=budget, completed=min(done, budget), width=SERIES_WIDTH),
            f"{done} of {budget} {'evaluations' if progress['measured'] else 'simulations'}",
        )
        facts = Table.grid(padding=(0, 2))
        for name, value, series in self._facts(progress):
            facts.add_row(Text(name, style="dim"), value, Text(series, style="cyan"))
        return Group(head, facts)

    def _facts(self, progress: dict[str, Any]) -> list[tuple[str, str, str]]:
        last = self._series[-1] if self._series else None
        shares = [g["unsafe"] / g["evaluated"] for g in self._series if g["evaluated"]]
        # Searches for different violations minimise their criticality, and do not look for the boundary.
        diverse = not progress["looks_for_boundary"]
        rows = [
            ("unsafe", f"{shares[-1]:.0%}" if shares else "–", spark(shares)),
            (
                "criticality" if diverse else "best fitness",
                f"{last['best_fitness']:.3f}" if last and last["best_fitness"] is not None else "–",
                spark([g["best_fitness"] for g in self._series if g["best_fitness"] is not None]),
            ),
            ("rate", f"{rate_of(progress['rate_per_s'])}   left {duration(progress['remaining_s'])}", ""),
            (
                "workers",
                f"{progress['workers'] or 'none yet'}   running {progress['leased']}   queued {progress['queued']}",
                "",
            ),
        ]
        if not diverse:
            boundary = f"{last['dbs']} distinct, {last['strict_dbs']} strict" if last else "–"
            rows.insert(2, ("boundary", boundary, spark([g["dbs"] for g in self._series])))
        if progress["measured"]:
            rows.append(
                ("on data", f"{progress['measured']} measured   simulated {progress['evaluated']}", "")
            )
        if progress["quarantined"] or progress["failed"]:
            rows.append(("failed", f"{progress['failed']}   in quarantine {progress['quarantined']}", ""))
        # At a start no worker has been heard of yet, which is nothing to say of what they offer.
        for needs, count in progress["unrunnable"].items() if progress["workers"] else ():
            rows.append(("waiting", f"{count} jobs need {needs}, which no worker offers", ""))
        if progress["asking"]:
            rows.append(("seeds", progress["asking"], ""))
        if progress["trouble"]:
            rows.append(("trouble", progress["trouble"], ""))
        if progress["status"] != "running":
            rows.append(("status", f"{progress['status']} {progress['status_reason']}", ""))
        return rows

    def _line(self, progress: dict[str, Any]) -> str:
        facts = {name: value for name, value, _ in self._facts(progress)}
        said = ", ".join(
            f"{name} {facts[name]}"
            for name in ("unsafe", "best fitness", "criticality", "boundary")
            if name in facts
        )
        return (
            f"{progress['simulations']}/{progress['budget']} simulations, {said}, {rate_of(progress['rate_per_s'])}, "
            f"left {duration(progress['remaining_s'])}, workers {progress['workers']}"
            + (f", {progress['asking']}" if progress["asking"] else "")
        )


def spark(values: list[float]) -> str:
    """Return a series as a line of bars, its latest values at the right."""
    shown = values[-SERIES_WIDTH:]
    if len(shown) < 2:
        return ""
    low, high = min(shown), max(shown)
    if high == low:
        return BARS[0] * len(shown)
    return "".join(BARS[round((value - low) / (high - low) * (len(BARS) - 1))] for value in shown)


def rate_of(rate: float | None) -> str:
    """Return simulations a second for people."""
    if rate is None:
        return "–"
    return f"{rate:.1f} a second" if rate >= 1 else f"{60 * rate:.1f} a minute"


def duration(seconds: float | None) -> str:
    """Return a time for people."""
    if seconds is None:
        return "–"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02} min"
    return f"{minutes} min {rest:02} s" if minutes else f"{rest} s"
