"""Measures the errors of an obstacle detector against the truth, in the terms of `detection_errors`.

The boxes of a drive are compared image by image. A detection belongs to the true box that it overlaps most. A road
user's *life* is the time for which it is visible; a detector is judged by the part in which the road user is a target
within the distance that matters to the driving system, whether or not it was reported before. For each type of error
and target, the measure is the worst of the drive:

- `miss`, `wrong_label`: the longest time, in images on end; an image lasts until the next one, and what is no target
  or hidden for up to `PAUSE_S`, or hands over to another target, ends no miss while it is not reported;
- `late`: the longest visible time before the first detection of a road user that becomes a target, from its first
  sight at any distance, as in `detection_errors`; time out of sight does not count, and one that is never reported is
  late by its whole life;
- `flicker` and errors of place and size: the mean while the target is there, if it is for `SUSTAINED_S` or longer;
- `short_range`: the distance from which on fewer than half of the sightings are detections;
- `ghost_on_road`: the longest time of a detection in the ego's lane where there is nothing.

What a drive cannot tell is left out: errors of place without a detection, a mean over a target that was there for
less than `SUSTAINED_S`, a target that was there for less than `SHORTEST_S`.

Concerning a target that stands for several road users, an error is one of all of them at a time, as in
`detection_errors`. Ghosts that stay in the image are not told apart from those on the road, and are not measured.

This module has no heavy imports: recordings are measured in the same way as simulated drives.
"""

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import PERCEPTION_STEP_S, Box, ObstacleLabel
from brink.sim.driving.obstacles import overlap
from brink.sim.episode import Json
from brink.sim.urban.detection_errors import BOX_TYPES, RELEVANT_M, ErrorType, Target

MEASURES: Final = "measured_errors"
"""Name of the feature with the detector's errors: the magnitude of each type, by target."""
SUSTAINED_S: Final = 4.0
"""Errors of place, size and share are means over the time for which the target is there, if it is this long."""
PAUSE_S: Final = 1.0
"""A longer gap between images, or a longer absence of the target, ends a miss."""
SHORTEST_S: Final = 1.0
"""Targets that are visible for less time are not measured."""
MATCHES_FROM: Final = 0.3
"""Overlap (IoU) from which a detection belongs to a true box."""
NOTHING_BELOW: Final = 0.1
"""A detection that overlaps every true box by less than this is a ghost."""
INSIDE_FROM: Final = 0.5
"""A detection is inside an ignored region if this share of it is."""
GHOST_WITHIN_M: Final = 40.0
HALF_LANE_M: Final = 1.75
RANGE_FROM_M: Final = 25.0
"""A drive in which nobody is this far away does not tell how far the detector sees."""
_BIN_M: Final = 5.0
_ROUNDING_S: Final = 1e-6

MEASURED: Final = tuple(kind for kind in BOX_TYPES if kind is not ErrorType.GHOST_IN_IMAGE)
Measures = Mapping[Target, Mapping[ErrorType, float]]
"""Magnitude of each type of error, by target. What a drive cannot tell is missing."""


class TrueBox(NamedTuple):
    """A road user in an image.

    Attributes:
        track: Identifies the road user in the drive.
        box: Its true box.
        kind: What it is: `Target.LEAD` for any vehicle that goes the ego's way.
        is_target: Whether it is the lead itself, or the nearest pedestrian in or beside the ego's lane.
        is_visible: Whether enough of it can be seen for a detector to be expected to report it.
        depth_m: Distance of its nearest point ahead of the camera; None to take it from the box's bottom edge.
        left_m: How far left of the camera's axis its middle is; None to take it from the box.
    """

    track: int
    box: Box
    kind: Target
    is_target: bool
    is_visible: bool = True
    depth_m: float | None = None
    left_m: float | None = None


class ReportedBox(NamedTuple):
    """A detection.

    Attributes:
        box: Its box.
        depth_m: Reported distance ahead of the camera; None to take it from the box's bottom edge.
        left_m: Reported place to the left of the camera's axis; None to take it from the box.
    """

    box: Box
    depth_m: float | None = None
    left_m: float | None = None


class Sample(NamedTuple):
    """One true box and its detection, if there is one.

    Attributes:
        time_s: Time of the image.
        track: Of the true box.
        kind: Of the true box.
        is_target: Of the true box.
        is_visible: Of the true box.
        label: Of the true box.
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
    is_visible: bool
    label: ObstacleLabel
    depth_m: float
    is_seen: bool
    is_wrong: bool = False
    far: float = math.nan
    right_m: float = math.nan
    size: float = math.nan


class Span(NamedTuple):
    """When an error occurred in a drive.

    Attributes:
        from_s: Time of its first image.
        duration_s: How long it lasted.
        track: The road user that it concerned; None if it concerned none or several.
    """

    from_s: float
    duration_s: float
    track: int | None = None


@dataclass(slots=True)
class DriveErrors:
    """The errors of a detector in one drive.

    Attributes:
        magnitudes: Magnitude of each type of error, by target; what the drive cannot tell is missing.
        at_least: Types whose magnitude is a lower bound, by target: the drive was cut off at the time, or the road
            user was never reported. A lower bound of no error is uninformative.
        spans: When the worst error of those types occurred that have a time.
    """

    magnitudes: dict[Target, dict[ErrorType, float]] = field(default_factory=dict)
    at_least: dict[Target, set[ErrorType]] = field(default_factory=dict)
    spans: dict[Target, dict[ErrorType, Span]] = field(default_factory=dict)

    def note(self, target: Target, kind: ErrorType, span: Span, *, at_least: bool = False) -> None:
        """Record an error of a type and the time at which it occurred."""
        self.magnitudes.setdefault(target, {})[kind] = span.duration_s
        if span.duration_s > 0.0:
            self.spans.setdefault(target, {})[kind] = span
        if at_least:
            self.at_least.setdefault(target, set()).add(kind)


class _Look(NamedTuple):
    """An image of a run.

    Attributes:
        time_s: Time of the image.
        lasts_s: Time until the next image; 0 if the target is not there, so that the image does not count.
        samples: The target's road users; if it is not there, those that were the target just before.
    """

    time_s: float
    lasts_s: float
    samples: Sequence[Sample]

    @property
    def is_missed(self) -> bool:
        return not any(sample.is_seen for sample in self.samples)

    @property
    def is_mislabelled(self) -> bool:
        return not self.is_missed and all(sample.is_wrong for sample in self.samples if sample.is_seen)


_Run = list[_Look]
"""The images of a time in which a target was there, but for interruptions of at most `PAUSE_S`."""


class ErrorMeter:
    """Measures one drive.

    Args:
        camera: Camera of the boxes.
        step_s: Time between images.
        is_excerpt: Whether the images were cut out of a longer drive, so that what is there in the first image may
            have been in sight before.
        in_lane: Returns whether a box stands in the ego's lane; by default the lane is taken to lead straight ahead.

    Attributes:
        samples: All true boxes, in the order of their images.
        ghosts: Time of each image, and the labels of the detections in the ego's lane where nothing is.
    """

    def __init__(
        self,
        camera: Camera,
        step_s: float = PERCEPTION_STEP_S,
        *,
        is_excerpt: bool = False,
        in_lane: Callable[[Box], bool] | None = None,
    ) -> None:
        self._camera = camera
        self._step_s = step_s
        self._is_excerpt = is_excerpt
        self._in_lane = in_lane
        self.samples: list[Sample] = []
        self.ghosts: list[tuple[float, frozenset[ObstacleLabel]]] = []

    def see(
        self,
        time_s: float,
        truth: Sequence[TrueBox],
        detections: Sequence[ReportedBox],
        ignored: Sequence[Box] = (),
        parked: Sequence[Box] = (),
    ) -> None:
        """Compare the boxes of one image; times must ascend.

        Args:
            time_s: Time of the image.
            truth: Its true boxes, hidden ones included.
            detections: What was reported.
            ignored: Regions in which nothing is known: what is reported there is no ghost.
            parked: Boxes of parked cars, which are no road users and no ghosts either.
        """
        overlaps = sorted(
            (
                (shared, row, column)
                for row, true in enumerate(truth)
                for column, reported in enumerate(detections)
                if (shared := overlap(true.box, reported.box)) >= MATCHES_FROM
            ),
            reverse=True,
        )
        matched: dict[int, int] = {}
        for _, row, column in overlaps:
            if row not in matched and column not in matched.values():
                matched[row] = column
        for row, true in enumerate(truth):
            self.samples.append(
                self._compared(time_s, true, detections[matched[row]] if row in matched else None)
            )
        ghosts = {
            reported.box.label
            for column, reported in enumerate(detections)
            if column not in matched.values()
            and self._is_in_lane(reported)
            and all(
                overlap(box, reported.box) < NOTHING_BELOW for box in (*(true.box for true in truth), *parked)
            )
            and all(_inside(reported.box, region) < INSIDE_FROM for region in ignored)
        }
        self.ghosts.append((time_s, frozenset(ghosts)))

    def _is_in_lane(self, reported: ReportedBox) -> bool:
        box, depth_m, left_m = reported
        if depth_m is None:
            depth_m = self._camera.ground_depth_m(box.y_max_px)
        if depth_m is None or depth_m > GHOST_WITHIN_M:
            return False
        if self._in_lane is not None:
            return self._in_lane(box)
        if left_m is None:
            left_m = self._camera.left_m(0.5 * (box.x_min_px + box.x_max_px), depth_m)
        return abs(left_m) < HALF_LANE_M

    def _compared(self, time_s: float, true: TrueBox, reported: ReportedBox | None) -> Sample:
        depth_m = self._depth_m(true.box) if true.depth_m is None else true.depth_m
        sample = Sample(
            time_s,
            true.track,
            true.kind,
            true.is_target,
            true.is_visible,
            true.box.label,
            depth_m,
            is_seen=reported is not None,
        )
        if reported is None:
            return sample
        box, found = true.box, reported.box
        if true.depth_m is None or reported.depth_m is None:
            far = self._depth_m(found) / self._depth_m(box)
        else:
            far = reported.depth_m / max(true.depth_m, self._camera.near_m)
        if true.left_m is None or reported.left_m is None:
            middle_px = 0.5 * (found.x_min_px + found.x_max_px - box.x_min_px - box.x_max_px)
            right_m = middle_px * depth_m / self._camera.focal_px
        else:
            right_m = true.left_m - reported.left_m
        return sample._replace(
            is_wrong=found.label is not box.label,
            far=far - 1.0,
            right_m=right_m,
            size=math.sqrt(_area(found) / _area(box)) - 1.0,
        )

    def _depth_m(self, box: Box) -> float:
        depth_m = self._camera.ground_depth_m(box.y_max_px)
        return self._camera.far_m if depth_m is None else min(depth_m, self._camera.far_m)

    def errors(self) -> DriveErrors:
        """Return the detector's errors."""
        return _Judge(self.samples, self.ghosts, self._step_s, is_excerpt=self._is_excerpt).errors()


class _Judge:
    """Finds the worst errors of a drive from its compared images."""

    def __init__(
        self,
        samples: Sequence[Sample],
        ghosts: Sequence[tuple[float, frozenset[ObstacleLabel]]],
        step_s: float,
        *,
        is_excerpt: bool,
    ) -> None:
        self._samples = samples
        self._ghosts = ghosts
        self._step_s = step_s
        self._is_excerpt = is_excerpt
        self._pause_s = max(PAUSE_S, 2.5 * step_s)
        times = [time_s for time_s, _ in ghosts]
        gaps_s = [later - earlier for earlier, later in itertools.pairwise(times)]
        breaks = [i for i, gap_s in enumerate(gaps_s) if gap_s > self._pause_s]
        # Before a longer break, an image lasts as long as usual.
        self._lasts_s = dict(zip(times, [*gaps_s, step_s], strict=True))
        self._lasts_s |= {times[i]: step_s for i in breaks}
        self._begins = {*times[:1], *(times[i + 1] for i in breaks)}
        self._ends = {*times[-1:], *(times[i] for i in breaks)}
        self._by_time: dict[float, list[Sample]] = {}
        for sample in samples:
            self._by_time.setdefault(sample.time_s, []).append(sample)

    def errors(self) -> DriveErrors:
        found = DriveErrors()
        for target in Target:
            single = target in (Target.LEAD, Target.PEDESTRIAN)
            visible = [s for s in self._samples if target in (Target.EVERYBODY, s.kind) and s.is_visible]
            near = [s for s in visible if s.depth_m <= RELEVANT_M and (s.is_target or not single)]
            runs = self._runs(near)
            looks = [look for run in runs for look in run]
            if sum(look.lasts_s for look in looks) < SHORTEST_S - _ROUNDING_S:
                continue
            self._note_longest(found, target, ErrorType.MISS, looks, lambda look: look.is_missed)
            if sum(look.lasts_s for look in looks if not look.is_missed) >= SHORTEST_S - _ROUNDING_S:
                self._note_longest(
                    found, target, ErrorType.WRONG_LABEL, looks, lambda look: look.is_mislabelled
                )
            _note_means(found.magnitudes[target], runs)
            self._note_delay(found, target, {sample.track for sample in near})
            _note_range(found, target, visible)
        for label, target in (
            (ObstacleLabel.VEHICLE, Target.LEAD),
            (ObstacleLabel.PERSON, Target.PEDESTRIAN),
        ):
            flags = (
                (time_s, self._lasts_s[time_s], label in labels, None) for time_s, labels in self._ghosts
            )
            found.note(target, ErrorType.GHOST_ON_ROAD, self._longest(flags)[0])
        return found

    def _runs(self, samples: Sequence[Sample]) -> list[_Run]:
        """Return the time spans with samples, including the images of short interruptions.

        Who stops being the target for a moment, hides for a moment, or hands over to another does not end a run. In
        an interruption, those who were the target just before are watched.
        """
        here_by_time: dict[float, list[Sample]] = {}
        for sample in samples:
            here_by_time.setdefault(sample.time_s, []).append(sample)
        runs: list[_Run] = []
        last_s = -math.inf
        tracks: set[int] = set()
        for time_s, lasts_s in self._lasts_s.items():
            here = here_by_time.get(time_s)
            is_over = time_s - last_s > self._pause_s + _ROUNDING_S
            if here is None:
                if not is_over:
                    watched = [s for s in self._by_time.get(time_s, ()) if s.track in tracks]
                    runs[-1].append(_Look(time_s, 0.0, watched))
                continue
            if is_over:
                runs.append([])
            runs[-1].append(_Look(time_s, lasts_s, here))
            last_s, tracks = time_s, {sample.track for sample in here}
        return runs

    def _note_longest(
        self,
        found: DriveErrors,
        target: Target,
        kind: ErrorType,
        looks: Sequence[_Look],
        is_wrong: Callable[[_Look], bool],
    ) -> None:
        """Record the longest time for which consecutive images are wrong."""
        span, until_s = self._longest(
            (
                look.time_s,
                look.lasts_s,
                is_wrong(look),
                look.samples[0].track if len(look.samples) == 1 else None,
            )
            for look in looks
            # While the target is not there, only a detection of it tells something.
            if look.lasts_s > 0.0 or not look.is_missed
        )
        is_cut_off = span.duration_s > 0.0 and (span.from_s in self._begins or until_s in self._ends)
        found.note(target, kind, span, at_least=self._is_excerpt and is_cut_off)

    def _longest(self, flags: Iterable[tuple[float, float, bool, int | None]]) -> tuple[Span, float]:
        """Return the longest time for which a flag holds without a break, and the time of its last image.

        Args:
            flags: Time, duration, flag and track of each image.
        """
        worst, until_s = Span(0.0, 0.0), -math.inf
        from_s = held_s = 0.0
        before_s = -math.inf
        for time_s, lasts_s, holds, track in flags:
            if not holds:
                held_s = 0.0
                continue
            if held_s == 0.0 or time_s - before_s > self._pause_s + _ROUNDING_S:
                from_s, held_s = time_s, 0.0
            held_s += lasts_s
            before_s = time_s
            if held_s > worst.duration_s:
                worst, until_s = Span(from_s, held_s, track), time_s
        return worst, until_s

    def _note_delay(self, found: DriveErrors, target: Target, tracks: Iterable[int]) -> None:
        """Record the longest time that a new target was visible before its first detection."""
        worst, is_bound, tells = Span(0.0, 0.0), False, False
        lives: dict[int, list[Sample]] = {track: [] for track in sorted(tracks)}
        for sample in self._samples:  # whatever it was to the ego before
            if sample.track in lives:
                lives[sample.track].append(sample)
        for track, life in lives.items():
            first = next((i for i, sample in enumerate(life) if sample.is_seen), len(life))
            delay_s = sum(self._lasts_s[sample.time_s] for sample in life[:first] if sample.is_visible)
            was_there = self._is_excerpt and life[0].time_s in self._begins
            tells = tells or delay_s > 0.0 or not was_there
            if delay_s > worst.duration_s:
                worst = Span(life[0].time_s, delay_s, track)
                is_bound = was_there or first == len(life)
        # Of road users that were reported in the first image of an excerpt, nobody knows how late that was.
        found.note(target, ErrorType.LATE, worst, at_least=is_bound or not tells)


def measures_to_json(meter: ErrorMeter) -> dict[str, Json]:
    """Return a drive's errors as the feature `MEASURES`."""
    return {
        MEASURES: {
            target.value: {kind.value: magnitude for kind, magnitude in errors.items()}
            for target, errors in meter.errors().magnitudes.items()
        }
    }


def _note_means(magnitudes: dict[ErrorType, float], runs: Sequence[_Run]) -> None:
    """Record the worst means over spans with the target present; none if it is never present for long enough."""

    def note(kind: ErrorType, value: float) -> None:
        magnitudes[kind] = max(magnitudes.get(kind, 0.0), value)

    for run in runs:
        there = [look for look in run if look.lasts_s > 0.0]
        there_s = sum(look.lasts_s for look in there)
        if there_s < SUSTAINED_S - _ROUNDING_S:
            continue
        note(ErrorType.FLICKER, sum(look.lasts_s for look in there if look.is_missed) / there_s)
        seen = [sample for look in there for sample in look.samples if sample.is_seen]
        if sum(look.lasts_s for look in there if not look.is_missed) < SHORTEST_S - _ROUNDING_S:
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


def _note_range(found: DriveErrors, target: Target, samples: Sequence[Sample]) -> None:
    """Record the distance beyond which fewer than half of the sightings are detected.

    Distances count in bins of `_BIN_M`, from the farthest that has a sighting. If most sightings there are
    detections, the range is taken to end where nobody was looked at any more, and is not known at all below
    `RANGE_FROM_M`. If they are in no bin, the range may be shorter than the nearest sighting says.
    """
    bins: dict[int, list[bool]] = {}
    for sample in samples:
        if sample.depth_m < RELEVANT_M:
            bins.setdefault(int(sample.depth_m / _BIN_M), []).append(sample.is_seen)
    numbers = sorted(bins, reverse=True)
    reported = next((number for number in numbers if 2 * sum(bins[number]) >= len(bins[number])), None)
    if reported is None:
        range_m = _BIN_M * min(numbers, default=0)
        found.at_least.setdefault(target, set()).add(ErrorType.SHORT_RANGE)
    elif reported == numbers[0]:
        range_m = min(_BIN_M * (reported + 1), RELEVANT_M)
        if range_m < RANGE_FROM_M:
            return
    else:
        range_m = _BIN_M * numbers[numbers.index(reported) - 1]
    found.magnitudes[target][ErrorType.SHORT_RANGE] = range_m


def _area(box: Box) -> float:
    return (box.x_max_px - box.x_min_px) * (box.y_max_px - box.y_min_px)


def _shared(one: Box, other: Box) -> float:
    """Return the area of the intersection of two boxes."""
    wide = min(one.x_max_px, other.x_max_px) - max(one.x_min_px, other.x_min_px)
    high = min(one.y_max_px, other.y_max_px) - max(one.y_min_px, other.y_min_px)
    return max(wide, 0.0) * max(high, 0.0)


def _inside(box: Box, region: Box) -> float:
    """Return the share of a box that lies in a region."""
    return _shared(box, region) / _area(box)


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredDrive:
    """The errors of a detector in one drive.

    Attributes:
        name: Name of the drive.
        condition: Name of its condition; None if it is unknown.
        errors: How wrong the detector was.
    """

    name: str
    condition: str | None
    errors: DriveErrors
