"""Fits the errors of a detector in a recording as a random process: `brink.sim.urban.error_process`.

A *sighting* is the time from image to image in which a road user is visible. Probabilities are events by images at
risk, so that lives which the recording cuts off count for as long as they were seen: a sighting that begins with the
drive does not tell how late the first report was, and one that ends with it not how long a miss would have lasted.

Numbers that rest on few samples are drawn towards those that rest on more: a bin of distance of all vehicles towards
all vehicles, as if by `PRIOR` more samples, and the bin of the lead or of other vehicles towards that, likewise.
Replicates are fits to the drives with random weights (the Bayesian bootstrap, Rubin 1981). None of these is 0, so
that no replicate lacks the only drives with pedestrians.
"""

import itertools
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from brink.recordings.choices import TYPES
from brink.recordings.recording import RecordingError
from brink.search.streams import Stream, generator
from brink.sim.driving.interface import PERCEPTION_STEP_S, ObstacleLabel
from brink.sim.urban.error_draws import LONG_AGO, age_class, bin_of, group_of
from brink.sim.urban.error_meter import ErrorMeter, Sample
from brink.sim.urban.error_process import (
    AGES_S,
    AT_ONCE,
    EDGES_M,
    ERRORS,
    FOUND,
    FOUND_FIRST,
    GROUPS,
    KEPT,
    LABELS,
    LOST,
    SCORES,
    SEEN,
    SHARES,
    WRONG_LABEL,
    ErrorProcess,
    FittedErrors,
    FloatArray,
)

LATER_S: Final = 1.0
"""Time after which errors of one road user are alike because of what is constant in them."""
_ITERATIONS: Final = 20
_MOST_KEPT: Final = 0.999
PRIOR: Final = 10.0
"""How many samples it counts for what is known from more than the bin of a group."""
REPLICATES: Final = 20
FEWEST_DRIVES: Final = 5
"""With fewer drives, random weights do not show how uncertain a fit is."""

IntArray: TypeAlias = NDArray[np.int64]
_DECIMALS: Final = 9
"""Errors of place and size are rounded to these, so that equal boxes have none."""
_BY_LABEL: Final = ([GROUPS.index("lead"), GROUPS.index("vehicle")], [GROUPS.index("pedestrian")])
_SHAPE: Final = (len(GROUPS), len(EDGES_M), len(SHARES))
_LEVELS: Final = stats.norm.cdf(SCORES)


@dataclass(slots=True, eq=False)
class _Counts:
    """Events and images at risk in one drive, by group, bin and column of `SHARES`, and pairs of labels by group."""

    events: FloatArray
    at_risk: FloatArray
    labels: FloatArray

    @classmethod
    def none(cls) -> "_Counts":
        return cls(np.zeros(_SHAPE), np.zeros(_SHAPE), np.zeros((len(GROUPS), 2)))

    def add(self, group: int, row: int, column: int, *, happens: bool) -> None:
        self.at_risk[group, row, column] += 1
        self.events[group, row, column] += happens


@dataclass(slots=True, kw_only=True, eq=False)
class _Values:
    """Errors of position and size of everything that was reported.

    Attributes:
        drive: Number of the drive, shape ``(n,)``.
        group: Number of the group, shape ``(n,)``.
        row: Number of the bin of distance, shape ``(n,)``.
        errors: `ERRORS`, shape ``(n, 3)``.
        back: How many values before is that of the same sighting one image before and `LATER_S` before, shape
            ``(n, 2)``; 0 if it was not reported then.
    """

    drive: IntArray
    group: IntArray
    row: IntArray
    errors: FloatArray
    back: IntArray


@dataclass(slots=True, kw_only=True, eq=False)
class _Drive:
    """The data of one drive that a fit needs."""

    hours: float
    step_s: float
    counts: _Counts
    values: list[tuple[float, ...]]
    ghosts: list[list[float]]


def fit_errors(
    meters: Sequence[ErrorMeter],
    detector: str,
    *,
    without: Collection[str] = (),
    replicates: int = REPLICATES,
    seed: int = 0,
) -> FittedErrors:
    """Fit the errors of a detector.

    Args:
        meters: What was measured in each drive.
        detector: Name of the detector.
        without: Types of errors to leave out, of `TYPES`: those are then as if the detector reported the truth.
        replicates: Number of fits to the drives with random weights.
        seed: Determines the weights.

    Raises:
        RecordingError: There are too few drives, or nothing is visible in them.
    """
    if len(meters) < FEWEST_DRIVES:
        raise RecordingError(
            f"expected at least {FEWEST_DRIVES} drives, to estimate the uncertainty of the fit; got {len(meters)}"
        )
    read = [_read(meter) for meter in meters]
    fit = _Fit(read)
    at_risk = np.sum([one.counts.at_risk for one in read], axis=0)
    if not at_risk[:, :, SEEN].any():
        raise RecordingError("expected visible road users in the recording, found none")
    rng = generator(seed, Stream.ERRORS)
    weights = len(read) * rng.dirichlet(np.ones(len(read)), size=replicates)
    hours = sum(one.hours for one in read)
    return FittedErrors(
        detector=detector,
        drives=len(read),
        hours=hours,
        without=tuple(name for name in TYPES if name in without),
        process=_without(fit.process(np.ones(len(read))), without),
        rests_on=at_risk,
        ghosts=tuple(sum(len(one.ghosts[i]) for one in read) for i in range(len(LABELS))),
        replicates=tuple(_without(fit.process(of_drive), without) for of_drive in weights),
    )


def _read(meter: ErrorMeter) -> _Drive:
    """Return the events and values of a drive, from images about every `PERCEPTION_STEP_S`."""
    all_times = [time_s for time_s, _ in meter.ghosts]
    own_step_s = round(float(np.median(np.diff(all_times))), 3)
    every = max(round(PERCEPTION_STEP_S / own_step_s), 1)
    times = all_times[::every]
    numbers = {time_s: number for number, time_s in enumerate(times)}
    lives: dict[int, list[tuple[int, Sample]]] = {}
    for sample in meter.samples:
        if sample.is_visible and sample.time_s in numbers:
            lives.setdefault(sample.track, []).append((numbers[sample.time_s], sample))
    step_s = every * own_step_s
    drive = _Drive(
        hours=len(times) * step_s / 3600.0,
        step_s=step_s,
        counts=_Counts.none(),
        values=[],
        ghosts=[_durations(meter, times, label, step_s) for label in LABELS],
    )
    for life in lives.values():
        for sighting in _sightings(life):
            _count(sighting, drive)
    return drive


def _sightings(life: Sequence[tuple[int, Sample]]) -> Iterator[list[tuple[int, Sample]]]:
    """Yield runs of consecutive images."""
    for _, run in itertools.groupby(enumerate(life), lambda item: item[1][0] - item[0]):
        yield [item for _, item in run]


def _count(sighting: Sequence[tuple[int, Sample]], drive: _Drive) -> None:
    """Add one sighting."""
    counts, later = drive.counts, _images_later(drive.step_s)
    begins_with_drive = sighting[0][0] == 0
    was_found, since = begins_with_drive, -LONG_AGO if begins_with_drive else sighting[0][0]
    before: Sample | None = None
    places: dict[int, int] = {}
    for number, sample in sighting:
        group, row = group_of(sample.label, is_target=sample.is_target), bin_of(sample.depth_m)
        seen = sample.is_seen
        counts.add(group, row, SEEN, happens=seen)
        if before is None:
            if not begins_with_drive:
                counts.add(group, row, AT_ONCE, happens=seen)
        else:
            age = age_class(round((number - since) * drive.step_s / PERCEPTION_STEP_S))
            if before.is_seen:
                counts.add(group, row, LOST + age, happens=not seen)
            else:
                counts.add(group, row, FOUND + age if was_found else FOUND_FIRST, happens=seen)
            if seen != before.is_seen:
                since = number
        if seen:
            counts.add(group, row, WRONG_LABEL, happens=sample.is_wrong)
            if before is not None and before.is_wrong:
                counts.labels[group] += (sample.is_wrong, 1.0)
            places[number] = here = len(drive.values)
            back = (here - places.get(number - images, here) for images in (1, later))
            drive.values.append((group, row, sample.far, sample.right_m, sample.size, *back))
            was_found = True
        before = sample


def _images_later(step_s: float) -> int:
    """Return how many images, one step apart, are taken in `LATER_S`."""
    return max(round(LATER_S / step_s), 2)


def _durations(meter: ErrorMeter, times: Sequence[float], label: ObstacleLabel, step_s: float) -> list[float]:
    """Return how long each ghost lasted."""
    labels = dict(meter.ghosts)
    runs = itertools.groupby(label in labels[time_s] for time_s in times)
    return [step_s * sum(1 for _ in run) for is_ghost, run in runs if is_ghost]


class _Fit:
    """Fits a process to drives with weights."""

    def __init__(self, drives: Sequence[_Drive]) -> None:
        self._drives = drives
        self._events = np.array([one.counts.events for one in drives])
        self._at_risk = np.array([one.counts.at_risk for one in drives])
        self._labels = np.array([one.counts.labels for one in drives])
        self._hours = np.array([one.hours for one in drives])
        # Images are as far apart in all drives of a recording, or nearly so.
        step_s = float(np.median([one.step_s for one in drives]))
        self._power, self._later = PERCEPTION_STEP_S / step_s, _images_later(step_s)
        rows = [(number, *row) for number, one in enumerate(drives) for row in one.values]
        table = np.array(rows, np.float64).reshape(-1, 8)
        whole = table[:, :3].astype(np.int64)
        self._values = _Values(
            drive=whole[:, 0],
            group=whole[:, 1],
            row=whole[:, 2],
            errors=table[:, 3:6].round(_DECIMALS),
            back=table[:, 6:].astype(np.int64),
        )
        self._scores = self._normal_scores()

    def _normal_scores(self) -> FloatArray:
        """Return the errors as normal scores within their group and bin, shape ``(n, 3)``."""
        values = self._values
        scores = np.zeros_like(values.errors)
        for group, row in itertools.product(range(len(GROUPS)), range(len(EDGES_M))):
            own = (values.group == group) & (values.row == row)
            if own.any():
                ranks = stats.rankdata(values.errors[own], axis=0)
                scores[own] = stats.norm.ppf((ranks - 0.5) / own.sum())
        return scores

    def process(self, weights: FloatArray) -> ErrorProcess:
        """Return the process that fits drives with weights, shape ``(drives,)``."""
        return ErrorProcess(
            shares=self._shares(weights),
            errors=self._quantiles(weights),
            kept=self._kept(weights),
            ghosts=np.array([self._ghosts(weights, i) for i in range(len(LABELS))]),
        )

    def _shares(self, weights: FloatArray) -> FloatArray:
        events = np.tensordot(weights, self._events, 1)
        at_risk = np.tensordot(weights, self._at_risk, 1)
        true = ErrorProcess.perfect().shares
        shares = true.copy()
        for label in _BY_LABEL:
            all_events, all_risk = (part[label].sum(axis=(0, 1)) for part in (events, at_risk))
            share = np.divide(all_events, all_risk, out=true[0, 0].copy(), where=all_risk > 0.0)
            by_bin = _drawn(events[label].sum(axis=0), at_risk[label].sum(axis=0), share)
            shares[label] = _drawn(events[label], at_risk[label], by_bin)
        changes = slice(FOUND_FIRST, LOST + len(AGES_S) + 1)
        shares[:, :, changes] = 1.0 - (1.0 - shares[:, :, changes]) ** self._power
        return shares

    def _quantiles(self, weights: FloatArray) -> FloatArray:
        values, of_value = self._values, weights[self._values.drive]

        def of(where: NDArray[np.bool_]) -> tuple[FloatArray, float]:
            count = float(of_value[where].sum())
            return count * _weighted_quantiles(values.errors[where], of_value[where]), count

        found = np.zeros((len(GROUPS), len(EDGES_M), len(ERRORS), len(SCORES)))
        for label in _BY_LABEL:
            in_label = np.isin(values.group, label)
            total, count = of(in_label)
            everywhere = total / count if count else total
            for row in range(len(EDGES_M)):
                in_bin = in_label & (values.row == row)
                by_bin = _drawn(*of(in_bin), everywhere)
                for group in label:
                    found[group, row] = _drawn(*of(in_bin & (values.group == group)), by_bin)
        return found

    def _kept(self, weights: FloatArray) -> FloatArray:
        kept = np.zeros((len(GROUPS), len(KEPT)))
        wrong, of = np.tensordot(weights, self._labels, 1).T
        for group in range(len(GROUPS)):
            soon, late = (self._correlation(weights, group, column) for column in (0, 1))
            constant = np.zeros(len(ERRORS))
            # late = constant + (1 - constant) * keep ** later, and soon likewise
            for _ in range(_ITERATIONS):
                keep = np.clip((soon - constant) / (1.0 - constant), 0.0, _MOST_KEPT)
                far = keep**self._later
                constant = np.clip((late - far) / (1.0 - far), 0.0, _MOST_KEPT)
            stays = wrong[group] / of[group] if of[group] else 0.0
            kept[group] = [*keep**self._power, stays**self._power, *constant]
        return kept

    def _correlation(self, weights: FloatArray, group: int, column: int) -> FloatArray:
        """Return the correlation of normal scores in one sighting, of a column of `_Values.back`, shape ``(3,)``."""
        values = self._values
        back = values.back[:, column]
        later = np.flatnonzero((values.group == group) & (back > 0))
        now, before = self._scores[later], self._scores[later - back[later]]
        of_pair = weights[values.drive[later]][:, None]
        squares = (of_pair * 0.5 * (now**2 + before**2)).sum(axis=0)
        found: FloatArray = (of_pair * now * before).sum(axis=0) / np.where(squares > 0.0, squares, 1.0)
        return found

    def _ghosts(self, weights: FloatArray, label: int) -> list[float]:
        lasted = [(s, w) for one, w in zip(self._drives, weights, strict=True) for s in one.ghosts[label]]
        durations, of_ghost = np.array(lasted, np.float64).reshape(-1, 2).T
        per_hour = float(of_ghost.sum()) / max(float(weights @ self._hours), 1e-9)
        return [per_hour, *_weighted_quantiles(durations[:, None], of_ghost)[0].tolist()]


def _drawn(total: FloatArray, count: FloatArray | float, towards: FloatArray) -> FloatArray:
    """Return means shrunk towards others, as if `PRIOR` more samples had these.

    Args:
        total: Sums over the samples.
        count: Numbers of samples.
        towards: The other means.
    """
    drawn: FloatArray = (total + PRIOR * towards) / (count + PRIOR)
    return drawn


def _weighted_quantiles(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the quantiles of each column at `SCORES`, shape ``(columns, scores)``; 0 without values."""
    columns = values.shape[1]
    if not weights.any():
        return np.zeros((columns, len(SCORES)))
    found = []
    for column in range(columns):
        order = np.argsort(values[:, column], kind="stable")
        below = np.cumsum(weights[order])
        levels = (below - 0.5 * weights[order]) / below[-1]
        found.append(np.interp(_LEVELS, levels, values[order, column]))
    return np.array(found)


def _without(process: ErrorProcess, types: Collection[str]) -> ErrorProcess:
    """Return a process in which some types of errors do not occur."""
    true = ErrorProcess.perfect()
    shares, errors, kept, ghosts = (
        part.copy() for part in (process.shares, process.errors, process.kept, process.ghosts)
    )
    columns = {
        "misses": [SEEN, *range(FOUND, WRONG_LABEL)],
        "delays": [AT_ONCE, FOUND_FIRST],
        "labels": [WRONG_LABEL],
    }
    for name in types:
        shares[:, :, columns.get(name, [])] = true.shares[:, :, columns.get(name, [])]
    if "places" in types:
        errors[:] = 0.0
    if "ghosts" in types:
        ghosts[:] = 0.0
    return replace(process, shares=shares, errors=errors, kept=kept, ghosts=ghosts)
