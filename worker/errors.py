"""Errors of the worker package.

WorkerError
├── SettingsError           final: a setting is out of range or malformed
├── CoordinatorError
│   ├── CoordinatorAway     retryable: no answer, 5xx or 429; the same request may work later
│   ├── RequestRefused      final: 4xx; the same request will be refused again
│   └── UnexpectedReply     final: what answered does not speak this version of the wire
├── NoCluster               final: there is no Ray cluster at this address
├── ChildFailedToStart      retryable: the simulation process did not come up
├── EpisodeAbandoned        final: the episode was given up on purpose, there is no outcome
├── UnsendableResult        final: a simulator returned what JSON cannot carry
└── BrokenFrame             final: the pipe to the simulation process carries something else than frames
"""


class WorkerError(Exception):
    """Root of everything that the worker package raises on purpose."""


class SettingsError(WorkerError, ValueError):
    """A setting is out of range or malformed.

    Attributes:
        field: Name of the setting.
    """

    def __init__(self, field: str, message: str) -> None:
        super().__init__(f"{field}: {message}")
        self.field = field


class CoordinatorError(WorkerError):
    """A request to the coordinator did not succeed."""


class CoordinatorAway(CoordinatorError):
    """The coordinator did not answer, or asked to be left alone for a while.

    Attributes:
        retry_after_s: How long it asked to wait, or None.
    """

    def __init__(self, message: str, *, retry_after_s: float | None = None) -> None:
        super().__init__(message)
        self.retry_after_s = retry_after_s


class RequestRefused(CoordinatorError):
    """The coordinator refused a request.

    Attributes:
        status: HTTP status, 400 to 499.
    """

    def __init__(self, message: str, *, status: int) -> None:
        super().__init__(message)
        self.status = status


class UnexpectedReply(CoordinatorError):
    """What answered does not speak this version of the wire."""


class NoCluster(WorkerError):
    """There is no Ray cluster at this address, or it does not let us in."""


class ChildFailedToStart(WorkerError):
    """The simulation process did not come up."""


class EpisodeAbandoned(WorkerError):
    """The episode was given up on purpose: there is no outcome.

    Attributes:
        ticket: The ticket of that episode, or None if the process was closed altogether.
    """

    def __init__(self, ticket: int | None) -> None:
        super().__init__("the episode was given up")
        self.ticket = ticket


class UnsendableResult(WorkerError):
    """A simulator returned what JSON cannot carry, such as NaN."""


class BrokenFrame(WorkerError):
    """The pipe to the simulation process carries something else than frames."""
