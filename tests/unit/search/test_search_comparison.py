"""Conclusions in words: a campaign compared with its control, and methods compared over repeats."""

import numpy as np
import pytest

from brink.search.analysis.comparison import Duel, Line, Row, conclusion, control_summaries
from brink.search.analysis.paper import PAPER_D_THS, PAPER_T_BS, Measure
from brink.search.analysis.statistics import Comparison

SHAPE = (len(PAPER_T_BS), len(PAPER_D_THS))


def row(strict: float, *, spread: float = 0.0, repeats: float | None = None, beyond: int = 0) -> Row:
    figures = np.full(SHAPE, strict)
    return Row(
        label="night", campaign="3f2a", unsafe_share=0.2, dbs=figures, strict=figures,
        strict_spread=np.full(SHAPE, spread), repeats=repeats, beyond=beyond,
    )  # fmt: skip


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


GA, RS, GA_CONTROL = (
    Line(problem="gap", method=method, control=control)
    for method, control in (("GA", False), ("RS", False), ("GA", True))
)


def duel(second: Line, p: float, adjusted: float, a12: float) -> Duel:
    result = Comparison(u=1.0, p_value=p, a12=a12)
    return Duel(
        first=GA, second=second, measure=Measure.STRICT, t_b=0.1, d_th=0.2, result=result, adjusted=adjusted
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
    ],
)
def test_conclusion_follows_from_the_test_and_the_control(
    second: Line, p: float, adjusted: float, a12: float, low: tuple[str, ...], expected: str
) -> None:
    assert expected in conclusion(duel(second, p, adjusted, a12), 12.0, 7.0, low)


def test_line_below_its_control_shows_no_effect_of_behaviour() -> None:
    assert "no more than" in conclusion(duel(GA_CONTROL, 0.001, 0.01, 0.1), 7.0, 12.0, ())
