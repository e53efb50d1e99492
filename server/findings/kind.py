"""The contract of a kind of finding, and the discovery of kinds.

A kind is a folder of this package with a module `kind` that defines `KIND`, or a plug-in of the group
``brink.findings``, which is called like all user code (`brink.server.user_code`): one that fails or hangs loses
its own finding and no other. Nothing lists them. Which campaigns have a kind follows from what their algorithm
declares that it finds (`finds`), and from what their problem reports.
"""

import importlib
import logging
import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from types import MappingProxyType
from typing import Any, ClassVar, Final, TypeVar, cast

from pydantic import BaseModel, ConfigDict, ValidationError

from brink.server import findings
from brink.server.campaigns.archives import Archives, ReadArchive
from brink.server.campaigns.follow_ups.follow_up import StoredFollowUp
from brink.server.campaigns.plan import Plan
from brink.server.campaigns.store import Campaign
from brink.server.documents import invalid_input
from brink.server.findings.finding import Finding, Role, Step
from brink.server.findings.sources import Sources
from brink.server.problems.base import Problem
from brink.server.user_code import CONSTRUCTION, USER_CODE, guarded, is_guarded
from brink.sim.catalogue import load_plugin, plugin_ids

T = TypeVar("T")

MOST_RINGS: Final = 1_000
"""Most rings that a map shows."""

FINDINGS: Final = "brink.findings"
"""Entry-point group of kinds: each loads a subclass of `Kind`."""
NOTHING: Final[Mapping[str, str]] = MappingProxyType({})
log = logging.getLogger(__name__)


class Settings(BaseModel):
    """Query parameters of a kind of finding; a kind that has any defines a subclass."""

    model_config = ConfigDict(extra="forbid", frozen=True)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Subject:
    """The campaign that a finding is about.

    Attributes:
        sources: Where findings are read from.
        campaign: The campaign.
        read: Its archive.
        stored: Its follow-ups.
        role: Why it has this kind of finding.
        rows: Most rows of each table.
        settings: What it is asked with, of the kind's own type; see `find_safely`.
    """

    sources: Sources
    campaign: Campaign
    read: ReadArchive
    stored: Sequence[StoredFollowUp]
    role: Role
    rows: int
    settings: Any = None

    @property
    def plan(self) -> Plan:
        """The campaign's plan."""
        return self.read.plan

    @property
    def noun(self) -> str:
        """What a solution is called."""
        return "drive" if self.plan.problem.records_traces else "solution"

    @property
    def path(self) -> str:
        """Path of the campaign, in the API and on the dashboard."""
        return f"campaigns/{self.campaign.id}"

    def keep(self, option: str, what: str) -> Step:
        """Return the step that keeps drives in a suite.

        Args:
            option: Option of `brink suite create` that takes them.
            what: What they are.
        """
        return Step(
            kind="suite",
            question="Is it fixed in the next version?",
            words=f"Keeps {what} in a file; brink suite run simulates them again with every version, also in a CI.",
            command=f"brink suite create {self.campaign.id} {option} --out hazards.yaml",
        )

    def longer(self, words: str) -> Step:
        """Return the step that searches again with a larger budget."""
        return Step(
            kind="longer",
            question="Search longer?",
            words=f"{words} Try {4 * self.campaign.budget:,} simulations.",
            label="Clone it with a larger budget",
            place=f"new?from={self.campaign.id}&simulations={4 * self.campaign.budget}",
            tells_more=True,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Listed:
    """A campaign that has ended, in a list of many.

    Attributes:
        archives: Where archives are read.
        campaign: The campaign.
        plan: Its plan.
        kept: What kinds keep of campaigns, by campaign, as long as the list is shown.
    """

    archives: Archives
    campaign: Campaign
    plan: Plan
    kept: MutableMapping[str, Any]


class Kind(ABC):
    """A kind of finding.

    Attributes:
        id: What algorithms declare in `finds`; names the finding in addresses.
        title: Heading.
        rank: Of the kinds that a campaign is for, the one with the lowest rank comes first.
        is_met: Whether any campaign may come across it.
        is_silent: Whether nothing is said of it where a campaign that is not for it came across none.
        is_exclusive: Whether a campaign that is for this has no other findings, because its simulations are chosen
            so that they say nothing else.
        settings: What it can be asked with; every setting has a default.
    """

    id: ClassVar[str]
    title: ClassVar[str]
    rank: ClassVar[int] = 50
    is_met: ClassVar[bool] = False
    is_silent: ClassVar[bool] = False
    is_exclusive: ClassVar[bool] = False
    settings: ClassVar[type[Settings]] = Settings

    def is_reported_by(self, problem: Problem) -> bool:
        """Return whether every campaign on a problem has this kind; by default, if the problem's `finds` names it."""
        return self.id in getattr(problem, "finds", ())

    def fits(self, plan: Plan) -> bool:
        """Return whether a campaign can have this kind if its algorithm declares it or may produce it."""
        return True

    def asked_with(self, given: Mapping[str, str]) -> Settings:
        """Return settings.

        Args:
            given: Their values as text, by name.

        Raises:
            InvalidInput: There is no such setting, or a value is out of its bounds.
        """
        try:
            return self.settings.model_validate(dict(given))
        except ValidationError as error:
            raise invalid_input(error, self.settings, "/query") from None

    async def find(self, subject: Subject) -> Finding:
        """Return the finding for a campaign with at least one evaluated solution.

        By default, that is what `analyse` returns, which runs in a thread and under a time limit. Plug-ins implement
        `analyse` alone: this one runs in the event loop.
        """
        return await subject.sources.analyses.run(lambda: self.analyse(subject))

    def analyse(self, subject: Subject) -> Finding:
        """Return the finding, for kinds that need only the campaign's archive."""
        raise NotImplementedError(f"findings of kind {self.id} implement neither find nor analyse")

    @abstractmethod
    def brief(self, listed: Listed) -> str:
        """Summarise the finding in at most five words; empty if that takes too long."""

    def leads_to(self, subject: Subject) -> list[Step]:
        """Return steps for a campaign with another purpose, once all questions about that purpose have been asked."""
        return []

    def role(self, plan: Plan) -> Role | None:
        """Return why a campaign has this kind; None if it does not."""
        if self.is_reported_by(plan.problem):
            return Role.SOUGHT
        if not self.fits(plan):
            return None
        if self.id in plan.finds:
            return Role.SOUGHT if plan.finds[0] == self.id else Role.SIDE
        return Role.MET if self.is_met else None


@cache
def _own_kinds() -> tuple[Kind, ...]:
    names = (module.name for module in pkgutil.iter_modules(findings.__path__) if module.ispkg)
    return tuple(importlib.import_module(f"{findings.__name__}.{name}.kind").KIND for name in names)


@cache
def _plugin_kind(name: str, factory: Callable[[], object]) -> Kind | None:
    """Return the kind that a plug-in makes; None, which is logged once, if it makes none."""
    try:
        kind = USER_CODE.call(name, CONSTRUCTION, factory)
    except Exception:
        log.exception("plug-in cannot be loaded", extra={"plugin": name})
        return None
    if not isinstance(kind, Kind):
        log.error("plug-in is not a kind of finding", extra={"plugin": name})
        return None
    return guarded(name, kind)


def all_kinds() -> list[Kind]:
    """Return all kinds in order of presentation, without plug-ins that cannot be loaded."""
    found = [
        _plugin_kind(name, cast(Callable[[], object], load_plugin(FINDINGS, name)))
        for name in plugin_ids(FINDINGS)
    ]
    kinds = [*_own_kinds(), *(kind for kind in found if kind is not None)]
    return sorted(kinds, key=lambda kind: (kind.rank, kind.id))


def asked(kind: Kind, question: Callable[[], T], otherwise: T) -> T:
    """Return a kind's answer, or a fallback if the kind is a plug-in's and fails, which is logged.

    Args:
        kind: The kind.
        question: Asks it.
        otherwise: The answer of one that fails.
    """
    try:
        return question()
    except Exception:
        if not is_guarded(kind):
            raise
        log.exception("plug-in failed", extra={"plugin": kind.id})
        return otherwise


def reported_by(problem: Problem) -> list[str]:
    """Return the kinds of findings that every campaign on a problem has."""
    return [kind.id for kind in all_kinds() if asked(kind, partial(kind.is_reported_by, problem), False)]


async def find_safely(kind: Kind, subject: Subject, given: Mapping[str, str] = NOTHING) -> Finding:
    """Return a kind's finding, or a note that it is unavailable if the kind is a plug-in's and fails.

    Args:
        kind: The kind.
        subject: The campaign, without settings.
        given: Settings as text, by name.

    Raises:
        InvalidInput: The kind has no such setting, or a value is out of its bounds.
    """
    if not is_guarded(kind):
        return await kind.find(replace(subject, settings=kind.asked_with(given)))
    failed = Finding(
        kind=kind.id,
        title=kind.title,
        role=subject.role,
        sentence="the plug-in of this finding failed: the coordinator's log says why",
        is_empty=True,
    )

    def answer() -> Finding:
        settings = kind.asked_with(given) if given else None

        def analyse() -> Finding:
            return kind.analyse(replace(subject, settings=settings or kind.asked_with(NOTHING)))

        return asked(kind, analyse, failed)

    return await subject.sources.analyses.run(answer)


def kinds_of(plan: Plan) -> dict[Kind, Role]:
    """Return a campaign's kinds of findings with their roles, the main ones first."""
    asked_of = {kind: asked(kind, partial(kind.role, plan), None) for kind in all_kinds()}
    roles = {kind: role for kind, role in asked_of.items() if role is not None}
    exclusive = {kind: role for kind, role in roles.items() if kind.is_exclusive and role is Role.SOUGHT}
    order = list(Role)
    return dict(sorted((exclusive or roles).items(), key=lambda one: order.index(one[1])))
