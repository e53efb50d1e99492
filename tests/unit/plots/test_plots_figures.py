"""The figures of a campaign show what its archive says."""

from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from synthetic_campaign import MIXED, campaign, mixed_campaign, mtq_campaign

from brink.plots import (
    FIGURES,
    CampaignFigures,
    figure_dbs,
    figure_embedding,
    figure_fitness,
    figure_parameters,
)
from brink.plots.style import WIDTH_PX
from brink.search.analysis.boundary import dbs, dbs_grid, distinct_boundary, strict_dbs
from brink.search.analysis.dependence import dependences
from brink.search.analysis.paper import PAPER_D_THS, PAPER_T_BS
from brink.search.analysis.similarity import embedded
from brink.search.fitness import wilson_interval
from brink.search.problems import MTQ_SPACE

MakeFigure = Callable[[CampaignFigures], Figure]


def pixels(figure: Figure) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.asarray(canvas.buffer_rgba())[..., :3]  # type: ignore[no-untyped-call]


def scattered(axes: Axes, gid: str) -> PathCollection:
    found = [item for item in axes.collections if item.get_gid() == gid]
    assert len(found) == 1, gid
    assert isinstance(found[0], PathCollection)
    return found[0]


def words(figure: Figure) -> str:
    texts = list(figure.texts)
    for axes in figure.axes:
        texts += axes.texts
    for legend in figure.legends:
        texts += legend.get_texts()
    return "\n".join(text.get_text() for text in texts)


def line(axes: Axes, label: str) -> tuple[list[float], list[float]]:
    found = [item for item in axes.lines if item.get_label() == label]
    assert len(found) == 1, label
    return list(found[0].get_xdata()), list(found[0].get_ydata())  # type: ignore[arg-type]


@pytest.mark.parametrize("make", FIGURES.values(), ids=FIGURES)
@pytest.mark.parametrize("inputs", [mtq_campaign(), mixed_campaign()], ids=["mtq", "mixed"])
def test_figure_is_wide_and_not_blank(make: MakeFigure, inputs: CampaignFigures) -> None:
    image = pixels(make(inputs))
    assert image.shape[1] == WIDTH_PX
    assert 0.005 < (image < 200).any(axis=2).mean() < 0.6


def test_dbs_lines_end_at_the_archives_dbs() -> None:
    inputs = mtq_campaign()
    figure = figure_dbs(inputs)
    assert len(figure.axes) == len(PAPER_D_THS)
    for axes, d_th in zip(figure.axes, PAPER_D_THS, strict=True):
        for t_b in PAPER_T_BS:
            x, plain = line(axes, f"t_b {t_b:g}")
            _, strict = line(axes, f"strict {t_b:g}")
            assert x[-1] == len(inputs.archive)
            assert plain[-1] == dbs(inputs.archive, t_b, d_th)
            assert strict[-1] == strict_dbs(inputs.archive, t_b, d_th)
    assert figure.axes[0].get_ylim()[1] > 2, "the landscape has a boundary, or this shows nothing"


def test_dbs_at_half_the_budget_knows_only_the_first_half() -> None:
    inputs = mtq_campaign()
    half = dbs_grid(inputs.archive.first(200))
    assert half.dbs[-1, 0] > 0
    for column, axes in enumerate(figure_dbs(inputs).axes):
        for row, t_b in enumerate(PAPER_T_BS):
            x, plain = line(axes, f"t_b {t_b:g}")
            assert plain[x.index(200)] == half.dbs[row, column]


def test_map_has_a_dot_for_every_solution_where_the_embedding_puts_it() -> None:
    inputs = mtq_campaign()
    dots = scattered(figure_embedding(inputs).axes[0], "solutions")
    places = np.asarray(dots.get_offsets())
    expected = embedded(inputs.archive).points
    # The map may be turned by a quarter, which keeps distances.
    for one, other in ((0, 1), (5, 99), (17, 399)):
        assert np.hypot(*(places[one] - places[other])) == pytest.approx(
            np.hypot(*(expected[one] - expected[other]))
        )
    colours = np.asarray(dots.get_facecolor())
    safe, unsafe = ~inputs.archive.unsafe, inputs.archive.unsafe
    assert len(np.unique(colours[safe], axis=0)) == 1
    assert len(np.unique(colours[unsafe], axis=0)) == 1
    assert not np.allclose(colours[safe][0], colours[unsafe][0])


def test_map_rings_the_distinct_boundary_solutions_best_first() -> None:
    inputs = mtq_campaign()
    axes = figure_embedding(inputs).axes[0]
    places = np.asarray(scattered(axes, "solutions").get_offsets())
    distinct = distinct_boundary(inputs.archive, inputs.t_b, inputs.d_th)
    assert distinct.size > 3
    for rank, position in enumerate(distinct.tolist(), start=1):
        ring = np.asarray(scattered(axes, f"ring-{rank}").get_offsets())
        np.testing.assert_allclose(ring[0], places[position])
    near = np.asarray(scattered(axes, "near-boundary").get_offsets())
    assert len(near) == np.count_nonzero(inputs.archive.fitness <= inputs.t_b)


def test_map_says_what_its_dots_and_rings_are() -> None:
    inputs = mtq_campaign()
    said = words(figure_embedding(inputs))
    unsafe = int(inputs.archive.unsafe.sum())
    assert f"safe: {len(inputs.archive) - unsafe}" in said
    assert f"unsafe: {unsafe}" in said
    count = distinct_boundary(inputs.archive, inputs.t_b, inputs.d_th).size
    assert f"distinct boundary solutions: {count}\n" in said
    assert f"strict: {strict_dbs(inputs.archive, inputs.t_b, inputs.d_th)}" in said


def test_map_names_the_parameter_that_separates_an_axis() -> None:
    axes = figure_embedding(mixed_campaign()).axes[0]
    assert "scenario." in axes.get_xlabel() + axes.get_ylabel() or "behaviour.label" in axes.get_xlabel()


def test_fitness_lines_are_scored_with_what_was_known_then() -> None:
    inputs = mtq_campaign()
    x, best = line(figure_fitness(inputs).axes[0], "best")
    _, median = line(figure_fitness(inputs).axes[0], "median")
    assert x == list(inputs.generation_ends)
    for end, low, middle in zip(inputs.generation_ends, best, median, strict=True):
        known = inputs.archive.first(end)
        assert low == pytest.approx(known.fitness.min())
        assert middle == pytest.approx(np.median(known.fitness))


def test_unsafe_shares_of_generations_add_up() -> None:
    inputs = mtq_campaign()
    axes = figure_fitness(inputs).axes[1]
    x, so_far = line(axes, "so far")
    assert so_far[-1] == pytest.approx(inputs.archive.unsafe.mean())
    dots = np.asarray(axes.collections[0].get_offsets())
    sizes = np.diff([0, *x])
    assert (dots[:, 1] * sizes).sum() == pytest.approx(inputs.archive.unsafe.sum())


def test_panels_show_the_share_of_each_choice_with_its_interval() -> None:
    inputs = mixed_campaign()
    figure = figure_parameters(inputs)
    assert len(figure.axes) == inputs.space.dimension
    strongest = dependences(inputs.space, inputs.archive)[0]
    assert strongest.column.name == "scenario.weather"
    share = next(item for item in figure.axes[0].lines if item.get_gid() == "share")
    weather = inputs.archive.vectors[:, 0]
    for choice, shown in enumerate(np.asarray(share.get_ydata(), dtype=float)):
        assert shown == pytest.approx(inputs.archive.unsafe[weather == choice].mean())
    lower, upper = wilson_interval(strongest.unsafe, strongest.counts)
    segments = np.asarray(figure.axes[0].collections[0].get_segments())  # type: ignore[attr-defined]
    np.testing.assert_allclose(segments[:, 0, 1], lower)
    np.testing.assert_allclose(segments[:, 1, 1], upper)


def test_numbers_of_a_sleeping_block_are_left_out_of_their_panels() -> None:
    inputs = mixed_campaign()
    awake = inputs.archive.vectors[:, 2] == 1
    found = {dependence.column.name: dependence for dependence in dependences(inputs.space, inputs.archive)}
    assert found["behaviour.x_px"].counts.sum() == awake.sum() < len(inputs.archive)
    assert found["behaviour.x_px"].unsafe.sum() == inputs.archive.unsafe[awake].sum()
    assert found["behaviour.x_px"].places.min() > 0
    assert found["behaviour.label"].counts.sum() == len(inputs.archive)


def test_verdicts_that_do_not_depend_on_a_parameter_are_not_called_dependent() -> None:
    inputs = mixed_campaign(600)
    found = {dependence.column.name: dependence for dependence in dependences(inputs.space, inputs.archive)}
    assert found["scenario.weather"].p_value < 1e-6
    assert found["scenario.lanes"].p_value > 0.01
    assert found["scenario.weather"].strength > 3 * found["scenario.lanes"].strength


def _few(count: int, *, unsafe: bool) -> CampaignFigures:
    vectors = np.random.default_rng(3).random((count, 2))
    return campaign(
        MTQ_SPACE,
        vectors,
        np.full(count, unsafe),
        np.full(count, -1.0 if unsafe else 1.0),
        radius=0.05,
        t_b=0.01,
        d_th=0.3,
    )


FURTHER = pytest.mark.long("draws every figure of one more campaign")


def _all_alike() -> CampaignFigures:
    vectors = np.tile([0.0, 1, 0, 0, 0], (3, 1))
    return campaign(MIXED, vectors, np.array([True, False, True]), np.zeros(3), radius=0.3, t_b=1.0, d_th=0.0)


@pytest.mark.parametrize("make", FIGURES.values(), ids=FIGURES)
@pytest.mark.parametrize(
    "inputs",
    [
        pytest.param(_few(0, unsafe=False), id="none"),
        pytest.param(_few(1, unsafe=False), id="one safe", marks=FURTHER),
        pytest.param(_few(1, unsafe=True), id="one unsafe", marks=FURTHER),
        pytest.param(_few(2, unsafe=True), id="two", marks=FURTHER),
        pytest.param(_few(120, unsafe=False), id="all safe", marks=FURTHER),
        pytest.param(_few(120, unsafe=True), id="all unsafe"),
        pytest.param(mixed_campaign(40, null_share=1.0), id="all null", marks=FURTHER),
        pytest.param(_all_alike(), id="all alike"),
    ],
)
def test_degenerate_campaigns_still_give_a_clear_picture(make: MakeFigure, inputs: CampaignFigures) -> None:
    figure = make(inputs)
    figure.set_dpi(40)
    assert (pixels(figure) < 200).any(axis=2).mean() > 0.002


def test_map_without_boundary_says_so() -> None:
    assert "none yet" in words(figure_embedding(_few(120, unsafe=True)))
    assert "no solution has been evaluated" in words(figure_embedding(_few(0, unsafe=True)))


def test_inputs_that_do_not_belong_together_are_refused() -> None:
    good = mtq_campaign(60)
    with pytest.raises(ValueError, match=r"generation_ends: expected ascending counts up to 60"):
        CampaignFigures(
            archive=good.archive, space=good.space, title="", generation_ends=(61,), t_b=0.1, d_th=0.1
        )
    with pytest.raises(ValueError, match=r"space: expected 2 parameters"):
        CampaignFigures(archive=good.archive, space=MIXED, title="", generation_ends=(60,), t_b=0.1, d_th=0.1)
