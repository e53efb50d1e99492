"""Routes of language models: what a campaign asked, what came, what it took."""

from typing import Annotated

from fastapi import APIRouter, Query

from brink.server.api.context import Services
from brink.server.api.schemas import LlmCall, LlmCalls
from brink.server.db.engine import read
from brink.server.llm.calls import StoredCall, spent_on
from brink.server.llm.store import list_calls

router = APIRouter(prefix="/campaigns/{campaign_id}/llm-calls", tags=["language models"])


@router.get("")
async def get_llm_calls(
    campaign_id: str,
    services: Services,
    replies: Annotated[bool, Query(description="Whether to give the raw replies, too.")] = False,
) -> LlmCalls:
    """Return the calls of a campaign."""
    campaign = await services.campaigns.get(campaign_id)
    calls = await read(services.engines, lambda connection: list_calls(connection, campaign.id))
    spent = spent_on(calls)
    return LlmCalls(
        calls=[_view(call, replies=replies) for call in calls], total_calls=spent.calls, total_tokens=spent.tokens,
        estimated_tokens=spent.estimated_tokens, cost=spent.cost,
    )  # fmt: skip


def _view(call: StoredCall, *, replies: bool) -> LlmCall:
    usage = call.usage
    return LlmCall(
        request=call.key.request, turn=call.key.turn, outcome=call.outcome,
        mode=call.mode, prompt_hash=call.prompt_hash, calls=call.calls,
        prompt_tokens=None if usage is None else usage.prompt_tokens,
        completion_tokens=None if usage is None else usage.completion_tokens,
        estimated=usage is not None and usage.estimated, cost=call.cost, latency_s=call.latency_s,
        error=call.error, reply=call.raw if replies else None,
    )  # fmt: skip
