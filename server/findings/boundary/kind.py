"""The boundary as a kind of finding."""

from typing import Annotated

from pydantic import Field

from brink.search.analysis.boundary import has_evidence
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.campaigns.boundaries import read_last_count
from brink.server.campaigns.follow_ups.limits import DEFAULT_REPEATS, MOST
from brink.server.campaigns.plan import check_repeatable
from brink.server.errors import InvalidInput
from brink.server.findings.boundary.analysis import boundary_note, boundary_table, boundary_words, grid_table
from brink.server.findings.finding import Finding, Role, Step, StepRequest, Term
from brink.server.findings.follow_ups import follow_up_view
from brink.server.findings.kind import MOST_RINGS, Kind, Listed, Settings, Subject
from brink.server.findings.solutions import solutions_of
from brink.server.findings.words import counted, listed_words
from brink.server.states import ENDED, FollowUpKind, Selection


class BoundarySettings(Settings):
    """Thresholds: the maximum fitness of a boundary solution, and the minimum distance between two of them.

    `thresholds` adds DBS at other thresholds, which a search for the boundary always has.
    """

    t_b: Annotated[float, Field(ge=0, le=1)] = DEFAULT_T_B
    d_th: Annotated[float, Field(ge=0, le=1)] = DEFAULT_D_TH
    thresholds: bool = False


class BoundaryKind(Kind):
    """Distinct solutions near the hazard boundary."""

    id = "boundary"
    title = "The boundary"
    rank = 80
    settings = BoundarySettings

    async def find(self, subject: Subject) -> Finding:
        """Return the distinct boundary solutions, best first."""
        sources, read = subject.sources, subject.read
        t_b, d_th = subject.settings.t_b, subject.settings.d_th
        boundary = await sources.boundaries.get(subject.campaign, read, t_b, d_th)
        distinct, strict = boundary.counts.dbs, boundary.counts.strict
        numbers = [int(number) for number in read.archive.numbers[boundary.chosen[: subject.rows]]]
        solutions = await sources.pages.read(
            sources.engines, lambda c: solutions_of(c, subject.campaign, read, numbers, rated=True)
        )
        grid = []
        if subject.rows and (subject.settings.thresholds or subject.role is Role.SOUGHT):
            grid = [grid_table(await sources.boundaries.grid(subject.campaign, read))]
        near = subject.plan.neighbourhood
        is_strict = has_evidence(read.archive)[boundary.chosen]
        marked = [number for number, is_one in zip(numbers, is_strict, strict=False) if is_one]
        return Finding(
            kind=self.id,
            title=self.title,
            role=subject.role,
            sentence=boundary_words(distinct, strict, t_b=t_b, d_th=d_th),
            purpose=f"Brink searched for the hazard boundary: {subject.noun}s around which about {near.p_th:.0%} of "
            f"similar {subject.noun}s are unsafe.",
            figures=[
                Term(term=f"{distinct:,}", words=f"distinct boundary solution{'' if distinct == 1 else 's'}"),
                Term(term=f"{strict:,}", words="of them strict"),
            ],
            legend=[
                f"The neighbourhood of a solution is all evaluated solutions within a distance of {near.radius:g}, "
                f"and its fitness is how far the interval of their unsafe share lies from {near.p_th:g}: 0 is on the "
                "boundary",
                boundary_note(subject.campaign, read, boundary, t_b),
            ],
            rings=[[int(number)] for number in read.archive.numbers[boundary.chosen[:MOST_RINGS]]],
            is_empty=not distinct,
            tables=[
                boundary_table(solutions, marked, distinct, f"boundary?t_b={t_b:g}&d_th={d_th:g}"),
                *grid,
            ],
            steps=self._steps(subject, distinct, strict),
        )

    def brief(self, listed: Listed) -> str:
        """Return how many there are, as of the last generation."""
        with listed.archives.engines.reader.connect() as connection:
            return counted(read_last_count(connection, listed.campaign.id), "boundary solution")

    def _steps(self, subject: Subject, distinct: int, strict: int) -> list[Step]:
        campaign = subject.campaign.id
        other = Step(
            kind="thresholds",
            question="What about other thresholds?",
            words="Lists boundary solutions that are less near the boundary, or nearer to each other.",
            command=f"brink results {campaign} --t-b 0.15 --d-th 0.1",
        )
        if not distinct:
            return [subject.longer("Only neighbourhoods with enough solutions lie near the boundary."), other]
        steps = _repeat(subject, distinct)
        if len(subject.plan.problem.space.components) > 1:
            steps.append(
                Step(
                    kind="control",
                    question="How much of it is the component's?",
                    label="Compare with the control",
                    words="Compares it with its control, whose verdicts do not depend on the component.",
                    place=f"compare?ids={campaign}",
                    command=f"brink compare {campaign}",
                )
            )
        steps.append(other)
        if subject.plan.problem.records_traces:
            steps.append(
                Step(
                    kind="export",
                    question="Where is the evidence?",
                    words="Exports the boundary as tables, rules and replays.",
                    command=f"brink evidence {campaign} --out evidence",
                )
            )
        if not strict:
            steps.append(subject.longer("No boundary solution is strict yet: that takes more neighbours."))
        return steps


def _repeat(subject: Subject, distinct: int) -> list[Step]:
    """Return the step that simulates the boundary again, unless that was done or would be uninformative."""
    again = [
        one
        for one in subject.stored
        if one.kind is FollowUpKind.CONFIRM and one.selection is Selection.BOUNDARY
    ]
    open_one = next((one for one in again if one.campaign.status not in ENDED), None)
    if open_one is None and (again or _cannot_repeat(subject)):
        return []
    repeated = min(distinct, MOST)
    what = listed_words(repeated, distinct).removeprefix("the ") if distinct > 1 else "boundary solution"
    return [
        Step(
            kind="repeat",
            question="Does the boundary hold?",
            label="Repeat the boundary",
            words=f"Simulates the {what} with {DEFAULT_REPEATS} other seeds. It takes "
            f"{DEFAULT_REPEATS * repeated:,} simulations.",
            command=f"brink repeats {subject.campaign.id}",
            request=StepRequest(path=f"{subject.path}/repeats", body={}),
            follow_up=None if open_one is None else follow_up_view(open_one.kind, open_one.campaign),
            tells_more=True,
        )
    ]


def _cannot_repeat(subject: Subject) -> bool:
    try:
        check_repeatable(subject.plan)
    except InvalidInput:
        return True
    return False


KIND = BoundaryKind()
