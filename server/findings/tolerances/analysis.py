"""The tolerances of a campaign in words and units."""

import math
from collections.abc import Mapping

from brink.search.analysis.confirmation import Share
from brink.search.curves import Curve, Screening, severities
from brink.search.odd import with_odd
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.detector_check import CellCheck
from brink.server.campaigns.plan import Plan
from brink.server.campaigns.store import Campaign
from brink.server.campaigns.tolerance import CampaignTolerance
from brink.server.findings.follow_ups import ShareView
from brink.server.findings.sources import Sources
from brink.server.findings.tolerances.views import (
    Amount,
    BaselineView,
    CellView,
    CurveView,
    ExampleView,
    FallView,
    ToleranceView,
    Tolerated,
    ToleratedView,
)
from brink.server.findings.words import as_sentence
from brink.server.problems.base import Problem, SeverityScale
from brink.server.states import ENDED
from brink.sim.verdict import drives_violate

_NEARLY_ALL = 0.95
"""Severity from which the end of the scale is not told apart."""


EXAMPLES = 5
"""Maximum number of violations listed for a cell."""


BASELINE_CONFIDENCE = 0.95
"""Confidence of the intervals of shares without any error."""


async def find_tolerance(sources: Sources, campaign: Campaign, read: ReadArchive) -> ToleranceView:
    """Return the tolerances of a campaign for people and programs.

    Args:
        sources: Where findings are read from.
        campaign: The campaign.
        read: Its archive.
    """
    found = await sources.tolerances.get(campaign, read)
    return await sources.pages.run(lambda: tolerance_view(campaign, read.plan, found))


def tolerance_view(campaign: Campaign, plan: Plan, found: CampaignTolerance) -> ToleranceView:
    """Return the tolerances of a campaign as the API returns them.

    Args:
        campaign: The campaign.
        plan: Its plan.
        found: Its tolerances.
    """
    problem = plan.problem
    requirements = list(problem.requirements)
    layout, config = found.layout, found.config
    examples: dict[int, list[tuple[int, int]]] = {}
    for at, level, number in found.tally.caused:
        examples.setdefault(at, []).append((level, number))
    cells = []
    for place, (cell, curve) in enumerate(zip(layout.cells, found.curves, strict=True)):
        choices = dict(zip(layout.names, cell.choices, strict=True))
        words = CellWords(problem, choices, requirements, config.limit)
        screening = None if cell.group is None else found.tally.screenings[cell.group]
        basis = _basis(curve, screening)
        cells.append(
            CellView(
                place=place + 1,
                choices=choices,
                condition=cell.condition,
                error=error_words(problem, choices),
                words=words.activity(curve),
                sentence=words.sentence(cell.condition, curve, basis),
                basis=basis,
                unit=words.scale.unit if words.scale else "",
                decimals=words.scale.decimals if words.scale else 2,
                meaning=words.scale.meaning if words.scale else "severity of the error",
                drives=int(curve.drives.sum()),
                caused=int(curve.caused.sum()),
                screened=0 if screening is None else screening.screened,
                vulnerable=0 if screening is None else screening.vulnerable,
                tolerated=words.tolerated(curve, basis),
                tolerated_words=words.tolerated_words(curve, basis),
                curve=words.curve(curve),
                fall=words.fall(curve),
                examples=[
                    ExampleView(
                        number=number,
                        severity=level / len(curve.drives),
                        magnitude=words.magnitude(level / len(curve.drives)),
                    )
                    for level, number in examples.get(place, ())[:EXAMPLES]
                ],
            )
        )
    drives = sum(cell.drives for cell in cells)
    return ToleranceView(
        campaign=campaign.id,
        name=campaign.body.name,
        status=campaign.status,
        complete=campaign.status in ENDED,
        requirements=requirements,
        limit=config.limit,
        confidence=config.confidence,
        simulations=campaign.evaluated,
        open=len(found.tally.open_numbers),
        note=_note(cells, drives, config.limit),
        caveat=with_odd(_caveat(cells, config.limit), plan.problem.space),
        conditions=list(layout.conditions),
        baseline=_baselines(found),
        cells=cells,
        mean_width=sum(curve.tolerated.width for curve in found.curves) / len(found.curves),
        audited=sum(one.audited for one in found.tally.screenings),
        leaks=sum(one.leaked for one in found.tally.screenings),
    )


def _note(cells: list[CellView], drives: int, limit: float) -> str:
    findings = [cell.tolerated.finding for cell in cells]
    reached, never = findings.count(Tolerated.LIMIT), findings.count(Tolerated.THROUGHOUT)
    if not any(cell.basis for cell in cells):
        return f"no drive with an error has been simulated yet; {len(cells)} cells are to be measured"
    return (
        f"of {len(cells)} cells, {reached} reach the limit of {limit:.0%} of drives at some magnitude, {never} at "
        f"none, {len(cells) - reached - never} undecided; {drives:,} drives with an error"
    )


def _caveat(cells: list[CellView], limit: float) -> str:
    about = "All of this is about one error at a time, in these scenarios, with this driving system."
    without = [cell for cell in cells if cell.basis and cell.tolerated.finding is Tolerated.THROUGHOUT]
    if not without:
        return about
    more = ""
    if shares := [cell.vulnerable / cell.screened for cell in without if cell.screened]:
        low, high = f"{min(shares):.0%}", f"{max(shares):.0%}"
        more = (
            f" The most severe error concerning the same road users makes "
            f"{low if low == high else f'{low} to {high}'} of drives violate."
        )
    return (
        f"{about} An error for which no limit was found is not harmless: it may make up to {limit:.0%} of drives "
        f"violate, and more in other scenarios or together with other errors.{more}"
    )


def _basis(curve: Curve, screening: Screening | None) -> str:
    """Return how many drives the tolerance of a cell is based on; empty if there are none."""
    drives, caused = int(curve.drives.sum()), int(curve.caused.sum())
    if screening is None:
        return f"such errors did so in {caused} of {drives} drives" if drives else ""
    if not screening.screened:
        return ""
    vulnerable = f"{screening.vulnerable} of {screening.screened} drives are vulnerable"
    return (
        f"such errors did so in {caused} of {drives} vulnerable drives; {vulnerable}"
        if drives
        else vulnerable
    )


def _baselines(found: CampaignTolerance) -> list[BaselineView]:
    layout = found.layout
    views = []
    for population, (violating, drives) in enumerate(found.tally.baseline):
        members = [cell for cell in layout.cells if cell.population == population]
        others = [
            cell
            for cell in layout.cells
            if cell.condition == members[0].condition and cell.population != population
        ]
        kept = [
            place
            for place, _ in enumerate(layout.names)
            if others and {c.choices[place] for c in members}.isdisjoint(c.choices[place] for c in others)
        ]
        choices = {tuple((layout.names[place], cell.choices[place]) for place in kept) for cell in members}
        views.append(
            BaselineView(
                condition=members[0].condition,
                choices=[dict(one) for one in sorted(choices)],
                share=ShareView.model_validate(
                    Share.of(violating, drives, confidence=BASELINE_CONFIDENCE), from_attributes=True
                ),
            )
        )
    return views


def error_words(problem: Problem, choices: Mapping[str, str]) -> str:
    """Return the error of a cell without its magnitude, such as ``not reporting the lead for …``."""
    if problem.severity_scale(choices) is not None:
        return problem.error_words(choices, "…")
    return ", ".join(choice.replace("_", " ") for choice in choices.values()) or "the error"


class CellWords:
    """Describes the estimates of a cell in words and units."""

    def __init__(
        self, problem: Problem, choices: Mapping[str, str], requirements: list[str], limit: float
    ) -> None:
        self._problem = problem
        self._choices = choices
        self._requirements = requirements
        self._limit = limit
        self.scale: SeverityScale | None = problem.severity_scale(choices)

    def magnitude(self, severity: float) -> float | None:
        """Return the magnitude of a severity; None without a scale."""
        return None if self.scale is None else self.scale.at(severity)

    def tolerated(self, curve: Curve, basis: str) -> ToleratedView:
        """Return the severity at which the limit is reached, with its interval."""
        value, low, high = (self._amount(one) for one in _ends(curve))
        return ToleratedView(finding=_finding(curve, basis), value=value, low=low, high=high)

    def tolerated_words(self, curve: Curve, basis: str) -> str:
        """Return the same in words, such as ``2.2 s [1.4, 2.8]`` or ``no limit to 8.0 s``."""
        value, low, high = _ends(curve)
        finding = _finding(curve, basis)
        if not basis:
            return "unknown"
        if finding is Tolerated.THROUGHOUT:
            return f"no limit to {self._number(1.0, unit=True)}"
        probably = "probably " if finding is Tolerated.UNDECIDED else ""
        number = "any" if math.isinf(value) else self._number(value, unit=True)
        return f"{probably}{number} [{self._range(low, high)}]"

    def _amount(self, severity: float) -> Amount:
        if math.isinf(severity):
            return Amount(severity=None, magnitude=None)
        return Amount(severity=severity, magnitude=self.magnitude(severity))

    def curve(self, curve: Curve) -> CurveView:
        """Return the share of drives with a caused violation by severity."""
        grid = severities().tolist()
        return CurveView(
            severity=grid,
            magnitude=None if self.scale is None else [self.scale.at(one) for one in grid],
            share=curve.median.tolist(),
            low=curve.low.tolist(),
            high=curve.high.tolist(),
            drives=[0, *curve.drives.tolist()],
            caused=[0, *curve.caused.tolist()],
        )

    def activity(self, curve: Curve) -> str:
        """Return the error with the magnitude at which the limit is reached, or with the largest one."""
        value, low, high = _ends(curve)
        if math.isinf(value):
            return self._activity(self._number(1.0, unit=True))
        if low == high:
            return self._activity(self._number(value, unit=True))
        return self._activity(f"{self._number(value, unit=True)} [{self._range(low, high)}]")

    def _activity(self, magnitude: str) -> str:
        if self.scale is None:
            choices = ", ".join(self._choices.values())
            return f"{choices} at severity {magnitude}".lstrip()
        return self._problem.error_words(self._choices, magnitude)

    def _range(self, low: float, high: float) -> str:
        ends = sorted((low, high), key=lambda one: self.magnitude(min(one, 1.0)) or min(one, 1.0))
        texts = ["beyond" if math.isinf(one) else self._number(one) for one in ends]
        return ", ".join(texts)

    def _number(self, severity: float, *, unit: bool = False) -> str:
        if self.scale is None:
            return f"{severity:.2f}"
        return self.scale.words(severity) if unit else self.scale.number(severity)

    def sentence(self, condition: str, curve: Curve, basis: str) -> str:
        """Return the requirement that follows from a cell, with its interval.

        Args:
            condition: Its condition.
            curve: Its curve.
            basis: How many drives it rests on; empty if there are none.
        """
        share = f"{self._limit:.0%}"
        violated = drives_violate(self._requirements)
        activity = self.activity(curve)
        match _finding(curve, basis):
            case Tolerated.LIMIT:
                words = f"{activity} makes {share} of drives {violated}"
            case Tolerated.THROUGHOUT:
                words = f"{activity} makes fewer than {share} of drives {violated}"
            case Tolerated.UNDECIDED if not basis:
                words = f"{self._activity('any magnitude')}: nothing is known yet"
            case Tolerated.UNDECIDED if math.isinf(curve.tolerated.value):
                words = f"{activity} probably makes fewer than {share} of drives {violated}"
                if curve.tolerated.low < _NEARLY_ALL:
                    low = self._number(curve.tolerated.low, unit=True)
                    words += f", but {self._activity(low)} may already make that many"
            case Tolerated.UNDECIDED:
                words = f"{activity} probably makes {share} of drives {violated}, or no magnitude does"
        return f"{as_sentence(condition)}: {words}{f' ({basis})' if basis else ''}."

    @property
    def error(self) -> str:
        """The error without its magnitude."""
        return error_words(self._problem, self._choices)

    def checked(self, check: CellCheck, middle: float | None) -> str:
        """Return whether a detector meets the requirement of a cell, with the evidence.

        Args:
            check: The detector's errors.
            middle: Median of their severities; None without any.
        """
        start = f"{as_sentence(check.condition)}: {self.error}: {check.result.value}"
        if check.share is None or middle is None:
            return f"{start}: there are no informative drives."
        drives, at_least = len(check.severity), " at least" if check.bounds else ""
        share = check.share
        words = (
            f"in {drives:,} {'drive' if drives == 1 else 'drives'} the worst such error has a median of{at_least} "
            f"{self._number(middle, unit=True)}; {share.value:.1%} [{100 * share.low:.1f}, {100 * share.high:.1f}] "
            f"of drives with such errors {drives_violate(self._requirements)}, {self._limit:.0%} are allowed"
        )
        return f"{start}: {words}."

    def fall(self, curve: Curve) -> FallView | None:
        """Return the range over which a larger error is safer; None if there is none."""
        fall = curve.fall
        if fall is None:
            return None
        words = (
            f"a larger error is safer from {self._number(fall.from_severity, unit=True)} on: "
            f"{fall.from_share:.0%} of "
            f"drives violate because of it there, {fall.to_share:.0%} at {self._number(fall.to_severity, unit=True)}"
        )
        return FallView(
            from_severity=fall.from_severity,
            to_severity=fall.to_severity,
            from_share=fall.from_share,
            to_share=fall.to_share,
            words=words,
        )


def _ends(curve: Curve) -> tuple[float, float, float]:
    return curve.tolerated.value, curve.tolerated.low, curve.tolerated.high


def _finding(curve: Curve, basis: str) -> Tolerated:
    """Return the estimate for a cell; undecided before the first drive, whatever the prior."""
    if not basis:
        return Tolerated.UNDECIDED
    if math.isinf(curve.tolerated.low):
        return Tolerated.THROUGHOUT
    return Tolerated.UNDECIDED if math.isinf(curve.tolerated.high) else Tolerated.LIMIT
