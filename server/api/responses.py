"""Conventions that routes share: entity tags, cursor pagination, idempotent submission, 202 while computing."""

import base64
import hashlib
import re
from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime
from typing import Annotated, Any, Final, Protocol

from fastapi import Header, Query, Request, Response
from fastapi.responses import JSONResponse

from brink.search.analysis.paper import D_THS, PAPER_T_BS
from brink.server.api.schemas import BeingMade, Thresholds
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.errors import InvalidInput
from brink.server.views import View

Responses = dict[int | str, dict[str, Any]]
"""What a route accepts as ``responses``."""

NOT_MODIFIED: Final[Responses] = {304: {"description": "Not modified: the client's ETag is current."}}
COMPUTING: Final[Responses] = {
    202: {"model": BeingMade, "description": "Still being computed; try again after `Retry-After` seconds."}
}
THRESHOLDS: Final = Thresholds(t_b=DEFAULT_T_B, d_th=DEFAULT_D_TH, t_bs=list(PAPER_T_BS), d_ths=list(D_THS))
"""Default thresholds, and the grid of thresholds in score tables."""


def set_etag(
    request: Request, response: Response, view: View | Sequence[View], *, leave_out: Collection[str] = ()
) -> None:
    """Set the ETag of a response, and turn it into a 304 without a body if the client already has it.

    Args:
        request: The request, whose ``If-None-Match`` is compared.
        response: The response whose headers and status are set.
        view: The content.
        leave_out: Fields of each view that change constantly, such as ages and rates.
    """
    digest = hashlib.sha256()
    for part in (view,) if isinstance(view, View) else view:
        digest.update(part.model_dump_json(exclude=set(leave_out)).encode())
    etag = f'"{digest.hexdigest()[:32]}"'
    response.headers["ETag"] = etag
    if matches(request, etag):
        response.status_code = 304


def etag_of(*parts: object) -> str:
    """Return an ETag that changes whenever one of the parts changes; for content that is slow to compute."""
    return f'"{hashlib.sha256(repr(parts).encode()).hexdigest()[:32]}"'


def matches(request: Request, etag: str) -> bool:
    """Return whether ``If-None-Match`` contains a tag, also in the weak form that compressing proxies make of it."""
    known = request.headers.get("if-none-match", "")
    return any(one.strip().removeprefix("W/") in (etag, "*") for one in known.split(","))


def not_modified(etag: str) -> Any:
    """Return a 304 response."""
    return Response(status_code=304, headers={"ETag": etag})


Alpha = Annotated[
    float, Query(gt=0, lt=1, description="Corrected p value up to which a difference is significant.")
]
Cursor = Annotated[str | None, Query(max_length=200)]
DocumentHash = Annotated[str | None, Query(max_length=64, pattern="^[0-9a-f]*$")]
LATEST_S: Final = 4e9
"""An upper bound on timestamps that every platform can represent, in seconds since 1970."""


class Dated(Protocol):
    """An entry of a list that is ordered by creation time, newest first."""

    @property
    def id(self) -> str:
        """Id, which breaks ties."""

    @property
    def created_at(self) -> datetime:
        """Time of creation."""


def next_cursor(page: Sequence[Dated], limit: int) -> str | None:
    """Return the cursor of the page that follows this one, or None if this page is not full."""
    if len(page) < limit:
        return None
    last = page[-1]
    return base64.urlsafe_b64encode(f"{last.created_at.timestamp()!r} {last.id}".encode()).decode()


def read_cursor(cursor: str | None) -> tuple[datetime, str] | None:
    """Return the creation time and id of the last entry of the previous page; None without a cursor.

    Raises:
        InvalidInput: The cursor is not one that this API issued.
    """
    if not cursor:
        return None
    found = re.fullmatch(r"(\d+\.\d+) ([0-9a-z]+)", _decoded(cursor))
    if found is None:
        raise InvalidInput.at("/query/cursor", "expected the value of `next` from an earlier page")
    return datetime.fromtimestamp(min(float(found[1]), LATEST_S), UTC), found[2]


def _decoded(cursor: str) -> str:
    try:
        return base64.urlsafe_b64decode(cursor).decode()
    except ValueError:
        return ""


IdempotencyKey = Annotated[str | None, Header(max_length=200, pattern="^[ -~]+$")]


def existing(model: type[View], noun: str) -> Responses:
    """Return the documented response to a repeated submission with the same ``Idempotency-Key``."""
    return {200: {"model": model, "description": f"The {noun} already submitted with this Idempotency-Key."}}


def set_created(response: Response, path: str, *, new: bool) -> None:
    """Set the location of a submitted resource, and the status: 201 if it is new, 200 if it already existed.

    Args:
        response: The response whose headers and status are set.
        path: Path of the resource below ``/api/v1``.
        new: Whether this request created it.
    """
    response.headers["Location"] = f"/api/v1/{path}"
    if not new:
        response.status_code = 200


def json_response(view: View, headers: Mapping[str, str] | None = None) -> Response:
    """Return a large view as a response; called in a thread, because encoding it takes too long for the event loop.

    Args:
        view: The view.
        headers: Additional headers.
    """
    return Response(view.model_dump_json(), media_type="application/json", headers=headers)


MEDIA: Final = {"csv": "text/csv", "jsonl": "application/jsonl", "parquet": "application/vnd.apache.parquet"}
"""Media types of tables."""


def file_response(content: bytes, name: str, form: str, headers: Mapping[str, str] | None = None) -> Response:
    """Return a table as a file to save.

    Args:
        content: The table.
        name: Name of the file, without its ending.
        form: Its format, a key of `MEDIA`.
        headers: Additional headers.
    """
    disposition = {"Content-Disposition": f'attachment; filename="{name}.{form}"'}
    return Response(content, media_type=MEDIA[form], headers={**disposition, **(headers or {})})


def computing(detail: str) -> Any:
    """Return a 202 response that names what is still being computed."""
    return JSONResponse(BeingMade(detail=detail).model_dump(), status_code=202, headers={"Retry-After": "2"})
