"""Coverage of the intervals of tolerated severities (`brink.search.curves`)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from benchmarks.coverage.study import Claim, Study
from brink.search.curves import LEVELS, Counts, Screening, curves_of, severities, severity_at
from brink.search.space import BoolArray, FloatArray

LIMIT: Final = 0.05
CONFIDENCE: Final = 0.9


def steps(rng: np.random.Generator, cells: int, lowest: float = 0.06) -> FloatArray:
    """Return curves that rise from 0 to a height from ``lowest`` to 1, in one step, shape ``(cells, LEVELS + 1)``."""
    middle = rng.uniform(0.1, 0.9, (cells, 1))
    scale = rng.uniform(0.02, 0.15, (cells, 1))
    height = np.exp(rng.uniform(np.log(lowest), 0.0, (cells, 1)))
    rise = 1.0 / (1.0 + np.exp((middle - severities()) / scale))
    return np.asarray(height * (rise - rise[:, :1]) / (1.0 - rise[:, :1]))


def _drawn(shares: FloatArray, drives: int, rng: np.random.Generator) -> Counts:
    """Return the counts of drives at random levels of severity.

    Args:
        shares: True shares at all severities, shape ``(cells, LEVELS + 1)``.
        drives: Drives of each cell.
        rng: Draws levels and verdicts.
    """
    simulated = rng.multinomial(drives, np.full(LEVELS, 1.0 / LEVELS), len(shares))
    return Counts(drives=simulated, caused=rng.binomial(simulated, shares[:, 1:]))


def _covered(counts: Counts, screenings: Sequence[Screening | None], truth: FloatArray) -> BoolArray:
    """Return in which cells the interval covers where the truth reaches the limit."""
    known = curves_of(counts, screenings, [False] * len(truth), limit=LIMIT, confidence=CONFIDENCE)
    low, high = np.array([(one.tolerated.low, one.tolerated.high) for one in known]).T
    severity = severity_at(truth, LIMIT)
    return np.asarray((low <= severity) & (severity <= high))


def _without_screening(drives: int, rng: np.random.Generator, repetitions: int) -> BoolArray:
    truth = steps(rng, repetitions)
    return _covered(_drawn(truth, drives, rng), [None] * repetitions, truth)


@dataclass(frozen=True, slots=True, kw_only=True)
class Leaks:
    """Drives that hold with the most severe error and violate with milder ones.

    Attributes:
        name: The case in words.
        share: Their share of the drives that hold, at severity 1.
        grows: The share at a severity, as a part of that at severity 1.
        claim: Whether the intervals promise to cover; not where leaks do not grow in proportion to severity.
    """

    name: str
    share: float
    grows: Callable[[FloatArray], FloatArray] = np.asarray
    claim: Claim = Claim.AT_LEAST


SCREENED: Final = 180
DRIVES: Final = 60
AUDITS: Final = 60
"""Screened drives of a group, drives of a cell with an error, and audits of a group: those of a usual campaign."""


def _with_screening(leaks: Leaks, rng: np.random.Generator, repetitions: int) -> BoolArray:
    vulnerable, leak = rng.uniform(0.15, 0.6, repetitions), leaks.share * leaks.grows(severities())
    among_vulnerable = steps(rng, repetitions)
    truth = vulnerable[:, None] * among_vulnerable + (1.0 - vulnerable)[:, None] * leak
    audits = _drawn(np.broadcast_to(leak, truth.shape), AUDITS, rng)
    screenings = [
        Screening(vulnerable=int(found), screened=SCREENED, audits=audited, leaks=leaking)
        for found, audited, leaking in zip(
            rng.binomial(SCREENED, vulnerable), audits.drives, audits.caused, strict=True
        )
    ]
    return _covered(_drawn(among_vulnerable, DRIVES, rng), screenings, truth)


_LEAKS: Final = (
    *(
        Leaks(name=f"{share:.0%} of the drives that hold leak", share=share)
        for share in (0.0, 0.02, 0.1, 0.3)
    ),
    Leaks(
        name="10% leak at any severity from .25",
        share=0.1,
        grows=lambda severity: np.where(severity >= 0.25, 1.0, 0.0),
        claim=Claim.NONE,
    ),
)
STUDIES: Final = (
    *(
        Study(
            name=f"tolerance: {drives:,} drives a cell",
            claim=Claim.AT_LEAST,
            nominal=CONFIDENCE,
            simulate=partial(_without_screening, drives),
        )
        for drives in (100, 1_000, 5_000, 20_000)
    ),
    *(
        Study(
            name=f"tolerance, screened: {leaks.name}",
            claim=leaks.claim,
            nominal=CONFIDENCE,
            simulate=partial(_with_screening, leaks),
        )
        for leaks in _LEAKS
    ),
)
