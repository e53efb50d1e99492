"""The wire of an OpenAI-compatible ``/chat/completions`` endpoint: what is sent, and how replies are read.

Servers differ: usage and finish_reason may be missing, content may be a list of parts or null, thoughts may come
beside it. Everything here is pure and takes whatever comes.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any, Final, Literal, TypeAlias

from brink.server.llm.errors import UnusableReply
from brink.server.llm.settings import LlmSettings
from brink.server.llm.untrusted_json import BadJson, decoded

JsonObject: TypeAlias = Mapping[str, Any]

_SCHEMA_NAME: Final = "solutions"
_CUT_SHORT: Final = frozenset({"length", "max_tokens", "model_length", "max_output_tokens"})
_WITHHELD: Final = frozenset({"content_filter", "safety", "refusal", "recitation"})
_MOST_TOKENS: Final = 10**9
_SAID_CHARS: Final = 300
_NAME_CHARS: Final = 200


class Mode(StrEnum):
    """How the form of a reply is asked for, the strictest first.

    The second is what llama-cpp-python and some hosted endpoints take instead of the first: a JSON object's schema.
    """

    JSON_SCHEMA = "json_schema"
    SCHEMA_IN_OBJECT = "schema_in_object"
    JSON_OBJECT = "json_object"
    PLAIN = "plain"

    @property
    def looser(self) -> "Mode | None":
        """The next mode to try, or None after the last."""
        modes = list(Mode)
        place = modes.index(self) + 1
        return modes[place] if place < len(modes) else None


@dataclass(frozen=True, slots=True)
class Message:
    """One message of a prompt."""

    role: Literal["system", "user", "assistant"]
    content: str


Messages: TypeAlias = tuple[Message, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Usage:
    """Tokens of a call.

    Attributes:
        prompt_tokens: Of the prompt.
        completion_tokens: Of the reply, thoughts included.
        estimated: Whether any of them is an estimate, because the endpoint did not say.
    """

    prompt_tokens: int
    completion_tokens: int
    estimated: bool = False

    @property
    def total(self) -> int:
        """Both together."""
        return self.prompt_tokens + self.completion_tokens


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """What a reply says.

    Attributes:
        text: The content; empty if there is none.
        finish_reason: Why the model stopped, in lower case; None if the endpoint does not say.
        usage: Tokens, or None if the endpoint does not say.
        refusal: Whether the model, or a filter, declined to answer.
    """

    text: str
    finish_reason: str | None
    usage: Usage | None
    refusal: bool

    @property
    def cut_short(self) -> bool:
        """Whether the model ran into the limit of tokens."""
        return self.finish_reason in _CUT_SHORT


def canonical(messages: Messages) -> str:
    """Return messages as text, the same for the same messages."""
    return json.dumps([asdict(message) for message in messages], sort_keys=True, separators=(",", ":"))


def prompt_hash(messages: Messages) -> str:
    """Return a hash by which the same prompt is known again."""
    return hashlib.sha256(canonical(messages).encode()).hexdigest()


def request_body(settings: LlmSettings, messages: Messages, mode: Mode, schema: JsonObject) -> dict[str, Any]:
    """Return the body of a request."""
    body: dict[str, Any] = {
        "model": settings.model,
        "messages": [asdict(message) for message in messages],
        "temperature": settings.temperature,
        "top_p": settings.top_p,
        settings.token_field: settings.max_tokens,
        "stream": False,
    }
    if settings.seed is not None:
        body["seed"] = settings.seed
    if mode is Mode.JSON_SCHEMA:
        named = {"name": _SCHEMA_NAME, "strict": True, "schema": schema}
        body["response_format"] = {"type": "json_schema", "json_schema": named}
    elif mode is Mode.SCHEMA_IN_OBJECT:
        body["response_format"] = {"type": "json_object", "schema": schema}
    elif mode is Mode.JSON_OBJECT:
        body["response_format"] = {"type": "json_object"}
    return body


def clean(body: bytes, secrets: Sequence[str] = ()) -> str:
    """Return the text of a body, which can be stored: without NUL, without secrets."""
    text = body.decode("utf-8", errors="replace").replace("\x00", "\ufffd")
    for secret in secrets:
        for written in (secret, json.dumps(secret)[1:-1], secret.replace("/", "\\/")):
            text = text.replace(written, "[key]")
    return text


def read_reply(raw: str) -> Reply:
    """Read the body of a 2xx answer.

    Raises:
        UnusableReply: It is no chat completion.
    """
    try:
        document = decoded(raw)
    except BadJson as error:
        raise UnusableReply(f"expected a chat completion, got no JSON ({error})", raw=raw) from None
    choices = document.get("choices") if isinstance(document, dict) else None
    if not isinstance(document, dict) or not isinstance(choices, list):
        raise UnusableReply(f"expected a chat completion with choices, got {said(raw)}", raw=raw)
    first = choices[0] if choices else None
    message = first.get("message") if isinstance(first, dict) else None
    if not isinstance(first, dict) or not isinstance(message, dict):
        raise UnusableReply("expected a chat completion with a message, got one without", raw=raw)
    reason = first.get("finish_reason")
    finish_reason = reason.lower() if isinstance(reason, str) else None
    # With forced JSON some servers take the answer itself for a thought, and leave the content empty.
    fields = ("content", "reasoning_content", "reasoning", "thinking")
    text = next((text for name in fields if (text := _text(message.get(name))).strip()), "")
    return Reply(
        text=text,
        finish_reason=finish_reason,
        usage=_usage(document.get("usage")),
        refusal=bool(_text(message.get("refusal")).strip()) or finish_reason in _WITHHELD,
    )


def _text(content: object) -> str:
    """Return the text of a content: a string, or a list of parts."""
    if isinstance(content, str):
        return content
    if not isinstance(content, list):
        return ""
    parts = [part.get("text") if isinstance(part, dict) else part for part in content]
    return "".join(part for part in parts if isinstance(part, str))


def _usage(stated: object) -> Usage | None:
    if not isinstance(stated, dict):
        return None
    prompt, completion, total = (
        _tokens(stated.get(name)) for name in ("prompt_tokens", "completion_tokens", "total_tokens")
    )
    if prompt is None:
        return None
    if total is not None:
        # Where thoughts are billed but not counted among the completion's tokens, the total has them.
        completion = max(completion or 0, total - prompt)
    if completion is None:
        return None
    return Usage(prompt_tokens=prompt, completion_tokens=completion)


def _tokens(stated: object) -> int | None:
    if isinstance(stated, bool) or not isinstance(stated, int | float) or not 0 <= stated <= _MOST_TOKENS:
        return None
    return int(stated)


def said(raw: str) -> str:
    """Return what an error body says, on one short line: the message in any of the usual forms, or the text."""
    try:
        document = decoded(raw)
    except BadJson:
        document = None
    words = _message(document) if isinstance(document, dict) else ""
    text = "".join(letter if letter.isprintable() else " " for letter in (words or raw)[: 8 * _SAID_CHARS])
    return " ".join(text.split())[:_SAID_CHARS] or "nothing"


def _message(document: dict[str, Any]) -> str:
    for name in ("error", "detail", "message"):
        found = document.get(name)
        if isinstance(found, dict):
            found = found.get("message")
        elif isinstance(found, list):
            messages = [one.get("msg") for one in found if isinstance(one, dict)]
            found = "; ".join(message for message in messages if isinstance(message, str))
        if isinstance(found, str) and found.strip():
            return found
    return ""


def listed_models(raw: str) -> tuple[str, ...] | None:
    """Return the models of a list in any of the usual forms; None if it is no list."""
    try:
        document: Any = decoded(raw)
    except BadJson:
        return None
    if isinstance(document, dict):
        document = next((document[name] for name in ("data", "models") if document.get(name)), [])
    if not isinstance(document, list):
        return None
    names = (
        next((one[name] for name in ("id", "model", "name") if one.get(name)), None)
        if isinstance(one, dict)
        else one
        for one in document
    )
    return tuple(name[:_NAME_CHARS] for name in names if isinstance(name, str))
