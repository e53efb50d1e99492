"""The wire form of solutions: its JSON schema, how solutions are written in it, and how an item is read.

An item is checked for shape, ranges, and actions that fit; whether the road has room for it is `drivable`'s to say.
Errors never quote text of an item, only finite numbers: what a model wrote goes into no later prompt.
"""

import json
import math
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Annotated, Any, Final

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from brink.search.traffic.participants import (
    MAGNITUDES,
    MAX_ACTIONS,
    MAX_DURATION_S,
    MAX_SPEEDS_MPS,
    MIN_ACTIONS,
    MIN_DURATION_S,
    PEDESTRIAN_ACTIONS,
    REACH_M,
    VEHICLE_ACTIONS,
    Action,
    Gene,
    Kind,
    Participant,
    Solution,
)
from brink.server.errors import FieldError

ERRORS_AN_ITEM: Final = 4
"""More errors of one item are not listed."""


class Heading(StrEnum):
    """Where somebody looks at the start."""

    WITH_EGO = "with_ego"
    ONCOMING = "oncoming"
    ACROSS = "across"


def heading_of(dyaw_rad: float) -> Heading:
    """Return the word for a heading relative to the ego's lane."""
    if abs(math.cos(dyaw_rad)) < 0.5:
        return Heading.ACROSS
    return Heading.WITH_EGO if math.cos(dyaw_rad) > 0 else Heading.ONCOMING


def _object(**properties: Any) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


def _list(items: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}


def _words(choices: type[StrEnum]) -> dict[str, Any]:
    return {"type": "string", "enum": [choice.value for choice in choices]}


_NUMBER: Final = {"type": "number"}
SCHEMA: Final[Mapping[str, Any]] = _object(
    solutions=_list(
        _object(
            participants=_list(
                _object(
                    kind=_words(Kind),
                    ds_m=_NUMBER,
                    dd_m=_NUMBER,
                    heading=_words(Heading),
                    speed_mps=_NUMBER,
                    actions=_list(_object(action=_words(Action), duration_s=_NUMBER, magnitude=_NUMBER)),
                )
            )
        )
    )
)
"""Objects, arrays, enums and numbers alone: all that endpoints with forced schemas have in common."""


class _Form(BaseModel):
    """Base of what a model writes. Fields that nobody asked for are dropped."""

    model_config = ConfigDict(strict=True, frozen=True, extra="ignore", allow_inf_nan=False)


class _ActionForm(_Form):
    action: Annotated[Action, Field(strict=False)]
    duration_s: Annotated[float, Field(ge=MIN_DURATION_S, le=MAX_DURATION_S)]
    magnitude: float


class _ParticipantForm(_Form):
    kind: Annotated[Kind, Field(strict=False)]
    ds_m: Annotated[float, Field(ge=-REACH_M, le=REACH_M)]
    dd_m: Annotated[float, Field(ge=-REACH_M, le=REACH_M)]
    heading: Annotated[Heading, Field(strict=False)]
    speed_mps: Annotated[float, Field(ge=0.0)]
    actions: Annotated[list[_ActionForm], Field(min_length=MIN_ACTIONS, max_length=MAX_ACTIONS)]


class _SolutionForm(_Form):
    participants: Annotated[list[_ParticipantForm], Field(min_length=1)]


def _of(choices: type[StrEnum]) -> str:
    *first, last = choices
    return f"{', '.join(first)} or {last}"


_EXPECTED: Final[Mapping[str, str]] = {
    "participants": "a list of participants",
    "kind": _of(Kind),
    "ds_m": f"a number from {-REACH_M:g} to {REACH_M:g} (m)",
    "dd_m": f"a number from {-REACH_M:g} to {REACH_M:g} (m)",
    "heading": _of(Heading),
    "speed_mps": f"a number from 0 to {max(MAX_SPEEDS_MPS.values()):g} (m/s)",
    "actions": f"a list of {MIN_ACTIONS} to {MAX_ACTIONS} actions",
    "action": _of(Action),
    "duration_s": f"a number from {MIN_DURATION_S:g} to {MAX_DURATION_S:g} (s)",
    "magnitude": "a finite number",
}


def written(solution: Solution) -> dict[str, Any]:
    """Return a solution in the wire form, rounded to centimetres and the like."""
    return {
        "participants": [
            {
                "kind": one.kind.value,
                "ds_m": _rounded(one.ds_m),
                "dd_m": _rounded(one.dd_m),
                "heading": heading_of(one.dyaw_rad).value,
                "speed_mps": _rounded(one.speed_mps),
                "actions": [
                    {
                        "action": gene.action.value,
                        "duration_s": _rounded(gene.duration_s),
                        "magnitude": _rounded(gene.magnitude),
                    }
                    for gene in one.genes
                ],
            }
            for one in solution
        ]
    }


def as_text(solutions: Sequence[Solution]) -> str:
    """Return solutions as the text of a reply."""
    return json.dumps({"solutions": [written(solution) for solution in solutions]})


def _rounded(value: float) -> float:
    return round(value, 2) + 0.0


def read(item: object, most: int, pointer: str) -> Solution | list[FieldError]:
    """Return the solution that an item describes, not yet placed on the road, or what is wrong with it.

    Args:
        item: A decoded JSON value, whatever it is.
        most: Most participants.
        pointer: JSON pointer to the item.
    """
    listed = item.get("participants") if isinstance(item, dict) else None
    count = len(listed) if isinstance(listed, list) else 0
    if count > most:
        return [FieldError(pointer=f"{pointer}/participants", message=f"expected 1 to {most}, got {count}")]
    try:
        form = _SolutionForm.model_validate(item)
    except ValidationError as error:
        return [_field_error(one, pointer) for one in error.errors(include_url=False)[:ERRORS_AN_ITEM]]
    misfits = [
        error
        for place, one in enumerate(form.participants)
        for error in _misfits(one, f"{pointer}/participants/{place}")
    ]
    if misfits:
        return misfits[:ERRORS_AN_ITEM]
    return tuple(_participant(one) for one in form.participants)


def _field_error(error: Any, pointer: str) -> FieldError:
    """Return an error in our own words; places consist of our field names and of numbers."""
    location = error["loc"]
    names = [part for part in location if isinstance(part, str)]
    expected = _EXPECTED[names[-1]] if names else 'an object with "participants"'
    if location and isinstance(location[-1], int):
        expected = f"an object, one of {expected}"
    value = error["input"]
    message = f"expected {expected}"
    if error["type"] == "missing":
        message = f"missing; {message}"
    elif type(value) in (int, float) and math.isfinite(value):
        message = f"{message}, got {value:g}"
    return FieldError(pointer=pointer + "".join(f"/{part}" for part in location), message=message)


def _misfits(one: _ParticipantForm, pointer: str) -> list[FieldError]:
    """Return what of a participant does not go together."""
    errors = []
    fastest = MAX_SPEEDS_MPS[one.kind]
    if one.speed_mps > fastest:
        message = f"expected a {one.kind} to go at {fastest:g} m/s at most, got {one.speed_mps:g}"
        errors.append(FieldError(pointer=f"{pointer}/speed_mps", message=message))
    on_foot = one.kind is Kind.PEDESTRIAN
    fitting = PEDESTRIAN_ACTIONS if on_foot else VEHICLE_ACTIONS
    if on_foot and one.heading is Heading.ACROSS:
        message = "expected with_ego or oncoming: pedestrians start along the pavement and turn with the action cross"
        errors.append(FieldError(pointer=f"{pointer}/heading", message=message))
    for place, step in enumerate(one.actions):
        here = f"{pointer}/actions/{place}"
        room = MAGNITUDES[step.action]
        if step.action not in fitting:
            message = f"expected an action of a {one.kind}: {', '.join(fitting)}; got {step.action}"
            errors.append(FieldError(pointer=f"{here}/action", message=message))
        elif room.unit and not room.low <= step.magnitude <= room.high:
            message = (
                f"expected {room.low:g} to {room.high:g} {room.unit} for {step.action}, "
                f"got {step.magnitude:g}"
            )
            errors.append(FieldError(pointer=f"{here}/magnitude", message=message))
    return errors


def _participant(one: _ParticipantForm) -> Participant:
    heading_rad = {
        Heading.WITH_EGO: 0.0,
        Heading.ONCOMING: math.pi,
        Heading.ACROSS: -0.5 * math.pi if one.dd_m > 0 else 0.5 * math.pi,
    }[one.heading]
    return Participant(
        kind=one.kind,
        ds_m=one.ds_m,
        dd_m=one.dd_m,
        dyaw_rad=heading_rad,
        speed_mps=one.speed_mps,
        genes=tuple(
            Gene(
                action=step.action,
                duration_s=step.duration_s,
                magnitude=step.magnitude if MAGNITUDES[step.action].unit else 0.0,
            )
            for step in one.actions
        ),
    )
