"""Between the simulator's values and the wire's messages, both ways.

Everything that JSON cannot carry is refused here, next to the simulator that made it, so that no message is ever
stuck on its way to the coordinator.
"""

import base64
import binascii
import json
from collections.abc import Mapping

from pydantic import ValidationError

from sim.episode import EpisodeResult, EpisodeSpec, Json, Verdict
from worker.errors import UnexpectedReply, UnsendableResult
from worker.wire import Completed, LeasedJob

MESSAGE_LENGTH = 4000
"""Longest message of a failed job on the wire, in characters."""


def episode_spec(job: LeasedJob) -> EpisodeSpec:
    """Return what a leased job asks to run.

    Raises:
        InvalidEpisode: The specification is malformed.
    """
    return EpisodeSpec.from_json(job.spec)


def to_wire(result: EpisodeResult) -> Completed:
    """Return the message that carries a result.

    Raises:
        UnsendableResult: A number is not finite, a value is no JSON, or something is too long.
    """
    _check_json("features", result.features)
    _check_json("provenance", result.provenance)
    try:
        return Completed.model_validate(
            {
                "verdicts": {
                    name: {"robustness": v.robustness, "unit": v.unit, "violated_at_s": v.violated_at_s}
                    for name, v in result.verdicts.items()
                },
                "objectives": dict(result.objectives),
                "features": dict(result.features),
                "provenance": dict(result.provenance),
                "trace": None if result.trace is None else base64.b64encode(result.trace).decode("ascii"),
            }
        )
    except ValidationError as error:
        raise UnsendableResult(_first_complaint(error)) from error


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


def failure_text(message: str, context: str = "") -> str:
    """Return a message and the end of its context, cut to what the wire carries.

    Args:
        message: What happened, in one line.
        context: More lines; the last ones matter most.
    """
    context = context.rstrip().strip("\n")
    if not context:
        return message[:MESSAGE_LENGTH]
    message = message[: MESSAGE_LENGTH // 2]
    return f"{message}\n{context[-(MESSAGE_LENGTH - len(message) - 1) :]}"


def _check_json(name: str, values: Mapping[str, Json]) -> None:
    try:
        json.dumps(dict(values), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise UnsendableResult(f"{name}: {error}") from error


def _first_complaint(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    place = ".".join(str(part) for part in first["loc"])
    return f"{place}: {first['msg']}, got {str(first['input'])[:80]!r}"
