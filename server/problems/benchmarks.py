"""The benchmark problems with known answers, evaluated in process."""

from collections.abc import Mapping
from typing import Any, ClassVar

import brink.search.problems.mtq as mtq
import brink.search.problems.onemax as onemax
from brink.search.algorithm import Evaluation
from brink.server.problems.base import NoParams, Vectors


class Mtq:
    """Two unequal hills on the unit square; unsafe below height 0."""

    id: ClassVar[str] = "mtq@1"
    summary: ClassVar[str] = "Maximum of two quadratics on the unit square: a boundary that can be drawn."
    params_type: ClassVar[type[Any]] = NoParams

    def __init__(self, params: NoParams) -> None:
        self.space = mtq.SPACE
        self.algorithm_defaults: Mapping[str, Any] = {"radius": mtq.RADIUS}

    def evaluate(self, vectors: Vectors) -> Evaluation:
        """Return the verdict of the formula."""
        return mtq.evaluate(vectors)


class Onemax:
    """Ten and ten bits; unsafe if fewer than five are set."""

    id: ClassVar[str] = "onemax@1"
    summary: ClassVar[str] = "Twenty bits, unsafe if fewer than five are set: a boundary that can be counted."
    params_type: ClassVar[type[Any]] = NoParams

    def __init__(self, params: NoParams) -> None:
        self.space = onemax.SPACE
        self.algorithm_defaults: Mapping[str, Any] = {"radius": onemax.RADIUS}

    def evaluate(self, vectors: Vectors) -> Evaluation:
        """Return the verdict of the formula."""
        return onemax.evaluate(vectors)
