"""Everything that the report of a campaign contains, fetched over the API."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

from brink.api.client import Api
from brink.api.live import failures_of
from brink.api.results import FetchedArchive, fetch_archive
from brink.search.analysis.dependence import ParameterColumn, parameter_columns
from brink.search.analysis.rules import Rules, region_rules
from brink.search.errors import MissingExtra
from brink.server.api.schemas import CampaignList, CampaignView, JobList, Progress
from brink.server.findings.boundary.repeat_views import RepeatsView
from brink.server.findings.finding import Finding, Findings
from brink.server.findings.tolerances.views import DetectorView
from brink.server.problems.base import InProcessProblem
from brink.server.problems.catalogue import is_baseline
from brink.server.states import CampaignStatus, JobStatus
from brink.server.views import SolutionView

Show: TypeAlias = Callable[[str, int, int], None]
"""Called with what is being done, in words, how much of it is done, and how much there is; 0 if that is unknown."""
OPEN: Final = (CampaignStatus.RUNNING, CampaignStatus.PAUSED)
LISTED: Final = 200
"""Campaigns among which random search on the same problem is looked for, newest first."""
MOST_ROWS: Final = 20
"""Rows of each table."""
ALL_ROWS: Final = 1_000
_JOBS: Final = 1000
_ALL_GENERATIONS: Final = 10**9
"""Cursor beyond the last generation of every campaign, for progress without its series of generations."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Jobs:
    """The sources of a campaign's results.

    Attributes:
        simulated: Results that its own jobs gave.
        cached: Results that were taken over from identical simulations.
        repeated: Jobs that took more than one attempt.
    """

    simulated: int
    cached: int
    repeated: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Facts:
    """The facts about a campaign.

    Attributes:
        view: The campaign.
        progress: Its counts.
        finding: What it found, and the campaign that it follows up, if any.
        fetched: Its archive.
        detector: Whether the detector of another campaign meets its tolerances; None if none was named.
        repeats: Simulations of its solutions with other seeds, in separate campaigns.
        rules: The rules of its unsafe region.
        jobs: Where its results came from; None if verdicts are computed.
        random: Random search on the same problem, the largest first.
        sample: Its first evaluated solution, with provenance.
    """

    view: CampaignView
    progress: Progress
    finding: Findings
    fetched: FetchedArchive
    detector: DetectorView | None
    repeats: Sequence[RepeatsView]
    rules: Rules | None
    jobs: Jobs | None
    random: Sequence[CampaignView]
    sample: SolutionView | None

    @property
    def ended(self) -> bool:
        """Whether the campaign has ended; if not, more results may come."""
        return self.progress.status not in OPEN

    @property
    def evaluated(self) -> int:
        """Solutions with a verdict."""
        return len(self.fetched.archive)

    @property
    def unsafe(self) -> int:
        """Those that are unsafe."""
        return int(self.fetched.archive.unsafe.sum())

    @property
    def columns(self) -> list[ParameterColumn]:
        """All parameters with their values in the evaluated solutions."""
        fetched = self.fetched
        return parameter_columns(fetched.plan.problem.space, fetched.archive.vectors, fetched.active)

    @property
    def left_out(self) -> int:
        """Simulations of incomplete generations, whose results are not counted elsewhere."""
        return max(
            self.progress.simulations - self.evaluated - failures_of(self.progress) - self.progress.measured,
            0,
        )

    @property
    def computed(self) -> bool:
        """Whether the verdicts are deterministic."""
        return self.fetched.plan.problem.ignores_seeds

    @property
    def drives(self) -> bool:
        """Whether solutions are drives, which can be replayed."""
        return self.fetched.plan.problem.records_traces

    @property
    def noun(self) -> str:
        """What a solution is called."""
        return "drive" if self.drives else "solution"

    @property
    def found(self) -> list[Finding]:
        """The findings that there are, what the campaign was for first."""
        return [one for one in self.finding.findings if not one.is_empty]


async def fetch_facts(api: Api, campaign: str, show: Show, *, episodes: str | None = None) -> Facts:
    """Fetch everything that the report of a campaign contains.

    Args:
        api: Coordinator of the campaign.
        campaign: Id of the campaign, or a unique prefix of it.
        show: Called with what is being done.
        episodes: Id of a campaign whose detector is checked against its tolerances; None for none.

    Raises:
        CoordinatorError: The campaign does not exist, or the detector cannot be checked.
        InvalidInput: Its problem or algorithm is not installed here.
    """
    show("reading the campaign", 0, 0)
    view = await api.read(CampaignView, f"/campaigns/{campaign}")
    path = f"/campaigns/{view.id}"
    progress = await api.read(Progress, f"{path}/progress", {"since": _ALL_GENERATIONS})
    finding = await api.read(Findings, f"{path}/findings", {"rows": MOST_ROWS})
    if finding.exclusive:  # its one finding is all that the report is about
        finding = await api.read(Findings, f"{path}/findings", {"rows": ALL_ROWS})
    fetched = await fetch_archive(api, view.id)
    problem, archive = fetched.plan.problem, fetched.archive
    show("comparing with random search", 0, 0)
    detector = None
    if episodes is not None:
        detector = await api.read(DetectorView, f"{path}/tolerance/detector", {"episodes": episodes})
    first = int(archive.numbers[0]) if len(archive) else None
    return Facts(
        view=view,
        progress=progress,
        finding=finding,
        fetched=fetched,
        detector=detector,
        repeats=await api.read(list[RepeatsView], f"{path}/repeats"),
        rules=_rules(fetched),
        jobs=None if isinstance(problem, InProcessProblem) else await _jobs(api, view.id),
        random=await _random_search(api, view),
        sample=None if first is None else await api.read(SolutionView, f"{path}/solutions/{first}"),
    )


def _rules(fetched: FetchedArchive) -> Rules | None:
    """Return the rules of the unsafe region; None if there is nothing to explain, or an extra is missing."""
    unsafe = fetched.archive.unsafe
    if not unsafe.any() or unsafe.all():
        return None
    try:
        return region_rules(
            fetched.archive,
            fetched.plan.problem.space,
            unsafe,
            "the unsafe solutions",
            seed=fetched.body.seed,
            recorded=fetched.active,
        )
    except MissingExtra:
        return None


async def _jobs(api: Api, campaign: str) -> Jobs:
    """Count the sources of results: a job that was never leased took its result from an identical one."""
    simulated = cached = repeated = 0
    params = {"campaign": campaign, "status": JobStatus.DONE.value, "limit": _JOBS}
    async for page in api.pages(JobList, "/jobs", params):
        for job in page.jobs:
            if job.kind != "trace":
                simulated += job.attempt > 0
                cached += job.attempt == 0
                repeated += job.attempt > 1
    return Jobs(simulated=simulated, cached=cached, repeated=repeated)


async def _random_search(api: Api, view: CampaignView) -> Sequence[CampaignView]:
    """Return finished campaigns of random search on the same problem and simulator, the largest first."""
    if is_baseline(view.body.algorithm.id):
        return []
    asked = {"limit": LISTED, "status": CampaignStatus.FINISHED.value}
    found = [
        one
        for one in (await api.read(CampaignList, "/campaigns", asked)).campaigns
        if is_baseline(one.body.algorithm.id)
        and one.body.problem == view.body.problem
        and one.body.ground_truth == view.body.ground_truth
    ]
    alone = [await api.read(CampaignView, f"/campaigns/{one.id}") for one in found]  # lists name no simulator
    return sorted((one for one in alone if one.simulator == view.simulator), key=lambda one: -one.simulations)
