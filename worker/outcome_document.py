"""What came of an episode, as the JSON object that goes on the wire.

Made in the simulation process, next to the simulator that is to blame for what JSON cannot carry. The models of
`brink.worker.wire` are left to the parent: importing them would cost every simulation process 11 MB.
"""

import base64
import json
import math
from collections.abc import Mapping

from brink.sim.episode import EpisodeResult, Json, JsonObject
from brink.worker.errors import UnsendableResult

MESSAGE_LENGTH = 4000
"""Longest message of a failed job on the wire, in characters."""


def completed(result: EpisodeResult) -> JsonObject:
    """Return the `brink.worker.wire.Completed` that carries a result, as JSON.

    Raises:
        UnsendableResult: A number is not finite, or a value is no JSON.
    """
    return {
        "kind": "completed",
        "verdicts": {
            name: {
                "robustness": _number(f"verdicts.{name}.robustness", v.robustness),
                "unit": v.unit,
                "violated_at_s": None
                if v.violated_at_s is None
                else _number(f"verdicts.{name}.violated_at_s", v.violated_at_s),
            }
            for name, v in result.verdicts.items()
        },
        "objectives": {name: _number(f"objectives.{name}", x) for name, x in result.objectives.items()},
        "features": _json("features", result.features),
        "provenance": _json("provenance", result.provenance),
        "trace": None if result.trace is None else base64.b64encode(result.trace).decode("ascii"),
    }


def failed(reason: str, message: str, context: str = "") -> JsonObject:
    """Return a `brink.worker.wire.JobFailed` as JSON, its text cut to what the wire carries."""
    return {"kind": "failed", "reason": reason, "message": failure_text(message, context)}


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


def _number(place: str, value: object) -> float:
    try:
        number = float(value)  # type: ignore[arg-type]  # a simulator may return anything that is a number
    except (TypeError, ValueError) as error:
        raise UnsendableResult(f"{place}: expected a number, got {str(value)[:80]!r}") from error
    if not math.isfinite(number):
        raise UnsendableResult(f"{place}: expected a finite number, got {number}")
    return number


def _json(place: str, values: Mapping[str, Json]) -> JsonObject:
    values = dict(values)
    try:
        json.dumps(values, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise UnsendableResult(f"{place}: {error}") from error
    return values
