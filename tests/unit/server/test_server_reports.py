"""Reports: experiment tables against scipy and naive recomputation, and the detections of a component."""

import csv
import itertools
import re
import shutil
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from support.traces import make_trace

from brink.plots.experiment import EXPERIMENT_FIGURES, figure_found
from brink.report.component import COLUMNS, DetectionCounts, box_rows, count_detections, write_boxes
from brink.report.experiment import ReportedFound, html_report, markdown_report
from brink.report.experiment_found import PAIRS
from brink.search.analysis.boundary import dbs, strict_dbs
from brink.search.analysis.comparison import Line, Repeat, duels, standings
from brink.search.analysis.count_comparison import ProblemMeasure, by_method, count_duels
from brink.search.analysis.pair_comparison import PairRepeat, PairStanding
from brink.search.analysis.paper import D_THS, PAPER_D_THS, PAPER_FRACTIONS, PAPER_T_BS, Measure
from brink.search.analysis.scores import Control, Figures, Scores, scored
from brink.search.archive import Archive, Neighbourhood
from brink.search.testing import example_spaces
from brink.server.experiments.body import parse_experiment
from brink.server.findings.experiments import ExperimentPairs
from brink.sim.trace import BOX_COLUMNS, Ragged, Trace

SHAPE = (len(PAPER_FRACTIONS), len(PAPER_T_BS), len(D_THS))
METHODS = {"MLCSHE": 30, "GA": 18, "RS <b>": 4}
SEEDS = 10


def make_repeats() -> list[Repeat]:
    rng = np.random.default_rng(5)
    repeats = []
    for seed, (method, level) in itertools.product(range(SEEDS), METHODS.items()):
        grown = np.cumsum(rng.poisson(level / 10, SHAPE), axis=0).astype(float)
        blind = Control(
            figures=Figures(dbs=grown * 0.8, strict=grown * 0.5),
            unsafe_share=0.2,
            spread=np.ones(SHAPE[1:]),
            repeats=1.1 if method.startswith("RS") else 6.0,
        )
        scores = Scores(
            evaluated=1300, unsafe=300, figures=Figures(dbs=grown, strict=grown * 0.7), control=blind
        )
        repeats.append(
            Repeat(problem="gap", method=method, seed=seed, campaign=f"c{seed}{method[:2]}", scores=scores)
        )
    return repeats


REPEATS = make_repeats()


def values(line: Line, measure: Measure, i: int, j: int) -> list[float]:
    found = []
    for repeat in REPEATS:
        if repeat.method == line.method:
            figures = (
                repeat.scores.control.figures
                if line.control and repeat.scores.control
                else repeat.scores.figures
            )
            found.append(float(measure.of(figures)[-1, i, j]))
    return found


def test_standings_have_means_with_student_intervals() -> None:
    table = standings(REPEATS)
    assert len(table) == 6 * 2 * len(PAPER_T_BS) * len(D_THS)
    for one in table[::7]:
        sample = values(one.line, one.measure, PAPER_T_BS.index(one.t_b), D_THS.index(one.d_th))
        assert one.value.mean == pytest.approx(np.mean(sample))
        low, high = stats.t.interval(0.95, SEEDS - 1, loc=np.mean(sample), scale=stats.sem(sample))
        assert (one.value.low, one.value.high) == pytest.approx((low, high))


def test_duels_agree_with_scipy_and_the_definitions_of_the_paper() -> None:
    table = duels(REPEATS)
    assert {(d.first.method, d.second.method) for d in table if not d.second.control} == set(
        itertools.combinations(METHODS, 2)
    )
    assert {d.first.method for d in table if d.second.control} == set(METHODS)
    for measure in Measure:
        family = [d for d in table if d.measure is measure]
        p_values, adjusted_here = [], []
        for duel in family:
            i, j = PAPER_T_BS.index(duel.t_b), PAPER_D_THS.index(duel.d_th)
            a, b = values(duel.first, measure, i, j), values(duel.second, measure, i, j)
            reference = stats.mannwhitneyu(a, b, alternative="two-sided")
            assert (duel.result.u, duel.result.p_value) == pytest.approx(
                (reference.statistic, reference.pvalue)
            )
            wins = sum((x > y) + (x == y) / 2 for x, y in itertools.product(a, b))
            assert duel.result.a12 == pytest.approx(wins / SEEDS**2)
            if len({*a, *b}) > 1:
                p_values.append(reference.pvalue)
                adjusted_here.append(duel.adjusted)
            else:
                assert (duel.result.p_value, duel.adjusted) == (None, None)
        order = np.argsort(p_values)
        steps = np.array(p_values)[order] * np.arange(len(p_values), 0, -1)
        adjusted = np.minimum(np.maximum.accumulate(steps), 1)
        assert [adjusted_here[k] for k in order] == pytest.approx(adjusted.tolist())


def test_scores_by_budget_use_the_results_known_at_the_time() -> None:
    space = example_spaces()["mixed"]
    rng = np.random.default_rng(3)
    rows = np.array([space.join(space.sample(rng)) for _ in range(260)])
    unsafe = rows[:, 0] + rng.random(260) < 0.9
    kept = np.setdiff1d(np.arange(260), [3, 77])  # two failed
    near = Neighbourhood(radius=0.3, p_th=0.1)
    whole = Archive.empty(space, near).grown(kept, rows[kept], unsafe[kept], np.zeros(kept.size))
    scores = scored(whole, space, simulations=200, seed=1)
    assert scores.evaluated == 198, "solutions beyond the budget are not counted"
    for k, fraction in enumerate(PAPER_FRACTIONS):
        known = kept[kept < round(200 * fraction)]
        naive = Archive.empty(space, near).grown(known, rows[known], unsafe[known], np.zeros(known.size))
        for (i, t_b), (j, d_th) in itertools.product(enumerate(PAPER_T_BS), enumerate(D_THS)):
            assert scores.figures.dbs[k, i, j] == dbs(naive, t_b, d_th)
            assert scores.figures.strict[k, i, j] == strict_dbs(naive, t_b, d_th)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("report")


@pytest.fixture(scope="module")
def report(folder: Path) -> str:
    """The report in Markdown, with its pictures in `folder`."""
    body = parse_experiment(
        {
            "name": "rq1 <script>",
            "problems": [{"name": "gap", "id": "mtq@1"}],
            "algorithms": [{"name": name, "id": "ga@1"} for name in METHODS],
            "seeds": {"count": SEEDS + 1},
            "budget": {"simulations": 1300},
        }
    )
    pictures = {}
    for place, (kind, draw) in enumerate(EXPERIMENT_FIGURES.items()):
        file = folder / f"{kind}.png"
        draw(REPEATS, "gap", list(Measure)[place % 2]).savefig(file, dpi=30)
        for measure in Measure:
            name = f"{measure}-{kind}.png"
            shutil.copy(file, folder / name)
            pictures["gap", measure, kind] = name
    return markdown_report(
        body,
        REPEATS,
        pictures,
        experiment="3f2a",
        created_at=datetime(2026, 1, 2, tzinfo=UTC),
        elapsed_s=3700,
    )


def rows_below(report: str, heading: str, measure: str = "DBS") -> list[list[str]]:
    """Return the cells of the table below a heading of the section of a measure, without names of columns."""
    section = re.split(r"^## ", report, flags=re.MULTILINE)
    [text] = [one for one in section if one.splitlines()[0].lower() == measure.lower()]
    table = text.split(f"### {heading}\n\n")[1].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in table]


def test_differences_are_given_at_each_tenth_of_the_budget(report: str) -> None:
    rows = rows_below(report, "Differences by share of the budget")
    assert len(rows) == 3 * len(PAPER_T_BS)
    [row] = [row for row in rows if row[:2] == ["MLCSHE − GA", "0.1"]]
    grown = {
        method: [one.scores.figures.dbs[:, 3, 1] for one in REPEATS if one.method == method]
        for method in METHODS
    }
    for cell, ours, theirs in zip(
        row[2:], np.transpose(grown["MLCSHE"]), np.transpose(grown["GA"]), strict=True
    ):
        p_value = stats.mannwhitneyu(ours, theirs, alternative="two-sided").pvalue
        difference = f"{np.mean(ours) - np.mean(theirs):+.1f}"
        assert cell == (f"**{difference}**" if p_value <= 0.01 else difference)
    assert "**MLCSHE** minus **GA** over the budget: DBS +" in report
    assert "significant at 0.01, without correction, from" in report


def test_comparisons_as_in_the_paper_are_not_corrected(report: str) -> None:
    rows = rows_below(report, "Comparisons as in the paper")
    assert len(rows) == 3 * len(PAPER_D_THS), "methods only, no controls"
    [row] = [row for row in rows if row[:2] == ["0.2", "MLCSHE : GA"]]
    for i, cell in enumerate(row[2:]):
        a, b = (
            values(Line(problem="gap", method=m, control=False), Measure.DBS, i, 1) for m in ("MLCSHE", "GA")
        )
        p_value = stats.mannwhitneyu(a, b, alternative="two-sided").pvalue
        assert ("< .001" if p_value < 0.001 else f"{p_value:.3f}") in cell
        assert cell.startswith("**") == (p_value <= 0.01)
    assert "Comparisons as in the paper" not in re.split(r"^## Strict DBS", report, flags=re.MULTILINE)[1]


def test_equal_values_and_methods_that_found_nothing_are_not_tested() -> None:
    def with_level(repeat: Repeat, level: float) -> Repeat:
        same = Figures(dbs=np.full(SHAPE, level), strict=np.full(SHAPE, level))
        return replace(repeat, scores=replace(repeat.scores, figures=same, control=None))

    levels = {"MLCSHE": 3.0, "GA": 3.0, "RS <b>": 0.0}
    text = markdown_report(
        parse_experiment(
            {
                "name": "rq1",
                "problems": [{"name": "gap", "id": "mtq@1"}],
                "seeds": {"count": SEEDS},
                "algorithms": [{"name": name, "id": "ga@1"} for name in METHODS],
                "budget": {"simulations": 1300},
            }
        ),
        [with_level(repeat, levels[repeat.method]) for repeat in REPEATS],
        {},
        experiment="3f2a",
        created_at=datetime(2026, 1, 2, tzinfo=UTC),
        elapsed_s=3700,
        level=0.2,
    )
    [ours, *_] = rows_below(text, "Comparisons")
    assert ours[1:] == ["MLCSHE : GA", *["equal"] * len(PAPER_T_BS)]
    paper = {row[1]: row[2:] for row in rows_below(text, "Comparisons as in the paper")}
    assert paper["MLCSHE : GA"] == ["equal"] * len(PAPER_T_BS)
    assert paper[r"MLCSHE : RS \<b>"] == ["N/A"] * len(PAPER_T_BS)
    assert (
        "**MLCSHE** and **GA**: DBS 3.0 against 3.0; all values are equal, so there is nothing to test."
        in text
    )
    assert "Bold: p at most 0.2.*" in text


def test_a_control_that_reads_low_supports_no_conclusion(report: str) -> None:
    lines = [line for line in report.splitlines() if "compared with its control" in line]
    assert len(lines) == 6
    for line in lines:
        proves_nothing = "the control reads low here, so this proves nothing" in line
        assert proves_nothing == ("RS" in line)
        assert ("behaviour accounts for" in line or "than scenarios and chance explain" in line) == (
            "RS" not in line
        )


def test_the_page_embeds_its_images_and_no_foreign_html(report: str, folder: Path) -> None:
    page = html_report(report, "rq1 <script>", folder)
    assert page.count('src="data:image/png;base64,') == 8
    assert "<script>" not in page
    assert "<b>" not in page
    assert "<table>" in page
    assert not re.search(r"""(src|href|url)[=(]["']?http""", page)


def with_pairs(folder: Path, tried: tuple[bool, ...]) -> str:
    """Return a report that begins with pairs.

    Args:
        folder: Folder for the figure.
        tried: Whether the pairs of each method were simulated again.
    """
    rng = np.random.default_rng(1)
    repeats = [
        PairRepeat(
            problem="gap",
            method=method,
            seed=seed,
            campaign=f"c{seed}{method[:2]}",
            computed=False,
            distinct=distinct,
            checked=distinct,
            tried=again,
            judged=again,
            confirmed=again - again // 4 if again else None,
            refuted=0,
            checked_judged=again,
            checked_confirmed=again - again // 4,
            component=again,
            scenario=0,
            drives=10,
        )
        for seed in range(SEEDS)
        for (method, level), follows in zip(METHODS.items(), tried, strict=True)
        for distinct in [1 + int(rng.poisson(level))]
        for again in [distinct if follows else 0]
    ]
    figure_found(repeats, "gap").savefig(folder / "pairs.png", dpi=30)
    found = ExperimentPairs(
        id="3f2a",
        name="rq1",
        eps=0.02,
        d_th=0.2,
        campaigns=len(repeats),
        counted=len(repeats),
        problems=[ProblemMeasure.of(repeats)],
        standings=[PairStanding.of(ours) for ours in by_method(repeats).values()],
        duels=count_duels(repeats),
        repeats=repeats,
    )
    body = parse_experiment(
        {
            "name": "rq1",
            "problems": [{"name": "gap", "id": "mtq@1"}],
            "seeds": {"count": SEEDS},
            "algorithms": [{"name": name, "id": "ga@1"} for name in METHODS],
            "budget": {"simulations": 1300},
        }
    )
    return markdown_report(
        body,
        REPEATS,
        {},
        experiment="3f2a",
        created_at=datetime(2026, 1, 2, tzinfo=UTC),
        elapsed_s=3700,
        found=[ReportedFound(words=PAIRS, found=found, pictures={"gap": "pairs.png"})],
    )


def test_pairs_that_were_not_tried_are_no_zeros(tmp_path: Path) -> None:
    text = with_pairs(tmp_path, (True, True, False))
    [row] = [
        line for line in text.splitlines() if line.startswith(r"| **RS \<b>** |") and "not tried" in line
    ]
    assert row.split(" | ")[2:] == ["not tried", "not tried", "not tried", "not tried |"]
    assert "Compared on distinct pairs, confirmed or not: only" in text
    campaigns = [line for line in text.splitlines() if re.match(r"\| `c\dRS`", line) and "not tried" in line]
    assert len(campaigns) == SEEDS
    assert all(line.count("not tried") == 7 for line in campaigns)


Box = tuple[float, float, float, float, float]
CAR: Box = (0.0, 100.0, 200.0, 300.0, 400.0)
NEARLY: Box = (0.0, 110.0, 210.0, 310.0, 410.0)
FAR: Box = (0.0, 160.0, 260.0, 360.0, 460.0)
PERSON: Box = (1.0, 100.0, 200.0, 300.0, 400.0)


def boxes(samples: list[list[Box]]) -> Ragged:
    first = np.cumsum([0, *map(len, samples)]).astype(np.int32)
    rows = np.array([box for sample in samples for box in sample], np.float32).reshape(-1, 5)
    return Ragged(columns=BOX_COLUMNS, first=first, rows=rows)


def trace(truth: list[list[Box]], detected: list[list[Box]]) -> Trace:
    return replace(make_trace(samples=len(truth)), seen_boxes=boxes(truth), given_boxes=boxes(detected))


@pytest.mark.parametrize(
    ("truth", "detected", "matched"),
    [
        ([CAR], [CAR], 1),
        ([CAR], [NEARLY], 1),  # 90 x 90 of 100 x 100 twice: .68
        ([CAR], [FAR], 0),  # 40 x 40: .09
        ([CAR], [PERSON], 0),  # same place, different label
        ([CAR], [], 0),
        ([], [CAR], 0),
        ([CAR, NEARLY], [CAR], 1),  # a detection matches only one box
        ([NEARLY, CAR], [CAR, NEARLY], 2),
    ],
)
def test_a_detection_matches_a_box_of_its_label(truth: list[Box], detected: list[Box], matched: int) -> None:
    counts = count_detections(trace([truth, []], [detected, []]))
    assert counts == DetectionCounts(truth=len(truth), detected=len(detected), matched=matched)
    columns = counts.to_columns()
    assert (columns["missed"], columns["invented"]) == (len(truth) - matched, len(detected) - matched)


def test_boxes_at_different_times_do_not_match() -> None:
    assert count_detections(trace([[CAR], []], [[], [CAR]])).matched == 0


def test_every_box_is_written_with_its_time(tmp_path: Path) -> None:
    shown = trace([[CAR], [PERSON]], [[], [NEARLY]])
    assert list(box_rows(shown)) == [
        (0.0, "seen", "vehicle", 100.0, 200.0, 300.0, 400.0),
        (0.1, "seen", "person", 100.0, 200.0, 300.0, 400.0),
        (0.1, "said", "vehicle", 110.0, 210.0, 310.0, 410.0),
    ]
    file = tmp_path / "boxes.csv"
    write_boxes(shown, file)
    with file.open(newline="") as text:
        rows = list(csv.reader(text))
    assert tuple(rows[0]) == COLUMNS
    assert [row[:3] for row in rows[1:]] == [
        ["0.0", "seen", "vehicle"],
        ["0.1", "seen", "person"],
        ["0.1", "said", "vehicle"],
    ]
