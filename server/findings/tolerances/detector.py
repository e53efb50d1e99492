"""Whether a detector meets the requirement that follows from tolerances."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from brink.server.campaigns.detector_check import ALL_DRIVES, CellCheck, Drive, check_detector, read_drives
from brink.server.campaigns.plan import Plan
from brink.server.campaigns.store import Campaign
from brink.server.campaigns.tolerance import CampaignTolerance
from brink.server.findings.sources import Sources
from brink.server.findings.tolerances.analysis import CellWords
from brink.server.findings.tolerances.views import DetectorCell, DetectorConditionView, DetectorView
from brink.server.findings.words import as_sentence
from brink.server.problems.base import Problem, RatesMeasuredErrors, SeverityScale
from brink.server.states import CheckResult
from brink.sim.urban.detection_errors import Target
from brink.sim.urban.error_meter import MEASURED
from brink.sim.verdict import drives_violate


async def check_campaign(sources: Sources, campaign: Campaign, other: Campaign) -> DetectorView:
    """Return whether the detector of another campaign meets the requirement of a campaign.

    Args:
        sources: Where findings are read from.
        campaign: The campaign with the tolerances.
        other: A campaign with a camera and a detector in the loop.

    Raises:
        InvalidInput: The errors do not fit the campaign.
    """
    found = await sources.tolerances.get(campaign, await sources.archives.get(campaign))
    there = await sources.archives.get(other)
    drives = await sources.pages.read(sources.engines, lambda c: read_drives(c, other, there, found.layout))
    name = there.plan.problem.measured_detector or other.body.name
    return await check_drives(sources, campaign, name, drives)


async def check_drives(
    sources: Sources, campaign: Campaign, name: str, drives: Sequence[Drive]
) -> DetectorView:
    """Return whether a detector meets the requirement of a campaign.

    Args:
        sources: Where findings are read from.
        campaign: The campaign with the tolerances.
        name: Name of the detector.
        drives: Its errors.

    Raises:
        InvalidInput: The errors do not fit the campaign.
    """
    read = await sources.archives.get(campaign)
    found = await sources.tolerances.get(campaign, read)
    return await sources.analyses.run(lambda: detector_view(campaign, read.plan, found, name, drives))


def detector_view(
    campaign: Campaign, plan: Plan, found: CampaignTolerance, name: str, drives: Sequence[Drive]
) -> DetectorView:
    """Return whether a detector meets a requirement.

    Args:
        campaign: The campaign with the tolerances.
        plan: Its plan.
        found: The tolerances.
        name: Name of the detector.
        drives: Its errors.

    Raises:
        InvalidInput: The errors do not fit the campaign.
    """
    order = list(_SHOWN)
    checks = sorted(
        check_detector(found, plan.problem, drives, campaign.body.seed),
        key=lambda check: order.index(check.result),
    )
    requirements = list(plan.problem.requirements)
    limit, confidence = found.config.limit, found.config.confidence
    cells = [
        _detector_cell(check, CellWords(plan.problem, check.choices, requirements, limit)) for check in checks
    ]
    conditions = []
    for condition in dict.fromkeys((*found.layout.conditions, *(check.condition for check in checks))):
        here = [drive for drive in drives if condition in (drive.condition, ALL_DRIVES)]
        known = [drive.unsafe for drive in here if drive.unsafe is not None]
        conditions.append(
            DetectorConditionView(
                condition=condition, drives=len(here), violations=sum(known) if known else None
            )
        )
    return DetectorView(
        campaign=campaign.id,
        detector=name,
        limit=limit,
        confidence=confidence,
        note=_verdict(name, len(drives), [check.result for check in checks]),
        meaning="Each cell is a type of error that concerns one target, under one condition. Met: errors of the "
        f"sizes that this detector has make at most {limit:.0%} of drives {drives_violate(requirements)}, even at "
        f"the upper end of an interval of {confidence:.0%}. Not met: they make more, even at its lower end."
        + _not_judged(plan.problem, [check.choices for check in checks], drives),
        no_data=_no_data(cells),
        next=_next(cells, sum(drive.condition is None for drive in drives)),
        conditions=conditions,
        cells=cells,
    )


def _not_judged(problem: Problem, cells: Sequence[Mapping[str, str]], drives: Sequence[Drive]) -> str:
    """Return a sentence on the severe errors of the detector for which the campaign has no cell; empty for none."""
    names = {name.rpartition(".")[2]: name for name in cells[0]} if cells else {}
    if not isinstance(problem, RatesMeasuredErrors) or set(names) != {"type", "target"}:
        return ""
    targets = dict.fromkeys(cell[names["target"]] for cell in cells)
    worst = []
    for kind, target in itertools.product([kind.value for kind in MEASURED], targets):
        choices = {names["type"]: kind, names["target"]: target}
        rated = [problem.measured_severity(choices, drive.measures, drive.at_least) for drive in drives]
        severity = max((one.severity for one in rated if one is not None), default=0.0)
        scale = problem.severity_scale(choices)
        if choices not in cells and severity >= _GROSS and scale is not None:
            worst.append((severity, problem.error_words(choices, scale.words(severity))))
    worst.sort(reverse=True)
    if not worst:
        return ""
    named = "; ".join(words for _, words in worst[:_MOST_NOT_JUDGED])
    return f" Not judged, because the campaign has no cell for them: {named}."


_GROSS: Final = 0.25
"""Severity from which an error is worth naming although no cell judges it."""


_MOST_NOT_JUDGED: Final = 5


_SHOWN: Final = (CheckResult.NOT_MET, CheckResult.TOO_LITTLE, CheckResult.MET, CheckResult.NO_DATA)
"""The order in which results matter."""


def _verdict(name: str, drives: int, results: Sequence[CheckResult]) -> str:
    """Return a sentence that counts the cells in which a requirement is met, not met, or undecided."""
    not_met, met, no_data = (
        results.count(result) for result in (CheckResult.NOT_MET, CheckResult.MET, CheckResult.NO_DATA)
    )
    unknown = len(results) - not_met - met
    if not_met:
        words = "does not meet the requirement"
    elif unknown:
        words = "is not shown to meet the requirement"
    else:
        words = "meets the requirement"
    without = f" ({no_data} without any data)" if no_data else ""
    return (
        f"{name} {words}: not met in {not_met} of {len(results)} cells, unknown in {unknown}{without}, met in {met}; "
        f"from {drives:,} {'drive' if drives == 1 else 'drives'}"
    )


def _detector_cell(check: CellCheck, words: "CellWords") -> DetectorCell:
    drives, share = len(check.severity), check.share
    middle, most = (
        np.quantile(check.severity, [0.5, 0.95], method="inverted_cdf").tolist() if drives else (None, None)
    )
    scale = words.scale
    return DetectorCell(
        choices=dict(check.choices),
        error=words.error,
        condition=check.condition,
        result=check.result,
        drives=drives,
        needed=check.needed,
        at_least=check.bounds,
        typical=_in_unit(scale, middle),
        grossest=_in_unit(scale, most),
        unit=scale.unit if scale else "",
        beyond=check.beyond,
        share=share.value if share else None,
        low=share.low if share else None,
        high=share.high if share else None,
        worst=list(check.worst),
        sentence=words.checked(check, middle),
    )


def _no_data(cells: Sequence[DetectorCell]) -> str:
    """Return a sentence for each group of conditions without informative drives."""
    conditions: dict[str, list[str]] = {}
    for condition in dict.fromkeys(cell.condition for cell in cells):
        here = [cell for cell in cells if cell.condition == condition]
        without = [cell.error for cell in here if cell.result is CheckResult.NO_DATA]
        if without:
            errors = "everything" if len(without) == len(here) else ", ".join(without)
            conditions.setdefault(errors, []).append(condition)
    parts = [f"{as_sentence('; '.join(names))}: {errors}." for errors, names in conditions.items()]
    return f"Without data. {' '.join(parts)}" if parts else ""


def _next(cells: Sequence[DetectorCell], without_condition: int) -> list[str]:
    """Return what to record next: where more drives would be decisive, where there are none yet, and the rest.

    Args:
        cells: The cells.
        without_condition: How many drives have no condition.
    """
    begun: dict[tuple[str, str], list[int]] = {}
    empty: dict[str, list[DetectorCell]] = {}
    has_conditions = any(cell.condition != ALL_DRIVES for cell in cells)
    for cell in cells:
        target = next((value for name, value in cell.choices.items() if name.endswith(".target")), "")
        if cell.needed is not None and cell.drives:
            begun.setdefault((cell.condition, target), []).append(cell.needed - cell.drives)
        elif cell.needed is not None and (cell.condition != ALL_DRIVES or not has_conditions):
            empty.setdefault(target, []).append(cell)
    words = [
        f"{as_sentence(condition)}: about {most:,} more {'drive' if most == 1 else 'drives'} with "
        f"{_in_sight(target)} would decide {_cells(len(more))} if they are like those so far"
        for (condition, target), more in begun.items()
        if (most := max(more)) > 0
    ]
    if without_condition and has_conditions:
        words.append(
            f"{without_condition:,} {'drive has' if without_condition == 1 else 'drives have'} no condition, and "
            "count under all drives alone: say what it was like"
        )
    for target, without in empty.items():
        conditions = list(dict.fromkeys(cell.condition for cell in without))
        words.append(
            f"{as_sentence('; '.join(conditions))}: {max(cell.needed or 0 for cell in without):,} drives or more"
            f"{' each' if len(conditions) > 1 else ''} with {_in_sight(target)}, before {_cells(len(without))} "
            "can be met; none so far is informative"
        )
    open_ended = sum(cell.result is CheckResult.TOO_LITTLE and cell.needed is None for cell in cells)
    if open_ended:
        words.append(
            f"More drives would not decide {_cells(open_ended)}: the requirement is too uncertain, or the detector "
            "too close to it; a campaign with a larger budget may decide"
        )
    return words


def _cells(number: int) -> str:
    return "1 cell" if number == 1 else f"{number} cells"


def _in_sight(target: str) -> str:
    return f"{_IN_SIGHT.get(target, 'such a road user')} in sight"


_IN_SIGHT: Final[Mapping[str, str]] = {
    Target.LEAD: "a vehicle ahead",
    Target.ONCOMING: "an oncoming vehicle",
    Target.CROSSING: "a crossing vehicle",
    Target.PEDESTRIAN: "a pedestrian near the lane",
    Target.EVERYBODY: "somebody",
}


def _in_unit(scale: SeverityScale | None, severity: float | None) -> float | None:
    if severity is None:
        return None
    return severity if scale is None else scale.at(severity)
