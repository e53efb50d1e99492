"""Response schemas of tolerances: how severe an error may be before it makes too many drives violate."""

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from brink.server.findings.follow_ups import ShareView
from brink.server.findings.table import Table
from brink.server.states import CampaignStatus, CheckResult
from brink.server.views import View


class Tolerated(StrEnum):
    """How severe an error may be."""

    LIMIT = "limit"
    """Up to a limit, at which too many drives violate."""
    THROUGHOUT = "throughout"
    """However severe it is: the limit is not within the scale."""
    UNDECIDED = "undecided"
    """The limit may or may not be within the scale."""


class Amount(View):
    """A severity and its magnitude; both are null beyond the scale."""

    severity: float | None
    magnitude: Annotated[float | None, Field(description="In the unit of the cell; null without one, too.")]


class ToleratedView(View):
    """The severity at which the share of caused violations reaches the limit, with its interval."""

    finding: Tolerated
    value: Amount
    low: Annotated[Amount, Field(description="Lower end; above it, the limit may be exceeded.")]
    high: Amount


class CurveView(View):
    """The share of drives with a violation that the error caused, by severity, as one list per column."""

    severity: list[float]
    magnitude: Annotated[list[float] | None, Field(description="In the unit of the cell.")]
    share: Annotated[list[float], Field(description="Median.")]
    low: list[float]
    high: list[float]
    drives: Annotated[list[int], Field(description="Simulated drives with the error.")]
    caused: Annotated[list[int], Field(description="Drives with a violation that the error caused.")]


class FallView(View):
    """A range of severities over which a larger error is safer."""

    from_severity: float
    to_severity: float
    from_share: float
    to_share: float
    words: str


class ExampleView(View):
    """A drive with a violation that the error caused."""

    number: int
    severity: float
    magnitude: float | None


class CellView(View):
    """One cell: a combination of choices under a condition."""

    place: Annotated[int, Field(description="Its position in the list, from 1.")]
    choices: dict[str, str]
    condition: str
    error: Annotated[
        str, Field(description="The error as an activity of the component, without its magnitude.")
    ]
    words: Annotated[str, Field(description="The error as an activity of the component, with its magnitude.")]
    sentence: Annotated[str, Field(description="The resulting requirement, with its evidence.")]
    basis: Annotated[
        str, Field(description="Number of drives it is based on, in words; empty if there are none.")
    ]
    unit: Annotated[str, Field(description="Unit of magnitudes; empty for none.")]
    decimals: Annotated[int, Field(description="Decimal places of magnitudes that matter.")]
    meaning: str
    drives: Annotated[int, Field(description="Drives with the error; of screened cells, vulnerable ones.")]
    caused: Annotated[int, Field(description="Drives with a violation that the error caused.")]
    screened: Annotated[
        int, Field(description="Drives that were screened with the most severe error; 0 for none.")
    ]
    vulnerable: Annotated[
        int, Field(description="Screened drives with a violation that the most severe error caused.")
    ]
    tolerated: ToleratedView
    tolerated_words: Annotated[
        str, Field(description="The tolerated magnitude with its interval, such as `2.2 s [1.4, 2.8]`.")
    ] = ""
    curve: CurveView
    fall: FallView | None
    examples: Annotated[list[ExampleView], Field(description="Mildest errors that caused a violation first.")]


class BaselineView(View):
    """How often drives violate a requirement without any error."""

    condition: str
    choices: Annotated[
        list[dict[str, str]],
        Field(description="Cells that it belongs to, by those of their choices that matter."),
    ]
    share: ShareView


class ToleranceView(View):
    """The tolerances of a campaign."""

    campaign: str
    name: str
    status: CampaignStatus
    complete: Annotated[bool, Field(description="Whether the campaign has ended.")]
    requirements: list[str]
    limit: float
    confidence: float
    note: str
    caveat: Annotated[str, Field(description="What the tolerances do not cover.")]
    simulations: Annotated[
        int, Field(description="Simulations with a verdict, those without an error included.")
    ]
    open: Annotated[
        int, Field(description="Violations of which it is not known whether the error caused them.")
    ]
    mean_width: Annotated[float, Field(description="Mean width of the intervals, as a share of the scale.")]
    conditions: list[str]
    baseline: list[BaselineView]
    audited: Annotated[
        int,
        Field(
            description="Drives simulated with a milder error although they hold with the most severe one."
        ),
    ]
    leaks: Annotated[int, Field(description="Audited drives that violated nevertheless.")]
    cells: list[CellView]


class DetectorCell(View):
    """A detector's errors in one cell."""

    choices: dict[str, str]
    error: str
    condition: str
    result: CheckResult
    drives: Annotated[
        int,
        Field(description="Drives of the detector under the condition that show how severe this error is."),
    ]
    needed: Annotated[
        int | None,
        Field(
            description="Drives with such errors that would decide, or without errors if there are none yet; null if "
            "more drives would not, or if it is decided."
        ),
    ]
    at_least: Annotated[
        int,
        Field(description="Drives whose error was cut off by the recording, so that it is a lower bound."),
    ]
    typical: Annotated[float | None, Field(description="Median magnitude, in the unit of the cell.")]
    grossest: Annotated[float | None, Field(description="Magnitude that 5% of the drives exceed.")]
    unit: str
    beyond: Annotated[int, Field(description="Drives with a more severe error than is tolerated.")]
    share: Annotated[float | None, Field(description="Share of drives that such errors make violate.")]
    low: float | None
    high: float | None
    worst: Annotated[list[str], Field(description="Drives with the most severe errors, worst first.")]
    sentence: Annotated[str, Field(description="The result with its basis.")]


class DetectorConditionView(View):
    """The detector's drives under one condition."""

    condition: str
    drives: int
    violations: Annotated[
        int | None, Field(description="Drives that violated a requirement; null if unknown.")
    ]


class DetectorView(View):
    """Whether a detector meets the requirement of a campaign."""

    campaign: str
    detector: str
    limit: float
    confidence: float
    note: str
    meaning: Annotated[str, Field(description="The meaning of *met*, and its basis.")]
    no_data: Annotated[str, Field(description="Cells without informative drives; empty for none.")]
    next: Annotated[list[str], Field(description="What to record next to decide more, in sentences.")]
    conditions: list[DetectorConditionView]
    cells: Annotated[
        list[DetectorCell], Field(description="Cells that are not met first, cells without data last.")
    ]


class AgreementCell(View):
    """The evidence of fresh drives on one cell."""

    place: Annotated[int, Field(description="Its position in the list of cells, from 1.")]
    choices: dict[str, str]
    error: str
    condition: str
    drives: Annotated[int, Field(description="Fresh drives with the error.")]
    caused: Annotated[int, Field(description="Fresh drives with a violation that the error caused.")]
    low: Annotated[int, Field(description="Lower end of the prediction interval of that number.")]
    high: int
    agrees: Annotated[
        bool | None, Field(description="Whether it lies in that interval; null without fresh drives.")
    ]


class AgreementView(View):
    """Whether the drives of another campaign agree with the predictions of a campaign's tolerances."""

    campaign: str
    fresh: str
    confidence: float
    drives: int
    agreeing: Annotated[int, Field(description="Cells whose number lies in its interval.")]
    note: str
    cells: list[AgreementCell]
    table: Annotated[Table, Field(description="The cells as a table.")]
