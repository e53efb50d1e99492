"""Routes of monitors: how likely solutions are unsafe, from what a campaign has simulated."""

import asyncio
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter
from pydantic import Field

from brink.search.analysis.monitor import Answer
from brink.search.errors import SpaceError
from brink.server.api.context import Services
from brink.server.api.schemas import View
from brink.server.documents import Body
from brink.server.errors import FieldError, InvalidInput

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["monitors"])

MAX_SOLUTIONS = 1_000


class Questions(Body):
    """Solutions to be scored."""

    solutions: Annotated[
        list[dict[str, dict[str, Any]]],
        Field(
            min_length=1, max_length=MAX_SOLUTIONS,
            description="Each with its parameters by component and name, as solutions are answered.",
        ),
    ]  # fmt: skip
    threshold: Annotated[
        float | None,
        Field(
            gt=0,
            lt=1,
            description="Probability above which unsafe is the answer; p_th if left out.",
        ),
    ] = None


class RiskView(View):
    """How likely a solution is unsafe."""

    probability: float
    low: Annotated[float, Field(description="Lower limit of the interval.")]
    high: float
    neighbours: Annotated[float, Field(description="Weight of what was simulated around it, in evaluations.")]
    answer: Annotated[
        Answer, Field(description="By the whole interval: unknown where it holds the threshold.")
    ]


class Scored(View):
    """What a campaign's monitor says."""

    campaign: str
    learned_from: Annotated[int, Field(description="Solutions that the monitor learned from.")]
    threshold: float
    risks: Annotated[list[RiskView], Field(description="In the order of the solutions.")]


@router.post("/monitor/score")
async def score_solutions(campaign_id: str, questions: Questions, services: Services) -> Scored:
    """Return how likely solutions are unsafe, with an interval that is wide where little was simulated."""
    campaign = await services.campaigns.get(campaign_id)
    monitor = await services.monitors.get(campaign)
    rows = []
    for place, values in enumerate(questions.solutions):
        try:
            rows.append(monitor.space.join(monitor.space.encode(values)))
        except SpaceError as error:
            raise InvalidInput([FieldError(pointer=f"/solutions/{place}", message=str(error))]) from None
    risks = await asyncio.get_running_loop().run_in_executor(None, monitor.score, np.array(rows))
    threshold = questions.threshold if questions.threshold is not None else monitor.threshold
    columns = (risks.probability, risks.low, risks.high, risks.neighbours)
    return Scored(
        campaign=campaign.id,
        learned_from=len(monitor),
        threshold=threshold,
        risks=[
            RiskView(probability=p, low=low, high=high, neighbours=n, answer=answer)
            for p, low, high, n, answer in zip(
                *(column.tolist() for column in columns), risks.answers(threshold), strict=True
            )
        ],
    )
