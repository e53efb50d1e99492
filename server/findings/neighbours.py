"""The neighbourhood of a solution, and the solutions closest to it."""

import json
import math
from typing import Annotated

from pydantic import Field
from sqlalchemy import Connection

from brink.search.analysis.similarity import Nearest, nearest_opposite, nearest_solutions
from brink.search.pairs import Steps
from brink.server.campaigns import view_store
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.outcomes import CampaignOutcomes, outcome_of
from brink.server.campaigns.store import Campaign
from brink.server.errors import NotFound
from brink.server.findings.solutions import simulated
from brink.server.findings.sources import Sources
from brink.server.problems.changes import change_words, changes_between
from brink.server.states import OutcomeKind, SolutionVerdict
from brink.server.views import View


class Neighbour(View):
    """An evaluated solution close to another one."""

    number: int
    distance: float
    within: Annotated[
        bool, Field(description="Whether it counts as a neighbour, that is, lies within the radius.")
    ]
    unsafe: bool
    outcome: Annotated[
        str, Field(description="What its simulation showed about all requirements, without moments.")
    ]
    kind: OutcomeKind
    robustness: float
    fitness: float


class Opposite(View):
    """The nearest solution with the other verdict, and what differs."""

    number: int
    distance: float
    unsafe: bool
    outcome: Annotated[str, Field(description="What its simulation showed, in words, with moments.")]
    kind: OutcomeKind
    change: Annotated[str, Field(description="What differs in the unsafe one of the two, in words.")]
    differences: Annotated[int, Field(description="Number of parameters that differ.")]
    same_seed: Annotated[
        bool, Field(description="Whether both had the same episode seed, which rules out chance.")
    ]


class Neighbours(View):
    """The neighbourhood of a solution and the solutions closest to it."""

    number: int
    radius: Annotated[float, Field(description="Largest distance of a neighbour.")]
    p_th: Annotated[float, Field(description="Unsafe share that defines the boundary.")]
    confidence: Annotated[float, Field(description="Confidence level of the interval, such as 0.95.")]
    rated: Annotated[
        bool,
        Field(description="Whether the algorithm searches for this boundary; if not, fitness means little."),
    ]
    neighbours: Annotated[int, Field(description="Solutions within the radius, including this one.")]
    unsafe_neighbours: int
    interval: Annotated[
        tuple[float, float], Field(description="Wilson interval of the unsafe share within the radius.")
    ]
    fitness: Annotated[float, Field(description="Distance of that interval from p_th; 0 on the boundary.")]
    evaluated: Annotated[int, Field(description="Evaluated solutions of the campaign.")]
    nearest: Annotated[list[Neighbour], Field(description="Closest first, without this one.")]
    opposite: Annotated[
        Opposite | None, Field(description="Nearest solution with the other verdict; null if there is none.")
    ] = None


async def find_neighbours(sources: Sources, campaign: Campaign, number: int, most: int) -> Neighbours:
    """Return the neighbourhood of an evaluated solution and the solutions closest to it.

    Args:
        sources: Where findings are read from.
        campaign: The campaign.
        number: The solution.
        most: Most solutions to return.

    Raises:
        NotFound: There is no such solution.
    """
    read = await sources.archives.get(campaign)
    boundary = "boundary" in read.plan.finds
    outcomes = await sources.outcomes.get(campaign.id, read)

    def look() -> Neighbours:
        place = read.places.get(number)
        if place is None:
            raise NotFound(f"campaign {campaign.id} has no evaluated solution {number}")
        near = nearest_solutions(read.archive, place, most)
        view = _neighbours_view(read, outcomes, number, place, near, boundary=boundary)
        with sources.engines.reader.connect() as connection:
            return view.model_copy(update={"opposite": _opposite(connection, campaign.id, read, place)})

    return await sources.pages.run(look)


def _opposite(connection: Connection, campaign_id: str, found: ReadArchive, place: int) -> Opposite | None:
    nearest = nearest_opposite(found.archive, place)
    if nearest is None:
        return None
    archive, problem, (other, distance) = found.archive, found.plan.problem, nearest
    places = (other, place) if archive.unsafe[place] else (place, other)
    rows = {
        row.number: row
        for row in view_store.read_solutions(
            connection, campaign_id, [int(archive.numbers[one]) for one in places]
        )
    }
    if len(rows) < len(places):
        return None  # it was deleted meanwhile
    safe, unsafe = (rows[int(archive.numbers[one])] for one in places)
    units = Steps(problem.space).differing(archive.vectors[places[0]], archive.vectors[places[1]])
    sides = simulated(problem, safe), simulated(problem, unsafe)
    changes = changes_between(problem, *sides, units)
    shown = rows[int(archive.numbers[other])]
    outcome = outcome_of(
        problem,
        json.loads(shown.result) if shown.result else None,
        safe=shown.verdict == SolutionVerdict.SAFE,
        robustness=shown.robustness,
    )
    return Opposite(
        number=shown.number,
        distance=distance,
        unsafe=bool(archive.unsafe[other]),
        outcome=outcome.words(),
        kind=outcome.kind,
        change=change_words(problem, *sides, changes),
        differences=sum(len(change.names) for change in changes),
        same_seed=safe.seed == unsafe.seed,
    )


def _neighbours_view(
    found: ReadArchive, outcomes: CampaignOutcomes, number: int, place: int, near: Nearest, *, boundary: bool
) -> Neighbours:
    archive, settings = found.archive, found.plan.neighbourhood
    low, high = archive.interval[place].tolist()
    return Neighbours(
        number=number,
        radius=settings.radius,
        p_th=settings.p_th,
        confidence=math.erf(settings.z / math.sqrt(2)),
        rated=boundary,
        neighbours=int(archive.neighbours[place]),
        unsafe_neighbours=int(archive.unsafe_neighbours[place]),
        interval=(low, high),
        fitness=float(archive.fitness[place]),
        evaluated=len(archive),
        nearest=[
            Neighbour(
                number=int(archive.numbers[other]),
                distance=distance,
                within=distance <= settings.radius,
                unsafe=bool(archive.unsafe[other]),
                outcome=outcomes.groups[outcomes.which[other]].words,
                kind=outcomes.groups[outcomes.which[other]].kind,
                robustness=float(archive.robustness[other]),
                fitness=float(archive.fitness[other]),
            )
            for other, distance in zip(near.positions.tolist(), near.distances.tolist(), strict=True)
        ],
    )
