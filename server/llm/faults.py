"""What an answer that is no completion means: try again, give up, or ask for the form of the reply in another way."""

import math
import re
from collections.abc import Mapping
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from typing import Final

from brink.server.llm.errors import (
    AccessRefused,
    EndpointAway,
    LlmError,
    ModelUnknown,
    Refused,
    RequestRefused,
)
from brink.server.llm.settings import LlmSettings
from brink.server.llm.untrusted_json import BadJson, decoded
from brink.server.llm.wire import said

_RETRYABLE: Final = frozenset({408, 409, 425, 429})
_NOT_IMPLEMENTED: Final = 501
_NAMES_FORM: Final = re.compile(
    r"response_?format|json_?schema|json schema|json_?object|json mode|structured|guided|grammar"
    r"|unsupported|not supported",
    re.IGNORECASE,
)
_NO_CREDIT: Final = re.compile(r"insufficient_quota|exceeded your current quota|billing", re.IGNORECASE)
_FORM_REFUSED: Final = frozenset({400, 404, 422, 500, _NOT_IMPLEMENTED})
_PROBABLY_FORM: Final = frozenset({400, 422})
_LOOKED_AT_CHARS: Final = 2000


def retry_after_s(headers: Mapping[str, str], now: datetime) -> float | None:
    """Return how long an answer asks to wait, from seconds or an HTTP date; None if it does not."""
    stated = headers.get("Retry-After", "").strip()
    try:
        seconds = float(stated)
    except ValueError:
        seconds = _seconds_until(stated, now)
    return max(seconds, 0.0) if math.isfinite(seconds) else None


def _seconds_until(date: str, now: datetime) -> float:
    try:
        when = parsedate_to_datetime(date)
    except (ValueError, OverflowError):
        return math.nan
    return (when.replace(tzinfo=when.tzinfo or UTC) - now).total_seconds()


def status_within(raw: str) -> int | None:
    """Return the status that a 2xx answer has inside: some gateways report errors of those behind them so."""
    if '"error"' not in raw:
        return None
    try:
        document = decoded(raw)
    except BadJson:
        return None
    if not isinstance(document, dict) or document.get("choices") or not document.get("error"):
        return None
    code = document["error"].get("code") if isinstance(document["error"], dict) else None
    return code if type(code) is int and 400 <= code <= 599 else None


def fault(
    status: int, headers: Mapping[str, str], raw: str, settings: LlmSettings, now: datetime
) -> LlmError:
    """Return the error that an answer is, with what to do about it."""
    words = said(raw)
    message = f"{settings.endpoint} answered {status}: {words}"
    if status == 429 and _NO_CREDIT.search(raw):
        return AccessRefused(f"{message}. There is no credit left", status=status, said=words)
    if status in _RETRYABLE or (status >= 500 and status != _NOT_IMPLEMENTED):
        return EndpointAway(message, retry_after_s=retry_after_s(headers, now))
    return _refusal(status, message, words, settings)


def _refusal(status: int, message: str, words: str, settings: LlmSettings) -> Refused:
    if status in (401, 403):
        key = settings.api_key_env
        advice = f"Check the key in {key}" if key else "Name the variable with the key in api_key_env"
        return AccessRefused(f"{message}. {advice}", status=status, said=words)
    if status == 402:
        return AccessRefused(f"{message}. There is no credit left", status=status, said=words)
    if status == 404:
        advice = f"Check that it serves the model {settings.model!r}, and that endpoint ends as its manual says (/v1)"
        return ModelUnknown(f"{message}. {advice}", status=status, said=words)
    if 300 <= status < 400:
        message = f"{message}. It points elsewhere: give that address as endpoint"
    elif settings.token_field == "max_tokens" and "max_completion_tokens" in words:
        message = f"{message}. Set token_field: max_completion_tokens"
    return RequestRefused(message, status=status, said=words)


def refuses_form(status: int, raw: str, *, proven: bool) -> bool:
    """Return whether an answer refuses the form of the reply that was asked for.

    Args:
        status: HTTP status.
        raw: The body.
        proven: Whether the endpoint took this form before.
    """
    if status in _FORM_REFUSED and _NAMES_FORM.search(raw[:_LOOKED_AT_CHARS]):
        return True
    return status in _PROBABLY_FORM and not proven
