"""Route of a campaign's finding: what it found in a sentence, its best pairs, and what to do next.

The sentences are those of the routes for pairs, tolerances, violations, combinations, repeats and boundaries. Which
of them comes first depends on what the search is for.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any, Final
from urllib.parse import urlencode

from fastapi import APIRouter
from pydantic import Field
from sqlalchemy import Connection

from brink.search.algorithm import WarmStarts
from brink.search.algorithms.tolerance import Tolerance
from brink.search.analysis.avoidable import EXPLANATION, Avoidable
from brink.search.analysis.confirmation import Confirmation
from brink.search.analysis.violations import FoundViolation
from brink.search.errors import UnsupportedSpace
from brink.search.slots import slots_of
from brink.server.api.context import Context, Services
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.campaigns.outcomes import CampaignOutcomes
from brink.server.campaigns.pairs import PairSettings, searches_for_pairs
from brink.server.campaigns.plan import check_repeatable, looks_for_boundary
from brink.server.campaigns.repeats import MOST, FollowUpKind, StoredRepeats, followed_by, read_follow_ups
from brink.server.campaigns.store import CAMPAIGNS, ENDED, Campaign
from brink.server.campaigns.tolerance import searches_for_tolerances
from brink.server.campaigns.violations import read_violations
from brink.server.db.engine import read
from brink.server.errors import InvalidInput
from brink.server.findings.boundary.analysis import boundary_words
from brink.server.findings.boundary.repeats import DEFAULT_REPEATS, count_distinct, repeats_view
from brink.server.findings.combinations.analysis import combinations_view
from brink.server.findings.combinations.views import Combinations
from brink.server.findings.follow_ups import FollowUpView, follow_up_view
from brink.server.findings.pairs.analysis import pairs_view
from brink.server.findings.pairs.views import DEFAULT_CONFIRMATIONS, PairsView, PairView
from brink.server.findings.tolerances.analysis import tolerance_view
from brink.server.findings.violations.analysis import violation_types, violations_words
from brink.server.findings.words import listed_words
from brink.server.problems.base import ReportsViolations
from brink.server.problems.catalogue import ODD, make_problem, problem_type, takes_requirement
from brink.server.problems.changes import as_sentence
from brink.server.problems.requirements import ANY
from brink.server.states import CampaignStatus, OutcomeKind
from brink.server.views import View
from brink.sim.requirements import CollisionKind
from brink.sim.verdict import clock_words, impact_of, violated_words

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["campaigns"])

BEST: Final = 2
_TOLERANCE_SIMULATIONS: Final = 2_000
"""Enough for twelve cells under one condition."""
MOST_RINGS: Final = 1_000


class StepKind(StrEnum):
    """What a next step is about."""

    RESUME = "resume"
    CONFIRM = "confirm"
    COMPONENT = "component"
    MINIMISE = "minimise"
    REPEAT = "repeat"
    CONTROL = "control"
    LOOK = "look"
    EXPORT = "export"
    LONGER = "longer"
    REPORT = "report"
    GO_ON = "go on"
    ANY_REQUIREMENT = "any requirement"
    TOLERANCE = "tolerance"
    MONITOR = "monitor"


_QUESTIONS_LEFT: Final = frozenset(
    {StepKind.CONFIRM, StepKind.COMPONENT, StepKind.MINIMISE, StepKind.REPEAT, StepKind.LONGER}
)
"""Steps that tell more about what was found; what leads on is offered once none of them is left."""


class StepRequest(View):
    """The request of the API that takes a step."""

    path: Annotated[str, Field(description="Path below `/api/v1`, for POST.")]
    body: dict[str, Any]


class StepView(View):
    """Something to do next."""

    kind: StepKind
    question: Annotated[str, Field(description="The question that it answers.")]
    words: Annotated[str, Field(description="What it does, and how many simulations it takes.")]
    label: Annotated[str, Field(description="Words for a button or a link.")]
    command: Annotated[
        str,
        Field(description="The same on the command line, without the coordinator; empty if there is none."),
    ] = ""
    request: StepRequest | None = None
    place: Annotated[
        str | None, Field(description="Address of a page of the dashboard that has the answer, without `#/`.")
    ] = None
    follow_up: Annotated[
        FollowUpView | None,
        Field(description="The campaign that is simulating it, if it has been requested."),
    ] = None


class BestPair(View):
    """One of the best pairs."""

    place: int
    safe: Annotated[int, Field(description="Number of the safe solution.")]
    unsafe: int
    words: Annotated[str, Field(description="The change and what the unsafe side did, in one sentence.")]
    state: Annotated[
        Confirmation, Field(description="Whether it is confirmed; see `confirmation` of a pair.")
    ]
    evidence: Annotated[
        str, Field(description="The same in a few words, with the number of drives that kept their verdicts.")
    ]
    shares: Annotated[
        str,
        Field(
            description="How often each side was unsafe with other seeds, in a sentence; empty if not tried."
        ),
    ]


class AvoidableExample(View):
    """A violation that a careful driver would have avoided, the first of its type."""

    number: Annotated[int, Field(description="Number of the solution.")]
    words: Annotated[str, Field(description="What the system did, such as `hit a pedestrian at 12.8 s`.")]
    type: Annotated[str, Field(description="Its type.")]


class FollowedView(View):
    """The campaign that a follow-up asks about."""

    campaign: str
    name: str
    kind: FollowUpKind


class FindingView(View):
    """What a campaign found."""

    campaign: str
    complete: Annotated[bool, Field(description="Whether the campaign has ended.")]
    words: Annotated[str, Field(description="The finding in a sentence.")]
    more: Annotated[list[str], Field(description="What else is known, in sentences.")]
    of: Annotated[FollowedView | None, Field(description="The campaign that this one follows up.")] = None
    pairs: Annotated[
        int | None,
        Field(
            description="Distinct pairs at its own settings; null if there are too many to tell, or it searched for "
            "tolerances."
        ),
    ]
    rings: Annotated[
        list[tuple[int, int]],
        Field(description="The sides of each of them, by place; empty if the search was not for pairs."),
    ]
    replayable: Annotated[bool, Field(description="Whether drives are recorded, so that they can be drawn.")]
    best: Annotated[
        list[BestPair],
        Field(
            description="The first pairs: confirmed ones, then undecided ones and those not tried, refuted ones last."
        ),
    ]
    rule: Annotated[str, Field(description="What it takes for a pair to hold, in a sentence.")]
    avoidable: Annotated[
        list[AvoidableExample],
        Field(
            description="Examples of the most frequent types of violations that a careful driver would have avoided."
        ),
    ]
    explanation: Annotated[
        str, Field(description="Who that driver is, in sentences; empty if there is no example.")
    ]
    steps: Annotated[list[StepView], Field(description="What to do next, the most useful first.")]


@router.get("/finding")
async def get_finding(campaign_id: str, services: Services) -> FindingView:
    """Return what a campaign found in a sentence, its best pairs, and what to do next."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    known = await _known(services, campaign, found)
    words, more = await _sentences(services, known)
    avoidable = await services.pages.run(lambda: _avoidable_examples(known.violations))
    of = await read(services.engines, lambda c: _followed(c, campaign))
    view = known.pairs
    if campaign.failed and not _all_failed(campaign):  # otherwise the words say it already
        words = f"{words}; {_failures(campaign)}"
    if odd := known.outcomes.odd:
        words = f"within the ODD: {words}"
    if view is not None and view.searched and view.distinct:
        more = [*more, view.caveat.removesuffix(odd).rstrip()]  # the outcomes say it already
    return FindingView(
        campaign=campaign.id,
        complete=campaign.status in ENDED,
        words=_sentence(words),
        more=[_sentence(one) for one in more if one],
        of=of,
        pairs=None if view is None else view.distinct,
        rings=known.rings[:MOST_RINGS],
        replayable=found.plan.problem.records_traces,
        best=[] if view is None else [_best_pair(view, pair) for pair in view.pairs],
        rule="" if view is None else _rule_words(view),
        avoidable=avoidable,
        explanation=EXPLANATION if avoidable else "",
        steps=[] if of is not None else _steps(known),
    )


def _avoidable_examples(found: Sequence[FoundViolation]) -> list[AvoidableExample]:
    """Return a violation of each of the first types that a careful driver would have avoided, one per solution."""
    examples: dict[int, AvoidableExample] = {}
    careful = [one for one in found if one.avoidable is Avoidable.CAREFUL]
    for kind in violation_types(careful):
        if len(examples) == BEST:
            break
        one = next(one for one in careful if (one.number, one.type) == (kind.example, kind.type))
        hit = next((each for each in CollisionKind if each == one.circumstances["collision"]), None)
        did = violated_words(str(one.circumstances["requirement"]), hit, impact_of(one.circumstances))
        words = f"{did} at {clock_words(float(one.circumstances['time_s']))}"
        examples.setdefault(one.number, AvoidableExample(number=one.number, words=words, type=one.type))
    return list(examples.values())


def _best_pair(view: PairsView, pair: PairView) -> BestPair:
    state, safe, unsafe = pair.confirmation.state, pair.confirmation.safe, pair.confirmation.unsafe
    drives = safe.evaluated + unsafe.evaluated
    counts = " and ".join(f"{side.unsafe:,}/{side.evaluated:,}" for side in (safe, unsafe))
    again = f"unsafe in {counts} drives with other seeds"
    evidence = {
        Confirmation.CONFIRMED: f"confirmed: {again}",
        Confirmation.REFUTED: f"refuted: {again}",
        Confirmation.UNDECIDED: f"undecided: {again}",
        Confirmation.PENDING: "being simulated again",
        Confirmation.NOT_TRIED: "not simulated again yet",
    }[state]
    shares = (
        ""
        if not drives
        else (
            f"With other seeds, the safe drive was unsafe in {safe.unsafe:,} of {safe.evaluated:,} simulations, and "
            f"the unsafe drive in {unsafe.unsafe:,} of {unsafe.evaluated:,}."
        )
    )
    return BestPair(
        place=pair.place,
        safe=pair.safe.number,
        unsafe=pair.unsafe.number,
        words=pair.words,
        state=state,
        evidence="computed" if view.computed else evidence,
        shares=shares,
    )


def _rule_words(view: PairsView) -> str:
    """Return what it takes for a pair to hold."""
    rule = view.rule
    if view.computed:
        return "Verdicts are computed, not simulated: every pair holds."
    return (
        f"A pair holds if, with other seeds, the safe drive is unsafe in at most {rule.safe_at_most:.0%} of the "
        f"simulations and the unsafe one in at least {rule.unsafe_at_least:.0%}. It is confirmed or refuted with an "
        f"error rate of {rule.error:.0%}, and undecided where the simulations show neither."
    )


def _sentence(words: str) -> str:
    return f"{as_sentence(words).removesuffix('.')}."


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Known:
    """What is known of a campaign.

    Attributes:
        campaign: The campaign.
        found: Its archive.
        outcomes: What its simulations showed.
        reported: Verdicts that the search has not been told yet, and how many of them are unsafe.
        stored: Its follow-ups.
        violations: Its violations, if its problem reports them.
        chains: Its chains of techniques, if its problem has them and the search was not for pairs; None otherwise.
        pairs: Its first pairs; None if there are too many to tell, or the search was for tolerances.
        too_many: Why there are too many.
        rings: The sides of all its pairs if it searched for them.
        boundary: Distinct boundary solutions, and strict ones among them.
    """

    campaign: Campaign
    found: ReadArchive
    outcomes: CampaignOutcomes
    reported: tuple[int, int]
    stored: Sequence[StoredRepeats]
    violations: Sequence[FoundViolation]
    chains: Combinations | None
    pairs: PairsView | None
    too_many: str
    rings: list[tuple[int, int]]
    boundary: tuple[int, int]

    @property
    def searched_for_pairs(self) -> bool:
        """Whether the search was for pairs."""
        return searches_for_pairs(self.campaign.body.algorithm.id)

    @property
    def about_boundary(self) -> bool:
        """Whether the boundary is the result: the search looked for it."""
        return looks_for_boundary(self.campaign.body.algorithm.id) and not self.searched_for_pairs


async def _known(services: Context, campaign: Campaign, found: ReadArchive) -> _Known:
    stored = await services.pages.read(services.engines, lambda c: read_follow_ups(c, campaign.id))
    reported = await services.pages.read(services.engines, lambda c: services.reported.read(c, campaign))
    problem = found.plan.problem
    violations: Sequence[FoundViolation] = ()
    if isinstance(problem, ReportsViolations):
        violations = await services.pages.read(
            services.engines, lambda c: read_violations(c, campaign.id, problem)
        )
    view, too_many, rings = None, "", []
    if not searches_for_tolerances(campaign.body.algorithm.id):
        try:
            pairs = await services.pairs.get(campaign, found, PairSettings.of(found.plan))
        except InvalidInput as error:
            too_many = "; ".join(one.message for one in error.errors)
        else:
            view = await services.pages.read(
                services.engines, lambda c: pairs_view(c, campaign, found, pairs, stored, BEST)
            )
            if view.searched:
                rings = [(pair.safe.number, pair.unsafe.number) for pair in pairs.found.pairs]
    boundary = await services.boundaries.get(campaign, found, DEFAULT_T_B, DEFAULT_D_TH)
    chains = None
    if not searches_for_pairs(campaign.body.algorithm.id):
        chains = await services.analyses.run(lambda: _chains(found))
    return _Known(
        campaign=campaign,
        found=found,
        outcomes=await services.outcomes.get(campaign.id, found),
        reported=(len(reported.results), reported.unsafe),
        stored=stored,
        violations=violations,
        chains=chains,
        pairs=view,
        too_many=too_many,
        rings=rings,
        boundary=(boundary.counts.dbs, boundary.counts.strict),
    )


def _chains(found: ReadArchive) -> Combinations | None:
    """Return the chains of techniques of an archive; None if it has none, or the problem reports violations."""
    problem = found.plan.problem
    if isinstance(problem, ReportsViolations) or not len(found.archive):
        return None
    try:
        slots_of(problem.space)
    except UnsupportedSpace:
        return None
    return combinations_view(problem.space, found.archive)


def _followed(connection: Connection, campaign: Campaign) -> FollowedView | None:
    """Return the campaign that a campaign follows up; None if it is no follow-up."""
    found = followed_by(connection, campaign.id)
    of = None if found is None else CAMPAIGNS.find(connection, found[0])
    if found is None or of is None:
        return None
    return FollowedView(campaign=of.id, name=of.body.name, kind=found[1])


async def _sentences(services: Context, known: _Known) -> tuple[str, list[str]]:
    """Return the finding in a sentence, and further sentences."""
    campaign, found, outcomes = known.campaign, known.found, known.outcomes
    if not len(found.archive):
        return _nothing_yet(known), []
    of = await read(services.engines, lambda c: followed_by(c, campaign.id))
    if of is not None:
        return await _follow_up_words(services, *of, campaign), [outcomes.sentence()]
    pairs = known.too_many or (known.pairs.note if known.pairs else "")
    if known.searched_for_pairs:
        return pairs, [outcomes.sentence()]
    if searches_for_tolerances(campaign.body.algorithm.id):
        tolerances = await services.tolerances.get(campaign, found)
        view = await services.pages.run(lambda: tolerance_view(campaign, found.plan, tolerances))
        return _so_far(campaign, view.note), [view.caveat]
    special = _special_words(known)
    also = [pairs] if known.pairs is not None and known.pairs.distinct else []
    if special:
        return _so_far(campaign, special), [outcomes.sentence(), *also]
    if known.about_boundary:
        words = boundary_words(*known.boundary, t_b=DEFAULT_T_B, d_th=DEFAULT_D_TH)
        return _so_far(campaign, words), [outcomes.sentence(), *also]
    return _so_far(campaign, _counts(known)), [outcomes.sentence(), *also]


def _all_failed(campaign: Campaign) -> bool:
    """Return whether a campaign has ended without any result."""
    return campaign.status in ENDED and 0 < campaign.failed == campaign.completed


def _failures(campaign: Campaign) -> str:
    """Return how many simulations failed: the finding does not rest on them."""
    count = f"{campaign.failed:,} of {campaign.completed:,} simulations failed"
    return f"{count} and count neither as safe nor as unsafe"


def _nothing_yet(known: _Known) -> str:
    reported, unsafe = known.reported
    if not reported:
        if known.campaign.status not in ENDED:
            return "no simulation has a verdict yet"
        if _all_failed(known.campaign):
            return f"all {known.campaign.failed:,} simulations failed"
        return "no simulation had a verdict"
    return (
        f"{unsafe:,} of the first {reported:,} drives {_violated(known)}; the search is told once its first "
        "generation is complete"
    )


def _counts(known: _Known) -> str:
    return f"{known.campaign.unsafe:,} of {known.campaign.evaluated:,} solutions {_violated(known)}"


def _violated(known: _Known) -> str:
    requirements = known.outcomes.requirements
    return known.outcomes.kind_words(OutcomeKind.VIOLATED) if requirements else "are unsafe"


def _so_far(campaign: Campaign, words: str) -> str:
    if campaign.status in ENDED:
        return words
    return f"so far, after {campaign.evaluated:,} of {campaign.budget:,} simulations: {words}"


def _special_words(known: _Known) -> str:
    """Return the sentence about violations or combinations, if the problem is about these."""
    if isinstance(known.found.plan.problem, ReportsViolations):
        return violations_words(known.violations)
    return "" if known.chains is None else known.chains.words


async def _follow_up_words(services: Context, of_id: str, kind: FollowUpKind, campaign: Campaign) -> str:
    """Return what a follow-up showed."""
    of = await services.campaigns.get(of_id)
    if kind is FollowUpKind.CONFIRM:
        found = await services.archives.get(of)
        stored = await services.pages.read(services.engines, lambda c: read_follow_ups(c, of.id))
        own = next(one for one in stored if one.campaign.id == campaign.id)
        distinct = await count_distinct(services, of, own, found)
        return repeats_view(of, own, found, distinct).words
    counts = f"{campaign.unsafe:,} of {campaign.evaluated:,} drives"
    if kind is FollowUpKind.COMPONENT:
        return f"with ground truth in place of the component, {counts} were unsafe all the same"
    return f"with some of their differences reverted, {counts} were still unsafe"


def _steps(known: _Known) -> list[StepView]:
    campaign, name = known.campaign, f"campaigns/{known.campaign.id}"
    if campaign.status is CampaignStatus.PAUSED:
        return [
            StepView(
                kind=StepKind.RESUME,
                question="Go on?",
                label="Resume",
                words="The campaign is paused: workers get none of its jobs.",
                command=f"brink resume {campaign.id}",
                request=StepRequest(path=f"{name}/resume", body={}),
            )
        ]
    if campaign.status not in ENDED or not len(known.found.archive):
        return []
    steps = _pair_steps(known) if known.searched_for_pairs else []
    reports_violations = isinstance(known.found.plan.problem, ReportsViolations)
    if known.about_boundary and not reports_violations:
        steps += _boundary_steps(known)
    if reports_violations:
        steps.append(
            StepView(
                kind=StepKind.LOOK,
                question="Which violations are there?",
                label="",
                words="Lists all types of violations, and names them.",
                command=f"brink violations {campaign.id}",
            )
        )
    if (number := example_of(known.chains)) is not None:
        steps.append(
            StepView(
                kind=StepKind.LOOK,
                question="What do the perturbations do?",
                label=f"Open solution {number}",
                words="Shows an unsafe drive that is safe with each part of its chain alone, or in another order.",
                place=f"campaigns/{campaign.id}/solutions/{number}",
                command=f"brink replay {campaign.id} {number} --out hazard.mp4",
            )
        )
    if searches_for_tolerances(campaign.body.algorithm.id):
        steps.append(
            StepView(
                kind=StepKind.EXPORT,
                question="What may the detector get wrong?",
                label="",
                words="Writes the tolerances as sentences: a requirement for the detector.",
                command=f"brink tolerance {campaign.id} --format sentences",
            )
        )
        steps.append(
            StepView(
                kind=StepKind.TOLERANCE,
                question="Does your detector meet it?",
                label="",
                words="Compares the errors of a detector, from the drives of another campaign, with the tolerances.",
                command=f"brink tolerance {campaign.id} --episodes OTHER",
            )
        )
    elif not known.searched_for_pairs and known.pairs is not None and known.pairs.distinct:
        steps.append(_look_at_pairs(known, "Which small change decides?"))
    if not any(step.kind in _QUESTIONS_LEFT for step in steps):
        steps += _leading_on(known)
    return steps


def example_of(chains: Combinations | None) -> int | None:
    """Return an unsafe solution of the most informative chain whose hazard is due to the combination or its order."""
    if chains is None:
        return None
    numbers = (number for one in chains.combinations for number in (*one.together, *one.turned))
    return next(numbers, None)


def _leading_on(known: _Known) -> list[StepView]:
    """Return what leads on once everything about the finding itself has been asked."""
    campaign, plan = known.campaign, known.found.plan
    about_tolerances = searches_for_tolerances(campaign.body.algorithm.id)
    steps = [
        StepView(
            kind=StepKind.REPORT,
            question="Who should know?",
            label="",
            words="Writes a report for people who have never seen Brink: one HTML file, with pictures and evidence.",
            command=f"brink report {campaign.id} --out report.html",
        )
    ]
    if isinstance(plan.algorithm, WarmStarts):
        steps.append(
            StepView(
                kind=StepKind.GO_ON,
                question="Is there more to find?",
                label="Go on from these results",
                words="Searches with another seed, from these results: they guide the search, and cost nothing.",
                place=f"new?start_from={campaign.id}",
            )
        )
    if not about_tolerances:
        steps += _other_requirement(known)
    if plan.problem.errors_problem and not about_tolerances:
        steps.append(_tolerance_step(campaign, plan.problem.errors_problem))
    if 0 < campaign.unsafe < campaign.evaluated and not about_tolerances:
        steps.append(
            StepView(
                kind=StepKind.MONITOR,
                question="How likely is a new drive to be unsafe?",
                label="",
                words="Fits a safety monitor to these simulations; it rates drives that were not simulated.",
                command=f"brink monitor fit {campaign.id} --out monitor.json",
            )
        )
    return steps


def _other_requirement(known: _Known) -> list[StepView]:
    """Return the step that changes what counts as a violation, if the problem knows more requirements."""
    problem = known.campaign.body.problem
    if "requirement" not in problem.params or problem.params["requirement"] == ANY:
        return []
    if not takes_requirement(problem.id, ANY):
        return []
    return [
        StepView(
            kind=StepKind.ANY_REQUIREMENT,
            question="Does it violate anything else?",
            label="Search for any violation",
            words="Searches again with requirement: any. That changes what counts as a violation: not only drives "
            f"that {_violated(known)}.",
            place=f"new?from={known.campaign.id}&requirement={ANY}",
        )
    ]


def _tolerance_step(campaign: Campaign, errors_problem: str) -> StepView:
    """Return the step that asks how wrong the detector of a problem may be."""
    requirement = campaign.body.problem.params.get("requirement")
    kind = problem_type(errors_problem)
    names = make_problem(errors_problem, {}).space.column_names()
    limits = {name: one for name, one in campaign.body.problem.params.get(ODD, {}).items() if name in names}
    odd = {ODD: limits} if limits else {}
    body = {
        "name": f"{campaign.body.name[:180]}: tolerances",
        "problem": {"id": errors_problem, "params": {"errors": 1, "requirement": requirement} | odd},
        "algorithm": {"id": Tolerance.id, "params": {"cells": dict(kind.usual_cells)}},
        "budget": {"simulations": _TOLERANCE_SIMULATIONS},
    }
    return StepView(
        kind=StepKind.TOLERANCE,
        question="How wrong may the detector be?",
        label="Search for tolerances",
        words="Searches for a requirement for the detector: how gross each type of its errors may be before drives "
        "violate. What counts as a violation stays the same.",
        place=f"new?{urlencode({'body': json.dumps(body)})}",
    )


def _pair_steps(known: _Known) -> list[StepView]:
    campaign, view = known.campaign, known.pairs
    if view is None or not view.distinct:
        return [_longer(known, "A larger budget finds nearer solutions with opposite verdicts.")]
    steps = []
    for offer in view.offers:
        open_one = next(
            (
                one
                for one in known.stored
                if one.kind is offer.kind and one.campaign.status not in ENDED and not one.boundary
            ),
            None,
        )
        done = offer.kind is FollowUpKind.CONFIRM and view.tried + view.pending == view.distinct
        if open_one is None and (offer.reason or done or view.computed):
            continue
        question, label, option, what = _QUESTIONS[offer.kind]
        simulations = offer.simulations * (DEFAULT_CONFIRMATIONS if offer.kind is FollowUpKind.CONFIRM else 1)
        most = "" if offer.kind is FollowUpKind.COMPONENT else "at most "
        steps.append(
            StepView(
                kind=StepKind(offer.kind.value),
                question=question,
                label=label,
                words=what if open_one else f"{what} It takes {most}{simulations:,} simulations.",
                command=f"brink pairs {campaign.id} {option}",
                request=StepRequest(
                    path=f"campaigns/{campaign.id}/pairs/follow-ups",
                    body={"kind": offer.kind.value}
                    | ({"repeats": DEFAULT_CONFIRMATIONS} if offer.kind is FollowUpKind.CONFIRM else {}),
                ),
                follow_up=None if open_one is None else follow_up_view(open_one),
            )
        )
    steps.append(_look_at_pairs(known, "What happens in them?"))
    return steps


_QUESTIONS: Final = {
    FollowUpKind.CONFIRM: (
        "Do the pairs hold?",
        "Confirm the pairs",
        f"--confirm {DEFAULT_CONFIRMATIONS}",
        f"Simulates both sides of each pair with up to {DEFAULT_CONFIRMATIONS} other seeds.",
    ),
    FollowUpKind.COMPONENT: (
        "Is the component to blame?",
        "Blame the component",
        "--component",
        "Simulates each unsafe side once more, with ground truth in place of the component.",
    ),
    FollowUpKind.MINIMISE: (
        "Which differences matter?",
        "Minimise the changes",
        "--minimise",
        "Reverts the differences of each pair one by one, as long as its unsafe side stays unsafe.",
    ),
}


def _look_at_pairs(known: _Known, question: str) -> StepView:
    view, campaign = known.pairs, known.campaign.id
    count = 0 if view is None else view.distinct
    best = view.pairs[0].place if view is not None and view.pairs else 1
    films = view is not None and view.replayable
    return StepView(
        kind=StepKind.LOOK,
        question=question,
        words=f"Shows both {'drives' if films else 'sides'} of each pair side by side.",
        label="Open the pair" if count == 1 else f"Open all {count:,} pairs",
        place=f"campaigns/{campaign}/pairs",
        command=f"brink pairs {campaign}" + (f" --film {best} pair-{best}.mp4" if films else ""),
    )


def _boundary_steps(known: _Known) -> list[StepView]:
    campaign, (distinct, strict) = known.campaign, known.boundary
    if not distinct:
        return [_longer(known, "Only neighbourhoods with enough solutions lie near the boundary.")]
    steps = []
    again = [one for one in known.stored if one.boundary and one.kind is FollowUpKind.CONFIRM]
    open_one = next((one for one in again if one.campaign.status not in ENDED), None)
    if open_one or not (again or _cannot_repeat(known.found)):
        repeated = min(distinct, MOST)
        what = listed_words(repeated, distinct).removeprefix("the ") if distinct > 1 else "boundary solution"
        steps.append(
            StepView(
                kind=StepKind.REPEAT,
                question="Does the boundary hold?",
                label="Repeat the boundary",
                words=f"Simulates the {what} with {DEFAULT_REPEATS} other seeds. It takes "
                f"{DEFAULT_REPEATS * repeated:,} simulations.",
                command=f"brink repeats {campaign.id}",
                request=StepRequest(path=f"campaigns/{campaign.id}/repeats", body={}),
                follow_up=None if open_one is None else follow_up_view(open_one),
            )
        )
    if len(known.found.plan.problem.space.components) > 1:
        steps.append(
            StepView(
                kind=StepKind.CONTROL,
                question="How much of it is the component's?",
                label="Compare with the control",
                words="Compares it with its control, whose verdicts do not depend on the component.",
                place=f"compare?ids={campaign.id}",
                command=f"brink compare {campaign.id}",
            )
        )
    steps.append(
        StepView(
            kind=StepKind.EXPORT,
            question="Where is the evidence?",
            label="",
            words="Exports the boundary as tables, rules and replays.",
            command=f"brink evidence {campaign.id} --out evidence",
        )
    )
    if not strict:
        steps.append(_longer(known, "No boundary solution is strict yet: that takes more neighbours."))
    return steps


def _cannot_repeat(found: ReadArchive) -> bool:
    try:
        check_repeatable(found.plan)
    except InvalidInput:
        return True
    return False


def _longer(known: _Known, words: str) -> StepView:
    return StepView(
        kind=StepKind.LONGER,
        question="Search longer?",
        words=words,
        label="Clone it with a larger budget",
        place=f"new?from={known.campaign.id}&simulations={4 * known.campaign.budget}",
    )
