"""`subset@1`: rates of 1e-4 on functions where they are known, chance included."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.special import ndtri

from brink.search.algorithm import Candidate, Evaluation, LevelEstimate, Scored
from brink.search.algorithms.subset import Subset, SubsetConfig, _variation
from brink.search.distribution import distributed
from brink.search.document import Document
from brink.search.replayed import draw_from, moved
from brink.search.space import Component, Real, SearchSpace
from brink.search.streams import generator
from brink.search.testing import Run, check_algorithm, example_spaces, play

SPACE = SearchSpace((Component("x", tuple(Real(f"x{i}", 0.0, 1.0) for i in range(4))),))
RATE = 1e-4
LEVEL = -float(ndtri(RATE))


def normal(seed: int) -> Callable[[Candidate], Evaluation]:
    """Return verdicts whose robustness is normal: four fifths of its variance by parameters, the rest by the seed."""

    def evaluate(candidate: Candidate) -> Scored:
        own = candidate.number if candidate.seed_number is None else candidate.seed_number
        scores = ndtri(np.clip(candidate.vectors[0], 1e-9, 1 - 1e-9)).sum()
        scores += generator(seed, 1_000, own).standard_normal()
        robustness = float(LEVEL - scores / 5**0.5)
        return Scored(unsafe=robustness < 0, robustness=robustness)

    return evaluate


def estimate(run: Run) -> LevelEstimate:
    return Subset().level_estimate(Document.from_bytes(run.documents[-1]), 0.95)


def test_a_rate_of_1_in_10000_takes_two_thousand_simulations() -> None:
    found = [
        estimate(play(Subset(), SPACE, SubsetConfig(), normal(seed), seed=seed, budget=4_000))
        for seed in range(3)
    ]
    assert {one.ended for one in found} == {"reached"}
    assert max(sum(level.simulations for level in one.levels) for one in found) <= 2_750
    rates = [one.rate for one in found if one.rate is not None]
    variation = np.mean([one.variation for one in found if one.variation is not None])
    # Four standard errors of the mean, by the coefficient of variation that is reported.
    assert abs(np.mean(rates) / RATE - 1) < 4 * variation / len(rates) ** 0.5
    assert sum(one.low <= RATE <= one.high for one in found if one.low and one.high) >= 2


def test_contract_holds_over_levels_with_several_groups_of_chains() -> None:
    run = check_algorithm(
        Subset(),
        SPACE,
        budget=300,
        config=SubsetConfig(chains=6, in_flight=3),
        evaluate=normal(1),
        repeats=True,
        ends_itself=True,
    )
    assert len(estimate(run).levels) >= 3
    shared = [one for one in run.candidates if one.seed_number is not None]
    assert 0.2 < len(shared) / len(run.candidates) < 0.6


@pytest.mark.parametrize(("robustness", "budget", "ended"), [(1.0, 300, "not graded"), (None, 150, "budget")])
def test_no_rate_without_graded_robustness_or_budget(
    robustness: float | None, budget: int, ended: str
) -> None:
    evaluate = normal(2) if robustness is None else lambda _: Scored(unsafe=False, robustness=robustness)
    run = play(Subset(), SPACE, SubsetConfig(chains=10), evaluate, seed=1, budget=budget)
    found = estimate(run)
    assert (found.ended, found.rate, found.low) == (ended, None, None)
    assert len(run.candidates) == 100


@pytest.mark.parametrize("name", ["mixed", "traffic", "declared"])
def test_moves_keep_the_distribution_of_any_space(name: str) -> None:
    space = example_spaces()[name]
    if name == "mixed":
        space = distributed(space, {"scenario.weather": {"weights": {"dry": 8, "wet": 1, "fog": 1}}})
    rng = np.random.default_rng(1)
    drawn = np.array([space.join(space.draw(rng)) for _ in range(200)])
    walked, numbers = [], np.empty(0)
    for _ in range(200):  # chains of two moves each, from a draw
        row, numbers = draw_from(space, np.empty(0), rng)
        for _ in range(2):
            row, numbers = draw_from(space, moved(numbers, rng), rng)
        assert space.allows(row)
        walked.append(row)
    for column in range(space.dimension):
        one, other = drawn[:, column], np.array(walked)[:, column]
        error = ((one.var() + other.var()) / len(one)) ** 0.5
        assert abs(one.mean() - other.mean()) <= 4.5 * error + 1e-9


def test_variation_counts_correlation_along_chains() -> None:
    inside = np.repeat(np.arange(50) % 10 == 0, 10).reshape(50, 10)  # every chain stays where it is
    independent, chained = _variation(inside, is_chained=False), _variation(inside, is_chained=True)
    assert independent == pytest.approx((0.9 / (0.1 * 500)) ** 0.5)
    assert chained == pytest.approx((0.9 / (0.1 * 50)) ** 0.5)
