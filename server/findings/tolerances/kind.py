"""How severe each error of a component may be before too many drives violate a requirement."""

import json
from typing import Final
from urllib.parse import urlencode

from brink.search.algorithms.tolerance import Layout, Tolerance, ToleranceConfig
from brink.server.campaigns.plan import Plan
from brink.server.campaigns.store import Campaign
from brink.server.findings.finding import Finding, Step
from brink.server.findings.kind import Kind, Listed, Subject
from brink.server.findings.table import Column, Format, Table
from brink.server.findings.tolerances.analysis import find_tolerance
from brink.server.findings.tolerances.views import CellView, ToleranceView
from brink.server.findings.words import counted
from brink.server.problems.catalogue import ODD, make_problem, problem_type

SIMULATIONS: Final = 2_000
"""Enough for twelve cells under one condition."""


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
            more=[view.caveat],
            is_empty=not any(cell.basis for cell in view.cells),
            tables=[cells_table(view, subject.rows)],
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
        layout = Layout(listed.plan.problem.space, listed.plan.config)
        return counted(len(layout.cells), "tolerance")

    def leads_to(self, subject: Subject) -> list[Step]:
        """Return the step that asks how severe the errors of the problem's detector may be."""
        errors_problem = subject.plan.problem.errors_problem
        return [_search(subject.campaign, errors_problem)] if errors_problem else []


def cells_table(view: ToleranceView, rows: int | None = None) -> Table:
    """Return the tolerances as a table with one row for each cell."""
    names = list(view.cells[0].choices) if view.cells else []
    ends = ("value", "low", "high")
    columns = [
        *(Column(name=name.rpartition(".")[2], title=name.rpartition(".")[2], detail=True) for name in names),
        Column(name="error", title="error"),
        Column(name="condition", title="condition"),
        Column(name="finding", title="finding"),
        Column(name="unit", title="unit", detail=True),
        Column(name="value", title="tolerated", format=Format.NUMBER),
        Column(name="low", title="low", format=Format.NUMBER),
        Column(name="high", title="high", format=Format.NUMBER),
        *(
            Column(name=f"severity_{end}", title=f"severity, {end}", format=Format.NUMBER, detail=True)
            for end in ends
        ),
        *(
            Column(name=name, title=name, format=Format.COUNT)
            for name in ("screened", "vulnerable", "drives", "caused")
        ),
        Column(name="sentence", title="sentence", detail=True),
    ]
    shown = view.cells[:rows]
    return Table(
        name="tolerances",
        title="Tolerated magnitude of each error",
        columns=columns,
        rows=[[*(cell.choices[name] for name in names), *_cells(cell)] for cell in shown],
        left_out=len(view.cells) - len(shown),
    )


def _cells(cell: CellView) -> list[str | int | float | None]:
    tolerated = cell.tolerated
    amounts = (tolerated.value, tolerated.low, tolerated.high)
    return [
        cell.error,
        cell.condition,
        tolerated.finding.value,
        cell.unit,
        *(one.magnitude for one in amounts),
        *(one.severity for one in amounts),
        cell.screened,
        cell.vulnerable,
        cell.drives,
        cell.caused,
        cell.sentence,
    ]


def _search(campaign: Campaign, errors_problem: str) -> Step:
    requirement = campaign.body.problem.params.get("requirement")
    names = make_problem(errors_problem, {}).space.column_names()
    limits = {name: one for name, one in campaign.body.problem.params.get(ODD, {}).items() if name in names}
    odd = {ODD: limits} if limits else {}
    body = {
        "name": f"{campaign.body.name[:180]}: tolerances",
        "problem": {"id": errors_problem, "params": {"errors": 1, "requirement": requirement} | odd},
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
        words="Searches for a requirement for the detector: how gross each type of its errors may be before drives "
        "violate. What counts as a violation stays the same.",
        place=f"new?{urlencode({'body': json.dumps(body)})}",
    )


KIND = TolerancesKind()
