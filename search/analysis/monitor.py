"""A safety monitor: the probability that a complete solution is unsafe, estimated from simulated ones.

A monitor holds simulated solutions with their verdicts, and a model fitted to them: gradient-boosted trees
(`brink.search.analysis.boosted_trees`), which are more accurate, or kernel regression on the neighbours
(`brink.search.analysis.neighbours`), which needs no extra package and can be followed by hand.

Each probability has an interval. A solution is called unsafe only if the whole interval is above the threshold, and
safe only if none of it is; otherwise the answer is "unknown". It is also "unknown" if the solution is unlike anything
simulated (`brink.search.analysis.coverage`).

To be asked, a monitor needs only numpy and scipy, and no server: ``Monitor.load("monitor.json").ask({...})``.

Source: the safety monitors of Sharifi et al. 2023, section 5.1, which the boundary is meant for.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import ArrayLike

from brink.search.analysis.boosted_trees import BoostedTrees, is_installed
from brink.search.analysis.choices import LEAST_OF_A_VERDICT, Model
from brink.search.analysis.coverage import Coverage
from brink.search.analysis.neighbours import Neighbours
from brink.search.errors import DocumentError, SpaceError
from brink.search.features import Features
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
from brink.user_file import read_text

FORMAT: Final = "brink-monitor"
VERSION: Final = 4
LARGEST_BYTES: Final = 256 * 1024**2
"""Maximum size of a file."""


class Answer(StrEnum):
    """A monitor's answer for a solution."""

    SAFE = "safe"
    UNSAFE = "unsafe"
    UNKNOWN = "unknown"


def default_model(unsafe: BoolArray) -> Model:
    """Return the more accurate model that can be fitted.

    These are the trees where scikit-learn is installed and both verdicts occur often enough, else the neighbours.

    Args:
        unsafe: Verdicts of the simulated solutions, shape ``(n,)``.
    """
    enough = min(np.count_nonzero(unsafe), np.count_nonzero(~unsafe)) >= LEAST_OF_A_VERDICT
    return Model.TREES if is_installed() and enough else Model.NEIGHBOURS


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Risks:
    """Risk estimates for m solutions.

    Attributes:
        probability: Unsafe probability, shape ``(m,)``.
        low: Lower limit of its interval, shape ``(m,)``.
        high: Upper limit of its interval, shape ``(m,)``.
        neighbours: Total weight of the evaluated solutions around each, in evaluations, shape ``(m,)``; None for
            trees, which have no such number.
        nearest: Distance to the nearest simulated solution, shape ``(m,)``.
        unlike: In what each solution is unlike anything simulated, in words; empty if it is not.
    """

    probability: FloatArray
    low: FloatArray
    high: FloatArray
    neighbours: FloatArray | None
    nearest: FloatArray
    unlike: tuple[str, ...]

    def answers(self, threshold: float) -> list[Answer]:
        """Return the answers for a threshold probability, each decided by the interval."""
        return [
            Answer.UNKNOWN
            if unlike
            else Answer.UNSAFE
            if low > threshold
            else Answer.SAFE
            if high <= threshold
            else Answer.UNKNOWN
            for low, high, unlike in zip(self.low.tolist(), self.high.tolist(), self.unlike, strict=True)
        ]

    def each(self, threshold: float) -> "list[Risk]":
        """Return the estimate for each solution, with the answer for a threshold probability."""
        count = len(self.probability)
        return [
            Risk(
                probability=p, low=low, high=high, neighbours=n, nearest=nearest, unlike=unlike, answer=answer
            )
            for p, low, high, n, nearest, unlike, answer in zip(
                self.probability.tolist(),
                self.low.tolist(),
                self.high.tolist(),
                [None] * count if self.neighbours is None else self.neighbours.tolist(),
                self.nearest.tolist(),
                self.unlike,
                self.answers(threshold),
                strict=True,
            )
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Risk:
    """Risk estimate for one solution.

    Attributes:
        probability: Unsafe probability.
        low: Lower limit of its interval.
        high: Upper limit of its interval.
        neighbours: Total weight of the evaluated solutions around it, in evaluations; None for trees.
        nearest: Distance to the nearest simulated solution.
        unlike: In what the solution is unlike anything simulated, in words; empty if it is not.
        answer: The answer for the monitor's threshold.
    """

    probability: float
    low: float
    high: float
    neighbours: float | None
    nearest: float
    unlike: str
    answer: Answer


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Monitor:
    """Simulated solutions and a model fitted to them, from which the risk of any solution is estimated.

    Attributes:
        space: Space of the complete solutions; constraints are not needed.
        vectors: Simulated solutions, shape ``(n, d)``.
        unsafe: Their verdicts, shape ``(n,)``.
        threshold: Probability above which a solution is called unsafe, in (0, 1).
        z: Quantile of the standard normal for the interval, > 0.
        features: Features of solutions: which numbers are tied together, which parts are interchangeable.
        estimator: The fitted model.
        coverage: What counts as like the simulated solutions.
    """

    space: SearchSpace
    vectors: FloatArray
    unsafe: BoolArray
    threshold: float
    z: float
    features: Features
    estimator: Neighbours | BoostedTrees
    coverage: Coverage

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
        """Return a monitor of the neighbours with the given weights.

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
        rows, verdicts = _checked(space, vectors, unsafe, threshold, z)
        features = Features.of_space(space)
        return cls(
            space=space,
            vectors=rows,
            unsafe=verdicts,
            threshold=threshold,
            z=z,
            features=features,
            estimator=Neighbours.of(space, weights, rows, verdicts),
            coverage=Coverage.of(space, rows, features.orders),
        )

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
        model: Model = Model.NEIGHBOURS,
    ) -> Self:
        """Return a monitor with a model fitted to the simulated solutions.

        Args:
            space: The search space.
            vectors: Simulated solutions, shape ``(n, d)``, n >= 2.
            unsafe: Their verdicts, shape ``(n,)``.
            threshold: Probability above which a solution is called unsafe, in (0, 1).
            z: Quantile of the standard normal for the interval, > 0.
            seed: Determines the folds of the trees, and the solutions that weights are chosen with if there are many.
            model: The model to fit.

        Raises:
            MissingExtra: Trees were asked for, and scikit-learn is not installed.
            ValueError: A shape or a value is wrong, or there are too few solutions.
        """
        rows, verdicts = _checked(space, vectors, unsafe, threshold, z)
        features = Features.of_space(space)
        return cls(
            space=space,
            vectors=rows,
            unsafe=verdicts,
            threshold=threshold,
            z=z,
            features=features,
            estimator=_fitted(features, rows, verdicts, model, seed),
            coverage=Coverage.of(space, rows, features.orders),
        )

    def refitted(self, model: Model, *, seed: int = 1) -> Self:
        """Return a monitor with another model fitted to the same simulated solutions.

        Args:
            model: The model to fit.
            seed: As for `fitted`.

        Raises:
            MissingExtra: Trees were asked for, and scikit-learn is not installed.
            ValueError: There are too few solutions.
        """
        return replace(self, estimator=_fitted(self.features, self.vectors, self.unsafe, model, seed))

    def __len__(self) -> int:
        return len(self.vectors)

    @property
    def model(self) -> Model:
        """The kind of model."""
        return Model.TREES if isinstance(self.estimator, BoostedTrees) else Model.NEIGHBOURS

    @property
    def unsafe_share(self) -> float:
        """Unsafe share of all simulated solutions."""
        return float(self.unsafe.mean())

    @property
    def informative_weights(self) -> dict[str, float]:
        """The positive weights of the neighbours by ``component.parameter``, largest first; empty for trees."""
        if not isinstance(self.estimator, Neighbours):
            return {}
        known = zip(self.space.column_names(), self.estimator.weights.tolist(), strict=True)
        return dict(sorted(((name, weight) for name, weight in known if weight > 0), key=lambda one: -one[1]))

    def score(self, vectors: FloatArray) -> Risks:
        """Estimate the risk of complete solutions, shape ``(m, d)``.

        Raises:
            SpaceError: The shape is wrong.
        """
        rows = np.asarray(vectors, np.float64)
        if rows.ndim != 2 or rows.shape[1] != self.space.dimension:
            raise SpaceError(f"expected rows of {self.space.dimension} numbers, got shape {rows.shape}")
        neighbours: FloatArray | None = None
        if isinstance(self.estimator, Neighbours):
            probability, low, high, neighbours = self.estimator.estimate(rows, self.z)
        else:
            probability, low, high = self.estimator.estimate(rows, self.z)
        nearest = self.coverage.nearest(rows)
        return Risks(
            probability=probability,
            low=low,
            high=high,
            neighbours=neighbours,
            nearest=nearest,
            unlike=self.coverage.reasons(rows, nearest),
        )

    def encoded(self, values: Mapping[str, Mapping[str, object]]) -> FloatArray:
        """Return the row of a complete solution, shape ``(d,)``; it may lie outside the ODD, as its risk then states.

        Args:
            values: ``{component: {parameter: value}}``.

        Raises:
            SpaceError: A value is missing, unknown or out of range; names the parameter.
        """
        whole = self.space.unlimited()
        return whole.join(whole.encode(values))

    def ask(self, values: Mapping[str, Mapping[str, object]]) -> Risk:
        """Estimate the risk of one complete solution.

        Args:
            values: ``{component: {parameter: value}}``, as in ``solutions`` of the API.

        Raises:
            SpaceError: A value is missing, unknown or out of range; names the parameter.
        """
        risks = self.score(self.encoded(values)[None])
        return risks.each(self.threshold)[0]

    def to_json(self, about: Mapping[str, Any] | None = None) -> str:
        """Return the monitor as a JSON document.

        Args:
            about: Provenance to store in the document.
        """
        estimator = self.estimator
        fitted = (
            estimator.to_document()
            if isinstance(estimator, BoostedTrees)
            else {"weights": estimator.weights.tolist()}
        )
        document = {
            "format": FORMAT,
            "version": VERSION,
            "about": dict(about or {}),
            "threshold": self.threshold,
            "z": self.z,
            "components": [
                {"name": component.name, "parameters": [p.describe() for p in component.parameters]}
                for component in self.space.components
            ],
            "unsafe": [int(one) for one in self.unsafe],
            "vectors": self.vectors.tolist(),
            "ties": self.features.ties,
            "orders": self.features.orders.tolist(),
            "model": {"name": str(self.model), **fitted},
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
        except (ValueError, RecursionError) as error:
            raise DocumentError(f"expected a monitor: {error}") from None
        if not isinstance(document, dict) or document.get("format") != FORMAT:
            raise DocumentError(f"expected a document with format {FORMAT!r}")
        if document.get("version") != VERSION:
            raise DocumentError(
                f"expected version {VERSION}, got {document.get('version')!r}: fit the monitor again"
            )
        try:
            return cls._read(document)
        except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
            raise DocumentError(f"expected a monitor: {type(error).__name__}: {error}") from None

    @classmethod
    def _read(cls, document: Mapping[str, Any]) -> Self:
        space = SearchSpace(
            tuple(
                Component(part["name"], tuple(_parameter(one) for one in part["parameters"]))
                for part in document["components"]
            )
        )
        threshold, z = float(document["threshold"]), float(document["z"])
        given = np.array(document["vectors"], np.float64), np.array(document["unsafe"], np.bool_)
        rows, verdicts = _checked(space, *given, threshold, z)
        features = Features.of(space, document["ties"], document["orders"])
        stored = document["model"]
        estimator: Neighbours | BoostedTrees
        if Model(stored["name"]) is Model.TREES:
            estimator = BoostedTrees.of(features, stored)
        else:
            estimator = Neighbours.of(space, stored["weights"], rows, verdicts)
        return cls(
            space=space,
            vectors=rows,
            unsafe=verdicts,
            threshold=threshold,
            z=z,
            features=features,
            estimator=estimator,
            coverage=Coverage.of(space, rows, features.orders),
        )

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Return the monitor stored in a file.

        Raises:
            DocumentError: The file does not contain a monitor.
            OSError: The file cannot be read.
        """
        try:
            text = read_text(path, LARGEST_BYTES)
        except UnicodeDecodeError:
            raise DocumentError(f"{path}: expected a monitor, got a binary file") from None
        return cls.from_json(text)


def _fitted(
    features: Features, vectors: FloatArray, unsafe: BoolArray, model: Model, seed: int
) -> Neighbours | BoostedTrees:
    if len(vectors) < 2:
        raise ValueError(f"expected at least two evaluated solutions, got {len(vectors)}")
    rng = generator(seed, Stream.MONITOR)
    if model is Model.TREES:
        return BoostedTrees.fitted(features, vectors, unsafe, rng)
    return Neighbours.fitted(features.space, vectors, unsafe, rng)


def _checked(
    space: SearchSpace, vectors: FloatArray, unsafe: BoolArray, threshold: float, z: float
) -> tuple[FloatArray, BoolArray]:
    """Return solutions and verdicts, read-only.

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
    if not 0 < threshold < 1:
        raise ValueError(f"threshold: expected a probability in (0, 1), got {threshold!r}")
    if not (math.isfinite(z) and z > 0):
        raise ValueError(f"z: expected a number > 0, got {z!r}")
    return rows, verdicts


def _parameter(described: Mapping[str, Any]) -> Parameter:
    name, kind = str(described["name"]), described["type"]
    parameter: Parameter
    if kind == "categorical":
        parameter = Categorical(name, tuple(described["choices"]))
    elif kind == "integer":
        parameter = Integer(name, described["low"], described["high"], described.get("unit", ""))
    elif kind == "real":
        parameter = Real(name, described["low"], described["high"], described.get("unit", ""))
    else:
        raise DocumentError(f"{name}: expected a real, integer or categorical parameter, got {kind!r}")
    return parameter.limited(described["odd"]) if "odd" in described else parameter
