"""A safety monitor: how likely a complete solution is unsafe, from what was simulated around it.

Every evaluated solution counts with a weight that falls with its distance, exp(-sum of d_c / h_c) over the components
c: each component has its own distance and its own bandwidth h_c, chosen so that every solution is best foretold by
all others (least mean log loss). With n the sum of weights and k that of the unsafe ones, the probability of unsafe
is (k + m) / (n + 1), where m is the unsafe share of all: one evaluation's weight for what is known of no place at
all. The interval is Wilson's for k of n. Where little was simulated n is small and the interval wide, and "unknown"
is the answer: the monitor calls a solution unsafe only if the whole interval lies above the threshold, and safe only
if none of it does.

A monitor needs numpy and scipy alone, and no server: ``Monitor.load("monitor.json").ask({...})``.

Source: the safety monitors of Sharifi et al. 2023, section 5.1, for which the boundary is sought; Wilson 1927; kernel
regression (Nadaraya 1964, Watson 1964).
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from search.component import BoolArray, Component, FloatArray, frozen_array
from search.errors import DocumentError, SpaceError
from search.fitness import Z_95
from search.metric import METRIC_VERSION, Metric, Points
from search.parameters import Categorical, Integer, Parameter, Real
from search.space import SearchSpace
from search.streams import Stream, generator

FORMAT: Final = "brink-monitor"
VERSION: Final = 1
BANDWIDTHS: Final = (0.01, 0.02, 0.035, 0.06, 0.1, 0.17, 0.3, 0.5, math.inf)
"""That are tried for each component; an infinite one makes it count for nothing."""
FORETOLD: Final = 1_500
"""Solutions, drawn at random, that bandwidths are judged by."""
SWEEPS: Final = 3


class Answer(StrEnum):
    """What a monitor says of a solution."""

    SAFE = "safe"
    UNSAFE = "unsafe"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Risks:
    """How likely some solutions are unsafe.

    Attributes:
        probability: Of unsafe, shape ``(m,)``.
        low: Lower limit of its interval, shape ``(m,)``.
        high: Upper limit, shape ``(m,)``.
        neighbours: Weight of the evaluated solutions around each, in evaluations, shape ``(m,)``.
    """

    probability: FloatArray
    low: FloatArray
    high: FloatArray
    neighbours: FloatArray

    def answers(self, threshold: float) -> list[Answer]:
        """Return what can be said for a threshold probability: the interval decides."""
        return [
            Answer.UNSAFE if low > threshold else Answer.SAFE if high <= threshold else Answer.UNKNOWN
            for low, high in zip(self.low.tolist(), self.high.tolist(), strict=True)
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Risk:
    """How likely one solution is unsafe.

    Attributes:
        probability: Of unsafe.
        low: Lower limit of its interval.
        high: Upper limit.
        neighbours: Weight of the evaluated solutions around it, in evaluations.
        answer: What can be said.
    """

    probability: float
    low: float
    high: float
    neighbours: float
    answer: Answer


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Monitor:
    """What was simulated, and how far each of it tells of its surroundings.

    Attributes:
        space: Whose complete solutions it can be asked about; without constraints.
        bandwidths: One a component, > 0; infinite where a component tells nothing.
        vectors: What was simulated, shape ``(n, d)``.
        unsafe: Its verdicts, shape ``(n,)``.
        threshold: Probability of unsafe above which a solution is called unsafe, in (0, 1).
        z: Quantile of the standard normal for the interval, > 0.
    """

    space: SearchSpace
    bandwidths: tuple[float, ...]
    vectors: FloatArray
    unsafe: BoolArray
    threshold: float
    z: float
    _metrics: tuple[Metric, ...]
    _points: tuple[Points, ...]

    @classmethod
    def of(
        cls,
        space: SearchSpace,
        bandwidths: Sequence[float],
        vectors: FloatArray,
        unsafe: BoolArray,
        *,
        threshold: float,
        z: float = Z_95,
    ) -> Self:
        """Return a monitor with given bandwidths.

        Raises:
            ValueError: Something does not fit.
        """
        rows, verdicts = frozen_array(vectors), frozen_array(unsafe, np.bool_)
        if rows.ndim != 2 or rows.shape[1] != space.dimension or verdicts.shape != rows.shape[:1]:
            raise ValueError(
                f"expected a verdict for each row of {space.dimension}, got {rows.shape} and {verdicts.shape}"
            )
        if not len(rows):
            raise ValueError("expected at least one evaluated solution")
        if len(bandwidths) != len(space.components) or not all(width > 0 for width in bandwidths):
            raise ValueError(f"expected {len(space.components)} bandwidths > 0, got {list(bandwidths)}")
        if not 0 < threshold < 1:
            raise ValueError(f"threshold: expected a probability in (0, 1), got {threshold!r}")
        if not (math.isfinite(z) and z > 0):
            raise ValueError(f"z: expected a number > 0, got {z!r}")
        metrics = tuple(Metric.of_component(space, place) for place in range(len(space.components)))
        return cls(
            space=space, bandwidths=tuple(bandwidths), vectors=rows, unsafe=verdicts, threshold=threshold, z=z,
            _metrics=metrics,
            _points=tuple(
                metric.points(rows[:, part]) for metric, part in zip(metrics, space.slices, strict=True)
            ),
        )  # fmt: skip

    @classmethod
    def fitted(
        cls,
        space: SearchSpace,
        vectors: FloatArray,
        unsafe: BoolArray,
        *,
        threshold: float,
        z: float = Z_95,
        seed: int = 1,
    ) -> Self:
        """Return the monitor whose bandwidths foretell what was simulated best.

        Args:
            space: What was searched.
            vectors: What was simulated, shape ``(n, d)``, n >= 2.
            unsafe: Its verdicts, shape ``(n,)``.
            threshold: Probability of unsafe above which a solution is called unsafe.
            z: Quantile of the standard normal for the interval.
            seed: Decides which solutions bandwidths are judged by, if there are many.

        Raises:
            ValueError: Something does not fit.
        """
        if len(vectors) < 2:
            raise ValueError(f"expected at least two evaluated solutions, got {len(vectors)}")
        start = cls.of(space, [0.1] * len(space.components), vectors, unsafe, threshold=threshold, z=z)
        judged = np.arange(len(vectors))
        if len(vectors) > FORETOLD:
            judged = np.sort(generator(seed, Stream.MONITOR).choice(len(vectors), FORETOLD, replace=False))
        widths = _best_bandwidths(start, judged)
        return cls.of(space, widths, vectors, unsafe, threshold=threshold, z=z)

    def __len__(self) -> int:
        return len(self.vectors)

    @property
    def unsafe_share(self) -> float:
        """Unsafe share of all that was simulated."""
        return float(self.unsafe.mean())

    def score(self, vectors: FloatArray) -> Risks:
        """Return how likely complete solutions are unsafe.

        Args:
            vectors: Rows, shape ``(m, d)``.

        Raises:
            SpaceError: The shape is wrong.
        """
        rows = np.asarray(vectors, np.float64)
        if rows.ndim != 2 or rows.shape[1] != self.space.dimension:
            raise SpaceError(f"expected rows of {self.space.dimension} numbers, got shape {rows.shape}")
        parts = zip(self._metrics, self.space.slices, strict=True)
        asked = [metric.points(rows[:, part]) for metric, part in parts]
        n, k = np.zeros(len(rows)), np.zeros(len(rows))
        for places, columns, weights in self._weights(asked):
            n[places] += weights.sum(axis=1)
            k[places] += weights @ self.unsafe[columns]
        return self._risks(n, k)

    def ask(self, values: Mapping[str, Mapping[str, object]]) -> Risk:
        """Return how likely one complete solution is unsafe.

        Args:
            values: ``{component: {parameter: value}}``, as in ``solutions`` of the API.

        Raises:
            SpaceError: A value is missing, unknown or out of its range; names the parameter.
        """
        risks = self.score(self.space.join(self.space.encode(values))[None])
        return Risk(
            probability=float(risks.probability[0]), low=float(risks.low[0]), high=float(risks.high[0]),
            neighbours=float(risks.neighbours[0]), answer=risks.answers(self.threshold)[0],
        )  # fmt: skip

    def _weights(self, asked: Sequence[Points]) -> Any:
        """Yield blocks of weights: which of those asked about, which of those simulated, and the weights."""
        used = [place for place, width in enumerate(self.bandwidths) if math.isfinite(width)]
        if not used:
            yield slice(0, len(asked[0])), slice(0, len(self)), np.ones((len(asked[0]), len(self)))
            return
        blocks = [self._metrics[place].blocks(asked[place], self._points[place]) for place in used]
        for parts in zip(*blocks, strict=True):
            exponent = sum(
                block / self.bandwidths[place] for place, (_, _, block) in zip(used, parts, strict=True)
            )
            yield parts[0][0], parts[0][1], np.exp(-exponent)

    def _risks(self, n: FloatArray, k: FloatArray) -> Risks:
        probability = (k + self.unsafe_share) / (n + 1.0)
        # Wilson's interval for a weight of evaluations that need not be whole; with none it is everything.
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(n > 0, k / n, 0.5)
            g = self.z**2 / n
            centre = np.where(n > 0, (share + g / 2) / (1 + g), 0.5)
            half = np.where(n > 0, self.z / (1 + g) * np.sqrt(share * (1 - share) / n + g / (4 * n)), 0.5)
        # Tiny weights overflow g; their interval is everything.
        sound = np.isfinite(centre) & np.isfinite(half)
        return Risks(
            probability=probability, neighbours=n,
            low=np.where(sound, np.clip(centre - half, 0.0, 1.0), 0.0),
            high=np.where(sound, np.clip(centre + half, 0.0, 1.0), 1.0),
        )  # fmt: skip

    def to_json(self, about: Mapping[str, Any] | None = None) -> str:
        """Return the monitor as a JSON document.

        Args:
            about: Where it comes from, kept beside it.
        """
        document = {
            "format": FORMAT,
            "version": VERSION,
            "metric_version": METRIC_VERSION,
            "about": dict(about or {}),
            "threshold": self.threshold,
            "z": self.z,
            "bandwidths": [width if math.isfinite(width) else None for width in self.bandwidths],
            "components": [
                {"name": component.name, "parameters": [p.describe() for p in component.parameters]}
                for component in self.space.components
            ],
            "unsafe": [int(one) for one in self.unsafe],
            "vectors": self.vectors.tolist(),
        }
        return json.dumps(document, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Return the monitor of a JSON document.

        Raises:
            DocumentError: It is none, or of a version that is not known here.
        """
        try:
            document = json.loads(text)
        except ValueError as error:
            raise DocumentError(f"expected a monitor: {error}") from None
        if not isinstance(document, dict) or document.get("format") != FORMAT:
            raise DocumentError(f"expected a document with format {FORMAT!r}")
        if (document.get("version"), document.get("metric_version")) != (VERSION, METRIC_VERSION):
            raise DocumentError(
                f"expected version {VERSION} with metric version {METRIC_VERSION}, got "
                f"{document.get('version')!r} and {document.get('metric_version')!r}"
            )
        try:
            space = SearchSpace(
                tuple(
                    Component(part["name"], tuple(_parameter(one) for one in part["parameters"]))
                    for part in document["components"]
                )
            )
            widths = [math.inf if width is None else float(width) for width in document["bandwidths"]]
            return cls.of(
                space, widths, np.array(document["vectors"], np.float64), np.array(document["unsafe"], np.bool_),
                threshold=float(document["threshold"]), z=float(document["z"]),
            )  # fmt: skip
        except (KeyError, TypeError, ValueError) as error:
            raise DocumentError(f"expected a monitor: {type(error).__name__}: {error}") from None

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Return the monitor in a file.

        Raises:
            DocumentError: There is none in it.
            OSError: The file cannot be read.
        """
        try:
            text = Path(path).read_text(encoding="utf-8")
        except UnicodeDecodeError:
            raise DocumentError(f"{path}: expected a monitor, got no text") from None
        return cls.from_json(text)


def _parameter(described: Mapping[str, Any]) -> Parameter:
    name, kind = str(described["name"]), described["type"]
    if kind == "categorical":
        return Categorical(name, tuple(described["choices"]))
    if kind == "integer":
        return Integer(name, described["low"], described["high"], described.get("unit", ""))
    if kind == "real":
        return Real(name, described["low"], described["high"], described.get("unit", ""))
    raise DocumentError(f"{name}: expected a real, integer or categorical parameter, got {kind!r}")


def _best_bandwidths(monitor: Monitor, judged: np.typing.NDArray[np.intp]) -> tuple[float, ...]:
    """Return the bandwidths with the least mean log loss, each solution foretold by all others.

    One component after the other, until nothing changes.
    """
    distances = [
        metric.between(monitor.vectors[judged][:, part], monitor.vectors[:, part]).astype(np.float32)
        for metric, part in zip(monitor._metrics, monitor.space.slices, strict=True)
    ]
    unsafe = monitor.unsafe.astype(np.float32)
    truth = monitor.unsafe[judged]
    itself = (np.arange(judged.size), judged)

    def loss(widths: Sequence[float]) -> float:
        exponent = np.zeros_like(distances[0])
        for distance, width in zip(distances, widths, strict=True):
            if math.isfinite(width):
                exponent += distance / np.float32(width)
        weights = np.exp(-exponent)
        weights[itself] = 0.0
        foretold = (weights @ unsafe + monitor.unsafe_share) / (weights.sum(axis=1) + 1.0)
        foretold = np.clip(foretold, 1e-6, 1 - 1e-6)
        return -float(np.mean(np.where(truth, np.log(foretold), np.log1p(-foretold))))

    best = list(monitor.bandwidths)
    least = loss(best)
    for _ in range(SWEEPS):
        before = tuple(best)
        for place in range(len(best)):
            for width in BANDWIDTHS:
                tried = [*best[:place], width, *best[place + 1 :]]
                if (found := loss(tried)) < least:
                    best, least = tried, found
        if tuple(best) == before:
            break
    return tuple(best)
