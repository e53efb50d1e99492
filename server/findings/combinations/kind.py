"""Hazardous chains of techniques as a kind of finding."""

from collections.abc import Sequence
from typing import Final

from brink.search.analysis.combinations import HAZARDOUS, MIN_PLACES, combinations, verdicts_by_chain
from brink.search.errors import UnsupportedSpace
from brink.search.slots import slots_of
from brink.server.findings.combinations.analysis import find_combinations
from brink.server.findings.combinations.views import ChainTally, Combinations, StepTally
from brink.server.findings.finding import Finding, Step, Term
from brink.server.findings.kind import Kind, Listed, Subject
from brink.server.findings.table import Column, Format, Table
from brink.server.findings.words import counted
from brink.server.problems.base import Problem, ReportsViolations

MOST_SOLUTIONS: Final = 20_000
"""Largest archive whose chains are counted for a list; a campaign's page has those of others."""
COLUMNS: Final = [
    Column(name="chain", title="chain"),
    Column(name="unsafe", title="unsafe", format=Format.COUNT),
    Column(name="trials", title="of", format=Format.COUNT),
    Column(name="hazardous", title="hazardous", format=Format.FLAG),
    Column(name="only_together", title="only together", format=Format.FLAG),
    Column(name="order_matters", title="order matters", format=Format.FLAG),
    Column(name="added_harm", title="added harm", format=Format.NUMBER),
    Column(name="alpha", title="alpha", format=Format.NUMBER, detail=True),
    Column(name="interacts", title="interacts", format=Format.FLAG, detail=True, optional=True),
    Column(name="minimal", title="minimal", format=Format.FLAG, detail=True),
    Column(name="parts", title="its parts"),
    Column(name="orders", title="other order"),
    Column(name="example", title="example", format=Format.SOLUTION, optional=True),
]
_OTHER: Final = ("chain", "parts", "orders", "example")
LEGEND: Final = [
    "A chain is a list of changes that are applied to the camera image in order. It is hazardous if it was driven in "
    f"at least {MIN_PLACES} streets, and at least {HAZARDOUS:.0%} of these drives were unsafe. Its parts and other "
    "orders are compared in the same streets.",
    "Only together: each part of the chain alone is safe, which is to say unsafe in at most 20% of these drives. "
    "Order matters: the same chain is safe in another order.",
]
TECHNIQUES: Final = [
    Column(name="technique", title="technique at a level"),
    Column(name="alone_unsafe", title="unsafe alone", format=Format.COUNT),
    Column(name="alone_trials", title="of", format=Format.COUNT),
    Column(name="joined_unsafe", title="unsafe with others", format=Format.COUNT),
    Column(name="joined_trials", title="of", format=Format.COUNT),
]


class CombinationsKind(Kind):
    """Chains of techniques that are hazardous alone, only together, or in one order but not in another."""

    id = "combinations"
    title = "Chains of techniques"
    rank = 40

    def is_reported_by(self, problem: Problem) -> bool:
        """Return whether candidates are chains of techniques."""
        if isinstance(problem, ReportsViolations):
            return False
        try:
            slots_of(problem.space)
        except UnsupportedSpace:
            return False
        return True

    def fits(self, plan: object) -> bool:
        """Return False: only problems that report chains have them."""
        return False

    async def find(self, subject: Subject) -> Finding:
        """Return the chains that were simulated, the most informative first."""
        view = await find_combinations(subject.sources, subject.campaign, subject.read)
        return Finding(
            kind=self.id,
            title=self.title,
            role=subject.role,
            sentence=view.words,
            more=[view.explanation] if view.explanation else [],
            purpose="Brink searched for changes to the camera image, alone or together, that make the driving "
            "unsafe.",
            figures=_figures(view),
            legend=LEGEND,
            is_empty=not view.combinations,
            tables=[chains_table(view, subject.rows), techniques_table(view, subject.rows)],
            steps=_watch(subject, view),
        )

    def brief(self, listed: Listed) -> str:
        """Return how many chains are hazardous."""
        if listed.campaign.evaluated > MOST_SOLUTIONS:
            return ""
        _, _, archive = listed.archives.stored(listed.campaign)
        chains = combinations(verdicts_by_chain(listed.plan.problem.space, archive))
        hazardous, together = sum(one.hazardous for one in chains), sum(one.only_together for one in chains)
        return counted(hazardous, "hazardous chain") + (f", {together} only together" if together else "")


def _figures(view: Combinations) -> list[Term]:
    """Return how many of the chains that were simulated often enough are hazardous."""
    judged = [one.hazardous for one in view.combinations if one.trials >= MIN_PLACES]
    return [Term(term=f"{sum(judged):,} of {len(judged):,}", words="chains of changes are hazardous")]


def chains_table(view: Combinations, rows: int | None = None) -> Table:
    """Return chains as a table."""
    shown = view.combinations[:rows]
    names = [column.name for column in COLUMNS if column.name not in _OTHER]
    return Table(
        name="combinations",
        title="Chains of techniques, the most informative first",
        columns=COLUMNS,
        rows=[
            [
                one.words,
                *(getattr(one, name) for name in names),
                _tallies(one.parts) or "not simulated",
                _tallies(one.orders),
                next(iter((*one.together, *one.turned)), None),
            ]
            for one in shown
        ],
        left_out=len(view.combinations) - len(shown),
    )


def techniques_table(view: Combinations, rows: int | None = None) -> Table:
    """Return each technique at a level, alone and with others, as a table."""
    names = [column.name for column in TECHNIQUES[1:]]
    steps = [step for step in view.steps if step.alone_unsafe or step.joined_unsafe]
    shown = sorted(steps, key=_unsafe_shares, reverse=True)[:rows]
    return Table(
        name="techniques",
        title="Each technique alone and with others",
        columns=TECHNIQUES,
        rows=[[step.words, *(getattr(step, name) for name in names)] for step in shown],
        left_out=len(steps) - len(shown),
    )


def _unsafe_shares(step: StepTally) -> tuple[float, float]:
    return step.alone_unsafe / max(1, step.alone_trials), step.joined_unsafe / max(1, step.joined_trials)


def _tallies(tallies: Sequence[ChainTally]) -> str:
    return "; ".join(f"{one.words}: {one.unsafe} of {one.trials}" for one in tallies)


def example_of(view: Combinations) -> int | None:
    """Return an unsafe solution of the most informative chain whose hazard is due to the combination or its order."""
    numbers = (number for one in view.combinations for number in (*one.together, *one.turned))
    return next(numbers, None)


def _watch(subject: Subject, view: Combinations) -> list[Step]:
    number, campaign = example_of(view), subject.campaign.id
    if number is None:
        return []
    return [
        Step(
            kind="look",
            question="What do the perturbations do?",
            label=f"Open solution {number}",
            words="Shows an unsafe drive that is safe with each part of its chain alone, or in another order.",
            place=f"{subject.path}/solutions/{number}",
            command=f"brink replay {campaign} {number} --out hazard.mp4",
        )
    ]


KIND = CombinationsKind()
