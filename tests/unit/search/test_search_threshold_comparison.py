"""Methods compared by their thresholds: what is distinct, what is known, and what they are compared on."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from brink.search.analysis.confirmation import Share
from brink.search.analysis.count_comparison import CountMeasure, ProblemMeasure, by_method, count_duels
from brink.search.analysis.threshold_comparison import (
    FoundThreshold,
    ThresholdRepeat,
    ThresholdStanding,
    close_ones,
)
from brink.search.space import Component, Real, SearchSpace

SPACE = SearchSpace((Component("where", (Real("x", 0.0, 1.0), Real("y", 0.0, 1.0))),))
MISS, FALSE = ("miss", "hit the lead"), ("ghost", "hit the lead")
SHARES = {
    1: Share.of(0, 15), 2: Share.of(15, 15),  # confirmed
    3: Share.of(4, 20), 4: Share.of(20, 20),  # undecided, but held
    5: Share.of(7, 10), 6: Share.of(10, 10),  # refuted
    7: Share.of(0, 4), 8: Share.of(4, 4),  # too few drives
}  # fmt: skip

CAMPAIGN: dict[str, Any] = {"problem": "gap", "method": "a", "seed": 1, "campaign": "c1", "computed": False}


def count(
    thresholds: Sequence[FoundThreshold], shares: Mapping[int, Share], scenario: Mapping[int, bool]
) -> ThresholdRepeat:
    return ThresholdRepeat.of(thresholds, shares, scenario, **CAMPAIGN)


def found(number: int, kind: tuple[str, ...] = MISS, near: tuple[int, ...] = ()) -> FoundThreshold:
    return FoundThreshold(kind=kind, near=frozenset(near), ends=(number, number + 1), is_paired=True)


def test_thresholds_of_one_kind_that_lie_close_together_count_once() -> None:
    rows = np.array([[0.1, 0.5], [0.2, 0.5], [0.3, 0.5], [0.1, 0.5]])
    near = close_ones([MISS, MISS, MISS, FALSE], rows, SPACE, 0.08)
    assert near == [frozenset(), {0}, {1}, frozenset()], "a distance is a mean over both numbers"
    chain = [FoundThreshold(kind=MISS, near=one, ends=(0, 1), is_paired=False) for one in near[:3]]
    assert count(chain, {}, {}).distinct == 2, "the one in the middle falls away, and only that"
    assert close_ones([], np.empty(0), SPACE, 0.08) == []


def test_thresholds_are_counted_by_what_is_known_of_them() -> None:
    thresholds = [
        found(1),
        found(3, near=(0,)),
        found(5, FALSE),
        found(7, FALSE, near=(2,)),
        replace(found(9, ("other",)), is_paired=False),
    ]
    counts = count(thresholds, SHARES, {2: False, 4: True, 10: False, 99: True})
    assert counts == ThresholdRepeat(
        **CAMPAIGN,
        found=5,
        distinct=3,
        kinds=3,
        paired=4,
        tried=4,
        judged=3,
        held=2,
        confirmed=1,
        confirmed_distinct=1,
        confirmed_kinds=1,
        refuted=1,
        component=2,
        scenario=1,
        drives=4,
    )
    assert not counts.is_tried, "one has too few drives"
    assert count(thresholds[4:], SHARES, {}).is_tried, "without a tight pair, there is none to try"
    second = {3: Share.of(0, 15), 4: Share.of(15, 15)}
    assert count(thresholds[:2], {**SHARES, **second}, {}).confirmed_distinct == 1
    alone = count(thresholds[1:2], second, {})
    assert alone.confirmed_distinct == 1, "the sharper one near it is not there"
    failed = count([found(1)], {1: Share.of(0, 0, 15), 2: Share.of(0, 0, 15)}, {})
    assert (failed.judged, failed.held) == (1, 0), "without a verdict, nothing holds"


def repeats(methods: Mapping[str, list[ThresholdRepeat]], *, computed: bool = False) -> list[ThresholdRepeat]:
    return [
        replace(one, method=method, seed=seed, computed=computed)
        for method, ones in methods.items()
        for seed, one in enumerate(ones)
    ]


NONE = count([], {}, {})
UNTRIED = count([found(1)], {}, {})
CONFIRMED = count([found(1)], SHARES, {})
FEW = count([found(7)], SHARES, {})
UNPAIRED = count([replace(found(1), is_paired=False)], {}, {})


@pytest.mark.parametrize(
    ("ours", "theirs", "computed", "measure", "words"),
    [
        (CONFIRMED, NONE, False, CountMeasure.CONFIRMED, "on confirmed distinct"),
        (CONFIRMED, UNTRIED, False, CountMeasure.DISTINCT, "only 1 of 2"),
        (CONFIRMED, FEW, False, CountMeasure.DISTINCT, "1 of 2 have too few"),
        (UNTRIED, UNTRIED, False, CountMeasure.DISTINCT, "none of them was simulated again"),
        (UNTRIED, NONE, True, CountMeasure.DISTINCT, "verdicts are computed"),
        (UNPAIRED, NONE, False, CountMeasure.DISTINCT, "none has simulated ends close enough"),
        (NONE, NONE, False, CountMeasure.DISTINCT, "No method found any threshold"),
    ],
)
def test_methods_are_compared_on_confirmed_thresholds_only_if_all_are_known(
    ours: ThresholdRepeat, theirs: ThresholdRepeat, computed: bool, measure: CountMeasure, words: str
) -> None:
    compared = ProblemMeasure.of(repeats({"a": [ours], "b": [theirs]}, computed=computed))
    assert compared.measure is measure
    assert words in compared.says


def test_what_was_not_tried_has_no_mean() -> None:
    ours = repeats({"a": [CONFIRMED, UNTRIED], "b": [CONFIRMED, NONE]})
    [mine, theirs] = map(ThresholdStanding.of, by_method(ours).values())
    assert (mine.confirmed, mine.confirmed_kinds, mine.known) == (None, None, 1)
    assert theirs.confirmed is not None
    assert theirs.confirmed.mean == 0.5
    assert (mine.held, mine.overall) == (theirs.held, theirs.overall)
    assert mine.component is None


def test_duels_are_those_of_the_measure() -> None:
    [duel] = count_duels(repeats({"a": [CONFIRMED] * 4, "b": [NONE] * 4}))
    assert (duel.u, duel.first_mean, duel.differs) == (16, 1, True)
    assert duel.says == "a finds more"
