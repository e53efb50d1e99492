"""Whether a detector meets the requirement of a campaign, judged by its errors in its own drives."""

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from sqlalchemy import Connection

from brink.search.algorithms.tolerance import Layout
from brink.search.curves import Curve, DriveShares, Interval, flawless_drives
from brink.search.space import FloatArray
from brink.search.streams import Stream, generator
from brink.server.campaigns import view_store
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.store import Campaign
from brink.server.campaigns.tolerance import CampaignTolerance
from brink.server.errors import InvalidInput
from brink.server.problems.base import RatesMeasuredErrors
from brink.server.states import CheckResult
from brink.sim.urban.error_meter import MEASURES

MOST_DRIVES = 10_000
WORST = 5
"""Maximum number of drives listed as the worst of a cell."""
ALL_DRIVES = "all drives"
"""The condition of drives of which none is known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """The errors of a detector in one drive.

    Attributes:
        name: Name of the drive, such as the number of its solution.
        condition: Name of its condition; None if it is unknown.
        measures: Magnitude of each type of error, by target; what the drive cannot tell is missing.
        at_least: Types whose magnitude is a lower bound, by target.
        unsafe: Whether it violated the requirement; None if that is unknown.
    """

    name: str
    condition: str | None
    measures: Mapping[str, Mapping[str, float]]
    at_least: Mapping[str, Collection[str]] = field(default_factory=dict)
    unsafe: bool | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class CellCheck:
    """A detector's errors in one cell.

    Attributes:
        choices: The error, as choices of parameters by component.parameter.
        condition: Condition of the drives.
        severity: How gross the error was in each drive that tells, shape ``(n,)``.
        bounds: How many of these are lower bounds.
        share: Share of drives with a violation that such errors cause; None without drives.
        tolerated: Severity at which the share of violations reaches the limit; infinite beyond the scale.
        result: Whether the detector meets the requirement.
        needed: Drives with such errors, or without any if there are none yet, that would decide; None where more
            drives would not, or nothing is left to decide.
        worst: Names of the drives with the grossest errors, grossest first.
    """

    choices: Mapping[str, str]
    condition: str
    severity: FloatArray
    bounds: int
    share: Interval | None
    tolerated: float
    result: CheckResult
    needed: int | None
    worst: tuple[str, ...]

    @property
    def beyond(self) -> int:
        """Drives with a more severe error than is tolerated."""
        return int((self.severity > self.tolerated).sum())


def check_detector(
    found: CampaignTolerance, problem: object, drives: Sequence[Drive], seed: int
) -> list[CellCheck]:
    """Judge a detector by each cell of a campaign.

    Drives whose condition is unknown count under `ALL_DRIVES` and under no other condition. Where the campaign has
    conditions of its own, they are judged there by whichever of its curves is the worst, or, for *not met*, the best.

    Args:
        found: The tolerances of the campaign.
        problem: Its problem.
        drives: The detector's drives.
        seed: Seed of the intervals.

    Raises:
        InvalidInput: The problem does not know measured errors, or a condition is none of the campaign's.
    """
    if not isinstance(problem, RatesMeasuredErrors):
        raise InvalidInput.at(
            "/path/campaign_id", "the problem of this campaign does not support measured errors"
        )
    conditions = found.layout.conditions
    has_conditions = tuple(conditions) != (ALL_DRIVES,)
    for drive in drives:
        if has_conditions and drive.condition is not None and drive.condition not in conditions:
            raise InvalidInput.at(
                "/drives",
                f"drive {drive.name}: expected one of the conditions {'; '.join(conditions)}; got "
                f"{drive.condition!r}",
            )
    cells: dict[tuple[str, tuple[str, ...]], list[Curve]] = {
        (cell.condition, cell.choices): [curve]
        for cell, curve in zip(found.layout.cells, found.curves, strict=True)
    }
    if has_conditions and any(drive.condition is None for drive in drives):
        for cell, curve in zip(found.layout.cells, found.curves, strict=True):
            cells.setdefault((ALL_DRIVES, cell.choices), []).append(curve)
    by_condition = {
        condition: [drive for drive in drives if condition in (drive.condition, ALL_DRIVES)]
        for condition in (*conditions, ALL_DRIVES)
    }
    return [
        _checked(
            found,
            problem,
            dict(zip(found.layout.names, choices, strict=True)),
            condition,
            curves,
            by_condition[condition],
            generator(seed, Stream.TOLERANCE, 4, place),
        )
        for place, ((condition, choices), curves) in enumerate(cells.items())
    ]


def _checked(
    found: CampaignTolerance,
    problem: RatesMeasuredErrors,
    choices: Mapping[str, str],
    condition: str,
    curves: Sequence[Curve],
    drives: Sequence[Drive],
    rng: np.random.Generator,
) -> CellCheck:
    limit, confidence = found.config.limit, found.config.confidence
    rated = [
        (problem.measured_severity(choices, drive.measures, drive.at_least), drive.name) for drive in drives
    ]
    rated_drives = [(one, name) for one, name in rated if one is not None]
    severity = np.array([one.severity for one, _ in rated_drives])
    share, needed, result = None, None, CheckResult.NO_DATA
    if rated_drives:
        shares = DriveShares.of(curves, severity, np.array([one.is_bound for one, _ in rated_drives]))
        share = shares.interval(rng, confidence)
        result = CheckResult.TOO_LITTLE
        if share.high <= limit:
            result = CheckResult.MET
        elif share.low > limit:
            result = CheckResult.NOT_MET
        else:
            needed = shares.needed(rng, confidence, limit, MOST_DRIVES)
    elif problem.measures_errors(choices):
        needed = flawless_drives(limit, confidence)
    worst = sorted((one for one in rated_drives if one[0].severity > 0.0), key=lambda one: -one[0].severity)
    return CellCheck(
        choices=choices,
        condition=condition,
        severity=severity,
        bounds=sum(one.is_bound for one, _ in rated_drives),
        share=share,
        tolerated=min(curve.tolerated.value for curve in curves),
        result=result,
        needed=needed,
        worst=tuple(name for _, name in worst[:WORST]),
    )


def read_drives(connection: Connection, campaign: Campaign, read: ReadArchive, layout: Layout) -> list[Drive]:
    """Return the drives of a campaign with a camera and a detector in the loop.

    Args:
        connection: Read connection.
        campaign: The campaign.
        read: Its archive.
        layout: The cells against which the drives are checked, which define their conditions.

    Raises:
        InvalidInput: Its episodes do not measure the errors of a detector.
    """
    results = view_store.read_results(connection, campaign.id)
    space = read.plan.problem.space
    drives = []
    for place, number in enumerate(read.archive.numbers.tolist()):
        text = results.get(number)
        features = (json.loads(text).get("features") or {}) if text else {}
        measures = features.get(MEASURES)
        if not isinstance(measures, dict):
            continue
        row = read.archive.vectors[place]
        values = {
            f"{component}.{name}": value
            for component, parameters in space.decode(space.split(row)).items()
            for name, value in parameters.items()
        }
        condition = layout.condition_of(values)
        if condition is not None:
            drives.append(
                Drive(
                    name=str(number),
                    condition=condition,
                    measures=measures,
                    unsafe=bool(read.archive.unsafe[place]),
                )
            )
    if not drives:
        raise InvalidInput.at(
            "/query/episodes",
            f"campaign {campaign.id}: expected drives with a detector in the loop under the conditions of the "
            "requirement, such as those of urban-camera@1; found none (drives of earlier versions were measured in "
            "another way: simulate them again, with cache: false)",
        )
    return drives
