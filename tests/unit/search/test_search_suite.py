"""The sequential test of suites, what it decides, and the algorithm that simulates as many drives as it takes."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brink.search.algorithm import Candidate, Evaluation, Failed, Scored
from brink.search.algorithms.suite import Suite, SuiteConfig, schedule, tallied
from brink.search.analysis.suite import SuiteVerdict, passes, verdict_on
from brink.search.errors import ConfigError
from brink.search.testing import example_spaces, play, synthetic_verdicts
from brink.search.wald import LEAD, MOST, Decision, decide, further_drives

SPACE = example_spaces()["mixed"]
GIVEN = [SPACE.join(SPACE.sample(np.random.default_rng(seed))).tolist() for seed in range(6)]


def probabilities(p: float, most: int = MOST) -> tuple[dict[Decision, float], float]:
    """Return the exact probability of each end of the test for a drive that violates with probability p, and the
    mean number of drives, by following every sequence of verdicts."""
    ends: dict[Decision, float] = dict.fromkeys(Decision, 0.0)
    drives, states = 0.0, {(0, 0): 1.0}
    while states:
        following: dict[tuple[int, int], float] = {}
        for (unsafe, evaluated), chance in states.items():
            decision = decide(unsafe, evaluated, most=most)
            if decision is not Decision.OPEN:
                ends[decision] += chance
                drives += chance * evaluated
                continue
            for violates, share in ((1, p), (0, 1 - p)):
                key = (unsafe + violates, evaluated + 1)
                following[key] = following.get(key, 0.0) + chance * share
        states = following
    return ends, drives


@pytest.mark.parametrize("p", [0.05, 0.2, 0.3, 0.5, 0.8])
def test_the_test_is_a_random_walk_between_two_walls(p: float) -> None:
    ends, drives = probabilities(p, most=2_000)
    # Gambler's ruin between -LEAD and +LEAD: Feller 1968, An introduction to probability theory, XIV.2 and XIV.3.
    odds = (1 - p) / p
    expected = 1 / (1 + odds**LEAD)
    assert ends[Decision.UNSAFE] == pytest.approx(expected, abs=1e-9)
    mean = LEAD**2 if p == 0.5 else LEAD * (1 - 2 * expected) / (1 - 2 * p)
    assert drives == pytest.approx(mean, abs=1e-6)


def test_error_rates_and_cost_are_those_that_are_promised() -> None:
    assert LEAD == 4 == math.ceil(math.log(99) / math.log(4))
    safe, drives = probabilities(0.2)
    assert safe[Decision.UNSAFE] <= 1 / 257 + 1e-12 <= 0.01
    assert safe[Decision.UNCLEAR] < 0.01
    assert drives == pytest.approx(6.6, abs=0.1)
    unsafe, _ = probabilities(0.8)
    assert unsafe[Decision.SAFE] == pytest.approx(safe[Decision.UNSAFE])
    assert probabilities(0.5)[0][Decision.UNCLEAR] > 0.2
    assert probabilities(0.0)[1] == 4


@pytest.mark.parametrize(
    ("unsafe", "evaluated", "failed", "decision"),
    [
        (0, 0, 0, Decision.OPEN),
        (0, 3, 0, Decision.OPEN),
        (0, 4, 0, Decision.SAFE),
        (4, 4, 0, Decision.UNSAFE),
        (4, 5, 0, Decision.OPEN),
        (5, 6, 0, Decision.UNSAFE),
        (10, 20, 0, Decision.UNCLEAR),
        (0, 4, 1, Decision.OPEN),
        (0, 5, 1, Decision.SAFE),
        (5, 5, 1, Decision.UNSAFE),
        (0, 0, 3, Decision.OPEN),
        (0, 0, 4, Decision.CANNOT_RUN),
        (1, 1, 19, Decision.UNCLEAR),
    ],
)
def test_known_decisions(unsafe: int, evaluated: int, failed: int, decision: Decision) -> None:
    assert decide(unsafe, evaluated, failed) is decision


@given(st.integers(0, 20), st.integers(0, 20), st.integers(0, 20))
def test_no_decision_comes_sooner_than_further_drives_say(unsafe: int, safe: int, failed: int) -> None:
    evaluated = unsafe + safe
    further = further_drives(unsafe, evaluated, failed)
    assert (further == 0) == (decide(unsafe, evaluated, failed) is not Decision.OPEN)
    for violating in range(further):
        for holding in range(further - violating):
            if violating + holding:
                more = decide(unsafe + violating, evaluated + violating + holding, failed)
                assert more is Decision.OPEN


@pytest.mark.parametrize(
    ("decision", "expected", "before", "reproduce", "verdict", "passed"),
    [
        (Decision.SAFE, "safe", "", "", SuiteVerdict.STILL_SAFE, True),
        (Decision.UNSAFE, "safe", "", "", SuiteVerdict.BROKEN, False),
        (Decision.SAFE, "unsafe", "", "", SuiteVerdict.FIXED, True),
        (Decision.UNSAFE, "unsafe", "", "", SuiteVerdict.STILL_UNSAFE, True),
        (Decision.UNCLEAR, "safe", "", "", SuiteVerdict.UNCLEAR, False),
        (Decision.UNCLEAR, "unsafe", "", "unsafe", SuiteVerdict.UNCLEAR, True),
        (Decision.CANNOT_RUN, "unsafe", "", "", SuiteVerdict.CANNOT_RUN, False),
        (Decision.OPEN, "unsafe", "", "", SuiteVerdict.OPEN, False),
        (Decision.SAFE, "unsafe", "", "unsafe", SuiteVerdict.NOT_REPRODUCED, False),
        (Decision.UNSAFE, "unsafe", "", "unsafe", SuiteVerdict.STILL_UNSAFE, True),
        (Decision.UNSAFE, "unsafe", "safe", "", SuiteVerdict.BROKEN, False),
        (Decision.UNSAFE, "safe", "unsafe", "", SuiteVerdict.STILL_UNSAFE, False),
        (Decision.SAFE, "safe", "unsafe", "", SuiteVerdict.FIXED, True),
    ],
)
def test_verdicts(
    decision: Decision, expected: str, before: str, reproduce: str, verdict: SuiteVerdict, passed: bool
) -> None:
    assert verdict_on(decision, expected, before=before, reproduce=reproduce) is verdict
    assert passes(verdict, expected) is passed


def clear(candidate: Candidate) -> Evaluation:
    """Return a verdict that depends on the drive alone: the first two are unsafe, the last one fails."""
    place = GIVEN.index(SPACE.join(candidate.vectors).tolist())
    if place == len(GIVEN) - 1:
        return Failed(reason="synthetic")
    return Scored(unsafe=place < 2, robustness=-1.0 if place < 2 else 1.0)


def test_clear_drives_take_four_simulations_with_seeds_of_their_own() -> None:
    config = SuiteConfig(solutions=GIVEN, seeds=[100 * place for place in range(6)])
    run = play(Suite(), SPACE, config, clear, seed=0, budget=6 * MOST)
    assert len(run.candidates) == 6 * 4
    seeds: dict[int, list[int | None]] = {}
    for one in run.candidates:
        seeds.setdefault(GIVEN.index(SPACE.join(one.vectors).tolist()), []).append(one.seed_number)
    assert seeds == {place: [100 * place + nth for nth in range(4)] for place in range(6)}


def test_the_simulations_of_a_drive_do_not_depend_on_the_rest_of_the_suite() -> None:
    verdicts = synthetic_verdicts(SPACE, failing=0.2)

    def seeded(places: list[int]) -> dict[int, set[int | None]]:
        config = SuiteConfig(solutions=[GIVEN[place] for place in places], seeds=[50 * p for p in places])
        run = play(Suite(), SPACE, config, by_seed, seed=0, budget=len(places) * MOST)
        found: dict[int, set[int | None]] = {place: set() for place in places}
        for one in run.candidates:
            found[GIVEN.index(SPACE.join(one.vectors).tolist())].add(one.seed_number)
        return found

    def by_seed(candidate: Candidate) -> Evaluation:
        assert candidate.seed_number is not None
        return verdicts(Candidate(number=candidate.seed_number, vectors=candidate.vectors))

    assert seeded([4, 1]).items() <= seeded(list(range(6))).items()


def test_tallies_follow_from_the_verdicts_of_a_stored_campaign() -> None:
    verdicts = synthetic_verdicts(SPACE, failing=0.1)
    run = play(Suite(), SPACE, SuiteConfig(solutions=GIVEN), verdicts, seed=3, budget=6 * MOST)
    ended: dict[int, bool | None] = {one.number: None for one in run.candidates}
    ended |= dict(zip(run.archive.numbers.tolist(), run.archive.unsafe.tolist(), strict=True))
    drives = [GIVEN.index(SPACE.join(one.vectors).tolist()) for one in run.candidates]
    assert [drive for drive, _ in schedule(6, ended)] == drives
    tallies = tallied(6, ended)
    assert [one.evaluated + one.failed for one in tallies] == [drives.count(place) for place in range(6)]
    assert all(one.decision is not Decision.OPEN for one in tallies)


@pytest.mark.parametrize(
    ("config", "field"),
    [
        (SuiteConfig(), "solutions"),
        (SuiteConfig(solutions=[[0.0]]), "solutions"),
        (SuiteConfig(solutions=GIVEN, seeds=[1]), "seeds"),
        (SuiteConfig(solutions=GIVEN, names=["one"]), "names"),
        (SuiteConfig(solutions=GIVEN[:1], expect=["maybe"]), "expect"),
        (SuiteConfig(solutions=GIVEN[:1], reproduce=["maybe"]), "reproduce"),
    ],
)
def test_wrong_settings_are_named(config: SuiteConfig, field: str) -> None:
    with pytest.raises(ConfigError) as raised:
        Suite().check(SPACE, config, budget=6 * MOST)
    assert raised.value.field == field
