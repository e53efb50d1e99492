"""Live progress displays: a panel updated in place on a terminal, an occasional line elsewhere."""

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Generic, Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from brink.api.client import Api
from brink.api.following import P
from brink.api.terminal import plain_table
from brink.server.api.schemas import ExperimentProgress, ExperimentView, GenerationView, MemberView, Progress
from brink.server.states import CampaignStatus

PLAIN_EVERY_S = 10.0
FIRST_LINE_S = 2.0
"""How long a command without a terminal waits before it first reports what it is doing."""
BARS = "▁▂▃▄▅▆▇█"
SERIES_WIDTH = 40


def updates_in_place(console: Console) -> bool:
    """Return whether a console can show progress in place: elsewhere, control characters would litter its output.

    A console that is told to use colours, as by ``FORCE_COLOR``, counts as a terminal although its output may be a
    file.
    """
    return console.is_terminal and not console.is_dumb_terminal and console.file.isatty()


class InPlace:
    """Something that is shown in place on a terminal while a block runs.

    Args:
        console: Shows it.
        render: Returns it, where it is not passed to `Live.update`.
    """

    def __init__(self, console: Console, render: Callable[[], RenderableType] | None = None) -> None:
        self._console = console
        self._began = time.monotonic()
        self._live: Live | None = None
        if updates_in_place(console):
            self._live = Live(get_renderable=render, console=console, refresh_per_second=4, transient=True)

    def __enter__(self) -> Self:
        """Start the display."""
        if self._live is not None:
            self._live.start(refresh=True)
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the display and restore the terminal."""
        if self._live is not None:
            self._live.stop()


class Steps(InPlace):
    """Shows the current step of a command, its progress, and its duration.

    On a terminal a line in place, such as ``drawing replays, 2 of 3, 41 s``; elsewhere such a line after two seconds,
    then every ten seconds.

    Args:
        console: Shows the progress.
        first: The first step, in words.
        plain_every_s: Time between two lines on a console that is not a terminal.
    """

    def __init__(self, console: Console, first: str, *, plain_every_s: float = PLAIN_EVERY_S) -> None:
        self._plain_every_s = plain_every_s
        self._what, self._done, self._total = first, 0, 0
        super().__init__(console, self._line)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._print_now_and_then, name="brink-steps", daemon=True)

    def __enter__(self) -> Self:
        """Start the display."""
        if self._live is None:
            self._thread.start()
        return super().__enter__()

    def __exit__(self, *_: object) -> None:
        """Stop the display and restore the terminal."""
        self._ended.set()
        if self._live is None:
            self._thread.join()
        super().__exit__()

    def show(self, what: str, done: int = 0, total: int = 0) -> None:
        """Show a step, with its progress unless `total` is 0; safe from any thread."""
        self._what, self._done, self._total = what, done, total

    def of(self, what: str) -> Callable[[int, int], None]:
        """Return a callback that shows the progress of a step."""
        self.show(what)
        return lambda done, total: self.show(what, done, total)

    def _line(self) -> Text:
        parts = [self._what]
        if self._total:
            parts.append(f"{self._done:,} of {self._total:,}")
        parts.append(duration(time.monotonic() - self._began))
        return Text(", ".join(parts), no_wrap=True, overflow="ellipsis")

    def _print_now_and_then(self) -> None:
        wait_s = min(FIRST_LINE_S, self._plain_every_s)
        while not self._ended.wait(wait_s):
            self._console.print(self._line(), soft_wrap=True)
            wait_s = self._plain_every_s


class LiveDisplay(InPlace, ABC, Generic[P]):
    """A panel updated in place on a terminal; elsewhere a line every ten seconds."""

    def __init__(self, console: Console) -> None:
        super().__init__(console)
        self._printed_at = float("-inf")

    @abstractmethod
    async def fetch(self, api: Api, work: str) -> P:
        """Return the progress of the work with this id."""

    @abstractmethod
    def _panel(self, progress: P) -> RenderableType:
        """Return what a terminal shows."""

    @abstractmethod
    def _line(self, progress: P) -> str:
        """Return the text for output that is not a terminal."""

    def show(self, progress: P) -> None:
        """Show the panel on a terminal; elsewhere print the line, unless one was printed recently.

        Before the first worker connects, the line says nothing, so it is only printed if that takes long.
        """
        if self._live is not None:
            self._live.update(self._panel(progress))
            return
        waiting = progress.status is CampaignStatus.RUNNING and not (progress.workers or progress.simulations)
        now = time.monotonic()
        if now - (max(self._began, self._printed_at) if waiting else self._printed_at) >= PLAIN_EVERY_S:
            self._printed_at = time.monotonic()
            self._console.print(Text(self._line(progress)), soft_wrap=True)


class CampaignDisplay(LiveDisplay[Progress]):
    """Progress display of a campaign."""

    def __init__(self, console: Console) -> None:
        super().__init__(console)
        self._series: list[GenerationView] = []
        self._failed = False

    async def fetch(self, api: Api, campaign: str) -> Progress:
        """Return the progress of a campaign, with the generations that were not shown yet."""
        since = {"since": len(self._series)}
        return await api.read(Progress, f"/campaigns/{campaign}/progress", since)

    def show(self, progress: Progress) -> None:
        """Show the progress of a campaign, including new generations."""
        self._series += [one for one in progress.generations if one.number >= len(self._series)]
        if failures_of(progress) and not self._failed:
            self._printed_at, self._failed = float("-inf"), True
        super().show(progress)

    def _panel(self, progress: Progress) -> Group:
        kind = "evaluations" if progress.measured else "simulations"
        facts = facts_table(
            [(name, Text(value), Text(series, style="cyan")) for name, value, series in self._facts(progress)]
        )
        return Group(budget_bar(progress.name, progress.simulations, progress.budget, kind), facts)

    def _facts(self, progress: Progress) -> list[tuple[str, str, str]]:
        """Return the name, value and sparkline of each line of the panel."""
        last = self._series[-1] if self._series else None
        shares = [one.unsafe / one.evaluated for one in self._series if one.evaluated]
        rated = self._series if progress.minimises else []
        best = [one.best_fitness for one in rated if one.best_fitness is not None]
        rows = [("unsafe", f"{shares[-1]:.0%}" if shares else "–", spark(shares))]
        if best or progress.minimises == "fitness":
            name = "best fitness" if progress.minimises == "fitness" else progress.minimises
            rows.append((name, f"{best[-1]:.3f}" if best else "–", spark(best)))
        if progress.is_for("boundary"):
            boundary = f"{last.dbs} distinct, {last.strict_dbs} strict" if last else "–"
            rows.append(("boundary", boundary, spark([one.dbs or 0 for one in self._series])))
        rows += [("rate", rate_words(progress), ""), ("workers", workers_words(progress), "")]
        if progress.measured:
            rows.append(("on data", f"{progress.measured} measured   simulated {progress.evaluated}", ""))
        if failures_of(progress):
            rows.append(("failed", failures_words(progress), ""))
        # Before the first worker connects, every job is unrunnable: nothing worth reporting.
        rows += [("waiting", words, "") for words in waits_words(progress)] if progress.workers else []
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
            *(f"{name} {facts[name]}" for name in shown if facts.get(name, "–") != "–"),
            *rate_parts(progress),
            f"workers {progress.workers or 'none yet'}",
        ]
        failures = f"failed {failures_words(progress)}" if failures_of(progress) else ""
        return ", ".join(filter(None, [*parts, progress.asking, failures, progress.trouble]))


class ExperimentDisplay(LiveDisplay[ExperimentProgress]):
    """Progress display of an experiment and, on a terminal, of its campaigns by method."""

    _members: Sequence[MemberView] = ()

    async def fetch(self, api: Api, experiment: str) -> ExperimentProgress:
        """Return the progress of an experiment."""
        if self._live is not None:
            self._members = (await api.read(ExperimentView, f"/experiments/{experiment}")).members
        return await api.read(ExperimentProgress, f"/experiments/{experiment}/progress")

    def _panel(self, progress: ExperimentProgress) -> Group:
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
        return Group(bar, facts, *([_methods(self._members)] if self._members else []))

    def _line(self, progress: ExperimentProgress) -> str:
        parts = [
            f"{progress.simulations}/{progress.budget} simulations",
            f"{progress.finished} of {progress.campaigns} campaigns finished",
            *rate_parts(progress),
            f"workers {progress.workers or 'none yet'}",
        ]
        return ", ".join(filter(None, [*parts, progress.trouble]))


class FollowUpsDisplay(ExperimentDisplay):
    """Progress display of the follow-ups of an experiment."""

    async def fetch(self, api: Api, experiment: str) -> ExperimentProgress:
        """Return the progress of the follow-ups of an experiment."""
        return await api.read(ExperimentProgress, f"/experiments/{experiment}/follow-ups")


def _methods(members: Sequence[MemberView]) -> Table:
    """Return a table of the campaigns by method."""
    several = len({member.problem for member in members}) > 1
    by_method: dict[str, list[MemberView]] = {}
    for member in members:
        label = f"{member.method}, {member.problem}" if several else member.method
        by_method.setdefault(label, []).append(member)
    columns = ("finished", "simulations", "unsafe")
    table = plain_table("method", *columns, right=columns)
    for label, ours in by_method.items():
        finished = sum(one.status is CampaignStatus.FINISHED for one in ours)
        simulations, unsafe = sum(one.simulations for one in ours), sum(one.unsafe for one in ours)
        share = f"{unsafe / simulations:.0%}" if simulations else "–"
        table.add_row(Text(label), f"{finished} of {len(ours)}", f"{simulations:,}", share)
    return table


def budget_bar(name: str, simulations: int, budget: int, kind: str = "simulations") -> Table:
    """Return a progress bar with the name of a campaign or an experiment.

    Args:
        name: Name shown in front of the bar.
        simulations: Completed so far; may exceed the budget.
        budget: Simulations in all.
        kind: What is counted, in words.
    """
    bar = Table.grid(padding=(0, 1))
    bar.add_column(no_wrap=True, overflow="ellipsis")
    bar.add_column()  # the only one that may shrink
    bar.add_column(no_wrap=True, overflow="ellipsis")
    bar.add_row(
        Text(name, style="bold"),
        ProgressBar(total=budget, completed=min(simulations, budget), width=SERIES_WIDTH),
        f"{simulations:,} of {budget:,} {kind}",
    )
    return bar


def facts_table(rows: Sequence[tuple[str, *tuple[Text, ...]]]) -> Table:
    """Return a table of facts below a progress bar: a name and its values in each row, cut at the screen's edge."""
    facts = Table.grid(padding=(0, 2))
    for name, *values in rows:
        facts.add_row(Text(name, style="dim"), *values)
    for column in facts.columns:
        column.no_wrap, column.overflow = True, "ellipsis"
    return facts


def earlier_words(progress: Progress | ExperimentProgress) -> str:
    """State that a result comes from an earlier run: when it finished, if known, and that nothing was simulated."""
    at = progress.finished_at if isinstance(progress, Progress) else None
    return f"finished earlier{f', on {at:%Y-%m-%d at %H:%M} UTC' if at else ''}; nothing was simulated"


def waits_words(progress: Progress) -> list[str]:
    """Describe the queued jobs that wait for a suitable worker, one line for each kind of worker."""
    return [
        f"{count:,} {'job waits' if count == 1 else 'jobs wait'} for {progress.waits_for.get(needs, needs)}"
        for needs, count in progress.unrunnable.items()
    ]


def failures_of(progress: Progress) -> int:
    """Return how many simulations of a campaign have failed, whether or not its search has received them."""
    return progress.failed + progress.reported_failed


def failures_words(progress: Progress) -> str:
    """Return how many simulations of a campaign have failed, and the first error."""
    first = f" (first: {progress.failure})" if progress.failure else ""
    return f"{failures_of(progress):,}{first}"


def rate_parts(progress: Progress | ExperimentProgress) -> list[str]:
    """Return the simulation rate, the number of cached results, and the time left, if known."""
    parts = [] if progress.rate_per_s is None else [rate_of(progress.rate_per_s)]
    if progress.cached:
        parts.append(f"{progress.cached:,} from the cache")
    if progress.remaining_s is not None:
        parts.append(f"remaining {duration(progress.remaining_s)}")
    return parts


def rate_words(progress: Progress | ExperimentProgress) -> str:
    """Return `rate_parts` as the text of a row."""
    return "   ".join(rate_parts(progress)) or "–"


def workers_words(progress: Progress | ExperimentProgress) -> str:
    """Return how many workers there are, and their states."""
    return f"{progress.workers or 'none yet'}   running {progress.leased}   queued {progress.queued}"


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


def duration(seconds: float) -> str:
    """Return a duration as text."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02} min"
    return f"{minutes} min {rest:02} s" if minutes else f"{rest} s"
