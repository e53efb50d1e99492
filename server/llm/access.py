"""Which language models may be contacted, and which keys may be sent there: the setting ``BRINK_LLM_ENDPOINTS``.

A campaign names an endpoint and an environment variable, and may come from anybody: through the API, from a file,
from a database that somebody else filled. Without a rule, whoever writes it could send any variable of this process
to any address. So a key is sent only where the operator pairs its variable with a base URL, and nothing at all is
sent to endpoints that are neither listed nor on this machine. The rule is checked when a campaign is submitted or
imported, and again for every request: `LlmClient` gets keys from here alone.
"""

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final, Self

from pydantic import SecretStr

from brink.server.errors import InvalidInput
from brink.server.llm.protocol import NotSent
from brink.server.llm.settings import ENV_NAME, LlmSettings

VARIABLE: Final = "BRINK_LLM_ENDPOINTS"
_ANY: Final = "*"
_BASE_URL: Final = re.compile(r"https?://[^\s/?#@\\,]+(/[^\s?#@\\,]*)?")


@dataclass(frozen=True, slots=True)
class _Allowed:
    """An allowed base URL (`_ANY` allows all) and the environment variables whose keys may be sent there."""

    base: str
    keys: frozenset[str]

    def covers(self, endpoint: str) -> bool:
        return self.base == _ANY or f"{endpoint}/".startswith(f"{self.base}/")


@dataclass(frozen=True, slots=True)
class LlmAccess:
    """The language models and keys that campaigns may use; without rules, models on this machine without a key.

    Attributes:
        environ: The environment with the keys, read anew for every request.
    """

    _allowed: tuple[_Allowed, ...] = ()
    environ: Mapping[str, str] = field(default_factory=lambda: os.environ, repr=False)

    @classmethod
    def parse(cls, text: str, environ: Mapping[str, str] | None = None) -> Self:
        """Parse the setting into rules.

        Args:
            text: Entries separated by commas: a base URL, followed by the names of the environment variables whose
                keys may be sent there, or ``*`` for all endpoints without a key.
            environ: The environment with the keys; that of this process if None.

        Raises:
            InvalidInput: An entry is malformed.
        """
        return cls(tuple(_entries(text)), os.environ if environ is None else environ)

    def refusal(self, settings: LlmSettings) -> tuple[str, str] | None:
        """Return why a language model may not be used with its key, as a field and a message; None if it may."""
        endpoint, key = settings.endpoint, settings.api_key_env
        matching = [one for one in self._allowed if one.covers(endpoint)]
        setting = f"its operator can allow that with {VARIABLE}='{endpoint}{f' {key}' if key else ''}'"
        if not matching and not settings.on_this_machine:
            known = ", ".join(one.base for one in self._allowed) or "models on its own machine, without a key"
            return "endpoint", f"this coordinator may use {known}, not {endpoint}; {setting}"
        if key is not None and not any(key in one.keys for one in matching):
            return "api_key_env", f"this coordinator may not send the key in {key} to {endpoint}; {setting}"
        return None

    def check(self, settings: LlmSettings | None) -> None:
        """Check the language model of a campaign; None if it has none.

        Raises:
            InvalidInput: It may not be used, or not with its key.
        """
        refusal = None if settings is None else self.refusal(settings)
        if refusal is not None:
            raise InvalidInput.at(f"/llm/{refusal[0]}", refusal[1])

    def key(self, settings: LlmSettings) -> SecretStr | None:
        """Return the key to send with a request; None if the settings name none.

        Raises:
            NotSent: The endpoint may not be used, or not with this key, or the variable holds no valid key.
        """
        if (refusal := self.refusal(settings)) is not None:
            raise NotSent(refusal[1])
        name = settings.api_key_env
        if name is None:
            return None
        key = self.environ.get(name, "").strip()
        if not key:
            raise NotSent(
                f"the environment variable {name} is not set: export it before the coordinator starts"
            )
        if not all("!" <= letter <= "~" for letter in key):
            raise NotSent(
                f"the environment variable {name} holds no key: expected printable ASCII, no spaces"
            )
        return SecretStr(key)


def _entries(text: str) -> Iterator[_Allowed]:
    for entry in text.split(","):
        base, *keys = entry.split() or [""]
        if not base:
            continue
        if base != _ANY and not _BASE_URL.fullmatch(base):
            raise InvalidInput.at(
                VARIABLE, "expected base URLs such as https://api.example.com/v1, without credentials, or *"
            )
        if base == _ANY and keys:
            raise InvalidInput.at(VARIABLE, "expected no key after *, which would be sent to any address")
        if not all(ENV_NAME.fullmatch(key) for key in keys):
            raise InvalidInput.at(
                VARIABLE,
                f"expected the names of environment variables in capitals after {base}, such as OPENAI_API_KEY, not "
                "the keys themselves",
            )
        yield _Allowed(base.rstrip("/"), frozenset(keys))
