"""The warning signs of a violation before it happened: in the detector's output, and to a range sensor.

A monitor of outputs sees what is reported, never who is there. It can only infer from what it sees, such as a box
that vanishes, that something is wrong. If nothing is reported, there is nothing to infer from but the drive itself.
"""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from brink.pictures.pair import counterpart_of
from brink.pictures.scene import EpisodeScene, obstacles_on
from brink.pictures.story import Judged, story_of
from brink.sim.trace import Trace
from brink.sim.urban.range_sensor import in_view

WINDOW_S: Final = 3.0
"""What was reported this long before a violation counts."""
LEAD_S: Final = 1.5
"""How long before a violation its counterpart must be within range of a range sensor."""


class Reported(StrEnum):
    """What the detector reported in the seconds before a violation."""

    COUNTERPART = "counterpart"
    """The road user that the violation is about."""
    OTHERS = "others"
    """Something else, which may not exist."""
    NOTHING = "nothing"
    """Nothing at all."""
    NO_ROAD_USER = "no road user"
    """The violation is about no road user, such as one of a red light."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sight:
    """The warning signs of a violation.

    Attributes:
        reported: What was reported within `WINDOW_S` before it.
        ever: Whether the counterpart was ever reported before it.
        in_range: Whether the counterpart was within range of a range sensor, and in its sectors, `LEAD_S` before it,
            even if something hid it. False for a violation sooner after the start than that.
    """

    reported: Reported
    ever: bool
    in_range: bool


def sight_of(trace: Trace, requirement: Judged) -> Sight | None:
    """Return the warning signs of the first violation of a drive; None if it has none.

    Args:
        trace: The drive.
        requirement: Ids of the requirements that count.
    """
    story = story_of(trace, requirement)
    if not story.violated:
        return None
    end, moment_s = story.decisive, story.violations[0].time_s
    actor = counterpart_of(trace, story)
    if actor is None:
        return Sight(reported=Reported.NO_ROAD_USER, ever=False, in_range=False)
    scene = EpisodeScene.of(trace)
    times_s = np.asarray(trace.time_s[: end + 1], np.float64)
    on_it = np.array([bool(obstacles_on(scene, sample, actor)) for sample in range(end + 1)])
    boxes = np.diff(trace.given_boxes.first)[: end + 1]
    recent = times_s >= moment_s - WINDOW_S
    reported = Reported.OTHERS if boxes[recent].any() else Reported.NOTHING
    earlier = int(np.abs(times_s - (moment_s - LEAD_S)).argmin())
    return Sight(
        reported=Reported.COUNTERPART if on_it[recent].any() else reported,
        ever=bool(on_it.any()),
        in_range=moment_s >= LEAD_S and _in_range(trace, earlier, actor),
    )


def _in_range(trace: Trace, sample: int, actor: int) -> bool:
    """Return whether a road user is within range of a range sensor on the front bumper, ignoring occlusion."""
    other = trace.actors[actor]
    x_m, y_m, yaw_rad = (float(value) for value in trace.ego[sample, :3])
    at_x_m, at_y_m, turned_rad = (float(value) for value in other.motion[sample, :3])
    if math.isnan(at_x_m):
        return False
    ahead_m, left_m = _rotated(at_x_m - x_m, at_y_m - y_m, -yaw_rad)
    return in_view(
        ahead_m - 0.5 * trace.ego_size_m[0], left_m, turned_rad - yaw_rad, other.length_m, other.width_m
    )


def _rotated(x: float, y: float, angle_rad: float) -> tuple[float, float]:
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    return x * cosine - y * sine, x * sine + y * cosine
