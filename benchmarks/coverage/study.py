"""Studies of intervals and tests on synthetic data with a known truth: nominal against measured rates.

A module of this package that has ``STUDIES`` adds studies to `coverage`; nothing lists the modules. Each
study makes up data many times, calls the code of the product on them, and says in which repetitions the interval
covered the truth, or the test erred.
"""

import importlib
import pkgutil
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

import benchmarks.coverage
from benchmarks.measurement import Progress
from brink.search.fitness import wilson_interval
from brink.search.space import BoolArray

REPETITIONS: Final = 1_000
Z_99: Final = 2.575829
"""Quantile of the standard normal for the interval of a found rate: 99%, because many rates are found at once."""


class Claim(StrEnum):
    """The promise of a nominal rate."""

    AT_LEAST = "at least"
    """An interval covers the truth at least this often."""
    AT_MOST = "at most"
    """An error occurs at most this often."""
    NONE = ""
    """Nothing: the rate serves as a comparison."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """Synthetic data with a known truth, and an interval or a test on them.

    Attributes:
        name: Name, unique among all studies: what is judged, then the case, such as ``tolerance: 100 drives a cell``.
        claim: What the nominal rate promises.
        nominal: The nominal rate, in [0, 1].
        simulate: Given a generator and a number of repetitions, returns in which of them the interval covered or the
            test erred, shape ``(repetitions,)``.
    """

    name: str
    claim: Claim
    nominal: float
    simulate: Callable[[np.random.Generator, int], BoolArray]


@dataclass(frozen=True, slots=True, kw_only=True)
class Coverage:
    """The rate that a study measured.

    Attributes:
        name: Name of the study.
        claim: What the nominal rate promises.
        nominal: The nominal rate.
        hits: Repetitions in which the interval covered or the test erred.
        repetitions: All repetitions.
    """

    name: str
    claim: Claim
    nominal: float
    hits: int
    repetitions: int

    @property
    def found(self) -> float:
        """The measured rate."""
        return self.hits / self.repetitions

    @property
    def interval(self) -> tuple[float, float]:
        """The 99% Wilson interval of the rate."""
        low, high = wilson_interval(self.hits, self.repetitions, Z_99)
        return float(low), float(high)

    @property
    def met(self) -> bool | None:
        """Whether the measured rate agrees with the nominal one; None if that promises nothing."""
        low, high = self.interval
        match self.claim:
            case Claim.AT_LEAST:
                return high >= self.nominal
            case Claim.AT_MOST:
                return low <= self.nominal
            case Claim.NONE:
                return None


def studies() -> list[Study]:
    """Return the studies of all modules of this package, by name."""
    found = [
        study
        for module in pkgutil.iter_modules(benchmarks.coverage.__path__, f"{benchmarks.coverage.__name__}.")
        for study in getattr(importlib.import_module(module.name), "STUDIES", ())
    ]
    return sorted(found, key=lambda study: study.name)


def measure(
    chosen: Iterable[Study], repetitions: int, seed: int, progress: Progress = lambda *_: None
) -> Iterator[Coverage]:
    """Yield the rate that each study measures.

    Args:
        chosen: The studies. What one finds does not depend on the others.
        repetitions: Repetitions of each, >= 1.
        seed: Seed of the synthetic data, >= 0.
        progress: Called before and after each study.
    """
    for study in chosen:
        progress(study.name, 0, 1)
        rng = np.random.default_rng([seed, zlib.crc32(study.name.encode())])
        hits = study.simulate(rng, repetitions)
        if hits.shape != (repetitions,):
            raise ValueError(f"{study.name}: expected {repetitions} repetitions, got shape {hits.shape}")
        progress(study.name, 1, 1)
        yield Coverage(
            name=study.name,
            claim=study.claim,
            nominal=study.nominal,
            hits=int(np.count_nonzero(hits)),
            repetitions=repetitions,
        )
