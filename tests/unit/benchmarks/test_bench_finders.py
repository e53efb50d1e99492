"""The comparison of the searches for pairs."""

from pathlib import Path
from typing import Any

import pytest

from benchmarks.finders import CASES, FINDERS, Tally, experiment, run_finders, standings
from brink.api.terminal import PlainConsole
from brink.search.analysis.confirmation import Confirmation
from brink.server.campaigns.plan import make_checked_plan
from brink.server.experiments.pairs import check_pairs
from brink.server.findings.pairs.views import ChangeView, ConfirmationView, PairNature, PairsView, PairView


@pytest.mark.parametrize("problem", CASES)
def test_every_search_can_run_on_every_problem(problem: str) -> None:
    body = experiment(problem, simulations=1300, seeds=10, methods=list(FINDERS))
    assert body.campaigns == 10 * len(FINDERS)
    check_pairs(body)
    for cell in body.cells()[: len(FINDERS)]:
        make_checked_plan(cell.body)


def view_of(kind: Any, **values: Any) -> Any:
    """Return a view with some of its values."""
    return kind.model_construct(**values)


def change(moved: float | None, *, active: bool | None = True) -> ChangeView:
    made: ChangeView = view_of(ChangeView, moved=moved, active=active)
    return made


def pair(state: Confirmation, nature: PairNature, *changes: ChangeView) -> PairView:
    confirmation = view_of(ConfirmationView, state=state)
    made: PairView = view_of(PairView, confirmation=confirmation, nature=nature, changes=list(changes))
    return made


def test_pairs_that_hold_are_told_apart_by_what_changes() -> None:
    held, numbers = Confirmation.CONFIRMED, PairNature.NUMBERS
    pairs = [
        pair(held, numbers, change(0.05)),
        pair(
            held, numbers, change(0.02), change(0.5, active=False)
        ),  # the second had no part in either drive
        pair(held, numbers, change(0.02), change(0.02)),
        pair(held, numbers, change(0.3)),
        pair(held, PairNature.CATEGORY, change(None)),
        pair(held, PairNature.SCENARIO, change(None)),
        pair(Confirmation.REFUTED, numbers, change(0.01)),
        pair(Confirmation.UNDECIDED, PairNature.CATEGORY, change(None)),
    ]
    view = view_of(PairsView, pairs=pairs, distinct=len(pairs))
    mine = Tally.of("edge", 1, view, computed=False)
    assert (mine.pairs, mine.held, mine.numbers, mine.narrow) == (8, 6, 4, 2)
    assert (mine.category, mine.scenario) == (1, 1)
    computed = Tally.of("edge", 2, view, computed=True)
    assert (computed.held, computed.numbers, computed.narrow, computed.category) == (8, 5, 3, 2)
    [row] = standings([mine, computed])
    assert (row["method"], row["campaigns"], row["held"], row["narrow"]) == ("edge", 2, 7.0, 2.5)


@pytest.mark.long("runs campaigns")
def test_an_experiment_runs_and_is_continued_by_the_same_call(tmp_path: Path) -> None:
    screen = PlainConsole(width=160)
    body = experiment("mtq", simulations=150, seeds=2, methods=["nearest opposite", "random search"])
    given: dict[str, Any] = {"database": f"sqlite:///{tmp_path / 'brink.db'}", "out": tmp_path / "out"}
    tallies = run_finders(body, screen, **given, workers=1)
    assert tallies is not None
    assert [(one.method, one.seed) for one in tallies] == [
        (method, seed) for seed in (1, 2) for method in ("nearest opposite", "random search")
    ]
    mine, theirs = standings(tallies)
    assert mine["narrow"] > 2 > theirs["held"]
    with screen.capture() as captured:
        assert run_finders(body, screen, **given, workers=1) == tallies
    assert "--new starts another" in captured.get()
