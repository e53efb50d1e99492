"""The thresholds of a campaign for people: in the units of the problem, in words, with drives at both ends."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from sqlalchemy import Connection, Row

from brink.search.analysis.confirmation import Share
from brink.search.archive import Archive
from brink.search.conclusions import Outcome
from brink.search.pairs import Steps
from brink.search.parameters import Integer
from brink.search.thresholds import CONFIDENCE
from brink.server.campaigns import view_store
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.follow_ups.follow_up import StoredFollowUp
from brink.server.campaigns.follow_ups.kinds.confirm import Repeated
from brink.server.campaigns.outcomes import SolutionOutcome
from brink.server.campaigns.store import Campaign
from brink.server.campaigns.threshold_ends import Ends, kind_of, read_outcome, row_at
from brink.server.campaigns.thresholds import CampaignThresholds, Threshold
from brink.server.errors import NotFound
from brink.server.findings.follow_ups import ShareView
from brink.server.findings.pairs.analysis import read_truths
from brink.server.findings.pairs.views import ComponentPart, ComponentView
from brink.server.findings.thresholds.views import (
    CurveView,
    DotView,
    EndView,
    ThresholdsView,
    ThresholdView,
    TightPairView,
)
from brink.server.findings.thresholds.words import (
    BLAMED,
    Amounts,
    change_of,
    headline,
    held,
    parameter_words,
    rises,
    rule,
    sentence,
    turns,
    untold,
    window,
    within,
)
from brink.server.findings.words import as_sentence
from brink.server.problems.base import Problem, SimulatedSolution
from brink.server.problems.changes import changes_between

_ROUNDING: Final = 1e-9
_CURVE_DIGITS: Final = 5


def thresholds_view(
    connection: Connection,
    campaign: Campaign,
    read: ReadArchive,
    found: CampaignThresholds,
    stored: Sequence[StoredFollowUp],
) -> ThresholdsView:
    """Return the thresholds of a campaign.

    Args:
        connection: Read connection.
        campaign: The campaign.
        read: Its archive.
        found: Its thresholds.
        stored: Its follow-ups.
    """
    ends = [Ends.of(read.archive, one) for one in found.all]
    numbers = {number for one in ends for number in (one.safe, one.unsafe)}
    rows = {row.number: row for row in view_store.read_solutions(connection, campaign.id, numbers)}
    if not rows.keys() >= numbers:
        raise NotFound(f"campaign {campaign.id}: no such campaign")  # it was deleted meanwhile
    evidence = _Evidence(repeated=Repeated.of(stored), truths=read_truths(connection, stored))
    views = [
        _view(place, one, pair, read, rows, evidence)
        for place, (one, pair) in enumerate(zip(found.all, ends, strict=True), start=1)
    ]
    problem = read.plan.problem
    noun = "drive" if problem.records_traces else "solution"
    kinds = {tuple(one.kind) for one in views if one.outcome is Outcome.THRESHOLD}
    return ThresholdsView(
        campaign=campaign.id,
        name=campaign.body.name,
        status=campaign.status,
        sentence=headline(found, len(kinds), read.archive, problem, noun),
        note=untold(found, read.archive, problem, noun),
        confidence=CONFIDENCE,
        replayable=problem.records_traces,
        computed=problem.ignores_seeds,
        has_component=problem.has_component,
        kinds=len(kinds),
        left_out=found.left_out,
        thresholds=views,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Evidence:
    """What follow-ups showed: shares with other seeds, and by number what happens with ground truth."""

    repeated: Repeated
    truths: Mapping[int, ComponentView]


def _view(
    place: int,
    one: Threshold,
    ends: Ends,
    read: ReadArchive,
    rows: Mapping[int, Row[Any]],
    evidence: _Evidence,
) -> ThresholdView:
    problem, line = read.plan.problem, one.line
    row = read.archive.vectors[int(line.places[0])]
    amounts = Amounts.of(problem, line.leading, row, one.resolution)
    safe, unsafe = (_at(problem, read.archive, one, value) for value in _sides(problem, one, amounts))
    first, last = (_at(problem, read.archive, one, value) for value in line.ends)
    steps = Steps(problem.space)
    units = steps.differing(*(problem.space.join(tuple(side.vectors)) for side in (safe, unsafe))) or [
        line.unit
    ]
    change = change_of(problem, safe, unsafe, changes_between(problem, safe, unsafe, units))
    outcomes = [read_outcome(problem, rows[number]) for number in (ends.safe, ends.unsafe)]
    fails = outcomes[1].words(times=False)
    name = problem.space.column_names()[line.leading]
    parameter = parameter_words(problem, name, unsafe, amounts.unit)
    reached = [amounts.words(value) for value in sorted(line.ends, key=lambda value: value * amounts.per_1)]
    truth = evidence.truths.get(ends.unsafe) or ComponentView(state=ComponentPart.NOT_TRIED)
    return ThresholdView(
        place=place,
        outcome=one.outcome,
        words=sentence(one, change, fails, reached, as_sentence(parameter)),
        change=change,
        turns=turns(one, amounts, computed=problem.ignores_seeds),
        within=within(one, amounts),
        rule=rule(one, amounts, computed=problem.ignores_seeds),
        held=held(problem, first, last, line.unit),
        fails=fails,
        requirements=list(outcomes[1].episode.deciding) if outcomes[1].episode else [],
        kind=list(kind_of(problem, read.archive, one, fails)),
        names=[problem.space.column_names()[column] for column in line.unit],
        parameter=parameter,
        unit=amounts.unit,
        decimals=amounts.decimals,
        log=amounts.digits is not None,
        resolution=amounts.apart(one.resolution),
        states_resolution=one.states_resolution,
        range=amounts.apart(one.range),
        middle=amounts.amount(one.middle),
        low=_least(amounts, one),
        high=_most(amounts, one),
        at_20=amounts.amount(one.start),
        at_80=amounts.amount(one.end),
        stretch=amounts.apart(one.stretch) if math.isfinite(one.stretch) else None,
        rises=rises(one, amounts),
        safe_again=None if one.safe_again is None else amounts.amount(one.safe_again),
        window=window(one, amounts),
        chancy=one.chancy,
        drives=one.drives,
        blame=truth.state,
        blame_words=BLAMED[truth.state] if problem.has_component and one.outcome is Outcome.THRESHOLD else "",
        truth=truth.outcome,
        pair=_pair(one, ends, amounts, outcomes, evidence),
        dots=_dots(one, amounts),
        curve=_curve(one, amounts),
    )


def _sides(problem: Problem, one: Threshold, amounts: Amounts) -> list[float]:
    """Return the 20 and the 80% point, or else the ends of the line.

    They are rounded as people read them, unless that makes them equal; whole numbers, outwards then.
    """
    points = [
        point if math.isfinite(point) else end
        for point, end in zip((one.start, one.end), one.line.ends, strict=True)
    ]
    rounded = [amounts.rounded(point) for point in points]
    if rounded[0] != rounded[1]:
        return rounded
    if not isinstance(problem.space.parameters[one.line.leading], Integer):
        return points
    outwards = (math.floor, math.ceil) if one.line.rises else (math.ceil, math.floor)
    return [float(towards(point)) for towards, point in zip(outwards, points, strict=True)]


def _at(problem: Problem, archive: Archive, one: Threshold, value: float) -> SimulatedSolution:
    """Return the solution at a value of a line, without a result, since it need not have been simulated."""
    return SimulatedSolution(vectors=problem.space.split(row_at(problem, archive, one, value)))


def _least(amounts: Amounts, one: Threshold) -> float | None:
    return amounts.amount(min(one.low, one.high, key=lambda value: value * amounts.per_1))


def _most(amounts: Amounts, one: Threshold) -> float | None:
    return amounts.amount(max(one.low, one.high, key=lambda value: value * amounts.per_1))


def _pair(
    one: Threshold, ends: Ends, amounts: Amounts, outcomes: Sequence[SolutionOutcome], evidence: _Evidence
) -> TightPairView | None:
    if not ends.are_beyond or one.outcome is Outcome.CHANCY:
        return None
    safe, unsafe = (
        EndView(number=number, value=amounts.at(value), outcome=outcome.words(), again=_share(share))
        for number, value, outcome, share in zip(
            (ends.safe, ends.unsafe),
            ends.values,
            outcomes,
            evidence.repeated.shares_of(ends.safe, ends.unsafe),
            strict=True,
        )
    )
    return TightPairView(
        safe=safe,
        unsafe=unsafe,
        width=amounts.apart(ends.width),
        tight=one.outcome is Outcome.THRESHOLD and ends.are_tight,
        confirmation=evidence.repeated.state(ends.safe, ends.unsafe),
    )


def _dots(one: Threshold, amounts: Amounts) -> list[DotView]:
    line = one.line
    values, which = np.unique(line.values[line.own], return_inverse=True)
    drives = np.bincount(which, minlength=len(values))
    unsafe = np.bincount(which, weights=line.unsafe[line.own], minlength=len(values))
    return [
        DotView(value=amounts.at(value), drives=int(count), unsafe=int(violating))
        for value, count, violating in zip(values.tolist(), drives, unsafe, strict=True)
    ]


def _curve(one: Threshold, amounts: Amounts) -> CurveView:
    shares = one.shares
    order = slice(None) if rises(one, amounts) else slice(None, None, -1)
    values = [amounts.at(value) for value in shares.values[order].tolist()]
    if amounts.digits is None:
        values = np.round(values, _CURVE_DIGITS).tolist()
    columns = (shares.median, shares.low, shares.high)
    share, low, high = (np.round(column[order], _CURVE_DIGITS).tolist() for column in columns)
    return CurveView(value=values, share=share, low=low, high=high)


def _share(share: Share) -> ShareView:
    return ShareView(
        evaluated=share.evaluated,
        unsafe=share.unsafe,
        probability=share.probability,
        low=share.low,
        high=share.high,
        failed=share.failed,
    )
