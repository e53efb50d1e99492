"""The comparison of the searches for thresholds and pairs."""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks import finder_runs
from benchmarks.cli import bench
from benchmarks.finder_curves import Driven, curves_table, figure_curves, places_of
from benchmarks.finder_runs import End, Estimated, Run, Runner, estimated_thresholds, pairs_to_sharpen
from benchmarks.finders import (
    CASES,
    FINDERS,
    FOLLOWED,
    Comparison,
    Found,
    Tally,
    Task,
    duels,
    run_or_read,
    runner_of,
    standings,
)
from brink.api.terminal import PlainConsole
from brink.search.algorithm import Scored
from brink.search.problems import mtq_gap_to_boundary
from brink.search.sequential import FIRST


@pytest.mark.parametrize("problem", CASES)
def test_every_search_can_run_on_every_problem(problem: str) -> None:
    runner = runner_of(problem)
    for name in FINDERS.values():
        plan = runner.plan_of(name, {}, 1300)
        plan.algorithm.check(plan.problem.space, plan.config, budget=1300)


def task(folder: Path, method: str, *, followed: bool, budget: int = 150) -> Task:
    return Task(problem="mtq", method=method, followed=followed, seed=1, budget=budget, folder=folder)


@pytest.mark.parametrize("followed", [False, True])
def test_a_run_spends_its_budget_and_no_more(tmp_path: Path, followed: bool) -> None:
    found = run_or_read(task(tmp_path, "random search", followed=followed))
    least = 150 - finder_runs.USUAL_SHARP if followed else 150
    assert least <= found.run.simulations <= 150
    assert len(found.run.parts) > 1 if followed else len(found.run.parts) == 1
    assert len(found.run.parts[0].rows) == (75 if followed else 150)


def test_the_estimation_that_follows_finds_places_on_the_boundary(tmp_path: Path) -> None:
    alone, followed = (
        run_or_read(task(tmp_path, "random search", followed=followed)) for followed in (False, True)
    )
    assert not alone.thresholds
    assert len(followed.thresholds) >= 3
    space = runner_of("mtq").problem.space
    for one in followed.thresholds:
        row = one.at(space, one.middle)
        assert row is not None
        assert mtq_gap_to_boundary(*row.tolist()) < CASES["mtq"].eps
        assert one.holds
        assert one.confirmed
    tally = Tally.of(followed)
    assert (tally.thresholds, tally.hold, tally.confirmed) == (len(followed.thresholds),) * 3
    assert 1 <= tally.kinds <= tally.distinct <= tally.thresholds
    assert (tally.narrow, tally.percent) == (None, None)


def test_a_completed_run_is_read_and_not_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = run_or_read(task(tmp_path, "GA", followed=True))
    monkeypatch.setattr(Runner, "search", None)
    again = run_or_read(task(tmp_path, "GA", followed=True))
    assert (again.run, again.thresholds, again.pairs) == (first.run, first.thresholds, first.pairs)
    with pytest.raises(TypeError):
        run_or_read(task(tmp_path, "GA", followed=False))


def test_pairs_to_sharpen_are_apart_and_the_nearest_come_first() -> None:
    runner, run = runner_of("mtq"), Run()
    part = runner.search(run, "random@1", {}, seed=1, budget=200)
    space = runner.problem.space
    pairs = pairs_to_sharpen(space, part, eps=0.002, d_th=0.1)
    assert len(pairs) >= 3
    lengths = [float(np.abs(safe - unsafe).mean()) for safe, unsafe in pairs]
    assert lengths == sorted(lengths)
    middles = [0.5 * (safe + unsafe) for safe, unsafe in pairs]
    gaps = [np.abs(a - b).mean() for place, a in enumerate(middles) for b in middles[:place]]
    assert min(gaps) >= 0.1
    for safe, unsafe in pairs:
        verdicts = [runner.outcome(row, 0)[0] for row in (safe, unsafe)]
        assert [isinstance(one, Scored) and one.unsafe for one in verdicts] == [False, True]


def test_comparison_has_each_rival_alone_and_followed(tmp_path: Path) -> None:
    made = Comparison("mtq", ["edge@2", "GA"], seeds=2, budget=200, folder=tmp_path)
    assert [(one.label, one.seed) for one in made.tasks] == [
        (label, seed) for seed in (1, 2) for label in ("edge@2", "GA", f"GA{FOLLOWED}")
    ]
    assert len({one.file for one in made.tasks}) == 6
    followed = Comparison("mtq", ["edge@2", "GA"], seeds=1, budget=200, folder=tmp_path, alone=False)
    assert [one.label for one in followed.tasks] == ["edge@2", f"GA{FOLLOWED}"]


def tally(method: str, seed: int, distinct: int) -> Tally:
    return Tally(
        method=method,
        seed=seed,
        simulations=100,
        pairs=3,
        narrow=None,
        thresholds=5,
        hold=4,
        confirmed=3,
        distinct=distinct,
        kinds=2,
        search_cpu_s=1.0,
        search_s=2.0,
        percent=None,
    )


def test_methods_are_compared_with_edge_2_after_correction() -> None:
    tallies = [tally("edge@2", seed, 10 + seed) for seed in range(1, 9)]
    tallies += [tally(f"GA{FOLLOWED}", seed, seed) for seed in range(1, 9)]
    tallies += [tally(f"BSV{FOLLOWED}", seed, 10 + seed) for seed in range(1, 9)]
    tallies += [tally("BSV", seed, 0) for seed in range(1, 9)]
    first, second = duels(tallies, "distinct")
    assert "14.5 against 4.5 distinct confirmed thresholds, A12 1.00 (large)" in first
    assert first.endswith("edge@2 finds more")
    assert second.endswith("these repeats show no difference")
    assert not duels(tallies[8:], "distinct")
    assert standings(tallies)[0] | {"method": ""} == standings(tallies)[2] | {"method": ""}
    assert standings(tallies)[0]["narrow"] is None


LINE = Estimated(
    name="x.x",
    columns=[0],
    leading=0,
    kind=["x", "unsafe"],
    row=[0.5, 0.75],
    slopes=[1.0],
    middle=0.55,
    low=0.54,
    high=0.56,
    start=0.56,
    end=0.54,
    resolution=0.002,
    range=1.0,
    drives=30,
    ends=[End(unsafe=4, drives=20, holds=False), End(unsafe=20, drives=20, holds=True)],
    curve=[[0.5, 0.6], [1.0, 0.0], [0.9, 0.0], [1.0, 0.1]],
)


def test_a_threshold_holds_if_neither_share_contradicts_it() -> None:
    assert LINE.holds
    assert not LINE.confirmed, "4 of 20 do not show that at most 20% are unsafe"
    five = replace(LINE, ends=[End(unsafe=5, drives=20, holds=False), LINE.ends[1]])
    none = replace(LINE, ends=[End(unsafe=0, drives=0, holds=False), LINE.ends[1]])
    assert not five.holds
    assert not none.holds, "there is no drive that says so"


def test_a_chancy_end_is_not_confirmed(monkeypatch: pytest.MonkeyPatch) -> None:
    runner = runner_of("front-gap")
    verdicts = iter([False] * (FIRST - 1) + [True] + [False] * 2 * finder_runs.FRESH)

    def fresh(*args: Any) -> Iterator[tuple[Scored, None]]:
        return ((Scored(unsafe=next(verdicts), robustness=0.0), None) for _ in range(args[-1]))

    monkeypatch.setattr(Runner, "fresh", fresh)
    end, _ = runner.end(np.zeros(runner.problem.space.dimension), 1, 0, unsafe=False)
    assert end == End(unsafe=1, drives=20, holds=False)
    end, _ = runner.end(np.zeros(runner.problem.space.dimension), 1, 0, unsafe=False)
    assert end == End(unsafe=0, drives=20, holds=True)


def driven(values: list[float], unsafe: list[bool], one: Estimated = LINE) -> Driven:
    mine = task(Path(), "edge@2", followed=False)
    found = Found(task=mine, run=Run(), thresholds=[one], pairs=0, narrow=[])
    return Driven(found=found, one=one, values=values, unsafe=unsafe)


def test_the_driven_middle_is_where_the_share_passes_one_half() -> None:
    values = np.linspace(0.5, 0.6, 11).tolist()
    falling = driven(values, [True, True, True, True, False, True, False, False, False, False, False])
    assert 0.53 < falling.middle < 0.56
    assert falling.is_inside
    rising = driven(values, [value > 0.585 for value in values], replace(LINE, start=0.54, end=0.56))
    assert math.isclose(rising.middle, 0.585)
    assert not rising.is_inside
    never = driven(values, [False] * 11, replace(LINE, start=0.54, end=0.56))
    assert math.isnan(never.middle)
    assert not never.is_inside
    screen = PlainConsole(width=200)
    with screen.capture() as captured:
        screen.print(curves_table([falling, rising, never]))
    text = captured.get()
    assert "1 of 3 driven 50% points within the 90% interval" in text
    assert "none" in text
    figure = figure_curves([falling, rising, never], "Thresholds")
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    states = [title.split(". ")[1].split(":")[0] for title in titles if title]
    assert states == ["inside", "outside", "outside"]


def test_a_threshold_is_driven_again_on_its_line_alone() -> None:
    wide = places_of(replace(LINE, curve=[[0.0, 1.0], *LINE.curve[1:]]))
    assert min(wide) < 0.53
    assert max(wide) > 0.57
    window = places_of(replace(LINE, curve=[[0.535, 0.565], *LINE.curve[1:]]))
    assert (min(window), max(window)) == (0.535, 0.565), "drives further on are safe again"
    assert len(wide) == len(window) == 200


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--problem", "x"], "expected one of urban-errors, front-gap, lane-keeping, mtq; got 'x'"),
        (["--method", "y"], "expected one of edge@2, edge@1"),
        (["--problem", "front-gap", "--method", "GA", "--curves", "3"], "expected --method edge@2"),
        (["--problem", "mtq", "--curves", "3"], "expected a problem with chance; mtq has none"),
    ],
)
def test_wrong_options_are_refused(options: list[str], message: str) -> None:
    ran = CliRunner().invoke(bench, ["finders", *options])
    assert ran.exit_code != 0
    assert message in str(ran.exception)


@pytest.mark.long("simulates drives")
def test_thresholds_of_drives_are_simulated_again(tmp_path: Path) -> None:
    runner, run = runner_of("urban-errors"), Run()
    part = runner.search(run, "random@1", {}, seed=1, budget=120)
    pairs = pairs_to_sharpen(runner.problem.space, part, eps=0.02, d_th=0.2)
    runner.sharpen(run, pairs, seed=1, budget=180)
    assert run.simulations <= 300
    assert run.drives_cpu_s > 0
    for one in estimated_thresholds(runner, run):
        assert all(end.drives in (0, finder_runs.FRESH) for end in one.ends)
        assert one.kind
