"""Measures the errors of an obstacle detector against the truth, in the terms of `detection_errors`.

The boxes of a drive are compared frame by frame. A detection belongs to the true box that it overlaps most. For each
type of error and target, the measure is the worst of the drive:

- `miss`, `wrong_label`: the longest time, after the first detection;
- `late`: the longest delay from first sight to first detection, of road users that become a target;
- `flicker` and errors of place and size: the mean while the target is there, if it is for `SUSTAINED_S` or longer;
- `short_range`: the distance from which on fewer than half of the sightings are detections;
- `ghost_on_road`: the longest time of a detection in the ego's lane where there is nothing.

Concerning a target that stands for several road users, an error is one of all of them at a time, as in
`detection_errors`. All but `late` concern road users within the distance that matters to the driving system. Ghosts
that stay in the image are not told apart from those on the road, and are not measured.

This module has no heavy imports: detections from other sources are measured in the same way.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import Box, ObstacleLabel
from brink.sim.urban.behaviour import PERCEPTION_STEP_S
from brink.sim.urban.detection_errors import GHOSTS, MAGNITUDES, RELEVANT_M, ErrorType, Target

MEASURES: Final = "detector_errors"
"""Name of the feature with the detector's errors: the magnitude of each type, by target."""
SUSTAINED_S: Final = 4.0
"""Errors of place, size and share are means over the time for which the target is there, if it is this long."""
SHORTEST_S: Final = 1.0
"""Targets that are visible for less time are not measured."""
MATCHES_FROM: Final = 0.3
"""Overlap (IoU) from which a detection belongs to a true box."""
NOTHING_BELOW: Final = 0.1
"""A detection that overlaps every true box by less than this is a ghost."""
GHOST_WITHIN_M: Final = 40.0
HALF_LANE_M: Final = 1.75
_BIN_M: Final = 5.0

_NOTHING_THERE: Final = {kind: MAGNITUDES[kind].none for kind in ErrorType if kind not in GHOSTS}
"""The errors concerning a target that a drive lacks: none."""
MEASURED: Final = tuple(kind for kind in ErrorType if kind is not ErrorType.GHOST_IN_IMAGE)
Measures = Mapping[Target, Mapping[ErrorType, float]]
"""Magnitude of each type of error, by target; targets that a drive lacks are missing."""


class TrueBox(NamedTuple):
    """A road user in an image.

    Attributes:
        track: Identifies the road user in the drive.
        box: Its true box.
        kind: What it is: `Target.LEAD` for any vehicle that goes the ego's way.
        is_target: Whether it is the lead itself, or the nearest pedestrian in or beside the ego's lane.
    """

    track: int
    box: Box
    kind: Target
    is_target: bool


class _Sample(NamedTuple):
    """One true box and its detection, if there is one.

    Attributes:
        time_s: Time of the image.
        track: Of the true box.
        kind: Of the true box.
        is_target: Of the true box.
        depth_m: True distance.
        is_seen: Whether there is a detection.
        is_wrong: Whether the detection has the wrong label.
        far: Error of the distance, as a share of it; NaN without a detection.
        right_m: Error to the side; NaN without a detection.
        size: Error of the size, as a share of it; NaN without a detection.
    """

    time_s: float
    track: int
    kind: Target
    is_target: bool
    depth_m: float
    is_seen: bool
    is_wrong: bool = False
    far: float = math.nan
    right_m: float = math.nan
    size: float = math.nan


class ErrorMeter:
    """Measures one drive.

    Args:
        camera: Camera of the boxes.
        step_s: Time between images.
    """

    def __init__(self, camera: Camera, step_s: float = PERCEPTION_STEP_S) -> None:
        self._camera = camera
        self._step_s = step_s
        self._samples: list[_Sample] = []
        self._ghosts: list[tuple[float, frozenset[ObstacleLabel]]] = []

    def see(self, time_s: float, truth: Sequence[TrueBox], detections: Sequence[Box]) -> None:
        """Compare the boxes of one image; times must ascend."""
        overlaps = sorted(
            (
                (overlap, row, column)
                for row, true in enumerate(truth)
                for column, box in enumerate(detections)
                if (overlap := _overlap(true.box, box)) >= MATCHES_FROM
            ),
            reverse=True,
        )
        matched: dict[int, int] = {}
        for _, row, column in overlaps:
            if row not in matched and column not in matched.values():
                matched[row] = column
        for row, true in enumerate(truth):
            self._samples.append(
                self._compared(time_s, true, detections[matched[row]] if row in matched else None)
            )
        ghosts = {
            box.label
            for column, box in enumerate(detections)
            if column not in matched.values()
            and self._is_in_lane(box)
            and all(_overlap(true.box, box) < NOTHING_BELOW for true in truth)
        }
        self._ghosts.append((time_s, frozenset(ghosts)))

    def _is_in_lane(self, box: Box) -> bool:
        depth_m = self._camera.ground_depth_m(box.y_max_px)
        if depth_m is None or depth_m > GHOST_WITHIN_M:
            return False
        return abs(self._camera.left_m(0.5 * (box.x_min_px + box.x_max_px), depth_m)) < HALF_LANE_M

    def _compared(self, time_s: float, true: TrueBox, found: Box | None) -> _Sample:
        camera, box = self._camera, true.box
        depth_m = camera.ground_depth_m(box.y_max_px)
        if depth_m is None:
            depth_m = camera.far_m
        if found is None:
            return _Sample(time_s, true.track, true.kind, true.is_target, depth_m, is_seen=False)
        found_m = camera.ground_depth_m(found.y_max_px)
        middle_px = 0.5 * (found.x_min_px + found.x_max_px - box.x_min_px - box.x_max_px)
        return _Sample(
            time_s,
            true.track,
            true.kind,
            true.is_target,
            depth_m,
            is_seen=True,
            is_wrong=found.label is not box.label,
            far=(camera.far_m if found_m is None else min(found_m, camera.far_m)) / depth_m - 1.0,
            right_m=middle_px * depth_m / camera.focal_px,
            size=math.sqrt(_area(found) / _area(box)) - 1.0,
        )

    def measures(self) -> Measures:
        """Return the magnitude of each type of error, by target."""
        found: dict[Target, dict[ErrorType, float]] = {}
        for target in Target:
            single = target in (Target.LEAD, Target.PEDESTRIAN)
            members = [s for s in self._samples if target in (Target.EVERYBODY, s.kind)]
            near = [s for s in members if s.depth_m <= RELEVANT_M and (s.is_target or not single)]
            series = self._series(near, split=single)
            frames = [frame for run in series for frame in run]
            if len(frames) * self._step_s < SHORTEST_S:
                continue
            errors = self._windowed(series)
            tracks = {s.track for s in members if s.is_target} if single else {s.track for s in members}
            errors[ErrorType.LATE] = max(
                (self._delay_s([s for s in members if s.track == track]) for track in tracks), default=0.0
            )
            errors[ErrorType.SHORT_RANGE] = _range_m(members)
            found[target] = errors
        for label, target in (
            (ObstacleLabel.VEHICLE, Target.LEAD),
            (ObstacleLabel.PERSON, Target.PEDESTRIAN),
        ):
            held_s = self._longest_s([(time_s, label in labels) for time_s, labels in self._ghosts])
            if held_s > 0.0 or target in found:
                found.setdefault(target, dict(_NOTHING_THERE))[ErrorType.GHOST_ON_ROAD] = held_s
        return found

    def _series(self, samples: Sequence[_Sample], *, split: bool) -> list[list[list[_Sample]]]:
        """Return runs of consecutive images, each with the samples in it; `split` where the road user changes."""
        runs: list[list[list[_Sample]]] = []
        for sample in samples:
            last = runs[-1][-1] if runs else None
            if last is not None and last[0].time_s == sample.time_s and not split:
                last.append(sample)
                continue
            follows = (
                last is not None
                and sample.time_s - last[0].time_s < 1.5 * self._step_s
                and (not split or sample.track == last[0].track)
            )
            if follows:
                runs[-1].append([sample])
            else:
                runs.append([[sample]])
        return runs

    def _windowed(self, runs: Sequence[Sequence[Sequence[_Sample]]]) -> dict[ErrorType, float]:
        worst = dict.fromkeys(
            (
                ErrorType.MISS, ErrorType.WRONG_LABEL, ErrorType.FLICKER, ErrorType.TOO_FAR, ErrorType.TOO_NEAR,
                ErrorType.LEFT, ErrorType.RIGHT, ErrorType.TOO_LARGE, ErrorType.TOO_SMALL,
            ),
            0.0,
        )  # fmt: skip

        def note(kind: ErrorType, value: float) -> None:
            if value > worst[kind]:
                worst[kind] = value

        seen_before: set[int] = set()
        long_enough = round(SUSTAINED_S / self._step_s)
        for run in runs:
            missed: list[tuple[float, bool]] = []
            wrong: list[tuple[float, bool]] = []
            for frame in run:
                known = [s for s in frame if s.is_seen or s.track in seen_before]
                seen_before |= {s.track for s in frame if s.is_seen}
                missed.append((frame[0].time_s, bool(known) and not any(s.is_seen for s in frame)))
                seen = [s for s in frame if s.is_seen]
                wrong.append((frame[0].time_s, bool(seen) and all(s.is_wrong for s in seen)))
            note(ErrorType.MISS, self._longest_s(missed))
            note(ErrorType.WRONG_LABEL, self._longest_s(wrong))
            if len(run) < long_enough:
                continue
            note(ErrorType.FLICKER, sum(off for _, off in missed) / len(run))
            seen = [s for frame in run for s in frame if s.is_seen]
            if len(seen) * self._step_s < SHORTEST_S:
                continue
            far, right_m, size = (
                sum(values) / len(seen)
                for values in zip(*((s.far, s.right_m, s.size) for s in seen), strict=True)
            )
            note(ErrorType.TOO_FAR, far)
            note(ErrorType.TOO_NEAR, -far)
            note(ErrorType.RIGHT, right_m)
            note(ErrorType.LEFT, -right_m)
            note(ErrorType.TOO_LARGE, size)
            note(ErrorType.TOO_SMALL, -size)
        return worst

    def _longest_s(self, flags: Sequence[tuple[float, bool]]) -> float:
        """Return the longest time for which a flag holds in consecutive images."""
        longest = held = 0
        for _, holds in flags:
            held = held + 1 if holds else 0
            longest = max(longest, held)
        return longest * self._step_s

    def _delay_s(self, samples: Sequence[_Sample]) -> float:
        """Return the time from the first sight of a road user to its first detection, or to its last sight."""
        first_s = samples[0].time_s
        seen_s = next((s.time_s for s in samples if s.is_seen), samples[-1].time_s + self._step_s)
        return seen_s - first_s


def _range_m(samples: Sequence[_Sample]) -> float:
    """Return the distance from which on fewer than half of the sightings are detections; `RELEVANT_M` for none.

    Distances count in bins of `_BIN_M`, from the farthest that has a sighting.
    """
    bins: dict[int, list[bool]] = {}
    for sample in samples:
        if sample.depth_m <= RELEVANT_M:
            bins.setdefault(int(sample.depth_m / _BIN_M), []).append(sample.is_seen)
    range_m = RELEVANT_M
    for number in sorted(bins, reverse=True):
        if 2 * sum(bins[number]) >= len(bins[number]):
            break
        range_m = number * _BIN_M
    return range_m


def _area(box: Box) -> float:
    return (box.x_max_px - box.x_min_px) * (box.y_max_px - box.y_min_px)


def _overlap(one: Box, other: Box) -> float:
    """Return the intersection over union of two boxes, whatever their labels."""
    wide = min(one.x_max_px, other.x_max_px) - max(one.x_min_px, other.x_min_px)
    high = min(one.y_max_px, other.y_max_px) - max(one.y_min_px, other.y_min_px)
    if wide <= 0.0 or high <= 0.0:
        return 0.0
    return wide * high / (_area(one) + _area(other) - wide * high)


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredDrive:
    """The errors of a detector in one drive.

    Attributes:
        name: Name of the drive.
        condition: Name of its condition; None if it is unknown.
        measures: Magnitude of each type of error, by target.
    """

    name: str
    condition: str | None
    measures: Measures
