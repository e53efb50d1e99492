"""Numbers, ranges and requirements as the report of a campaign tells them."""

import numpy as np
import pytest

from brink.report.campaign_words import constants, ranges, share
from brink.search.analysis.dependence import parameter_columns
from brink.search.space import Categorical, Component, Dormant, Integer, Real, SearchSpace


@pytest.mark.parametrize(
    ("part", "whole", "words"),
    [(0, 10, "0%"), (10, 10, "100%"), (1, 3, "33%"), (1, 1000, "0.10%"), (999, 1000, "99.90%"), (0, 0, "–")],
)
def test_a_share_is_never_rounded_to_none_or_all(part: int, whole: int, words: str) -> None:
    assert share(part, whole) == words


def test_parameters_that_differ_in_digits_alone_share_a_row() -> None:
    space = SearchSpace(
        (
            Component(
                "scenario", (Categorical("weather", tuple(f"w{n}" for n in range(14))), Real("x", 0, 1))
            ),
            Component(
                "users",
                (
                    Real("p1.speed", 0, 15, "m/s"),
                    Real("p2.speed", 0, 15, "m/s"),
                    Integer("p3.speed", 0, 9, "m/s"),
                ),
            ),
        )
    )
    rows = np.array([[n, 0.1 * n, 1.0, 2.0, 3.0] for n in range(14)])
    rows[:3, 2:] = 0.5
    weather, x, *users = ranges(parameter_columns(space, rows))
    assert weather.values == f"{', '.join(f'w{n}' for n in range(12))} and 2 more"
    assert x.values == "0 to 1 (no unit)"
    assert [(one.names, one.values) for one in users] == [
        ("p*.speed (2 parameters)", "0 to 15 m/s"),
        ("p3.speed", "0 to 9 m/s"),
    ]


def test_only_what_occurred_was_varied() -> None:
    kind = Categorical("type", ("none", "miss", "late", "ghost"))
    dormant = Dormant(label="type", null_choice="none", members=("severity", "onset_s"))
    parameters = (kind, Real("severity", 0, 1), Real("onset_s", 0, 12, "s"), Real("distance_m", 0, 9, "m"))
    space = SearchSpace((Component("behaviour", parameters, constraints=(dormant,)),))
    rows = np.array([[0, 0, 0, 3], [1, 0.2, 4, 3], [1, 0.7, 4, 3], [2, 0.7, 4, 3]], dtype=float)
    recorded = np.array([[True, True, True, False]] * 4)
    columns = parameter_columns(space, rows, recorded)
    assert [(one.names, one.values) for one in ranges(columns)] == [
        ("type", "none, miss, late"),
        ("severity", "0 to 1 (no unit)"),
    ]
    assert [(one.names, one.values) for one in constants(columns)] == [
        ("onset_s", "4 s"),
        ("distance_m", "had no part"),
    ]
