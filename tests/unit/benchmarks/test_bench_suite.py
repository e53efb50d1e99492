"""Suites beside repeats, and of other planners: figures are of the right drives."""

import numpy as np

from benchmarks.suite import _beside_repeats, hazard_rows
from brink.search.analysis.suite import verdict_on
from brink.search.wald import Decision
from brink.server.suites.results import CaseResult


def case(decision: str, found: str = "unsafe") -> CaseResult:
    said = Decision(decision)
    return CaseResult(
        name=found,
        system="own",
        found=found,
        expect=found,
        verdict=verdict_on(said, found),
        passed=True,
        decision=said,
        evaluated=5,
    )


def test_hazards_of_others_are_shares_of_what_the_own_system_does() -> None:
    own = [case(said) for said in ("unsafe", "unsafe", "unsafe", "safe", "safe", "unclear")]
    again = [case(said) for said in ("unsafe", "safe", "unclear", "unsafe", "safe", "unsafe")]
    hazards, broken = hazard_rows("other", own, again)
    assert (round(hazards.value), round(broken.value)) == (33, 50)
    assert "1 of 3, 90% interval 2 to 86%" in hazards.note
    assert "1 safe" in hazards.note
    assert "1 unclear" in hazards.note
    assert "1 of 2" in broken.note


def test_only_clear_drives_must_have_the_right_verdict() -> None:
    cases = [case("unsafe"), case("safe", "safe"), case("unclear"), case("unsafe")]
    right, wrong, *_ = _beside_repeats("nothing changed", cases, np.array([1.0, 0.0, 0.5, 0.5]))
    assert (right.value, right.met) == (100, True)
    assert right.note == "2 of 4 drives are clear in the repeats"
    assert wrong.met is False
    assert wrong.note == "1 of 3; opposite: 0"
