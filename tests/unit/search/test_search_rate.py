"""`rate@1`, and what is said of its draws."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from brink.search.algorithm import Candidate, Draws, Evaluation, Failed, Known, Scored
from brink.search.algorithms.random_search import RandomSearch, RandomSearchConfig
from brink.search.algorithms.rate import Column, Rarity, Rate, RateConfig, _drawn
from brink.search.analysis.rate import claim_of, looks, rate_of, ratio_of, replicated_rate, strata_of
from brink.search.conclusions import Decision
from brink.search.distribution import distributed
from brink.search.document import Document
from brink.search.errors import ConfigError
from brink.search.sequential import exact_interval
from brink.search.space import BoolArray, Categorical, Component, FloatArray, Real, SearchSpace
from brink.search.streams import generator
from brink.search.testing import Run, check_algorithm, play

SPACE = SearchSpace(
    (
        Component(
            "scenario", (Real("x", 0.0, 1.0), Real("y", 0.0, 1.0), Categorical("time", ("day", "night")))
        ),
    )
)
pytestmark = pytest.mark.usefixtures("few_trees")
HOT, COLD = 0.6, 0.004
P = 0.16 * HOT + 0.84 * COLD
SMALL = RateConfig(pool=10, generation_size=40, in_flight=2)


def half_random(seed: int) -> Callable[[Candidate], Evaluation]:
    """Return random verdicts: often unsafe in one corner of the space, rarely elsewhere."""

    def evaluate(candidate: Candidate) -> Scored:
        x, y, _ = candidate.vectors[0]
        risk = HOT if x > 0.6 and y > 0.6 else COLD
        unsafe = bool(generator(seed, 1_000, candidate.number).random() < risk)
        return Scored(unsafe=unsafe, robustness=-1.0 if unsafe else 1.0)

    return evaluate


def draws_of(algorithm: Rate | RandomSearch, run: Run) -> Draws:
    return algorithm.draws(Document.from_bytes(run.documents[-1]), run.archive)


class Lying:
    """A surrogate that is certain of the wrong corner."""

    size = 100

    def unsafe(self, rows: FloatArray) -> FloatArray:
        return np.where(rows[:, 0] < 0.3, 1.0, 0.0)


@pytest.mark.parametrize(
    "space", [SPACE, distributed(SPACE, {"scenario.time": {"weights": {"day": 9, "night": 1}}})]
)
@pytest.mark.parametrize("surrogate", [None, Lying()], ids=["first part", "wrong surrogate"])
def test_weighted_draws_have_the_expectations_of_operation(
    space: SearchSpace, surrogate: Lying | None
) -> None:
    algorithm, rng = Rate(), np.random.default_rng(1)
    state = algorithm.start(space, RateConfig(pool=8), seed=1, budget=10_000)
    lying: Any = surrogate
    rows, drawn = _drawn(state, 1500, lying, rng)
    alpha = drawn[:, Column.ALPHA]
    weights = 1 / (alpha + (1 - alpha) * drawn[:, Column.RATIO])
    assert (weights <= 1 / alpha + 1e-12).all()
    x, night = np.array(rows)[:, 0], np.array(rows)[:, 2] == 1
    for values, expected in (
        (np.ones(len(x)), 1.0),
        (x, 0.5),
        ((x < 0.3) * 1.0, 0.3),
        (night * 1.0, 0.1 if space.distribution else 0.5),
    ):
        terms = weights * values
        assert abs(terms.mean() - expected) < 4 * terms.std() / len(x) ** 0.5 + 1e-12
    if surrogate is not None:  # a control variate has the expectation 0 even if it is wrong
        base = drawn[:, Column.POOL] - weights * drawn[:, Column.PREDICTED]
        assert abs(base.mean()) < 4 * base.std() / len(x) ** 0.5
        assert (drawn[:, Column.LAMBDA] > 0).all()
        assert base.min() >= -1
    if space.distribution and surrogate is None:
        assert night.mean() > 0.13  # a rare choice gets more than its share


def test_rate_is_covered_and_its_simulations_are_spent_where_it_is_unsafe() -> None:
    missed, unsafe, effective = 0, 0, 0.0
    for seed in range(5):
        run = play(Rate(), SPACE, SMALL, half_random(seed), seed=seed, budget=480)
        found = rate_of(draws_of(Rate(), run), 0.95)
        missed += not found.interval[0] <= P <= found.interval[1]
        unsafe += found.unsafe
        effective += found.effective
    assert missed == 0
    assert unsafe > 1.25 * P * 5 * 480
    assert effective > 1.1 * 5 * 480


@pytest.mark.parametrize(
    ("at_most", "decision"), [(0.3, Decision.SHOWN), (0.03, Decision.REFUTED), (0.17, Decision.NOT_SHOWN)]
)
def test_search_ends_when_its_claim_is_decided(at_most: float, decision: Decision) -> None:
    config = replace(SMALL, claim={"at_most": at_most}, generation_size=20)
    run = check_algorithm(
        Rate(), SPACE, budget=300, config=config, evaluate=half_random(1), repeats=True, ends_itself=True
    )
    told = claim_of(draws_of(Rate(), run), at_most, 0.95)
    assert told.decision is decision
    assert told.high >= told.low
    if decision is Decision.NOT_SHOWN:
        assert len(run.candidates) == 300
        assert told.more is not None
        assert told.more > 0
    else:
        assert told.after <= len(run.candidates) <= told.after + 3 * 20


def test_what_was_known_teaches_the_surrogate_and_stays_out_of_the_estimate() -> None:
    rng = np.random.default_rng(3)
    rows = np.array([SPACE.join(SPACE.sample(rng)) for _ in range(200)])
    unsafe = (rows[:, 0] > 0.6) & (rows[:, 1] > 0.6)
    known = Known(
        rows=rows, unsafe=unsafe, robustness=np.where(unsafe, -1.0, 1.0), points=rows[:3] * [0.5, 0.5, 1.0]
    )
    config = replace(SMALL, first=0.1)
    run = check_algorithm(
        Rate(), SPACE, budget=200, config=config, evaluate=half_random(2), repeats=True, known=known
    )
    draws = draws_of(Rate(), run)
    assert draws.numbers.tolist() == list(range(3, 200))
    assert (draws.bounds[40:] > 1).any()


def test_plain_draws_have_the_exact_interval_and_failures_widen_it_on_both_sides() -> None:
    evaluate = half_random(4)
    failing = {5, 17, 30}

    def some(candidate: Candidate) -> Evaluation:
        return Failed(reason="crashed") if candidate.number in failing else evaluate(candidate)

    for algorithm, config in (
        (Rate(), replace(SMALL, pool=1)),
        (RandomSearch(), RandomSearchConfig(in_flight=2)),
    ):
        run = play(algorithm, SPACE, config, some, seed=1, budget=150)
        found = rate_of(draws_of(algorithm, run), 0.9)
        assert (found.simulations, found.failed) == (150, 3)
        low, high = exact_interval(found.unsafe, 150, 0.9)[0], exact_interval(found.unsafe + 3, 150, 0.9)[1]
        assert found.fixed == pytest.approx((low, high))
        assert found.rate == found.unsafe / 147
    series = looks(draws_of(algorithm, run), 0.9)
    assert series[-1].simulations == 150
    assert (series[-1].low, series[-1].high) == found.interval


def test_strata_add_up_and_ratios_weigh_what_is_driven() -> None:
    draws = Draws.plain(
        np.arange(6),
        weights=np.array([1.0, 2.0, 0.5, 0.5, 1.0, 1.0]),
        bounds=np.full(6, 2.0),
        unsafe=np.array([True, False, True, False, True, False]),
        failed=np.array([False, False, False, False, False, True]),
    )
    inside: BoolArray = np.array([True, True, False, False, False, True])
    one, other = strata_of(draws, {"day": inside, "night": ~inside}, 0.95)
    assert (one.share, other.share) == (3 / 5, 2 / 5)
    assert (one.part, other.part) == (0.4, 0.6)
    assert one.rate is not None
    assert one.rate.value == pytest.approx(1 / 3)
    assert one.rate.low <= 1 / 3 <= one.rate.high
    per = ratio_of(draws, np.array([10.0, 10.0, 20.0, np.nan, 10.0, 10.0]), 0.95)
    assert per is not None
    assert per.value == pytest.approx(2.5 / 50)


def test_rarity_is_the_inverse_of_the_frequency_of_choices() -> None:
    space = distributed(SPACE, {"scenario.time": {"weights": {"day": 19, "night": 1}}})
    rarity = Rarity.of(space, seed=1)
    assert rarity is not None
    day, night = rarity.importance(np.array([[0.1, 0.2, 0.0], [0.1, 0.2, 1.0]])).tolist()
    assert 0.95 * day + 0.05 * night == pytest.approx(1.0, abs=0.15)
    assert night > 5 * day
    assert Rarity.of(SPACE, seed=1) is None


@pytest.mark.parametrize(
    "claim", [{"at_most": 0}, {"confidence": 0.9}, {"at_most": 0.1, "sure": 1}, {"at_most": True}]
)
def test_wrong_claims_are_refused(claim: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match="claim"):
        RateConfig(claim=claim)


def test_uncertainty_of_a_fit_widens_the_interval_only_if_replicates_differ() -> None:
    rng = np.random.default_rng(5)
    replicates = np.repeat(np.arange(20.0), 100)
    alike, apart = np.full(20, 0.1), np.linspace(0.02, 0.18, 20)
    widths = []
    for rates in (alike, apart):
        unsafe = rng.random(2_000) < np.repeat(rates, 100)
        draws = Draws.plain(np.arange(2_000), unsafe, np.zeros(2_000, np.bool_))
        found, plain = replicated_rate(draws, replicates, 0.95), rate_of(draws, 0.95)
        assert found is not None
        assert found.value == plain.rate
        assert found.low <= 0.1 <= found.high
        widths.append((found.high - found.low) / (plain.fixed[1] - plain.fixed[0]))
        assert replicated_rate(draws, np.zeros(2_000), 0.95) is None
    assert 1.0 <= widths[0] < 0.7 * widths[1]
