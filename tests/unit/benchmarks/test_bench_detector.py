"""The measurement of a detector: its figures from known detections, and that it runs."""

from collections.abc import Mapping

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.cli import bench
from benchmarks.detector import (
    Accuracy,
    Bin,
    ClassAccuracy,
    DetectorAccuracy,
    ObservedImage,
    Step,
    evaluate,
    measure_detector,
)
from brink.server.errors import InvalidInput
from brink.sim.perception.boxes import Detections, GroundTruth
from brink.sim.perception.detector import LABELS
from brink.sim.perturbations import CATALOGUE, Perturbation

VEHICLE, PERSON = (LABELS.index(name) for name in ("vehicle", "person"))
GENES = [CATALOGUE["smoke"], CATALOGUE["channel_dropout"]]
PLACES = [(40.0 * place, 0.0, 40.0 * place + 20.0, 30.0) for place in range(8)]
DEPTHS_M = [4.0, 5.0, 15.0, 79.0, 3.0, 9.0, 19.0, 30.0]
VISIBLE = [1.0, 0.75, 0.5, 0.3, 1.0, 0.95, 0.74, 0.3]
"""Of four vehicles, then of four people."""
ALL = tuple(range(8))


def found(*places: int, score: float = 0.9) -> Detections:
    """Return correct detections of the bodies in some of the places."""
    return Detections(
        labels=np.array([VEHICLE if place < 4 else PERSON for place in places], np.int64),
        boxes=np.array([PLACES[place] for place in places], np.float32).reshape(len(places), 4),
        scores=np.full(len(places), score, np.float32),
    )


def observation(
    clean: Detections, perturbed: Mapping[Perturbation, Detections] | None = None
) -> ObservedImage:
    under = {step.of(gene): found(*ALL) for gene in GENES for step in Step}
    return ObservedImage(
        truth=GroundTruth(
            labels=np.array([VEHICLE] * 4 + [PERSON] * 4, np.int64),
            boxes=np.array(PLACES, np.float32),
            ignored=np.zeros(8, np.bool_),
        ),
        depths_m=np.array(DEPTHS_M, np.float32),
        visible=np.array(VISIBLE, np.float32),
        clean=clean,
        perturbed={**under, **(perturbed or {})},
    )


def measured(
    clean: Detections, perturbed: Mapping[Perturbation, Detections] | None = None
) -> DetectorAccuracy:
    return evaluate("a", [observation(clean, perturbed)], seed=0, threshold=0.5, genes=GENES)


def boxes_in(bins: Mapping[Bin, Accuracy]) -> dict[str, list[int]]:
    """Return the number of vehicles and of people that count, by name of the bin."""
    return {
        one.name: [accuracy.classes[name].boxes if name in accuracy.classes else 0 for name in LABELS]
        for one, accuracy in bins.items()
    }


def reached(count: int, of: int) -> float:
    """Return the average precision when a share of the boxes is found and nothing is wrong."""
    return (int(100 * count / of) + 1) / 101


def test_a_bin_counts_only_the_bodies_within_it() -> None:
    got = measured(found(0, 2, 4, 5))
    assert boxes_in(got.by_distance) == {
        "0 to 5 m": [1, 1],
        "5 to 10 m": [1, 1],
        "10 to 20 m": [1, 1],
        "20 to 40 m": [0, 1],
        "40 to 80 m": [1, 0],
    }
    maps = {one.name: accuracy.map for one, accuracy in got.by_distance.items()}
    assert maps == {
        "0 to 5 m": 1.0,
        "5 to 10 m": 0.5,
        "10 to 20 m": 0.5,
        "20 to 40 m": 0.0,
        "40 to 80 m": 0.0,
    }


def test_bodies_outside_a_bin_are_neutral_and_false_detections_count_in_every_bin() -> None:
    people = found(5, 4)
    nowhere = np.array([[0.0, 200.0, 9.0, 240.0]], np.float32)
    got = measured(
        Detections(
            labels=np.array([PERSON, PERSON, PERSON], np.int64),
            boxes=np.vstack([people.boxes, nowhere]),
            scores=np.array([0.9, 0.7, 0.8], np.float32),
        )
    )
    person = {one.name: accuracy.classes.get("person") for one, accuracy in got.by_distance.items()}
    assert person["0 to 5 m"] == ClassAccuracy(boxes=1, average_precision=0.5, precision=0.5, recall=1.0)
    assert person["5 to 10 m"] == ClassAccuracy(boxes=1, average_precision=1.0, precision=0.5, recall=1.0)
    assert person["10 to 20 m"] == ClassAccuracy(boxes=1, average_precision=0.0, precision=0.0, recall=0.0)
    assert person["40 to 80 m"] is None


def test_genes_are_measured_at_three_levels_and_averaged() -> None:
    smoke = GENES[0]
    got = measured(
        found(*ALL),
        {
            Perturbation("smoke", 1): found(0, 1, 2, 3, 4, 5),
            Perturbation("smoke", smoke.levels // 2): found(0, 1, 2, 3),
            Perturbation("smoke", smoke.levels - 1): found(),
            Perturbation("channel_dropout", 1): found(*ALL, score=0.4),
        },
    )
    first = got.genes["smoke"][Step.FIRST]
    assert first.map == pytest.approx(0.5 * (1 + reached(2, 4)))
    assert (first.person_precision, first.person_recall) == (1.0, 0.5)
    assert got.genes["smoke"][Step.MIDDLE].map == 0.5
    assert got.genes["smoke"][Step.HIGHEST].map == 0.0
    dropout = got.genes["channel_dropout"]
    assert dropout[Step.MIDDLE] is dropout[Step.FIRST]  # it has two levels
    assert (dropout[Step.FIRST].map, dropout[Step.FIRST].person_recall) == (1.0, 0.0)
    means = got.over_genes
    assert means[Step.FIRST].map == pytest.approx(0.5 * (first.map + 1.0))
    assert means[Step.FIRST].person_recall == 0.25
    assert means[Step.HIGHEST].map == 0.5
    assert [row.value for row in got.rows] == pytest.approx(
        [1.0, 1.0, means[Step.FIRST].map, 0.75, 1.0, 0.25]
    )
    assert [row.met for row in got.rows] == [True, True, True, True, True, False]


def test_a_measurement_is_reproducible() -> None:
    def run() -> DetectorAccuracy:
        return measure_detector(
            "brink-det@1",
            images=2,
            seed=2,
            threshold=0.5,
            processes=1,
            genes=[CATALOGUE["gaussian_noise"]],
            progress=lambda *_: None,
        )

    first = run()
    assert first.to_json() == run().to_json()
    assert first.clean.map is not None
    assert first.clean.map > 0.5
    assert first.genes["gaussian_noise"][Step.HIGHEST].map < first.clean.map


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--detector", "brnk-det@1"], "--detector: expected one of brink-det@1.*did you mean 'brink-det@1'"),
        (["--detector", "onnx:/nowhere.onnx"], "--detector: /nowhere.onnx: no such file"),
        (["--detector", "brink-det@1", "--picture", "a.gif"], "--picture: a.gif: expected a file name"),
    ],
    ids=["unknown", "missing file", "picture"],
)
def test_invalid_options_are_refused_before_anything_is_rendered(options: list[str], said: str) -> None:
    with pytest.raises(InvalidInput, match=said):
        CliRunner().invoke(bench, ["detector", *options], catch_exceptions=False)
