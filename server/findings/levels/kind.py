"""A small rate by subset simulation, as a kind of finding."""

import math
from typing import Annotated, Any

from pydantic import Field

from brink.search.algorithm import EstimatesByLevels, LevelEstimate
from brink.search.algorithms.subset import Ended
from brink.search.distribution import distribution_words
from brink.search.document import Document
from brink.server.campaigns import step_store
from brink.server.findings.finding import Finding
from brink.server.findings.kind import Kind, Listed, Settings, Subject
from brink.server.findings.levels.views import LevelsView, LevelView
from brink.server.findings.rate.analysis import interval_words
from brink.server.findings.rate.views import IntervalView
from brink.server.findings.table import Column, Format, Table
from brink.server.findings.words import percent
from brink.server.states import OutcomeKind

COLUMNS = [
    Column(name="threshold", title="robustness at most", format=Format.NUMBER),
    Column(name="share", title="share", format=Format.SHARE),
    Column(name="variation", title="coefficient of variation", format=Format.NUMBER, optional=True),
    Column(name="samples", title="samples", format=Format.COUNT),
    Column(name="simulations", title="simulated", format=Format.COUNT),
    Column(name="accepted", title="moves accepted", format=Format.SHARE),
]
WHY = {
    Ended.NOT_YET: "the search has not reached unsafe simulations yet",
    Ended.NOT_GRADED: "the robustness has too few values to divide simulations: estimate the rate from draws instead",
    Ended.BUDGET: "the budget does not suffice for a further level",
}


class LevelsSettings(Settings):
    """How the rate is shown."""

    confidence: Annotated[float, Field(gt=0, lt=1, description="Confidence of the approximate interval.")] = (
        0.95
    )


class LevelsKind(Kind):
    """A small rate by subset simulation."""

    id = "levels"
    title = "Rate by subset simulation"
    rank = 21
    settings = LevelsSettings

    def fits(self, plan: Any) -> bool:
        """Return whether the algorithm estimates a rate by levels."""
        return isinstance(plan.algorithm, EstimatesByLevels)

    async def find(self, subject: Subject) -> Finding:
        """Return the rate with its coefficient of variation, and what each level gave."""
        outcomes = await subject.sources.outcomes.get(subject.campaign.id, subject.read)
        violate = outcomes.kind_words(OutcomeKind.VIOLATED) if outcomes.requirements else "are unsafe"
        confidence = subject.settings.confidence
        estimate = await subject.sources.analyses.run(lambda: _estimate(subject, confidence))
        if estimate is None:
            return Finding(
                kind=self.id,
                title=self.title,
                role=subject.role,
                sentence="no level is complete yet",
                is_empty=True,
            )
        return self._finding(subject, _view(subject, estimate, confidence), violate)

    def _finding(self, subject: Subject, view: LevelsView, violate: str) -> Finding:
        noun = subject.noun
        drawn = "the stated distribution" if view.is_stated else "all values equally likely"
        if view.rate is None:
            reached = math.prod(one.share for one in view.levels)
            sentence = f"no rate: {WHY[Ended(view.ended)]}"
            more = [
                f"the {len(view.levels)} levels so far are {percent(reached)} of operation, none of it counted"
            ]
            if reached == 0:
                more = []
        else:
            sentence = f"about {interval_words(view.rate)} of simulated {noun}s {violate}, with {drawn}"
            more = [
                f"coefficient of variation {view.variation:.2f}, {view.most_variation:.2f} if levels depend on each "
                f"other as much as possible; bias of up to {percent(view.bias or 0.0)} of the rate"
            ]
        return Finding(
            kind=self.id,
            title=self.title,
            role=subject.role,
            sentence=sentence,
            more=more,
            purpose=f"Brink estimated how often {noun}s from the operational domain {violate}.",
            caveats=_caveats(view, noun),
            legend=[
                "Robustness at most: what samples of the next level do not exceed. Share: how many of this level "
                "belong to it; the rate is the product of all shares"
            ],
            view=view,
            tables=[
                Table(
                    name="levels",
                    title="Levels",
                    columns=COLUMNS,
                    rows=[
                        [one.threshold, one.share, one.variation, one.samples, one.simulations, one.accepted]
                        for one in view.levels[: subject.rows]
                    ],
                    left_out=max(0, len(view.levels) - subject.rows),
                )
            ],
        )

    def brief(self, listed: Listed) -> str:
        """Return the number of unsafe simulations, which are no draws from operation."""
        return f"{listed.campaign.unsafe:,} unsafe"


def _estimate(subject: Subject, confidence: float) -> LevelEstimate | None:
    algorithm = subject.plan.algorithm
    assert isinstance(algorithm, EstimatesByLevels)
    with subject.sources.engines.reader.connect() as connection:
        checkpoint = step_store.find_checkpoint(connection, subject.campaign.id)
    if checkpoint is None:
        return None
    estimate = algorithm.level_estimate(Document.from_bytes(checkpoint.document), confidence)
    return estimate if estimate.levels else None


def _view(subject: Subject, estimate: LevelEstimate, confidence: float) -> LevelsView:
    space = subject.plan.problem.space
    rate = None
    if estimate.rate is not None and estimate.low is not None and estimate.high is not None:
        rate = IntervalView(value=estimate.rate, low=estimate.low, high=estimate.high)
    return LevelsView(
        ended=estimate.ended,
        rate=rate,
        variation=estimate.variation,
        most_variation=estimate.most_variation,
        bias=estimate.bias,
        confidence=confidence,
        simulations=subject.campaign.completed,
        failed=subject.campaign.failed,
        distribution=distribution_words(space),
        is_stated=space.distribution is not None,
        levels=[
            LevelView(
                threshold=one.threshold,
                share=one.share,
                variation=one.variation,
                samples=one.samples,
                simulations=one.simulations,
                accepted=one.accepted / one.simulations,
            )
            for one in estimate.levels
        ],
    )


def _caveats(view: LevelsView, noun: str) -> list[str]:
    said = [
        f"This is a rate in a simulator, for {noun}s distributed as stated: {view.distribution}. It says nothing "
        "about what the simulator, the distribution or the requirement leave out"
    ]
    if view.rate is not None:
        said.append(
            "The interval is approximate: it assumes that chains have visited all ways in which a violation comes "
            "about. Unlike an interval from draws, it shows no claim"
        )
    if view.failed:
        said.append(f"{view.failed:,} simulations without a verdict count as safe")
    return said


KIND = LevelsKind()
