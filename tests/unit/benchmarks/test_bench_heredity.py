"""The study of heredity: which methods it compares, its figures, and what it concludes."""

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from benchmarks.heredity import T_BS, Twins, figure_heredity, heredity_of, sized, twins_of
from brink.search.analysis.comparison import Line, Repeat
from brink.search.analysis.paper import D_THS, PAPER_FRACTIONS, PAPER_T_BS, Measure
from brink.search.analysis.scores import Control, Figures, Scores
from brink.search.analysis.statistics import holm
from brink.server.errors import InvalidInput
from brink.server.experiments.body import parse_experiment, read_experiment_file

STUDY = read_experiment_file(Path(__file__).parents[3] / "examples" / "heredity.yaml")
SHAPE = (len(PAPER_FRACTIONS), len(PAPER_T_BS), len(D_THS))
SEEDS = 10


def test_the_study_compares_three_rates_each_with_and_without_selection() -> None:
    assert (STUDY.campaigns, STUDY.budget.simulations) == (60, 1300)
    rates = [one.params["mutation_probability"] for one in STUDY.algorithms]
    assert rates == [1.0, 1.0, 0.2, 0.2, 0.05, 0.05]
    assert twins_of(STUDY) == [
        Twins(method=f"rate {rate}", twin=f"rate {rate}, no selection") for rate in ("1", ".2", ".05")
    ]


def test_the_size_of_the_study_is_chosen() -> None:
    small = sized(STUDY, seeds=2, simulations=200)
    assert (small.seeds, small.budget.simulations, small.algorithms) == ([1, 2], 200, STUDY.algorithms)
    assert sized(STUDY, seeds=None, simulations=None) == STUDY
    with pytest.raises(InvalidInput):
        sized(STUDY, seeds=100, simulations=None)  # 600 campaigns


@pytest.mark.parametrize(
    ("change", "pointer"),
    [
        ({"algorithms": [{"id": "mlcshe@1"}]}, "/algorithms/0"),
        (
            {
                "algorithms": [
                    {"name": "a", "id": "mlcshe@1", "params": {"partners": 2}},
                    {"name": "b", "id": "mlcshe@1", "params": {"selection": "none"}},
                ]
            },
            "/algorithms/0",
        ),
        ({"problems": [{"id": "mtq@1"}, {"id": "onemax@1"}]}, "/problems"),
    ],
)
def test_a_study_without_twins_or_with_two_problems_is_rejected(
    change: dict[str, object], pointer: str
) -> None:
    with pytest.raises(InvalidInput) as raised:
        twins_of(parse_experiment({**STUDY.document(), **change}))
    assert [error.pointer for error in raised.value.errors] == [pointer]


def make_repeats(found: dict[str, list[float]], behaviours_a_scenario: float = 6.0) -> list[Repeat]:
    """Return campaigns whose DBS is the same at all thresholds, by method and seed, half of it in the control."""
    repeats = []
    for method, values in found.items():
        for seed, value in enumerate(values):
            dbs, nothing = np.full(SHAPE, value), np.zeros(SHAPE)
            control = Control(
                figures=Figures(dbs=dbs / 2, strict=nothing),
                unsafe_share=0.2,
                spread=np.ones(SHAPE[1:]),
                repeats=behaviours_a_scenario,
            )
            scores = Scores(
                evaluated=100, unsafe=20, figures=Figures(dbs=dbs, strict=nothing), control=control
            )
            repeats.append(Repeat(problem="gap", method=method, seed=seed, campaign="c", scores=scores))
    return repeats


FOUND = {
    "rate 1": [10.0 + seed for seed in range(SEEDS)],
    "rate 1, no selection": [10.5 + seed for seed in range(SEEDS)],
    "rate .2": [40.0 + seed for seed in range(SEEDS)],
    "rate .2, no selection": [12.0 + seed for seed in range(SEEDS)],
}
TWINS = [
    Twins(method="rate 1", twin="rate 1, no selection"),
    Twins(method="rate .2", twin="rate .2, no selection"),
]
HEREDITY = heredity_of(make_repeats(FOUND), TWINS)


def test_each_rate_is_compared_with_its_twin_and_with_the_first_rate() -> None:
    ours = [one for one in HEREDITY.effects if one.measure is Measure.DBS]
    pairs = [(one.first.method, one.second.method) for one in ours]
    assert list(dict.fromkeys(pairs)) == [
        ("rate 1", "rate 1, no selection"),
        ("rate .2", "rate .2, no selection"),
        ("rate .2", "rate 1"),
    ]
    expected = [
        float(stats.mannwhitneyu(FOUND[first], FOUND[second], alternative="two-sided").pvalue)
        for first, second in pairs
    ]
    assert [one.result.p_value for one in ours] == pytest.approx(expected)
    assert [one.adjusted for one in ours] == pytest.approx(holm(expected))


def test_conclusions_name_what_is_significant_after_correction() -> None:
    assert list(HEREDITY.conclusions()) == [
        "DBS, selection: rate .2 finds more than rate .2, no selection at t_b 0.05, 0.1, 0.15",
        "DBS, the mutation rate: rate .2 finds more than rate 1 at t_b 0.05, 0.1, 0.15",
        "DBS, the component's behaviour: "
        + "; ".join(f"{name} finds more than {name}, control at t_b 0.05, 0.1, 0.15" for name in FOUND),
        "strict DBS, selection: no difference is significant (corrected p at most 0.05) at any t_b",
        "strict DBS, the mutation rate: no difference is significant (corrected p at most 0.05) at any t_b",
        "strict DBS, the component's behaviour: no difference is significant (corrected p at most 0.05) at any t_b",
    ]


def test_each_method_is_compared_with_its_own_control() -> None:
    ours = [one for one in HEREDITY.against_controls if one.measure is Measure.DBS]
    assert {(one.first.label, one.second.label) for one in ours} == {
        (name, f"{name}, control") for name in FOUND
    }
    values = FOUND["rate .2"]
    expected = stats.mannwhitneyu(values, [value / 2 for value in values], alternative="two-sided").pvalue
    found = [one.result.p_value for one in ours if one.first.method == "rate .2"]
    assert found == pytest.approx([float(expected)] * len(T_BS))
    assert [one.adjusted for one in ours] == pytest.approx(holm([one.result.p_value for one in ours]))
    assert len(HEREDITY.document()["against_controls"]) == 2 * len(ours)


def test_a_control_that_reads_low_is_not_compared() -> None:
    assert heredity_of(make_repeats(FOUND, behaviours_a_scenario=2.0), TWINS).against_controls == []


def test_rows_have_the_means_of_methods_and_of_their_controls() -> None:
    rows = {name: cells for name, *cells in HEREDITY.rows(Measure.DBS)}
    assert list(rows)[:3] == ["rate 1", "rate 1, control", "rate 1, no selection"]
    assert rows["rate 1"][0].startswith("14.5 [")
    assert rows["rate 1, control"][0].startswith("7.2 [")
    assert {len(cells) for cells in rows.values()} == {len(T_BS)}
    assert {cell for _, *cells in HEREDITY.effect_rows(Measure.STRICT) for cell in cells} == {"equal"}


def test_document_has_every_campaign(tmp_path: Path) -> None:
    document = HEREDITY.document()
    assert len(document["values"]) == 4 * 2 * 2 * len(T_BS), "method or control, measure, t_b"
    own = next(
        one["values"]
        for one in document["values"]
        if (one["method"], one["control"], one["measure"], one["t_b"]) == ("rate .2", False, "dbs", 0.1)
    )
    assert own == FOUND["rate .2"]


def test_figure_has_a_panel_for_each_t_b_with_every_campaign() -> None:
    figure = figure_heredity(HEREDITY, Measure.DBS, "heredity")
    assert [axes.get_title(loc="left") for axes in figure.axes] == [f"t_b {t_b:g}" for t_b in T_BS]
    dots = [line for line in figure.axes[0].get_lines() if len(np.atleast_1d(line.get_xdata())) == SEEDS]
    assert [sorted(np.asarray(line.get_ydata()).tolist()) for line in dots] == list(FOUND.values())
    figure.canvas.draw()


def test_values_are_those_of_the_whole_budget() -> None:
    line = Line(problem="gap", method="rate 1", control=False)
    assert HEREDITY.values[line, Measure.DBS, 0.1] == FOUND["rate 1"]
