"""Route of who asks: what the token of a request may do."""

from typing import Annotated

from fastapi import APIRouter, Request
from pydantic import Field

from brink.server.api.guards import caller_of
from brink.server.api.schemas import View
from brink.server.states import Scope

router = APIRouter(tags=["access"])


class AccessView(View):
    """What the caller may do."""

    tokens: Annotated[bool, Field(description="Whether this coordinator asks for tokens.")]
    scope: Annotated[Scope, Field(description="Of the token; admin where none is needed.")]


@router.get("/access")
async def get_access(request: Request) -> AccessView:
    """Return what the caller may do. Without a token that is taken, it answers 401 as everything else does."""
    caller = caller_of(request)
    return AccessView(tokens=caller is not None, scope=Scope.ADMIN if caller is None else caller.scope)
