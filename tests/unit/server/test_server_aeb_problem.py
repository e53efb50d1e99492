"""The problem of the emergency brake: from candidates to episodes and back."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brink.search.algorithm import Measured, Scored
from brink.search.errors import ConfigError
from brink.server.campaigns.body import parse_body
from brink.server.campaigns.submission import check_submission
from brink.server.errors import InvalidInput
from brink.server.problems.aeb_crossing import ACCIDENT, DANGEROUS_STOP, AebCrossing, AebCrossingParams
from brink.server.problems.base import MeasuresOnData, SimulatedProblem
from brink.sim.aeb.specification import AebScenario, Behaviour, Options
from brink.sim.perturbations import CATALOGUE
from brink.worker.wire import Completed, WireVerdict

PROBLEM = AebCrossing(AebCrossingParams())


@given(st.integers(0, 2**32 - 1))
def test_every_candidate_becomes_an_episode_that_can_run(seed: int) -> None:
    vectors = PROBLEM.space.sample(np.random.default_rng(seed))
    spec = PROBLEM.episode(vectors, seed)
    AebScenario.from_json(spec.scenario)
    behaviour = Behaviour.from_json(spec.behaviour)
    assert Options.from_json(spec.options).size_px == (640, 360)
    assert len({p.gene for p in behaviour.perturbations}) == 2
    assert all(0 <= p.level < CATALOGUE[p.gene].levels for p in behaviour.perturbations)


def test_genes_keep_their_order_and_levels_their_rank() -> None:
    values = {
        "scenario": {
            "time_of_day": "noon", "weather": "clear", "occluder": "van", "crossing_m": 50.0, "arrival_s": 0.0,
            "oncoming_m": 60.0,
        },
        "perturbation": {"gene_1": "smoke", "intensity_1": 0.3, "gene_2": "rain", "intensity_2": 1.0},
    }  # fmt: skip
    vectors = PROBLEM.space.encode(values)
    assert PROBLEM.perturbations(vectors) == [{"gene": "smoke", "level": 3}, {"gene": "rain", "level": 5}]
    assert PROBLEM.words(vectors) == (
        "smoke 3/10, then rain 5/5; noon, clear, pedestrian from behind a van after 50 m"
    )
    spec = PROBLEM.dataset_evaluation(vectors)
    assert spec.behaviour["perturbations"] == PROBLEM.perturbations(vectors)


def test_a_measurement_does_not_depend_on_the_scenario() -> None:
    rng = np.random.default_rng(1)
    first, second = PROBLEM.space.sample(rng), PROBLEM.space.sample(rng)
    mixed = (second[0], first[1])
    assert PROBLEM.dataset_evaluation(first).digest() == PROBLEM.dataset_evaluation(mixed).digest()
    assert PROBLEM.dataset_evaluation(first).digest() != PROBLEM.dataset_evaluation(second).digest()


@pytest.mark.parametrize(
    ("hazard", "robustness"), [("any", -2.0), ("accident", 1.5), ("dangerous-stop", -2.0)]
)
def test_the_hazard_that_was_chosen_gives_the_verdict(hazard: str, robustness: float) -> None:
    outcome = Completed(
        verdicts={
            ACCIDENT: WireVerdict(robustness=1.5, unit="m", violated_at_s=None),
            DANGEROUS_STOP: WireVerdict(robustness=-2.0, unit="m/s", violated_at_s=3.0),
        },
        objectives={"alpha": 0.4},
    )
    got = AebCrossing(AebCrossingParams(hazard=hazard)).evaluation(outcome)
    assert isinstance(got, Scored)
    assert (got.unsafe, got.robustness, got.objectives["alpha"]) == (robustness < 0, robustness, 0.4)
    assert PROBLEM.measurement(outcome) == Measured(objectives={"alpha": 0.4})


def test_it_is_what_it_says() -> None:
    assert isinstance(PROBLEM, SimulatedProblem)
    assert isinstance(PROBLEM, MeasuresOnData)
    assert AebCrossing(AebCrossingParams(perturbations=3)).space.dimension == 12
    with pytest.raises(ConfigError, match="perturbations"):
        AebCrossingParams(perturbations=9)


BODY: dict[str, Any] = {
    "name": "p", "problem": {"id": "aeb-crossing@1"}, "algorithm": {"id": "simood-ga@1"},
    "budget": {"simulations": 200},
}  # fmt: skip


def refused(**params: Any) -> dict[str, str]:
    with pytest.raises(InvalidInput) as caught:
        check_submission(parse_body({**BODY, "problem": {"id": "aeb-crossing@1", "params": params}}))
    return {error.pointer: error.message for error in caught.value.errors}


def test_the_first_generation_is_measured_on_data() -> None:
    _, solutions = check_submission(parse_body(BODY))
    assert len(solutions) == 20
    specs = [solution.job.spec for solution in solutions if solution.job is not None]
    assert len(set(specs)) == 20
    assert all('"simulator":"brink-dataset@1"' in spec.replace(" ", "") for spec in map(str, specs))


def test_what_is_missing_or_broken_is_told_at_submission(tmp_path: Path) -> None:
    broken = tmp_path / "labels.json"
    broken.write_text('{"images": []}')
    weights = tmp_path / "weights.onnx"
    weights.write_text("nothing")
    assert refused(dataset=str(broken)) == {
        "/problem/params/dataset": f"{broken}: expected a non-empty list of images, as in COCO format"
    }
    assert "No such file" in refused(dataset="nowhere.json")["/problem/params/dataset"]
    assert "no such file" in refused(detector="onnx:nowhere.onnx")["/problem/params/detector"]
    assert "brink-det@1" in refused(detector="brnk-det@1")["/problem/params/detector"]
    assert "cannot be loaded" in refused(detector=f"onnx:{weights}")["/problem/params/detector"]
    assert set(refused(detector="onnx:no.onnx", dataset="no.json")) == {
        "/problem/params/detector", "/problem/params/dataset",
    }  # fmt: skip


def test_only_the_techniques_that_were_chosen_are_used() -> None:
    chosen = AebCrossing(AebCrossingParams(techniques=" smoke, dirty ,smoke,contrast"))
    rng = np.random.default_rng(1)
    seen = {str(p["gene"]) for _ in range(40) for p in chosen.perturbations(chosen.space.sample(rng))}
    assert seen == {"smoke", "dirty", "contrast"}
    levels = [level for p in chosen.perturbations(chosen.space.sample(rng)) if (level := p["level"])]
    assert all(isinstance(level, int) and 0 < level <= 10 for level in levels)
    with pytest.raises(ConfigError, match=r"got 'smoek'") as caught:
        AebCrossingParams(techniques="smoek, dirty")
    assert caught.value.nearest == "smoke"
    with pytest.raises(ConfigError, match="at least 2 of them, got 1"):
        AebCrossingParams(techniques="smoke")
