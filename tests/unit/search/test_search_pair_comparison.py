"""Methods compared by their pairs: counts, shares, and what they are compared on."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from scipy import stats

from brink.search.analysis.confirmation import Share
from brink.search.analysis.count_comparison import (
    CountMeasure,
    ProblemMeasure,
    Proportion,
    by_method,
    count_duels,
)
from brink.search.analysis.pair_comparison import DistinctPair, PairRepeat, PairStanding
from brink.search.analysis.statistics import holm, mean_interval

SHARES = {
    1: Share.of(0, 15), 2: Share.of(15, 15),  # confirmed
    3: Share.of(2, 20), 4: Share.of(20, 20),  # undecided
    5: Share.of(7, 10), 6: Share.of(10, 10),  # refuted
    7: Share.of(0, 4), 8: Share.of(4, 4),  # too few drives
}  # fmt: skip
PAIRS = [
    DistinctPair(safe=number, unsafe=number + 1, checked=number in (1, 5, 7, 9)) for number in (1, 3, 5, 7, 9)
]


CAMPAIGN: dict[str, Any] = {"problem": "gap", "method": "a", "seed": 1, "campaign": "c1", "computed": False}


def counts(distinct: int, *, tried: int = 0, confirmed: int = 0, checked: int = 0) -> dict[str, int | None]:
    """Return counts of pairs, of which the first `checked` are checked, and the first `confirmed` confirmed."""
    return {
        "distinct": distinct,
        "checked": checked,
        "tried": tried,
        "judged": tried,
        "confirmed": confirmed if tried or not distinct else None,
        "refuted": 0,
        "checked_judged": min(checked, tried),
        "checked_confirmed": min(checked, confirmed),
        "component": 0,
        "scenario": 0,
        "drives": 15 if tried else 0,
    }


def repeats(methods: Mapping[str, list[dict[str, Any]]]) -> list[PairRepeat]:
    """Return the campaigns of methods, one for each of their counts."""
    return [
        PairRepeat(problem="gap", method=method, seed=seed, campaign=f"{method}{seed}", computed=False, **one)
        for method, ones in methods.items()
        for seed, one in enumerate(ones)
    ]


def test_pairs_are_counted_by_what_is_known_of_them() -> None:
    found = PairRepeat.of(PAIRS, SHARES, {2: False, 4: True, 6: False, 99: True}, **CAMPAIGN)
    assert found == PairRepeat(
        **CAMPAIGN,
        distinct=5,
        checked=4,
        tried=4,
        judged=3,
        confirmed=1,
        refuted=1,
        checked_judged=2,
        checked_confirmed=1,
        component=2,
        scenario=1,
        drives=4,
    )
    assert not found.is_tried, "the last pair was not"
    assert PairRepeat.of([], SHARES, {}, **CAMPAIGN).is_tried, "there is none to try"


def test_confirmed_pairs_have_a_mean_only_if_all_were_tried() -> None:
    tried = [counts(n, tried=n, confirmed=n - 1, checked=n - 2) for n in (5, 6, 7)]
    ours = repeats({"all": tried, "some": [*tried[:2], counts(7, checked=7)], "none": [counts(0)] * 3})
    every, some, none = map(PairStanding.of, by_method(ours).values())
    assert every.confirmed == mean_interval([4, 5, 6])
    assert every.precision == Proportion.pooled([(12, 12)])
    assert every.overall == Proportion.pooled([(15, 18)])
    assert (some.confirmed, some.known, some.pairs, some.tried) == (None, 2, 18, 11)
    assert some.distinct == mean_interval([5, 6, 7])
    assert some.overall is not None
    assert (some.overall.count, some.overall.of) == (9, 11), "of the tried ones"
    assert none.confirmed is not None
    assert (none.confirmed.mean, none.known, none.overall, none.component) == (0, 3, None, None)


def test_pooled_shares_have_wilson_intervals() -> None:
    share = Proportion.pooled([(8, 10), (9, 10), (0, 0)])
    assert share is not None
    expected = stats.binomtest(17, 20).proportion_ci(method="wilson")
    assert (share.low, share.high) == pytest.approx((expected.low, expected.high), abs=1e-4)
    assert share.share == 0.85
    assert Proportion.pooled([(0, 0)]) is None


def test_methods_are_compared_on_confirmed_pairs_only_if_all_are_known() -> None:
    rng = np.random.default_rng(3)
    values = {method: rng.poisson(level, 10).tolist() for method, level in (("a", 60), ("b", 40), ("c", 2))}
    known = {
        method: [counts(n + 3, tried=n + 3, confirmed=n) for n in ones] for method, ones in values.items()
    }
    none = [counts(0)] * 10
    ours = repeats({**known, "nothing": none, "neither": none})
    assert ProblemMeasure.of(ours).measure is CountMeasure.CONFIRMED
    duels = {(one.first, one.second): one for one in count_duels(ours)}
    assert len(duels) == 10
    raw = {}
    for (first, second), duel in duels.items():
        a, b = ([one.confirmed_ones for one in ours if one.method == method] for method in (first, second))
        assert (duel.first_mean, duel.second_mean) == (float(np.mean(a)), float(np.mean(b)))
        if {*a, *b} != {0}:
            expected = stats.mannwhitneyu(a, b, alternative="two-sided")
            assert (duel.u, duel.p) == pytest.approx((expected.statistic, expected.pvalue))
            raw[first, second] = expected.pvalue
    assert len(raw) == 9, "all values of the two that found nothing are equal: nothing to correct for"
    assert [duels[key].p_holm for key in raw] == pytest.approx(holm(list(raw.values())))
    assert duels["nothing", "neither"].p_holm is None
    assert "all values are equal" in duels["nothing", "neither"].says
    assert duels["a", "b"].says == "a finds more"

    partly = repeats({**known, "a": [counts(99), *known["a"][1:]], "nothing": none})
    compared = ProblemMeasure.of(partly)
    assert compared.measure is CountMeasure.DISTINCT
    assert "confirmed or not: only" in compared.says
