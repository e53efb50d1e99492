"""Live progress display of an experiment, or of the follow-ups of its pairs."""

from collections import Counter
from collections.abc import Sequence

from rich.console import Group
from rich.table import Table
from rich.text import Text

from brink.api.live import LiveDisplay, budget_bar, facts_table, rate_parts, rate_words, workers_words
from brink.cli.options import plain_table
from brink.server.api.schemas import ExperimentProgress, MemberView
from brink.server.states import CampaignStatus

POLL_S = 1.0
"""Time between two requests for results that are being computed."""


class ExperimentDisplay(LiveDisplay):
    """Progress display of an experiment and its campaigns."""

    def show(self, progress: ExperimentProgress, members: Sequence[MemberView]) -> None:
        """Show the progress of an experiment."""
        self._update(progress, lambda: _panel(progress, members), lambda: _line(progress))


def _panel(progress: ExperimentProgress, members: Sequence[MemberView]) -> Group:
    rows = [
        ("campaigns", f"{progress.finished} of {progress.campaigns} finished"),
        ("rate", rate_words(progress)),
        ("workers", workers_words(progress)),
    ]
    if progress.failed or progress.quarantined:
        rows.append(("failed", f"{progress.failed}   quarantined {progress.quarantined}"))
    rows += [("paused", reason) for reason in progress.paused]
    if progress.trouble:
        rows.append(("trouble", progress.trouble))
    facts = facts_table([(name, Text(value)) for name, value in rows])
    bar = budget_bar(progress.name, progress.simulations, progress.budget)
    return Group(bar, facts, _methods(members)) if members else Group(bar, facts)


def _methods(members: Sequence[MemberView]) -> Table:
    """Return a table of the campaigns by method."""
    several = len({member.problem for member in members}) > 1
    campaigns, finished, simulations, unsafe = (Counter[str]() for _ in range(4))
    for member in members:
        label = f"{member.method}, {member.problem}" if several else member.method
        campaigns[label] += 1
        finished[label] += member.status is CampaignStatus.FINISHED
        simulations[label] += member.simulations
        unsafe[label] += member.unsafe
    columns = ("finished", "simulations", "unsafe")
    table = plain_table("method", *columns, right=columns)
    for label, count in campaigns.items():
        share = f"{unsafe[label] / simulations[label]:.0%}" if simulations[label] else "–"
        table.add_row(Text(label), f"{finished[label]} of {count}", f"{simulations[label]:,}", share)
    return table


def _line(progress: ExperimentProgress) -> str:
    parts = [
        f"{progress.simulations}/{progress.budget} simulations",
        f"{progress.finished} of {progress.campaigns} campaigns finished",
        *rate_parts(progress),
        f"workers {progress.workers or 'none yet'}",
    ]
    return ", ".join(parts)
