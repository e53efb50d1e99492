"""The live display of an experiment: a bar for all of it, and how far each method is."""

from collections import Counter
from typing import Any

from rich.console import Group
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from brink.cli.live import SERIES_WIDTH, LiveDisplay, duration, rate_of


class ExperimentDisplay(LiveDisplay):
    """Shows progress documents of ``GET /experiments/{id}/progress`` and the campaigns of the experiment."""

    def show(self, progress: dict[str, Any], members: list[dict[str, Any]]) -> None:
        """Show where an experiment stands."""
        self._update(lambda: self._panel(progress, members), lambda: _line(progress))

    def _panel(self, progress: dict[str, Any], members: list[dict[str, Any]]) -> Group:
        head = Table.grid(padding=(0, 1))
        head.add_row(
            Text(progress["name"], style="bold"),
            ProgressBar(
                total=progress["budget"],
                completed=min(progress["simulations"], progress["budget"]),
                width=SERIES_WIDTH,
            ),
            f"{progress['simulations']:,} of {progress['budget']:,} simulations",
        )
        facts = Table.grid(padding=(0, 2))
        facts.add_row(
            Text("campaigns", style="dim"), f"{progress['finished']} of {progress['campaigns']} finished"
        )
        facts.add_row(
            Text("rate", style="dim"),
            f"{rate_of(progress['rate_per_s'])}   left {duration(progress['remaining_s'])}",
        )
        facts.add_row(
            Text("workers", style="dim"),
            f"{progress['workers'] or 'none yet'}   running {progress['leased']}   queued {progress['queued']}",
        )
        if progress["failed"] or progress["quarantined"]:
            facts.add_row(
                Text("failed", style="dim"),
                f"{progress['failed']}   in quarantine {progress['quarantined']}",
            )
        for reason in progress["paused"]:
            facts.add_row(Text("paused", style="dim"), Text(reason))
        if progress["trouble"]:
            facts.add_row(Text("trouble", style="dim"), Text(progress["trouble"]))
        return Group(head, facts, _methods(members))


def _methods(members: list[dict[str, Any]]) -> Table:
    table = Table(box=None, pad_edge=False)
    for name, justify in (
        ("method", "left"),
        ("finished", "right"),
        ("simulations", "right"),
        ("unsafe", "right"),
    ):
        table.add_column(name, justify=justify, header_style="dim")  # type: ignore[arg-type]
    problems = len({member["problem"] for member in members}) > 1
    of: Counter[str] = Counter()
    finished: Counter[str] = Counter()
    simulations: Counter[str] = Counter()
    unsafe: Counter[str] = Counter()
    for member in members:
        label = f"{member['method']}, {member['problem']}" if problems else member["method"]
        of[label] += 1
        finished[label] += member["status"] == "finished"
        simulations[label] += member["simulations"]
        unsafe[label] += member["unsafe"]
    for label, count in of.items():
        share = f"{unsafe[label] / simulations[label]:.0%}" if simulations[label] else "–"
        table.add_row(Text(label), f"{finished[label]} of {count}", f"{simulations[label]:,}", share)
    return table


def _line(progress: dict[str, Any]) -> str:
    return (
        f"{progress['simulations']}/{progress['budget']} simulations, {progress['finished']} of "
        f"{progress['campaigns']} campaigns finished, {rate_of(progress['rate_per_s'])}, "
        f"left {duration(progress['remaining_s'])}, workers {progress['workers']}"
    )
