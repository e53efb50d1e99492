"""Studies: the same search as a campaign, told its results by somebody else."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from brink import Study, Trial
from brink.search.errors import DocumentError, OrderError, SpaceError, UnsupportedSpace
from brink.server.errors import InvalidInput

pytestmark = pytest.mark.usefixtures("fewer_trees")
SPACE = {"x": (0.0, 1.0), "y": (0.0, 1.0)}
SHARP = {"checks": 0, "margin": 0.0, "eps": 0.005, "d_th": 0.05}

EACH = ["random@1", "ga@1", "edge@2"]
"""A search of each kind; contract tests store all of them, and tell them results in other orders."""


def outside(trial: Trial) -> float:
    return float(np.hypot(trial.values["x"] - 0.5, trial.values["y"] - 0.5)) - 0.3


def finished(study: Study) -> Study:
    while trials := study.ask():
        for trial in trials:
            study.tell(trial, outside(trial))
    return study


@cache
def undisturbed(algorithm: str) -> Study:
    """Return a study that is neither stored nor told its results in another order."""
    return finished(Study(SPACE, algorithm, simulations=90))


def test_a_study_finds_pairs_on_a_known_boundary() -> None:
    study = finished(Study(SPACE, simulations=250, params=SHARP))
    assert len(study.to_pandas()) == 250
    pairs = study.pairs(eps=0.005, d_th=0.05)
    assert len(pairs) >= 8
    assert (pairs["safe.robustness"] >= 0).all()
    assert (pairs["unsafe.robustness"] < 0).all()
    none = Study(SPACE, simulations=250).pairs()
    assert none.dtypes.to_dict() == pairs.dtypes.to_dict()
    radius = np.hypot(pairs["safe.x"] - 0.5, pairs["safe.y"] - 0.5)
    assert np.abs(radius - 0.3).max() < 0.01


@pytest.mark.parametrize("algorithm", EACH)
@given(order=st.randoms(use_true_random=False))
@settings(max_examples=5, deadline=None)
def test_the_order_of_results_does_not_matter(algorithm: str, order: object) -> None:
    study = Study(SPACE, algorithm, simulations=90)
    while trials := study.ask():
        order.shuffle(trials)  # type: ignore[attr-defined]
        for trial in trials:
            study.tell(trial, outside(trial))
    assert study.to_pandas().equals(undisturbed(algorithm).to_pandas())


@pytest.mark.parametrize("algorithm", EACH)
@pytest.mark.parametrize("told", [0, 7, 61])
def test_a_saved_study_goes_on_where_it_was(algorithm: str, told: int, tmp_path: Path) -> None:
    study = Study(SPACE, algorithm, simulations=90)
    count = 0
    while count < told:
        for trial in study.ask():
            if count < told:
                study.tell(trial, outside(trial))
                count += 1
    loaded = Study.load(study.save(tmp_path / "study.json"))
    for trial in loaded.open:
        loaded.tell(trial, outside(trial))
    assert finished(loaded).to_pandas().equals(undisturbed(algorithm).to_pandas())


def test_trials_are_told_once_and_only_if_asked_for() -> None:
    study = Study(SPACE, "ga@1", simulations=120)
    trials = study.ask()
    study.tell(trials[0], 1.0)
    with pytest.raises(OrderError, match="told already"):
        study.tell(trials[0], 1.0)
    with pytest.raises(OrderError, match="not asked for"):
        study.tell(5_000, 1.0)
    with pytest.raises(OrderError, match=rf"tell the results of {len(trials) - 1} trials first: 1, 2, 3"):
        study.ask()
    assert [trial.number for trial in study.open] == [trial.number for trial in trials[1:]]


def test_failed_trials_are_neither_safe_nor_unsafe() -> None:
    study = Study(SPACE, "random@1", simulations=30)
    while trials := study.ask():
        for trial in trials:
            study.tell(trial, None if trial.number % 3 == 0 else outside(trial))
    assert study.finished
    assert len(study.to_pandas()) == 20


def test_a_result_that_is_no_number_is_refused() -> None:
    study = Study(SPACE, "random@1", simulations=30)
    trial = study.ask()[0]
    with pytest.raises(ValueError, match="expected a finite robustness"):
        study.tell(trial, float("nan"))
    study.tell(trial, 0.0)


def test_components_and_equal_names_are_kept_apart() -> None:
    space = {"scenario": {"speed": (0.0, 9.0)}, "behaviour": {"speed": range(5), "kind": ["a", "b"]}}
    (trial, *_) = Study(space, "random@1", simulations=10).ask()
    assert list(trial.values) == ["scenario.speed", "behaviour.speed", "behaviour.kind"]
    assert trial.values["behaviour.speed"] in range(5)


def test_what_cannot_be_searched_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="unknown algorithm"):
        Study(SPACE, "gradient@1")
    with pytest.raises(InvalidInput, match="radius"):
        Study(SPACE, "random@1", params={"radius": 7})
    with pytest.raises(UnsupportedSpace, match="two components"):
        Study(SPACE, "mlcshe@1")
    with pytest.raises(SpaceError, match="expected a range such as"):
        Study({"x": "wide"})
    path = tmp_path / "study.json"
    path.write_text("{}", encoding="utf-8")
    with pytest.raises(DocumentError, match="expected a saved study"):
        Study.load(path)
    with pytest.raises(UnsupportedSpace, match="needs measures, which a study cannot give"):
        Study(SPACE, "qd@1")


@pytest.mark.parametrize("algorithm", ["random@1", "edge@1", "edge@2"])
def test_a_study_starts_from_known_results(algorithm: str, tmp_path: Path) -> None:
    known = finished(Study(SPACE, "random@1", simulations=120)).to_pandas()
    study = Study(SPACE, algorithm, simulations=60, start_from=known)
    again = Study.load(study.save(tmp_path / "study.json"))
    assert again.ask() == study.ask()
    for trial in again.open:
        again.tell(trial, outside(trial))
    frame = finished(again).to_pandas()
    assert len(frame) == 60
    seen = set(map(tuple, known[["x", "y"]].to_numpy().tolist()))
    repeated = seen.intersection(map(tuple, frame[["x", "y"]].to_numpy().tolist()))
    if algorithm == "random@1":  # the same seed: without what is known, it would draw the same
        assert not repeated


def test_points_without_a_result_come_first() -> None:
    points = finished(Study(SPACE, "random@1", simulations=10)).to_pandas()[["x", "y"]]
    asked = Study(SPACE, "random@1", simulations=60, seed=2, start_from=points).ask()
    shown = [[trial.values["x"], trial.values["y"]] for trial in asked[:10]]
    assert shown == points.to_numpy().tolist()


def test_known_points_that_do_not_fit_are_refused() -> None:
    known = finished(Study(SPACE, "random@1", simulations=10)).to_pandas()
    with pytest.raises(InvalidInput, match=r"missing parameters\.y"):
        Study(SPACE, "random@1", start_from=known[["x"]])
    with pytest.raises(InvalidInput, match=r"row 1: expected a value of parameters\.x, got none"):
        Study(SPACE, "random@1", start_from=known.assign(x=[0.5, *[float("nan")] * 9]))
    with pytest.raises(InvalidInput, match="a study knows no campaigns"):
        Study(SPACE, "random@1", start_from={"campaign": "3f2a"})
    with pytest.raises(UnsupportedSpace, match="cannot start from what is known"):
        Study(SPACE, "repeat@1", params={"solutions": [[0.1, 0.1]]}, start_from=known)
