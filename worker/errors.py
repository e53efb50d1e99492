"""Errors of the worker package.

WorkerError
├── SettingsError              final: a setting is out of range or malformed
├── CoordinatorError
│   ├── CoordinatorUnavailable retryable: no response, 5xx, 408 or 429; the same request may succeed later
│   ├── RequestRefused         final: 4xx; the same request will be refused again
│   └── UnexpectedReply        final: the server does not speak this version of the wire protocol
├── NoCluster                  final: there is no Ray cluster at this address
├── ChildFailedToStart         retryable: the simulation process did not start
├── EpisodeAbandoned           final: the episode was killed on request; there is no outcome
├── UnserializableResult       final: a simulator returned a value that JSON cannot represent
└── BrokenFrame                final: the pipe to the simulation process carries something other than frames
"""


class WorkerError(Exception):
    """Base class of all errors that the worker package raises deliberately."""


class SettingsError(WorkerError, ValueError):
    """A setting is out of range or malformed.

    Attributes:
        field: Name of the setting.
    """

    def __init__(self, field: str, message: str) -> None:
        super().__init__(f"{field}: {message}")
        self.field = field


class CoordinatorError(WorkerError):
    """A request to the coordinator failed."""


class CoordinatorUnavailable(CoordinatorError):
    """The coordinator did not respond, or asked the worker to retry later.

    Attributes:
        retry_after_s: Requested wait, or None.
        status: HTTP status, or None if there was no response.
    """

    def __init__(
        self, message: str, *, retry_after_s: float | None = None, status: int | None = None
    ) -> None:
        super().__init__(message)
        self.retry_after_s = retry_after_s
        self.status = status


class RequestRefused(CoordinatorError):
    """The coordinator refused a request.

    Attributes:
        status: HTTP status, 400 to 499.
    """

    def __init__(self, message: str, *, status: int) -> None:
        super().__init__(message)
        self.status = status


class UnexpectedReply(CoordinatorError):
    """The server does not speak this version of the wire protocol."""


class NoCluster(WorkerError):
    """There is no Ray cluster at this address, or it refused the connection."""


class ChildFailedToStart(WorkerError):
    """The simulation process did not start."""


class EpisodeAbandoned(WorkerError):
    """The episode was killed on request: there is no outcome.

    Attributes:
        ticket: Ticket of the episode, or None if the whole process was killed.
    """

    def __init__(self, ticket: int | None) -> None:
        super().__init__("the episode was abandoned")
        self.ticket = ticket


class UnserializableResult(WorkerError):
    """A simulator returned a value that JSON cannot represent, such as NaN."""


class BrokenFrame(WorkerError):
    """The pipe to the simulation process carries something other than frames."""


def no_token_words(server: str, *, given: bool, scope: str) -> str:
    """Return why a coordinator answers a request with 401, and what to do.

    Args:
        server: Address of the coordinator.
        given: Whether the request carried a token.
        scope: Scope that a new token needs.
    """
    create = f"one that this prints, on the coordinator's database: brink token create NAME --scope {scope}"
    if given:
        return (
            f"token rejected: the coordinator at {server} does not know it, or it was revoked or has expired; "
            f"set the environment variable BRINK_TOKEN to {create}"
        )
    return (
        f"the coordinator at {server} requires a token: set the environment variable BRINK_TOKEN to the one that it "
        f"was started with, or to {create}"
    )
