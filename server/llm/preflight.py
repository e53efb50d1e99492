"""Checks of `brink llm` before a campaign is submitted: whether an endpoint works, and the cost of its prompts."""

from dataclasses import dataclass, replace
from typing import Final

import httpx

from brink.search.algorithm import SeedRequest
from brink.search.traffic.participants import RoadLimits
from brink.server.llm.access import LlmAccess
from brink.server.llm.calls import cost_of, tokens_of, worst_usage
from brink.server.llm.client import Call, LlmClient
from brink.server.llm.prompts import example, question
from brink.server.llm.protocol import AccessRefused, EndpointUnavailable, LlmError, Messages, NotSent, Usage
from brink.server.llm.replies import SCHEMA, RoadChecker, parse, pointed, to_text
from brink.server.llm.settings import LlmSettings
from brink.server.problems.base import SupportsSeeds
from brink.server.seeding import Mode, Spent

_PARTICIPANTS: Final = 2
_SYSTEM: Final = "an automated car on a road in a town"


@dataclass(frozen=True, slots=True, kw_only=True)
class ModeReport:
    """The result of a request with one form of reply.

    Attributes:
        mode: The form.
        accepted: Whether the endpoint accepted it.
        usable: Whether the reply was a valid solution.
        usage_stated: Whether the endpoint reported tokens.
        finish_reason: Reported reason, or None.
        latency_s: Time until the response; None without one.
        trouble: What was wrong; None if nothing was.
    """

    mode: Mode
    accepted: bool
    usable: bool = False
    usage_stated: bool = False
    finish_reason: str | None = None
    latency_s: float | None = None
    trouble: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class EndpointReport:
    """The result of checking an endpoint.

    Attributes:
        reachable: Whether it responds at all.
        models: The models it lists; None if it has no list.
        model_listed: Whether the configured model is listed; None if there is no list.
        modes: The results of all forms of reply.
        trouble: Why nothing could be checked; None if anything was.
    """

    reachable: bool
    models: tuple[str, ...] | None = None
    model_listed: bool | None = None
    modes: tuple[ModeReport, ...] = ()
    trouble: str | None = None

    @property
    def mode(self) -> Mode | None:
        """The strictest form with a usable reply, or None."""
        return next((report.mode for report in self.modes if report.usable), None)

    @property
    def works(self) -> bool:
        """Whether any form yields a usable reply."""
        return self.mode is not None


async def check_endpoint(
    settings: LlmSettings, *, access: LlmAccess, transport: httpx.AsyncBaseTransport | None = None
) -> EndpointReport:
    """Check an endpoint with a request for its models, and one small prompt for each form of reply.

    Args:
        settings: The endpoint; ``retries`` is ignored, and nothing is retried.
        access: Decides whether the endpoint may be used, and has the key.
        transport: HTTP transport; the network if None.
    """
    async with LlmClient(settings, access=access, transport=transport) as client:
        try:
            models = await client.models()
        except (EndpointUnavailable, NotSent) as error:
            return EndpointReport(reachable=False, trouble=str(error))
        except AccessRefused as error:
            return EndpointReport(reachable=True, trouble=str(error))
        except LlmError:
            models = None
        listed = None if models is None else _is_listed(settings.model, models)
        road = RoadLimits()
        messages = question(SeedRequest(number=0, count=1), road, _PARTICIPANTS, _SYSTEM)
        reports = [await _try_mode(client, messages, mode, RoadChecker(road, _PARTICIPANTS)) for mode in Mode]
    return EndpointReport(reachable=True, models=models, model_listed=listed, modes=tuple(reports))


async def _try_mode(client: LlmClient, messages: Messages, mode: Mode, road: RoadChecker) -> ModeReport:
    call = Call()
    try:
        reply = await client.complete(messages, SCHEMA, call, only=mode)
    except LlmError as error:
        return ModeReport(mode=mode, accepted=False, trouble=str(error))
    parsed = parse(reply.text, road, wanted=1)
    return ModeReport(
        mode=mode,
        accepted=True,
        usable=bool(parsed.solutions),
        usage_stated=reply.usage is not None,
        finish_reason=reply.finish_reason,
        latency_s=call.latency_s,
        trouble=None if parsed.solutions else "; ".join(map(pointed, parsed.errors[:3])),
    )


def _is_listed(model: str, models: tuple[str, ...]) -> bool:
    """Return whether a model is listed; Ollama adds a tag to names without one."""
    return model in models or f"{model}:latest" in models


_SHOWN: Final = 3
"""Number of known solutions of each kind that a differential prompt is assumed to contain."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """The expected usage of a campaign's calls.

    Attributes:
        expected: Calls without repair turns.
        most: Calls if each needs a repair turn, limited by ``max_calls``, with replies of maximum length.
        solutions_a_reply: Number of solutions that fit into a reply of maximum length.
    """

    expected: Spent
    most: Spent
    solutions_a_reply: int

    @property
    def words(self) -> str:
        """The estimate on one line."""
        expected, most = self.expected, self.most
        cost, most_cost = ("unknown" if one.cost is None else f"{one.cost:.3g}" for one in (expected, most))
        return (
            f"about {expected.total_calls} calls (at most {most.total_calls}), {expected.total_tokens} tokens "
            f"(at most {most.total_tokens}), cost {cost} (at most {most_cost}); a reply has room for about "
            f"{self.solutions_a_reply} solutions"
        )


def estimate(
    settings: LlmSettings, problem: SupportsSeeds, *, initial: int, differential: int, differential_calls: int
) -> Estimate:
    """Estimate the usage of a campaign's calls.

    Args:
        settings: The model, its prices and limits.
        problem: The road, and the system under test.
        initial: Solutions of the first request; 0 if there is none.
        differential: Solutions of each later request.
        differential_calls: Assumed number of later requests.
    """
    one = example(problem.road, problem.max_participants)
    shown = (one,) * _SHOWN
    first = SeedRequest(number=0, count=initial)
    later = SeedRequest(number=1, count=max(differential, 1), exposed=shown, silent=shown)
    firsts = 1 if initial else 0
    calls = min(firsts + differential_calls, settings.max_calls)
    repairs = min(calls, settings.max_calls - calls)
    a_solution = tokens_of(len(to_text([one])))
    usage = most = Usage(estimated=True)
    for request, made, repaired in (
        (first, firsts, min(repairs, firsts)),
        (later, calls - firsts, max(repairs - firsts, 0)),
    ):
        asked = question(request, problem.road, problem.max_participants, problem.system)
        worst = worst_usage(settings, asked)
        expected = replace(worst, completion_tokens=min(request.count * a_solution, settings.max_tokens))
        usage += expected * made
        # A repair turn repeats the question and the accepted part of its answer.
        most += worst * made + replace(worst, prompt_tokens=worst.total) * repaired
    return Estimate(
        expected=Spent(total_calls=calls, total_tokens=usage.total, cost=cost_of(usage, settings)),
        most=Spent(total_calls=calls + repairs, total_tokens=most.total, cost=cost_of(most, settings)),
        solutions_a_reply=max(1, settings.max_tokens // a_solution),
    )
