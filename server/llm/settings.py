"""Settings of a language model: the ``llm`` section of a campaign file, which never contains the API key.

Error messages never repeat a possible secret: a URL with credentials, an invalid name of an environment variable, a
field that looks like a key.
"""

import re
from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal, Self
from urllib.parse import unquote, urlsplit

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

HIDDEN: Final = "[not shown]"
_PATH: Final = "/chat/completions"
ENV_NAME: Final = re.compile(r"[A-Z_][A-Z0-9_]{0,99}")
"""The name of an environment variable that may hold a key."""
_SECRET_FIELD: Final = re.compile(r"key|token|secret|password|authorization", re.IGNORECASE)


def _hiding(message: str, *location: str) -> ValidationError:
    """Return a validation error that does not contain the input."""
    line = InitErrorDetails(
        type=PydanticCustomError("value_error", "{message}", {"message": message}), loc=location, input=HIDDEN
    )
    return ValidationError.from_exception_data("LlmSettings", [line], hide_input=True)


def _endpoint(given: object) -> object:
    """Validate and normalise a base URL."""
    if not isinstance(given, str):
        return given
    text = given.strip()
    try:
        parts = urlsplit(text)
        _ = parts.port  # raises ValueError if it is out of range
    except ValueError:
        raise _hiding("expected a base URL such as http://127.0.0.1:8000/v1") from None
    if "@" in text or parts.query or parts.fragment:
        raise _hiding(
            "expected a base URL without credentials, query or fragment; name the environment variable with the key "
            "in api_key_env"
        )
    if parts.scheme not in ("http", "https") or not parts.hostname or not re.fullmatch(r"[!-~]+", text):
        raise ValueError("expected a base URL with http or https, such as http://127.0.0.1:8000/v1")
    if "\\" in text or {".", ".."} & set(unquote(parts.path).split("/")):
        # Operators allow URL prefixes; the rest of a URL must not lead out of the allowed prefix.
        raise ValueError("expected a base URL whose path has no '.' or '..' segments, and no backslashes")
    return text.rstrip("/").removesuffix(_PATH)


def _env_name(given: object) -> object:
    """Validate the name of an environment variable without quoting it in errors, as it may be the key itself."""
    if isinstance(given, str) and not ENV_NAME.fullmatch(given):
        raise _hiding(
            "expected the name of an environment variable in capitals, such as OPENAI_API_KEY, not the key itself"
        )
    return given


class LlmSettings(BaseModel):
    """Endpoint, model, sampling parameters and budget."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, hide_input_in_errors=True
    )

    endpoint: Annotated[
        str,
        BeforeValidator(_endpoint),
        Field(
            max_length=2000,
            description="Base URL of an OpenAI-compatible endpoint, such as http://127.0.0.1:8000/v1.",
        ),
    ]
    model: Annotated[str, Field(min_length=1, max_length=200, description="Name of the model.")]
    api_key_env: Annotated[
        str | None,
        BeforeValidator(_env_name),
        Field(description="Environment variable with the API key; without it, no key is sent."),
    ] = None
    temperature: Annotated[float, Field(ge=0, le=2, description="Sampling temperature.")] = 0.8
    top_p: Annotated[float, Field(gt=0, le=1, description="Cumulative probability for nucleus sampling.")] = (
        1.0
    )
    seed: Annotated[int | None, Field(ge=0, lt=2**31, description="Sampling seed; only sent if set.")] = None
    max_tokens: Annotated[
        int,
        Field(
            ge=64,
            le=1_000_000,
            description="Maximum number of tokens in a reply; a solution takes about 200.",
        ),
    ] = 4096
    token_field: Annotated[
        Literal["max_tokens", "max_completion_tokens"],
        Field(description="Request field that limits the tokens of a reply."),
    ] = "max_tokens"
    timeout_s: Annotated[float, Field(gt=0, le=3600, description="Maximum time to wait for a reply.")] = 120.0
    retries: Annotated[
        int, Field(ge=0, le=20, description="Number of retries of a call after the first attempt.")
    ] = 4
    max_wait_s: Annotated[
        float, Field(ge=0, le=3600, description="Maximum pause between attempts, including Retry-After.")
    ] = 120.0
    max_delay_s: Annotated[
        float | None,
        Field(
            gt=0,
            le=86_400,
            exclude_if=lambda given: given is None,  # the hashes of older submissions stay valid
            description="Maximum delay of a campaign by one request for seeds: all tries, pauses and the repair turn "
            "together. By default twice timeout_s, at least 60 s.",
        ),
    ] = None
    max_calls: Annotated[
        int,
        Field(
            ge=1,
            le=1_000_000,
            description="Maximum number of HTTP requests for a campaign, whatever becomes of them.",
        ),
    ] = 50
    max_total_tokens: Annotated[
        int | None,
        Field(
            ge=1, le=10**12, description="Maximum number of tokens for a campaign, in prompts and replies."
        ),
    ] = None
    max_cost: Annotated[
        float | None,
        Field(gt=0, le=10**9, description="Maximum cost of a campaign, in the currency of the prices."),
    ] = None
    input_price: Annotated[
        float | None, Field(ge=0, le=10**6, description="Price per million prompt tokens.")
    ] = None
    output_price: Annotated[
        float | None, Field(ge=0, le=10**6, description="Price per million completion tokens.")
    ] = None

    @model_validator(mode="before")
    @classmethod
    def _no_keys(cls, given: Any) -> Any:
        """Reject a key without quoting it in the error."""
        if isinstance(given, Mapping):
            for name in given:
                if name not in cls.model_fields and _SECRET_FIELD.search(str(name)):
                    raise _hiding(
                        "unknown field; a campaign must not contain a key: name the environment variable that "
                        "holds it in api_key_env",
                        str(name)[:40],
                    )
        return given

    @model_validator(mode="after")
    def _priced(self) -> Self:
        if self.max_cost is not None and not self.priced:
            missing = [name for name in ("input_price", "output_price") if getattr(self, name) is None]
            raise _hiding(
                f"expected {' and '.join(missing)} too: without prices the cost is unknown and cannot be limited",
                "max_cost",
            )
        return self

    @property
    def delay_limit_s(self) -> float:
        """Maximum delay of a campaign by one request for seeds."""
        return max(60.0, 2 * self.timeout_s) if self.max_delay_s is None else self.max_delay_s

    @property
    def on_this_machine(self) -> bool:
        """Whether the endpoint runs on this machine."""
        from brink.server.settings import (
            LOOPBACK,  # loads pydantic-settings, which is not needed for reading a campaign file
        )

        return urlsplit(self.endpoint).hostname in LOOPBACK

    @property
    def priced(self) -> bool:
        """Whether both prices are known."""
        return self.input_price is not None and self.output_price is not None
