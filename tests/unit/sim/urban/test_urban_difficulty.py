import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brink.sim.episode import EpisodeSpec
from brink.sim.figures import Row
from brink.sim.trials import Trial, run_trials
from brink.sim.urban import difficulty
from brink.sim.urban.behaviour import BOX_FIELDS, DetectorBehaviour, trajectory_ranges
from brink.sim.urban.difficulty import Sizes, consistent_effect_p, measure
from brink.sim.urban.draws import (
    CATEGORICAL,
    PARAMETERS,
    Draw,
    distance,
    draw,
    neighbour,
    redraw,
    without_ghosts,
)
from brink.sim.world.scenario import UrbanScenario

seeds = st.integers(0, 2**32)


def check(candidate: Draw) -> None:
    spec = candidate.spec(1, ("front-gap@1",))
    UrbanScenario.from_json(spec.scenario)
    DetectorBehaviour.from_json(spec.behaviour)
    for ghost in range(2):
        values = candidate.values
        if candidate.is_null(ghost):
            assert all(values[f"{ghost}.{name}"] == 0.0 for name in trajectory_ranges())
            continue
        assert float(values[f"{ghost}.t1_step"]) - float(values[f"{ghost}.t0_step"]) >= 300 / 18 - 1e-9
        for low, high in zip(BOX_FIELDS[::2], BOX_FIELDS[1::2], strict=True):
            assert float(values[f"{ghost}.{high}"]) - float(values[f"{ghost}.{low}"]) >= 50.0 - 1e-9


def test_there_are_twenty_nine_parameters() -> None:
    assert len(PARAMETERS) == len(set(PARAMETERS)) == 29


@given(seeds)
def test_draws_are_valid_candidates(seed: int) -> None:
    check(draw(np.random.default_rng(seed)))


@given(seeds, st.sampled_from(PARAMETERS))
def test_a_redraw_changes_its_parameter_and_stays_valid(seed: int, name: str) -> None:
    rng = np.random.default_rng(seed)
    base = draw(rng)
    if "." in name and not name.endswith("label") and base.is_null(int(name[0])):
        return
    before = dict(base.values)
    other = redraw(base, name, rng)
    check(other)
    assert base.values == before
    if name in CATEGORICAL:
        assert other.values[name] != base.values[name]
    changed = {key for key in PARAMETERS if other.values[key] != base.values[key]}
    group = name.split(".")[0]
    assert all(key == name or ("." in name and key.startswith(f"{group}.")) for key in changed)


@pytest.mark.parametrize("name", [name for name in PARAMETERS if name not in CATEGORICAL])
def test_a_redraw_of_a_number_seldom_changes_nothing(name: str) -> None:
    changes = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        base = draw(rng)
        if not base.is_null(int(name[0])):
            changes.append(redraw(base, name, rng).values != base.values)
    assert len(changes) > 20
    # An upper side below the lower one makes the smallest box, which it may have been before.
    assert sum(changes) > (0.4 if "_max_" in name else 0.9) * len(changes)


@given(seeds)
def test_distance_is_a_metric_on_candidates(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b, c = draw(rng), draw(rng), draw(rng)
    assert distance(a, a) == 0.0
    assert 0.0 <= distance(a, b) == distance(b, a) <= 1.0
    assert distance(a, c) <= distance(a, b) + distance(b, c) + 1e-12


@given(seeds)
def test_neighbours_are_near_and_valid(seed: int) -> None:
    rng = np.random.default_rng(seed)
    base = draw(rng)
    near = neighbour(base, rng)
    check(near)
    assert distance(base, near) < 0.2


def test_one_category_is_an_eighteenth_apart() -> None:
    rng = np.random.default_rng(3)
    base = without_ghosts(draw(rng))
    assert distance(base, redraw(base, "weather", rng)) == pytest.approx(1 / 18)


def test_an_effect_is_found_even_where_it_cancels_on_average_and_its_absence_too() -> None:
    rng = np.random.default_rng(5)
    context = rng.choice((-1.0, 1.0), size=(150, 1)) * (rng.random((150, 1)) < 0.3)
    assert consistent_effect_p(context + 0.5 * rng.normal(size=(150, 2)), rng, 999) < 0.01
    p_values = [consistent_effect_p(rng.normal(size=(150, 2)), rng, 199) for _ in range(60)]
    assert 0.25 < float(np.mean(p_values)) < 0.75
    assert consistent_effect_p(np.zeros((150, 2)), rng, 99) == 1.0


def test_trials_come_in_order_and_the_same_from_any_number_of_processes() -> None:
    specs = [draw(np.random.default_rng(i)).spec(i, ("front-gap@1",)) for i in range(6)]
    alone = list(run_trials(specs, processes=1))
    assert list(run_trials(specs, processes=2)) == alone
    assert len({trial.robustness for trial in alone}) > 1


def test_measuring_gives_every_row_and_tells_its_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    def fake(specs: list[EpisodeSpec], *, processes: int) -> list[Trial]:
        trials = []
        for spec in specs:
            number = int(spec.digest()[:6], 16) / 16**6
            is_oracle = spec.behaviour["mode"] == "oracle"
            robustness = 1.0 if is_oracle else number - 0.4
            trials.append(Trial(unsafe=robustness < 0, robustness=robustness))
        return trials

    monkeypatch.setattr(difficulty, "run_trials", fake)
    told: list[tuple[str, int, int]] = []
    sizes = Sizes(
        candidates=300,
        scenarios=10,
        reruns=100,
        pairs=50,
        redraws=20,
        number_redraws=10,
        ends=20,
        permutations=99,
    )
    rows: dict[str, Row] = {row.what: row for row in measure(sizes, progress=lambda *step: told.append(step))}
    assert len(rows) == 5 + 1 + 1 + 1 + 2 + 29
    assert rows["unsafe share"].met
    assert rows["unsafe share with a perfect detector"].value == 0.0
    assert not rows["verdicts that another seed flips"].met  # these verdicts are nothing but chance
    assert not rows["verdict agreement of neighbours, less that of strangers"].met
    assert told[0] == ("random candidates", 1, 300)
    assert all(done <= total for _, done, total in told)
