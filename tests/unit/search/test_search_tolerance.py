"""Tolerances: curves of caused violations, and the search that chooses where to simulate."""

import dataclasses
from collections import Counter
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy import stats

from brink.search.algorithm import Candidate, Evaluation, Failed, Scored, ask_all
from brink.search.algorithms.tolerance import (
    FIRST_SCREENED,
    Layout,
    Purpose,
    Tally,
    Tolerance,
    ToleranceConfig,
    ToleranceState,
    tally,
)
from brink.search.curves import LEVELS, Counts, Curve, Screening, curves_of, library, severities, severity_at
from brink.search.document import Document
from brink.search.errors import ConfigError, UnsupportedSpace
from brink.search.space import Categorical, Component, Dormant, FloatArray, Real, SearchSpace

SPACE = SearchSpace(
    (
        Component(
            "scenario",
            (
                Categorical("weather", ("dry", "wet", "fog")),
                Categorical("people", ("0", "18")),
                Real("gap", 1.0, 60.0, "m"),
            ),
        ),
        Component(
            "behaviour",
            (
                Categorical("error_1.type", ("none", "miss", "late", "left")),
                Categorical("error_1.target", ("lead", "pedestrian")),
                Real("error_1.onset", 0.0, 12.0, "s"),
                Real("error_1.severity", 0.0, 1.0),
                Categorical("error_2.type", ("none", "miss")),
            ),
            (Dormant("error_1.type", "none", ("error_1.onset", "error_1.severity")),),
        ),
    )
)
SETTINGS: dict[str, Any] = {
    "severity": "behaviour.error_1.severity",
    "cells": {"error_1.type": ["miss", "late"], "target": ["lead", "pedestrian"]},
    "conditions": [{"name": "by day", "weather": ["dry", "wet"]}, {"weather": "fog"}],
    "fixed": {"error_2.type": "none"},
    "truth": {"error_1.type": "none"},
    "needs": {"target=pedestrian": {"people": ["18"]}},
    "without_error": 20,
    "generation_size": 30,
}


pytestmark = pytest.mark.usefixtures("smaller_library")


def steps(at: float, height: float, scale: float = 0.05) -> FloatArray:
    """Return a curve that rises from 0 to a height around a severity."""
    rise = 1.0 / (1.0 + np.exp((at - severities()) / scale))
    return np.asarray(height * (rise - rise[0]) / (1.0 - rise[0]))


def simulated(curve: FloatArray, drives: int, rng: np.random.Generator) -> Counts:
    """Return the counts of one cell with drives at random severities."""
    levels = rng.integers(1, LEVELS, drives, endpoint=True)
    counts = Counts.empty(1)
    np.add.at(counts.drives[0], levels - 1, 1)
    np.add.at(counts.caused[0], levels - 1, rng.random(drives) < curve[levels])
    return counts


def screening_of(vulnerable: int, screened: int, *, audits: dict[int, tuple[int, int]]) -> Screening:
    """Return a screening, given the audited drives and the leaks by level."""
    audited, leaks = np.zeros(LEVELS, np.int64), np.zeros(LEVELS, np.int64)
    for level, (drives, violating) in audits.items():
        audited[level - 1], leaks[level - 1] = drives, violating
    return Screening(vulnerable=vulnerable, screened=screened, audits=audited, leaks=leaks)


def joined(all_counts: list[Counts]) -> Counts:
    return Counts(
        drives=np.concatenate([one.drives for one in all_counts]),
        caused=np.concatenate([one.caused for one in all_counts]),
    )


def rated(counts: Counts) -> list[Curve]:
    cells = len(counts.drives)
    return curves_of(counts, [None] * cells, [False] * cells, limit=0.05, confidence=0.9)


# The curves.


def test_every_curve_of_the_library_is_a_share_that_begins_at_zero() -> None:
    curves = library(5_000)
    assert curves.shape == (5_000, LEVELS + 1)
    assert (curves[:, 0] == 0).all()
    assert curves.min() >= 0
    assert curves.max() <= 1
    falling = (np.diff(curves, axis=1) < -1e-6).any(axis=1).mean()
    assert 0.05 < falling < 0.2


def test_severity_at_a_limit_is_interpolated_and_infinite_where_it_is_not_reached() -> None:
    shares = np.vstack([severities() * 0.32, severities() * 0.04, np.where(severities() >= 0.5, 0.4, 0.0)])
    assert severity_at(shares, 0.05) == pytest.approx([0.05 / 0.32, np.inf, 15 / 32 + 0.125 / 32])


@cache
def found(kind: str) -> list[tuple[FloatArray, Curve]]:
    """Return true curves and what 150 drives at random severities say of them."""
    rng = np.random.default_rng(3)
    if kind == "rising":
        curves = [
            steps(rng.uniform(0.1, 0.9), rng.choice([0.02, 0.1, 0.3, 0.6]), rng.uniform(0.02, 0.15))
            for _ in range(40)
        ]
    else:
        curves = [steps(0.25, 0.4, 0.04) * (1.0 - steps(0.6, 0.95, 0.05)) for _ in range(5)]
    counts = joined([simulated(curve, 150 if kind == "rising" else 300, rng) for curve in curves])
    return list(zip(curves, rated(counts), strict=True))


def test_intervals_cover_the_tolerated_severity_and_the_curve_as_often_as_they_say() -> None:
    covered, inside = [], []
    for curve, known in found("rising"):
        true = float(severity_at(curve[None], 0.05)[0])
        covered.append(known.tolerated.low <= true <= known.tolerated.high)
        assert known.tolerated.low <= known.tolerated.value <= known.tolerated.high
        relevant = curve > 0.005
        inside += ((known.low <= curve) & (curve <= known.high))[relevant].tolist()
    assert np.mean(covered) >= 0.8
    assert np.mean(inside) >= 0.8


def test_a_fall_is_reported_where_there_is_one_and_nowhere_else() -> None:
    assert [known.fall for _, known in found("rising") if known.fall is not None] == []
    for curve, known in found("falling"):
        assert known.fall is not None
        assert known.fall.from_severity == pytest.approx(float(severities()[np.argmax(curve)]), abs=0.2)
        assert known.fall.from_severity < known.fall.to_severity
        assert known.fall.from_share > known.fall.to_share + 0.1


def test_fresh_drives_lie_in_the_predicted_interval() -> None:
    rng = np.random.default_rng(8)
    hits = []
    for curve, known in found("rising"):
        levels = rng.integers(1, LEVELS, 40, endpoint=True)
        low, high = known.predicted(levels, rng, 0.95)
        hits.append(low <= int((rng.random(40) < curve[levels]).sum()) <= high)
    assert np.mean(hits) >= 0.85


def test_a_screened_curve_is_the_share_of_vulnerable_drives_times_the_curve_among_them() -> None:
    counts = Counts.empty(1)
    counts.drives[0, -1], counts.caused[0, -1] = 300, 150
    trusted = Screening(vulnerable=200, screened=1_000, audits=None, leaks=None)
    (plain,) = rated(counts)
    (screened,) = curves_of(counts, [trusted], [False], limit=0.05, confidence=0.9)
    assert plain.median[-1] == pytest.approx(0.5, abs=0.02)
    assert screened.median[-1] == pytest.approx(0.1, abs=0.02)
    leaking = screening_of(200, 1_000, audits={LEVELS: (150, 30)})
    (leaky,) = curves_of(counts, [leaking], [False], limit=0.05, confidence=0.9)
    assert leaky.median[-1] == pytest.approx(0.2 * 0.5 + 0.8 * 30 / 150, abs=0.02)
    none_of_many = screening_of(0, 200, audits={LEVELS: (100, 0)})
    (safe,) = curves_of(Counts.empty(1), [none_of_many], [False], limit=0.05, confidence=0.9)
    assert np.isinf(safe.tolerated.low)


def test_an_audit_tells_as_much_of_leaks_as_its_severity() -> None:
    at_half, at_full = (screening_of(100, 200, audits={level: (100, 10)}) for level in (LEVELS // 2, LEVELS))
    assert (at_half.exposure, at_full.exposure) == (50.0, 100.0)
    at = np.array([0.05, 0.5, 0.95])
    assert at_full.leak(at) == pytest.approx(stats.beta.ppf(at, 10.5, 90.5), abs=2e-3)
    # Ten in a hundred at severity .5 are twenty in a hundred at severity 1.
    assert at_half.leak(at)[1] == pytest.approx(0.2, abs=0.01)


def test_without_audits_leaks_are_unknown_unless_they_are_taken_on_trust() -> None:
    unknown = screening_of(100, 200, audits={})
    assert unknown.leak(np.array([0.05, 0.5, 0.95])) == pytest.approx([0.006, 0.5, 0.994], abs=1e-3)
    trusted = Screening(vulnerable=100, screened=200, audits=None, leaks=None)
    assert (trusted.leak(np.array([0.5])) == 0.0).all()


# The search.

TRUE = {"miss": steps(0.3, 0.5), "late": steps(0.7, 0.3), "left": steps(0.5, 0.55)}


def drive(candidate: Candidate, root: int, leak: float = 0.0) -> Scored:
    """Violate with a probability that grows with severity; some drives violate without any error.

    Of the drives that hold with the grossest error, some leak in fog with 18 people about.
    """
    row = SPACE.decode(candidate.vectors)
    values = row["behaviour"]
    # One number says how vulnerable a drive is, so that the gross errors cover the milder ones.
    chance = np.random.default_rng([root, int(row["scenario"]["people"])]).random(3)
    kind = str(values["error_1.type"])
    severity = 0.0 if kind == "none" else float(values["error_1.severity"])
    share = 0.0 if kind == "none" else TRUE[kind][round(severity * LEVELS)]
    is_leaking = (
        leak > 0.0 and values["error_1.target"] == "pedestrian" and row["scenario"]["weather"] == "fog"
    )
    leaks = (
        is_leaking
        and kind in ("miss", "late")
        and chance[1] >= TRUE["left"][-1]
        and chance[2] < leak * severity
    )
    unsafe = bool(chance[0] < 0.1 or chance[1] < share or leaks)
    return Scored(unsafe=unsafe, robustness=-1.0 if unsafe else 1.0)


@dataclasses.dataclass
class Played:
    """A finished search with all that it asked for."""

    state: ToleranceState
    asked: list[Candidate]

    @property
    def layout(self) -> Layout:
        return Layout(SPACE, self.state.config)

    @property
    def tally(self) -> Tally:
        archive = self.state.archive
        numbers = archive.numbers.tolist()
        return tally(
            self.layout, archive.vectors, numbers, archive.unsafe, [self.state.drives[n] for n in numbers]
        )

    @property
    def curves(self) -> list[Curve]:
        return self.tally.curves(self.layout, limit=0.05, confidence=0.9)

    def jobs(self, purpose: Purpose) -> Any:
        return self.state.jobs[self.state.jobs[:, 0] == purpose]


def play(
    budget: int = 900,
    seed: int = 1,
    *,
    failing: int = 0,
    reload: bool = False,
    leak: float = 0.0,
    **changes: Any,
) -> Played:
    algorithm, asked = Tolerance(), list[Candidate]()
    config = ToleranceConfig(**{**SETTINGS, **changes})
    state = algorithm.start(SPACE, config, seed=seed, budget=budget)
    roots: dict[int, int] = {}
    while not algorithm.finished(state):
        state, generations = ask_all(algorithm, state)
        asked += [candidate for generation in generations for candidate in generation]
        told: dict[int, Evaluation] = {}
        for candidate in state.pending:
            root = candidate.number if candidate.seed_number is None else candidate.seed_number
            roots[candidate.number] = root
            told[candidate.number] = drive(candidate, root, leak)
            if failing and candidate.number % failing == 1:
                told[candidate.number] = Failed(reason="it crashed")
        state = algorithm.tell(state, told)
        if reload:
            document = Document.from_bytes(algorithm.dump(state).to_bytes())
            state = algorithm.load(SPACE, config, document, state.archive)
    return Played(state, asked)


@pytest.fixture(scope="module")
def played() -> Played:
    return play()


def test_the_search_finds_the_tolerated_severities(played: Played) -> None:
    curves = played.curves
    hits = []
    for cell, curve in zip(played.layout.cells, curves, strict=True):
        true = float(severity_at(0.9 * TRUE[cell.choices[0]][None], 0.05)[0])
        hits.append(curve.tolerated.low - 0.05 <= true <= curve.tolerated.high + 0.05)
    assert sum(hits) >= 7
    assert len(hits) == 8


def test_the_whole_budget_is_spent_and_every_violation_explained(played: Played) -> None:
    assert len(played.asked) == 900
    assert len(played.tally.open_numbers) <= 3


def test_drives_of_all_cells_are_the_same_but_for_what_cell_and_condition_prescribe(played: Played) -> None:
    space, layout = SPACE, played.layout
    gaps: dict[int, set[float]] = {}
    seeds: dict[int, set[int]] = {}
    for candidate in played.asked:
        number = played.state.drives[candidate.number]
        row = space.decode(candidate.vectors)
        gaps.setdefault(number, set()).add(float(row["scenario"]["gap"]))
        root = candidate.number if candidate.seed_number is None else candidate.seed_number
        seeds.setdefault(number, set()).add(root)
        if row["behaviour"]["error_1.target"] == "pedestrian" and row["behaviour"]["error_1.type"] != "none":
            assert row["scenario"]["people"] == "18"
        assert row["behaviour"]["error_2.type"] == "none"
    assert {len(found) for found in gaps.values()} == {1}
    assert {len(found) for found in seeds.values()} == {1}
    assert len({next(iter(found)) for found in seeds.values()}) == len(seeds)
    cells = layout.cells_of(np.array([space.join(c.vectors) for c in played.asked]))
    per_cell = Counter(
        zip(cells.tolist(), [played.state.drives[c.number] for c in played.asked], strict=True)
    )
    assert {count for (cell, _), count in per_cell.items() if cell >= 0} == {1}


def test_a_violation_that_happens_without_the_error_was_not_caused_by_it(played: Played) -> None:
    result, archive = played.tally, played.state.archive
    cells = played.layout.cells_of(archive.vectors)
    assert (archive.unsafe & (cells >= 0)).sum() > result.counts.caused.sum()
    assert sum(violating for violating, _ in result.baseline) > 0
    assert all(drives == 20 for _, drives in result.baseline)
    rows = dict(zip(archive.numbers.tolist(), archive.vectors, strict=True))
    for cell, level, number in result.caused:
        row = rows[number]
        assert played.layout.cells_of(row[None])[0] == cell
        assert played.layout.levels_of(row[None])[0] == level
    assert [level for _, level, _ in result.caused] == sorted(level for _, level, _ in result.caused)


# Screening.

SCREENED: dict[str, Any] = {
    "cells": {"error_1.type": ["miss", "late", "left"], "target": ["lead", "pedestrian"]},
    "grossest": {"error_1.type": "left"},
    "covers": {"error_1.type": ["miss", "late"]},
}


@pytest.fixture(scope="module")
def screened() -> Played:
    return play(1_500, **SCREENED)


def test_only_vulnerable_drives_are_simulated_with_milder_errors(screened: Played) -> None:
    layout, known = screened.layout, screened.tally
    assert len(layout.groups) == 4
    assert [one.choices[0] for one in layout.groups] == ["left"] * 4
    for group, screening in enumerate(known.screenings):
        assert 0 <= screening.vulnerable - len(known.vulnerable[group]) <= len(known.open_numbers)
        assert (
            FIRST_SCREENED
            <= screening.screened
            <= len(known.vulnerable[group]) + len(known.immune[group]) + 30
        )
        assert 0.3 < screening.vulnerable / screening.screened < 0.75
    vulnerable = [{drive for drive, _ in found} for found in known.vulnerable]
    immune = [{drive for drive, _ in found} for found in known.immune]
    for _, cell, drive in screened.jobs(Purpose.ERROR).tolist():
        assert drive in vulnerable[layout.cells[cell].group or 0]
    audits = screened.jobs(Purpose.AUDIT).tolist()
    assert all(drive in immune[layout.cells[cell].group or 0] for _, cell, drive in audits)
    for group, screening in enumerate(known.screenings):
        mine = [cell for _, cell, _ in audits if layout.cells[cell].group == group]
        assert screening.audited == len(mine) > 3
        assert screening.leaked == 0


def test_screening_finds_the_same_severities(screened: Played) -> None:
    hits = []
    for cell, curve in zip(screened.layout.cells, screened.curves, strict=True):
        true = float(severity_at(0.9 * TRUE[cell.choices[0]][None], 0.05)[0])
        hits.append(curve.tolerated.low - 0.05 <= true <= curve.tolerated.high + 0.05)
    assert len(hits) == 12
    assert sum(hits) >= 10


def test_leaks_count_in_their_own_group_and_at_their_own_severity() -> None:
    ended = play(1_200, leak=0.4, audit=0.25, **SCREENED)
    vulnerable = TRUE["left"][-1]
    for cell, curve in zip(ended.layout.cells, ended.curves, strict=True):
        if cell.choices[0] == "left":
            continue
        leaking = cell.choices[1] == "pedestrian" and cell.condition == "fog"
        true = TRUE[cell.choices[0]] + (1.0 - vulnerable) * (0.4 * severities() if leaking else 0.0)
        assert curve.low[-1] <= 0.9 * true[-1] <= curve.high[-1], cell
        if leaking:
            reached = float(severity_at(0.9 * true[None], 0.05)[0])
            assert curve.tolerated.low - 0.05 <= reached <= curve.tolerated.high + 0.05, cell


def test_simulations_go_where_the_limit_may_be_reached(played: Played) -> None:
    adaptive, uniform = played, play(design="uniform")
    widths = []
    for one in (adaptive, uniform):
        curves = one.curves
        widths.append(np.mean([min(c.tolerated.high, 1.0) - min(c.tolerated.low, 1.0) for c in curves]))
    assert widths[0] < widths[1]
    drives = uniform.tally.counts.drives
    assert np.ptp(drives.sum(axis=1)) <= 1
    assert set(np.flatnonzero(drives.sum(axis=0)) + 1) == set(range(4, 33, 4))


def test_failed_drives_count_nowhere_and_are_not_repeated() -> None:
    ended = play(600, failing=7)
    assert len(ended.asked) == 600
    assert ended.tally.counts.drives.sum() + sum(drives for _, drives in ended.tally.baseline) < 600 - 80


def test_a_stored_search_continues_as_if_it_had_not_been_stored() -> None:
    again, undisturbed = (play(350, reload=reload) for reload in (True, False))
    assert np.array_equal(again.state.archive.vectors, undisturbed.state.archive.vectors)
    assert [c.seed_number for c in again.asked] == [c.seed_number for c in undisturbed.asked]


def test_without_cells_there_is_one_for_each_condition() -> None:
    layout = Layout(SPACE, ToleranceConfig(**{**SETTINGS, "cells": {}, "needs": {}}))
    assert [(cell.choices, cell.condition) for cell in layout.cells] == [((), "by day"), ((), "fog")]


@pytest.mark.parametrize(
    ("changes", "field", "words"),
    [
        ({"cells": {"typ": ["miss"]}}, "cells", "unknown parameter 'typ'"),
        (
            {"cells": {"type": ["miss"]}},
            "cells",
            "may be any of behaviour.error_1.type, behaviour.error_2.type",
        ),
        ({"cells": {"error_1.type": ["misss"]}}, "cells", "did you mean 'miss'"),
        ({"cells": {"error_1.type": []}}, "cells", "one or more distinct choices"),
        ({"cells": {"gap": ["1"]}}, "cells", "a parameter with choices"),
        ({"severity": "gap"}, "severity", "a number from 0 to 1"),
        ({"conditions": []}, "conditions", "one condition or more"),
        ({"conditions": [{"weather": "snow"}]}, "conditions", "expected one of dry, wet, fog"),
        ({"conditions": [{"weather": "dry"}, {"weather": ["dry", "fog"]}]}, "conditions", "overlap"),
        ({"conditions": [{"weather": "dry"}, {"people": "0"}]}, "conditions", "overlap"),
        (
            {"conditions": [{"name": "a", "weather": "dry"}, {"name": "a", "weather": "wet"}]},
            "conditions",
            "own",
        ),
        ({"conditions": [{"target": "lead"}]}, "conditions", "distinguishes the cells"),
        (
            {"conditions": [{"people": "0"}]},
            "conditions",
            "pedestrian under 0: expected scenario.people to allow 18",
        ),
        ({"fixed": {"gap": 100.0}}, "fixed", "expected a number in"),
        ({"grossest": {"error_1.type": "gone"}}, "grossest", "expected one of none, miss, late, left"),
        ({"grossest": {"error_1.type": "left"}}, "covers", "the same parameters as in grossest"),
        (
            {**SCREENED, "covers": {"error_1.type": ["gone"]}},
            "covers",
            "expected one of none, miss, late, left",
        ),
        ({"levels": 5}, "levels", "a divisor of 32"),
        ({"design": "clever"}, "design", "expected one of"),
    ],
)
def test_settings_that_do_not_fit_are_refused(changes: dict[str, Any], field: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words) as refused:
        Tolerance().check(SPACE, ToleranceConfig(**{**SETTINGS, **changes}), budget=10_000)
    assert refused.value.field == field


def test_a_budget_that_does_not_reach_every_cell_is_refused() -> None:
    with pytest.raises(ConfigError, match="expected at least the 144 simulations"):
        Tolerance().check(SPACE, ToleranceConfig(**SETTINGS), budget=143)


def test_a_space_without_severity_is_refused() -> None:
    space = SearchSpace((Component("scenario", (Real("gap", 1.0, 60.0, "m"),)),))
    with pytest.raises(UnsupportedSpace, match="severity"):
        Tolerance().check(space, ToleranceConfig(), budget=1_000)


def test_an_audited_drive_that_violates_anyway_is_no_leak(screened: Played) -> None:
    archive, state, layout = screened.state.archive, screened.state, screened.layout
    numbers = archive.numbers.tolist()
    truths = {
        (of, drive): n
        for n in numbers
        for kind, of, drive in [state.jobs[n].tolist()]
        if kind == Purpose.TRUTH
    }
    audit, truth = next(
        (n, truths[layout.cells[cell].population, drive])
        for n in numbers
        for kind, cell, drive in [state.jobs[n].tolist()]
        if kind == Purpose.AUDIT and (layout.cells[cell].population, drive) in truths
    )
    drives = [state.drives[n] for n in numbers]
    for also, leaks in ((False, 1), (True, 0)):
        verdicts = archive.unsafe.copy()
        verdicts[numbers.index(audit)], verdicts[numbers.index(truth)] = True, also
        changed = tally(layout, archive.vectors, numbers, verdicts, drives)
        own = layout.cells[state.jobs[audit][1]].group
        assert [one.leaked for one in changed.screenings] == [
            leaks if group == own else 0 for group in range(len(layout.groups))
        ]
        assert audit not in changed.open_numbers


def test_a_failed_drive_without_an_error_is_simulated_again() -> None:
    ended = play(900, failing=5, **SCREENED)
    tries = Counter((of, drive) for _, of, drive in ended.jobs(Purpose.TRUTH).tolist())
    assert 2 <= max(tries.values()) <= 3
    assert len(ended.tally.open_numbers) <= 8


def test_an_interval_is_no_narrower_than_its_curves_support() -> None:
    rng = np.random.default_rng(6)
    curves = [steps(at, 0.4, 0.05) for at in (0.3, 0.5, 0.7)]
    for curve, known in zip(
        curves, rated(joined([simulated(one, 20_000, rng) for one in curves])), strict=True
    ):
        assert len(np.unique(known.draws, axis=0)) > 1_000
        assert 0.005 < known.tolerated.width < 0.08
        true = float(severity_at(curve[None], 0.05)[0])
        assert known.tolerated.value == pytest.approx(true, abs=known.tolerated.width)


def test_an_error_without_effect_is_tolerated_throughout() -> None:
    counts = Counts.empty(1)
    counts.drives[0, -1] = 200
    (known,) = rated(counts)
    assert np.isinf(known.tolerated.low)
    assert known.high[-1] < 0.05


def test_few_vulnerable_drives_of_few_screened_leave_the_answer_open() -> None:
    few = screening_of(3, 40, audits={LEVELS: (100, 0)})
    (curve,) = curves_of(Counts.empty(1), [few], [False], limit=0.05, confidence=0.9)
    assert np.isfinite(curve.tolerated.low)


def test_all_vulnerable_drives_violate_with_the_grossest_error(screened: Played) -> None:
    for cell, curve in zip(screened.layout.cells, screened.curves, strict=True):
        if screened.layout.is_grossest(cell):
            share = screened.tally.screenings[cell.group or 0]
            vulnerable = share.vulnerable / share.screened
            leaking = (1.0 - vulnerable) * share.leak(np.array([0.5]))[0]
            assert curve.median[-1] == pytest.approx(vulnerable + leaking, abs=0.03)
            assert curve.drives[-1] == 0
