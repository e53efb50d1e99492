"""How severe each error of a component may be before too many drives violate a requirement."""

import json
from collections import Counter
from typing import Final
from urllib.parse import urlencode

from brink.search.algorithms.tolerance import Layout, Tolerance, ToleranceConfig
from brink.server.campaigns.plan import Plan
from brink.server.campaigns.store import Campaign
from brink.server.findings.finding import Finding, Step, Term
from brink.server.findings.kind import Kind, Listed, Subject
from brink.server.findings.table import Column, Format, Table
from brink.server.findings.tolerances.analysis import find_tolerance
from brink.server.findings.tolerances.views import CellView, ToleranceView, Tolerated
from brink.server.findings.words import counted
from brink.server.problems.catalogue import ODD, make_problem, problem_type
from brink.server.problems.driving_systems import driving_params

SIMULATIONS: Final = 2_000
"""Enough for twelve cells under one condition."""
KEY: Final = (
    "screened: drives simulated with the most severe error concerning the same road users; vulnerable: those that it "
    "makes violate; drives: those simulated with this error, of the vulnerable ones if there was screening; caused: "
    "those that violate because of it; mildest example: the one with the smallest error"
)
"""What the numbers of drives in a table of cells mean."""
SENTENCES: Final = [Column(name="requirement", title="requirement")]
FALLS: Final = [
    Column(name="error", title="error"),
    Column(name="condition", title="condition"),
    Column(name="words", title="where a larger error is safer"),
]
BASELINE: Final = [
    Column(name="condition", title="condition"),
    Column(name="cells", title="cells"),
    Column(name="drives", title="drives", format=Format.COUNT),
    Column(name="violate", title="violate", format=Format.SHARE, optional=True),
    Column(name="interval", title="95% interval"),
]


class TolerancesKind(Kind):
    """How gross each error of a component may be before too many drives violate a requirement."""

    id = "tolerances"
    title = "Tolerances"
    rank = 20
    is_exclusive = True

    def fits(self, plan: Plan) -> bool:
        """Return whether the search has cells."""
        return isinstance(plan.config, ToleranceConfig)

    async def find(self, subject: Subject) -> Finding:
        """Return the tolerance of each cell."""
        sources, campaign = subject.sources, subject.campaign
        view = await find_tolerance(sources, campaign, subject.read)
        return Finding(
            kind=self.id,
            title=self.title,
            role=subject.role,
            sentence=view.note,
            purpose="Brink measured how severe the errors of the component may be before more than "
            f"{view.limit:.0%} of drives violate a requirement because of them.",
            example="".join(f"Tightest: {cell.sentence}" for cell in _tightest(view)[:1]),
            figures=_figures(view),
            caveats=_caveats(view),
            trust=_trust(view),
            legend=_legend(view),
            is_empty=not any(cell.basis for cell in view.cells),
            tables=[cells_table(view, subject.rows), *_further_tables(view, subject.rows)],
            steps=[
                Step(
                    kind="export",
                    question="What may the detector get wrong?",
                    words="Writes the tolerances as sentences: a requirement for the detector.",
                    command=f"brink tolerance {campaign.id} --format sentences",
                ),
                Step(
                    kind="tolerance",
                    question="Does your detector meet it?",
                    words="Compares the errors of a detector, from the drives of another campaign, with the "
                    "tolerances.",
                    command=f"brink tolerance {campaign.id} --episodes OTHER",
                ),
            ],
        )

    def brief(self, listed: Listed) -> str:
        """Return how many cells there are."""
        config = listed.plan.config
        assert isinstance(config, ToleranceConfig)  # see `fits`
        layout = Layout(listed.plan.problem.space, config)
        return counted(len(layout.cells), "tolerance")

    def leads_to(self, subject: Subject) -> list[Step]:
        """Return the step that asks how severe the errors of the problem's detector may be."""
        errors_problem = subject.plan.problem.errors_problem
        return [_search(subject.campaign, errors_problem)] if errors_problem else []


def _tightest(view: ToleranceView) -> list[CellView]:
    """Return the cells with a limit, the tightest first."""
    limited = [cell for cell in view.cells if cell.tolerated.finding is Tolerated.LIMIT]
    return sorted(limited, key=lambda cell: cell.tolerated.value.severity or 0.0)


def _figures(view: ToleranceView) -> list[Term]:
    known = Counter(cell.tolerated.finding for cell in view.cells)
    return [
        Term(
            term=f"{known[Tolerated.LIMIT]:,} of {len(view.cells):,}",
            words="cells with a limit within the scale",
        ),
        Term(term=f"{known[Tolerated.THROUGHOUT]:,}", words="cells in which no limit was found"),
        Term(term=f"{known[Tolerated.UNDECIDED]:,}", words="cells undecided"),
    ]


def _caveats(view: ToleranceView) -> list[str]:
    told = [f"Each limit has an interval that covers the truth with a probability of {view.confidence:.0%}"]
    if view.open:
        told.append(
            f"Of {counted(view.open, 'violation')} it is not known yet whether the error caused them; they count as "
            "caused"
        )
    return [*told, view.caveat]


def _trust(view: ToleranceView) -> list[Term]:
    if not view.audited:
        return []
    words = (
        "Drives that hold with the most severe error are assumed to hold with milder ones. Of "
        f"{view.audited:,} that were simulated with milder ones nevertheless, {view.leaks:,} violated a requirement."
    )
    return [Term(term="Screening", words=words)]


def _legend(view: ToleranceView) -> list[str]:
    return [
        "A cell is a type of error that concerns one target, under one condition. A violation counts if it goes away "
        f"without the error, in the same drive with the same seed. The limit is {view.limit:.0%} of drives",
        KEY,
    ]


def _further_tables(view: ToleranceView, rows: int) -> list[Table]:
    """Return the requirements in sentences, where a larger error is safer, and the drives without any error."""
    sentences = [cell.sentence for cell in _tightest(view)]
    sentences += [cell.sentence for cell in view.cells if cell.tolerated.finding is Tolerated.THROUGHOUT]
    falls = [[cell.error, cell.condition, cell.fall.words] for cell in view.cells if cell.fall is not None]
    baseline = [
        [
            one.condition,
            " or ".join(" ".join(choices.values()) for choices in one.choices if choices).replace("_", " ")
            or "all",
            one.share.evaluated,
            one.share.probability,
            f"{one.share.low:.0%} to {one.share.high:.0%}",
        ]
        for one in view.baseline
    ]
    return [
        Table(
            name=name,
            title=title,
            columns=columns,
            rows=all_rows[:rows],
            left_out=max(0, len(all_rows) - rows),
        )
        for name, title, columns, all_rows in (
            ("requirements", "The requirements, tightest first", SENTENCES, [[words] for words in sentences]),
            ("falls", "Where a larger error is safer", FALLS, falls),
            ("baseline", "Drives without any error", BASELINE, baseline),
        )
    ]


def cells_table(view: ToleranceView, rows: int | None = None) -> Table:
    """Return the tolerances as a table with one row for each cell."""
    names = list(view.cells[0].choices) if view.cells else []
    ends = ("value", "low", "high")
    columns = [
        *(Column(name=name.rpartition(".")[2], title=name.rpartition(".")[2], detail=True) for name in names),
        Column(name="error", title="error"),
        Column(name="condition", title="condition"),
        Column(name="tolerated", title=f"tolerated, {view.confidence:.0%} interval"),
        Column(name="finding", title="finding", detail=True),
        Column(name="unit", title="unit", detail=True),
        *(Column(name=end, title=end, format=Format.NUMBER, detail=True) for end in ends),
        *(
            Column(name=f"severity_{end}", title=f"severity, {end}", format=Format.NUMBER, detail=True)
            for end in ends
        ),
        *(
            Column(name=name, title=name, format=Format.COUNT)
            for name in ("screened", "vulnerable", "drives", "caused")
        ),
        Column(name="example", title="mildest example", format=Format.SOLUTION, optional=True),
        *(
            Column(name=name, title=name, format=Format.NUMBER, detail=True)
            for name in ("limit", "confidence")
        ),
        Column(name="sentence", title="sentence", detail=True),
    ]
    shown = view.cells[:rows]
    return Table(
        name="tolerances",
        title="Tolerated magnitude of each error",
        columns=columns,
        rows=[
            [
                *(cell.choices[name] for name in names),
                *_cells(cell),
                view.limit,
                view.confidence,
                cell.sentence,
            ]
            for cell in shown
        ],
        left_out=len(view.cells) - len(shown),
    )


def _cells(cell: CellView) -> list[str | int | float | None]:
    tolerated = cell.tolerated
    amounts = (tolerated.value, tolerated.low, tolerated.high)
    return [
        cell.error,
        cell.condition,
        cell.tolerated_words,
        tolerated.finding.value,
        cell.unit,
        *(one.magnitude for one in amounts),
        *(one.severity for one in amounts),
        cell.screened,
        cell.vulnerable,
        cell.drives,
        cell.caused,
        cell.examples[0].number if cell.examples else None,
    ]


def _search(campaign: Campaign, errors_problem: str) -> Step:
    requirement = campaign.body.problem.params.get("requirement")
    names = make_problem(errors_problem, {}).space.column_names()
    limits = {name: one for name, one in campaign.body.problem.params.get(ODD, {}).items() if name in names}
    odd = {ODD: limits} if limits else {}
    driving = driving_params(campaign.body.problem.params)
    body = {
        "name": f"{campaign.body.name[:180]}: tolerances",
        "problem": {
            "id": errors_problem,
            "params": {"errors": 1, "requirement": requirement} | odd | driving,
        },
        "algorithm": {
            "id": Tolerance.id,
            "params": {"cells": dict(problem_type(errors_problem).usual_cells)},
        },
        "budget": {"simulations": SIMULATIONS},
    }
    return Step(
        kind="tolerance",
        question="How wrong may the detector be?",
        label="Search for tolerances",
        words="Searches for a requirement for the detector: how severe each type of its errors may be before drives "
        "violate. What counts as a violation stays the same.",
        place=f"new?{urlencode({'body': json.dumps(body)})}",
    )


KIND = TolerancesKind()
