"""`minimise@1` reverts the differences of pairs as long as the unsafe side stays unsafe."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from brink.search.algorithm import Evaluation, Failed, Scored, ask_all
from brink.search.algorithms.minimise import (
    Minimise,
    MinimiseConfig,
    MinimiseState,
    Reductions,
    most_trials,
    replay,
)
from brink.search.errors import ConfigError
from brink.search.space import FloatArray
from brink.search.testing import example_spaces

SPACE = example_spaces()["mixed"]
"""weather, cars; label, start..end, left..right, delay."""


def row(
    weather: str, cars: int, label: str, start: int, end: int, left: float, right: float, delay: float
) -> FloatArray:
    behaviour = {"label": label, "start": start, "end": end, "left": left, "right": right, "delay": delay}
    return SPACE.join(SPACE.encode({"scenario": {"weather": weather, "cars": cars}, "behaviour": behaviour}))


SAFE = row("dry", 1, "car", 10, 40, 100.0, 300.0, 0.5)
UNSAFE = row("wet", 2, "car", 12, 41, 110.0, 300.0, 0.7)
Rule = Callable[[dict[str, dict[str, Any]]], bool | None]


def run(
    rule: Rule, *pairs: tuple[FloatArray, FloatArray], budget: int = 200, **more: Any
) -> tuple[MinimiseState, list[Any]]:
    """Run a reduction; a rule says whether decoded parameters are unsafe, or that their simulation fails."""
    config = MinimiseConfig(
        safe=[safe.tolist() for safe, _ in pairs], unsafe=[unsafe.tolist() for _, unsafe in pairs], **more
    )
    algorithm = Minimise()
    asked: list[Any] = []
    state = algorithm.start(SPACE, config, seed=1, budget=budget)
    while not algorithm.finished(state):
        state, [generation] = ask_all(algorithm, state)
        asked += generation
        evaluations: dict[int, Evaluation] = {}
        for candidate in generation:
            verdict = rule(SPACE.decode(candidate.vectors))
            evaluations[candidate.number] = (
                Failed(reason="no")
                if verdict is None
                else Scored(unsafe=verdict, robustness=-1.0 if verdict else 1.0)
            )
        state = algorithm.tell(state, evaluations)
    return state, asked


def by_cars_and_delay(values: dict[str, dict[str, Any]]) -> bool:
    return bool(values["scenario"]["cars"] >= 2 and values["behaviour"]["delay"] > 0.6)


def test_only_the_differences_that_matter_are_left() -> None:
    state, asked = run(by_cars_and_delay, (SAFE, UNSAFE), seed_numbers=[7])
    assert state.reductions.is_minimal(0)
    assert SPACE.decode(SPACE.split(state.reductions.unsafe[0])) == {
        "scenario": {"weather": "dry", "cars": 2},
        "behaviour": {"label": "car", "start": 10, "end": 40, "left": 100.0, "right": 300.0, "delay": 0.7},
    }
    assert {candidate.seed_number for candidate in asked} == {7}
    given = Reductions.of(SPACE, SAFE[None], UNSAFE[None])
    assert len(asked) <= most_trials(given) == 15


def test_a_difference_that_became_needless_is_tried_again() -> None:
    """Cars matter as long as the weather differs, so they can only go after it."""

    def rule(values: dict[str, dict[str, Any]]) -> bool:
        wet, cars = values["scenario"]["weather"] == "wet", values["scenario"]["cars"]
        return values["behaviour"]["delay"] > 0.6 and (not wet or cars >= 2)

    state, _ = run(rule, (SAFE, UNSAFE))
    assert state.reductions.is_minimal(0)
    assert SPACE.decode(SPACE.split(state.reductions.unsafe[0]))["scenario"] == {"weather": "dry", "cars": 1}


def test_every_pair_is_minimal_one_by_one() -> None:
    other = row("fog", 4, "person", 0, 80, 0.0, 700.0, 1.9)
    state, asked = run(by_cars_and_delay, (SAFE, UNSAFE), (SAFE, other))
    for pair in range(2):
        left = state.reductions.unsafe[pair]
        assert by_cars_and_delay(SPACE.decode(SPACE.split(left)))
        for unit in state.reductions.steps.differing(SAFE, left):
            without = np.array(left)
            without[list(unit)] = SAFE[list(unit)]
            assert not by_cars_and_delay(SPACE.decode(SPACE.split(without)))
    sizes = [candidate.number for candidate in asked]
    assert sizes == list(range(len(asked)))


def test_a_label_is_reverted_with_the_numbers_that_it_wakes() -> None:
    silent = row("wet", 2, "none", 0, 0, 0.0, 0.0, 0.7)
    for safe, unsafe in ((SAFE, silent), (silent, SAFE)):
        reductions = Reductions.of(SPACE, safe[None], unsafe[None])
        trials = []
        while (trial := reductions.trial(0)) is not None:
            trials.append(trial)
            reductions = reductions.after([trial], [False])
        for trial in trials:
            SPACE.check(SPACE.split(trial.row))
            kept = trial.row == safe
            assert (kept | (trial.row == unsafe)).all(), "nothing is drawn afresh"
        label = [trial.row for trial in trials if trial.row[2] == safe[2]]
        assert label
        assert np.array_equal(label[0][2:7], safe[2:7])


def test_a_failed_simulation_leaves_a_pair_undecided() -> None:
    state, _ = run(
        lambda values: None if values["scenario"]["weather"] == "dry" else by_cars_and_delay(values),
        (SAFE, UNSAFE),
    )
    assert not state.reductions.is_minimal(0)
    assert state.reductions.is_undecided(0)


@pytest.mark.parametrize("told", [0, 3, 1000])
def test_the_state_follows_from_the_stored_verdicts(told: int) -> None:
    pairs = (SAFE, UNSAFE), (SAFE, row("fog", 4, "person", 0, 80, 0.0, 700.0, 1.9))
    state, asked = run(by_cars_and_delay, *pairs)
    verdicts: dict[int, bool | None] = {
        c.number: by_cars_and_delay(SPACE.decode(c.vectors)) for c in asked[:told]
    }
    given = Reductions.of(SPACE, np.array([SAFE, SAFE]), np.array([unsafe for _, unsafe in pairs]))
    found = replay(given, verdicts, 200)
    assert sum(found.tried) <= min(told, len(asked))
    if told >= len(asked):
        assert np.array_equal(found.reductions.unsafe, state.reductions.unsafe)
        assert sum(found.tried) == len(asked)
        for pair, number in enumerate(found.latest):
            assert number is not None
            assert np.array_equal(SPACE.join(asked[number].vectors), state.reductions.unsafe[pair])
    elif told == 0:
        assert found.latest == (None, None)


@pytest.mark.parametrize(
    ("config", "field"),
    [
        (MinimiseConfig(), "unsafe"),
        (MinimiseConfig(safe=[SAFE.tolist()], unsafe=[]), "unsafe"),
        (MinimiseConfig(safe=[[0.0]], unsafe=[[0.0]]), "safe"),
        (MinimiseConfig(safe=[SAFE.tolist()], unsafe=[SAFE.tolist()]), "unsafe"),
        (MinimiseConfig(safe=[SAFE.tolist()], unsafe=[UNSAFE.tolist()], seed_numbers=[1, 2]), "seed_numbers"),
        (MinimiseConfig(safe=[SAFE.tolist()], unsafe=[UNSAFE.tolist()], seed_numbers=[-1]), "seed_numbers"),
    ],
)
def test_pairs_that_cannot_be_reduced_are_refused(config: MinimiseConfig, field: str) -> None:
    with pytest.raises(ConfigError) as caught:
        Minimise().check(SPACE, config, budget=10)
    assert caught.value.field == field


def test_a_spent_budget_claims_nothing() -> None:
    state, asked = run(by_cars_and_delay, (SAFE, UNSAFE), budget=2)
    assert len(asked) == 2
    assert not state.reductions.is_minimal(0)
    assert not state.reductions.is_undecided(0)
