"""The settings of a coordinator, from environment variables (``BRINK_…``) and the command line."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, SecretStr, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from brink.server.errors import TOKEN_FORM
from brink.worker.log import LogFormat, LogLevel

DEFAULT_DATABASE = "sqlite:///brink.db"
LOOPBACK = ("127.0.0.1", "::1", "localhost")
"""Host names that no other machine can reach."""


class Settings(BaseSettings):
    """All settings of a coordinator."""

    model_config = SettingsConfigDict(env_prefix="BRINK_", frozen=True, extra="ignore")

    database: Annotated[str, Field(description="SQLAlchemy URL: sqlite:///FILE or postgresql://…")] = (
        DEFAULT_DATABASE
    )
    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 8700
    token: Annotated[
        SecretStr | None,
        Field(description="Bearer token that every request must carry; not needed on loopback."),
    ] = None
    lease_s: Annotated[float, Field(gt=0, le=3600, description="Duration of a lease.")] = 60.0
    retry_backoff_s: Annotated[
        float,
        Field(ge=0, le=3600, description="Delay before the first retry of a job; doubles with each attempt."),
    ] = 1.0
    sweep_s: Annotated[float, Field(gt=0, le=60, description="Interval between two sweeps.")] = 1.0
    worker_seen_s: Annotated[
        float, Field(gt=0, description="A worker without contact for this long counts as gone.")
    ] = 45.0
    max_body_bytes: Annotated[int, Field(gt=0)] = 64 * 1024 * 1024
    stall_s: Annotated[
        float,
        Field(
            gt=0,
            le=3600,
            description="Time limit for receiving a request, plus a second for each 10 kB of its body.",
        ),
    ] = 30.0
    read_limit_s: Annotated[
        float, Field(gt=0, le=3600, description="Time limit of a costly read, including its wait for others.")
    ] = 20.0
    max_stored_distances: Annotated[
        int, Field(ge=0, description="Number of solutions above which distances are not stored.")
    ] = 2_000
    rate_limit: Annotated[
        float, Field(ge=0, description="Requests per second allowed for each token; 0 for no limit.")
    ] = 1000.0
    plugin_timeout_s: Annotated[
        float,
        Field(
            gt=0,
            le=86_400,
            description="Time limit for each call of a plug-in's code; a campaign whose plug-in exceeds it pauses.",
        ),
    ] = 60.0
    live_searches_mib: Annotated[
        int,
        Field(
            ge=0,
            description="Memory for the searches of running campaigns, in MiB; the others are read again when their "
            "next generation is complete.",
        ),
    ] = 1024
    llm_endpoints: Annotated[
        str,
        Field(
            description="Language models that campaigns may use: base URLs separated by commas, each followed by "
            "the environment variables whose keys may be sent there, or * for any without a key. By default only "
            "models on this machine, without a key."
        ),
    ] = ""
    log_level: Annotated[LogLevel, Field(description="Minimum severity of log lines.")] = LogLevel.INFO
    log_format: Annotated[LogFormat, Field(description="Log lines as text or as JSON.")] = LogFormat.TEXT
    access_log: Annotated[bool, Field(description="Log every request at level info instead of debug.")] = (
        False
    )

    @field_validator("log_level", "log_format", mode="before")
    @classmethod
    def _in_any_case(cls, given: object) -> object:
        return given.lower() if isinstance(given, str) else given

    @field_validator("token")
    @classmethod
    def _fits_a_header(cls, token: SecretStr | None) -> SecretStr | None:
        """Check the token; an empty one counts as unset.

        Raises:
            ValueError: The token contains characters that do not fit into a header.
        """
        text = token.get_secret_value() if token is not None else ""
        if not all("!" <= letter <= "~" for letter in text):
            raise ValueError(TOKEN_FORM)
        return token if text else None

    @property
    def sqlite_file(self) -> Path | None:
        """The database file, or None if the database is not SQLite."""
        prefix = "sqlite:///"
        return Path(self.database.removeprefix(prefix)) if self.database.startswith(prefix) else None

    def allowing(self, endpoints: Iterable[str]) -> Self:
        """Return settings that also allow some language models, without a key.

        Args:
            endpoints: Base URLs that a file names which its user runs on this machine.
        """
        allowed = ",".join(filter(None, [self.llm_endpoints, *endpoints]))
        return self.model_copy(update={"llm_endpoints": allowed})
