"""A safety monitor: the probability that a complete solution is unsafe, estimated from simulated ones around it.

Every evaluated solution has a weight that falls with its distance, exp(-sum of w_j d_j) over the parameters j. d_j is
the difference of two numbers as a share of their range, or 1 for different categories; w_j >= 0 is the weight of the
parameter. The weights are chosen to minimise the mean log loss when each solution is predicted from all others; most
become 0. With n the sum of weights and k that of the unsafe solutions, the unsafe probability is
(k + m) / (n + 1); the overall unsafe share m has the weight of one evaluation. The interval is Wilson's for k of n.

Where few solutions were simulated, n is small, the interval wide and the answer "unknown": a solution is called
unsafe only if the whole interval is above the threshold, and safe only if none of it is.

A monitor needs only numpy and scipy, and no server: ``Monitor.load("monitor.json").ask({...})``.

Source: the safety monitors of Sharifi et al. 2023, section 5.1, which the boundary is meant for; Wilson 1927; kernel
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

from brink.search.errors import DocumentError, SpaceError
from brink.search.fitness import Z_95
from brink.search.space import (
    BoolArray,
    Categorical,
    Component,
    FloatArray,
    Integer,
    Parameter,
    Real,
    SearchSpace,
    frozen_array,
)
from brink.search.streams import Stream, generator

FORMAT: Final = "brink-monitor"
VERSION: Final = 2
LEVELS: Final = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Weights tried for each parameter."""
_START: Final = LEVELS.index(1.0)
MAX_PREDICTED: Final = 1_000
"""Maximum number of solutions, drawn at random, whose predictions determine the weights."""
MAX_LEARNED: Final = 3_000
"""Maximum number of solutions, drawn at random, that predict those; a fitted monitor uses all solutions."""
MAX_SWEEPS: Final = 4
BLOCK_PAIRS: Final = 1 << 20
"""Maximum number of pairs of solutions compared at a time."""


class Answer(StrEnum):
    """A monitor's answer for a solution."""

    SAFE = "safe"
    UNSAFE = "unsafe"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Risks:
    """Risk estimates for m solutions.

    Attributes:
        probability: Unsafe probability, shape ``(m,)``.
        low: Lower limit of its interval, shape ``(m,)``.
        high: Upper limit of its interval, shape ``(m,)``.
        neighbours: Total weight of the evaluated solutions around each, in evaluations, shape ``(m,)``.
    """

    probability: FloatArray
    low: FloatArray
    high: FloatArray
    neighbours: FloatArray

    def answers(self, threshold: float) -> list[Answer]:
        """Return the answers for a threshold probability, each decided by the interval."""
        return [
            Answer.UNSAFE if low > threshold else Answer.SAFE if high <= threshold else Answer.UNKNOWN
            for low, high in zip(self.low.tolist(), self.high.tolist(), strict=True)
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Risk:
    """Risk estimate for one solution.

    Attributes:
        probability: Unsafe probability.
        low: Lower limit of its interval.
        high: Upper limit of its interval.
        neighbours: Total weight of the evaluated solutions around it, in evaluations.
        answer: The answer for the monitor's threshold.
    """

    probability: float
    low: float
    high: float
    neighbours: float
    answer: Answer


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Monitor:
    """Simulated solutions and parameter weights, from which the risk of any solution is estimated.

    Attributes:
        space: Space of the complete solutions, without constraints.
        weights: Weight of each parameter, >= 0, shape ``(d,)``.
        vectors: Simulated solutions, shape ``(n, d)``.
        unsafe: Their verdicts, shape ``(n,)``.
        threshold: Probability above which a solution is called unsafe, in (0, 1).
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
        """Return a monitor with the given weights.

        Args:
            space: Space of the complete solutions.
            weights: Weight of each parameter, >= 0, shape ``(d,)``.
            vectors: Simulated solutions, shape ``(n, d)``, n >= 1.
            unsafe: Their verdicts, shape ``(n,)``.
            threshold: Probability above which a solution is called unsafe, in (0, 1).
            z: Quantile of the standard normal for the interval, > 0.

        Raises:
            ValueError: A shape or a value is wrong.
        """
        rows, verdicts = frozen_array(vectors), frozen_array(unsafe, np.bool_)
        if rows.ndim != 2 or rows.shape[1] != space.dimension or verdicts.shape != rows.shape[:1]:
            raise ValueError(
                f"expected rows of {space.dimension} numbers and a verdict for each, "
                f"got shapes {rows.shape} and {verdicts.shape}"
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
        """Return the monitor with the weights that predict the simulated solutions best.

        Args:
            space: The search space.
            vectors: Simulated solutions, shape ``(n, d)``, n >= 2.
            unsafe: Their verdicts, shape ``(n,)``.
            threshold: Probability above which a solution is called unsafe, in (0, 1).
            z: Quantile of the standard normal for the interval, > 0.
            seed: Determines which solutions the weights are chosen with, if there are many.

        Raises:
            ValueError: A shape or a value is wrong.
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
        """Unsafe share of all simulated solutions."""
        return float(self.unsafe.mean())

    @property
    def informative_weights(self) -> dict[str, float]:
        """The positive weights by ``component.parameter``, largest first."""
        known = zip(self.space.column_names(), self.weights.tolist(), strict=True)
        return dict(sorted(((name, weight) for name, weight in known if weight > 0), key=lambda one: -one[1]))

    def score(self, vectors: FloatArray) -> Risks:
        """Estimate the risk of complete solutions, shape ``(m, d)``.

        Raises:
            SpaceError: The shape is wrong.
        """
        rows = np.asarray(vectors, np.float64)
        if rows.ndim != 2 or rows.shape[1] != self.space.dimension:
            raise SpaceError(f"expected rows of {self.space.dimension} numbers, got shape {rows.shape}")
        n, k = np.zeros(len(rows)), np.zeros(len(rows))
        step = max(1, BLOCK_PAIRS // len(self))
        for first in range(0, len(rows), step):
            part = slice(first, first + step)
            kernel = self._kernel(rows[part])
            n[part] = kernel.sum(axis=1)
            k[part] = kernel @ self.unsafe
        return self._risks(n, k)

    def ask(self, values: Mapping[str, Mapping[str, object]]) -> Risk:
        """Estimate the risk of one complete solution.

        Args:
            values: ``{component: {parameter: value}}``, as in ``solutions`` of the API.

        Raises:
            SpaceError: A value is missing, unknown or out of range; names the parameter.
        """
        risks = self.score(self.space.join(self.space.encode(values))[None])
        return Risk(
            probability=float(risks.probability[0]), low=float(risks.low[0]), high=float(risks.high[0]),
            neighbours=float(risks.neighbours[0]), answer=risks.answers(self.threshold)[0],
        )  # fmt: skip

    def _kernel(self, rows: FloatArray) -> FloatArray:
        """Return the weight of each evaluated solution for each row, shape ``(m, n)``."""
        from scipy.spatial.distance import cdist  # slow to import

        exponent = cdist(_scaled(rows, self._scales), self._numbers, "cityblock")
        for column in np.flatnonzero(self.space.categorical & (self.weights > 0)):
            exponent += self.weights[column] * (rows[:, column, None] != self.vectors[None, :, column])
        kernel: FloatArray = np.exp(-exponent)
        return kernel

    def _risks(self, n: FloatArray, k: FloatArray) -> Risks:
        probability = (k + self.unsafe_share) / (n + 1.0)
        # Wilson's interval for fractional counts; without any evaluation it is [0, 1].
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(n > 0, k / n, 0.5)
            g = self.z**2 / n
            centre = np.where(n > 0, (share + g / 2) / (1 + g), 0.5)
            half = np.where(n > 0, self.z / (1 + g) * np.sqrt(share * (1 - share) / n + g / (4 * n)), 0.5)
        # Tiny counts overflow g; their interval is [0, 1] as well.
        finite = np.isfinite(centre) & np.isfinite(half)
        return Risks(
            probability=probability, neighbours=n,
            low=np.where(finite, np.clip(centre - half, 0.0, 1.0), 0.0),
            high=np.where(finite, np.clip(centre + half, 0.0, 1.0), 1.0),
        )  # fmt: skip

    def to_json(self, about: Mapping[str, Any] | None = None) -> str:
        """Return the monitor as a JSON document.

        Args:
            about: Provenance to store in the document.
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
        """Return the monitor stored in a JSON document.

        Raises:
            DocumentError: The text is not a monitor, or its version is unknown.
        """
        try:
            document = json.loads(text)
        except ValueError as error:
            raise DocumentError(f"expected a monitor: {error}") from None
        if not isinstance(document, dict) or document.get("format") != FORMAT:
            raise DocumentError(f"expected a document with format {FORMAT!r}")
        if document.get("version") != VERSION:
            raise DocumentError(
                f"expected version {VERSION}, got {document.get('version')!r}: fit the monitor again"
            )
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
        """Return the monitor stored in a file.

        Raises:
            DocumentError: The file does not contain a monitor.
            OSError: The file cannot be read.
        """
        try:
            text = Path(path).read_text(encoding="utf-8")
        except UnicodeDecodeError:
            raise DocumentError(f"{path}: expected a monitor, got a binary file") from None
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
    """Return the numbers with a positive weight, scaled so that their differences sum to the exponent."""
    used = scales > 0
    return np.ascontiguousarray(rows[:, used] * scales[used]) if used.any() else np.zeros((len(rows), 1))


def _best_weights(
    space: SearchSpace, vectors: FloatArray, unsafe: BoolArray, rng: np.random.Generator
) -> FloatArray:
    """Return the weights with the smallest mean log loss when each solution is predicted from all others.

    Coordinate descent: one parameter after the other until nothing changes. On ties the smallest weight wins, so
    that parameters without an effect are left out.
    """
    learned = np.sort(rng.permutation(len(vectors))[:MAX_LEARNED])
    rows, truth = vectors[learned], unsafe[learned]
    predicted = np.sort(rng.permutation(len(rows))[:MAX_PREDICTED])
    itself = (np.arange(predicted.size), predicted)
    counts, share = truth.astype(np.float32), float(unsafe.mean())

    def difference(column: int) -> NDArray[np.float32]:
        apart = np.abs(rows[predicted, column, None] - rows[None, :, column])
        apart = apart != 0 if space.categorical[column] else apart / space.ranges[column]
        shares: NDArray[np.float32] = apart.astype(np.float32)
        return shares

    def loss(exponent: NDArray[np.float32]) -> float:
        kernel = np.exp(-exponent)
        kernel[itself] = 0.0
        risk = (kernel @ counts + share) / (kernel.sum(axis=1) + 1.0)
        risk = np.clip(risk.astype(np.float64), 1e-6, 1 - 1e-6)
        return -float(np.mean(np.where(truth[predicted], np.log(risk), np.log1p(-risk))))

    levels = np.full(space.dimension, _START)
    exponent = np.zeros((predicted.size, len(rows)), np.float32)
    for column in range(space.dimension):
        exponent += np.float32(LEVELS[_START]) * difference(column)
    for _ in range(MAX_SWEEPS):
        before = levels.copy()
        for column in range(space.dimension):
            apart = difference(column)
            others = exponent - np.float32(LEVELS[levels[column]]) * apart
            losses = [loss(others + np.float32(level) * apart) for level in LEVELS]
            levels[column] = int(np.argmin(losses))
            exponent = others + np.float32(LEVELS[levels[column]]) * apart
        if (levels == before).all():
            break
    weights: FloatArray = np.array(LEVELS)[levels]
    return weights
