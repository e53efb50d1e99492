"""The behaviour of the obstacle detector: injected trajectories of image boxes, or the ground truth.

This module has no heavy imports, so that code that builds a search space can read the parameters from here.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Self

from brink.sim.driving.interface import PERCEPTION_STEP_S, Box, ObstacleLabel
from brink.sim.episode import Json, JsonObject, check_fields, nearest, parse_number
from brink.sim.errors import InvalidEpisode

IMAGE_WIDTH_PX = 800
IMAGE_HEIGHT_PX = 600
MIN_BOX_PX = 50.0
"""Minimum width and height of a sampled box; an episode accepts any box with a positive extent."""

DEFAULT_DURATION_S = 30.0
MIN_DURATION_SHARE = 1.0 / 18.0
"""Minimum duration of a sampled trajectory, as a share of the episode."""

TRAJECTORY_COUNT = 2
"""Usual number of trajectories in a sampled behaviour; an episode accepts up to `MAX_TRAJECTORIES`."""
MAX_TRAJECTORIES = 16

NULL_LABEL = "null"
TRAJECTORY_LABELS = (NULL_LABEL, ObstacleLabel.VEHICLE.value, ObstacleLabel.PERSON.value)
BOX_SIDES = ("x_min", "x_max", "y_min", "y_max")
BOX_FIELDS = tuple(f"{side}_{end}_px" for end in (0, 1) for side in BOX_SIDES)
TRAJECTORY_FIELDS = ("label", "t0_step", "t1_step", *BOX_FIELDS)
"""The eleven parameters of a trajectory, in the order of the genome."""


def trajectory_numbers(names: Collection[str]) -> range:
    """Return the numbers of the trajectories of a behaviour, from 1, given the names of its parameters."""
    return range(1, sum(name.startswith("trajectory_") and name.endswith(".label") for name in names) + 1)


def trajectory_ranges(duration_s: float = DEFAULT_DURATION_S) -> dict[str, tuple[float, float, str]]:
    """Return (low, high, unit) of the ten numeric parameters of a trajectory, in the order of the genome."""
    last_step = last_perception_step(duration_s)
    ranges: dict[str, tuple[float, float, str]] = {
        "t0_step": (0.0, float(last_step), "steps of 0.1 s"),
        "t1_step": (0.0, float(last_step), "steps of 0.1 s"),
    }
    for name in BOX_FIELDS:
        ranges[name] = (0.0, float(IMAGE_WIDTH_PX if name.startswith("x_") else IMAGE_HEIGHT_PX), "px")
    return ranges


def last_perception_step(duration_s: float) -> int:
    """Return T, the number of perception steps in an episode; the detector runs at steps 0 to T - 1."""
    return round(duration_s / PERCEPTION_STEP_S)


class BehaviourMode(StrEnum):
    """Source of the detector's output."""

    INJECTED = "injected"
    ORACLE = "oracle"


@dataclass(frozen=True, slots=True, kw_only=True)
class InjectedTrajectory:
    """A ghost: a box that moves linearly through the image.

    Attributes:
        label: Label that the detector reports.
        t0_step: First perception step with the box; may be fractional.
        t1_step: Last perception step with the box, > `t0_step`.
        first_px: x_min, x_max, y_min, y_max at `t0_step`.
        last_px: The same at `t1_step`.
    """

    label: ObstacleLabel
    t0_step: float
    t1_step: float
    first_px: tuple[float, float, float, float]
    last_px: tuple[float, float, float, float]

    def box_at(self, step: float) -> Box | None:
        """Return the box at a perception step, which may be fractional; None before and after the trajectory."""
        if not self.t0_step <= step <= self.t1_step:
            return None
        share = (step - self.t0_step) / (self.t1_step - self.t0_step)
        x_min, x_max, y_min, y_max = (
            a + share * (b - a) for a, b in zip(self.first_px, self.last_px, strict=True)
        )
        return Box(label=self.label, x_min_px=x_min, x_max_px=x_max, y_min_px=y_min, y_max_px=y_max)

    def to_json(self) -> JsonObject:
        """Return the trajectory as a JSON object."""
        document: JsonObject = {"label": self.label.value, "t0_step": self.t0_step, "t1_step": self.t1_step}
        document.update(zip(BOX_FIELDS, (*self.first_px, *self.last_px), strict=True))
        return document


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectorBehaviour:
    """The obstacle detector's output during an episode.

    Attributes:
        mode: Injected boxes or the ground truth.
        trajectories: The injected trajectories that are not null; empty unless `mode` is injected.
    """

    mode: BehaviourMode
    trajectories: tuple[InjectedTrajectory, ...] = ()

    def to_json(self) -> JsonObject:
        """Return the behaviour as a JSON object, without null trajectories."""
        if self.mode is BehaviourMode.ORACLE:
            return {"mode": self.mode.value}
        return {"mode": self.mode.value, "trajectories": [item.to_json() for item in self.trajectories]}

    @classmethod
    def from_json(cls, document: Mapping[str, Json], duration_s: float = DEFAULT_DURATION_S) -> Self:
        """Parse a behaviour from a JSON object.

        A null trajectory is validated like any other, except that all its numbers may be 0.

        Args:
            document: ``{"mode": "oracle"}`` or ``{"mode": "injected", "trajectories": [...]}``.
            duration_s: Length of the episode, which bounds the time steps.

        Raises:
            InvalidEpisode: A field is missing or unknown, or its value is out of range.
        """
        known = tuple(item.value for item in BehaviourMode)
        mode = document.get("mode")
        if not isinstance(mode, str) or mode not in known:
            raise InvalidEpisode(
                f"behaviour.mode: expected one of {', '.join(known)}; got {mode!r}{nearest(mode, known)}"
            )
        if mode == BehaviourMode.ORACLE:
            check_fields("behaviour", document, ("mode",))
            return cls(mode=BehaviourMode.ORACLE)
        check_fields("behaviour", document, ("mode", "trajectories"))
        items = document["trajectories"]
        if not isinstance(items, list) or len(items) > MAX_TRAJECTORIES:
            raise InvalidEpisode(
                f"behaviour.trajectories: expected a list of at most {MAX_TRAJECTORIES}, got {items!r:.80}"
            )
        read = [_trajectory(f"behaviour.trajectories[{i}]", item, duration_s) for i, item in enumerate(items)]
        return cls(mode=BehaviourMode.INJECTED, trajectories=tuple(t for t in read if t is not None))


DELIVERED = "delivered_steps"
"""Name of the feature that says when each trajectory was delivered; see `steps_to_json`."""


def steps_to_json(found: Sequence[tuple[int, int] | None]) -> Json:
    """Return first and last steps as JSON: a pair for each, or null."""
    return [None if steps is None else [*steps] for steps in found]


def steps_from_json(document: Json) -> tuple[tuple[int, int] | None, ...] | None:
    """Return the first and last steps that `steps_to_json` wrote; None if they were not recorded.

    Args:
        document: A feature of a result, which any worker may have sent.
    """
    if not isinstance(document, list):
        return None
    found: list[tuple[int, int] | None] = []
    for steps in document:
        match steps:
            case None:
                found.append(None)
            case [int(first), int(last)] if 0 <= first <= last:
                found.append((first, last))
            case _:
                return None
    return tuple(found)


def words_of_behaviour(trajectories: Json) -> str:
    """Describe injected detections with their times, such as ``reported: person 17.4-26.7 s``."""
    if not isinstance(trajectories, list) or not trajectories:
        return "nothing reported"
    detections = []
    for trajectory in trajectories:
        if isinstance(trajectory, Mapping):
            start, end = (float(str(trajectory[name])) * PERCEPTION_STEP_S for name in ("t0_step", "t1_step"))
            detections.append(f"{trajectory['label']} {start:.1f}-{end:.1f} s")
    return "reported: " + ", ".join(detections)


def _trajectory(where: str, document: Json, duration_s: float) -> InjectedTrajectory | None:
    if not isinstance(document, dict):
        raise InvalidEpisode(f"{where}: expected an object, got {document!r:.80}")
    check_fields(where, document, TRAJECTORY_FIELDS)
    label = document["label"]
    if not isinstance(label, str) or label not in TRAJECTORY_LABELS:
        raise InvalidEpisode(
            f"{where}.label: expected one of {', '.join(TRAJECTORY_LABELS)}; "
            f"got {label!r}{nearest(label, TRAJECTORY_LABELS)}"
        )
    values = {
        name: parse_number(f"{where}.{name}", document[name], low, high)
        for name, (low, high, _) in trajectory_ranges(duration_s).items()
    }
    if label == NULL_LABEL:
        return None
    if not values["t0_step"] < values["t1_step"]:
        raise InvalidEpisode(
            f"{where}.t1_step: expected more than t0_step {values['t0_step']}, got {values['t1_step']}"
        )
    for end in (0, 1):
        for axis in ("x", "y"):
            low, high = values[f"{axis}_min_{end}_px"], values[f"{axis}_max_{end}_px"]
            if not low < high:
                raise InvalidEpisode(
                    f"{where}.{axis}_max_{end}_px: expected more than {axis}_min_{end}_px {low}, got {high}"
                )
    corners = [values[name] for name in BOX_FIELDS]
    return InjectedTrajectory(
        label=ObstacleLabel(label),
        t0_step=values["t0_step"],
        t1_step=values["t1_step"],
        first_px=(corners[0], corners[1], corners[2], corners[3]),
        last_px=(corners[4], corners[5], corners[6], corners[7]),
    )
