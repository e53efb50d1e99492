"""Errors of the obstacle detector relative to the truth: their types, targets, time windows and magnitudes.

The detector reports the truth, apart from a few errors. An error has a type, a target, usually a time window, and a
magnitude in a physical unit. `brink.sim.urban.erroneous_detector` does to the boxes what is described here, and
`brink.sim.urban.erroneous_objects` to objects.

*Severity* puts the magnitudes of a type on a scale from 0, no error, to 1, the grossest error that is studied. The
two are proportional, so that half the severity is half the time, distance or share.

This module has no heavy imports, so that code that builds a search space can read the parameters from here.

Source: ours; see docs/explanation/tolerance.md.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Self

from brink.sim.driving.settings import FollowSettings
from brink.sim.episode import Json, JsonObject, check_fields, parse_choice, parse_number
from brink.sim.errors import InvalidEpisode
from brink.sim.perception_errors import MODE, Magnitude

MAX_ERRORS: Final = 8
"""Maximum number of errors in an episode."""


class ErrorType(StrEnum):
    """What is wrong with the detector's output."""

    MISS = "miss"
    LATE = "late"
    FLICKER = "flicker"
    TOO_FAR = "too_far"
    TOO_NEAR = "too_near"
    LEFT = "left"
    RIGHT = "right"
    TOO_LARGE = "too_large"
    TOO_SMALL = "too_small"
    WRONG_LABEL = "wrong_label"
    SHORT_RANGE = "short_range"
    GHOST_ON_ROAD = "ghost_on_road"
    GHOST_IN_IMAGE = "ghost_in_image"
    TOO_FAST = "too_fast"
    TOO_SLOW = "too_slow"
    STALE = "stale"
    UNSURE = "unsure"
    NEW_ID = "new_id"
    NOISE = "noise"


OBJECT_TYPES: Final = frozenset(
    {
        ErrorType.TOO_FAST,
        ErrorType.TOO_SLOW,
        ErrorType.STALE,
        ErrorType.UNSURE,
        ErrorType.NEW_ID,
        ErrorType.NOISE,
    }
)
"""What can be wrong with a list of objects alone."""
BOX_TYPES: Final = tuple(kind for kind in ErrorType if kind not in OBJECT_TYPES)
"""What can be wrong with boxes."""
ON_OBJECTS: Final = "objects"
"""What errors act on if not on boxes."""


class Target(StrEnum):
    """Whose boxes are wrong.

    In a time window, ``lead`` is the nearest vehicle ahead in the ego's lane when the window opens, and
    ``pedestrian`` the nearest pedestrian ahead within 3 m of the middle of that lane, or the one who steps out if
    that opens the window. The window waits until there is one. Otherwise all of the kind are meant.
    Vehicles are told apart by their heading relative to the ego's: up to 45 degrees (``lead``), from 135 degrees
    (``oncoming``), and between (``crossing``).
    """

    LEAD = "lead"
    ONCOMING = "oncoming"
    CROSSING = "crossing"
    PEDESTRIAN = "pedestrian"
    EVERYBODY = "everybody"


class Onset(StrEnum):
    """What an error's window begins with."""

    TIME = "time"
    LEAD_BRAKES = "lead_brakes"
    PEDESTRIAN_STEPS_OUT = "pedestrian_steps_out"


LONGEST_S: Final = 8.0
RELEVANT_M: Final = FollowSettings().range_m
"""Distance beyond which the driving system ignores vehicles; a range of this or more counts as no error."""

MAGNITUDES: Final[Mapping[ErrorType, Magnitude]] = {
    ErrorType.MISS: Magnitude(
        unit="s", none=0.0, most=LONGEST_S, meaning="how long the target is not reported"
    ),
    ErrorType.LATE: Magnitude(
        unit="s",
        none=0.0,
        most=LONGEST_S,
        has_window=False,
        meaning="how long after it first was visible the target is first reported",
    ),
    ErrorType.FLICKER: Magnitude(
        unit="share",
        none=0.0,
        most=1.0,
        has_duration=True,
        meaning="share of each period of 2 s in which the target is not reported",
    ),
    ErrorType.TOO_FAR: Magnitude(
        unit="share",
        none=0.0,
        most=1.0,
        has_duration=True,
        meaning="how much farther away the box's bottom edge puts the target, as a share of its distance",
    ),
    ErrorType.TOO_NEAR: Magnitude(
        unit="share",
        none=0.0,
        most=0.8,
        has_duration=True,
        meaning="how much nearer the box's bottom edge puts the target, as a share of its distance",
    ),
    ErrorType.LEFT: Magnitude(
        unit="m",
        none=0.0,
        most=4.0,
        has_duration=True,
        meaning="how far to the left of the target its box lies, at the target's distance",
    ),
    ErrorType.RIGHT: Magnitude(
        unit="m",
        none=0.0,
        most=4.0,
        has_duration=True,
        meaning="how far to the right of the target its box lies, at the target's distance",
    ),
    ErrorType.TOO_LARGE: Magnitude(
        unit="share",
        none=0.0,
        most=1.0,
        has_duration=True,
        meaning="how much wider and higher the box is, about its centre",
    ),
    ErrorType.TOO_SMALL: Magnitude(
        unit="share",
        none=0.0,
        most=0.8,
        has_duration=True,
        meaning="how much narrower and lower the box is, about its centre",
    ),
    ErrorType.WRONG_LABEL: Magnitude(
        unit="s",
        none=0.0,
        most=LONGEST_S,
        meaning="how long a vehicle is reported as a person, or a person as a vehicle",
    ),
    ErrorType.SHORT_RANGE: Magnitude(
        unit="m",
        none=RELEVANT_M,
        most=0.0,
        has_window=False,
        meaning="distance beyond which the target is not reported",
    ),
    ErrorType.GHOST_ON_ROAD: Magnitude(
        unit="s",
        none=0.0,
        most=LONGEST_S,
        meaning="how long a target that is not there is reported at a place on the road",
    ),
    ErrorType.GHOST_IN_IMAGE: Magnitude(
        unit="s",
        none=0.0,
        most=LONGEST_S,
        meaning="how long a target that is not there is reported at a place in the image",
    ),
    ErrorType.TOO_FAST: Magnitude(
        unit="m/s",
        none=0.0,
        most=8.0,
        has_duration=True,
        meaning="how much faster the target is reported, along its heading",
    ),
    ErrorType.TOO_SLOW: Magnitude(
        unit="m/s",
        none=0.0,
        most=8.0,
        has_duration=True,
        meaning="how much slower the target is reported, along its heading",
    ),
    ErrorType.STALE: Magnitude(
        unit="s",
        none=0.0,
        most=2.0,
        has_duration=True,
        meaning="how old the report of the target is, besides the latency of all reports",
    ),
    ErrorType.UNSURE: Magnitude(
        unit="share",
        none=0.0,
        most=1.0,
        has_duration=True,
        meaning="how much lower the existence of the target is",
    ),
    ErrorType.NEW_ID: Magnitude(
        unit="s", none=0.0, most=LONGEST_S, meaning="how long the target has a new number in each report"
    ),
    ErrorType.NOISE: Magnitude(
        unit="share",
        none=0.0,
        most=0.5,
        has_duration=True,
        meaning="standard deviation of the target's reported place, as a share of its distance",
    ),
}

PEDESTRIAN_WITHIN_M: Final = 3.0
"""A single pedestrian is a target within this distance of the middle of the ego's lane."""
GHOSTS: Final = frozenset({ErrorType.GHOST_ON_ROAD, ErrorType.GHOST_IN_IMAGE})
WINDOW_FIELDS: Final = ("onset", "onset_s")


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectionError:
    """One error of the obstacle detector.

    Attributes:
        type: What is wrong.
        target: Whose boxes are wrong; of ghosts, what they look like.
        magnitude: How wrong, in the unit of the type.
        onset: What the window begins with.
        onset_s: Begin of the window or, with an event as onset, the earliest time at which the event counts.
        duration_s: Length of the window.
    """

    type: ErrorType
    target: Target
    magnitude: float
    onset: Onset = Onset.TIME
    onset_s: float = 0.0
    duration_s: float = math.inf

    def to_json(self) -> JsonObject:
        """Return the error as a JSON object, with the fields of its type."""
        scale = MAGNITUDES[self.type]
        document: JsonObject = {
            "type": self.type.value,
            "target": self.target.value,
            "magnitude": self.magnitude,
        }
        if scale.has_window:
            document |= {"onset": self.onset.value, "onset_s": self.onset_s}
        if scale.has_duration:
            document["duration_s"] = self.duration_s
        return document

    @classmethod
    def from_json(cls, where: str, document: Json, duration_s: float) -> Self:
        """Parse an error.

        Args:
            where: Where it stands, for messages.
            document: Fields ``type``, ``target`` and ``magnitude``, and those of the window that the type has.
            duration_s: Length of the episode, which bounds times.

        Raises:
            InvalidEpisode: A field is missing, unknown, or outside its unit.
        """
        if not isinstance(document, Mapping):
            raise InvalidEpisode(f"{where}: expected an object, got {document!r:.80}")
        kind = parse_choice(f"{where}.type", document.get("type"), ErrorType)
        scale = MAGNITUDES[kind]
        fields: tuple[str, ...] = ("type", "target", "magnitude")
        fields += WINDOW_FIELDS if scale.has_window else ()
        fields += ("duration_s",) if scale.has_duration else ()
        check_fields(where, document, fields)
        lowest, highest = sorted((scale.none, scale.most))
        if scale.unit == "s":
            highest = max(highest, duration_s)
        magnitude = parse_number(f"{where}.magnitude", document["magnitude"], lowest, highest, scale.unit)
        error = cls(
            type=kind, target=parse_choice(f"{where}.target", document["target"], Target), magnitude=magnitude
        )
        if not scale.has_window:
            return error
        return cls(
            type=kind,
            target=error.target,
            magnitude=magnitude,
            onset=parse_choice(f"{where}.onset", document["onset"], Onset),
            onset_s=parse_number(f"{where}.onset_s", document["onset_s"], 0.0, duration_s, "s"),
            duration_s=parse_number(f"{where}.duration_s", document["duration_s"], 0.0, duration_s, "s")
            if scale.has_duration
            else magnitude,
        )

    @property
    def severity(self) -> float:
        """The severity of the error; 0 has no effect."""
        return MAGNITUDES[self.type].severity(self.magnitude)

    @property
    def words(self) -> str:
        """The error in words, such as ``the lead is not reported for 1.3 s from 4.2 s on``."""
        scale = MAGNITUDES[self.type]
        words = self.words_with(scale.words(self.magnitude))
        if scale.has_duration:
            words += f" for {self.duration_s:.1f} s"
        return f"{words} {self.onset_words}" if scale.has_window else words

    def words_with(self, magnitude: str) -> str:
        """Describe the error with the given magnitude and without the onset."""
        return words_of_error(self.type, self.target, magnitude)

    @property
    def onset_words(self) -> str:
        """The onset in words, such as ``from 4.2 s on`` or ``when the lead brakes after 4.2 s``."""
        match self.onset:
            case Onset.TIME:
                return f"from {self.onset_s:.1f} s on"
            case Onset.LEAD_BRAKES:
                return f"when the lead brakes after {self.onset_s:.1f} s"
            case Onset.PEDESTRIAN_STEPS_OUT:
                return f"when a pedestrian steps out after {self.onset_s:.1f} s"


_SINGLE: Final = {Target.LEAD: "the lead", Target.PEDESTRIAN: "the nearest pedestrian"}
"""A target that is a single road user in a time window."""
_KIND: Final = {
    Target.LEAD: "vehicle going the same way",
    Target.ONCOMING: "oncoming vehicle",
    Target.CROSSING: "crossing vehicle",
    Target.PEDESTRIAN: "pedestrian",
    Target.EVERYBODY: "road user",
}
"""A target that is all of its kind."""
_GHOST: Final = {
    Target.LEAD: "a vehicle that is not there",
    Target.ONCOMING: "an oncoming vehicle that is not there",
    Target.CROSSING: "a crossing vehicle that is not there",
    Target.PEDESTRIAN: "a person who is not there",
    Target.EVERYBODY: "a vehicle and a person that are not there",
}
_NOT: Final = "not "
_REPORTS: Final[Mapping[ErrorType, tuple[str, str]]] = {
    ErrorType.MISS: (_NOT, "for {much}"),
    ErrorType.LATE: ("first ", "{much} late"),
    ErrorType.FLICKER: (_NOT, "{much} of the time"),
    ErrorType.TOO_FAR: ("", "{much} too far away"),
    ErrorType.TOO_NEAR: ("", "{much} too near"),
    ErrorType.LEFT: ("", "{much} too far left"),
    ErrorType.RIGHT: ("", "{much} too far right"),
    ErrorType.TOO_LARGE: ("", "{much} too large"),
    ErrorType.TOO_SMALL: ("", "{much} too small"),
    ErrorType.WRONG_LABEL: ("", "with the wrong label for {much}"),
    ErrorType.SHORT_RANGE: ("", "only within {much}"),
    ErrorType.GHOST_ON_ROAD: ("", "on the road for {much}"),
    ErrorType.GHOST_IN_IMAGE: ("", "at a fixed place in the image for {much}"),
    ErrorType.TOO_FAST: ("", "{much} too fast"),
    ErrorType.TOO_SLOW: ("", "{much} too slow"),
    ErrorType.STALE: ("", "as it was {much} earlier"),
    ErrorType.UNSURE: ("", "with {much} less existence"),
    ErrorType.NEW_ID: ("", "under a new number each time for {much}"),
    ErrorType.NOISE: ("", "with noise of {much} of its distance"),
}
"""The words before and after "reported" or "reporting"."""


def words_of_error(kind: ErrorType, target: Target, magnitude: str) -> str:
    """Return an error in words, without its onset, such as ``the lead is not reported for 1.3 s``.

    The words say whether it concerns one road user or every one of a kind.

    Args:
        kind: What is wrong.
        target: Whose boxes are wrong.
        magnitude: How wrong, with the unit.
    """
    before, after = _REPORTS[kind]
    verb = "are" if kind in GHOSTS and target is Target.EVERYBODY else "is"
    who = _whose(kind, target)
    if who is None:
        every, before = ("no", "") if before == _NOT else ("every", before)
        who = f"{every} {_KIND[target]}"
    return f"{who} {verb} {before}reported {after.format(much=magnitude)}"


def activity_of_error(kind: ErrorType, target: Target | None, magnitude: str) -> str:
    """Return an error as an activity of the detector, such as ``not reporting the lead for 1.3 s``.

    Args:
        kind: What is wrong.
        target: Whose boxes are wrong; None if it varies.
        magnitude: How wrong, with the unit.
    """
    before, after = _REPORTS[kind]
    if target is None:
        who: str | None = "somebody who is not there" if kind in GHOSTS else "road users"
    else:
        who = _whose(kind, target) or f"{'any' if before == _NOT else 'every'} {_KIND[target]}"
    return f"{before}reporting {who} {after.format(much=magnitude)}"


def _whose(kind: ErrorType, target: Target) -> str | None:
    """Return the single road user or the ghost that an error affects; None if it affects a whole kind."""
    if kind in GHOSTS:
        return _GHOST[target]
    return _SINGLE.get(target) if MAGNITUDES[kind].has_window else None


def errors_from_json(document: Mapping[str, Json], duration_s: float) -> tuple[DetectionError, ...]:
    """Parse the errors of an episode.

    Args:
        document: ``{"mode": "errors", "errors": [...]}``, and ``"on": "objects"`` unless they act on boxes.
        duration_s: Length of the episode, which bounds times.

    Raises:
        InvalidEpisode: A field is missing, unknown, or outside its unit.
    """
    on_objects = "on" in document
    check_fields("behaviour", document, ("mode", *(["on"] if on_objects else []), "errors"))
    if on_objects and document["on"] != ON_OBJECTS:
        raise InvalidEpisode(f"behaviour.on: expected {ON_OBJECTS}, or nothing; got {document['on']!r:.80}")
    if document["mode"] != MODE:
        raise InvalidEpisode(f"behaviour.mode: expected {MODE}, got {document['mode']!r}")
    items = document["errors"]
    if not isinstance(items, list) or len(items) > MAX_ERRORS:
        raise InvalidEpisode(
            f"behaviour.errors: expected a list of at most {MAX_ERRORS} errors, got {items!r:.80}"
        )
    errors = tuple(
        DetectionError.from_json(f"behaviour.errors[{i}]", item, duration_s) for i, item in enumerate(items)
    )
    for index, error in enumerate(errors):
        if error.type in OBJECT_TYPES and not on_objects:
            raise InvalidEpisode(
                f'behaviour.errors[{index}].type: {error.type} needs a list of objects, so "on": "{ON_OBJECTS}"'
            )
    return errors


ERROR_STEPS: Final = "error_steps"
"""Name of the feature that says when each error changed the output; see `behaviour.steps_to_json`."""
