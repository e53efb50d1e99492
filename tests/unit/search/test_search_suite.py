"""The sequential test of suites, what it decides, and the algorithm that simulates as many drives as it takes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from brink.search.algorithm import Candidate, Evaluation, Failed, Scored
from brink.search.algorithms.suite import Suite, SuiteConfig, schedule, tallied
from brink.search.analysis.suite import SuiteVerdict, passes, verdict_on
from brink.search.errors import ConfigError
from brink.search.testing import example_spaces, play, synthetic_verdicts
from brink.search.wald import CLEAR, MOST, Decision, decide, further_drives

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


@given(st.integers(0, MOST), st.integers(0, MOST))
def test_a_verdict_is_given_once_the_likelihood_ratio_passes_walds_limit(unsafe: int, safe: int) -> None:
    drives = unsafe + safe
    # Wald 1947, Sequential analysis, 3.2: accept p0 at beta / (1 - alpha).
    limit = 0.05 / (1 - 0.1)
    for decision, against in ((Decision.SAFE, unsafe), (Decision.UNSAFE, safe)):
        ratio = binom.pmf(against, drives, 0.5) / binom.pmf(against, drives, 0.1)
        assert (decide(unsafe, drives) is decision) == (ratio <= limit)


@given(st.integers(0, MOST), st.integers(0, MOST), st.integers(0, MOST))
def test_at_most_a_fifth_of_the_simulations_contradict_a_verdict(unsafe: int, safe: int, failed: int) -> None:
    drives = unsafe + safe + failed
    decision = decide(unsafe, unsafe + safe, failed)
    if drives <= MOST and decision in (Decision.SAFE, Decision.UNSAFE):
        assert drives - (safe if decision is Decision.SAFE else unsafe) <= drives / 5


def test_the_verdict_on_a_drive_between_safe_and_unsafe_is_unclear() -> None:
    for p in (0.35, 0.5, 0.65):
        assert probabilities(p)[0][Decision.UNCLEAR] > 0.7
    half, drives = probabilities(0.5)
    assert max(half[Decision.SAFE], half[Decision.UNSAFE]) <= 0.05
    assert drives < 12, "it ends when no verdict can be reached"


def test_clear_drives_cost_little_and_are_recognised() -> None:
    for p, wanted in ((0.0, Decision.SAFE), (1.0, Decision.UNSAFE)):
        assert probabilities(p) == ({**dict.fromkeys(Decision, 0.0), wanted: 1.0}, CLEAR)
    ends, drives = probabilities(0.05)
    assert ends[Decision.SAFE] > 0.998
    assert drives == pytest.approx(6.2, abs=0.05)
    assert probabilities(0.1)[0][Decision.SAFE] > 0.97
    assert probabilities(0.95)[1] == pytest.approx(drives)


@pytest.mark.parametrize(
    ("unsafe", "evaluated", "failed", "decision"),
    [
        (0, 0, 0, Decision.OPEN),
        (0, 4, 0, Decision.OPEN),
        (0, 5, 0, Decision.SAFE),
        (5, 5, 0, Decision.UNSAFE),
        (1, 8, 0, Decision.OPEN),
        (1, 9, 0, Decision.SAFE),
        (5, 14, 0, Decision.UNCLEAR),
        (4, 19, 0, Decision.OPEN),
        (4, 20, 0, Decision.SAFE),
        (16, 20, 0, Decision.UNSAFE),
        (0, 5, 1, Decision.OPEN),
        (0, 8, 1, Decision.SAFE),
        (0, 0, 4, Decision.OPEN),
        (0, 0, 5, Decision.CANNOT_RUN),
        (1, 1, 4, Decision.OPEN),
        (1, 1, 19, Decision.UNCLEAR),
    ],
)
def test_known_decisions(unsafe: int, evaluated: int, failed: int, decision: Decision) -> None:
    assert decide(unsafe, evaluated, failed) is decision


@given(st.integers(0, 9), st.integers(0, 9), st.integers(0, 5), st.sampled_from([1, 3, MOST]))
def test_further_drives_is_when_the_test_may_end(unsafe: int, safe: int, failed: int, most: int) -> None:
    def may_end(more: int) -> bool:
        return any(
            decide(
                unsafe + violating,
                unsafe + safe + violating + holding,
                failed + more - violating - holding,
                most=most,
            )
            is not Decision.OPEN
            for violating in range(more + 1)
            for holding in range(more + 1 - violating)
        )

    further = further_drives(unsafe, unsafe + safe, failed, most=most)
    assert may_end(further)
    assert not further or not may_end(further - 1)
    assert further <= CLEAR, "as `Suite.flight` says of a round"


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


def test_clear_drives_take_five_simulations_with_seeds_of_their_own() -> None:
    config = SuiteConfig(solutions=GIVEN, seeds=[100 * place for place in range(6)])
    run = play(Suite(), SPACE, config, clear, seed=0, budget=6 * MOST)
    assert len(run.candidates) == 6 * CLEAR
    seeds: dict[int, list[int | None]] = {}
    for one in run.candidates:
        seeds.setdefault(GIVEN.index(SPACE.join(one.vectors).tolist()), []).append(one.seed_number)
    assert seeds == {place: [100 * place + nth for nth in range(CLEAR)] for place in range(6)}


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
    for place, tally in enumerate(tallies):
        for unsafe, number in tally.examples.items():
            assert number == min(n for n, drive in enumerate(drives) if drive == place and ended[n] is unsafe)


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
