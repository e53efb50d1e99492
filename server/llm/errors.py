"""Errors of the language model's side.

ServerError
├── LlmError                     no answer that can be used
│   ├── EndpointAway             retryable: no answer, cut off, timed out, 408, 409, 425, 429, 5xx
│   └── LlmFinal                 the same call will fail again
│       ├── KeyMissing           the environment variable that is to hold the key is not set
│       ├── OverBudget           a budget does not allow another request
│       ├── UnusableReply        2xx, but no chat completion, or one larger than allowed
│       └── Refused              the endpoint refused the request
│           ├── AccessRefused    401, 402, 403, or a 429 that says that there is no credit
│           ├── ModelUnknown     404
│           └── RequestRefused   any other 4xx, 501, a redirect
└── CallLogMismatch              a stored call was made with another prompt; never hidden

None of them carries the key: what an endpoint says is cleared of it before it is quoted.
"""

from dataclasses import dataclass
from typing import Final

from brink.server.errors import ServerError


@dataclass(frozen=True, slots=True, kw_only=True)
class Effort:
    """What a call took.

    Attributes:
        requests: HTTP requests sent.
        lost: Of those, the ones that the endpoint may have worked on, and billed, without a usable answer.
        elapsed_s: From the first request to the end, waits included.
    """

    requests: int = 0
    lost: int = 0
    elapsed_s: float = 0.0


NO_EFFORT: Final = Effort()


class LlmError(ServerError):
    """No answer that can be used.

    Attributes:
        effort: What was tried until then.
    """

    def __init__(self, message: str) -> None:
        super().__init__(message)
        self.effort = NO_EFFORT


class EndpointAway(LlmError):
    """The endpoint did not answer, or asked to be left alone for a while.

    Attributes:
        retry_after_s: How long it asked to wait, or None.
        lost: Whether it may have worked on the request.
    """

    def __init__(self, message: str, *, retry_after_s: float | None = None, lost: bool = False) -> None:
        super().__init__(message)
        self.retry_after_s = retry_after_s
        self.lost = lost


class LlmFinal(LlmError):
    """The same call will fail again."""


class KeyMissing(LlmFinal):
    """The environment variable that is to hold the key is not set, or holds no key."""


class OverBudget(LlmFinal):
    """A budget does not allow another request."""


class UnusableReply(LlmFinal):
    """What came is no chat completion, or is larger than allowed.

    Attributes:
        raw: The reply, or None if it was cut off.
    """

    def __init__(self, message: str, *, raw: str | None = None) -> None:
        super().__init__(message)
        self.raw = raw


class Refused(LlmFinal):
    """The endpoint refused the request.

    Attributes:
        status: HTTP status.
        said: What it said, on one line.
    """

    def __init__(self, message: str, *, status: int, said: str) -> None:
        super().__init__(message)
        self.status = status
        self.said = said


class AccessRefused(Refused):
    """The key is refused, or there is no credit."""


class ModelUnknown(Refused):
    """There is no such model, or no such path."""


class RequestRefused(Refused):
    """The endpoint does not take the request as it is."""


class CallLogMismatch(ServerError):
    """A stored call was made with another prompt than the one that is wanted now."""
