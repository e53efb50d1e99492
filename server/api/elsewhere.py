"""What protects a coordinator without tokens from web pages: a browser on its machine would knock for any of them.

Such a page cannot read an answer, but it need not, to cancel a campaign. And it could read, had the name of its own
site been made to point at this machine meanwhile.
"""

from typing import Final

from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import Scope

from brink.server.api.problem_details import problem
from brink.server.settings import LOOPBACK

_READS: Final = frozenset({"GET", "HEAD"})
_OWN_SITE: Final = frozenset({"same-origin", "none"})


def from_elsewhere(scope: Scope) -> Response | None:
    """Return the refusal of a request that another site's page had a browser make, or None."""
    headers = Headers(scope=scope)
    host = headers.get("host", "").lower()
    if _name(host) not in LOOPBACK:
        return problem(
            421, "Misdirected request",
            "expected a name of this machine, such as 127.0.0.1 or localhost; a coordinator without tokens serves "
            "under no other",
        )  # fmt: skip
    origin = headers.get("origin")
    foreign = origin is not None and origin.partition("://")[2].lower() != host
    fetched = headers.get("sec-fetch-site", "none") not in _OWN_SITE
    opened = headers.get("sec-fetch-mode") == "navigate"
    if (foreign and scope["method"] not in _READS) or (fetched and not opened):
        return problem(
            403, "Forbidden", "expected no request for a page of another site; make a token for that"
        )
    return None


def _name(host: str) -> str:
    if host.startswith("["):
        return host[1:].partition("]")[0]
    return host.partition(":")[0]
