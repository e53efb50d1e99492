"""All findings of a campaign: its kinds of findings, a summary sentence from the first, and next steps."""

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

from sqlalchemy import Connection

from brink.search.algorithm import WarmStarts
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.follow_ups.follow_up import StoredFollowUp
from brink.server.campaigns.follow_ups.question import question_of
from brink.server.campaigns.follow_ups.store import followed_by, read_follow_ups
from brink.server.campaigns.outcomes import CampaignOutcomes
from brink.server.campaigns.plan import Plan
from brink.server.campaigns.store import CAMPAIGNS, Campaign
from brink.server.campaigns.traces import driven_again
from brink.server.errors import NotFound
from brink.server.findings.boundary.repeats import count_distinct, repeats_view
from brink.server.findings.finding import Finding, Findings, FollowedView, Role, Step, StepRequest
from brink.server.findings.kind import NOTHING, Kind, Subject, all_kinds, asked, find_safely, kinds_of
from brink.server.findings.sources import Sources
from brink.server.findings.table import MOST_ROWS
from brink.server.findings.words import full_sentence, so_far
from brink.server.problems.catalogue import takes_requirement
from brink.server.problems.driving_systems import users_part
from brink.server.problems.requirements import ANY
from brink.server.states import ENDED, CampaignStatus, OutcomeKind

ROWS: Final = 10
"""Rows of each table where all kinds of findings are listed."""


async def find_all(sources: Sources, campaign: Campaign, *, rows: int = ROWS) -> Findings:
    """Return all findings of a campaign.

    Args:
        sources: Where findings are read from.
        campaign: The campaign.
        rows: Most rows of each table.
    """
    known = await _Known.read(sources, campaign)
    found = []
    if len(known.read_archive.archive):
        subjects = known.subjects(rows)
        all_found = await asyncio.gather(*(find_safely(kind, subject) for kind, subject in subjects.items()))
        found = [
            one
            for kind, one in zip(subjects, all_found, strict=True)
            if not (one.is_empty and kind.is_silent and one.role is Role.MET)
        ]
    words, more = await _sentences(known, found)
    if known.outcomes.odd:
        words = f"within the ODD: {words}"
    failures = "" if not campaign.failed or _all_failed(campaign) else _failures(campaign)
    warnings = [one for one in (failures, known.not_the_same) if one]
    return Findings(
        campaign=campaign.id,
        complete=campaign.status in ENDED,
        words=full_sentence("; ".join([words, *warnings])),
        headline=full_sentence(words),
        warnings=[full_sentence(one) for one in warnings],
        more=[full_sentence(one) for one in more if one],
        of=known.of,
        exclusive=known.is_exclusive,
        findings=found,
        steps=[] if known.of is not None else _steps(known, found),
    )


async def find_kind(
    sources: Sources,
    campaign: Campaign,
    kind_id: str,
    *,
    rows: int = MOST_ROWS,
    settings: Mapping[str, str] = NOTHING,
) -> Finding:
    """Return one kind of a campaign's findings.

    Args:
        sources: Where findings are read from.
        campaign: The campaign.
        kind_id: The kind.
        rows: Most rows of each table.
        settings: What the kind is asked with, as text; see `Kind.settings`.

    Raises:
        NotFound: The campaign does not have it, or nothing has been evaluated yet.
        InvalidInput: The kind has no such setting, or a value is out of its bounds.
    """
    known = await _Known.read(sources, campaign)
    subjects = known.subjects(rows)
    kind = next((one for one in subjects if one.id == kind_id), None)
    if kind is None:
        raise NotFound(
            f"campaign {campaign.id} has no findings of kind {kind_id[:64]!r}; it has "
            f"{', '.join(one.id for one in subjects)}"
        )
    if not len(known.read_archive.archive):
        raise NotFound(f"campaign {campaign.id}: no solution has been evaluated yet")
    return await find_safely(kind, subjects[kind], settings)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Known:
    """The facts about a campaign that its findings build on.

    Attributes:
        kinds: The kinds of findings that it has, those that it is for first, with why it has them.
        reported: Verdicts that the search has not received yet, and how many of them are unsafe.
        of: The campaign that it follows up, if any.
        not_the_same: That its driving system is not deterministic; empty if that has not shown.
    """

    sources: Sources
    campaign: Campaign
    read_archive: ReadArchive
    kinds: Mapping[Kind, Role]
    stored: Sequence[StoredFollowUp]
    outcomes: CampaignOutcomes
    reported: tuple[int, int]
    of: FollowedView | None
    not_the_same: str

    @classmethod
    async def read(cls, sources: Sources, campaign: Campaign) -> "_Known":
        """Read them."""
        archive = await sources.archives.get(campaign)

        outcomes = await sources.outcomes.get(campaign.id, archive)

        def look(connection: Connection) -> "_Known":
            reported = sources.reported.read(connection, campaign)
            return cls(
                sources=sources,
                campaign=campaign,
                read_archive=archive,
                kinds=kinds_of(archive.plan),
                stored=read_follow_ups(connection, campaign.id),
                outcomes=outcomes,
                reported=(len(reported.results), reported.unsafe),
                of=_followed(connection, campaign),
                not_the_same=_not_the_same(connection, campaign),
            )

        return await sources.pages.read(sources.engines, look)

    @property
    def is_exclusive(self) -> bool:
        """Whether its simulations are informative only about its purpose."""
        return any(kind.is_exclusive for kind in self.kinds)

    def subjects(self, rows: int) -> dict[Kind, Subject]:
        """Return the kinds of findings that the campaign has, the main ones first."""
        return {kind: self.subject(role, rows) for kind, role in self.kinds.items()}

    def subject(self, role: Role, rows: int = 0) -> Subject:
        """Return the campaign as the subject of a finding."""
        return Subject(
            sources=self.sources,
            campaign=self.campaign,
            read=self.read_archive,
            stored=self.stored,
            role=role,
            rows=rows,
        )

    @property
    def violated(self) -> str:
        """The violation that unsafe drives have in common."""
        return self.outcomes.kind_words(OutcomeKind.VIOLATED) if self.outcomes.requirements else "are unsafe"


def _followed(connection: Connection, campaign: Campaign) -> FollowedView | None:
    """Return the campaign that a campaign follows up; None if it is not a follow-up."""
    asks = followed_by(connection, campaign.id)
    of = None if asks is None else CAMPAIGNS.find(connection, asks.of_id)
    if asks is None or of is None:
        return None
    return FollowedView(campaign=of.id, name=of.body.name, kind=asks.kind)


def _not_the_same(connection: Connection, campaign: Campaign) -> str:
    """Return how many drives were not the same when they were driven again; empty if all were."""
    part = users_part(campaign.body.problem.params)
    again, differ = driven_again(connection, campaign.id) if part else (0, 0)
    if not differ:
        return ""
    return (
        f"{differ:,} of {again:,} drives that were driven again had another result: {part} is not "
        "deterministic, so nothing found here can be relied on"
    )


async def _sentences(known: _Known, found: Sequence[Finding]) -> tuple[str, list[str]]:
    """Return the first finding in a sentence, and further sentences."""
    if not found:
        return _nothing_yet(known), []
    if known.of is not None and not question_of(known.of.kind).has_findings:
        return await _follow_up_words(known, known.of), [known.outcomes.sentence()]
    first = found[0]
    told = "" if known.is_exclusive else known.outcomes.sentence()
    met = [one.sentence for one in found[1:] if one.role is Role.MET and not one.is_empty]
    return so_far(known.campaign, first.sentence), [
        told,
        *first.more,
        *first.caveats,
        *met,
        _ignored_distribution(known.read_archive.plan),
    ]


def _ignored_distribution(plan: Plan) -> str:
    """Return that a search ignored the operational distribution; empty if there is none, or it did not."""
    if plan.problem.space.distribution is None or getattr(plan.algorithm, "honours_distribution", False):
        return ""
    return (
        f"the search ({plan.body.algorithm.id}) ignored the operational distribution: the share of its unsafe "
        "solutions says nothing about how often they occur"
    )


def _all_failed(campaign: Campaign) -> bool:
    """Return whether a campaign has ended without any result."""
    return campaign.status in ENDED and 0 < campaign.failed == campaign.completed


def _failures(campaign: Campaign) -> str:
    """Return how many simulations failed, on which the finding therefore does not rest."""
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
        f"{unsafe:,} of the first {reported:,} drives {known.violated}; the search continues once its first "
        "generation is complete"
    )


async def _follow_up_words(known: _Known, followed: FollowedView) -> str:
    """Summarise a follow-up."""
    sources, campaign, question = known.sources, known.campaign, question_of(followed.kind)
    if question.repeats is None:
        return question.showed.format(counts=f"{campaign.unsafe:,} of {campaign.evaluated:,} drives")
    of = await sources.pages.read(sources.engines, lambda c: CAMPAIGNS.get(c, followed.campaign))
    archive = await sources.archives.get(of)
    stored = await sources.pages.read(sources.engines, lambda c: read_follow_ups(c, of.id))
    own = next(one for one in stored if one.campaign.id == campaign.id)
    distinct = await count_distinct(sources, of, own, archive)
    return repeats_view(of, own, archive, distinct).words


def _steps(known: _Known, found: Sequence[Finding]) -> list[Step]:
    campaign = known.campaign
    if campaign.status is CampaignStatus.PAUSED:
        return [
            Step(
                kind="resume",
                question="Go on?",
                label="Resume",
                words="The campaign is paused: workers get none of its jobs.",
                command=f"brink resume {campaign.id}",
                request=StepRequest(path=f"campaigns/{campaign.id}/resume", body={}),
            )
        ]
    if campaign.status not in ENDED or not found:
        return []
    steps = [step for one in found if one.role is not Role.SIDE for step in one.steps]
    if not any(step.tells_more for step in steps):
        steps += _leading_on(known)
    return steps


def _leading_on(known: _Known) -> list[Step]:
    """Return further steps, once all questions about the findings themselves have been asked."""
    campaign, plan = known.campaign, known.read_archive.plan
    steps = [
        Step(
            kind="report",
            question="Who should know?",
            words="Writes a report for people who have never seen Brink: one HTML file, with pictures and evidence.",
            command=f"brink report {campaign.id} --out report.html",
        )
    ]
    if isinstance(plan.algorithm, WarmStarts):
        steps.append(
            Step(
                kind="go on",
                question="Is there more to find?",
                label="Continue from these results",
                words="Searches with another seed, from these results: they guide the search at no cost.",
                place=f"new?start_from={campaign.id}",
            )
        )
    if known.is_exclusive:
        return steps
    steps += _other_requirement(known)
    side = known.subject(Role.SIDE)
    for kind in all_kinds():
        if known.kinds.get(kind, Role.SIDE) is Role.SIDE:
            steps += asked(kind, partial(kind.leads_to, side), list[Step]())
    if 0 < campaign.unsafe < campaign.evaluated:
        steps.append(
            Step(
                kind="monitor",
                question="How likely is a new drive to be unsafe?",
                words="Fits a safety monitor to these simulations; it rates drives that were not simulated.",
                command=f"brink monitor fit {campaign.id} --out monitor.json",
            )
        )
    return steps


def _other_requirement(known: _Known) -> list[Step]:
    """Return the step that changes the requirement, if the problem supports others."""
    problem = known.campaign.body.problem
    if "requirement" not in problem.params or problem.params["requirement"] == ANY:
        return []
    if not takes_requirement(problem.id, ANY):
        return []
    return [
        Step(
            kind="any requirement",
            question="Does it violate anything else?",
            label="Search for any violation",
            words="Searches again with requirement: any. That changes what counts as a violation: not only drives "
            f"that {known.violated}.",
            place=f"new?from={known.campaign.id}&requirement={ANY}",
        )
    ]
