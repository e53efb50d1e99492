"""What a campaign and its control say together, in words."""

import numpy as np
import pytest

from brink.search.analysis.comparison import Row, in_words
from brink.search.boundary import PAPER_D_THS, PAPER_T_BS

SHAPE = (len(PAPER_T_BS), len(PAPER_D_THS))


def row(strict: float, *, spread: float = 0.0, repeats: float | None = None) -> Row:
    figures = np.full(SHAPE, strict)
    return Row(
        label="night", campaign="3f2a", unsafe_share=0.2, dbs=figures, strict=figures,
        strict_spread=np.full(SHAPE, spread), repeats=repeats,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("found", "blind", "spread", "repeats", "said"),
    [
        (39, 33.0, 0.5, 6.0, "about 6 of 39 are owed"),
        (39, 33.0, 4.0, 6.0, "no more than scenarios and chance give"),  # within the draws' spread
        (37, 33.0, 0.0, 6.0, "no more than scenarios and chance give"),  # within the control's own error
        (7, 2.0, 0.6, 4.0, "about 5 of 7 are owed"),
        (16, 0.6, 0.5, 1.1, "proves nothing"),
        (0, 0.0, 0.0, 6.0, "nothing that could be owed"),
    ],
)
def test_figures_beside_their_control(
    found: float, blind: float, spread: float, repeats: float, said: str
) -> None:
    (sentence,) = in_words([row(found), row(blind, spread=spread, repeats=repeats)], 0.1, 0.2)
    assert sentence.startswith("night: ")
    assert said in sentence


def test_a_campaign_without_a_control_is_passed_over() -> None:
    assert in_words([row(3), row(4), row(1, repeats=5.0)], 0.1, 0.2)[0].startswith("night: strict DBS 4")
    assert in_words([row(3)], 0.1, 0.2) == []
