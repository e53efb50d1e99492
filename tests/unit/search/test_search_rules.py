"""Rules of a region: known regions are found, and memorised scenarios do not count as accuracy."""

import numpy as np
import pytest

from brink.search.analysis.rules import Rules, region_rules, rules_markdown
from brink.search.archive import Archive, Neighbourhood
from brink.search.space import Categorical, Component, Integer, Real, SearchSpace

SPACE = SearchSpace(
    (
        Component(
            "scenario",
            (
                Categorical("weather", ("dry", "wet", "fog", "snow", "hail")),
                Categorical("night", ("no", "yes")),
            ),
        ),
        Component("behaviour", (Real("late_s", 0.0, 10.0, "s"), Integer("misses", 0, 9))),
    )
)
NEAR = Neighbourhood(radius=0.3, p_th=0.1, z=1.96)


def archive(rows: np.ndarray) -> Archive:
    count = len(rows)
    return Archive.empty(SPACE, NEAR).grown(
        np.arange(count), rows, np.zeros(count, np.bool_), np.ones(count, np.float64)
    )


def drawn(count: int, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.array([SPACE.join(SPACE.sample(rng)) for _ in range(count)])


def found(rows: np.ndarray, inside: np.ndarray) -> Rules:
    return region_rules(archive(rows), SPACE, inside, "the region", seed=1)


def test_region_of_two_conditions_is_found_and_described() -> None:
    rows = drawn(600)
    inside = (rows[:, 0] == 2) & (rows[:, 2] > 4.0)
    rules = found(rows, inside)
    best = rules.rules[0]
    assert best.share > 0.95
    assert "scenario.weather is fog" in best.conditions
    [late] = [condition for condition in best.conditions if "late_s" in condition]
    assert late.startswith("behaviour.late_s at least ")
    assert float(late.split()[-2]) == pytest.approx(4.0, abs=0.3)
    assert late.endswith(" s")
    assert rules.solutions == 600
    assert rules.inside == inside.sum()
    assert sum(rule.solutions for rule in rules.rules) == rules.held_out == pytest.approx(300, abs=100)
    assert sum(rule.inside for rule in rules.rules) == rules.held_out_inside
    assert rules.accuracy is not None
    assert rules.accuracy > 0.95 > rules.usual
    text = rules_markdown([rules])
    assert "## The region" in text
    assert f"{inside.sum()} of 600 evaluated solutions" in text


def test_every_seed_of_a_campaign_gives_rules() -> None:
    rows = drawn(200)
    inside = rows[:, 2] > 6.0
    small, large = (
        region_rules(archive(rows), SPACE, inside, "the region", seed=seed) for seed in (5, 5 + 2**32)
    )
    assert small == large


def test_an_inactive_parameter_counts_as_inactive_whatever_its_value() -> None:
    rows = drawn(600)
    recorded = np.ones(rows.shape, np.bool_)
    recorded[::3, 1] = False
    recorded[1::3, 2] = False

    def conditions(inside: np.ndarray) -> set[str]:
        rules = region_rules(archive(rows), SPACE, inside, "the region", seed=1, recorded=recorded)
        assert [rule.share for rule in rules.rules] == [1.0] + [0.0] * (len(rules.rules) - 1)
        return {condition for rule in rules.rules for condition in rule.conditions}

    night, late = recorded[:, 1] & (rows[:, 1] == 1), recorded[:, 2] & (rows[:, 2] <= 6.0)
    assert conditions(recorded[:, 2]) == {"behaviour.late_s is active", "behaviour.late_s is inactive"}
    assert conditions(night) == {"scenario.night is yes", "scenario.night is no or inactive"}
    found = conditions(late)
    assert any(one.startswith("behaviour.late_s from 0 to ") for one in found), found
    assert any(one.endswith(" or inactive") or one.endswith(" is inactive") for one in found), found
    assert any(one.endswith(" s or inactive") for one in conditions(~recorded[:, 2] | (rows[:, 2] <= 6.0)))


def test_random_region_gets_no_better_than_chance() -> None:
    rng = np.random.default_rng(3)
    rows = drawn(500)
    rules = found(rows, rng.random(500) < 0.3)
    assert rules.accuracy is not None
    assert rules.accuracy < rules.usual + 0.03
    counted = [rule for rule in rules.rules if rule.solutions >= 15]
    assert max(abs(rule.share - 0.3) for rule in counted) < 0.3
    assert rules.balanced == pytest.approx(0.5, abs=0.08)


def test_scenarios_are_never_in_both_training_and_test_set() -> None:
    # A coin for each of 60 scenarios decides the region; a tree could memorise it if scenarios were in both sets.
    rng = np.random.default_rng(5)
    space = SearchSpace(
        (Component("scenario", (Real("place", 0.0, 1.0),)), Component("what", (Real("y", 0.0, 1.0),)))
    )
    places, coin = np.sort(rng.random(60)), np.tile([True, False], 30)
    which = np.repeat(np.arange(60), 20)
    rows = np.column_stack([places[which], rng.random(1200)])
    count = len(rows)
    every = Archive.empty(space, NEAR).grown(
        np.arange(count), rows, np.zeros(count, np.bool_), np.ones(count, np.float64)
    )
    rules = region_rules(every, space, coin[which], "coins", seed=1)
    assert rules.balanced is not None
    assert rules.balanced < 0.65
    said = f"a balanced accuracy of {rules.balanced:.0%}; guessing gives 50%. **They say little"
    assert said in rules_markdown([rules])


def test_regions_of_all_or_no_solutions_are_rejected() -> None:
    rows = drawn(50)
    for inside in (np.ones(50, np.bool_), np.zeros(50, np.bool_)):
        with pytest.raises(ValueError, match="some solutions inside and some outside"):
            found(rows, inside)


def test_too_few_scenarios_are_not_cross_validated() -> None:
    rows = drawn(60)
    rows[:, :2] = 0
    rules = found(rows, rows[:, 2] > 5)
    assert (rules.accuracy, rules.balanced, rules.rules) == (None, None, ())
    assert "Too few" in rules_markdown([rules])


def test_best_rule_covers_exactly_the_region() -> None:
    rows = drawn(300)
    inside = (rows[:, 3] <= 4) & (rows[:, 1] == 1)
    rules = found(rows, inside)
    best = rules.rules[0]
    assert set(best.conditions) == {"scenario.night is yes", "behaviour.misses at most 4"}
    assert best.share == 1.0
    assert best.inside == rules.held_out_inside
