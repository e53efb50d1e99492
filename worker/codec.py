"""Between the simulator's values and the wire's models, on the parent's side."""

import base64
import binascii

from pydantic import TypeAdapter, ValidationError

from brink.sim.episode import EpisodeResult, JsonObject, Verdict
from brink.worker.errors import UnexpectedReply
from brink.worker.outcome_document import failure_text
from brink.worker.wire import Completed, JobFailed, Outcome

_OUTCOME: TypeAdapter[Completed | JobFailed] = TypeAdapter(Outcome)


def outcome_from(document: JsonObject) -> Completed | JobFailed:
    """Return the outcome that a simulation process sent; one that breaks the wire's bounds is a failure."""
    try:
        return _OUTCOME.validate_python(document)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"][1:])
        complaint = f"{place}: {first['msg']}, got {str(first['input'])[:80]!r}"
        return JobFailed(reason="error", message=failure_text(f"the result cannot be sent: {complaint}"))


def from_wire(message: Completed) -> EpisodeResult:
    """Return the result that a message carries.

    Raises:
        UnexpectedReply: The trace is not base64.
    """
    try:
        trace = None if message.trace is None else base64.b64decode(message.trace, validate=True)
    except binascii.Error as error:
        raise UnexpectedReply(f"trace: expected base64: {error}") from error
    return EpisodeResult(
        verdicts={
            name: Verdict(robustness=v.robustness, unit=v.unit, violated_at_s=v.violated_at_s)
            for name, v in message.verdicts.items()
        },
        objectives=dict(message.objectives),
        features=dict(message.features),
        provenance=dict(message.provenance),
        trace=trace,
    )
