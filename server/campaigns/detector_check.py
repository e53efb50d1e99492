"""Whether a detector meets the requirement of a campaign, judged by its errors in drives of its own."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from sqlalchemy import Connection

from brink.search.algorithms.tolerance import Layout
from brink.search.curves import LEAST_DRIVES, Interval, expected_share
from brink.search.space import FloatArray
from brink.search.streams import Stream, generator
from brink.server.campaigns import view_store
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.store import Campaign
from brink.server.campaigns.tolerance import CampaignTolerance
from brink.server.errors import InvalidInput
from brink.server.problems.base import RatesMeasuredErrors
from brink.sim.urban.error_meter import MEASURES

MOST_DRIVES = 10_000
WORST = 5
"""Most drives listed as the worst of a cell."""


class CheckResult(StrEnum):
    """Whether a detector meets a requirement."""

    MET = "met"
    NOT_MET = "not met"
    TOO_LITTLE = "not enough data"
    NOT_MEASURED = "not measured"


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """The errors of a detector in one drive.

    Attributes:
        name: Name of the drive, such as the number of its solution.
        condition: Name of its condition; None if it belongs to any.
        measures: Magnitude of each type of error, by target.
        unsafe: Whether it violated the requirement; None if that is unknown.
    """

    name: str
    condition: str | None
    measures: Mapping[str, Mapping[str, float]]
    unsafe: bool | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class CellCheck:
    """A detector's errors of one cell.

    Attributes:
        cell: Place of the cell in the layout.
        drives: Drives of the detector under the cell's condition.
        severity: How gross the error was in each, shape ``(drives,)``.
        share: Share of drives with a violation that such errors cause; None without drives.
        beyond: Drives with a grosser error than is tolerated.
        result: Whether the detector meets the requirement.
        worst: Names of the drives with the grossest errors, grossest first.
    """

    cell: int
    drives: int
    severity: FloatArray
    share: Interval | None
    beyond: int
    result: CheckResult
    worst: tuple[str, ...]


def check_detector(
    found: CampaignTolerance, problem: object, drives: Sequence[Drive], seed: int
) -> list[CellCheck]:
    """Judge a detector by each cell of a campaign.

    Args:
        found: The tolerances of the campaign.
        problem: Its problem.
        drives: The detector's drives.
        seed: Seed of the bootstrap.

    Raises:
        InvalidInput: The problem does not know measured errors, or a condition is none of the campaign's.
    """
    if not isinstance(problem, RatesMeasuredErrors):
        raise InvalidInput.at(
            "/path/campaign_id", "the problem of this campaign does not know measured errors"
        )
    conditions = found.layout.conditions
    for drive in drives:
        if drive.condition is not None and drive.condition not in conditions:
            raise InvalidInput.at(
                "/drives",
                f"drive {drive.name}: expected one of the conditions {'; '.join(conditions)}; got "
                f"{drive.condition!r}",
            )
    return [_checked(found, problem, place, drives, seed) for place in range(len(found.layout.cells))]


def _checked(
    found: CampaignTolerance, problem: RatesMeasuredErrors, place: int, drives: Sequence[Drive], seed: int
) -> CellCheck:
    cell, curve = found.layout.cells[place], found.curves[place]
    choices = dict(zip(found.layout.names, cell.choices, strict=True))
    here = [drive for drive in drives if drive.condition in (None, cell.condition)]
    rated = [(problem.measured_severity(choices, drive.measures), drive.name) for drive in here]
    known = [(severity, name) for severity, name in rated if severity is not None]
    if here and not known:
        return CellCheck(
            cell=place, drives=0, severity=np.zeros(0), share=None, beyond=0, result=CheckResult.NOT_MEASURED,
            worst=(),
        )  # fmt: skip
    concerned = sum(bool(drive.measures) for drive in here)
    severity = np.array([one for one, _ in known])
    share = None
    if known:
        rng = generator(seed, Stream.TOLERANCE, 4, place)
        share = expected_share(curve, severity, rng, found.config.confidence)
    result = CheckResult.TOO_LITTLE
    if share is not None and min(len(known), concerned) >= LEAST_DRIVES:
        if share.high <= found.config.limit:
            result = CheckResult.MET
        elif share.low > found.config.limit:
            result = CheckResult.NOT_MET
    worst = sorted((one for one in known if one[0] > 0.0), key=lambda one: -one[0])
    tolerated = curve.tolerated.value
    return CellCheck(
        cell=place,
        drives=len(known),
        severity=severity,
        share=share,
        beyond=0 if math.isinf(tolerated) else int((severity > tolerated).sum()),
        result=result,
        worst=tuple(name for _, name in worst[:WORST]),
    )


def read_drives(connection: Connection, campaign: Campaign, read: ReadArchive, layout: Layout) -> list[Drive]:
    """Return the drives of a campaign with a camera and a detector in the loop.

    Args:
        connection: Read connection.
        campaign: The campaign.
        read: Its archive.
        layout: The cells that the drives are held against, which say what their conditions are.

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
                    name=str(number), condition=condition, measures=measures,
                    unsafe=bool(read.archive.unsafe[place]),
                )
            )  # fmt: skip
    if not drives:
        raise InvalidInput.at(
            "/query/episodes",
            f"campaign {campaign.id}: expected drives with a detector in the loop under the conditions of the "
            "requirement, such as those of urban-camera@1; found none",
        )
    return drives
