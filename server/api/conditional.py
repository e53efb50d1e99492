"""Conditional GET: an answer is tagged, and whoever has it already is told so, instead of being sent it again.

A page that is left open asks every few seconds; while nothing happens, that costs an answer of a few bytes.
"""

import hashlib
from collections.abc import Collection, Sequence
from typing import Any, Final

from fastapi import Request, Response

from brink.server.api.schemas import View

NOTHING_NEW: Final[dict[int | str, dict[str, Any]]] = {304: {"description": "Nothing new since that ETag."}}
"""For the ``responses`` of a route."""


def tag(
    request: Request, response: Response, view: View | Sequence[View], *, leave_out: Collection[str] = ()
) -> None:
    """Tag an answer, and make it a 304 without a body if the request names its tag.

    Args:
        request: What was asked.
        response: Where its headers and its status are set.
        view: The answer.
        leave_out: Fields, of each view, that change though nothing happens: times since, rates.
    """
    digest = hashlib.sha256()
    for part in (view,) if isinstance(view, View) else view:
        digest.update(part.model_dump_json(exclude=set(leave_out)).encode())
    etag = f'"{digest.hexdigest()[:32]}"'
    response.headers["ETag"] = etag
    if _names(request.headers.get("if-none-match", ""), etag):
        response.status_code = 304


def _names(known: str, etag: str) -> bool:
    """Return whether a list of tags has one; a proxy that compresses answers makes tags weak."""
    return any(one.strip().removeprefix("W/") in (etag, "*") for one in known.split(","))


def tag_of(*told: object) -> str:
    """Return the tag of an answer that is another one whenever one of these is: for what takes long to make."""
    return f'"{hashlib.sha256(repr(told).encode()).hexdigest()[:32]}"'


def is_known(request: Request, etag: str) -> bool:
    """Return whether a request names a tag."""
    return _names(request.headers.get("if-none-match", ""), etag)


def nothing_new(etag: str) -> Any:
    """Return the answer to a request that names the tag of what it would get."""
    return Response(status_code=304, headers={"ETag": etag})
