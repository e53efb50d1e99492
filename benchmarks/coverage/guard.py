"""Coverage of the intervals of a guard's effect on drives, and of the share of violations that it predicts."""

from collections.abc import Callable, Iterator
from functools import partial
from statistics import NormalDist
from typing import Final, NamedTuple

import numpy as np

from benchmarks.coverage.study import Claim, Study
from brink.guard.choices import FALSE_ALARMS
from brink.guard.evaluation import FOLDS, LEADS_S, JudgedDrives
from brink.search.analysis.folds import divisions, numbered
from brink.search.analysis.guard_drives import Estimate, GuardedDrives, guard_worth
from brink.search.analysis.intervals import CONFIDENCE
from brink.search.space import BoolArray, FloatArray, IntArray

SEEDS: Final = 10
UNSAFE, APART, SCENARIO_SD = 0.3, 1.5, 0.7
"""Share of drives with a violation; by how much their scores are higher; deviation of a scenario's mean score."""


class Loop(NamedTuple):
    """The outcomes of drives with a guard.

    Attributes:
        drives: Number of drives.
        prevented: Probability that a violation is prevented.
        caused: Probability that a safe drive is violated.
        alarms: Mean number of alarms.
    """

    drives: int
    prevented: float
    caused: float
    alarms: float

    def drawn(self, rng: np.random.Generator) -> GuardedDrives:
        """Return random drives; a prevented violation lets the car drive on."""
        count = self.drives
        before = rng.random(count) < UNSAFE
        after = np.where(before, rng.random(count) > self.prevented, rng.random(count) < self.caused)
        way_m = np.where(before, rng.uniform(20.0, 150.0, count), rng.uniform(100.0, 200.0, count))
        alarms = rng.negative_binomial(1.0, 1.0 / (1.0 + self.alarms), count)
        guarded_m = np.where(
            before & ~after, rng.uniform(90.0, 190.0, count), way_m * rng.beta(40.0, 1.0, count)
        )
        return GuardedDrives(
            seed=np.arange(count) % SEEDS,
            violated_without=before,
            violated_with=after,
            other_with=np.zeros(count, np.bool_),
            held_with=~after,
            way_without_m=way_m,
            way_with_m=guarded_m,
            time_with_s=rng.uniform(20.0, 30.0, count),
            alarms=alarms,
            intervention_s=np.asarray(2.0 * alarms, np.float64),
        )

    def truths(self) -> dict[str, float]:
        """Return the true figures."""
        fall = 1.0 - ((1.0 - self.prevented) + (1.0 - UNSAFE) / UNSAFE * self.caused)
        return {
            "reduction": fall,
            "distance_lost_when_safe": 1.0 - 40.0 / 41.0,
            "false_alarms_per_h": self.alarms * 3600.0 / 25.0,
        }


def _of_loop(loop: Loop, figure: str, rng: np.random.Generator, repetitions: int) -> BoolArray:
    truth = loop.truths()[figure]
    found: Iterator[Estimate] = (getattr(guard_worth(loop.drawn(rng)), figure) for _ in range(repetitions))
    return np.array(
        [one.low is not None and one.high is not None and one.low <= truth <= one.high for one in found]
    )


Labels = Callable[[np.random.Generator, int], list[IntArray]]


def _of_recall(drives: int, labels: Labels, rng: np.random.Generator, repetitions: int) -> BoolArray:
    """Scores are normal, and each label adds a normal effect."""
    kinds_of_drives = len(labels(rng, drives)) if labels is not _apart else 0
    deviation = np.sqrt(1.0 + kinds_of_drives * SCENARIO_SD**2)
    threshold = NormalDist(0.0, deviation).inv_cdf(1.0 - FALSE_ALARMS)
    truth = 1.0 - NormalDist(APART, deviation).cdf(threshold)
    covered = []
    for _ in range(repetitions):
        violated = rng.random(drives) < UNSAFE
        kinds = [numbered(kind.tolist()) for kind in labels(rng, drives)]
        score: FloatArray = rng.normal(APART * violated, 1.0)
        if kinds_of_drives:
            score += sum(rng.normal(0.0, SCENARIO_SD, int(kind.max()) + 1)[kind] for kind in kinds)
        judged = JudgedDrives(violated=violated, kinds=kinds, parts=divisions(kinds, violated, rng, FOLDS))
        _, (low, high) = judged.warnings(np.tile(score[:, None], len(LEADS_S)), FALSE_ALARMS)
        covered.append(low <= truth <= high)
    return np.array(covered)


def _apart(_: np.random.Generator, drives: int) -> list[IntArray]:
    return [np.arange(drives)]


def _by_scenario(rng: np.random.Generator, drives: int) -> list[IntArray]:
    return [rng.integers(0, drives // 6, drives)]


def _crossed(rng: np.random.Generator, drives: int) -> list[IntArray]:
    return [rng.integers(0, drives // 10, drives) for _ in range(2)]


_LOOPS: Final = {
    "2,000 drives": Loop(2_000, 0.9, 0.003, 0.3),
    "200 drives": Loop(200, 0.9, 0.003, 0.3),
    "200 drives, rare events": Loop(200, 0.98, 0.001, 0.02),
}
_FIGURES: Final = {
    "violations fall": "reduction",
    "distance lost": "distance_lost_when_safe",
    "false alarms": "false_alarms_per_h",
}
_DRIVES: Final = (
    ("2,000 random drives", 2_000, _apart),
    ("200 random drives", 200, _apart),
    ("1,300 drives of shared scenarios", 1_300, _by_scenario),
    ("1,300 drives of crossed scenarios and behaviours", 1_300, _crossed),
)
STUDIES: Final = (
    *(
        Study(
            name=f"guard drive: {words}, {case}",
            claim=Claim.AT_LEAST,
            nominal=CONFIDENCE,
            simulate=partial(_of_loop, loop, figure),
        )
        for case, loop in _LOOPS.items()
        for words, figure in _FIGURES.items()
    ),
    *(
        Study(
            name=f"guard judge: {case}",
            claim=Claim.AT_LEAST,
            nominal=CONFIDENCE,
            simulate=partial(_of_recall, drives, labels),
        )
        for case, drives, labels in _DRIVES
    ),
)
