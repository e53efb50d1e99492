"""Tables of an experiment: each method's figures with intervals, and methods compared with each other.

Source: Sharifi et al. 2023, Tables 1 and 2. Beyond the paper: strict DBS, controls, and p-values corrected by Holm's
method for all comparisons of one table, which are those of one problem and one measure in which values differ at all.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from brink.search.analysis.scores import Figures, Scores
from brink.search.boundary import PAPER_D_THS, PAPER_T_BS
from brink.search.statistics import Comparison, MeanInterval, compared, effect_size, holm, mean_interval


class Measure(StrEnum):
    """What is counted."""

    DBS = "dbs"
    STRICT = "strict"

    def of(self, figures: Figures) -> NDArray[np.float64]:
        """Return its figures."""
        return figures.dbs if self is Measure.DBS else figures.strict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Repeat:
    """A finished campaign of an experiment, and what it reached."""

    problem: str
    method: str
    seed: int
    campaign: str
    scores: Scores


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A method, or its control, on one problem."""

    problem: str
    method: str
    control: bool

    @property
    def label(self) -> str:
        """What it is called."""
        return f"{self.method}, control" if self.control else self.method


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """Table 1: where a method stands for one pair of thresholds."""

    line: Line
    measure: Measure
    t_b: float
    d_th: float
    value: MeanInterval


@dataclass(frozen=True, slots=True, kw_only=True)
class Duel:
    """Table 2: one line against another for one pair of thresholds.

    Attributes:
        first: Whose larger values make an A12 above one half.
        second: The other one.
        measure: What is compared.
        t_b: Largest fitness of a boundary solution.
        d_th: Least distance between two that count.
        result: U, p and A12.
        adjusted: The p-value, corrected for all comparisons of the table.
    """

    first: Line
    second: Line
    measure: Measure
    t_b: float
    d_th: float
    result: Comparison
    adjusted: float

    @property
    def size(self) -> str:
        """The effect in a word."""
        return effect_size(self.result.a12)


def lines_of(repeats: Sequence[Repeat]) -> dict[Line, list[tuple[int, Figures]]]:
    """Return the seeds and figures of each method and each control, in the order in which they come."""
    found: dict[Line, list[tuple[int, Figures]]] = {}
    for repeat in repeats:
        line = Line(problem=repeat.problem, method=repeat.method, control=False)
        found.setdefault(line, []).append((repeat.seed, repeat.scores.figures))
    for repeat in repeats:
        if repeat.scores.control is not None:
            line = Line(problem=repeat.problem, method=repeat.method, control=True)
            found.setdefault(line, []).append((repeat.seed, repeat.scores.control.figures))
    return found


def standings(repeats: Sequence[Repeat]) -> list[Standing]:
    """Return Table 1: means and 95% intervals for all lines, measures and thresholds."""
    return [
        Standing(
            line=line, measure=measure, t_b=t_b, d_th=d_th,
            value=mean_interval([float(measure.of(figures)[-1, i, j]) for _, figures in values]),
        )
        for line, values in lines_of(repeats).items()
        for measure in Measure
        for i, t_b in enumerate(PAPER_T_BS)
        for j, d_th in enumerate(PAPER_D_THS)
    ]  # fmt: skip


def duels(repeats: Sequence[Repeat]) -> list[Duel]:
    """Return Table 2: each pair of methods on a problem, and each method against its control."""
    lines = lines_of(repeats)
    found: list[Duel] = []
    for problem in dict.fromkeys(line.problem for line in lines):
        for measure in Measure:
            found += _table(lines, list(_pairs(lines, problem)), measure)
    return found


def _pairs(lines: Mapping[Line, object], problem: str) -> Iterator[tuple[Line, Line]]:
    methods = [line for line in lines if line.problem == problem and not line.control]
    yield from itertools.combinations(methods, 2)
    for line in methods:
        control = Line(problem=problem, method=line.method, control=True)
        if control in lines:
            yield line, control


def _table(
    lines: Mapping[Line, list[tuple[int, Figures]]], pairs: Sequence[tuple[Line, Line]], measure: Measure
) -> list[Duel]:
    results = []
    for first, second in pairs:
        for i, t_b in enumerate(PAPER_T_BS):
            for j, d_th in enumerate(PAPER_D_THS):
                a, b = (
                    [float(measure.of(figures)[-1, i, j]) for _, figures in lines[line]]
                    for line in (first, second)
                )
                results.append((first, second, t_b, d_th, compared(a, b), len({*a, *b}) > 1))
    # Where all values are the same there is nothing to test, whoever they belong to (Tarone 1990).
    tested = iter(holm([result.p_value for *_, result, differ in results if differ]))
    return [
        Duel(
            first=first, second=second, measure=measure, t_b=t_b, d_th=d_th, result=result,
            adjusted=next(tested) if differ else 1.0,
        )
        for first, second, t_b, d_th, result, differ in results
    ]  # fmt: skip
