"""Resolves a campaign's prior knowledge from an earlier campaign, and decides whether its results still apply.

A result is taken over only if this campaign would have asked for the very same simulation: the same problem with the
same parameters, and, for every solution, an episode with the same hash. Otherwise the campaign is rejected, unless it
asks for the solutions alone. Then they are simulated first, and cost as much as any others.

Two campaigns may have different operational design domains. Solutions outside this campaign's are left out, and
counted.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NoReturn

import numpy as np
from sqlalchemy import Connection, select

from brink.search.algorithm import nearest_to_boundary
from brink.search.errors import SpaceError
from brink.search.odd import odd_of, odd_words
from brink.search.space import SearchSpace
from brink.server.campaigns.body import MOST_KNOWN, CampaignBody, StartFrom
from brink.server.campaigns.known import KnownRecord, given_records, read_known
from brink.server.campaigns.plan import Plan, Start, make_plan
from brink.server.campaigns.simulators import other_simulator
from brink.server.campaigns.store import CAMPAIGNS, Campaign
from brink.server.db.models import SolutionRow
from brink.server.errors import InvalidInput, NotFound
from brink.server.problems.base import SimulatedProblem
from brink.server.problems.catalogue import LIMITS
from brink.server.queue.job_store import is_told
from brink.server.states import ENDED, SolutionVerdict
from brink.sim.catalogue import with_sources

_POINTER = "/start_from/campaign"


def find_start(connection: Connection, body: CampaignBody) -> Start | None:
    """Return the prior knowledge of a campaign; None if it has none.

    Args:
        connection: Sees one snapshot.
        body: The campaign's body.

    Raises:
        InvalidInput: With a pointer to each invalid field.
    """
    wanted = body.start_from
    if wanted is None:
        return None
    plan = make_plan(body)
    if wanted.solutions is not None:
        return Start(records=given_records(plan.problem.space, wanted.solutions), start_from=wanted)
    source = _source(connection, wanted)
    there = _plan_of(source)
    if there.problem.space.unlimited().describe() != plan.problem.space.unlimited().describe():
        _refuse(f"campaign {source.id} searches another space: {_first_difference(there, plan)}")
    if wanted.results:
        _check_same_problem(connection, source, there, plan)
    evaluated = _evaluated(connection, source)
    inside = _within_odd(evaluated, plan.problem.space)
    records = _nearest(inside, wanted)
    if not evaluated:
        _refuse(f"campaign {source.id} has no evaluated solutions")
    if not records:
        limits = "; ".join(filter(None, (odd_words(plan.problem.space), *plan.problem.space.constraints)))
        _refuse(f"campaign {source.id} has no solutions within the ODD: {limits}")
    _check_rows(source, records, plan.problem.space)
    if wanted.results:
        _check_same_episodes(connection, source, records, plan)
    outside = len(evaluated) - len(inside)
    resolved = wanted.model_copy(
        update={"campaign": source.id, "limit": len(records), "outside_odd": outside or None}
    )
    return Start(records=records, start_from=resolved)


def _refuse(message: str, pointer: str = _POINTER) -> NoReturn:
    raise InvalidInput.at(pointer, message)


def _source(connection: Connection, wanted: StartFrom) -> Campaign:
    try:
        source = CAMPAIGNS.get(connection, wanted.campaign or "")
    except NotFound as error:
        _refuse(str(error))
    if source.status not in ENDED:
        _refuse(f"campaign {source.id} is {source.status}: wait until it has ended, or cancel it")
    return source


def _plan_of(source: Campaign) -> Plan:
    try:
        return make_plan(source.body)
    except InvalidInput as error:
        _refuse(f"campaign {source.id} cannot be read here: {error}")


def _first_difference(there: Plan, here: Plan) -> str:
    names = there.problem.space.column_names(), here.problem.space.column_names()
    missing = [name for name in names[0] if name not in names[1]]
    extra = [name for name in names[1] if name not in names[0]]
    if missing or extra:
        return f"it has {', '.join(missing) or 'no further parameter'}, this one {', '.join(extra) or 'none'}"
    return "its parameters have other ranges or constraints"


def _check_same_problem(connection: Connection, source: Campaign, there: Plan, here: Plan) -> None:
    """Check that two campaigns have the same problem.

    Raises:
        InvalidInput: They do not, or the simulator has changed since then.
    """
    differing = [
        f"{name} is {before!r} there and {now!r} here"
        for name, before, now in _settings(there.body, here.body)
        if before != now
    ]
    if not differing and (other := other_simulator(connection, source)) is not None:
        differing = [other]
    if differing:
        _refuse(_not_here(source, "; ".join(differing)))


def _not_here(source: Campaign, why: str) -> str:
    return (
        f"the results of campaign {source.id} do not apply here: {why}. With start_from.results: false, its "
        "solutions "
        "are simulated first instead"
    )


def _settings(there: CampaignBody, here: CampaignBody) -> list[tuple[str, object, object]]:
    """Return the settings that decide the simulations of two campaigns, by name, with both values."""
    before: Mapping[str, Any] = there.problem.params
    now: Mapping[str, Any] = here.problem.params
    return [
        ("problem.id", there.problem.id, here.problem.id),
        *(
            (f"problem.params.{name}", before.get(name), now.get(name))
            for name in sorted({*before, *now} - set(LIMITS))
        ),
        ("ground_truth", there.ground_truth, here.ground_truth),
    ]


def _evaluated(connection: Connection, source: Campaign) -> list[KnownRecord]:
    """Return the results in a campaign's archive, by number, and then those of its own prior knowledge."""
    query = (
        select(SolutionRow.number, SolutionRow.vector, SolutionRow.verdict, SolutionRow.robustness)
        .where(
            SolutionRow.campaign_id == source.id,
            is_told(source.id),
            SolutionRow.verdict.in_((SolutionVerdict.SAFE, SolutionVerdict.UNSAFE)),
        )
        .order_by(SolutionRow.number)
    )
    own = [
        KnownRecord(
            vector=row.vector,
            unsafe=row.verdict == SolutionVerdict.UNSAFE,
            robustness=row.robustness,
            source=source.id,
            number=row.number,
        )
        for row in connection.execute(query)
    ]
    return own + [record for record in read_known(connection, source.id) if record.unsafe is not None]


def _within_odd(records: Sequence[KnownRecord], space: SearchSpace) -> Sequence[KnownRecord]:
    """Return the results within the ODD and the constraints of a space; all of them if it has none."""
    if not odd_of(space) and not space.constraints:
        return records
    return [record for record in records if space.contains(space.split(np.frombuffer(record.vector, "<f8")))]


def _nearest(records: Sequence[KnownRecord], wanted: StartFrom) -> list[KnownRecord]:
    """Return the results nearest to the boundary, in their order; or only the solutions, nearest first."""
    unsafe = np.array([record.unsafe for record in records], np.bool_)
    robustness = np.array([record.robustness for record in records], np.float64)
    order = nearest_to_boundary(unsafe, robustness).tolist()
    most = wanted.limit or MOST_KNOWN
    if wanted.results:
        return [records[place] for place in sorted(order[:most])]
    each = {records[place].vector: records[place] for place in reversed(order)}
    points = [each[vector] for vector in dict.fromkeys(records[place].vector for place in order)]
    return [KnownRecord(vector=one.vector, source=one.source, number=one.number) for one in points[:most]]


def _check_rows(source: Campaign, records: Sequence[KnownRecord], space: SearchSpace) -> None:
    for record in records:
        try:
            space.check(space.split(np.frombuffer(record.vector, "<f8")))
        except SpaceError as error:
            _refuse(f"solution {record.number} of campaign {source.id} is invalid here: {error}")


def _check_same_episodes(
    connection: Connection, source: Campaign, records: Sequence[KnownRecord], plan: Plan
) -> None:
    """Check that every solution would be simulated identically here, even if the problem reads files.

    Raises:
        InvalidInput: It would not.
    """
    problem = plan.problem
    if not isinstance(problem, SimulatedProblem):
        return
    query = select(SolutionRow.number, SolutionRow.seed, SolutionRow.spec_hash).where(
        SolutionRow.campaign_id == source.id
    )
    simulated = {row.number: row for row in connection.execute(query)}
    for record in records:
        if record.source != source.id or record.number is None:
            continue  # checked when that campaign began
        row = simulated[record.number]
        vectors = problem.space.split(np.frombuffer(record.vector, "<f8"))
        if with_sources(problem.episode(vectors, row.seed)).digest() != row.spec_hash:
            why = f"solution {record.number} would be simulated differently now, as a file or plug-in has changed"
            _refuse(_not_here(source, why))
