"""A safety monitor: how likely a complete solution is unsafe, from what was simulated around it.

Every evaluated solution counts with a weight that falls with its distance, exp(-sum of w_j d_j) over the parameters
j: d_j is the share of its range by which a number differs, or 1 where a category does, and w_j >= 0 says how much the
parameter tells. These are chosen so that every solution is best foretold by all others (least mean log loss); most of
them become 0. With n the sum of weights and k that of the unsafe ones, the probability of unsafe is
(k + m) / (n + 1), where m is the unsafe share of all: one evaluation's weight for what is known of no place at all.
The interval is Wilson's for k of n. Where little was simulated n is small and the interval wide, and "unknown" is the
answer: the monitor calls a solution unsafe only if the whole interval lies above the threshold, and safe only if none
of it does.

A monitor needs numpy and scipy alone, and no server: ``Monitor.load("monitor.json").ask({...})``.

Source: the safety monitors of Sharifi et al. 2023, section 5.1, for which the boundary is sought; Wilson 1927; kernel
regression (Nadaraya 1964, Watson 1964).
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import cdist

from brink.search.component import BoolArray, Component, FloatArray, frozen_array
from brink.search.errors import DocumentError, SpaceError
from brink.search.fitness import Z_95
from brink.search.parameters import Categorical, Integer, Parameter, Real
from brink.search.space import SearchSpace
from brink.search.streams import Stream, generator

FORMAT: Final = "brink-monitor"
VERSION: Final = 2
LEVELS: Final = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Weights that are tried for each parameter."""
_START: Final = LEVELS.index(1.0)
FORETOLD: Final = 1_000
"""Solutions, drawn at random, that weights are judged by."""
LEARNED: Final = 3_000
"""Solutions, drawn at random, that foretell them while weights are chosen; a monitor counts all."""
SWEEPS: Final = 4
BLOCK: Final = 1 << 20
"""Pairs of solutions that are looked at together."""


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
        weights: How much each parameter tells, >= 0, shape ``(d,)``.
        vectors: What was simulated, shape ``(n, d)``.
        unsafe: Its verdicts, shape ``(n,)``.
        threshold: Probability of unsafe above which a solution is called unsafe, in (0, 1).
        z: Quantile of the standard normal for the interval, > 0.
    """

    space: SearchSpace
    weights: FloatArray
    vectors: FloatArray
    unsafe: BoolArray
    threshold: float
    z: float
    _scales: FloatArray
    _numbers: FloatArray

    @classmethod
    def of(
        cls,
        space: SearchSpace,
        weights: ArrayLike,
        vectors: FloatArray,
        unsafe: BoolArray,
        *,
        threshold: float,
        z: float = Z_95,
    ) -> Self:
        """Return a monitor with given weights of the parameters.

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
        given = frozen_array(weights)
        if given.shape != (space.dimension,) or not (np.isfinite(given).all() and (given >= 0).all()):
            raise ValueError(f"expected {space.dimension} weights >= 0, got {given.tolist()}")
        if not 0 < threshold < 1:
            raise ValueError(f"threshold: expected a probability in (0, 1), got {threshold!r}")
        if not (math.isfinite(z) and z > 0):
            raise ValueError(f"z: expected a number > 0, got {z!r}")
        scales = np.where(space.categorical, 0.0, given / space.ranges)
        return cls(
            space=space, weights=given, vectors=rows, unsafe=verdicts, threshold=threshold, z=z,
            _scales=frozen_array(scales), _numbers=frozen_array(_scaled(rows, scales)),
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
        """Return the monitor whose weights foretell what was simulated best.

        Args:
            space: What was searched.
            vectors: What was simulated, shape ``(n, d)``, n >= 2.
            unsafe: Its verdicts, shape ``(n,)``.
            threshold: Probability of unsafe above which a solution is called unsafe.
            z: Quantile of the standard normal for the interval.
            seed: Decides which solutions weights are chosen with, if there are many.

        Raises:
            ValueError: Something does not fit.
        """
        if len(vectors) < 2:
            raise ValueError(f"expected at least two evaluated solutions, got {len(vectors)}")
        start = cls.of(space, np.ones(space.dimension), vectors, unsafe, threshold=threshold, z=z)
        weights = _best_weights(space, start.vectors, start.unsafe, generator(seed, Stream.MONITOR))
        return cls.of(space, weights, vectors, unsafe, threshold=threshold, z=z)

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
        n, k = np.zeros(len(rows)), np.zeros(len(rows))
        step = max(1, BLOCK // len(self))
        for first in range(0, len(rows), step):
            part = slice(first, first + step)
            kernel = self._kernel(rows[part])
            n[part] = kernel.sum(axis=1)
            k[part] = kernel @ self.unsafe
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

    def _kernel(self, rows: FloatArray) -> FloatArray:
        """Return how much each evaluated solution counts for each row, shape ``(rows, n)``."""
        exponent = cdist(_scaled(rows, self._scales), self._numbers, "cityblock")
        for column in np.flatnonzero(self.space.categorical & (self.weights > 0)):
            exponent += self.weights[column] * (rows[:, column, None] != self.vectors[None, :, column])
        kernel: FloatArray = np.exp(-exponent)
        return kernel

    @property
    def telling(self) -> dict[str, float]:
        """The weights of the parameters that tell something, the largest first, by ``component.parameter``."""
        known = zip(self.space.column_names(), self.weights.tolist(), strict=True)
        return dict(sorted(((name, weight) for name, weight in known if weight > 0), key=lambda one: -one[1]))

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
            "about": dict(about or {}),
            "threshold": self.threshold,
            "z": self.z,
            "weights": self.weights.tolist(),
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
        if document.get("version") != VERSION:
            raise DocumentError(f"expected version {VERSION}, got {document.get('version')!r}: fit it again")
        try:
            space = SearchSpace(
                tuple(
                    Component(part["name"], tuple(_parameter(one) for one in part["parameters"]))
                    for part in document["components"]
                )
            )
            return cls.of(
                space, document["weights"], np.array(document["vectors"], np.float64),
                np.array(document["unsafe"], np.bool_),
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


def _scaled(rows: FloatArray, scales: FloatArray) -> FloatArray:
    """Return the numbers that tell something, in units in which their distances are added up."""
    used = scales > 0
    return np.ascontiguousarray(rows[:, used] * scales[used]) if used.any() else np.zeros((len(rows), 1))


def _best_weights(
    space: SearchSpace, vectors: FloatArray, unsafe: BoolArray, rng: np.random.Generator
) -> FloatArray:
    """Return the weights with the least mean log loss, each solution foretold by all others.

    One parameter after the other, until nothing changes. What changes the loss by nothing is left out.
    """
    learned = np.sort(rng.permutation(len(vectors))[:LEARNED])
    rows, truth = vectors[learned], unsafe[learned]
    judged = np.sort(rng.permutation(len(rows))[:FORETOLD])
    itself = (np.arange(judged.size), judged)
    counts, share = truth.astype(np.float32), float(unsafe.mean())

    def difference(column: int) -> NDArray[np.float32]:
        apart = np.abs(rows[judged, column, None] - rows[None, :, column])
        apart = apart != 0 if space.categorical[column] else apart / space.ranges[column]
        shares: NDArray[np.float32] = apart.astype(np.float32)
        return shares

    def loss(exponent: NDArray[np.float32]) -> float:
        kernel = np.exp(-exponent)
        kernel[itself] = 0.0
        foretold = (kernel @ counts + share) / (kernel.sum(axis=1) + 1.0)
        foretold = np.clip(foretold.astype(np.float64), 1e-6, 1 - 1e-6)
        return -float(np.mean(np.where(truth[judged], np.log(foretold), np.log1p(-foretold))))

    levels = np.full(space.dimension, _START)
    exponent = np.zeros((judged.size, len(rows)), np.float32)
    for column in range(space.dimension):
        exponent += np.float32(LEVELS[_START]) * difference(column)
    for _ in range(SWEEPS):
        before = levels.copy()
        for column in range(space.dimension):
            apart = difference(column)
            others = exponent - np.float32(LEVELS[levels[column]]) * apart
            # Of equal losses the smallest weight: fewer parameters tell as much.
            found = [loss(others + np.float32(level) * apart) for level in LEVELS]
            levels[column] = int(np.argmin(found))
            exponent = others + np.float32(LEVELS[levels[column]]) * apart
        if (levels == before).all():
            break
    weights: FloatArray = np.array(LEVELS)[levels]
    return weights
