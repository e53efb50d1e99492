"""Solutions with decoded parameters and the outcomes of their simulations."""

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from sqlalchemy import Connection, Row

from brink.search.analysis.avoidable import avoidable_of, avoided_by_of
from brink.search.archive import NeighbourCounts
from brink.search.deadline import check_time
from brink.search.parameters import Categorical
from brink.search.space import SearchSpace
from brink.server.campaigns import view_store
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.known import KnownRecord
from brink.server.campaigns.outcomes import outcome_of
from brink.server.campaigns.store import Campaign
from brink.server.errors import NotFound
from brink.server.problems.base import Activity, Problem, SimulatedSolution, activity_of, describe_candidate
from brink.server.states import SolutionVerdict
from brink.server.views import ActivityView, SolutionView, View, ViolatedView
from brink.sim.verdict import Violated


def solutions_of(
    connection: Connection,
    campaign: Campaign,
    read: ReadArchive,
    numbers: Sequence[int],
    *,
    full: bool = False,
    rated: bool = False,
) -> list[SolutionView]:
    """Return the response schemas of solutions of a campaign by their numbers.

    Args:
        connection: Read connection.
        campaign: The campaign.
        read: Its archive.
        numbers: Evaluated solutions, in the order in which to return them.
        full: Whether to add all verdicts, features, provenance and the episode.
        rated: See `solution_views`.

    Raises:
        NotFound: The campaign was deleted meanwhile.
    """
    rows = {row.number: row for row in view_store.read_solutions(connection, campaign.id, numbers)}
    if len(rows) < len(numbers):
        raise NotFound(f"campaign {campaign.id}: no such campaign")
    return solution_views([rows[number] for number in numbers], read, full=full, rated=rated)


def solution_views(
    rows: Iterable[Row[*tuple[Any, ...]]], read: ReadArchive, *, full: bool = False, rated: bool = False
) -> list[SolutionView]:
    """Return the response schemas of solutions: decoded parameters and values from the archive.

    Args:
        rows: Database rows of the solutions.
        read: The campaign's archive.
        full: Whether to add all verdicts, features, provenance and the episode.
        rated: Whether to add neighbour counts and boundary fitness although the search does not find a boundary.
    """
    views = []
    counts = read.archive.counts if rated or "boundary" in read.plan.finds else None
    for row in rows:
        check_time()
        views.append(_solution(row, read.plan.problem, counts, read.places.get(row.number), full=full))
    return views


def _solution(
    row: Row[*tuple[Any, ...]],
    problem: Problem,
    counts: NeighbourCounts | None,
    index: int | None,
    *,
    full: bool,
) -> SolutionView:
    result: Mapping[str, Any] = json.loads(row.result) if row.result else {}
    vectors = problem.space.split(np.frombuffer(row.vector, dtype="<f8"))
    activity = activity_of(problem, vectors, result)
    return SolutionView(
        number=row.number,
        generation=row.generation,
        verdict=row.verdict,
        robustness=row.robustness,
        objectives=row.objectives,
        failure=row.failure,
        origin=row.origin,
        **_outcome(row, problem, result),
        **({} if counts is None or index is None else _rating(counts, index)),
        seed=row.seed,
        attempts=row.attempt,
        losses=row.losses,
        words=describe_candidate(problem, vectors, activity),
        parameters=problem.space.decode(vectors),
        titles=_titles(problem.space) if full else {},
        activity=None if activity is None else activity_view(problem.space, activity),
        verdicts=result.get("verdicts") if full else None,
        features=result.get("features") if full else None,
        provenance=result.get("provenance") if full else None,
        spec=json.loads(row.spec) if full and row.spec else None,
    )


def _rating(counts: NeighbourCounts, index: int) -> Mapping[str, Any]:
    """Return the fields that say how near to the boundary the solution at a position of the archive is."""
    return {
        "fitness": float(counts.fitness[index]),
        "neighbours": int(counts.neighbours[index]),
        "unsafe_neighbours": int(counts.unsafe_neighbours[index]),
        "interval": tuple(counts.interval[index].tolist()),
    }


def _titles(space: SearchSpace) -> dict[str, str]:
    """Return the titles of the parameters that have their own, with units, by full name."""
    return {
        f"{component.name}.{parameter.name}": f"{parameter.title} ({unit})" if unit else parameter.title
        for component in space.components
        for parameter in component.parameters
        if parameter.title
        for unit in ["" if isinstance(parameter, Categorical) else parameter.unit]
    }


def _outcome(row: Row[*tuple[Any, ...]], problem: Problem, stored: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the fields of a solution about all of its requirements."""
    if row.verdict not in (SolutionVerdict.SAFE, SolutionVerdict.UNSAFE):
        return {}
    outcome = outcome_of(problem, stored, safe=row.verdict == SolutionVerdict.SAFE, robustness=row.robustness)
    fields: dict[str, Any] = {"outcome": outcome.words(), "kind": outcome.kind}
    if outcome.episode is not None:
        fields["requirements"] = list(outcome.episode.deciding)
        fields["violated"] = [_violated_view(one, stored) for one in outcome.episode.violated]
    return fields


def _violated_view(one: Violated, stored: Mapping[str, Any]) -> ViolatedView:
    """Return a violation, and who would have avoided it; the data comes from a worker and may be malformed."""
    reported = (stored.get("features") or {}).get("violations")
    found = [each for each in (reported if isinstance(reported, list) else []) if isinstance(each, Mapping)]
    circumstances = next((each for each in found if each.get("requirement") == one.requirement), {})
    avoidable = avoidable_of(circumstances)
    return ViolatedView(
        requirement=one.requirement,
        time_s=one.time_s,
        words=one.words,
        decides=one.decides,
        avoidable=avoidable,
        avoided_by=avoided_by_of(circumstances),
        avoidable_words="" if avoidable is None else avoidable.words,
    )


def activity_view(space: SearchSpace, activity: Activity) -> ActivityView:
    """Return the response schema of the parameters that were active in an episode."""
    names = space.column_names()
    return ActivityView(
        inactive=[name for name, active in zip(names, activity.active, strict=True) if not active],
        effective=space.decode(space.split(activity.effective)),
        idle=list(activity.idle),
    )


def simulated(problem: Problem, row: Row[*tuple[Any, ...]]) -> SimulatedSolution:
    """Return a stored solution with the outcome of its simulation."""
    vectors = problem.space.split(np.frombuffer(row.vector, dtype="<f8"))
    result = json.loads(row.result) if row.result else None
    return SimulatedSolution(vectors=vectors, activity=activity_of(problem, vectors, result), result=result)


class KnownSolutionView(View):
    """A solution that a campaign started from."""

    place: Annotated[int, Field(description="Position among them; it has no number in this campaign.")]
    verdict: Annotated[
        SolutionVerdict | None,
        Field(description="Its known verdict, which this campaign did not simulate; null without a result."),
    ]
    robustness: float | None
    words: str
    parameters: dict[str, dict[str, Any]]
    campaign: Annotated[
        str | None, Field(description="The campaign that simulated it; null for a given solution.")
    ]
    number: Annotated[int | None, Field(description="Its number in that campaign.")]


def known_view(problem: Problem, place: int, record: KnownRecord) -> KnownSolutionView:
    """Return the response schema of a solution that a campaign started from, at a place among them."""
    vectors = problem.space.split(np.frombuffer(record.vector, dtype="<f8"))
    verdict = None
    if record.unsafe is not None:
        verdict = SolutionVerdict.UNSAFE if record.unsafe else SolutionVerdict.SAFE
    return KnownSolutionView(
        place=place,
        verdict=verdict,
        robustness=record.robustness,
        words=describe_candidate(problem, vectors),
        parameters=problem.space.decode(vectors),
        campaign=record.source,
        number=record.number,
    )
