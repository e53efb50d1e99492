"""Conclusions in words: a campaign compared with its control, and methods compared over repeats."""

import numpy as np
import pytest

from brink.search.analysis.comparison import (
    Duel,
    Line,
    Repeat,
    Row,
    conclusion,
    control_summaries,
    duels,
    lead_words,
    leads,
)
from brink.search.analysis.paper import D_THS, PAPER_FRACTIONS, PAPER_T_BS, Measure
from brink.search.analysis.scores import Figures, Scores
from brink.search.analysis.statistics import Comparison

SHAPE = (len(PAPER_T_BS), len(D_THS))


def row(strict: float, *, spread: float = 0.0, repeats: float | None = None, beyond: int = 0) -> Row:
    figures = np.full(SHAPE, strict)
    return Row(
        label="night",
        campaign="3f2a",
        unsafe_share=0.2,
        dbs=figures,
        strict=figures,
        strict_spread=np.full(SHAPE, spread),
        repeats=repeats,
        beyond=beyond,
    )


@pytest.mark.parametrize(
    ("found", "blind", "spread", "repeats", "expected"),
    [
        (39, 33.0, 0.5, 6.0, "accounts for about 6 of 39"),
        (39, 33.0, 4.0, 6.0, "no more than scenarios and chance explain"),  # within the draws' spread
        (37, 33.0, 0.0, 6.0, "no more than scenarios and chance explain"),  # within the control's own error
        (7, 2.0, 0.6, 4.0, "accounts for about 5 of 7"),
        (16, 0.6, 0.5, 1.1, "proves nothing"),
        (0, 0.0, 0.0, 6.0, "nothing to attribute"),
    ],
)
def test_effect_of_behaviour_is_stated_only_beyond_the_control(
    found: float, blind: float, spread: float, repeats: float, expected: str
) -> None:
    (sentence,) = control_summaries([row(found), row(blind, spread=spread, repeats=repeats)], 0.1, 0.2)
    assert sentence.startswith("night: ")
    assert expected in sentence


GA, RS, GA_CONTROL = (
    Line(problem="gap", method=method, control=control)
    for method, control in (("GA", False), ("RS", False), ("GA", True))
)


def duel(second: Line, p: float | None, adjusted: float | None, a12: float, level: float = 0.05) -> Duel:
    result = Comparison(u=1.0, p_value=p, a12=a12)
    return Duel(
        first=GA,
        second=second,
        measure=Measure.STRICT,
        t_b=0.1,
        d_th=0.2,
        result=result,
        adjusted=adjusted,
        found_nothing=False,
        level=level,
    )


@pytest.mark.parametrize(
    ("second", "p", "adjusted", "a12", "low", "expected"),
    [
        (RS, 0.001, 0.01, 0.9, (), "GA finds more"),
        (RS, 0.001, 0.01, 0.1, (), "RS finds more"),
        (RS, 0.01, 0.2, 0.9, (), "it may be chance"),
        (RS, 0.3, 1.0, 0.6, (), "show no difference"),
        (RS, 0.1, 0.1, 1.0, (), "GA finds more in every repeat, but these are too few for the test"),
        (RS, 0.1, 0.1, 0.0, (), "RS finds more in every repeat, but these are too few for the test"),
        (RS, 0.001, 0.01, 0.9, ("GA",), "GA finds more"),  # its control does not matter here
        (GA_CONTROL, 0.001, 0.01, 0.9, (), "behaviour accounts for 5.0"),
        (GA_CONTROL, 0.01, 0.2, 0.9, (), "it may be chance"),
        (GA_CONTROL, 0.3, 1.0, 0.6, (), "no more than scenarios and chance explain"),
        (GA_CONTROL, 0.001, 0.01, 0.9, ("GA",), "proves nothing"),
        (RS, None, None, 0.5, (), "all values are equal, so there is nothing to test"),
        (GA_CONTROL, None, None, 0.5, ("GA",), "all values are equal: nothing to attribute"),
    ],
)
def test_conclusion_follows_from_the_test_and_the_control(
    second: Line, p: float | None, adjusted: float | None, a12: float, low: tuple[str, ...], expected: str
) -> None:
    assert expected in conclusion(duel(second, p, adjusted, a12), 12.0, 7.0, low)


def test_line_below_its_control_shows_no_effect_of_behaviour() -> None:
    assert "no more than" in conclusion(duel(GA_CONTROL, 0.001, 0.01, 0.1), 7.0, 12.0, ())


def repeats_of(**methods: list[list[float]]) -> list[Repeat]:
    """Return campaigns on one problem; for each method and seed, the DBS at each tenth, equal at all thresholds."""
    found = []
    for method, seeds in methods.items():
        for seed, tenths in enumerate(seeds):
            figures = np.broadcast_to(np.array(tenths)[:, None, None], (len(PAPER_FRACTIONS), *SHAPE))
            scores = Scores(
                evaluated=100, unsafe=30, figures=Figures(dbs=figures, strict=0.0 * figures), control=None
            )
            found.append(Repeat(problem="gap", method=method, seed=seed, campaign="c", scores=scores))
    return found


def test_methods_that_found_the_same_are_equal_and_not_tested() -> None:
    same = [[4.0] * 10] * 5
    [first, *_] = [one for one in duels(repeats_of(a=same, b=same)) if one.measure is Measure.DBS]
    assert (first.result.p_value, first.adjusted, first.differs) == (None, None, False)
    assert not first.found_nothing


def test_table_of_the_paper_has_no_test_where_a_method_found_nothing() -> None:
    nothing, something = [[0.0] * 10] * 5, [[float(seed + 1)] * 10 for seed in range(5)]
    [first, *_] = [one for one in duels(repeats_of(a=something, b=nothing)) if one.measure is Measure.DBS]
    assert first.found_nothing
    assert first.paper_p is None
    assert first.result.p_value is not None
    assert first.result.p_value < 0.01, "our own table has the test"
    [first, *_] = [
        one for one in duels(repeats_of(a=something, b=something[::-1])) if one.measure is Measure.DBS
    ]
    assert first.paper_p == first.result.p_value


def growing(slope: float, spread: float = 0.0) -> list[list[float]]:
    """Return ten campaigns whose DBS at tenth k is ``slope * k``, plus up to nine spreads."""
    return [[slope * (tenth + 1) + spread * seed for tenth in range(10)] for seed in range(10)]


def test_differences_at_tenths_of_the_budget_are_those_of_the_means() -> None:
    # Means of a: 2 k + 0.45; of b: k + 0.45. From the first tenth on, all of a but for the spread exceed b.
    ours = repeats_of(a=growing(2.0, 0.1), b=growing(1.0, 0.1))
    at = {one.t_b: one for one in leads(ours, "gap", Measure.DBS, 0.2)}
    assert list(at) == list(PAPER_T_BS)
    lead = at[0.1]
    assert (lead.first, lead.second, lead.d_th) == ("a", "b", 0.2)
    assert lead.differences == pytest.approx([1, 2, 3, 4, 5, 6, 7, 8, 9, 10])
    assert lead.significant() == [True] * 10
    assert lead_words(lead) == (
        "+1.0 at 10% of the budget, +10.0 at 100%, furthest apart at 100% (+10.0); "
        "significant at 0.01, without correction, from 10% on"
    )


def test_methods_that_find_nothing_have_no_lead() -> None:
    lead = leads(repeats_of(a=growing(0.0), b=growing(0.0)), "gap", Measure.DBS, 0.2)[0]
    assert lead.found_nothing
    assert lead_words(lead) == "neither finds anything at any share of the budget"


def test_solutions_that_are_left_out_are_named() -> None:
    (sentence,) = control_summaries([row(7, beyond=12), row(2, repeats=6.0, beyond=12)], 0.1, 0.2)
    assert "strict DBS 7 within the budget, without the 12 solutions beyond it;" in sentence
    (sentence,) = control_summaries([row(7), row(2, repeats=6.0)], 0.1, 0.2)
    assert "beyond" not in sentence


def test_campaigns_without_a_control_are_skipped() -> None:
    assert control_summaries([row(3), row(4), row(1, repeats=5.0)], 0.1, 0.2)[0].startswith(
        "night: strict DBS 4"
    )
    assert control_summaries([row(3)], 0.1, 0.2) == []
