"""The thresholds of a campaign for people: in the units of the problem, in words, with drives at both ends."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from sqlalchemy import Connection, Row

from brink.search.analysis.confirmation import Share
from brink.search.archive import Archive
from brink.search.features import Unit
from brink.search.pairs import Steps
from brink.search.parameters import Categorical, Value
from brink.search.space import FloatArray, Integer
from brink.search.thresholds import CONFIDENCE, Outcome
from brink.server.campaigns import view_store
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.follow_ups.follow_up import StoredFollowUp
from brink.server.campaigns.follow_ups.kinds.component import blames_scenario
from brink.server.campaigns.follow_ups.kinds.confirm import Repeated
from brink.server.campaigns.outcomes import SolutionOutcome, outcome_of
from brink.server.campaigns.store import Campaign
from brink.server.campaigns.thresholds import CampaignThresholds, Threshold
from brink.server.errors import NotFound
from brink.server.findings.follow_ups import ShareView
from brink.server.findings.pairs.views import ComponentPart
from brink.server.findings.thresholds.views import (
    CurveView,
    DotView,
    EndView,
    ThresholdsView,
    ThresholdView,
    TightPairView,
)
from brink.server.findings.words import counted
from brink.server.problems.base import Problem, SimulatedSolution, describe_candidate
from brink.server.problems.changes import (
    as_sentence,
    change_words,
    changes_between,
    common_words,
    share_words,
)
from brink.server.states import SolutionVerdict

_ROUNDING: Final = 1e-9
_CURVE_DIGITS: Final = 5
_MOST_LISTED: Final = 6
"""Most held values that are listed where the problem has no words for what is held."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Amounts:
    """Values of a number in the unit that people use.

    Attributes:
        unit: The unit; empty for a plain number.
        at_0: Amount of the value 0.
        per_1: Amount of a difference of 1.
        decimals: Decimal places that the resolution asks for.
    """

    unit: str
    at_0: float
    per_1: float
    decimals: int

    @classmethod
    def of(cls, problem: Problem, column: int, row: FloatArray, resolution: float) -> Self:
        """Return the amounts of a number in a solution.

        Args:
            problem: The problem.
            column: Column of the number.
            row: The solution, shape ``(d,)``.
            resolution: Resolution of the number.
        """
        space = problem.space
        scale = problem.scale_of(space.column_names()[column], space.decode(space.split(row)))
        unit, at_0, at_1 = "", 0.0, 1.0
        if scale is not None:
            unit, at_0, at_1 = scale.unit, scale.none, scale.most
        else:
            parameter = space.parameters[column]
            assert not isinstance(parameter, Categorical)  # a line has no categories
            unit = parameter.unit
        shown = resolution * abs(at_1 - at_0)
        decimals = max(0, math.ceil(-math.log10(shown) - _ROUNDING))
        return cls(unit=unit, at_0=at_0, per_1=at_1 - at_0, decimals=decimals)

    def amount(self, value: float) -> float | None:
        """Return the amount of a value; None if that is infinite."""
        return self.at_0 + value * self.per_1 if math.isfinite(value) else None

    def rounded(self, value: float) -> float:
        """Return the value whose amount has no more decimal places than the resolution asks for."""
        return (round(self.at_0 + value * self.per_1, self.decimals) - self.at_0) / self.per_1

    def number(self, value: float) -> str:
        """Return the amount of a value in digits; ``beyond`` if that is infinite."""
        amount = self.amount(value)
        return "beyond" if amount is None else f"{amount + 0.0:.{self.decimals}f}"

    def words(self, value: float) -> str:
        """Return the amount of a value with its unit."""
        return self._with_unit(self.number(value))

    def interval(self, low: float, high: float) -> str:
        """Return an interval in digits, smaller amounts first."""
        ends = sorted((low, high), key=lambda value: self.at_0 + value * self.per_1)
        return f"[{self.number(ends[0])}, {self.number(ends[1])}]"

    def difference(self, width: float, resolution: float) -> str:
        """Return a difference with its unit; less than a resolution is not told apart."""
        shown = f"{max(width, resolution) * abs(self.per_1):.{self.decimals}f}"
        return self._with_unit(f"less than {shown}" if width < resolution else shown)

    def _with_unit(self, digits: str) -> str:
        return digits + (self.unit if self.unit == "%" else f" {self.unit}".rstrip())


def thresholds_view(
    connection: Connection,
    campaign: Campaign,
    read: ReadArchive,
    found: CampaignThresholds,
    stored: Sequence[StoredFollowUp],
    limit: int,
) -> ThresholdsView:
    """Return the thresholds of a campaign.

    Args:
        connection: Read connection.
        campaign: The campaign.
        read: Its archive.
        found: Its thresholds.
        stored: Its follow-ups.
        limit: Most lines to return.
    """
    ends = [_Ends.of(read.archive, one) for one in found.all]
    numbers = {number for one in ends for number in (one.safe, one.unsafe)}
    rows = {row.number: row for row in view_store.read_solutions(connection, campaign.id, numbers)}
    if not rows.keys() >= numbers:
        raise NotFound(f"campaign {campaign.id}: no such campaign")  # it was deleted meanwhile
    evidence = _Evidence(repeated=Repeated.of(stored), scenario=blames_scenario(stored))
    views = [
        _view(place, one, pair, read, rows, evidence)
        for place, (one, pair) in enumerate(zip(found.all, ends, strict=True), start=1)
    ]
    kinds = {tuple(one.kind) for one in views if one.outcome is Outcome.THRESHOLD}
    return ThresholdsView(
        campaign=campaign.id,
        name=campaign.body.name,
        status=campaign.status,
        sentence=_sentence(found, len(kinds)),
        confidence=CONFIDENCE,
        replayable=read.plan.problem.records_traces,
        kinds=len(kinds),
        left_out=found.left_out + max(0, len(views) - limit),
        thresholds=views[:limit],
    )


def _sentence(found: CampaignThresholds, kinds: int) -> str:
    """Return the result in at most 25 words."""
    thresholds, chancy, open_ones = (
        found.of(outcome) for outcome in (Outcome.THRESHOLD, Outcome.CHANCY, Outcome.OPEN)
    )
    rest = [counted(len(chancy), "chancy line")] if chancy else []
    rest += [counted(len(open_ones), "open line")] if open_ones else []
    if not thresholds:
        if rest:
            return f"no threshold so far: {' and '.join(rest)}"
        return "no threshold: no unit was varied alone with enough episode seeds"
    stretch = float(np.median([one.stretch / one.range for one in thresholds]))
    words = (
        f"{counted(len(thresholds), 'threshold')} of {counted(kinds, 'kind')}; from 20 to 80% unsafe within "
        f"{share_words(stretch)} of the range{' (median)' if len(thresholds) > 1 else ''}"
    )
    return "; ".join([words, *rest])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Ends:
    """Simulated solutions on both sides of a threshold, by number.

    Attributes:
        safe: The safe one nearest to the 20% point, on its safe side; else the one furthest from it.
        unsafe: The unsafe one nearest to the 80% point, on its unsafe side; else the one furthest from it.
        values: Values of the two.
        are_beyond: Whether both lie on these sides.
    """

    safe: int
    unsafe: int
    values: tuple[float, float]
    are_beyond: bool

    @classmethod
    def of(cls, archive: Archive, one: Threshold) -> Self:
        """Choose the solutions at both ends of a threshold."""
        line, sign = one.line, 1.0 if one.line.rises else -1.0
        along = sign * line.values
        reach = np.inf if one.safe_again is None else sign * one.safe_again
        safe = np.flatnonzero(~line.unsafe & (along < reach))
        unsafe = np.flatnonzero(line.unsafe & (along < reach))
        before = safe[along[safe] <= sign * one.start] if math.isfinite(one.start) else safe[:0]
        after = unsafe[along[unsafe] >= sign * one.end] if math.isfinite(one.end) else unsafe[:0]
        low = before[np.argmax(along[before])] if before.size else safe[np.argmin(along[safe])]
        high = after[np.argmin(along[after])] if after.size else unsafe[np.argmax(along[unsafe])]
        numbers = archive.numbers[line.places[[low, high]]].tolist()
        return cls(
            safe=numbers[0],
            unsafe=numbers[1],
            values=(float(line.values[low]), float(line.values[high])),
            are_beyond=bool(before.size and after.size),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Evidence:
    """What follow-ups showed: shares with other seeds, and by number whether the scenario alone is to blame."""

    repeated: Repeated
    scenario: Mapping[int, bool]

    def blame(self, unsafe: int) -> ComponentPart:
        """Return whether the component or the scenario is to blame for an unsafe solution."""
        if unsafe not in self.scenario:
            return ComponentPart.NOT_TRIED
        return ComponentPart.SCENARIO if self.scenario[unsafe] else ComponentPart.COMPONENT


def _view(
    place: int,
    one: Threshold,
    ends: _Ends,
    read: ReadArchive,
    rows: Mapping[int, Row[Any]],
    evidence: _Evidence,
) -> ThresholdView:
    problem, line = read.plan.problem, one.line
    row = read.archive.vectors[int(line.places[0])]
    amounts = Amounts.of(problem, line.leading, row, one.resolution)
    sides = _sides(one, amounts)
    safe, unsafe = (_at(problem, read.archive, one, value) for value in sides)
    steps = Steps(problem.space)
    units = steps.differing(*(problem.space.join(tuple(side.vectors)) for side in (safe, unsafe))) or [
        line.unit
    ]
    change = change_words(problem, safe, unsafe, changes_between(problem, safe, unsafe, units))
    outcomes = [_outcome(problem, rows[number]) for number in (ends.safe, ends.unsafe)]
    fails = outcomes[1].words(times=False)
    name = problem.space.column_names()[line.leading]
    values = problem.space.decode(tuple(unsafe.vectors))
    descriptions = [describe_candidate(problem, side.vectors) for side in (safe, unsafe)]
    return ThresholdView(
        place=place,
        outcome=one.outcome,
        words=f"{as_sentence(change)}: {fails}",
        change=change,
        turns=f"{amounts.words(one.middle)} {amounts.interval(one.low, one.high)}",
        within=_within(one, amounts),
        rule=_rule(one, amounts),
        held=common_words(*descriptions) or _listed(problem, safe, line.unit),
        fails=fails,
        requirements=list(outcomes[1].episode.deciding) if outcomes[1].episode else [],
        kind=[*problem.traits(name, values), fails],
        names=[problem.space.column_names()[column] for column in line.unit],
        parameter=problem.space.titles()[name],
        unit=amounts.unit,
        decimals=amounts.decimals,
        resolution=one.resolution * abs(amounts.per_1),
        states_resolution=one.states_resolution,
        range=one.range * abs(amounts.per_1),
        middle=amounts.amount(one.middle),
        low=_least(amounts, one),
        high=_most(amounts, one),
        at_20=amounts.amount(one.start),
        at_80=amounts.amount(one.end),
        stretch=one.stretch * abs(amounts.per_1) if math.isfinite(one.stretch) else None,
        rises=_rises(one, amounts),
        safe_again=None if one.safe_again is None else amounts.amount(one.safe_again),
        window=_window(one, amounts),
        chancy=one.chancy,
        drives=one.drives,
        blame=evidence.blame(ends.unsafe),
        pair=_pair(one, ends, amounts, outcomes, evidence),
        dots=_dots(one, amounts),
        curve=_curve(one, amounts),
    )


def _listed(problem: Problem, side: SimulatedSolution, unit: Unit) -> str:
    """Return the first values that are held, such as ``what.y 0.5 m``."""
    space, row = problem.space, problem.space.join(tuple(side.vectors))
    units = ["" if isinstance(one, Categorical) else one.unit for one in space.parameters]
    listed = [
        f"{name} {_value_text(parameter.decode(float(row[column])))} {units[column]}"
        for column, (name, parameter) in enumerate(zip(space.column_names(), space.parameters, strict=True))
        if column not in unit
    ]
    more = [f"{len(listed) - _MOST_LISTED} more"] if len(listed) > _MOST_LISTED else []
    return ", ".join([*map(str.rstrip, listed[:_MOST_LISTED]), *more])


def _value_text(value: Value) -> str:
    """Return a value with at most four significant digits."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _sides(one: Threshold, amounts: Amounts) -> list[float]:
    """Return the 20 and the 80% point, or else the ends of the line.

    They are rounded as people read them, unless that makes them equal.
    """
    points = [
        point if math.isfinite(point) else end
        for point, end in zip((one.start, one.end), one.line.ends, strict=True)
    ]
    rounded = [amounts.rounded(point) for point in points]
    return points if rounded[0] == rounded[1] else rounded


def _at(problem: Problem, archive: Archive, one: Threshold, value: float) -> SimulatedSolution:
    """Return the solution at a value of a line, without a result, since it need not have been simulated."""
    line, space = one.line, problem.space
    first, last = (archive.vectors[int(line.places[at])] for at in (0, -1))
    share = (value - line.values[0]) / (line.values[-1] - line.values[0])
    row = np.array(first)
    for column in line.unit:
        row[column] = first[column] + share * (last[column] - first[column])
        if isinstance(space.parameters[column], Integer):
            row[column] = np.rint(row[column])
    return SimulatedSolution(vectors=space.split(row))


def _outcome(problem: Problem, row: Row[Any]) -> SolutionOutcome:
    result = json.loads(row.result) if row.result else None
    safe = row.verdict == SolutionVerdict.SAFE
    return outcome_of(problem, result, safe=safe, robustness=row.robustness)


def _within(one: Threshold, amounts: Amounts) -> str:
    if not math.isfinite(one.stretch):
        return "not within the line"
    return f"{amounts.difference(one.stretch, one.resolution)} ({share_words(one.stretch / one.range)})"


def _rule(one: Threshold, amounts: Amounts) -> str:
    if one.outcome is not Outcome.THRESHOLD or not math.isfinite(one.end):
        return ""
    where = amounts.words(one.end)
    if all(map(math.isfinite, one.end_interval)):
        where += f" {amounts.interval(*one.end_interval)}"
    beyond = "above" if _rises(one, amounts) else "below"
    until = "" if one.safe_again is None else f", up to {amounts.words(one.safe_again)}"
    return f"unsafe in at least 80% of drives at {where} and {beyond}{until}"


def _window(one: Threshold, amounts: Amounts) -> str:
    if one.safe_again is not None:
        return f"further on, from {amounts.words(one.safe_again)}, no longer unsafe"
    if one.line.safe_beyond is not None:
        return f"one drive further on, at {amounts.words(one.line.safe_beyond)}, is safe again"
    return ""


def _least(amounts: Amounts, one: Threshold) -> float | None:
    return amounts.amount(min(one.low, one.high, key=lambda value: value * amounts.per_1))


def _most(amounts: Amounts, one: Threshold) -> float | None:
    return amounts.amount(max(one.low, one.high, key=lambda value: value * amounts.per_1))


def _pair(
    one: Threshold, ends: _Ends, amounts: Amounts, outcomes: Sequence[SolutionOutcome], evidence: _Evidence
) -> TightPairView | None:
    if not ends.are_beyond or one.outcome is Outcome.CHANCY:
        return None
    width = abs(ends.values[1] - ends.values[0])
    safe, unsafe = (
        EndView(
            number=number,
            value=amounts.at_0 + value * amounts.per_1,
            outcome=outcome.words(),
            again=_share(share),
        )
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
        width=width * abs(amounts.per_1),
        tight=width <= one.stretch + 2 * one.resolution + _ROUNDING,
        confirmation=evidence.repeated.state(ends.safe, ends.unsafe),
    )


def _share(share: Share) -> ShareView:
    return ShareView(
        evaluated=share.evaluated,
        unsafe=share.unsafe,
        probability=share.probability,
        low=share.low,
        high=share.high,
        failed=share.failed,
    )


def _dots(one: Threshold, amounts: Amounts) -> list[DotView]:
    line = one.line
    values, which = np.unique(line.values[line.own], return_inverse=True)
    drives = np.bincount(which, minlength=len(values))
    unsafe = np.bincount(which, weights=line.unsafe[line.own], minlength=len(values))
    return [
        DotView(value=amounts.at_0 + value * amounts.per_1, drives=int(count), unsafe=int(violating))
        for value, count, violating in zip(values.tolist(), drives, unsafe, strict=True)
    ]


def _curve(one: Threshold, amounts: Amounts) -> CurveView:
    shares = one.shares
    order = slice(None) if _rises(one, amounts) else slice(None, None, -1)
    columns = (amounts.at_0 + shares.values * amounts.per_1, shares.median, shares.low, shares.high)
    value, share, low, high = (np.round(column[order], _CURVE_DIGITS).tolist() for column in columns)
    return CurveView(value=value, share=share, low=low, high=high)


def _rises(one: Threshold, amounts: Amounts) -> bool:
    """Return whether larger amounts are the unsafe ones."""
    return one.line.rises == (amounts.per_1 > 0)
