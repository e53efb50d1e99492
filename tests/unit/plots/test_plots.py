"""Figures of a campaign: they show its archive, and are written completely and reproducibly."""

import threading
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from PIL import Image

from brink.plots import (
    FIGURES,
    CampaignFigures,
    PairFigure,
    figure_dbs,
    figure_embedding,
    figure_fitness,
    figure_pair,
    figure_parameters,
    write_campaign_figures,
)
from brink.plots.campaign import figure_fronts, recorded_diversities
from brink.plots.style import WIDTH_PX
from brink.search.algorithm import Scored
from brink.search.algorithms.multi_objective import CRITICALITY
from brink.search.algorithms.nsga2 import Nsga2, Nsga2Config
from brink.search.analysis.boundary import dbs, distinct_boundary, strict_dbs
from brink.search.analysis.dependence import dependences
from brink.search.analysis.paper import PAPER_D_THS, PAPER_T_BS
from brink.search.analysis.similarity import own_plane
from brink.search.archive import Archive, Neighbourhood
from brink.search.problems import MTQ_RADIUS, MTQ_SPACE, mtq_robustness
from brink.search.space import Categorical, Component, Dormant, Integer, Real, SearchSpace
from brink.search.traffic.constraint import participants_component
from brink.search.traffic.participants import RoadLimits
from brink.server.dashboard.solution_map import make_map

MIXED = SearchSpace(
    (
        Component(
            "scenario", (Categorical("weather", ("clear", "wet", "hard_rain")), Integer("lanes", 1, 4))
        ),
        Component(
            "behaviour",
            (
                Categorical("label", ("null", "vehicle")),
                Real("x_px", 0.0, 800.0, "px"),
                Integer("t0_step", 0, 300),
            ),
            (Dormant("label", "null", ("x_px", "t0_step")),),
        ),
    )
)
"""A space with a category, few and many integers, and a number that can be inactive."""


@cache
def mtq_campaign(count: int = 400, *, seed: int = 1, t_b: float = 0.2, d_th: float = 0.05) -> CampaignFigures:
    rng = np.random.default_rng(seed)
    vectors = np.clip(rng.normal(0.75, 0.2, (count, 2)), 0, 1)
    values = np.array([mtq_robustness(x, y) for x, y in vectors.tolist()])
    # MTQ is unsafe almost everywhere, so the verdicts are inverted: only the disc is unsafe.
    return campaign(MTQ_SPACE, vectors, values > 0, -values, radius=MTQ_RADIUS, t_b=t_b, d_th=d_th)


@cache
def mixed_campaign(count: int = 300, *, seed: int = 1, null_share: float = 0.4) -> CampaignFigures:
    rng = np.random.default_rng(seed)
    weather, lanes = rng.integers(0, 3, count), rng.integers(1, 5, count)
    label = (rng.random(count) >= null_share).astype(float)
    x_px, t0 = rng.uniform(1, 800, count) * label, rng.integers(1, 301, count) * label
    vectors = np.column_stack([weather, lanes, label, x_px, t0]).astype(float)
    chance = np.where(weather == 2, 0.6, 0.05) + 0.3 * (x_px > 400)
    unsafe = rng.random(count) < chance
    return campaign(MIXED, vectors, unsafe, np.where(unsafe, -1.0, 1.0), radius=0.3, t_b=0.2, d_th=0.1)


def campaign(
    space: SearchSpace,
    vectors: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    unsafe: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
    values: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    *,
    radius: float,
    t_b: float,
    d_th: float,
) -> CampaignFigures:
    count = len(vectors)
    archive = Archive.empty(space, Neighbourhood(radius, 0.1)).grown(
        np.arange(count), vectors, unsafe, values
    )
    ends = tuple(range(50, count, 50)) + ((count,) if count else ())
    return CampaignFigures(
        archive=archive, space=space, title="Test", generation_ends=ends, t_b=t_b, d_th=d_th
    )


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


@cache
def figure_of(make: MakeFigure, inputs: Callable[[], CampaignFigures]) -> Figure:
    """Return a figure that several tests look at."""
    return make(inputs())


def check_size_and_ink(image: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> None:
    assert image.shape[1] == WIDTH_PX
    assert 0.005 < (image < 200).any(axis=2).mean() < 0.6


def test_dbs_lines_end_at_the_dbs_of_the_archive() -> None:
    inputs = mtq_campaign()
    figure = figure_of(figure_dbs, mtq_campaign)
    assert len(figure.axes) == len(PAPER_D_THS)
    for axes, d_th in zip(figure.axes, PAPER_D_THS, strict=True):
        for t_b in PAPER_T_BS:
            x, plain = line(axes, f"t_b {t_b:g}")
            _, strict = line(axes, f"strict {t_b:g}")
            assert x[-1] == len(inputs.archive)
            assert plain[-1] == dbs(inputs.archive, t_b, d_th)
            assert strict[-1] == strict_dbs(inputs.archive, t_b, d_th)
    assert figure.axes[0].get_ylim()[1] > 2, "the landscape must have a boundary"


def test_map_has_a_dot_for_every_solution_where_the_dashboard_has_it() -> None:
    inputs = mixed_campaign(400)
    dots = scattered(figure_embedding(inputs).axes[0], "solutions")
    places = np.asarray(dots.get_offsets())
    np.testing.assert_allclose(places, make_map(inputs.space, inputs.archive, ended=True).points)
    across, up = np.ptp(places, axis=0)
    assert across >= up
    colours = np.asarray(dots.get_facecolor())
    safe, unsafe = ~inputs.archive.unsafe, inputs.archive.unsafe
    assert len(np.unique(colours[safe], axis=0)) == 1
    assert len(np.unique(colours[unsafe], axis=0)) == 1
    assert not np.allclose(colours[safe][0], colours[unsafe][0])


def test_own_coordinates_of_different_units_fill_a_square() -> None:
    def space(*numbers: Real) -> SearchSpace:
        return SearchSpace((Component("all", numbers),))

    apart = own_plane(space(Real("speed", 0.0, 20.0, "m/s"), Real("gap", 5.0, 55.0, "m")))
    assert apart is not None
    assert apart.names == ("speed (m/s)", "gap (m)")
    assert apart.placed(np.array([[5.0, 30.0]])).tolist() == [[0.25, 0.5]]
    assert (apart.value(0, 0.25), apart.value(1, 0.5)) == (5.0, 30.0)
    same = own_plane(space(Real("a", 0.0, 20.0, "m"), Real("b", 0.0, 40.0, "m")))
    assert same is not None
    assert same.placed(np.array([[20.0, 20.0]])).tolist() == [[0.5, 0.5]]
    assert own_plane(space(Real("a", 0.0, 1.0))) is None
    assert own_plane(MIXED) is None


def test_map_rings_the_distinct_boundary_solutions_best_first() -> None:
    inputs = mtq_campaign()
    axes = figure_of(figure_embedding, mtq_campaign).axes[0]
    places = np.asarray(scattered(axes, "solutions").get_offsets())
    distinct = distinct_boundary(inputs.archive, inputs.t_b, inputs.d_th)
    assert distinct.size > 3
    for rank, position in enumerate(distinct.tolist(), start=1):
        ring = np.asarray(scattered(axes, f"ring-{rank}").get_offsets())
        np.testing.assert_allclose(ring[0], places[position])
    near = np.asarray(scattered(axes, "near-boundary").get_offsets())
    assert len(near) == np.count_nonzero(inputs.archive.fitness <= inputs.t_b)


def test_map_of_a_search_for_pairs_rings_and_lists_these() -> None:
    plain = mtq_campaign()
    numbers, unsafe = plain.archive.numbers.tolist(), plain.archive.unsafe.tolist()
    safe = [number for number, one in zip(numbers, unsafe, strict=True) if not one]
    violated = [number for number, one in zip(numbers, unsafe, strict=True) if one]
    pairs = ((safe[5], violated[0]), (safe[2], violated[7]))
    figure = figure_embedding(replace(plain, pairs=pairs))
    axes = figure.axes[0]
    dots = np.asarray(scattered(axes, "solutions").get_offsets())
    for place, sides in enumerate(pairs, start=1):
        middle = dots[[numbers.index(number) for number in sides]].mean(axis=0)
        assert np.asarray(scattered(axes, f"ring-{place}").get_offsets())[0] == pytest.approx(middle)
    text = words(figure)
    assert "distinct pairs: 2" in text
    assert "near the boundary" not in text
    assert {str(number) for sides in pairs for number in sides} <= set(text.splitlines())


def test_fitness_is_scored_with_the_results_known_at_the_time() -> None:
    inputs = mtq_campaign()
    x, best = line(figure_of(figure_fitness, mtq_campaign).axes[0], "best")
    _, median = line(figure_of(figure_fitness, mtq_campaign).axes[0], "median")
    assert x == list(inputs.generation_ends)
    for end, low, middle in zip(inputs.generation_ends, best, median, strict=True):
        known = inputs.archive.first(end)
        assert low == pytest.approx(known.fitness.min())
        assert middle == pytest.approx(np.median(known.fitness))


def test_panels_show_the_share_of_each_choice_without_an_interval() -> None:
    inputs = mixed_campaign()
    figure = figure_of(figure_parameters, mixed_campaign)
    assert len(figure.axes) == inputs.space.dimension
    strongest = dependences(inputs.space, inputs.archive)[0]
    assert strongest.column.name == "scenario.weather"
    share = next(item for item in figure.axes[0].lines if item.get_gid() == "share")
    weather = inputs.archive.vectors[:, 0]
    for choice, shown in enumerate(np.asarray(share.get_ydata(), dtype=float)):
        assert shown == pytest.approx(inputs.archive.unsafe[weather == choice].mean())
    # Solutions of a search are relatives of each other: no interval would be right.
    assert not figure.axes[0].collections


def test_inactive_parameters_are_left_out_of_their_panels() -> None:
    inputs = mixed_campaign()
    awake = inputs.archive.vectors[:, 2] == 1
    found = {dependence.column.name: dependence for dependence in dependences(inputs.space, inputs.archive)}
    assert found["behaviour.x_px"].counts.sum() == awake.sum() < len(inputs.archive)
    assert found["behaviour.x_px"].unsafe.sum() == inputs.archive.unsafe[awake].sum()
    assert found["behaviour.x_px"].places.min() > 0
    assert found["behaviour.label"].counts.sum() == len(inputs.archive)


def test_a_parameter_with_an_effect_comes_before_one_without() -> None:
    inputs = mixed_campaign(600)
    found = {dependence.column.name: dependence for dependence in dependences(inputs.space, inputs.archive)}
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


FURTHER = pytest.mark.long("draws all figures of another campaign")


def _all_equal() -> CampaignFigures:
    vectors = np.tile([0.0, 1, 0, 0, 0], (3, 1))
    return campaign(MIXED, vectors, np.array([True, False, True]), np.zeros(3), radius=0.3, t_b=1.0, d_th=0.0)


@pytest.mark.parametrize("make", FIGURES.values(), ids=FIGURES)
@pytest.mark.parametrize(
    "inputs",
    [
        pytest.param(_few(0, unsafe=False), id="none"),
        pytest.param(_few(1, unsafe=True), id="one unsafe", marks=FURTHER),
        pytest.param(_few(120, unsafe=False), id="all safe", marks=FURTHER),
        pytest.param(mixed_campaign(40, null_share=1.0), id="all inactive", marks=FURTHER),
        pytest.param(_all_equal(), id="all equal"),
    ],
)
def test_degenerate_campaigns_give_readable_figures(make: MakeFigure, inputs: CampaignFigures) -> None:
    figure = make(inputs)
    figure.set_dpi(40)
    assert (pixels(figure) < 200).any(axis=2).mean() > 0.002


def test_inconsistent_inputs_are_rejected() -> None:
    good = mtq_campaign(60)
    with pytest.raises(ValueError, match=r"generation_ends: expected ascending counts up to 60"):
        CampaignFigures(
            archive=good.archive, space=good.space, title="", generation_ends=(61,), t_b=0.1, d_th=0.1
        )
    with pytest.raises(ValueError, match=r"space: expected 2 parameters"):
        CampaignFigures(archive=good.archive, space=MIXED, title="", generation_ends=(60,), t_b=0.1, d_th=0.1)
    with pytest.raises(ValueError, match="expected numbers of solutions in the archive, got 999"):
        replace(good, pairs=((3, 999),))


TRAFFIC = SearchSpace((participants_component("npcs", 2, RoadLimits()),))
CONFIG = Nsga2Config(population_size=10)


def test_recomputed_diversity_equals_that_of_the_search() -> None:
    algorithm = Nsga2()
    state = algorithm.start(TRAFFIC, CONFIG, seed=1, budget=40)
    ends, seen = [], {}
    while not algorithm.finished(state):
        state, candidates = algorithm.ask(state)
        answers = {
            c.number: Scored(unsafe=False, robustness=1.0, objectives={CRITICALITY: 1.0 + c.number})
            for c in candidates
        }
        before = len(state.history)
        state = algorithm.tell(state, answers)
        ends.append(len(state.archive))
        fresh = {n: d for n, d in zip(state.population, state.diversity.tolist(), strict=True) if n >= before}
        seen.update(fresh)
    assert seen
    found = recorded_diversities(TRAFFIC, state.archive.vectors, ends, CONFIG)
    for number, diversity in seen.items():
        assert found[number] == pytest.approx(diversity)
    figure = figure_fronts("npcs", TRAFFIC, state.archive.vectors, ends, 1.0 + np.arange(40.0), CONFIG)
    (axes,) = figure.axes
    drawn = [front for front in axes.lines if str(front.get_label()).endswith("solutions")]
    assert [front.get_label() for front in drawn] == [f"{end} solutions" for end in ends]
    for front in drawn:
        heights = np.asarray(front.get_ydata(), np.float64)
        assert (np.diff(heights) > 0).all() or len(heights) == 1


def test_every_figure_is_written_in_every_format(tmp_path: Path) -> None:
    files = write_campaign_figures(mtq_campaign(120), tmp_path / "new" / "folder", formats=("png", "svg"))
    assert [path.name for path in files] == [f"{stem}.{kind}" for stem in FIGURES for kind in ("png", "svg")]
    for path in files:
        if path.suffix == ".png":
            with Image.open(path) as image:
                check_size_and_ink(np.asarray(image.convert("RGB")))
        else:
            assert ElementTree.parse(path).getroot().tag.endswith("svg")


@pytest.mark.parametrize("change", [{"pairs": ()}, {"searched_boundary": False}])
def test_another_search_has_no_figures_of_the_boundary(change: dict[str, Any], tmp_path: Path) -> None:
    files = write_campaign_figures(replace(mtq_campaign(120), **change), tmp_path)
    assert [path.name for path in files] == ["map.png", "parameters.png"]


@pytest.mark.long("draws every figure twice")
def test_figures_can_be_drawn_in_threads(tmp_path: Path) -> None:
    inputs = mtq_campaign(60)
    threads = [
        threading.Thread(target=write_campaign_figures, args=(inputs, tmp_path / str(index)))
        for index in range(2)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    one, other = (sorted((tmp_path / str(index)).iterdir()) for index in range(2))
    assert len(one) == len(FIGURES)
    assert [path.read_bytes() for path in one] == [path.read_bytes() for path in other]


def test_an_unknown_format_is_rejected_before_drawing(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"formats: expected some of png, svg; got 'pdf'"):
        write_campaign_figures(mtq_campaign(60), tmp_path / "out", formats=("pdf",))
    assert not (tmp_path / "out").exists()


def test_a_pair_of_a_mixed_problem_has_a_row_for_each_difference() -> None:
    vectors = np.array([[0, 2, 1, 400.25, 100], [2, 2, 1, 410.5, 100.0]])
    inputs = campaign(
        MIXED, vectors, np.array([False, True]), np.array([1.0, -1.0]), radius=0.2, t_b=0.2, d_th=0.1
    )
    figure = figure_pair(inputs, PairFigure(safe=0, unsafe=1, change="hard rain instead of clear"))
    words = [text.get_text() for text in figure.axes[0].texts]
    assert [word for word in words if word.startswith(("scenario", "behaviour"))] == [
        "scenario: weather",
        "behaviour: x px",
    ]
    assert {"clear", "hard rain", "400.25 px", "410.5 px", "The other 3 parameters are the same."} <= set(
        words
    )
    active = np.array([[True, True, True, False, True], [True, True, True, False, False]])
    figure = figure_pair(
        replace(inputs, active=active), PairFigure(safe=0, unsafe=1, change="hard rain instead of clear")
    )
    words = [text.get_text() for text in figure.axes[0].texts]
    assert [word for word in words if word.startswith(("scenario", "behaviour"))] == ["scenario: weather"]
    assert "1 more differs but were inactive in both episodes. The other 3 are the same." in words
    with pytest.raises(ValueError, match="expected an evaluated solution of Test, got 7"):
        figure_pair(inputs, PairFigure(safe=7, unsafe=1, change=""))
