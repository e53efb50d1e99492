"""Benchmark problems with known boundaries, evaluated in process."""

from typing import Any, ClassVar

from brink.search.algorithm import Evaluation
from brink.search.problems import (
    MTQ_RADIUS,
    MTQ_SPACE,
    ONEMAX_RADIUS,
    ONEMAX_SPACE,
    evaluate_mtq,
    evaluate_onemax,
)
from brink.server.problems.base import InProcessProblem, NoParams, Vectors


class Mtq(InProcessProblem):
    """Two hills of different height on the unit square; a point is unsafe where the height is below 0."""

    id: ClassVar[str] = "mtq@1"
    summary: ClassVar[str] = "Maximum of two quadratics on the unit square: a boundary that can be drawn."
    params_type: ClassVar[type[Any]] = NoParams

    def __init__(self, params: NoParams) -> None:
        self.space = MTQ_SPACE
        self.algorithm_defaults = {
            "radius": MTQ_RADIUS,
            "eps": 0.002,
            "d_th": 0.05,
            "margin": 0.0,
            "checks": 0,
            "trials": 0,
        }

    def evaluate(self, vectors: Vectors) -> Evaluation:
        """Return the verdict of the formula."""
        return evaluate_mtq(vectors)


class Onemax(InProcessProblem):
    """Two components of ten bits; a candidate is unsafe if fewer than five bits are set."""

    id: ClassVar[str] = "onemax@1"
    summary: ClassVar[str] = "Twenty bits, unsafe if fewer than five are set: a boundary that can be counted."
    params_type: ClassVar[type[Any]] = NoParams

    def __init__(self, params: NoParams) -> None:
        self.space = ONEMAX_SPACE
        self.algorithm_defaults = {"radius": ONEMAX_RADIUS, "margin": 0.0, "checks": 0, "trials": 0}

    def evaluate(self, vectors: Vectors) -> Evaluation:
        """Return the verdict of the formula."""
        return evaluate_onemax(vectors)
