"""External sources of seeds: all that the rest of the coordinator knows of language models.

A search that waits for seeds (`brink.search.algorithm.Seeded`) gets them from a source that calls out, to an endpoint
that the operator allows, within the limits of the campaign's section ``llm``. A call costs time and money, so it is
stored, and never made twice. Prompts, replies, protocol and keys are the source's own: the plug-in `PLUGIN`, which
nothing else names.
"""

from collections.abc import Callable, Sequence
from datetime import datetime
from enum import StrEnum
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any, Final, Protocol

from pydantic import Field

from brink.server.views import View

if TYPE_CHECKING:  # campaign files are read without these
    from sqlalchemy import Connection

    from brink.search.algorithm import Proposal, SeedRequest
    from brink.server.db.engine import Engines
    from brink.server.db.writer import Writer
    from brink.server.problems.base import Problem

PLUGIN: Final = "brink.server.llm.seeder"
"""Module whose `SEEDER` is the `Seeder` of this coordinator."""


class SeederSettings(Protocol):
    """A campaign's settings of a source of seeds. They are validated by the plug-in, and contain no key."""

    @property
    def endpoint(self) -> str:
        """Base URL that is called."""

    @property
    def model(self) -> str:
        """What is asked there, for people."""

    @property
    def max_calls(self) -> int:
        """Maximum number of HTTP requests for the campaign."""


class Mode(StrEnum):
    """How a request specifies the form of the reply, strictest first.

    llama-cpp-python and some hosted endpoints support ``SCHEMA_IN_OBJECT`` instead of ``JSON_SCHEMA``.
    """

    JSON_SCHEMA = "json_schema"
    SCHEMA_IN_OBJECT = "schema_in_object"
    JSON_OBJECT = "json_object"
    PLAIN = "plain"


class Outcome(StrEnum):
    """The outcome of a call.

    Attributes:
        SENT: In progress. After a restart, this means that the reply was lost, although it may be billed.
        OK: Some of the reply is usable.
        TRUNCATED: The reply reached the token limit; its complete solutions are used, and there are some.
        INVALID: None of the reply is usable.
        DECLINED: The model or a content filter declined to answer.
        REFUSED: The endpoint rejected the request permanently, or there is no key.
        UNAVAILABLE: No try got a reply.
        OVER_BUDGET: Not sent, or not sent again after a coordinator stopped, because a budget does not allow it.
        CIRCUIT_OPEN: Not sent, because the last calls failed.
    """

    SENT = "sent"
    OK = "ok"
    TRUNCATED = "truncated"
    INVALID = "invalid"
    DECLINED = "declined"
    REFUSED = "refused"
    UNAVAILABLE = "unavailable"
    OVER_BUDGET = "over_budget"
    CIRCUIT_OPEN = "circuit_open"


class LlmCall(View):
    """A call to a language model: one prompt, with all HTTP requests that it took; as it is stored and shown."""

    request: Annotated[int, Field(description="Number of the request for seeds.")]
    turn: Annotated[int, Field(description="0 for the first prompt, 1 for the repair prompt.")]
    prompt_hash: str
    mode: Annotated[Mode, Field(description="How structured output was requested.")]
    outcome: Annotated[Outcome, Field(description="What became of it.")] = Outcome.SENT
    calls: Annotated[int, Field(description="HTTP requests sent, whatever became of them.")] = 0
    prompt_tokens: Annotated[
        int | None,
        Field(
            description="Of the requests that the endpoint processed or may have processed; null without any."
        ),
    ] = None
    completion_tokens: int | None = None
    estimated: Annotated[
        bool, Field(description="Whether tokens are estimated because the endpoint reported none.")
    ] = False
    cost: Annotated[float | None, Field(description="Null if no prices are configured.")] = 0.0
    latency_s: Annotated[
        float, Field(description="Duration of the successful request, or until the call was given up.")
    ] = 0.0
    error: Annotated[str | None, Field(description="What went wrong, in words; null if nothing did.")] = None
    reply: Annotated[
        str | None,
        Field(description="Raw body of the reply with the API key removed, if requested.", repr=False),
    ] = None
    called_at: Annotated[
        datetime | None, Field(description="When it was stored last, by the clock of the database.")
    ] = None

    @property
    def tokens(self) -> int:
        """Tokens of prompts and replies."""
        return (self.prompt_tokens or 0) + (self.completion_tokens or 0)


class Spent(View):
    """What the calls of a campaign have used so far."""

    total_calls: Annotated[int, Field(description="HTTP requests sent, whatever became of them.")] = 0
    total_tokens: int = 0
    estimated_tokens: int = 0
    cost: Annotated[
        float | None, Field(description="Total cost; null if the cost of any call is unknown.")
    ] = 0.0


class LlmCalls(Spent):
    """Language-model calls of a campaign."""

    calls: Annotated[list[LlmCall], Field(description="In the order in which they were made.")]
    max_calls: Annotated[
        int | None, Field(description="How many may be sent; null without a language model.")
    ]


def spent_on(calls: Sequence[LlmCall]) -> Spent:
    """Return what calls have used."""
    costs = [call.cost for call in calls if call.calls]
    return Spent(
        total_calls=sum(call.calls for call in calls),
        total_tokens=sum(call.tokens for call in calls),
        estimated_tokens=sum(call.tokens for call in calls if call.estimated),
        cost=None if None in costs else sum(cost for cost in costs if cost is not None),
    )


class Access(Protocol):
    """What the operator allows campaigns to call, and which keys may be sent there."""

    def check(self, settings: Any) -> None:
        """Check the settings of a campaign; None if it has none.

        Raises:
            InvalidInput: They may not be used.
        """


class SeedSource(Protocol):
    """Provides seeds for algorithms that wait for them: always the same for the same request of a campaign."""

    def proposals(
        self, campaign_id: str, settings: Any, problem: "Problem", request: "SeedRequest"
    ) -> "Sequence[Proposal] | None":
        """Return the seeds, possibly none at all, or None while they are still being generated.

        The first call starts the request, which may take minutes. The campaign is advanced when the seeds arrive.

        Args:
            campaign_id: The campaign.
            settings: Its section ``llm``, of the plug-in's own type; None if it has none.
            problem: Its problem.
            request: What the algorithm asks for.
        """

    def doing(self, campaign_id: str) -> str | None:
        """Describe the request that a campaign waits for; None if this coordinator has none in progress."""

    def calls(self, connection: "Connection", campaign_id: str) -> list[LlmCall]:
        """Return the stored calls of a campaign in order."""

    def close(self) -> None:
        """Start no more requests, and wait a few seconds for those in progress."""


class Seeder(Protocol):
    """Makes what the coordinator needs of a kind of source."""

    @property
    def settings_type(self) -> type[Any]:
        """The model of `SeederSettings`."""

    def check(self, settings: Any, config: object, algorithm_id: str, problem: "Problem") -> None:
        """Check that a campaign has settings if and only if its algorithm uses the source.

        Args:
            settings: The campaign's section ``llm``; None if it has none.
            config: The algorithm's parameters.
            algorithm_id: The algorithm, for messages.
            problem: The campaign's problem.

        Raises:
            InvalidInput: There is only one of the two, or the source cannot propose anything for the problem.
        """

    def access(self, allowed: str) -> Access:
        """Return what the setting ``BRINK_LLM_ENDPOINTS`` allows.

        Raises:
            InvalidInput: It is malformed.
        """

    def source(
        self, engines: "Engines", writer: "Writer", on_seeds: Callable[[str], None], access: Any
    ) -> SeedSource:
        """Return the source of a coordinator.

        Args:
            engines: For reading stored calls.
            writer: For storing calls.
            on_seeds: Called from another thread with the id of a campaign whose seeds are available.
            access: What campaigns may call, as `access` returned it.
        """


def seeder() -> Seeder:
    """Return the plug-in."""
    found: Seeder = import_module(PLUGIN).SEEDER
    return found
