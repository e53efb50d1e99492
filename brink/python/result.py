"""The result of a campaign, for Python: data frames, figures, replays.

`AsyncResult` does the work; `Result` is its synchronous form.
"""

import asyncio
import base64
import contextlib
import html
import io
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

from brink.api.client import Api, CoordinatorError
from brink.api.follow_ups import continue_follow_up, follow_up_requests
from brink.api.following import Silent, go_on
from brink.api.live import failures_of
from brink.api.results import (
    FetchedArchive,
    fetch_archive,
    fetch_requirements,
    find_pair,
    read_all_pairs,
    trace_of,
)
from brink.pictures import render
from brink.python.connection import Connection, environment_with, with_workers
from brink.python.frames import archive_frame, data_frame, table_frame, typed_frame, types_of
from brink.python.picture import Picture
from brink.python.synchronous import Synchronous, synchronous_method
from brink.report.campaign import campaign_report, write_page
from brink.report.figures import VIOLATION_TYPES, campaign_figure, marked_pairs
from brink.report.limits import MOST_PAIRS as MOST_SHOWN
from brink.report.pair_pictures import headline, write_pair
from brink.report.violations import figure_types
from brink.search.errors import TooManyPairs
from brink.server.api.schemas import CampaignView, Progress
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B, CampaignBody
from brink.server.errors import InvalidInput, ServerError
from brink.server.findings.boundary.table import boundary_columns, boundary_rows
from brink.server.findings.boundary.views import Boundary
from brink.server.findings.finding import Finding, Findings, Role
from brink.server.findings.follow_ups import FollowUpView
from brink.server.findings.pairs.table import pair_columns, pair_rows
from brink.server.findings.pairs.views import MOST_PAIRS, PairsView
from brink.server.findings.rate.views import RateView
from brink.server.findings.table import Table
from brink.server.findings.thresholds.kind import KIND as THRESHOLDS
from brink.server.findings.thresholds.kind import columns as threshold_columns
from brink.server.findings.violations.views import Violations
from brink.server.states import CampaignStatus
from brink.server.views import SolutionView

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

_VIOLATION: Final[Mapping[str, type]] = {
    "number": int,
    "requirement": str,
    "time_s": float,
    "type": str,
    "name": str,
    "avoidable": str,
    "avoided_by": str,
    "at_fault": bool,
    "signature": dict,
    "circumstances": dict,
}


class CampaignUnfinished(ServerError):
    """A campaign ended without finishing: it was cancelled, or paused after too many failures."""


def check_finished(progress: Progress) -> None:
    """Check that a campaign has finished.

    Raises:
        CampaignUnfinished: It was cancelled, or paused by a user or after too many failures.
    """
    if progress.status is not CampaignStatus.FINISHED:
        reason = f": {progress.status_reason}" if progress.status_reason else ""
        raise CampaignUnfinished(f"campaign {progress.id} is {progress.status}{reason}")


@dataclass(slots=True, kw_only=True)
class _Words:
    """Sentences about a result, which its two forms share."""

    finding: str
    note: str


class CampaignResult:
    """The facts about a campaign that need no further request: its id, its counts, and its finding in a sentence."""

    def __init__(self, connection: Connection, progress: Progress, body: CampaignBody, words: _Words) -> None:
        self._connection = connection
        self._progress = progress
        self._body = body
        self._words = words

    @property
    def finding(self) -> str:
        """The finding, in a sentence."""
        return self._words.finding

    @property
    def note(self) -> str:
        """A note if this is the result of an earlier run, or if an earlier run used different code; else empty."""
        return self._words.note

    @property
    def id(self) -> str:
        """Id of the campaign."""
        return self._progress.id

    @property
    def name(self) -> str:
        """Name of the campaign."""
        return self._progress.name

    @property
    def status(self) -> CampaignStatus:
        """Status of the campaign when the result was fetched."""
        return self._progress.status

    @property
    def simulations(self) -> int:
        """Simulations done."""
        return self._progress.simulations

    @property
    def evaluated(self) -> int:
        """Solutions with a verdict."""
        return self._progress.evaluated

    @property
    def unsafe(self) -> int:
        """Unsafe solutions."""
        return self._progress.unsafe

    @property
    def failed(self) -> int:
        """Solutions whose simulations failed: they are neither safe nor unsafe."""
        return failures_of(self._progress)

    @property
    def digest(self) -> str | None:
        """SHA-256 of all solutions and verdicts, once the campaign has ended."""
        return self._progress.digest

    @property
    def campaign(self) -> CampaignBody:
        """The campaign as it was submitted."""
        return self._body

    def __repr__(self) -> str:
        note = f" ({self.note})" if self.note else ""
        return f"<result of campaign {self.id}, {self.name}: {self.finding}{note}>"


class AsyncResult(CampaignResult):
    """The result of a campaign: the methods of `Result`, with ``await``."""

    _fetched: FetchedArchive | None = None
    function: Callable[..., Any] | None = None
    """The function that was searched, for workers that call it again."""

    @classmethod
    async def fetch(cls, connection: Connection, campaign: str, note: str = "") -> Self:
        """Return the result of a campaign so far.

        Args:
            connection: Where it is.
            campaign: Its id.
            note: What to say about the run besides.

        Raises:
            CoordinatorError: It does not exist, or nobody answers.
        """
        async with connection.open() as api:
            progress = await api.read(Progress, f"/campaigns/{campaign}/progress")
            view = await api.read(CampaignView, f"/campaigns/{campaign}")
            words = _Words(finding=await _finding(api, progress), note=note)
            return cls(connection, progress, view.body, words)

    async def archive(self) -> FetchedArchive:
        """Return all evaluated solutions with their search space."""
        if self._fetched is None:
            async with self._connection.open() as api:
                self._fetched = await fetch_archive(api, self.id)
        return self._fetched

    async def to_pandas(self) -> "pd.DataFrame":
        """Return all evaluated solutions as a data frame, one row each.

        Returns:
            The columns ``number``, one for each parameter (empty where it was inactive), ``unsafe``,
            ``robustness`` (negative if unsafe), ``fitness`` (distance from the boundary), ``neighbours``,
            ``unsafe_neighbours`` and ``outcome``, in words.

        Raises:
            MissingExtra: pandas is not installed.
        """
        fetched = await self.archive()
        frame = archive_frame(fetched.archive, fetched.plan.problem.space, fetched.active)
        view = fetched.outcomes
        words = {
            number: view.groups[group].words
            for number, group in zip(view.number or (), view.group or (), strict=True)
        }
        frame["outcome"] = frame["number"].map(words)
        return frame

    async def boundary(self, t_b: float = DEFAULT_T_B, d_th: float = DEFAULT_D_TH) -> "pd.DataFrame":
        """Return the distinct boundary solutions as a data frame, best first; at most the best 1,000.

        A warning says how many there are if these are not all.

        Args:
            t_b: Maximum fitness of a boundary solution.
            d_th: Minimum distance between two of them.
        """
        async with self._connection.open() as api:
            view = await api.read(Boundary, f"/campaigns/{self.id}/boundary", {"t_b": t_b, "d_th": d_th})
        if len(view.solutions) < view.dbs:
            warnings.warn(f"only {view.words}", stacklevel=2)
        rows = boundary_rows(view, self.id, self._body)
        return typed_frame(rows, types_of(rows[0]) if rows else await self._boundary_columns(view))

    async def _boundary_columns(self, empty: Boundary) -> dict[str, type]:
        """Return the columns of boundary solutions; any evaluated solution shows which measurements exist."""
        fetched = await self.archive()
        columns = boundary_columns(fetched.plan.problem.space)
        if not len(fetched.archive):
            return columns
        async with self._connection.open() as api:
            any_one = f"/campaigns/{self.id}/solutions/{fetched.archive.numbers[0]}"
            view = empty.model_copy(update={"solutions": [await api.read(SolutionView, any_one)]})
        return types_of(boundary_rows(view, self.id, self._body)[0]) | columns

    async def pairs(self, eps: float | None = None, d_th: float | None = None) -> "pd.DataFrame":
        """Return the distinct pairs across the boundary as a data frame, best first.

        Args:
            eps: Largest distance between the sides of a pair; by default the campaign's.
            d_th: Smallest distance between two distinct pairs; by default the campaign's.
        """
        params = {"limit": MOST_PAIRS, **_given(eps=eps, d_th=d_th)}
        async with self._connection.open() as api:
            view = await api.read(PairsView, f"/campaigns/{self.id}/pairs", params)
        rows = pair_rows(view)
        frame = typed_frame(rows, {} if rows else pair_columns((await self.archive()).plan.problem.space))
        frame.insert(0, "words", frame.pop("words"))  # print() leaves out the columns in the middle
        return frame

    async def check_pairs(
        self,
        confirm: int | None = None,
        *,
        component: bool = False,
        minimise: bool = False,
        sharpen: bool = False,
        limit: int | None = None,
        workers: int = 2,
    ) -> "pd.DataFrame":
        """Simulate sides of the pairs again to find out more about them.

        Args:
            confirm: Most simulations of each side with other seeds: does the pair hold?
            component: Whether to simulate the unsafe sides with ground truth in place of the component: who is to
                blame?
            minimise: Whether to revert the differences one by one: which of them matter?
            sharpen: Whether to bring the pairs to thresholds: where exactly between their sides does it turn?
            limit: Maximum number of pairs to follow up, first ones first.
            workers: Worker processes, unless a coordinator elsewhere has its own.

        Returns:
            The pairs, with what was found; with ``sharpen``, the thresholds, the narrowest first.

        Raises:
            CoordinatorError: There is nothing to simulate, or it cannot be simulated.
            CampaignUnfinished: The simulations ended early.
        """
        asked = follow_up_requests(
            {}, confirm, component=component, minimise=minimise, sharpen=sharpen, limit=limit
        )
        if not asked:
            raise InvalidInput.at(
                "confirm",
                "expected confirm=30, component=True, minimise=True or sharpen=True; got none of them",
            )
        with environment_with(self.function) as environment:
            async with with_workers(self._connection, workers, environment) as session:
                api = session.api
                for request in asked:
                    view = await api.send(FollowUpView, f"/campaigns/{self.id}/pairs/follow-ups", request)
                    await continue_follow_up(api, view)
                    check = go_on if session.processes is None else _check_runnable
                    paths = [f"/campaigns/{view.campaign}"]
                    check_finished(await session.follow(view.campaign, Silent(), paths, check))
                self._words.finding = await _finding(api, self._progress)
                if sharpen:
                    return await _thresholds_of(api, view.campaign)
        return await self.pairs()

    async def findings(self, kind: str | None = None, table: str | None = None) -> "pd.DataFrame":
        """Return one kind of findings as a data frame, or a data frame with a sentence for each kind.

        Args:
            kind: The kind, such as ``pairs``; None for an overview of all kinds.
            table: Name of the table, if the kind has several; by default the first.

        Raises:
            CoordinatorError: The campaign has no findings of this kind.
            InvalidInput: The kind has no such table.
        """
        async with self._connection.open() as api:
            if kind is None:
                found = await api.read(Findings, f"/campaigns/{self.id}/findings", {"rows": 0})
                return data_frame(
                    [
                        {"kind": one.kind, "role": str(one.role), "sentence": one.sentence}
                        for one in found.findings
                    ]
                )
            finding = await api.read(Finding, f"/campaigns/{self.id}/findings/{kind}")
        chosen = finding.table(table)
        if chosen is None:
            names = ", ".join(one.name for one in finding.tables) or "none"
            raise InvalidInput.at("table", f"expected one of {names}; got {table}")
        return table_frame(chosen)

    async def violations(self) -> "pd.DataFrame":
        """Return the violations that the simulator classified as a data frame, or else all unsafe solutions.

        The column ``avoidable`` says who would have avoided a violation: ``careful``, ``ideal``, ``no``, or None if
        that was not measured. ``avoided_by`` says how: by ``braking`` before the time of the violation, or by
        ``driving on``.
        """
        async with self._connection.open() as api:
            with contextlib.suppress(CoordinatorError):
                found = (await api.get(f"/campaigns/{self.id}/violations"))["violations"]
                return typed_frame(found, _VIOLATION)
        frame = await self.to_pandas()
        return frame[frame["unsafe"]].reset_index(drop=True)

    async def combinations(self) -> "pd.DataFrame":
        """Return the simulated chains of perturbations as a data frame, the most informative first.

        ``added_harm`` is by how much lower mAP is on the data set than with the most harmful part alone. Effects that
        merely add up count, and it says nothing about hazards in drives. It is empty where that was not measured.
        ``interacts`` says whether it reaches the margin of the search. ``example`` is an unsafe solution that needs
        all its perturbations or their order, if there is one.

        Raises:
            CoordinatorError: The problem has no ordered perturbations.
        """
        return await self.findings("combinations")

    async def rate(
        self, *, at_most: float | None = None, confidence: float | None = None, by: str | None = None
    ) -> RateView:
        """Return how often solutions are unsafe in operation, for campaigns of `rate@1` and `random@1`.

        Args:
            at_most: Claim to check: the largest acceptable rate; by default the campaign's.
            confidence: Confidence of intervals and claim; by default the campaign's, or 0.95.
            by: Categories to tell apart, such as ``scenario.weather``, separated by commas; ``+`` crosses them.

        Raises:
            CoordinatorError: The campaign does not draw from operation.
            InvalidInput: Nothing was simulated yet.
        """
        settings = _given(at_most=at_most, confidence=confidence, by=by)
        async with self._connection.open() as api:
            finding = await api.read(Finding, f"/campaigns/{self.id}/findings/rate", settings)
        if finding.view is None:
            raise InvalidInput.at("rate", finding.sentence)
        return RateView.model_validate(finding.view)

    async def tolerances(self) -> "pd.DataFrame":
        """Return how severe each error may be as a data frame.

        Raises:
            CoordinatorError: The campaign did not search for that.
        """
        return await self.findings("tolerances")

    async def plot(self, what: str = "map") -> "Figure":
        """Draw a figure, which a notebook displays and matplotlib can change.

        Args:
            what: ``map`` (similar solutions lie close together), ``parameters`` (how the verdict depends on each),
                ``dbs`` (boundary solutions against simulations), ``fitness``, or, of scripted traffic,
                ``violation-types`` (known types against solutions).

        Raises:
            InvalidInput: There is no such figure.
            CoordinatorError: The campaign has no types of violations.
        """
        if what == VIOLATION_TYPES:
            async with self._connection.open() as api:
                found = await api.read(Violations, f"/campaigns/{self.id}/violations")
            return await asyncio.to_thread(figure_types, found)
        fetched = await self.archive()
        async with self._connection.open() as api:
            pairs = await marked_pairs(api, fetched)
        return await asyncio.to_thread(
            campaign_figure, what, fetched, t_b=DEFAULT_T_B, d_th=DEFAULT_D_TH, pairs=pairs
        )

    async def pair(self, place: int | None = None, *, film: bool = False) -> Picture:
        """Draw both drives of a pair side by side or, if nothing was driven, the differences between the two.

        Args:
            place: Number of the pair, from 1; by default the one with the best evidence: a confirmed one, if any is.
            film: Whether to draw a film instead of a picture.

        Raises:
            InvalidInput: There is no such pair.
        """
        async with self._connection.open() as api:
            view = await read_all_pairs(api, self.id)
            if isinstance(view, TooManyPairs):
                raise view
            if place is None and not view.pairs:
                raise InvalidInput.at("pair", f"expected a campaign with pairs; {view.note}")
            chosen = view.pairs[0] if place is None else find_pair(view, place)
            if chosen is None:
                raise InvalidInput.at(
                    "place", f"expected the number of one of {len(view.pairs)} pairs, from 1; got {place}"
                )
            with _scratch(film) as path:
                await write_pair(api, view, chosen, path, workers=self._connection.has_workers)
                return Picture(content=path.read_bytes(), suffix=path.suffix, words=headline(chosen))

    async def replay(self, number: int, *, film: bool = False) -> Picture:
        """Simulate a solution again and draw its drive.

        Args:
            number: Number of the solution, as in the column ``number`` of `to_pandas`.
            film: Whether to draw a film instead of a picture.

        Raises:
            NothingToReplay: Its simulator records no drives.
            CoordinatorError: There is no such solution.
        """
        async with self._connection.open() as api:
            requirement = await fetch_requirements(api, self.id)
            trace = await trace_of(api, self.id, number, workers=self._connection.has_workers)
        with _scratch(film) as path:
            await asyncio.to_thread(render, trace, path, requirement=requirement)
            words = f"solution {number} of {self.name}"
            return Picture(content=path.read_bytes(), suffix=path.suffix, words=words)

    async def report(self, file: str | Path = "report.html", *, pairs: int = MOST_SHOWN) -> Path:
        """Write a report to hand on: one HTML file with all pictures, for people who have never seen Brink.

        Args:
            file: The file to write.
            pairs: Most pairs to show in full, with pictures; the others are in a table.

        Returns:
            The file.
        """
        async with self._connection.open() as api:
            page = await campaign_report(api, self.id, most_pairs=pairs, workers=self._connection.has_workers)
        write_page(Path(file), page)
        return Path(file)


class Result(CampaignResult, Synchronous[AsyncResult]):
    """The result of a campaign: data frames, figures, replays. A notebook displays it with its map.

    Most methods fetch or simulate what they return. `AsyncResult` has the same methods with ``await``.
    """

    _shown: tuple[str, str] | None = None
    """The finding, and how a notebook shows the result while that is the finding."""

    def __init__(self, result: AsyncResult) -> None:
        CampaignResult.__init__(self, result._connection, result._progress, result._body, result._words)
        Synchronous.__init__(self, result)

    to_pandas = synchronous_method(AsyncResult.to_pandas)
    boundary = synchronous_method(AsyncResult.boundary)
    pairs = synchronous_method(AsyncResult.pairs)
    check_pairs = synchronous_method(AsyncResult.check_pairs)
    findings = synchronous_method(AsyncResult.findings)
    violations = synchronous_method(AsyncResult.violations)
    combinations = synchronous_method(AsyncResult.combinations)
    tolerances = synchronous_method(AsyncResult.tolerances)
    rate = synchronous_method(AsyncResult.rate)
    plot = synchronous_method(AsyncResult.plot)
    pair = synchronous_method(AsyncResult.pair)
    replay = synchronous_method(AsyncResult.replay)
    report = synchronous_method(AsyncResult.report)

    def _repr_html_(self) -> str:
        """Return what a notebook displays: the finding, the counts and the map."""
        if self._shown is None or self._shown[0] != self.finding:
            picture = io.BytesIO()
            self.plot().savefig(picture, format="png", dpi=60)
            encoded = base64.b64encode(picture.getvalue()).decode()
            shown = (
                f"<div>{self._summary_html()}"
                f'<img alt="map of all solutions" style="max-width:100%" src="data:image/png;base64,{encoded}"></div>'
            )
            self._shown = self.finding, shown
        return self._shown[1]

    def _summary_html(self) -> str:
        share = f"{self.unsafe / self.evaluated:.0%}" if self.evaluated else "–"
        facts = (
            f"campaign {self.id} · {self._body.algorithm.id} on {self._body.problem.id} · "
            f"{self.simulations:,} simulations, {share} unsafe, {self.failed:,} failed · "
            f"{self.note or self.status.value}"
        )
        name, finding, facts = map(html.escape, (self.name, self.finding, facts))
        return f'<h4>{name}</h4><p><b>{finding}</b></p><p style="opacity:0.7">{facts}</p>'


async def _thresholds_of(api: Api, campaign: str) -> "pd.DataFrame":
    """Return the thresholds that a follow-up of pairs found as a data frame; without any, it has all columns."""
    finding = await api.read(Finding, f"/campaigns/{campaign}/findings/{THRESHOLDS.id}")
    empty = Table(name=THRESHOLDS.id, title="", columns=threshold_columns(computed=False), rows=[])
    return table_frame(finding.table(None) or empty)


async def _finding(api: Api, progress: Progress) -> str:
    """Return the finding of a campaign in a sentence, and what to try if it did not find what it searched for."""
    found = await api.read(Findings, f"/campaigns/{progress.id}/findings", {"rows": 0})
    first = found.findings[0] if found.findings and found.complete and found.of is None else None
    if first is None or not first.is_empty or first.role is not Role.SOUGHT:
        return found.words
    return " ".join([found.words, *(step.words for step in first.steps)])


def _check_runnable(progress: Progress) -> None:
    """Check that workers of this machine can simulate a follow-up; none will come from elsewhere.

    Raises:
        CampaignUnfinished: They cannot.
    """
    if progress.workers and progress.unrunnable and not progress.leased:
        raise CampaignUnfinished(
            f"campaign {progress.id} waits for {' and '.join(progress.waits_for.values())}, and no worker of this "
            "machine is one: install the extra, name the plug-in in BRINK_PLUGINS, or, for a function, ask the "
            "result that brink.search() returned"
        )


def _given(**settings: float | str | None) -> dict[str, float | str]:
    return {name: value for name, value in settings.items() if value is not None}


@contextlib.contextmanager
def _scratch(film: bool) -> Iterator[Path]:
    """Yield the path of a film or a picture that is deleted at the end of the block."""
    with tempfile.TemporaryDirectory(prefix="brink-") as folder:
        yield Path(folder) / ("film.mp4" if film else "picture.png")
