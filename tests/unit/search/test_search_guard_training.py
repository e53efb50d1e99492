"""Training of a guard: what is learned, division by group, and the trees that are exported."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from brink.forest import Forest
from brink.search.analysis import guard_training
from brink.search.analysis.boosted_trees import forest_of
from brink.search.analysis.guard_training import (
    BINS,
    FOLDS,
    THIN,
    DriveSeries,
    _Bins,
    _divisions,
    _Steps,
    fit_horizons,
)
from brink.search.errors import MissingExtra
from brink.search.space import FloatArray

HORIZONS_S = (1.0, 2.0)


@pytest.fixture(autouse=True)
def small_forests(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard_training, "TREES", 15)
    monkeypatch.setattr(guard_training, "LEAST_STEPS_OF_A_LEAF", 10)


def series(
    number: int, *, violated: bool, scenario: int | None = None, behaviour: int | None = None
) -> DriveSeries:
    """Return a drive of six seconds whose first feature is a noisy time to the violation."""
    rng = np.random.default_rng([7, number])
    until_s: FloatArray = 5.95 - 0.1 * np.arange(60, dtype=np.float64) if violated else np.full(60, np.inf)
    seen = np.minimum(until_s, 6.0) + rng.normal(0.0, 0.3, 60)
    features = np.stack([seen, rng.normal(size=60)], axis=1).astype(np.float16)
    return DriveSeries(
        features=features,
        until_s=until_s,
        scenario=number if scenario is None else scenario,
        behaviour=behaviour,
    )


def drives(safe: int = 40, unsafe: int = 20) -> list[DriveSeries]:
    return [series(number, violated=number < unsafe) for number in range(safe + unsafe)]


def test_probabilities_rise_towards_the_violation_and_the_trees_are_those_of_scikit_learn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fitted_models: list[Any] = []

    def kept(models: Sequence[Any], features: int) -> Forest:
        fitted_models.extend(models)
        return forest_of(models, features)

    monkeypatch.setattr(guard_training, "forest_of", kept)
    progress: list[tuple[int, int]] = []
    fitted = fit_horizons(drives(), HORIZONS_S, np.random.default_rng(1), lambda *done: progress.append(done))
    rows = np.concatenate([one.features for one in drives()]).astype(np.float32)
    bins = _Steps.of(drives(), max(HORIZONS_S)).bins
    expected = np.stack([model.decision_function(bins.indices(rows)) for model in fitted_models], axis=1)
    assert fitted.forest.scores(rows) == pytest.approx(expected, abs=1e-9)
    assert progress[-1] == (len(HORIZONS_S) * (FOLDS + 1),) * 2

    scores = fitted.forest.scores(np.array([[0.5, 0.0], [1.5, 0.0], [5.0, 0.0]], np.float32))
    log_odds = fitted.calibration[:, 0] + fitted.calibration[:, 1] * scores
    assert log_odds[0, 0] > 1.0 > -2.0 > log_odds[2, 0]
    assert log_odds[1, 1] > 0.5 > log_odds[1, 0], "1.5 s ahead is within two seconds, but not within one"
    unsafe, safe = fitted.unseen[0], fitted.unseen[-1]
    assert unsafe.shape == safe.shape == (60, 2)
    assert unsafe[-5:].mean() > safe.max()


def test_the_same_drives_and_seed_give_the_same_guard() -> None:
    first, second = (fit_horizons(drives(), HORIZONS_S, np.random.default_rng(1)) for _ in range(2))
    assert first.forest.to_document() == second.forest.to_document()
    assert (first.calibration == second.calibration).all()


def test_connected_drives_are_never_divided_and_violations_are_spread_evenly() -> None:
    """Each scenario has three drives, and one behaviour of each joins it to the next one."""
    given = [
        series(
            number,
            violated=number % 3 == 0,
            scenario=number // 3,
            behaviour=number // 6 if number % 3 == 1 else None,
        )
        for number in range(120)
    ]
    *divisions, last = _divisions(given, np.random.default_rng(1))
    assert len(divisions) == FOLDS
    assert last.fitted.all()
    assert not last.scored.any()
    scored = np.array([one.scored for one in divisions])
    assert (scored.sum(axis=0) == 1).all()
    assert scored.sum(axis=1).min() >= 36
    for division in divisions:
        assert (division.fitted == ~division.scored).all()
        assert len({*(division.scored.reshape(20, 6).sum(axis=1).tolist())}) == 2


def test_no_model_scores_a_scenario_or_a_behaviour_that_it_has_seen() -> None:
    """As in MLCSHE, every behaviour is joined with several scenarios, so all drives are connected."""
    rng = np.random.default_rng(3)
    given = [
        series(
            number, violated=number % 3 == 0, scenario=int(rng.integers(30)), behaviour=int(rng.integers(30))
        )
        for number in range(240)
    ]
    *divisions, last = _divisions(given, np.random.default_rng(1))
    assert last.fitted.all()
    assert len(divisions) == FOLDS**2
    assert (np.sum([one.scored for one in divisions], axis=0) == 1).all(), "every drive is scored once"
    for division in divisions:
        seen = [given[place] for place in np.flatnonzero(division.fitted)]
        for place in np.flatnonzero(division.scored):
            assert given[place].scenario not in {one.scenario for one in seen}
            assert given[place].behaviour not in {one.behaviour for one in seen}


def test_an_odd_with_a_single_scenario_or_behaviour_leaves_the_other_one_to_divide() -> None:
    for fixed in ("scenario", "behaviour"):
        given = [
            series(number, violated=number < 30, **{"scenario": number, "behaviour": number, fixed: 0})
            for number in range(90)
        ]
        assert len(_divisions(given, np.random.default_rng(1))) == FOLDS + 1


def test_steps_far_from_a_violation_are_thinned_and_stand_for_those_left_out() -> None:
    given = [series(0, violated=True), series(1, violated=False)]
    steps = _Steps.of(given, 2.0)
    near = steps.until_s <= 3.0
    assert near.sum() == 30
    assert (steps.weight[near] == 1).all()
    assert (steps.weight[~near] == THIN).all()
    assert steps.weight[steps.drive == 1].sum() == pytest.approx(60, abs=THIN)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (drives(safe=40, unsafe=9), "at least 10 drives"),
        (drives(safe=3, unsafe=20), "got 20 and 3"),
        (
            [series(n, violated=n < 20, scenario=n % 2, behaviour=n % 2) for n in range(60)],
            "got 2 scenarios and 2 beh",
        ),
    ],
)
def test_too_few_drives_are_refused(given: list[DriveSeries], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        fit_horizons(given, HORIZONS_S, np.random.default_rng(1))


def test_bins_have_the_edges_of_scikit_learn() -> None:
    from sklearn.ensemble._hist_gradient_boosting.binning import _BinMapper

    rng = np.random.default_rng(5)
    features = np.stack([rng.normal(size=2000), rng.integers(0, 9, 2000)], axis=1).astype(np.float32)
    weight = rng.choice([1.0, 5.0], 2000)
    mapper = _BinMapper(n_bins=BINS + 1).fit(features.astype(np.float64), sample_weight=weight)
    for own, expected in zip(_Bins.of(features, weight).edges, mapper.bin_thresholds_, strict=True):
        assert own == pytest.approx(expected, abs=1e-6)


def test_trees_are_fitted_in_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """A limit set before scikit-learn is imported does not reach its OpenMP, whose threads wait busily."""
    loaded: list[bool] = []

    @contextmanager
    def limits(*, limits: int) -> Iterator[None]:
        loaded.append("sklearn.ensemble" in sys.modules and limits == 1)
        yield

    monkeypatch.delitem(sys.modules, "sklearn.ensemble", raising=False)
    monkeypatch.setattr("threadpoolctl.threadpool_limits", limits)
    fit_horizons(drives(), HORIZONS_S, np.random.default_rng(1))
    assert loaded == [True]


def test_without_scikit_learn_the_command_that_installs_it_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard_training, "is_installed", lambda: False)
    with pytest.raises(MissingExtra, match="analysis"):
        fit_horizons(drives(), HORIZONS_S, np.random.default_rng(1))
