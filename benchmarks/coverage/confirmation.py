"""Error rates and power of the test of pairs (`brink.search.sequential`), coverage of its intervals, and repeats."""

from functools import partial
from typing import Final

import numpy as np

from benchmarks.coverage.study import Claim, Study
from brink.search.algorithms.repeats import tallied
from brink.search.analysis.confirmation import Confirmation, Share, confirmation_of
from brink.search.sequential import ERROR, INTERVAL, exact_interval
from brink.search.space import BoolArray

LOOKS: Final = 200
"""Drives of each side in studies of errors, each followed by a look; later ones decide practically nothing."""
MOST: Final = 30
"""Maximum number of drives of each side in studies of power."""


def _ever(
    claim: Confirmation, risks: tuple[float, float], drives: int, rng: np.random.Generator, repetitions: int
) -> BoolArray:
    """Return for which pairs a claim is made at any time, with a look after every drive of both sides.

    Args:
        claim: What is claimed.
        risks: Probability of the other verdict of each side.
        drives: Drives of each side.
        rng: Draws verdicts.
        repetitions: Number of pairs.
    """
    other = (rng.random((repetitions, drives, 2)) < risks).cumsum(axis=1).tolist()
    found = []
    for pair in other:
        looks = (
            confirmation_of(Share.of(safe, count), Share.of(count - unsafe, count))
            for count, (safe, unsafe) in enumerate(pair, start=1)
        )
        found.append(next((state is claim for state in looks if state is not Confirmation.UNDECIDED), False))
    return np.array(found)


def _covered(drives: int, rng: np.random.Generator, repetitions: int) -> BoolArray:
    risks = rng.random(repetitions)
    limits = np.array([exact_interval(int(count), drives) for count in rng.binomial(drives, risks)])
    return (limits[:, 0] <= risks) & (risks <= limits[:, 1])


def _called_wrongly(p_th: float, times: int, rng: np.random.Generator, repetitions: int) -> BoolArray:
    """Return which solutions that are unsafe with the probability `p_th` repeats call safer or less safe."""
    unsafe = rng.random((repetitions, times)) < p_th
    which = np.repeat(np.arange(repetitions), times).tolist()
    found = tallied(which, unsafe.reshape(-1).tolist(), repetitions)
    return ~found.contains(p_th)


STUDIES: Final = (
    *(
        Study(
            name=f"confirmation: one side with a risk of {risk:.0%}, confirmed",
            claim=Claim.AT_MOST,
            nominal=ERROR,
            simulate=partial(_ever, Confirmation.CONFIRMED, (risk, 0.0), LOOKS),
        )
        for risk in (0.2, 0.3, 0.5)
    ),
    *(
        Study(
            name=f"confirmation: both sides with a risk of {risk:.0%}, refuted",
            claim=Claim.AT_MOST,
            nominal=ERROR,
            simulate=partial(_ever, Confirmation.REFUTED, (risk, risk), LOOKS),
        )
        for risk in (0.1, 0.2)
    ),
    *(
        Study(
            name=f"confirmation: both sides with a risk of {risk:.0%}, confirmed within {MOST} drives",
            claim=Claim.NONE,
            nominal=0.0,
            simulate=partial(_ever, Confirmation.CONFIRMED, (risk, risk), MOST),
        )
        for risk in (0.0, 0.02, 0.05)
    ),
    *(
        Study(
            name=f"confirmation: one side with a risk of {risk:.0%}, refuted within {MOST} drives",
            claim=Claim.NONE,
            nominal=0.0,
            simulate=partial(_ever, Confirmation.REFUTED, (risk, 0.0), MOST),
        )
        for risk in (0.5, 0.7, 1.0)
    ),
    *(
        Study(
            name=f"confirmation: exact interval after {drives} drives",
            claim=Claim.AT_LEAST,
            nominal=INTERVAL,
            simulate=partial(_covered, drives),
        )
        for drives in (4, 15, 30)
    ),
    *(
        Study(
            name=f"repeats: a solution at p_th {p_th:g} called safer or less safe after {times}",
            claim=Claim.AT_MOST,
            nominal=0.05,
            simulate=partial(_called_wrongly, p_th, times),
        )
        for p_th, times in ((0.1, 50), (0.35, 20))
    ),
)
