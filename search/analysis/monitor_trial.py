"""A monitor on trial: it and others that saw the same foretell simulations that none of them ever saw.

Beside it stand the majority, which says of everything what share of all was unsafe, and gradient-boosted trees on the
same parameters (scikit-learn's, with its defaults; extra `analysis`), which know nothing of distances.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np

from brink.search.component import BoolArray, FloatArray
from brink.search.errors import install_command
from brink.search.judging import Alarm, Judgement, alarms, judge
from brink.search.monitor import Answer, Monitor

MONITOR, MAJORITY, TREES = "monitor", "majority", "gradient-boosted trees"
ALARM_STEPS = tuple(np.round(np.arange(0.0, 1.0001, 0.01), 2).tolist())


@dataclass(frozen=True, slots=True, kw_only=True)
class Witness:
    """Who foretells, and how well.

    Attributes:
        name: Who.
        judgement: How well.
        alarms: What alarms from each probability on cost.
    """

    name: str
    judgement: Judgement
    alarms: tuple[Alarm, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdicts:
    """What became of a monitor's answers.

    Attributes:
        answer: What it said.
        solutions: Of how many.
        unsafe: How many of these were unsafe.
    """

    answer: Answer
    solutions: int
    unsafe: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """A monitor and others before the same fresh simulations.

    Attributes:
        learned: Solutions that they learned from.
        fresh: Solutions that they foretold.
        threshold: Of the monitor's answers.
        witnesses: The monitor first.
        answers: What became of the monitor's answers.
        left_out: Who is not here, and why.
    """

    learned: int
    fresh: int
    threshold: float
    witnesses: tuple[Witness, ...]
    answers: tuple[Verdicts, ...]
    left_out: dict[str, str]


def try_monitor(monitor: Monitor, vectors: FloatArray, unsafe: BoolArray, *, seed: int = 1) -> Trial:
    """Judge a monitor, the majority and gradient-boosted trees by fresh simulations.

    Args:
        monitor: What it learned from is what the others learn from.
        vectors: Fresh solutions, shape ``(n, d)``; those that it knows are left out.
        unsafe: Their verdicts, shape ``(n,)``.
        seed: Of the trees.

    Raises:
        ValueError: Of the fresh solutions not both verdicts are known.
    """
    known = {row.tobytes() for row in monitor.vectors}
    fresh = np.array([row.tobytes() not in known for row in np.asarray(vectors, np.float64)], np.bool_)
    rows, truth = np.asarray(vectors, np.float64)[fresh], unsafe[fresh]
    risks = monitor.score(rows)
    answers = np.array(risks.answers(monitor.threshold))
    witnesses = [
        _witness(MONITOR, risks.probability, truth, risks.low, risks.high),
        _witness(MAJORITY, np.full(len(rows), monitor.unsafe_share), truth),
    ]
    left_out = {}
    if find_spec("sklearn") is None:
        left_out[TREES] = f"scikit-learn is not installed: {install_command('analysis')}"
    elif monitor.unsafe.all() or not monitor.unsafe.any():
        left_out[TREES] = "the monitor learned from one verdict alone"
    else:
        witnesses.append(_witness(TREES, _by_trees(monitor, rows, seed), truth))
    return Trial(
        learned=len(monitor),
        fresh=len(rows),
        threshold=monitor.threshold,
        witnesses=tuple(witnesses),
        answers=tuple(
            Verdicts(
                answer=answer, solutions=int((answers == answer).sum()),
                unsafe=int((truth & (answers == answer)).sum()),
            )
            for answer in Answer
        ),
        left_out=left_out,
    )  # fmt: skip


def _witness(
    name: str,
    probability: FloatArray,
    unsafe: BoolArray,
    low: FloatArray | None = None,
    high: FloatArray | None = None,
) -> Witness:
    return Witness(
        name=name,
        judgement=judge(probability, unsafe, low, high),
        alarms=tuple(alarms(probability, unsafe, _steps(probability))),
    )


def _steps(probability: FloatArray) -> Sequence[float]:
    """Return from which probabilities on alarms are tried: every hundredth, and one beyond all."""
    return [*ALARM_STEPS, float(np.nextafter(probability.max(), np.inf))]


def _by_trees(monitor: Monitor, rows: FloatArray, seed: int) -> FloatArray:
    # Imported here: an optional extra that takes a second to load.
    from sklearn.ensemble import HistGradientBoostingClassifier

    trees = HistGradientBoostingClassifier(
        categorical_features=monitor.space.categorical.tolist(), random_state=seed
    )
    trees.fit(monitor.vectors, monitor.unsafe)
    probability: FloatArray = trees.predict_proba(rows)[:, 1]
    return probability
