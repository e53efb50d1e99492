"""Time of one generation step: distances, counts and fitness when an archive grows by 60 solutions."""

import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from brink.search.archive import Archive, Neighbourhood
from brink.search.space import Categorical, Component, Dormant, Duration, Extent, Integer, Real, SearchSpace
from brink.search.streams import Stream, generator

SIZES = (200, 1_300, 5_000, 20_000)
NEW_SOLUTIONS = 60
TARGETS_MS = {1_300: 5.0, 20_000: 80.0}
"""Longest allowed time of a step in ms, by archive size."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StepTime:
    """Time of one generation step.

    Attributes:
        solutions: Size of the archive before the step.
        new: Number of solutions added.
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
        """Whether the median meets the target; None without one."""
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


def measure(sizes: Sequence[int] = SIZES, repeats: int = 15, seed: int = 1) -> tuple[StepTime, ...]:
    """Measure one generation step at several archive sizes.

    Args:
        sizes: Archive sizes before the step.
        repeats: Number of measurements of each step, >= 1.
        seed: Determines the solutions.
    """
    space = mixed_space()
    total = max(sizes) + NEW_SOLUTIONS
    rng = generator(seed, Stream.START)
    rows = np.array([space.join(space.sample(rng)) for _ in range(total)])
    unsafe = rng.random(total) < 0.35
    robustness = np.where(unsafe, -1.0, 1.0)
    return tuple(_step_time(space, rows, unsafe, robustness, size, repeats) for size in sizes)


def _step_time(
    space: SearchSpace,
    rows: np.typing.NDArray[np.float64],
    unsafe: np.typing.NDArray[np.bool_],
    robustness: np.typing.NDArray[np.float64],
    size: int,
    repeats: int,
) -> StepTime:
    numbers = np.arange(size + NEW_SOLUTIONS)
    before, new = slice(size), slice(size, size + NEW_SOLUTIONS)
    archive = Archive.empty(space, Neighbourhood(radius=0.3, p_th=0.1)).grown(
        numbers[before], rows[before], unsafe[before], robustness[before], keep_rows=False
    )
    times_ms: list[float] = []
    for _ in range(repeats):
        start = time.perf_counter()
        archive.grown(numbers[new], rows[new], unsafe[new], robustness[new])
        times_ms.append(1e3 * (time.perf_counter() - start))
    return StepTime(
        solutions=size,
        new=NEW_SOLUTIONS,
        min_ms=min(times_ms),
        median_ms=statistics.median(times_ms),
        target_ms=TARGETS_MS.get(size),
    )
