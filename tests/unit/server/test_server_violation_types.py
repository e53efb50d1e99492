"""Types of violations say in how many further drives of their solutions they were seen again."""

import numpy as np

from brink.search.archive import Archive, Neighbourhood
from brink.search.space import Component, Real, SearchSpace
from brink.server.findings.violations.analysis import seen_again
from brink.server.findings.violations.views import TypeView

SPACE = SearchSpace((Component("traffic", (Real("speed", 0.0, 10.0, "m/s"),)),))


def test_types_say_in_how_many_drives_of_their_solutions_they_were_seen_again() -> None:
    speeds = [1.0, 2.0, 3.0, 1.0, 2.0, 2.0]  # solution 0 again as 3, solution 1 as 4 and 5, solution 2 once
    archive = Archive.empty(SPACE, Neighbourhood(radius=0.3, p_th=0.1, z=1.96)).grown(
        np.arange(6), np.array(speeds)[:, None], np.ones(6, np.bool_), -np.ones(6)
    )
    numbers = {"always": [0, 3], "once of three": [4], "not simulated again": [2], "two solutions": [0, 1, 5]}
    types = [
        TypeView(
            type=name,
            numbers=its,
            solutions=len(its),
            avoided="",
            instances=1,
            first=its[0],
            example=its[0],
            named=0,
            avoidable=None,
            avoider="",
            avoided_by=None,
            avoidable_by={},
            at_fault=False,
        )
        for name, its in numbers.items()
    ]
    told = {one.type: one.again for one in seen_again(types, archive)}
    assert told == {
        "always": "1 of 1",
        "once of three": "0 of 2",
        "not simulated again": "",
        "two solutions": "1 of 3",
    }
