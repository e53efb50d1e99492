"""The contents of every finding, whatever its kind: a sentence, a typed view, tables, next steps."""

from enum import StrEnum
from typing import Annotated, Any

from pydantic import Field

from brink.server.findings.follow_ups import FollowUpView
from brink.server.findings.table import Table
from brink.server.states import FollowUpKind
from brink.server.views import View


class Role(StrEnum):
    """Why a campaign has a kind of finding."""

    SOUGHT = "sought"
    """This is the purpose of its algorithm or its problem."""
    SIDE = "side"
    """Its algorithm also finds this."""
    MET = "met"
    """It happened to find this."""


class Term(View):
    """A term, or a number, and what there is to say about it."""

    term: str
    words: str


class StepRequest(View):
    """The API request that takes a step."""

    path: Annotated[str, Field(description="Path below `/api/v1`, for POST.")]
    body: dict[str, Any]


class Step(View):
    """Something to do next."""

    kind: str
    question: Annotated[str, Field(description="The question that it answers.")]
    words: Annotated[str, Field(description="What it does, and how many simulations it takes.")]
    label: Annotated[str, Field(description="Words for a button or a link.")] = ""
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
    by_default: Annotated[
        bool, Field(description="Whether `brink run` takes it by itself at the end of a run.")
    ] = False
    tells_more: Annotated[
        bool, Field(description="Whether it clarifies this finding, rather than starts something new.")
    ] = False


class Finding(View):
    """One kind of a campaign's findings."""

    kind: str
    title: str
    role: Role
    sentence: Annotated[str, Field(description="The finding in a sentence of at most 25 words.")]
    more: Annotated[list[str], Field(description="Further facts, in sentences.")] = Field(
        default_factory=list
    )
    purpose: Annotated[
        str,
        Field(
            description="The purpose of a search for it, in a sentence for people who have never seen Brink."
        ),
    ] = ""
    example: Annotated[str, Field(description="An example, in a sentence.")] = ""
    figures: Annotated[list[Term], Field(description="The key figures.")] = Field(default_factory=list)
    caveats: Annotated[list[str], Field(description="Its uncertainty and limits, in sentences.")] = Field(
        default_factory=list
    )
    trust: Annotated[list[Term], Field(description="How far it can be trusted, term by term.")] = Field(
        default_factory=list
    )
    legend: Annotated[
        list[str],
        Field(description="The meaning of its words and of the columns of its tables, in sentences."),
    ] = Field(default_factory=list)
    page: Annotated[
        str,
        Field(description="Address of a page of the dashboard with all of it, without `#/`; empty for none."),
    ] = ""
    rings: Annotated[
        list[list[int]],
        Field(
            description="The solutions of each, for rings on a map, in order; empty if it is no result of its own."
        ),
    ] = Field(default_factory=list)
    is_empty: Annotated[bool, Field(description="Whether nothing of the kind was found.")] = False
    view: Annotated[
        Any, Field(description="Details that only this kind has; see its schema in the documentation.")
    ] = None
    tables: list[Table] = Field(default_factory=list)
    steps: list[Step] = Field(default_factory=list)

    def table(self, name: str | None = None) -> Table | None:
        """Return a table by its name, or the first one; None if there is none."""
        return next((one for one in self.tables if name in (None, one.name)), None)


class FollowedView(View):
    """The campaign that a follow-up asks about."""

    campaign: str
    name: str
    kind: FollowUpKind


class Findings(View):
    """All findings of a campaign."""

    campaign: str
    complete: Annotated[bool, Field(description="Whether the campaign has ended.")]
    words: Annotated[
        str, Field(description="The first finding in a sentence, with what it does not rest on.")
    ]
    headline: Annotated[str, Field(description="The first finding alone, in a short sentence.")]
    warnings: Annotated[
        list[str], Field(description="What it does not rest on, such as failed simulations, in sentences.")
    ]
    more: Annotated[list[str], Field(description="Further facts, in sentences.")]
    of: Annotated[FollowedView | None, Field(description="The campaign that this one follows up.")]
    exclusive: Annotated[
        bool, Field(description="Whether its simulations are informative only about the first finding.")
    ] = False
    findings: Annotated[
        list[Finding], Field(description="All kinds that the campaign has, its main purpose first.")
    ]
    steps: Annotated[list[Step], Field(description="Next steps, the most useful first.")]

    def of_kind(self, kind: str) -> Finding | None:
        """Return the finding of a kind; None if the campaign has none."""
        return next((one for one in self.findings if one.kind == kind), None)
