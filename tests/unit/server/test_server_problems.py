"""The problems: from candidates to episodes, and from outcomes to evaluations."""

import json
import re
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from support.circumstances import violation
from support.onnx_file import write_network

from brink.search.algorithm import Measured, Scored
from brink.search.analysis.violations import niche_of, signature_of
from brink.search.errors import ConfigError
from brink.search.space import Categorical
from brink.server.campaigns.body import parse_body
from brink.server.campaigns.plan import check_submission
from brink.server.errors import InvalidInput
from brink.server.findings.kind import reported_by
from brink.server.problems.aeb_crossing import ACCIDENT, DANGEROUS_STOP, AebCrossing, AebCrossingParams
from brink.server.problems.base import NoParams, SimulatedProblem
from brink.server.problems.catalogue import (
    PROBLEMS,
    describe_algorithms,
    describe_problems,
    make_algorithm,
    make_params,
    make_problem,
)
from brink.server.problems.npc_actions import ORACLES, NpcActions, NpcActionsParams
from brink.sim import catalogue
from brink.sim.aeb.specification import AebScenario, Behaviour, Options
from brink.sim.catalogue import plugin_ids
from brink.sim.encounter.specification import EncounterScenario
from brink.sim.perturbations import CATALOGUE
from brink.sim.urban.detection_errors import BOX_TYPES, MAGNITUDES
from brink.worker.wire import Completed, WireVerdict

AEB = AebCrossing(AebCrossingParams())


@given(st.integers(0, 2**32 - 1))
def test_every_aeb_candidate_becomes_a_valid_episode(seed: int) -> None:
    vectors = AEB.space.sample(np.random.default_rng(seed))
    spec = AEB.episode(vectors, seed)
    AebScenario.from_json(spec.scenario)
    behaviour = Behaviour.from_json(spec.behaviour)
    assert Options.from_json(spec.options).size_px == (640, 360)
    assert len({p.gene for p in behaviour.perturbations}) == 2
    assert all(0 <= p.level < CATALOGUE[p.gene].levels for p in behaviour.perturbations)


def test_genes_keep_their_order_and_intensities_become_levels() -> None:
    values = {
        "scenario": {
            "time_of_day": "noon",
            "weather": "clear",
            "occluder": "van",
            "crossing_m": 50.0,
            "arrival_s": 0.0,
            "oncoming_m": 60.0,
        },
        "perturbation": {"gene_1": "smoke", "intensity_1": 0.3, "gene_2": "rain", "intensity_2": 1.0},
    }
    vectors = AEB.space.encode(values)
    assert AEB.perturbations(vectors) == [{"gene": "smoke", "level": 3}, {"gene": "rain", "level": 5}]
    assert AEB.words(vectors) == (
        "smoke 3/10, then rain 5/5; noon, clear, pedestrian from behind a van after 50 m"
    )
    spec = AEB.dataset_evaluation(vectors)
    assert spec.behaviour["perturbations"] == AEB.perturbations(vectors)


@pytest.mark.parametrize(("width_px", "asked"), [(640, None), (320, 320)])
def test_a_measurement_is_on_images_of_the_size_of_the_episodes(width_px: int, asked: int | None) -> None:
    problem = AebCrossing(AebCrossingParams(width_px=width_px))
    vectors = problem.space.sample(np.random.default_rng(0))
    assert problem.dataset_evaluation(vectors).scenario.get("width_px") == asked


def test_a_measurement_does_not_depend_on_the_scenario() -> None:
    rng = np.random.default_rng(1)
    first, second = AEB.space.sample(rng), AEB.space.sample(rng)
    mixed = (second[0], first[1])
    assert AEB.dataset_evaluation(first).digest() == AEB.dataset_evaluation(mixed).digest()
    assert AEB.dataset_evaluation(first).digest() != AEB.dataset_evaluation(second).digest()


@pytest.mark.parametrize(
    ("hazard", "robustness"), [("any", -2.0), ("accident", 1.5), ("dangerous-stop", -2.0)]
)
def test_the_chosen_hazard_gives_the_verdict(hazard: str, robustness: float) -> None:
    completed = Completed(
        verdicts={
            ACCIDENT: WireVerdict(robustness=1.5, unit="m", violated_at_s=None),
            DANGEROUS_STOP: WireVerdict(robustness=-2.0, unit="m/s", violated_at_s=3.0),
        },
        objectives={"alpha": 0.4},
    )
    got = AebCrossing(AebCrossingParams(hazard=hazard)).evaluation(completed)
    assert isinstance(got, Scored)
    assert (got.unsafe, got.robustness, got.objectives["alpha"]) == (robustness < 0, robustness, 0.4)
    assert AEB.measurement(completed) == Measured(objectives={"alpha": 0.4})


AEB_BODY: dict[str, Any] = {
    "name": "p",
    "problem": {"id": "aeb-crossing@1"},
    "algorithm": {"id": "simood-ga@1"},
    "budget": {"simulations": 200},
}


def refused(**params: Any) -> dict[str, str]:
    with pytest.raises(InvalidInput) as caught:
        check_submission(parse_body({**AEB_BODY, "problem": {"id": "aeb-crossing@1", "params": params}}))
    return {error.pointer: error.message for error in caught.value.errors}


def test_the_first_generation_is_measured_on_data() -> None:
    _, asked = check_submission(parse_body(AEB_BODY))
    (solutions,) = asked.generations
    assert 20 < len(solutions) <= 20 + 40, "20 individuals, and each of their techniques alone"
    specs = [solution.job.spec for solution in solutions if solution.job is not None]
    assert len(set(specs)) == len(solutions)
    assert all('"simulator":"brink-dataset@2"' in spec.replace(" ", "") for spec in map(str, specs))


def test_missing_and_broken_files_are_reported_at_submission(tmp_path: Path) -> None:
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
        "/problem/params/detector",
        "/problem/params/dataset",
    }


def test_a_detector_that_does_not_fit_the_data_is_refused_at_submission(tmp_path: Path) -> None:
    Image.new("RGB", (320, 180)).save(tmp_path / "a.png")
    labels = tmp_path / "labels.json"
    document: dict[str, Any] = {
        "images": [{"id": 1, "file_name": "a.png", "width": 320, "height": 180}],
        "annotations": [{"id": 1, "image_id": 1, "category_id": 1, "bbox": [10, 20, 30, 60]}],
        "categories": [{"id": 1, "name": "person"}],
    }
    labels.write_text(json.dumps(document))
    file, output = tmp_path / "net.onnx", np.ones((1, 6, 3), np.float32)
    weights = write_network(file, output, input_px=(320, 192))
    assert AebCrossing(AebCrossingParams(dataset=str(labels), detector=weights)).wrong_inputs() == []
    (tmp_path / "net.onnx.json").write_text('{"names": ["car", "dog"]}')
    told = refused(dataset=str(labels), detector=weights)
    assert told == {
        "/problem/params/dataset": f"{labels}: the detector only finds vehicles, but all boxes that count are persons"
    }
    (tmp_path / "net.onnx.json").write_text('{"input_px": [640, 640]}')
    told = refused(dataset=str(labels), detector=weights)
    assert set(told) == {"/problem/params/detector"}
    assert (
        "takes images of 320 x 192 px, but net.onnx.json says 640 x 640 px"
        in told["/problem/params/detector"]
    )
    document["images"][0]["height"] = 200
    labels.write_text(json.dumps(document))
    told = refused(dataset=str(labels))
    assert (
        "expected 320 x 200 px according to the annotations, got 320 x 180" in told["/problem/params/dataset"]
    )


def test_only_the_chosen_techniques_are_used() -> None:
    chosen = AebCrossing(AebCrossingParams(techniques=" smoke, dirty ,smoke,contrast"))
    rng = np.random.default_rng(1)
    seen = {str(p["gene"]) for _ in range(40) for p in chosen.perturbations(chosen.space.sample(rng))}
    assert seen == {"smoke", "dirty", "contrast"}
    levels = [level for p in chosen.perturbations(chosen.space.sample(rng)) if (level := p["level"])]
    assert all(isinstance(level, int) and 0 < level <= 10 for level in levels)
    with pytest.raises(ConfigError, match=r"got 'smoek'") as caught:
        AebCrossingParams(techniques="smoek, dirty")
    assert caught.value.nearest == "smoke"
    with pytest.raises(ConfigError, match="at least 2 techniques, got 1"):
        AebCrossingParams(techniques="smoke")


NPC = NpcActions(NpcActionsParams())


@given(st.integers(0, 2**32 - 1))
def test_every_npc_candidate_becomes_a_valid_episode(seed: int) -> None:
    vectors = NPC.space.sample(np.random.default_rng(seed))
    spec = NPC.episode(vectors, seed)
    scenario = EncounterScenario.from_json(spec.scenario)
    assert len(scenario.road_users) == len(NPC.participants(vectors)) == len(NPC.waypoints(vectors))
    for script, ends in zip(scenario.road_users, NPC.waypoints(vectors), strict=True):
        last = script.stretches[-1]
        assert last.from_s + last.lasts_s >= NPC.params.duration_s - 1e-6
        # The search measures distances with the position at the end of the first action.
        first = [stretch for stretch in script.stretches if stretch.action == script.stretches[0].action]
        assert script.stretches[0] in first
        assert any(
            np.allclose(stretch.at(stretch.from_s + stretch.lasts_s)[:2], ends[0], atol=1e-6)
            for stretch in script.stretches
        )


def outcome(**robustness: float) -> Completed:
    ids = {name.partition("@")[0].replace("-", "_"): name for name in ORACLES}
    least = dict.fromkeys(ORACLES, 1.0) | {ids[name]: value for name, value in robustness.items()}
    return Completed(
        verdicts={
            name: WireVerdict(robustness=value, unit="m", violated_at_s=None if value >= 0 else 2.0)
            for name, value in least.items()
        },
        objectives={"criticality_m": 0.7},
        features={"violations": [{"requirement": name} for name, value in least.items() if value < 0]},
    )


def test_any_violation_counts_or_only_the_chosen_one() -> None:
    hit = outcome(no_collision=-1.0, front_gap=-0.2)
    evaluation = NPC.evaluation(hit)
    assert isinstance(evaluation, Scored)
    assert (evaluation.unsafe, evaluation.robustness, evaluation.objectives["criticality_m"]) == (
        True,
        -1.0,
        0.7,
    )
    gap = NpcActions(NpcActionsParams(violation="front-gap@2", criticality="robustness"))
    chosen = gap.evaluation(hit)
    assert isinstance(chosen, Scored)
    assert (chosen.robustness, chosen.objectives["criticality_m"]) == (-0.2, -0.2)
    assert [one["requirement"] for one in gap.violations(hit)] == ["front-gap@2"]
    assert len(NPC.violations(hit)) == 2
    assert NPC.violations(outcome()) == []


@pytest.mark.parametrize(
    ("violation", "by_gap"),
    [("any", True), ("no-collision@1", True), ("front-gap@2", True)]
    + [(name, False) for name in ("lane-keeping@1", "red-light@1", "speed-limit@1", "progress@1")],
)
def test_criticality_follows_the_requirement(violation: str, by_gap: bool) -> None:
    near = NpcActions(NpcActionsParams(violation=violation)).evaluation(outcome(progress=-3.0))
    assert isinstance(near, Scored)
    assert near.objectives["criticality_m"] == (0.7 if by_gap else near.robustness)


def test_an_evaluation_names_the_kinds_of_violations() -> None:
    violations = [violation(), violation("front-gap@2", collision=None)]
    hit = outcome(no_collision=-1.0, front_gap=-0.2).model_copy(
        update={"features": {"violations": violations}}
    )
    evaluation = NPC.evaluation(hit)
    assert isinstance(evaluation, Scored)
    assert evaluation.kinds == {str(signature_of(one)) for one in violations}
    of_gap = NpcActions(NpcActionsParams(violation="front-gap@2")).evaluation(hit)
    assert isinstance(of_gap, Scored)
    assert of_gap.kinds == {str(signature_of(violations[1]))}


def test_only_what_a_careful_driver_avoids_counts_if_asked_for() -> None:
    def told(*avoidable: str | None) -> Scored:
        names = ("no-collision@1", "front-gap@2")
        violations = [
            {**violation(name), "avoidable": who} for name, who in zip(names, avoidable, strict=False) if who
        ]
        features: dict[str, Any] = {"violations": violations, "closest": {**violation(), "requirement": None}}
        hit = outcome(**({"no_collision": -1.0} if violations else {})).model_copy(
            update={"features": features}
        )
        found = NpcActions(NpcActionsParams(count="avoidable")).evaluation(hit)
        assert isinstance(found, Scored)
        assert found.unsafe is bool(violations)
        return found

    careful, ideal, nobody, safe = told("no", "careful"), told("ideal"), told("no"), told()
    assert [one.counts for one in (careful, ideal, nobody, safe)] == [True, False, False, True]
    assert [len(one.kinds) for one in (careful, ideal, nobody, safe)] == [1, 0, 0, 0]
    assert [one.objectives["criticality_m"] for one in (careful, ideal, nobody, safe)] == [0.7, 250, 250, 0.7]
    assert [[niche.rank for niche in one.niches] for one in (careful, ideal, nobody, safe)] == [
        [3, 0],
        [2],
        [3],
        [1],
    ]
    assert safe.niches[0].name == ("front", "same way, cut in", "driving", "straight")


@pytest.mark.parametrize(("count", "criticality_m", "kind"), [("all", 0.7, "car"), ("avoidable", 4.0, "van")])
def test_coming_close_to_a_standing_ego_does_not_lead_a_search_for_what_is_avoidable(
    count: str, criticality_m: float, kind: str
) -> None:
    near = [{**violation(other={"kind": kind}), "requirement": None} for kind in ("car", "van")]
    safe = outcome().model_copy(
        update={
            "objectives": {"criticality_m": 0.7, "moving_criticality_m": 4.0},
            "features": {"violations": [], "closest": near[0], "closest_moving": near[1]},
        }
    )
    problem = NpcActions(NpcActionsParams(count=count))
    evaluation = problem.evaluation(safe)
    assert isinstance(evaluation, Scored)
    assert evaluation.objectives["criticality_m"] == criticality_m
    expected = violation(other={"kind": kind}) | {"requirement": ""}
    assert [niche.name for niche in evaluation.niches] == [niche_of(expected)]


def test_results_of_old_campaigns_can_still_be_read() -> None:
    old = outcome(no_collision=1.0, front_gap=-0.2)
    verdicts = dict(old.verdicts)
    verdicts["front-gap@1"] = verdicts.pop("front-gap@2")
    listed = [violation("front-gap@1", collision=None)]
    old = old.model_copy(update={"verdicts": verdicts, "features": {"violations": listed}})
    evaluation = NPC.evaluation(old)
    assert isinstance(evaluation, Scored)
    assert (evaluation.robustness, len(NPC.violations(old)), len(evaluation.kinds)) == (-0.2, 1, 1)
    assert NpcActionsParams(violation="front-gap@1").violation == "front-gap@1"
    spec = NpcActions(NpcActionsParams(violation="front-gap@1")).episode(
        NPC.space.sample(np.random.default_rng(1)), 1
    )
    assert {"front-gap@1", "front-gap@2"} <= set(spec.requirements)


def test_a_requirement_that_the_road_cannot_violate_is_rejected() -> None:
    with pytest.raises(ConfigError, match="no other road has lights"):
        NpcActionsParams(violation="red-light@1", road_curve="straight")


def test_catalogue_offers_the_requirements_that_a_problem_takes() -> None:
    offered = {
        one["id"]: [
            option["value"] for option in one["params"]["properties"]["requirement"].get("options", [])
        ]
        for one in describe_problems(reported_by)
        if "requirement" in one["params"]["properties"]
    }
    assert offered["urban-injected@1"][-1] == "any"
    assert "lane-keeping@1" not in offered["sumo-drivers@1"], "SUMO does not measure it"


def test_a_plug_in_that_is_no_subclass_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    class Unrelated:
        id, summary, params_type, space = "unrelated@1", "Looks like a problem.", NoParams, NPC.space

        def __init__(self, params: NoParams) -> None: ...

        def evaluate(self, vectors: Any) -> Scored:
            return Scored(unsafe=True, robustness=-1.0)

    monkeypatch.setitem(catalogue._registered, PROBLEMS, {Unrelated.id: Unrelated})
    with pytest.raises(TypeError, match="expected a subclass of SimulatedProblem"):
        make_problem(Unrelated.id, {})


def test_settings_that_do_not_affect_a_search_are_accepted_but_not_offered() -> None:
    offered = {one["id"]: set(one["params"]["properties"]) for one in describe_algorithms()}
    assert {"radius", "p_th", "z"} <= offered["mlcshe@1"]
    for name in ("edge@1", "tolerance@1", "qd@1", "nsga2@1", "minimise@1"):
        assert offered[name].isdisjoint({"radius", "p_th", "z"}), name
    assert make_params(make_algorithm("edge@1").config_type, {"radius": 0.1}, "").radius == 0.1


@pytest.mark.parametrize(
    "problem", [one for one in plugin_ids(PROBLEMS) if one not in ("function@1", "gymnasium@1")]
)
def test_problems_state_the_resolution_of_their_numbers(problem: str) -> None:
    parameters = make_problem(problem, {}).space.parameters
    unstated = [p.name for p in parameters if not isinstance(p, Categorical) and p.resolution is None]
    assert unstated == []


def test_the_resolution_of_a_severity_is_that_of_its_magnitude() -> None:
    space = make_problem("urban-errors@1", {}).space
    names, choices = (
        list(space.column_names()),
        dict(zip(space.column_names(), space.parameters, strict=True)),
    )
    column, kind = names.index("behaviour.error_1.severity"), choices["behaviour.error_1.type"]
    assert isinstance(kind, Categorical)
    row = np.array(space.join(space.sample(np.random.default_rng(1))))
    for error in BOX_TYPES:
        magnitude = MAGNITUDES[error]
        row[names.index("behaviour.error_1.type")] = kind.encode(error.value)
        scale = abs(magnitude.most - magnitude.none)
        expected = {"s": 0.1, "m": 0.25, "share": 0.01}[magnitude.unit]
        assert space.resolutions(row)[0][column] * scale == pytest.approx(expected)


KEEP_GAP: Final[dict[str, Any]] = {"keep-gap": {"stl": "always (front_gap_m > 2)", "unit": "m"}}


@pytest.mark.parametrize(
    "problem_id", ["urban-injected@1", "urban-errors@1", "urban-camera@1", "sumo-drivers@1"]
)
def test_a_formula_gives_the_verdict_alone_or_beside_other_requirements(problem_id: str) -> None:
    for stated, expected in (
        (KEEP_GAP, ("keep-gap",)),
        (["no-collision@1", KEEP_GAP], ("no-collision@1", "keep-gap")),
    ):
        problem = make_problem(problem_id, {"requirement": stated})
        assert isinstance(problem, SimulatedProblem)
        vectors = problem.space.sample(np.random.default_rng(1))
        spec = problem.episode(vectors, 1)
        assert problem.requirements == expected
        assert set(expected) <= set(spec.requirements)
        assert spec.formulas == KEEP_GAP


@pytest.mark.parametrize(
    ("problem_id", "stated", "message"),
    [
        (
            "urban-injected@1",
            {"keep-gap": {"stl": "always gap > 1", "unit": "m"}},
            "no signal 'gap' is recorded",
        ),
        ("urban-injected@1", {"keep-gap": {"stl": "always[0:2", "unit": "m"}}, "character 11: expected ']'"),
        (
            "urban-injected@1",
            {"keep-gap": {"stl": "always[40:50] collision", "unit": "1"}},
            "looks 40 s ahead",
        ),
        ("urban-injected@1", {"front-gap": KEEP_GAP["keep-gap"]}, "expected a name of your own"),
        ("urban-injected@1", [KEEP_GAP, KEEP_GAP], "expected each requirement once"),
        ("urban-injected@1", {}, "expected at least one requirement"),
        (
            "sumo-drivers@1",
            {"own": {"stl": "pedestrian_gap_m > 1", "unit": "m"}},
            "no signal 'pedestrian_gap_m'",
        ),
    ],
)
def test_a_wrong_formula_is_refused_at_submission(problem_id: str, stated: Any, message: str) -> None:
    with pytest.raises(InvalidInput, match="requirement.*" + re.escape(message)):
        make_problem(problem_id, {"requirement": stated})
