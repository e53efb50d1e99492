"""Response schemas of thresholds: where along one unit the probability of a violation passes from 20 to 80%."""

from typing import Annotated

from pydantic import Field

from brink.search.analysis.confirmation import Confirmation
from brink.search.conclusions import Outcome
from brink.server.findings.follow_ups import ShareView
from brink.server.findings.pairs.views import ComponentPart
from brink.server.states import CampaignStatus
from brink.server.views import View


class EndView(View):
    """A simulated drive at one end of the stretch."""

    number: int
    value: Annotated[float, Field(description="In the unit of the threshold.")]
    outcome: Annotated[str, Field(description="What it showed, in words, with moments.")]
    again: Annotated[ShareView, Field(description="How often it was unsafe with other seeds afterwards.")]


class TightPairView(View):
    """Simulated drives on either side of a stretch: the safe one below 20%, the unsafe one above 80%."""

    safe: EndView
    unsafe: EndView
    width: Annotated[float, Field(description="Distance of the two, in the unit of the threshold.")]
    tight: Annotated[
        bool,
        Field(
            description="Whether there is a threshold, and that is at most its stretch plus two resolutions."
        ),
    ]
    confirmation: Annotated[
        Confirmation,
        Field(description="Whether both keep their verdicts with other seeds; as for pairs, error rate 5%."),
    ]


class DotView(View):
    """The simulations at one place of a line that had a seed of their own."""

    value: float
    drives: int
    unsafe: int


class CurveView(View):
    """How likely a violation is along the unit, as one list per column."""

    value: list[float]
    share: Annotated[list[float], Field(description="Posterior median.")]
    low: Annotated[list[float], Field(description="Lower end of the 90% interval.")]
    high: list[float]


class ThresholdView(View):
    """A line of solutions that differ in one unit alone, and where it turns; values are in its unit."""

    place: Annotated[int, Field(description="Its position in the list, from 1.")]
    outcome: Annotated[
        Outcome,
        Field(
            description="threshold: the probability passes from 20 to 80% within a fifth of the range. chancy: it "
            "does not. open: more simulations would tell."
        ),
    ]
    words: Annotated[str, Field(description="The change and what it does, in a sentence.")]
    change: Annotated[str, Field(description="What changes from the 20% to the 80% point, in words.")]
    turns: Annotated[
        str,
        Field(
            description="The 50% point with its interval, such as `1.4 s [1.3, 1.6]`, or between which values it "
            "turns."
        ),
    ]
    within: Annotated[str, Field(description="The stretch from 20 to 80% in words, such as `0.2 s (2%)`.")]
    rule: Annotated[
        str,
        Field(
            description="The resulting rule in words, such as `unsafe with a probability of at least 80% from "
            "1.5 s [1.4, 1.6] up to 8.0 s`."
        ),
    ]
    held: Annotated[
        str,
        Field(
            description="What is held: what both ends have in common, in words, with … in place of what changes."
        ),
    ]
    fails: Annotated[str, Field(description="How the unsafe end fails, in words, without moments.")]
    requirements: list[str]
    kind: Annotated[
        list[str],
        Field(
            description="What tells its kind: parameter, type of the error, target, road, and how it fails."
        ),
    ]
    names: Annotated[list[str], Field(description="The parameters that move, as component.parameter.")]
    parameter: Annotated[str, Field(description="The one that is reported, in words.")]
    unit: Annotated[str, Field(description="Its unit; empty for a plain number.")]
    decimals: Annotated[int, Field(description="Decimal places that its resolution asks for.")]
    log: Annotated[
        bool,
        Field(
            description="Whether the scale is logarithmic; `resolution`, `range`, `stretch` and `width` are factors "
            "then."
        ),
    ]
    resolution: Annotated[float, Field(description="What people would call the same.")]
    states_resolution: Annotated[
        bool, Field(description="Whether the problem states the resolution; it is 1% of the range otherwise.")
    ]
    range: Annotated[float, Field(description="Range of the parameter, in the unit.")]
    middle: Annotated[float | None, Field(description="Value at 50%; null if it is beyond the line.")]
    low: Annotated[float | None, Field(description="Smaller end of its 90% interval; null beyond the line.")]
    high: Annotated[float | None, Field(description="Larger end of it; null beyond the line.")]
    at_20: Annotated[float | None, Field(description="Value at 20%; null beyond the line.")]
    at_80: Annotated[float | None, Field(description="Value at 80%; null beyond the line.")]
    stretch: Annotated[
        float | None, Field(description="Distance of these two; null if one is beyond the line.")
    ]
    rises: Annotated[bool, Field(description="Whether larger values are the unsafe ones.")]
    safe_again: Annotated[
        float | None,
        Field(
            description="Value from which drives further on are no longer unsafe (a window); null if none are."
        ),
    ]
    window: Annotated[
        str, Field(description="The same in words, or that one drive further on is safe again; else empty.")
    ]
    chancy: Annotated[float, Field(description="Probability that there is no threshold.")]
    drives: Annotated[int, Field(description="Simulations that it rests on, each with a seed of its own.")]
    blame: Annotated[
        ComponentPart,
        Field(
            description="Whether the component or the scenario is to blame for the unsafe end, if that was tried."
        ),
    ]
    blame_words: Annotated[str, Field(description="The same in words; empty where nothing can tell.")]
    truth: Annotated[
        str, Field(description="What the unsafe end shows with ground truth, in words; empty if not tried.")
    ]
    pair: Annotated[
        TightPairView | None, Field(description="Drives at both ends; null if there is none on a side.")
    ]
    dots: list[DotView]
    curve: CurveView


class ThresholdsView(View):
    """The thresholds of a campaign."""

    campaign: str
    name: str
    status: CampaignStatus
    sentence: str
    note: Annotated[
        str,
        Field(
            description="Where there is no threshold: what was tried, and what that leaves open; else empty."
        ),
    ]
    confidence: Annotated[float, Field(description="Confidence of all intervals.")]
    replayable: Annotated[
        bool, Field(description="Whether drives are recorded, so that both ends can be filmed.")
    ]
    computed: Annotated[
        bool,
        Field(
            description="Whether verdicts are deterministic, so that a threshold lies between two solutions and "
            "nothing is estimated."
        ),
    ]
    has_component: Annotated[bool, Field(description="Whether ground truth can replace a component.")]
    kinds: Annotated[int, Field(description="Different kinds among the thresholds.")]
    left_out: Annotated[int, Field(description="Lines that were not estimated, because there are too many.")]
    thresholds: Annotated[
        list[ThresholdView],
        Field(
            description="Thresholds first, the narrowest stretch first; then open lines, then chancy ones."
        ),
    ]
