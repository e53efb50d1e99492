"""The rate of unsafe solutions as a kind of finding."""

from typing import Annotated, Any, Final

from pydantic import Field

from brink.search.algorithm import EstimatesRate
from brink.search.algorithms.rate import RateConfig
from brink.server.findings.finding import Finding, Role, Step, Term
from brink.server.findings.kind import Kind, Listed, Settings, Subject
from brink.server.findings.rate.analysis import default_strata, find_rate, interval_words
from brink.server.findings.rate.views import RateView
from brink.server.findings.table import Column, Format, Table
from brink.server.findings.words import percent, rounded
from brink.server.states import OutcomeKind

CONFIDENCE: Final = 0.95
COLUMNS: Final = [
    Column(name="what", title="what"),
    Column(name="value", title="rate", format=Format.NUMBER, optional=True),
    Column(name="low", title="from", format=Format.NUMBER, optional=True),
    Column(name="high", title="to", format=Format.NUMBER, optional=True),
    Column(name="unit", title="unit"),
    Column(name="interval", title="interval"),
]
STRATA: Final = [
    Column(name="stratum", title="where"),
    Column(name="rate", title="rate", format=Format.SHARE, optional=True),
    Column(name="low", title="from", format=Format.SHARE, optional=True),
    Column(name="high", title="to", format=Format.SHARE, optional=True),
    Column(name="share", title="share of operation", format=Format.SHARE),
    Column(name="part", title="share of the unsafe", format=Format.SHARE, optional=True),
    Column(name="unsafe", title="unsafe", format=Format.COUNT),
    Column(name="simulations", title="simulated", format=Format.COUNT),
]
LOOKS: Final = [
    Column(name="simulations", title="simulations", format=Format.COUNT),
    Column(name="rate", title="rate", format=Format.SHARE),
    Column(name="low", title="from", format=Format.SHARE),
    Column(name="high", title="to", format=Format.SHARE),
]
ANY_LOOK: Final = "at every look"
FIXED: Final = "fixed number"
LEGEND: Final = [
    "At every look: the interval contains the rate with its confidence however often one looks and whenever one "
    "stops. Fixed number: it does so only if the number of simulations did not depend on results",
    "Rates in parts of operation, per kilometre and per hour have intervals for a fixed number of simulations",
]


class RateSettings(Settings):
    """How a rate is shown."""

    confidence: Annotated[
        float | None, Field(gt=0, lt=1, description="Confidence; by default that of the claim, or 0.95.")
    ] = None
    at_most: Annotated[
        float | None, Field(gt=0, lt=1, description="A claim to check; by default the campaign's.")
    ] = None
    by: Annotated[
        str,
        Field(
            max_length=1_000,
            description="Categories whose choices are told apart, separated by commas; + crosses them. By default "
            "those of the distribution.",
        ),
    ] = ""


class RateKind(Kind):
    """How often solutions are unsafe in operation."""

    id = "rate"
    title = "Rate in operation"
    rank = 20
    settings = RateSettings

    def fits(self, plan: Any) -> bool:
        """Return whether the algorithm's simulations are draws from operation."""
        return isinstance(plan.algorithm, EstimatesRate)

    async def find(self, subject: Subject) -> Finding:
        """Return the rate with its intervals, the claim, and the rates in parts of operation."""
        sources, campaign = subject.sources, subject.campaign
        outcomes = await sources.outcomes.get(campaign.id, subject.read)
        violate = outcomes.kind_words(OutcomeKind.VIOLATED) if outcomes.requirements else "are unsafe"
        view = await sources.analyses.run(lambda: self._view(subject))
        return self._finding(subject, view, violate)

    def _view(self, subject: Subject) -> RateView | None:
        asked, config, space = subject.settings, subject.plan.config, subject.plan.problem.space
        own = config.claim if isinstance(config, RateConfig) else {}
        confidence = asked.confidence or own.get("confidence", CONFIDENCE)
        limit = asked.at_most or own.get("at_most")
        declared = [] if space.distribution is None else list(space.distribution.describe())
        return find_rate(
            subject.sources.engines,
            subject.plan,
            subject.campaign.id,
            claim=None if limit is None else (limit, confidence),
            confidence=confidence,
            by=asked.by or default_strata(space, declared),
        )

    def _finding(self, subject: Subject, view: RateView | None, violate: str) -> Finding:
        if view is None:
            return Finding(
                kind=self.id,
                title=self.title,
                role=subject.role,
                sentence="no draws from operation yet",
                is_empty=True,
            )
        noun = subject.noun
        drawn = "the stated distribution" if view.is_stated else "all values equally likely"
        claim = [] if view.claim is None else [view.claim.words]
        return Finding(
            kind=self.id,
            title=self.title,
            role=subject.role,
            sentence=f"{interval_words(view.rate)} of simulated {noun}s {violate}, with {drawn}",
            more=[*claim, *_fitted_words(view), *_exposure_words(view, noun), *_strata_words(view)],
            purpose=f"Brink estimated how often {noun}s from the operational domain {violate}.",
            figures=[
                Term(term=interval_words(view.rate), words=f"of {noun}s {violate}"),
                Term(
                    term=f"{view.unsafe:,} of {view.simulations:,}",
                    words="simulations unsafe, before weighting",
                ),
            ],
            caveats=_caveats(view, noun),
            legend=LEGEND,
            view=view,
            tables=[
                _rates_table(view, noun),
                _strata_table(view, subject.rows),
                _looks_table(view, subject.rows),
            ],
            steps=_steps(subject, view),
        )

    def leads_to(self, subject: Subject) -> list[Step]:
        """Return the step that shows the rate, if the simulations of a search for something else are draws."""
        return [_by_condition(subject)] if self.fits(subject.plan) else []

    def brief(self, listed: Listed) -> str:
        """Return the share of unsafe simulations; the weighted rate takes longer."""
        return f"{listed.campaign.unsafe:,} unsafe"


def _fitted_words(view: RateView) -> list[str]:
    if view.fitted is None:
        return []
    return [
        f"with the uncertainty of the fit, from {view.replicates} replicates: {interval_words(view.fitted)}"
    ]


def _exposure_words(view: RateView, noun: str) -> list[str]:
    found = []
    for ratio, unit in ((view.per_1000_km, "per 1,000 km"), (view.per_hour, "per hour of driving")):
        if ratio is not None:
            low, high = rounded(ratio.low, outward=-1), rounded(ratio.high, outward=1)
            found.append(f"{rounded(ratio.value)} [{low}, {high}] {unit}")
    return [f"that is {', and '.join(found)}, counting {noun}s with a violation"] if found else []


def _strata_words(view: RateView) -> list[str]:
    """Return the part of operation that has most more than its share of what is unsafe; none if none has."""
    over = [
        one for one in view.strata if one.part is not None and one.part > 1.5 * one.share and one.unsafe >= 5
    ]
    if not over:
        return []
    worst = max(over, key=lambda one: (one.part or 0.0) - one.share)
    part, share = percent(worst.part or 0.0), percent(worst.share)
    return [f"{part} of them happen with {worst.words}, which is {share} of operation"]


def _caveats(view: RateView, noun: str) -> list[str]:
    said = [
        f"This is a rate in a simulator, for {noun}s distributed as stated: {view.distribution}. It says nothing "
        "about what the simulator, the distribution or the requirement leave out"
    ]
    if view.fitted is not None:
        said.append(
            "Only the interval with the uncertainty of the fit covers that; the others, and the claim, are about the "
            "fit as it is"
        )
    if view.failed:
        said.append(
            f"{view.failed:,} simulations without a verdict count as safe at lower and as unsafe at upper ends"
        )
    return said


def _rates_table(view: RateView, noun: str) -> Table:
    sure = f"{100 * view.confidence:.4g}%"
    rows: list[list[str | int | float | bool | None]] = [
        [
            f"unsafe {noun}s",
            view.rate.value,
            view.rate.low,
            view.rate.high,
            f"per {noun}",
            f"{sure}, {ANY_LOOK}",
        ],
        [
            f"unsafe {noun}s",
            view.fixed.value,
            view.fixed.low,
            view.fixed.high,
            f"per {noun}",
            f"{sure}, {FIXED}",
        ],
    ]
    if view.fitted is not None:
        one = view.fitted
        rows.append(
            [f"unsafe {noun}s", one.value, one.low, one.high, f"per {noun}", f"{sure}, {FIXED}, with the fit"]
        )
    rows += [
        [f"unsafe {noun}s", one.value, one.low, one.high, unit, f"{sure}, {FIXED}"]
        for one, unit in ((view.per_1000_km, "per 1,000 km"), (view.per_hour, "per hour"))
        if one is not None
    ]
    if (claim := view.claim) is not None:
        rows.append(
            [
                f"claim {claim.decision}",
                claim.at_most,
                claim.low,
                claim.high,
                f"per {noun}",
                "one-sided, each end",
            ]
        )
    return Table(name="rates", title="Rates", columns=COLUMNS, rows=rows)


def _strata_table(view: RateView, rows: int) -> Table:
    return Table(
        name="strata",
        title="Rates in parts of operation",
        columns=STRATA,
        rows=[
            [
                one.words,
                *((None,) * 3 if one.rate is None else (one.rate.value, one.rate.low, one.rate.high)),
                one.share,
                one.part,
                one.unsafe,
                one.simulations,
            ]
            for one in view.strata[:rows]
        ],
        left_out=max(0, len(view.strata) - rows),
    )


def _looks_table(view: RateView, rows: int) -> Table:
    """Return the looks, evenly thinned out if there are more than a number of rows, with the last one among them."""
    step = -(-len(view.looks) // max(rows, 1))
    shown = view.looks[::-1][::step][::-1] if rows else []
    return Table(
        name="looks",
        title="The interval as simulations came in",
        columns=LOOKS,
        rows=[[one.simulations, one.rate, one.low, one.high] for one in shown],
    )


def _steps(subject: Subject, view: RateView) -> list[Step]:
    open_claim = view.claim is not None and view.claim.decision == "not shown" and view.claim.more is not None
    steps = [subject.longer("The interval becomes narrower.")] if open_claim else []
    return steps if subject.role is Role.SIDE else [*steps, _by_condition(subject)]


def _by_condition(subject: Subject) -> Step:
    return Step(
        kind="rate",
        question="How often, and in which conditions?",
        words="Shows the rate with its intervals; --by names conditions, --at-most a claim. No simulations.",
        command=f"brink rate {subject.campaign.id}",
    )


KIND = RateKind()
