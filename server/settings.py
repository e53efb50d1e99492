"""Settings of a coordinator, from the environment (``BRINK_…``) and the command line."""

from pathlib import Path
from typing import Annotated

from pydantic import Field, SecretStr, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from brink.server.errors import TOKEN_FORM
from brink.worker.log import LogFormat, LogLevel

DEFAULT_DATABASE = "sqlite:///brink.db"
LOOPBACK = ("127.0.0.1", "::1", "localhost")
"""Names of this machine that no other one can reach."""


class Settings(BaseSettings):
    """Everything that a coordinator can be told."""

    model_config = SettingsConfigDict(env_prefix="BRINK_", frozen=True, extra="ignore")

    database: Annotated[str, Field(description="SQLAlchemy URL: sqlite:///FILE or postgresql://…")] = (
        DEFAULT_DATABASE
    )
    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 8700
    token: Annotated[
        SecretStr | None, Field(description="Bearer token that every request must carry; none on loopback.")
    ] = None
    lease_s: Annotated[float, Field(gt=0, le=3600, description="How long a lease holds.")] = 60.0
    retry_backoff_s: Annotated[
        float, Field(ge=0, le=3600, description="Wait before the first retry of a job; doubles each time.")
    ] = 1.0
    sweep_s: Annotated[float, Field(gt=0, le=60, description="Pause between two sweeps.")] = 1.0
    worker_seen_s: Annotated[
        float, Field(gt=0, description="A worker not heard of for this long counts as gone.")
    ] = 45.0
    max_body_bytes: Annotated[int, Field(gt=0)] = 64 * 1024 * 1024
    stall_s: Annotated[
        float,
        Field(
            gt=0,
            le=3600,
            description="How long a request may take to come; its body a second more for each 10 kB.",
        ),
    ] = 30.0
    max_stored_distances: Annotated[
        int, Field(ge=0, description="Solutions past which distance blocks are no longer stored.")
    ] = 20_000
    rate_limit: Annotated[
        float, Field(ge=0, description="Requests a second that one token may make; 0 for no limit.")
    ] = 1000.0
    llm_endpoints: Annotated[
        str,
        Field(
            description="Where campaigns may ask language models: base URLs, separated by commas; * for any. "
            "Without it: this machine alone, and without a key."
        ),
    ] = ""
    log_level: Annotated[LogLevel, Field(description="Least severe lines of the log.")] = LogLevel.INFO
    log_format: Annotated[LogFormat, Field(description="Lines of text, or of JSON.")] = LogFormat.TEXT
    access_log: Annotated[bool, Field(description="Log every request, not only in a log of level debug.")] = (
        False
    )

    @field_validator("log_level", "log_format", mode="before")
    @classmethod
    def _in_any_case(cls, given: object) -> object:
        return given.lower() if isinstance(given, str) else given

    @field_validator("token")
    @classmethod
    def _fits_a_header(cls, token: SecretStr | None) -> SecretStr | None:
        """Take an empty token for what it is: no token, with which nobody may listen to other machines."""
        text = token.get_secret_value() if token is not None else ""
        if not all("!" <= letter <= "~" for letter in text):
            raise ValueError(TOKEN_FORM)
        return token if text else None

    @property
    def sqlite_file(self) -> Path | None:
        """The database file, if the database is one."""
        prefix = "sqlite:///"
        return Path(self.database.removeprefix(prefix)) if self.database.startswith(prefix) else None
