from typing import Any

import numpy as np
import pytest
from scipy import stats

from brink.search.distribution import NUMBERS, distributed, distribution_words, rows_of_table
from brink.search.errors import DistributionError
from brink.search.odd import limited
from brink.search.space import Categorical, Component, Dormant, Extent, Integer, Real, SearchSpace
from brink.search.testing import example_spaces

SPACE = SearchSpace(
    (
        Component(
            "scenario",
            (
                Real("speed", 5.0, 30.0, "m/s"),
                Real("rate", 1e-3, 1.0, "1/s", log=True),
                Real("gap", 0.0, 10.0, "m", step=0.5),
                Integer("cars", 0, 8),
                Categorical("time", ("day", "night")),
                Categorical("weather", ("dry", "rain")),
                Categorical("limit", ("30", "50")),
            ),
        ),
        Component(
            "behaviour",
            (Categorical("type", ("none", "late")), Real("delay", 0.0, 2.0, "s")),
            (Dormant("type", "none", ("delay",)),),
        ),
    )
)


def drawn(space: SearchSpace, count: int = 600) -> dict[str, list[Any]]:
    rng = np.random.default_rng(1)
    columns: dict[str, list[Any]] = {}
    for _ in range(count):
        vectors = space.draw(rng)
        space.check(vectors)
        for component, values in space.decode(vectors).items():
            for name, value in values.items():
                columns.setdefault(f"{component}.{name}", []).append(value)
    return columns


@pytest.mark.parametrize("kind", NUMBERS)
def test_the_numbers_of_a_kind_are_those_that_it_takes(kind: str) -> None:
    names = NUMBERS[kind]
    distributed(SPACE, {"scenario.gap": {kind: dict.fromkeys(names, 2.0)}})
    with pytest.raises(DistributionError, match=f"expected {', '.join(names)}"):
        distributed(SPACE, {"scenario.gap": {kind: {}}})


@pytest.mark.parametrize(
    ("name", "declared", "expected"),
    [
        ("speed", {"normal": {"mean": 25, "deviation": 5}}, stats.truncnorm(-4, 1, 25, 5)),
        ("speed", {"beta": {"a": 2, "b": 5}}, stats.beta(2, 5, 5, 25)),
        ("speed", {"exponential": {"mean": 8}}, stats.truncexpon(25 / 8, 5, 8)),
        ("speed", {"histogram": {"edges": [0, 10, 20, 40], "weights": [2, 0, 4]}}, None),
        ("rate", {"lognormal": {"median": 0.05, "sigma": 1.0}}, None),
        ("speed", "uniform", stats.uniform(5, 25)),
        ("rate", "uniform", stats.loguniform(1e-3, 1)),
    ],
)
def test_numbers_have_the_declared_distribution_cut_to_their_range(
    name: str, declared: Any, expected: Any
) -> None:
    values = np.array(drawn(distributed(SPACE, {f"scenario.{name}": declared}))[f"scenario.{name}"])
    match declared:
        case {"histogram": _}:  # half of the first bin, and half of the last, are in the range: 1 to 2
            assert not ((values > 10) & (values < 20)).any()
            assert np.mean(values <= 10) == pytest.approx(1 / 3, abs=0.08)
        case {"lognormal": _}:
            cut = stats.norm(np.log(0.05), 1.0)
            low, high = (float(cut.cdf(np.log(end))) for end in (1e-3, 1.0))
            assert stats.kstest((cut.cdf(np.log(values)) - low) / (high - low), "uniform").pvalue > 0.001
        case _:
            assert stats.kstest(values, expected.cdf).pvalue > 0.001


def test_steps_take_the_nearest_value_ends_included() -> None:
    columns = drawn(
        distributed(
            SPACE,
            {
                "scenario.cars": {"normal": {"mean": 0, "deviation": 1}},
                "scenario.gap": {"histogram": {"edges": [-5, 15], "weights": [1]}},
            },
        )
    )
    # Half-open cells around 0 and 1: P(|z| < 0.5) and P(0.5 < z < 1.5) of P(z > -0.5).
    shares = np.bincount(columns["scenario.cars"], minlength=9)[:2] / 600
    cells = np.array([float(stats.norm.cdf(end)) for end in (-0.5, 0.5, 1.5, 8.5)])
    assert shares == pytest.approx(np.diff(cells)[:2] / (cells[3] - cells[0]), abs=0.08)
    assert (
        np.bincount(np.round(np.array(columns["scenario.gap"]) * 2).astype(int)).min() > 10
    )  # about 28 each


def test_weights_depend_on_other_categories_and_rows_stay_whole() -> None:
    space = distributed(
        SPACE,
        {
            "scenario.time": {"weights": {"day": 8, "night": 2}},
            "scenario.weather": {
                "depends_on": "scenario.time",
                "weights": {"day": {"dry": 1}, "night": {"dry": 1, "rain": 3}},
            },
            "behaviour.*": "uniform",
            "rows": rows_of_table(
                ["scenario.limit", "scenario.speed"], [["30", "8"], ["50", " 14.5"], ["50", "13"]]
            ),
        },
    )
    columns = drawn(space)
    night = np.array(columns["scenario.time"]) == "night"
    rain = np.array(columns["scenario.weather"]) == "rain"
    assert night.mean() == pytest.approx(0.2, abs=0.06)
    assert not rain[~night].any()
    assert rain[night].mean() == pytest.approx(0.75, abs=0.15)
    assert set(zip(columns["scenario.limit"], columns["scenario.speed"], strict=True)) == {
        ("30", 8.0),
        ("50", 14.5),
        ("50", 13.0),
    }
    assert np.mean(np.array(columns["scenario.limit"]) == "50") == pytest.approx(2 / 3, abs=0.08)
    assert "3 observations" in distribution_words(space)


def test_distribution_is_cut_to_the_odd_and_to_the_constraints() -> None:
    within = limited(SPACE, {"scenario.speed": {"max": 10}, "scenario.time": "night"})
    within = within.constrained(["speed > 6 + delay"])
    space = distributed(
        within,
        {
            "scenario.speed": {"normal": {"mean": 8, "deviation": 4}},
            "scenario.time": {"weights": {"day": 99, "night": 1}},
            "behaviour.type": {"weights": {"none": 1, "late": 1}},
        },
    )
    columns = drawn(space, 300)
    assert set(columns["scenario.time"]) == {"night"}
    assert min(columns["scenario.speed"]) >= 5
    assert max(columns["scenario.speed"]) <= 10


@pytest.mark.parametrize("space", example_spaces().values(), ids=example_spaces())
def test_without_a_distribution_draws_are_those_of_a_search(space: SearchSpace) -> None:
    one, other = (np.random.default_rng(5) for _ in range(2))
    assert (space.join(space.draw(one)) == space.join(space.sample(other))).all()


@pytest.mark.parametrize(
    ("declared", "name", "message"),
    [
        ({"scenario.sped": "uniform"}, "scenario.sped", "did you mean .scenario.speed"),
        ({"scenario.speed": {"normal": {"mean": 3}}}, "scenario.speed", "normal: expected mean, deviation"),
        ({"scenario.speed": {"normal": {"mean": 3, "deviation": 0}}}, "scenario.speed", "deviation: expected a num"),
        ({"scenario.speed": {"normal": {"mean": -900, "deviation": 1}}}, "scenario.speed", "practically none"),
        ({"scenario.speed": {"gauss": {}}}, "scenario.speed", "expected one of uniform, normal"),
        ({"scenario.speed": {"weights": {"a": 1}}}, "scenario.speed", "distribution of numbers"),
        ({"scenario.time": {"normal": {"mean": 1, "deviation": 1}}}, "scenario.time", "expected weights"),
        ({"scenario.time": {"weights": {"dusk": 1}}}, "scenario.time", "unknown choice 'dusk'"),
        ({"scenario.time": {"weights": {"day": 0}}}, "scenario.time", "positive weight"),
        ({"scenario.time": {"weights": {"day": -1, "night": 2}}}, "scenario.time", "weights >= 0"),
        ({"scenario.*": "uniform", "scenario.time": "uniform"}, "scenario.time", "named twice"),
        ({"scenario.time": {"depends_on": "scenario.cars", "weights": {}}}, "scenario.time", "another category"),
        (
            {"scenario.time": {"depends_on": "scenario.weather", "weights": {"dry": {"day": 1}}}},
            "scenario.time",
            "missing rain",
        ),
        (
            {
                "scenario.time": {
                    "depends_on": "scenario.weather",
                    "weights": {"dry": {"day": 1}, "rain": {"day": 1}},
                },
                "scenario.weather": {
                    "depends_on": "scenario.time",
                    "weights": {"day": {"dry": 1}, "night": {"dry": 1}},
                },
            },
            None,
            "circle",
        ),
        ({"rows": {"columns": ["scenario.speed"], "values": [[8], [99]]}}, "rows", "row 2, scenario.speed: expected"),
        ({"rows": {"columns": ["scenario.x"], "values": [[8]]}}, "rows", "unknown parameter"),
        ({"from": "drives.csv"}, "from", "campaign file"),
        ({"scenario.speed": {"histogram": {"edges": [1, 1], "weights": [1]}}}, "scenario.speed", "ascending"),
    ],
)  # fmt: skip
def test_wrong_distributions_are_refused_by_name(
    declared: dict[str, object], name: str | None, message: str
) -> None:
    with pytest.raises(DistributionError, match=message) as caught:
        distributed(SPACE, declared)
    assert caught.value.name == name


def test_parameters_that_a_constraint_decides_cannot_have_a_distribution() -> None:
    space = SearchSpace(
        (
            Component(
                "box",
                (Real("left", 0.0, 800.0), Real("right", 0.0, 800.0)),
                (Extent("left", "right", 50.0, 800.0),),
            ),
        )
    )
    with pytest.raises(DistributionError, match=r"box.left cannot have a distribution"):
        distributed(space, {"box.left": {"normal": {"mean": 100, "deviation": 9}}})


@pytest.mark.parametrize("space", [*example_spaces().values(), SPACE])
def test_rows_drawn_at_once_are_valid_and_distributed_as_single_draws(space: SearchSpace) -> None:
    rng = np.random.default_rng(4)
    rows = space.draw_rows(300, rng)
    for row in rows:
        space.check(space.split(row))
    single = np.array([space.join(space.draw(rng)) for _ in range(300)])
    # Means differ by less than four standard errors in every column.
    error = np.sqrt((rows.var(axis=0) + single.var(axis=0)) / 300)
    assert (np.abs(rows.mean(axis=0) - single.mean(axis=0)) <= 4 * error + 1e-12).all()
