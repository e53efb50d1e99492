"""CPU time of the search: a generation step at several archive sizes, and a query to a monitor."""

import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from brink.search.analysis.monitor import Monitor
from brink.search.archive import Archive, Neighbourhood
from brink.search.space import (
    BoolArray,
    Categorical,
    Component,
    Dormant,
    Duration,
    Extent,
    FloatArray,
    Integer,
    Real,
    SearchSpace,
)
from brink.search.streams import Stream, generator

SIZES = (200, 1_300, 5_000, 20_000)
NEW_SOLUTIONS = 60
TARGETS_MS = {1_300: 5.0, 20_000: 80.0}
"""Longest allowed median time of a generation step, by archive size."""
MONITOR_SIZES = (300, 1_300, 5_000, 20_000)
MONITOR_TARGETS_MS = {1_300: 1.0}
"""Longest allowed median time of a query, by the number of solutions to which the monitor was fitted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StepTime:
    """Time of a generation step or of a query.

    Attributes:
        solutions: Number of solutions before the step, or to which a monitor was fitted.
        new: Number of solutions that the step adds; 0 for a query.
        min_ms: Shortest time over the repeats.
        median_ms: Median time over the repeats.
        target_ms: Target for the median, or None.
    """

    solutions: int
    new: int
    min_ms: float
    median_ms: float
    target_ms: float | None

    @property
    def met(self) -> bool | None:
        """Whether the median meets the target; None without a target."""
        return None if self.target_ms is None else self.median_ms <= self.target_ms


def mixed_space() -> SearchSpace:
    """Return a space of 9 categorical and 20 numeric parameters, like that of the paper's case study."""
    choices = {"time": 3, "weather": 7, "pedestrians": 2, "curve": 4, "road": 3, "length": 3, "task": 3}
    scenario = Component(
        "scenario",
        tuple(Categorical(name, tuple(f"{name}-{i}" for i in range(n))) for name, n in choices.items()),
    )
    parameters: list[Categorical | Integer | Real] = []
    constraints: list[Dormant | Duration | Extent] = []
    for block in ("first", "second"):
        numbers: list[Integer | Real] = [Integer(f"{block}_t{i}", 0, 900, "step") for i in range(2)]
        constraints.append(Duration(numbers[0].name, numbers[1].name, 50, 900))
        for moment in ("start", "end"):
            for axis, size in (("x", 800.0), ("y", 600.0)):
                sides = [Real(f"{block}_{moment}_{axis}_{s}", 0.0, size, "px", 40.0) for s in ("min", "max")]
                constraints.append(Extent(sides[0].name, sides[1].name, 50.0, size))
                numbers.extend(sides)
        parameters += [Categorical(f"{block}_label", ("none", "vehicle", "person")), *numbers]
        constraints.append(Dormant(f"{block}_label", "none", tuple(number.name for number in numbers)))
    return SearchSpace((scenario, Component("behaviour", tuple(parameters), tuple(constraints))))


def measure_steps(sizes: Sequence[int] = SIZES, repeats: int = 15, seed: int = 1) -> tuple[StepTime, ...]:
    """Time a generation step (computing distances, counts and fitness for 60 new solutions) at several archive sizes.

    Args:
        sizes: Archive sizes before the step.
        repeats: Number of measurements of each step, >= 1.
        seed: Seed of the solutions.
    """
    space, rng = mixed_space(), generator(seed, Stream.START)
    rows, unsafe = _solutions(space, max(sizes) + NEW_SOLUTIONS, rng)
    robustness = np.where(unsafe, -1.0, 1.0)
    numbers = np.arange(len(rows))
    found = []
    for size in sizes:
        before, new = slice(size), slice(size, size + NEW_SOLUTIONS)
        archive = Archive.empty(space, Neighbourhood(radius=0.3, p_th=0.1)).grown(
            numbers[before], rows[before], unsafe[before], robustness[before], keep_rows=False
        )
        step = (numbers[new], rows[new], unsafe[new], robustness[new])
        times_ms = _times_ms(archive.grown, [step] * repeats)
        found.append(_step_time(times_ms, size, NEW_SOLUTIONS, TARGETS_MS.get(size)))
    return tuple(found)


def measure_monitor(
    sizes: Sequence[int] = MONITOR_SIZES, repeats: int = 500, seed: int = 1
) -> tuple[StepTime, ...]:
    """Time a query to monitors fitted to different numbers of solutions.

    Args:
        sizes: Numbers of solutions.
        repeats: Number of queries of each monitor.
        seed: Seed of the solutions and queries.
    """
    space, rng = mixed_space(), generator(seed, Stream.START)
    rows, unsafe = _solutions(space, max(sizes), rng)
    queries = [space.decode(space.sample(rng)) for _ in range(repeats)]
    weights = np.ones(space.dimension)
    found = []
    for size in sizes:
        monitor = Monitor.of(space, weights, rows[:size], unsafe[:size], threshold=0.1)
        times_ms = _times_ms(monitor.ask, [(query,) for query in queries])
        found.append(_step_time(times_ms, size, 0, MONITOR_TARGETS_MS.get(size)))
    return tuple(found)


def _solutions(space: SearchSpace, count: int, rng: np.random.Generator) -> tuple[FloatArray, BoolArray]:
    """Return random solutions, shape ``(count, dimension)``, and their verdicts, shape ``(count,)``."""
    rows = np.array([space.join(space.sample(rng)) for _ in range(count)])
    return rows, rng.random(count) < 0.35


def _times_ms(function: Callable[..., object], calls: Iterable[tuple[Any, ...]]) -> list[float]:
    times_ms = []
    for arguments in calls:
        start = time.perf_counter()
        function(*arguments)
        times_ms.append(1e3 * (time.perf_counter() - start))
    return times_ms


def _step_time(times_ms: Sequence[float], solutions: int, new: int, target_ms: float | None) -> StepTime:
    return StepTime(
        solutions=solutions,
        new=new,
        min_ms=min(times_ms),
        median_ms=statistics.median(times_ms),
        target_ms=target_ms,
    )
