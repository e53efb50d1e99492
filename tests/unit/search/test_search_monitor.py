import json
import math
from pathlib import Path

import numpy as np
import pytest

from brink.search.analysis import neighbours
from brink.search.analysis.monitor import Answer, Monitor
from brink.search.analysis.monitor_evaluation import evaluate_monitor, evaluate_pairs
from brink.search.analysis.neighbours import Neighbours
from brink.search.analysis.statistics import a12
from brink.search.errors import DocumentError, SpaceError
from brink.search.fitness import wilson_interval
from brink.search.space import Component, FloatArray, Real, SearchSpace
from brink.search.testing import example_spaces

MIXED = example_spaces()["mixed"]
PLANE = SearchSpace((Component("scenario", (Real("x", 0, 1),)), Component("behaviour", (Real("y", 0, 1),))))


def plane(count: int, seed: int = 1) -> tuple[np.typing.NDArray[np.float64], np.typing.NDArray[np.bool_]]:
    """Return points of the unit square that are unsafe with probability x, so that y is uninformative."""
    rng = np.random.default_rng(seed)
    rows = rng.random((count, 2))
    return rows, rng.random(count) < rows[:, 0]


def weights_of(monitor: Monitor) -> FloatArray:
    assert isinstance(monitor.estimator, Neighbours)
    return monitor.estimator.weights


def naive(monitor: Monitor, row: np.typing.NDArray[np.float64]) -> tuple[float, float, float]:
    n = k = 0.0
    space = monitor.space
    for other, unsafe in zip(monitor.vectors, monitor.unsafe, strict=True):
        exponent = 0.0
        for column, weight in enumerate(weights_of(monitor)):
            apart = abs(row[column] - other[column]) / space.ranges[column]
            exponent += weight * (apart > 0 if space.categorical[column] else apart)
        n += math.exp(-exponent)
        k += math.exp(-exponent) * unsafe
    return n, k, (k + monitor.unsafe_share) / (n + 1)


@pytest.mark.parametrize("kind", ["all", "some", "numbers", "categories", "none"])
def test_scores_follow_the_definition(kind: str) -> None:
    rng = np.random.default_rng(4)
    rows = np.array([MIXED.join(MIXED.sample(rng)) for _ in range(90)])
    weights = rng.uniform(0.5, 4.0, MIXED.dimension)
    used = {
        "all": np.ones(MIXED.dimension, bool),
        "some": np.arange(MIXED.dimension) % 2 == 0,
        "numbers": ~MIXED.categorical,
        "categories": MIXED.categorical,
        "none": np.zeros(MIXED.dimension, bool),
    }[kind]
    monitor = Monitor.of(MIXED, weights * used, rows[:70], rng.random(70) < 0.3, threshold=0.1)
    risks = monitor.score(rows[60:])
    assert risks.neighbours is not None
    for place, row in enumerate(rows[60:]):
        n, k, probability = naive(monitor, row)
        assert (risks.neighbours[place], risks.probability[place]) == pytest.approx((n, probability))
        assert risks.low[place] <= k / n <= risks.high[place]


def test_blocks_do_not_change_the_scores(monkeypatch: pytest.MonkeyPatch) -> None:
    rows, unsafe = plane(300)
    monitor = Monitor.of(PLANE, (8, 2), rows, unsafe, threshold=0.5)
    asked, _ = plane(70, seed=9)
    at_once = monitor.score(asked)
    monkeypatch.setattr(neighbours, "BLOCK_PAIRS", 700)
    in_blocks = monitor.score(asked)
    assert in_blocks.probability == pytest.approx(at_once.probability)
    assert in_blocks.neighbours == pytest.approx(at_once.neighbours)


def test_interval_is_wilsons_for_integer_weights() -> None:
    rows = np.zeros((30, 2))
    unsafe = np.arange(30) < 6
    risks = Monitor.of(PLANE, (10, 10), rows, unsafe, threshold=0.1).score(np.zeros((1, 2)))
    low, high = wilson_interval(6, 30)
    assert (risks.low[0], risks.high[0]) == pytest.approx((float(low), float(high)))


def test_answer_far_from_all_simulations_is_unknown() -> None:
    rows, unsafe = np.full((50, 2), 0.01), np.ones(50, bool)
    monitor = Monitor.of(PLANE, (1000, 1000), rows, unsafe, threshold=0.5)
    near, far, nowhere = monitor.score(np.array([[0.01, 0.01], [0.02, 0.02], [1.0, 1.0]])).answers(0.5)
    assert (near, far, nowhere) == (Answer.UNSAFE, Answer.UNKNOWN, Answer.UNKNOWN)
    risk = monitor.ask({"scenario": {"x": 1.0}, "behaviour": {"y": 1.0}})
    assert (risk.low, risk.high, risk.answer) == (0.0, 1.0, Answer.UNKNOWN)
    assert risk.neighbours is not None
    assert risk.neighbours < 1e-9
    assert risk.probability == pytest.approx(1.0), "without neighbours the estimate is the overall share"


def test_uninformative_parameter_gets_a_small_weight() -> None:
    rows, unsafe = plane(500)
    monitor = Monitor.fitted(PLANE, rows, unsafe, threshold=0.5)
    of_scenario, of_behaviour = weights_of(monitor)
    assert of_scenario >= 4
    assert of_behaviour <= 0.5
    assert next(iter(monitor.informative_weights)) == "scenario.x"
    fresh, truth = plane(2000, seed=2)
    risks = monitor.score(fresh)
    assert a12(risks.probability[truth].tolist(), risks.probability[~truth].tolist()) > 0.8
    inside = (risks.low <= fresh[:, 0]) & (fresh[:, 0] <= risks.high)
    assert inside.mean() > 0.9, "intervals contain the true probability"


def test_monitor_survives_storage(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    rows = np.array([MIXED.join(MIXED.sample(rng)) for _ in range(40)])
    monitor = Monitor.of(MIXED, np.arange(MIXED.dimension), rows, rng.random(40) < 0.3, threshold=0.2)
    path = tmp_path / "monitor.json"
    path.write_text(monitor.to_json({"campaign": "3f2a"}))
    again = Monitor.load(path)
    assert json.loads(path.read_text())["about"] == {"campaign": "3f2a"}
    assert again.threshold == monitor.threshold
    assert (weights_of(again) == weights_of(monitor)).all()
    assert (again.score(rows).probability == monitor.score(rows).probability).all()
    decoded = MIXED.decode(MIXED.split(rows[3]))
    assert again.ask(decoded) == monitor.ask(decoded)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "expected a monitor"),
        ("[]", "format 'brink-monitor'"),
        ('{"format": "brink-monitor", "version": 1}', "expected version 4, got 1: fit the monitor again"),
        ('{"format": "brink-monitor", "version": 4}', "expected a monitor: KeyError"),
    ],
)
def test_invalid_monitors_are_rejected(text: str, said: str) -> None:
    with pytest.raises(DocumentError, match=said):
        Monitor.from_json(text)


def test_pairs_count_as_right_if_both_sides_are() -> None:
    rows = np.array([[0.1, 0.5], [0.9, 0.5]])
    monitor = Monitor.of(PLANE, (50, 0), np.repeat(rows, 40, axis=0), np.arange(80) >= 40, threshold=0.1)
    safe, unsafe = (
        np.array([[0.1, 0.0], [0.12, 0.0], [0.9, 0.0]]),
        np.array([[0.9, 0.0], [0.14, 0.0], [0.1, 0.0]]),
    )
    found = evaluate_pairs(monitor, safe, unsafe)
    assert (found.pairs, found.both_right, found.ranked) == (3, 1, 2)
    expected = monitor.score(unsafe).probability - monitor.score(safe).probability
    assert found.difference == pytest.approx(expected.mean())
    with pytest.raises(ValueError, match="got 3 safe and 0 unsafe"):
        evaluate_pairs(monitor, safe, unsafe[:0])


def test_invalid_questions_are_rejected() -> None:
    rows, unsafe = plane(20)
    monitor = Monitor.of(PLANE, (10, 10), rows, unsafe, threshold=0.1)
    with pytest.raises(SpaceError, match="x: expected a number in"):
        monitor.ask({"scenario": {"x": 7}, "behaviour": {"y": 0.5}})
    with pytest.raises(SpaceError, match="behaviour: missing component"):
        monitor.ask({"scenario": {"x": 0.7}})
    with pytest.raises(SpaceError, match="rows of 2 numbers"):
        monitor.score(np.zeros((3, 3)))
    with pytest.raises(ValueError, match="at least two"):
        Monitor.fitted(PLANE, rows[:1], unsafe[:1], threshold=0.1)
    with pytest.raises(ValueError, match="weights >= 0"):
        Monitor.of(PLANE, (0.1, -1.0), rows, unsafe, threshold=0.1)
    with pytest.raises(ValueError, match=r"probability in \(0, 1\)"):
        Monitor.of(PLANE, (10, 10), rows, unsafe, threshold=1.0)


def test_json_of_an_evaluation_keeps_the_published_field_names() -> None:
    rows, unsafe = plane(200)
    fresh, truth = plane(300, seed=2)
    found = evaluate_monitor(Monitor.of(PLANE, (8, 0), rows, unsafe, threshold=0.5), fresh, truth).to_json()
    assert list(found) == [
        "model",
        "learned",
        "fresh",
        "threshold",
        "witnesses",
        "answers",
        "unlike",
        "left_out",
        "pairs",
    ]
    witness = json.loads(json.dumps(found))["witnesses"][0]
    assert list(witness) == ["name", "judgement", "alarms"]
    assert list(witness["judgement"]) == [
        "solutions",
        "unsafe",
        "auroc",
        "brier",
        "bins",
        "calibration_error",
    ]
    assert list(witness["judgement"]["bins"][0]) == [
        "solutions",
        "foretold",
        "low",
        "high",
        "observed",
        "observed_low",
        "observed_high",
    ]
    assert list(witness["alarms"][0]) == ["probability", "missed", "false"]
    assert [list(one) for one in found["answers"]] == [["answer", "solutions", "unsafe"]] * 3
    assert [one["answer"] for one in found["answers"]] == ["safe", "unsafe", "unknown"]
