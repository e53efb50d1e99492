"""A toy kind of findings, ``extremes``, and an algorithm that finds it, ``extremes@1``: all in this folder.

Name ``support.extremes.plugin`` in ``BRINK_PLUGINS``, with ``tests`` on ``PYTHONPATH``.
"""

import numpy as np

from brink.search.algorithms.random_search import RandomSearch
from brink.server.findings.finding import Finding, Step
from brink.server.findings.kind import Kind, Listed, Settings, Subject
from brink.server.findings.table import Column, Format, Table
from brink.server.views import View


class ExtremesAlgorithm(RandomSearch):
    """Random search whose result is the most extreme solutions."""

    id = "extremes@1"
    summary = "Draws solutions and tells the most extreme ones."
    finds: tuple[str, ...] = ("extremes",)
    is_baseline = False


class ExtremesView(View):
    """What only extremes have."""

    worst: int


class ExtremesSettings(Settings):
    """Which of them to find."""

    largest: bool = False


class ExtremesKind(Kind):
    """The solutions with the smallest robustness, or the largest."""

    id = "extremes"
    title = "Extremes"
    settings = ExtremesSettings

    def analyse(self, subject: Subject) -> Finding:
        """Return the solutions by robustness."""
        archive = subject.read.archive
        order = np.argsort(archive.robustness, kind="stable")[:: -1 if subject.settings.largest else 1]
        rows = [
            [int(archive.numbers[place]), float(archive.robustness[place]), bool(archive.unsafe[place])]
            for place in order[: subject.rows]
        ]
        worst = int(archive.numbers[order[0]])
        return Finding(
            kind=self.id,
            title=self.title,
            role=subject.role,
            sentence=f"solution {worst} is the most extreme of {len(archive):,}",
            view=ExtremesView(worst=worst),
            tables=[
                Table(
                    name="extremes",
                    title="Solutions by robustness",
                    columns=[
                        Column(name="number", title="solution", format=Format.SOLUTION),
                        Column(name="robustness", title="robustness", unit="m", format=Format.NUMBER),
                        Column(name="unsafe", title="unsafe", format=Format.FLAG),
                    ],
                    rows=rows,
                    left_out=len(archive) - len(rows),
                )
            ],
            steps=[
                Step(
                    kind="look",
                    question="What happens there?",
                    words="Draws the most extreme solution.",
                    command=f"brink replay {subject.campaign.id} {worst} --out worst.png",
                )
            ],
        )

    def brief(self, listed: Listed) -> str:
        """Return how many solutions were drawn."""
        return f"extreme of {listed.campaign.evaluated:,}"
