"""The protocol of OpenAI-compatible endpoints: request bodies, replies, and errors. Pure functions.

Servers differ: ``usage`` and ``finish_reason`` may be missing, content may be a list of parts or null, reasoning may
come in a separate field. Everything here accepts arbitrary input. Error messages never contain the API key.

ServerError
├── LlmError                  no usable reply
│   ├── EndpointUnavailable   retryable: no response, timeout, broken connection, 408, 409, 425, 429, 5xx
│   ├── OverBudget            a budget, or the time for a request for seeds, does not allow another request
│   ├── UnusableReply         2xx, but not a chat completion, or too large
│   └── Refused               the endpoint rejected the request: 4xx, 501, a redirect
│       ├── AccessRefused     401, 402, 403, or a 429 that reports exhausted credit
│       └── NotSent           the operator does not allow the endpoint or the key, or there is no key
└── CallLogMismatch           a stored call was made with a different prompt; never suppressed
"""

import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from typing import Any, ClassVar, Final, Literal, TypeAlias

from brink.server.errors import ServerError
from brink.server.llm.settings import LlmSettings
from brink.server.seeding import Mode, Outcome

JsonObject: TypeAlias = Mapping[str, Any]

_MAX_DIGITS: Final = 18
_TRUNCATED: Final = frozenset({"length", "max_tokens", "model_length", "max_output_tokens"})
_WITHHELD: Final = frozenset({"content_filter", "safety", "refusal", "recitation"})
_MAX_TOKENS: Final = 10**9
_ERROR_CHARS: Final = 300
_NAME_CHARS: Final = 200
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
_SEARCHED_CHARS: Final = 2000


class LlmError(ServerError):
    """No usable reply.

    Attributes:
        outcome: The outcome of the call.
        lost: Whether the endpoint may have processed the last request and billed it.
        raw: The reply; None if there is none, or if it was not read to its end.
    """

    outcome: ClassVar[Outcome] = Outcome.REFUSED
    lost: bool = False
    raw: str | None = None


class EndpointUnavailable(LlmError):
    """The endpoint did not respond, or asked the client to retry later.

    Attributes:
        what: What happened, in a few words, such as ``HTTP 500``.
        detail: What the endpoint or the system says about it; may be empty.
        retry_after_s: Requested pause, or None.
    """

    outcome = Outcome.UNAVAILABLE

    def __init__(
        self,
        endpoint: str,
        what: str,
        detail: str = "",
        *,
        retry_after_s: float | None = None,
        lost: bool = False,
    ) -> None:
        super().__init__(f"{endpoint}: {what}{f': {detail}' if detail else ''}")
        self.what = what
        self.detail = detail
        self.retry_after_s = retry_after_s
        self.lost = lost


class OverBudget(LlmError):
    """A budget, or the time for a request for seeds, does not allow another request."""

    outcome = Outcome.OVER_BUDGET


class UnusableReply(LlmError):
    """The reply is not a chat completion, or is too large."""

    outcome = Outcome.INVALID
    lost = True

    def __init__(self, message: str, *, raw: str | None = None) -> None:
        super().__init__(message)
        self.raw = raw


class Refused(LlmError):
    """The endpoint rejected the request; repeating it would fail again."""


class AccessRefused(Refused):
    """The key was rejected, or there is no credit left."""


class NotSent(Refused):
    """The operator does not allow the endpoint or the key, or the environment variable holds no key."""


class CallLogMismatch(ServerError):
    """A stored call was made with a different prompt."""


class BadJson(ValueError):
    """Not JSON, or nested too deeply."""


# NaN, Infinity, and integers with too many digits become non-finite numbers, which range checks reject.
_DECODER: Final = json.JSONDecoder(
    parse_constant=lambda name: math.nan if name == "NaN" else math.inf,
    parse_int=lambda digits: int(digits) if len(digits) <= _MAX_DIGITS else math.inf,
)


def decode_json_at(text: str, start: int) -> tuple[object, int]:
    """Decode the untrusted JSON value that begins at an index; return the value and the index of its end.

    Raises:
        BadJson: No valid value begins there.
    """
    try:
        return _DECODER.raw_decode(text, start)
    except (RecursionError, ValueError) as error:
        raise BadJson(f"not JSON: {error}"[:_ERROR_CHARS]) from None


def _decoded(text: str) -> Any:
    """Decode untrusted JSON; None if it is not one value."""
    stripped = text.strip()
    try:
        value, end = decode_json_at(stripped, 0)
    except BadJson:
        return None
    return value if end == len(stripped) else None


def _object(value: Any) -> dict[str, Any]:
    """Return a decoded value if it is an object, and an empty one if it is not."""
    return value if isinstance(value, dict) else {}


@dataclass(frozen=True, slots=True)
class Message:
    """One message of a prompt."""

    role: Literal["system", "user", "assistant"]
    content: str


Messages: TypeAlias = tuple[Message, ...]


@dataclass(frozen=True, slots=True)
class Usage:
    """Tokens used.

    Attributes:
        prompt_tokens: Tokens of prompts.
        completion_tokens: Tokens of replies, including reasoning.
        estimated: Whether any of them is an estimate because the endpoint did not report it.
    """

    prompt_tokens: int = 0
    completion_tokens: int = 0
    estimated: bool = False

    @property
    def total(self) -> int:
        """Tokens of prompts and replies."""
        return self.prompt_tokens + self.completion_tokens

    def __add__(self, other: "Usage") -> "Usage":
        return Usage(
            self.prompt_tokens + other.prompt_tokens,
            self.completion_tokens + other.completion_tokens,
            self.estimated or other.estimated,
        )

    def __mul__(self, count: int) -> "Usage":
        return Usage(self.prompt_tokens * count, self.completion_tokens * count, self.estimated)


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """The content of a chat completion.

    Attributes:
        text: The content; empty if there is none.
        finish_reason: Why the model stopped, in lower case; None if the endpoint does not report it.
        usage: Tokens used; None if the endpoint does not report them.
        refusal: Whether the model or a content filter declined to answer.
        raw: The body that contains it.
    """

    text: str
    finish_reason: str | None
    usage: Usage | None
    refusal: bool
    raw: str = field(repr=False)

    @property
    def truncated(self) -> bool:
        """Whether the model reached the token limit."""
        return self.finish_reason in _TRUNCATED


def canonical(messages: Messages) -> str:
    """Serialise messages canonically."""
    return json.dumps([asdict(message) for message in messages], sort_keys=True, separators=(",", ":"))


def prompt_hash(messages: Messages) -> str:
    """Return the SHA-256 of the canonical messages, in hexadecimal."""
    return hashlib.sha256(canonical(messages).encode()).hexdigest()


def request_body(settings: LlmSettings, messages: Messages, mode: Mode, schema: JsonObject) -> dict[str, Any]:
    """Return the JSON body of a chat completion request.

    Args:
        settings: Model and sampling parameters.
        messages: The prompt.
        mode: How to specify the form of the reply.
        schema: JSON schema of the reply.
    """
    forms: dict[Mode, JsonObject] = {
        Mode.JSON_SCHEMA: {
            "type": "json_schema",
            "json_schema": {"name": "solutions", "strict": True, "schema": schema},
        },
        Mode.SCHEMA_IN_OBJECT: {"type": "json_object", "schema": schema},
        Mode.JSON_OBJECT: {"type": "json_object"},
    }
    return {
        "model": settings.model,
        "messages": [asdict(message) for message in messages],
        "temperature": settings.temperature,
        "top_p": settings.top_p,
        settings.token_field: settings.max_tokens,
        "stream": False,
        **({} if settings.seed is None else {"seed": settings.seed}),
        **({} if mode is Mode.PLAIN else {"response_format": forms[mode]}),
    }


def sanitize(body: bytes, secrets: Sequence[str] = ()) -> str:
    """Decode a body, replacing NUL characters and secrets so that it can be stored."""
    text = body.decode("utf-8", errors="replace").replace("\x00", "\ufffd")
    for secret in secrets:
        for written in (secret, json.dumps(secret)[1:-1], secret.replace("/", "\\/")):
            text = text.replace(written, "[key]")
    return text


def read_reply(raw: str) -> Reply:
    """Parse the body of a 2xx response.

    Raises:
        UnusableReply: It is not a chat completion.
    """
    document = _object(_decoded(raw))
    choices = document.get("choices")
    if not isinstance(choices, list):
        raise UnusableReply(f"expected a chat completion with choices, got {error_text(raw)}", raw=raw)
    first = _object(choices[0] if choices else None)
    message = first.get("message")
    if not isinstance(message, dict):
        raise UnusableReply("expected a chat completion with a message, got one without", raw=raw)
    reason = first.get("finish_reason")
    finish_reason = reason.lower() if isinstance(reason, str) else None
    # With forced JSON, some servers report the answer as reasoning and leave the content empty.
    fields = ("content", "reasoning_content", "reasoning", "thinking")
    return Reply(
        text=next((text for name in fields if (text := _text(message.get(name))).strip()), ""),
        finish_reason=finish_reason,
        usage=_usage(_object(document.get("usage"))),
        refusal=bool(_text(message.get("refusal")).strip()) or finish_reason in _WITHHELD,
        raw=raw,
    )


def _text(content: object) -> str:
    """Return the text of a content field: a string, or a list of parts."""
    if isinstance(content, str):
        return content
    parts = content if isinstance(content, list) else []
    texts = [part.get("text") if isinstance(part, dict) else part for part in parts]
    return "".join(text for text in texts if isinstance(text, str))


def _usage(reported: Mapping[str, Any]) -> Usage | None:
    prompt, completion, total = (
        _tokens(reported.get(name)) for name in ("prompt_tokens", "completion_tokens", "total_tokens")
    )
    if prompt is None:
        return None
    if total is not None:
        # Some endpoints bill reasoning without counting it as completion tokens; the total includes it.
        completion = max(completion or 0, total - prompt)
    return None if completion is None else Usage(prompt, completion)


def _tokens(value: object) -> int | None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= _MAX_TOKENS:
        return None
    return int(value)


def error_text(raw: str) -> str:
    """Return the message of an error body in any of the usual forms, or else its text, on one short line."""
    message = _error_message(_object(_decoded(raw))) or raw
    text = "".join(letter if letter.isprintable() else " " for letter in message[: 8 * _ERROR_CHARS])
    return " ".join(text.split())[:_ERROR_CHARS] or "nothing"


def _error_message(document: Mapping[str, Any]) -> str:
    for name in ("error", "detail", "message"):
        reported = document.get(name)
        if isinstance(reported, dict):
            reported = reported.get("message")
        elif isinstance(reported, list):
            messages = [_object(one).get("msg") for one in reported]
            reported = "; ".join(message for message in messages if isinstance(message, str))
        if isinstance(reported, str) and reported.strip():
            return reported
    return ""


def parse_models(raw: str) -> tuple[str, ...] | None:
    """Return the model names of a model list in any of the usual forms, or None if it is not a list."""
    document = _decoded(raw)
    if isinstance(document, dict):
        document = document.get("data") or document.get("models") or []
    if not isinstance(document, list):
        return None
    names = [
        one.get("id") or one.get("model") or one.get("name") if isinstance(one, dict) else one
        for one in document
    ]
    return tuple(name[:_NAME_CHARS] for name in names if isinstance(name, str))


def parse_retry_after(headers: Mapping[str, str], now: datetime) -> float | None:
    """Return the pause that a Retry-After header requests, in seconds, or None if there is no valid one."""
    value = headers.get("Retry-After", "").strip()
    try:
        seconds = float(value)
    except ValueError:
        try:
            when = parsedate_to_datetime(value)
        except (ValueError, OverflowError):
            return None
        seconds = (when.replace(tzinfo=when.tzinfo or UTC) - now).total_seconds()
    return max(seconds, 0.0) if math.isfinite(seconds) else None


def embedded_status(raw: str) -> int | None:
    """Return the error status in the body of a 2xx response, or None: some gateways put upstream errors there."""
    document = _object(_decoded(raw) if '"error"' in raw else None)
    if document.get("choices"):
        return None
    code = _object(document.get("error")).get("code")
    return code if type(code) is int and 400 <= code <= 599 else None


def error_from(
    status: int, headers: Mapping[str, str], raw: str, settings: LlmSettings, now: datetime
) -> LlmError:
    """Return the error for a response other than 2xx, with advice on what to do.

    Args:
        status: HTTP status.
        headers: HTTP headers.
        raw: The body.
        settings: Settings of the request.
        now: Current time, to which a Retry-After date is relative.
    """
    text = error_text(raw)
    message = f"{settings.endpoint}: HTTP {status}: {text}"
    if status == 402 or (status == 429 and _NO_CREDIT.search(raw)):
        return AccessRefused(f"{message}. There is no credit left")
    if status in _RETRYABLE or (status >= 500 and status != _NOT_IMPLEMENTED):
        pause_s = parse_retry_after(headers, now)
        return EndpointUnavailable(settings.endpoint, f"HTTP {status}", text, retry_after_s=pause_s)
    if status in (401, 403):
        key = settings.api_key_env
        advice = f"Check the key in {key}" if key else "Name the variable with the key in api_key_env"
        return AccessRefused(f"{message}. {advice}")
    if status == 404:
        advice = f"Check that it serves the model {settings.model!r}, and that the path of endpoint is correct (/v1)"
        return Refused(f"{message}. {advice}")
    if 300 <= status < 400:
        message = f"{message}. It redirects: set endpoint to the new address"
    elif settings.token_field == "max_tokens" and "max_completion_tokens" in text:
        message = f"{message}. Set token_field: max_completion_tokens"
    return Refused(message)


def rejects_form(status: int, raw: str, *, proven: bool) -> bool:
    """Return whether a response rejects the requested form of the reply.

    Args:
        status: HTTP status.
        raw: The body.
        proven: Whether the endpoint accepted this form before.
    """
    if status in _FORM_REFUSED and _NAMES_FORM.search(raw[:_SEARCHED_CHARS]):
        return True
    return status in _PROBABLY_FORM and not proven
