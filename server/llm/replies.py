"""Solutions as a language model writes them: the JSON schema, and how replies become valid solutions.

Replies are untrusted text. JSON is found anywhere in it: plain, in fences, after other text or reasoning; from a
truncated list the complete items are used. Each item is checked for shape, ranges and suitable actions, then placed
on the road by the search's own repair. A solution that repair would change noticeably is physically impossible, and
is rejected rather than turned into a different one.

Error messages become part of repair prompts. A number out of range is quoted with its range and by how much it is
beyond; text that a model wrote is never quoted. The wording must not change: stored calls are found by the hash of
their prompt.
"""

import itertools
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any, Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from brink.search.traffic.constraint import ALONG_M, Participants, participants_component
from brink.search.traffic.participants import (
    MAGNITUDES,
    MAX_ACTIONS,
    MAX_DURATION_S,
    MAX_SPEEDS_MPS,
    MIN_ACTIONS,
    MIN_DURATION_S,
    PEDESTRIAN_ACTIONS,
    REACH_M,
    SIZES_M,
    VEHICLE_ACTIONS,
    Action,
    Gene,
    Kind,
    Participant,
    RoadLimits,
    Solution,
)
from brink.server.errors import FieldError
from brink.server.llm.protocol import BadJson, decode_json_at

MAX_ITEM_ERRORS: Final = 4
"""Maximum number of errors reported for one item."""


class Heading(StrEnum):
    """Direction that a participant faces at the start."""

    WITH_EGO = "with_ego"
    ONCOMING = "oncoming"
    ACROSS = "across"


def heading_of(dyaw_rad: float) -> Heading:
    """Return the name of a heading relative to the ego's lane."""
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
"""Contains only what all endpoints with structured output support: objects, arrays, enums and numbers."""


class _Form(BaseModel):
    """Base class of the models of a reply. Unknown fields are ignored."""

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


_UNITS: Final[Mapping[str, str]] = {"ds_m": "m", "dd_m": "m", "speed_mps": "m/s", "duration_s": "s"}
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


def pointed(error: FieldError) -> str:
    """Return an error of a reply on one line, with a JSON pointer into the reply."""
    return f"{error.pointer or '/'}: {error.message}"


def _to_json(solution: Solution) -> dict[str, Any]:
    return {
        "participants": [
            {
                "kind": participant.kind.value,
                "ds_m": _rounded(participant.ds_m),
                "dd_m": _rounded(participant.dd_m),
                "heading": heading_of(participant.dyaw_rad).value,
                "speed_mps": _rounded(participant.speed_mps),
                "actions": [
                    {
                        "action": gene.action.value,
                        "duration_s": _rounded(gene.duration_s),
                        "magnitude": _rounded(gene.magnitude),
                    }
                    for gene in participant.genes
                ],
            }
            for participant in solution
        ]
    }


def to_text(solutions: Sequence[Solution]) -> str:
    """Write solutions as the text of a reply, with numbers rounded to two decimals."""
    return json.dumps({"solutions": [_to_json(solution) for solution in solutions]})


def _rounded(value: float) -> float:
    return round(value, 2) + 0.0


def _read(item: object, max_participants: int, pointer: str) -> Solution | list[FieldError]:
    """Return the solution that a decoded JSON value describes, not yet placed on the road, or its errors."""
    listed = item.get("participants") if isinstance(item, dict) else None
    count = len(listed) if isinstance(listed, list) else 0
    if count > max_participants:
        message = f"expected 1 to {max_participants}, got {count}: {count - max_participants} too many"
        return [FieldError(pointer=f"{pointer}/participants", message=message)]
    try:
        form = _SolutionForm.model_validate(item)
    except ValidationError as error:
        return [_field_error(one, pointer) for one in error.errors(include_url=False)[:MAX_ITEM_ERRORS]]
    misfits = [
        error
        for place, participant in enumerate(form.participants)
        for error in _misfits(participant, f"{pointer}/participants/{place}")
    ]
    if misfits:
        return misfits[:MAX_ITEM_ERRORS]
    return tuple(_participant(one) for one in form.participants)


def _field_error(error: Any, pointer: str) -> FieldError:
    """Return a validation error in words that quote no text from the model."""
    location = error["loc"]
    names = [part for part in location if isinstance(part, str)]
    expected = _EXPECTED[names[-1]] if names else 'an object with "participants"'
    if location and isinstance(location[-1], int):
        expected = f"an object, one of {expected}"
    message = f"expected {expected}"
    if error["type"] == "missing":
        message = f"missing; {message}"
    elif got := _got(error, _UNITS.get(names[-1], "") if names else ""):
        message = f"{message}, got {got}"
    return FieldError(pointer=pointer + "".join(f"/{part}" for part in location), message=message)


def _got(error: Any, unit: str) -> str:
    """Return the number that a validation error is about, and its excess; empty if it is about no number."""
    value, limits = error["input"], error.get("ctx", {})
    if isinstance(value, list):
        low, high = limits.get("min_length"), limits.get("max_length")
        if high is not None:
            return f"{len(value)}: {len(value) - high} too many"
        return f"{len(value)}: {low - len(value)} too few" if low is not None else ""
    if type(value) not in (int, float):
        return ""
    if not math.isfinite(value):
        return "a number that is not finite"
    return _out_of_range(value, limits.get("ge", value), limits.get("le", value), unit)


def _out_of_range(value: float, low: float, high: float, unit: str) -> str:
    """Return a number, and by how much it is out of a range, in words."""
    excess, way = (low - value, "small") if value < low else (value - high, "large")
    return f"{value:g}: {f'{excess:g} {unit}'.strip()} too {way}" if excess > 0 else f"{value:g}"


def _misfits(one: _ParticipantForm, pointer: str) -> list[FieldError]:
    """Return the errors of a participant whose fields do not suit each other."""
    found = []
    fastest = MAX_SPEEDS_MPS[one.kind]
    if one.speed_mps > fastest:
        got = _out_of_range(one.speed_mps, 0.0, fastest, "m/s")
        found.append(("speed_mps", f"expected a {one.kind} to go at {fastest:g} m/s at most, got {got}"))
    on_foot = one.kind is Kind.PEDESTRIAN
    fitting = PEDESTRIAN_ACTIONS if on_foot else VEHICLE_ACTIONS
    if on_foot and one.heading is Heading.ACROSS:
        message = "expected with_ego or oncoming: pedestrians start along the pavement and turn with the action cross"
        found.append(("heading", message))
    for place, step in enumerate(one.actions):
        here, room = f"actions/{place}", MAGNITUDES[step.action]
        if step.action not in fitting:
            message = f"expected an action of a {one.kind}: {', '.join(fitting)}; got {step.action}"
            found.append((f"{here}/action", message))
        elif room.unit and not room.low <= step.magnitude <= room.high:
            got = _out_of_range(step.magnitude, room.low, room.high, room.unit)
            message = f"expected {room.low:g} to {room.high:g} {room.unit} for {step.action}, got {got}"
            found.append((f"{here}/magnitude", message))
    return [FieldError(pointer=f"{pointer}/{field}", message=message) for field, message in found]


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


TOLERANCE_M: Final = 3.0
"""Maximum distance by which repair may move the start of a participant."""


def apart_m(kind: Kind) -> float:
    """Return the minimum initial distance between the centres of two participants of a kind on the same lane."""
    return SIZES_M[kind][0] + ALONG_M


def kept_clear_m(kind: Kind, road: RoadLimits) -> tuple[float, float]:
    """Return the range of stations on the ego's lane where no participant of a kind may start with its centre."""
    return -road.clear_behind_m - 0.5 * apart_m(kind), road.clear_ahead_m + 0.5 * apart_m(kind)


class RoadChecker:
    """Checks that solutions are possible on a road.

    Args:
        road: The road.
        max_participants: Maximum number of participants in a solution.
    """

    def __init__(self, road: RoadLimits, max_participants: int) -> None:
        self.road = road
        self.max_participants = max_participants
        self._rule = Participants(max_participants, road)
        self._component = participants_component("participants", max_participants, road)

    def problems(self, solution: Solution) -> list[str]:
        """Describe how a solution violates the search's constraints; empty if it does not."""
        return list(self._component.problems(self._rule.encode(solution)))

    def place(self, solution: Solution, pointer: str) -> Solution | list[FieldError]:
        """Return a solution with its participants placed on the road, or the reasons why that is impossible.

        Args:
            solution: At most ``max_participants`` participants, with actions that suit their kinds.
            pointer: JSON pointer to it.
        """
        placed = self._repair(solution)
        if len(placed) < len(solution):
            return [self._no_room(solution, pointer)]
        errors = [
            error
            for place, (wanted, got) in enumerate(zip(solution, placed, strict=True))
            if (error := self._moved(wanted, got, f"{pointer}/participants/{place}"))
        ]
        return errors or placed

    def _repair(self, solution: Solution) -> Solution:
        # A complete solution leaves nothing to draw at random; the generator is only a required argument.
        rng = np.random.default_rng(0)
        return self._rule.decode(self._component.repair(self._rule.encode(solution), rng))

    def _no_room(self, solution: Solution, pointer: str) -> FieldError:
        """Return the error for the first participant that cannot be placed."""
        place = next(
            count - 1 for count in range(1, len(solution) + 1) if len(self._repair(solution[:count])) < count
        )
        message = "physically impossible: expected a place that nobody else has, found none near"
        return FieldError(pointer=f"{pointer}/participants/{place}", message=message)

    def _moved(self, wanted: Participant, got: Participant, pointer: str) -> FieldError | None:
        """Return the error for a participant that repair would change noticeably; None if it would not."""
        heading = heading_of(got.dyaw_rad)
        along_m, aside_m = got.ds_m - wanted.ds_m, got.dd_m - wanted.dd_m
        away_m = math.hypot(along_m, aside_m)
        nearest = (
            f"; the nearest start for this {wanted.kind} is ds_m {got.ds_m:.1f}, dd_m {got.dd_m:.1f}, {heading}"
            f"{f': {away_m:.1f} m away' if away_m >= 0.05 else ''}"
        )
        if heading is not heading_of(wanted.dyaw_rad):
            field, reason = "heading", self._why_heading(wanted) + nearest
        elif away_m > TOLERANCE_M:
            field = "ds_m" if abs(along_m) >= abs(aside_m) else "dd_m"
            reason = self._why_start(wanted) + nearest
        elif [gene.action for gene in got.genes] != [gene.action for gene in wanted.genes]:
            field, reason = "actions", f"expected actions that a {wanted.kind} can do"
        else:
            return None
        return FieldError(pointer=f"{pointer}/{field}", message=f"physically impossible: {reason}")

    def _why_heading(self, wanted: Participant) -> str:
        if heading_of(wanted.dyaw_rad) is Heading.ACROSS:
            return "expected across only in a crossing street, off the carriageway"
        if self.road.on_carriageway(wanted.dd_m):
            return "expected nobody to start against the traffic on the ego's own lane"
        return "expected across off the carriageway, where vehicles wait in a crossing street"

    def _why_start(self, wanted: Participant) -> str:
        road = self.road
        if wanted.kind is Kind.PEDESTRIAN:
            return "expected a start on a pavement"
        if heading_of(wanted.dyaw_rad) is Heading.ACROSS:
            return "expected a start in a crossing street, on the lane that leads to the road"
        if not road.on_carriageway(wanted.dd_m):
            return "expected a start on a lane"
        low_m, high_m = kept_clear_m(wanted.kind, road)
        return (
            f"expected a lane's middle, {apart_m(wanted.kind):g} m to others on that lane, and no {wanted.kind} on "
            f"the ego's own lane from ds_m {low_m:g} to {high_m:g}"
        )


MAX_CHARS: Final = 1_000_000
"""Text beyond this is ignored."""
MAX_ERRORS: Final = 40

_MAX_BROKEN: Final = 8
_MAX_LISTS: Final = 4
_THOUGHTS_END: Final = "</think>"
_LIST: Final = re.compile(r'"solutions"\s*:\s*\[')
_BARE_LIST: Final = re.compile(r'\[(?=\s*\{\s*"participants")')
_ITEM: Final = re.compile(r'\{\s*"participants"')
_BETWEEN: Final = re.compile(r"[\s,]*")


@dataclass(frozen=True, slots=True, kw_only=True)
class Parsed:
    """The usable part of a reply.

    Attributes:
        solutions: Valid solutions as placed on the road, without duplicates.
        errors: What is wrong with the other items and with the reply.
    """

    solutions: tuple[Solution, ...] = ()
    errors: tuple[FieldError, ...] = ()


_BROKEN: Final = object()
"""In place of an item that cannot be decoded."""


@dataclass(frozen=True, slots=True)
class _Scan:
    """The items of a list.

    Attributes:
        items: Decoded values; `_BROKEN` where decoding failed.
        closed: Whether the end of the list was found.
    """

    items: list[object]
    closed: bool

    @property
    def decoded(self) -> int:
        """Number of items that could be decoded."""
        return sum(item is not _BROKEN for item in self.items)


def parse(text: str, road: RoadChecker, wanted: int, known: Sequence[Solution] = ()) -> Parsed:
    """Return the valid solutions in the text of a reply.

    Args:
        text: The text, which may be anything.
        road: Checks that solutions are possible.
        wanted: Maximum number of solutions to return.
        known: Solutions that must not be returned again.
    """
    scan = _scan_text(text[:MAX_CHARS], limit=4 * wanted + 16)
    if scan is None:
        message = 'expected one JSON object {"solutions": [...]}, found none'
        return Parsed(errors=(FieldError(pointer="", message=message),))
    taken: dict[Solution, str] = dict.fromkeys(known, "a solution that was accepted before")
    solutions: list[Solution] = []
    errors: list[FieldError] = []
    for place, item in enumerate(scan.items):
        if len(solutions) == wanted:
            break
        pointer = f"/solutions/{place}"
        solution = _place_item(item, road, pointer)
        if isinstance(solution, list):
            errors += solution
        elif solution in taken:
            errors.append(FieldError(pointer=pointer, message=f"the same as {taken[solution]}"))
        else:
            taken[solution] = pointer
            solutions.append(solution)
    if not scan.closed and len(solutions) < wanted:
        message = "the reply breaks off before the list ends: write less, and no text beside the JSON"
        errors.append(FieldError(pointer="/solutions", message=message))
    elif not scan.items:
        errors.append(FieldError(pointer="/solutions", message=f"expected {wanted} solutions, got none"))
    return Parsed(solutions=tuple(solutions), errors=tuple(errors[:MAX_ERRORS]))


def _place_item(item: object, road: RoadChecker, pointer: str) -> Solution | list[FieldError]:
    if item is _BROKEN:
        return [FieldError(pointer=pointer, message="expected JSON, got something broken or unfinished")]
    solution = _read(item, road.max_participants, pointer)
    return solution if isinstance(solution, list) else road.place(solution, pointer)


def _scan_text(text: str, limit: int) -> _Scan | None:
    """Return the list with the most decodable items, the last of them in a tie; None if there is no list."""
    answer = text.rpartition(_THOUGHTS_END)[2]
    for part in (answer, text):
        starts = [found.end() for found in itertools.islice(_LIST.finditer(part), _MAX_LISTS)]
        if not starts and (bare := _BARE_LIST.search(part)):
            starts = [bare.end()]
        if starts:
            scans = [_scan(part, start, limit) for start in starts]
            return max(reversed(scans), key=lambda scan: scan.decoded)
        if _ITEM.search(part):
            return _scan(part, 0, limit, loose=True)
    return None


def _scan(text: str, at: int, limit: int, *, loose: bool = False) -> _Scan:
    """Return items; after a broken one, continue at the next that can be recognised.

    Args:
        text: The text.
        at: Index of the first item.
        limit: Maximum number of items.
        loose: Whether the items are in no list, so that any text may be between them.
    """
    items: list[object] = []
    broken = 0
    while len(items) < limit and broken < _MAX_BROKEN:
        if loose and (following := _ITEM.search(text, at)):
            at = following.start()
        elif loose:
            break
        elif between := _BETWEEN.match(text, at):
            at = between.end()
        if text[at : at + 1] in ("]", ""):
            return _Scan(items, closed=at < len(text))
        try:
            item, at = decode_json_at(text, at)
        except BadJson:
            items.append(_BROKEN)
            broken += 1
            following = _ITEM.search(text, at + 1)
            if following is None:
                return _Scan(items, closed=False)
            at = following.start()
        else:
            items.append(item)
    return _Scan(items, closed=not broken if loose else broken < _MAX_BROKEN)
