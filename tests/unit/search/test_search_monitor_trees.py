"""Monitors with trees: accuracy, symmetry, files, and which solutions are unlike anything simulated."""

import json
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from brink.search.analysis import boosted_trees
from brink.search.analysis.choices import Model
from brink.search.analysis.coverage import Coverage
from brink.search.analysis.monitor import Answer, Monitor, default_model
from brink.search.analysis.monitor_evaluation import classification_metrics, evaluate_monitor
from brink.search.errors import DocumentError, MissingExtra
from brink.search.features import Features
from brink.search.space import BoolArray, Categorical, Component, Extent, FloatArray, Real, SearchSpace


def boxes() -> SearchSpace:
    """Return a space of a weather and two interchangeable boxes."""
    parameters: list[Categorical | Real] = [Categorical("weather", ("dry", "wet", "fog"))]
    for i in (1, 2):
        parameters += [Real(f"left_{i}", 0.0, 10.0, "px"), Real(f"right_{i}", 0.0, 10.0, "px")]
    return SearchSpace(
        (
            Component(
                "scene",
                tuple(parameters),
                tuple(Extent(f"left_{i}", f"right_{i}", 1.0, 10.0) for i in (1, 2)),
                interchangeable=tuple((f"left_{i}", f"right_{i}") for i in (1, 2)),
            ),
        )
    )


BOXES = boxes()
SWAPPED = [0, 3, 4, 1, 2]


def drawn(count: int, seed: int) -> tuple[FloatArray, BoolArray]:
    """Return solutions that are unsafe if a box covers the middle, except that chance flips one verdict in ten."""
    rng = np.random.default_rng(seed)
    rows = np.array([BOXES.join(BOXES.sample(rng)) for _ in range(count)])
    covered = ((rows[:, [1, 3]] < 5) & (rows[:, [2, 4]] > 5)).any(axis=1) & (rows[:, 0] != 2)
    return rows, covered ^ (rng.random(count) < 0.1)


@pytest.fixture(scope="module")
def monitor() -> Monitor:
    return Monitor.fitted(BOXES, *drawn(300, 1), threshold=0.3, model=Model.TREES)


def test_trees_are_accurate_and_calibrated_on_fresh_solutions(monitor: Monitor) -> None:
    rows, unsafe = drawn(1_000, 2)
    risks = monitor.score(rows)
    found = classification_metrics(risks.probability, unsafe, risks.low, risks.high)
    assert found.auroc > 0.87
    assert found.brier < 0.12, "0.09 is the least that chance allows"
    assert found.calibration_error < 0.1
    assert ((risks.low <= risks.probability) & (risks.probability <= risks.high)).all()
    assert sum(one.within for one in found.bins) >= 9
    answers = np.array(risks.answers(0.3))
    assert unsafe[answers == Answer.SAFE].mean() < 0.3 < unsafe[answers == Answer.UNSAFE].mean()


def test_order_of_interchangeable_parts_does_not_matter(monitor: Monitor) -> None:
    rows, _ = drawn(50, 3)
    one, other = monitor.score(rows), monitor.score(rows[:, SWAPPED])
    assert one.probability == pytest.approx(other.probability)
    assert (one.nearest == other.nearest).all()


def test_verdicts_by_chance_get_their_share_everywhere() -> None:
    rows, _ = drawn(250, 4)
    unsafe = np.random.default_rng(5).random(250) < 0.3
    risks = Monitor.fitted(BOXES, rows, unsafe, threshold=0.5, model=Model.TREES).score(drawn(200, 6)[0])
    assert np.abs(risks.probability - unsafe.mean()).max() < 0.15
    assert ((risks.low <= 0.3) & (risks.high >= 0.3)).mean() > 0.9


def test_stored_trees_predict_the_same_without_scikit_learn(
    monitor: Monitor, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = monitor.to_json({"campaigns": ["3f2a"]})
    monkeypatch.setitem(sys.modules, "sklearn", None)
    again = Monitor.from_json(text)
    rows, _ = drawn(40, 7)
    before, after = monitor.score(rows), again.score(rows)
    for name in ("probability", "low", "high", "nearest"):
        assert (getattr(before, name) == getattr(after, name)).all()
    assert again.model is Model.TREES
    assert after.neighbours is None
    assert after.unlike == before.unlike
    risk = again.ask(BOXES.decode(BOXES.split(rows[0])))
    assert risk.probability == before.probability[0]


def test_same_seed_gives_the_same_trees() -> None:
    one, other = (Monitor.fitted(BOXES, *drawn(60, 1), threshold=0.3, model=Model.TREES) for _ in range(2))
    assert one.to_json() == other.to_json()


def test_missing_scikit_learn_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    rows, unsafe = drawn(60, 1)
    assert default_model(unsafe) is Model.TREES
    monkeypatch.setattr(boosted_trees, "find_spec", lambda name: None)
    with pytest.raises(
        MissingExtra, match=r"scikit-learn, which is not installed: .* -m pip install .*\[analysis\]"
    ):
        Monitor.fitted(BOXES, rows, unsafe, threshold=0.3, model=Model.TREES)
    assert default_model(unsafe) is Model.NEIGHBOURS
    found = evaluate_monitor(Monitor.of(BOXES, np.ones(5), rows, unsafe, threshold=0.3), *drawn(60, 2))
    assert "scikit-learn" in found.left_out["gradient-boosted trees"]


def test_too_few_solutions_are_refused() -> None:
    rows, unsafe = drawn(100, 1)
    few = np.flatnonzero(unsafe)[:9]
    chosen = np.concatenate([np.flatnonzero(~unsafe), few])
    with pytest.raises(
        ValueError, match=r"at least 10 safe and 10 unsafe solutions for trees, got \d+ and 9"
    ):
        Monitor.fitted(BOXES, rows[chosen], unsafe[chosen], threshold=0.3, model=Model.TREES)
    assert default_model(unsafe[chosen]) is Model.NEIGHBOURS
    same = np.repeat(rows[:2], 50, axis=0)
    with pytest.raises(ValueError, match="got 2 unlike each other"):
        Monitor.fitted(BOXES, same, np.arange(100) % 2 == 0, threshold=0.3, model=Model.TREES)


def test_what_near_duplicates_tell_about_each_other_is_not_taken_for_accuracy() -> None:
    """Four nearly equal solutions have the same verdict, which is chance: nothing is known about fresh ones."""
    rows, _ = drawn(150, 1)
    verdicts = np.random.default_rng(2).random(150) < 0.4
    copies = np.repeat(rows, 4, axis=0)
    copies[:, 1:] += np.random.default_rng(3).uniform(-1e-4, 1e-4, (600, 4))
    fitted = Monitor.fitted(BOXES, copies, np.repeat(verdicts, 4), threshold=0.5, model=Model.TREES)
    risks = fitted.score(drawn(500, 4)[0])
    assert np.abs(risks.probability - verdicts.mean()).max() < 0.2
    assert ((risks.low <= 0.4) & (risks.high >= 0.4)).mean() > 0.9


def spoilt(change: Callable[[Any], object]) -> Callable[[Any], None]:
    def spoil(document: Any) -> None:
        change(document["model"]["forest"])

    return spoil


@pytest.mark.parametrize(
    "spoil",
    [
        spoilt(lambda forest: forest["right"].__setitem__(0, 1)),  # the left child twice
        spoilt(
            lambda forest: forest["right"].__setitem__(forest["roots"][3], forest["roots"][4])
        ),  # another tree
        spoilt(lambda forest: forest["right"].__setitem__(0, -1)),
        spoilt(lambda forest: forest["feature"].__setitem__(0, 99)),
        spoilt(lambda forest: forest["value"].pop()),
        spoilt(lambda forest: forest["value"].__setitem__(0, "x")),
        spoilt(lambda forest: forest["roots"].reverse()),
        spoilt(lambda forest: forest["roots"].clear()),
        spoilt(lambda forest: forest["owners"].__setitem__(0, 5)),
        spoilt(lambda forest: forest["offsets"].pop()),
        spoilt(lambda forest: forest.pop("right")),
        lambda document: document["model"].update(calibration=[0.0, -1.0]),
        lambda document: document["model"].update(covariance=[[-1.0, 0.0], [0.0, 1.0]]),
        lambda document: document["model"].update(covariance=[1.0]),
        lambda document: document["model"].update(inflation=0.0),
        lambda document: document["model"].update(name="pickle"),
        lambda document: document.update(orders=[[0, 1, 2]]),
        lambda document: document.update(ties=[[0, 1]]),
        lambda document: document.pop("ties"),
    ],
)
def test_corrupt_trees_are_rejected(monitor: Monitor, spoil: Callable[[Any], None]) -> None:
    document = json.loads(monitor.to_json())
    spoil(document)
    with pytest.raises(DocumentError, match="expected a monitor"):
        Monitor.from_json(json.dumps(document))


def test_random_solutions_are_like_random_solutions() -> None:
    rows, _ = drawn(400, 1)
    coverage = Coverage.of(BOXES, rows, Features.of_space(BOXES).orders)
    fresh, _ = drawn(1_000, 2)
    unlike = coverage.reasons(fresh, coverage.nearest(fresh))
    assert sum(map(bool, unlike)) < 40
    assert coverage.reasons(rows, coverage.nearest(rows)) == ("",) * 400
    assert (coverage.nearest(rows) == 0).all()


def test_unlike_solutions_are_named_with_the_reason() -> None:
    rows, unsafe = drawn(400, 1)
    near = (rows[:, 0] != 2) & (rows[:, 1:] < 7).all(axis=1)
    monitor = Monitor.of(BOXES, np.zeros(5), rows[near], unsafe[near], threshold=0.99)
    like = {"weather": "wet", "left_1": 1.0, "right_1": 3.0, "left_2": 2.0, "right_2": 5.0}
    risk = monitor.ask({"scene": like})
    assert (risk.unlike, risk.answer) == ("", Answer.SAFE)
    foggy = monitor.ask({"scene": like | {"weather": "fog"}})
    assert "scene.weather fog was never simulated" in foggy.unlike
    assert foggy.answer is Answer.UNKNOWN
    wide = monitor.ask({"scene": like | {"right_2": 9.5}})
    assert wide.unlike.startswith("scene.right_2 is far from every simulated value, the closest being 6.9")
    apart = monitor.ask({"scene": like | {"left_1": 5.9, "right_1": 6.95, "left_2": 5.8, "right_2": 6.9}})
    if apart.unlike:
        assert apart.unlike.startswith("the nearest simulated solution is")


def test_solutions_between_two_clusters_are_unlike_both() -> None:
    space = SearchSpace((Component("plane", (Real("x", 0, 1), Real("y", 0, 1))),))
    corner = np.random.default_rng(1).random((200, 2)) * 0.2
    rows = np.concatenate([corner, 1 - corner])
    coverage = Coverage.of(space, rows, np.arange(2)[None])
    asked = np.array([[0.1, 0.1], [0.9, 0.9], [0.5, 0.1], [0.1, 0.9]])
    reasons = coverage.reasons(asked, coverage.nearest(asked))
    assert [bool(one) for one in reasons] == [False, False, True, True]
    assert reasons[2].startswith("plane.x is far from every simulated value")
    assert reasons[3].startswith("the nearest simulated solution is")
