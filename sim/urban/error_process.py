"""The errors of an obstacle detector as a random process, and the document that a fit to a recording writes.

A road user that comes into sight is reported at once or later, is lost and found again, and is reported at a wrong
place, with a wrong size or label; and there are ghosts. Probabilities depend on the group of the road user, on its
distance, and on the time since it was last found or lost: most misses and most finds are short. Errors of place and
size have the recorded quantiles; part of them is constant for a road user, and the rest is correlated from image to
image. All numbers hold for images every `PERCEPTION_STEP_S`.

`brink.recordings.fit_errors` fits the process; `brink.sim.urban.fitted_detector` drives it. A process in which
nothing goes wrong is the truth, bit for bit. Source: ours; see docs/adr/0071.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from brink.sim.driving.interface import PERCEPTION_STEP_S, ObstacleLabel
from brink.sim.episode import Json, JsonObject, check_fields, parse_integer, parse_number
from brink.sim.errors import InvalidEpisode

FloatArray = NDArray[np.float64]

MODE: Final = "fitted"
FORMAT: Final = "brink-errors@1"
MAX_REPLICATES: Final = 50

GROUPS: Final = ("lead", "vehicle", "pedestrian")
"""The nearest vehicle ahead in the ego's lane, any other vehicle, and any pedestrian."""
EDGES_M: Final = (0.0, 10.0, 20.0, 30.0, 45.0, 60.0)
"""Where the bins of distance begin; the last has no end."""
AGES_S: Final = (0.2, 1.0)
"""How long after a road user was found or lost the probability changes of losing or finding it again."""
SCORES: Final = (-2.0, -1.0, 0.0, 1.0, 2.0)
"""Normal scores at which the quantiles of errors are given: 2%, 16%, 50%, 84% and 98%."""
LABELS: Final = (ObstacleLabel.VEHICLE, ObstacleLabel.PERSON)
ERRORS: Final = ("far", "right_m", "size")
"""Errors of place and size, as in `error_meter.Sample`."""
SHARES: Final = (
    "seen",
    "at_once",
    "found_first",
    "found_in_0.2s",
    "found_in_1s",
    "found_later",
    "lost_in_0.2s",
    "lost_in_1s",
    "lost_later",
    "wrong_label",
)
SEEN, AT_ONCE, FOUND_FIRST, FOUND, LOST, WRONG_LABEL = 0, 1, 2, 3, 6, 9
"""Columns of `SHARES`; `FOUND` and `LOST` are the first of three."""
KEPT: Final = (*ERRORS, "wrong_label", *(f"{name}_constant" for name in ERRORS))
STAYS_WRONG, CONSTANT = 3, 4
"""Columns of `KEPT`; `CONSTANT` is the first of three."""

_BOUNDS: Final[Mapping[str, tuple[float, float]]] = {
    "shares": (0.0, 1.0), "kept": (0.0, 1.0), "far": (-0.95, 10.0), "right_m": (-50.0, 50.0), "size": (-0.95, 10.0),
    "per_hour": (0.0, 36_000.0), "seconds": (0.0, 600.0),
}  # fmt: skip
_TRUE_SHARES: Final = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ErrorProcess:
    """The random process.

    Attributes:
        shares: Probabilities by group, bin of distance and column of `SHARES`, shape ``(3, 6, 10)``: of being
            reported in any image and in the first image in sight; of being reported in the next image if it never
            was, or if it was lost that long ago; of not being reported in the next image if it was found that long
            ago; and of a wrong label.
        errors: Quantiles of `ERRORS` at `SCORES` by group and bin, shape ``(3, 6, 3, 5)``.
        kept: By group, what is kept from image to image, shape ``(3, 7)``: the correlation of the part of `ERRORS`
            that changes, the probability that a wrong label stays, and the share of the variance of `ERRORS` that is
            constant for a road user.
        ghosts: For each label, the ghosts in the ego's lane that begin in an hour, and the quantiles of their
            durations in s, shape ``(2, 6)``.
    """

    shares: FloatArray
    errors: FloatArray
    kept: FloatArray
    ghosts: FloatArray

    @classmethod
    def perfect(cls) -> Self:
        """Return the process of a detector that reports the truth."""
        return cls(
            shares=np.tile(np.array(_TRUE_SHARES), (len(GROUPS), len(EDGES_M), 1)),
            errors=np.zeros((len(GROUPS), len(EDGES_M), len(ERRORS), len(SCORES))),
            kept=np.zeros((len(GROUPS), len(KEPT))),
            ghosts=np.zeros((len(LABELS), 1 + len(SCORES))),
        )

    def mean_miss_s(self) -> FloatArray:
        """Return the mean time for which a lost road user goes unreported, by group and bin, shape ``(3, 6)``.

        Infinite where one that is lost is never found again at the same distance.
        """
        found = self.shares[:, :, FOUND : FOUND + 3]
        steps, lasts = np.zeros(found.shape[:2]), np.ones(found.shape[:2])
        ends = [0, *(round(age_s / PERCEPTION_STEP_S) for age_s in AGES_S)]
        for age, images in enumerate(np.diff(ends).tolist()):
            for _ in range(images):
                steps += lasts
                lasts *= 1.0 - found[:, :, age]
        with np.errstate(divide="ignore", invalid="ignore"):
            rest = np.where(lasts > 0.0, lasts / found[:, :, -1], 0.0)
        return PERCEPTION_STEP_S * (steps + rest)

    def to_json(self) -> list[Json]:
        """Return all numbers in the order of the attributes, with four significant digits."""
        parts = (self.shares, self.errors, self.kept, self.ghosts)
        return [rounded(value) for part in parts for value in part.ravel().tolist()]

    @classmethod
    def from_json(cls, where: str, document: Json) -> Self:
        """Parse a process.

        Args:
            where: Where it stands, for messages.
            document: The numbers, as of `to_json`.

        Raises:
            InvalidEpisode: There are more or fewer numbers, one is out of range, or quantiles do not ascend.
        """
        like = cls.perfect()
        shapes = [part.shape for part in (like.shares, like.errors, like.kept, like.ghosts)]
        sizes = [math.prod(shape) for shape in shapes]
        if not isinstance(document, list) or len(document) != sum(sizes):
            came = f"{len(document)}" if isinstance(document, list) else f"{document!r:.40}"
            raise InvalidEpisode(
                f"{where}: expected {sum(sizes)} numbers, as brink errors fit writes them; got {came}"
            )
        for index, value in enumerate(document):
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise InvalidEpisode(f"{where}[{index}]: expected a number, got {value!r:.40}")
        split = np.split(np.array(document, np.float64), np.cumsum(sizes)[:-1])
        shares, errors, kept, ghosts = (
            part.reshape(shape) for part, shape in zip(split, shapes, strict=True)
        )
        return cls(shares=shares, errors=errors, kept=kept, ghosts=ghosts).checked(where)

    def checked(self, where: str) -> Self:
        """Return this process after checking that all its numbers are valid.

        Raises:
            InvalidEpisode: One is out of range, or quantiles do not ascend.
        """
        parts = {
            "shares": self.shares,
            "kept": self.kept,
            "per_hour": self.ghosts[:, 0],
            "seconds": self.ghosts[:, 1:],
            **{name: self.errors[:, :, i] for i, name in enumerate(ERRORS)},
        }
        for name, values in parts.items():
            low, high = _BOUNDS[name]
            wrong = values[~((values >= low) & (values <= high))]
            if wrong.size:
                raise InvalidEpisode(
                    f"{where}: {name}: expected numbers in [{low:g}, {high:g}], got {wrong[0]:g}"
                )
            if name not in ("shares", "kept", "per_hour") and (np.diff(values) < 0.0).any():
                raise InvalidEpisode(f"{where}: {name}: expected quantiles that ascend")
        return self


def rounded(value: float) -> float:
    """Return a number with four significant digits."""
    return float(f"{value:.4g}")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FittedErrors:
    """The fitted errors of a detector: the content of `errors.yaml`.

    Attributes:
        detector: Name of the detector.
        drives: Number of recorded drives.
        hours: Their length together.
        without: Types of errors that were left out.
        process: The process.
        rests_on: Number of samples behind each probability, by group, bin and column of `SHARES`, shape
            ``(3, 6, 10)``; zeros if unknown.
        ghosts: Number of recorded ghosts by label.
        replicates: Processes that were fitted to the drives with random weights, which show how uncertain the fit is.
    """

    detector: str
    drives: int
    hours: float
    process: ErrorProcess
    without: tuple[str, ...] = ()
    rests_on: FloatArray = field(default_factory=lambda: np.zeros_like(ErrorProcess.perfect().shares))
    ghosts: tuple[int, ...] = (0, 0)
    replicates: tuple[ErrorProcess, ...] = ()

    @property
    def unknown(self) -> list[str]:
        """The groups of which the recording has no image."""
        return [
            group for group, images in zip(GROUPS, self.rests_on[:, :, SEEN], strict=True) if not images.any()
        ]

    def to_document(self) -> JsonObject:
        """Return the document, which lists every number and the data behind it in readable form."""
        process = self.process
        ghosts: JsonObject = {}
        for i, label in enumerate(LABELS):
            per_hour, *seconds = map(rounded, process.ghosts[i].tolist())
            ghosts[label.value] = {"count": self.ghosts[i], "per_hour": per_hour, "seconds": list(seconds)}
        return {
            "format": FORMAT,
            "detector": self.detector,
            "drives": self.drives,
            "hours": rounded(self.hours),
            "without": list(self.without),
            **{group: self._group(index) for index, group in enumerate(GROUPS)},
            "ghosts": ghosts,
            "replicates": [one.to_json() for one in self.replicates],
        }

    def _group(self, group: int) -> JsonObject:
        process = self.process
        bins: list[Json] = []
        for i, from_m in enumerate(EDGES_M):
            bins.append(
                {
                    "from_m": from_m,
                    **dict(zip(SHARES, map(rounded, process.shares[group, i].tolist()), strict=True)),
                    **{
                        name: [rounded(value) for value in process.errors[group, i, k].tolist()]
                        for k, name in enumerate(ERRORS)
                    },
                    "samples": [int(count) for count in self.rests_on[group, i].tolist()],
                }
            )
        kept = dict(zip(KEPT, map(rounded, process.kept[group].tolist()), strict=True))
        return {"bins": bins, "kept": dict(kept)}

    @classmethod
    def from_document(cls, where: str, document: Any) -> Self:
        """Parse the document.

        Args:
            where: Where it stands, for messages.
            document: The content of a file that `brink errors fit` wrote, possibly edited.

        Raises:
            InvalidEpisode: A field is missing, unknown, or out of range.
        """
        if not isinstance(document, Mapping):
            raise InvalidEpisode(
                f"{where}: expected the document that brink errors fit writes, got {document!r:.80}"
            )
        fields = ("format", "detector", "drives", "hours", "without", *GROUPS, "ghosts", "replicates")
        check_fields(where, document, fields)
        if document["format"] != FORMAT:
            raise InvalidEpisode(f"{where}.format: expected {FORMAT}, got {document['format']!r:.40}")
        without, replicates = document["without"], document["replicates"]
        if not isinstance(document["detector"], str) or len(document["detector"]) > 200:
            raise InvalidEpisode(f"{where}.detector: expected a name, got {document['detector']!r:.80}")
        if not isinstance(without, list) or not all(isinstance(one, str) for one in without):
            raise InvalidEpisode(f"{where}.without: expected a list of names, got {without!r:.80}")
        if not isinstance(replicates, list) or len(replicates) > MAX_REPLICATES:
            raise InvalidEpisode(
                f"{where}.replicates: expected a list of at most {MAX_REPLICATES}, got {replicates!r:.40}"
            )
        like = ErrorProcess.perfect()
        samples = np.zeros_like(like.shares)
        for index, group in enumerate(GROUPS):
            _read_group(f"{where}.{group}", document[group], index, like, samples)
        counts = _read_ghosts(f"{where}.ghosts", document["ghosts"], like)
        return cls(
            detector=document["detector"],
            drives=parse_integer(f"{where}.drives", document["drives"], 0, 10**6),
            hours=parse_number(f"{where}.hours", document["hours"], 0.0, 1e6, "h"),
            without=tuple(without),
            process=like.checked(where),
            rests_on=samples,
            ghosts=counts,
            replicates=tuple(
                ErrorProcess.from_json(f"{where}.replicates[{i}]", one) for i, one in enumerate(replicates)
            ),
        )


def _read_group(where: str, document: Any, group: int, into: ErrorProcess, samples: FloatArray) -> None:
    """Parse a group of road users.

    Raises:
        InvalidEpisode: A field is missing, unknown, or of the wrong type.
    """
    check_fields(where, _mapping(where, document), ("bins", "kept"))
    bins = document["bins"]
    if not isinstance(bins, list) or len(bins) != len(EDGES_M):
        raise InvalidEpisode(f"{where}.bins: expected {len(EDGES_M)} bins of distance, got {bins!r:.40}")
    for i, (from_m, row) in enumerate(zip(EDGES_M, bins, strict=True)):
        here = f"{where}.bins[{i}]"
        check_fields(here, _mapping(here, row), ("from_m", *SHARES, *ERRORS, "samples"))
        if row["from_m"] != from_m:
            raise InvalidEpisode(f"{here}.from_m: expected {from_m:g}, got {row['from_m']!r:.40}")
        into.shares[group, i] = [_number(f"{here}.{name}", row[name]) for name in SHARES]
        for k, name in enumerate(ERRORS):
            into.errors[group, i, k] = _numbers(f"{here}.{name}", row[name], len(SCORES))
        samples[group, i] = _numbers(f"{here}.samples", row["samples"], len(SHARES))
    kept = _mapping(f"{where}.kept", document["kept"])
    check_fields(f"{where}.kept", kept, KEPT)
    into.kept[group] = [_number(f"{where}.kept.{name}", kept[name]) for name in KEPT]


def _read_ghosts(where: str, document: Any, into: ErrorProcess) -> tuple[int, ...]:
    check_fields(where, _mapping(where, document), tuple(label.value for label in LABELS))
    counts = []
    for i, label in enumerate(LABELS):
        here, row = f"{where}.{label.value}", document[label.value]
        check_fields(here, _mapping(here, row), ("count", "per_hour", "seconds"))
        counts.append(parse_integer(f"{here}.count", row["count"], 0, 10**9))
        into.ghosts[i, 0] = _number(f"{here}.per_hour", row["per_hour"])
        into.ghosts[i, 1:] = _numbers(f"{here}.seconds", row["seconds"], len(SCORES))
    return tuple(counts)


def _mapping(where: str, document: Any) -> Mapping[str, Json]:
    if not isinstance(document, Mapping):
        raise InvalidEpisode(f"{where}: expected an object, got {document!r:.40}")
    return document


def _number(where: str, value: Any) -> float:
    return parse_number(where, value, -1e9, 1e9)


def _numbers(where: str, values: Any, count: int) -> list[float]:
    if not isinstance(values, list) or len(values) != count:
        raise InvalidEpisode(f"{where}: expected {count} numbers, got {values!r:.80}")
    return [_number(f"{where}[{i}]", value) for i, value in enumerate(values)]
