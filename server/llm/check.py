"""Tries an endpoint: is it there, does it know the model, which forms of a reply does it take, what does it state."""

from collections.abc import Mapping
from dataclasses import dataclass

import httpx

from brink.search.algorithm import SeedRequest
from brink.search.traffic.participants import RoadLimits
from brink.server.llm.client import LlmClient
from brink.server.llm.drivable import Drivable
from brink.server.llm.errors import AccessRefused, EndpointAway, KeyMissing, LlmError
from brink.server.llm.form import SCHEMA
from brink.server.llm.prompts import question
from brink.server.llm.replies import parse
from brink.server.llm.settings import LlmSettings
from brink.server.llm.wire import Messages, Mode

_MOST = 2
_SYSTEM = "an automated car on a road in a town"


@dataclass(frozen=True, slots=True, kw_only=True)
class ModeReport:
    """How one form of a reply went.

    Attributes:
        mode: The form.
        accepted: Whether the endpoint took it.
        usable: Whether the reply was a valid solution.
        usage_stated: Whether tokens were stated.
        finish_reason: As stated, or None.
        latency_s: How long the answer took; None without one.
        trouble: What was wrong, in words; None if nothing was.
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
    """How an endpoint does.

    Attributes:
        reachable: Whether anything answers.
        models: What it lists; None if it has no list.
        model_listed: Whether the model is among them; None if it has no list.
        modes: The forms that were tried.
        trouble: What stands in the way altogether, in words; None if nothing does.
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
        """Whether it can be used."""
        return self.mode is not None


async def check_endpoint(
    settings: LlmSettings,
    *,
    environ: Mapping[str, str] | None = None,
    transport: httpx.AsyncBaseTransport | None = None,
) -> EndpointReport:
    """Return how an endpoint does, from its list of models and one small question in each form.

    Args:
        settings: Of the endpoint; each question is tried once, whatever its ``retries``.
        environ: Where the key is; the environment of this process if None.
        transport: Replaces the network.
    """
    once = settings.model_copy(update={"retries": 0})
    async with LlmClient(once, environ=environ, transport=transport) as client:
        try:
            models = await client.models()
        except (EndpointAway, KeyMissing) as error:
            return EndpointReport(reachable=False, trouble=str(error))
        except AccessRefused as error:
            return EndpointReport(reachable=True, trouble=str(error))
        except LlmError:
            models = None
        listed = None if models is None else _listed(settings.model, models)
        road = RoadLimits()
        messages = question(SeedRequest(number=0, count=1), road, _MOST, _SYSTEM)
        reports = [await _tried(client, messages, mode, Drivable(road, _MOST)) for mode in Mode]
    return EndpointReport(reachable=True, models=models, model_listed=listed, modes=tuple(reports))


async def _tried(client: LlmClient, messages: Messages, mode: Mode, drivable: Drivable) -> ModeReport:
    try:
        completion = await client.complete(messages, SCHEMA, mode=mode)
    except LlmError as error:
        return ModeReport(mode=mode, accepted=False, trouble=str(error))
    parsed = parse(completion.text, drivable, wanted=1)
    return ModeReport(
        mode=mode,
        accepted=True,
        usable=bool(parsed.solutions),
        usage_stated=completion.usage is not None,
        finish_reason=completion.finish_reason,
        latency_s=completion.latency_s,
        trouble=None if parsed.solutions else "; ".join(map(str, parsed.errors[:3])),
    )


def _listed(model: str, models: tuple[str, ...]) -> bool:
    """Return whether a model is listed; one server adds a tag to names that have none."""
    return model in models or f"{model}:latest" in models
