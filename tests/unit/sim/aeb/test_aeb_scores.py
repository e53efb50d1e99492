"""Scores of a detector: how often single images lead to the right braking decision."""

import math

import numpy as np
import pytest

from brink.sim.aeb.braking import Region
from brink.sim.aeb.scores import decision_accuracy, score_episode
from brink.sim.perception.boxes import Detections, GroundTruth

WARNING = Region.from_reference(640, 360, warning=True)
AHEAD, ASIDE = (300.0, 150.0, 340.0, 320.0), (20.0, 150.0, 60.0, 320.0)
VEHICLE, PERSON = 0, 1


def truth(*boxes: tuple[float, ...], label: int = PERSON, ignored: bool = False) -> GroundTruth:
    count = len(boxes)
    return GroundTruth(
        labels=np.full(count, label),
        boxes=np.array(boxes, np.float32).reshape(count, 4),
        ignored=np.full(count, ignored),
    )


def found(*boxes: tuple[float, ...], label: int = PERSON, score: float = 0.9) -> Detections:
    count = len(boxes)
    return Detections(
        labels=np.full(count, label),
        boxes=np.array(boxes, np.float32).reshape(count, 4),
        scores=np.full(count, score, np.float32),
    )


def accuracy(*images: tuple[GroundTruth, Detections], threshold: float = 0.5) -> float:
    truths, detections = [one for one, _ in images], [one for _, one in images]
    return decision_accuracy(truths, detections, [WARNING] * len(images), threshold)


@pytest.mark.parametrize(
    ("image", "right"),
    [
        ((truth(AHEAD), found(AHEAD)), 1),
        ((truth(AHEAD), found()), 0),
        ((truth(AHEAD), found(ASIDE)), 0),
        ((truth(AHEAD), found(AHEAD, label=VEHICLE)), 0),
        ((truth(AHEAD), found(AHEAD, score=0.4)), 0),
        ((truth(AHEAD, ASIDE), found(AHEAD)), 1),
        ((truth(), found()), 1),
        ((truth(ASIDE), found()), 1),
        ((truth(), found(AHEAD)), 0),
        ((truth(ASIDE), found(AHEAD, score=0.4)), 1),
        ((truth(AHEAD, label=VEHICLE), found(AHEAD, label=VEHICLE)), 1),
    ],
)
def test_an_image_decides_rightly_or_wrongly(image: tuple[GroundTruth, Detections], right: int) -> None:
    assert accuracy(image) == right


def test_both_kinds_of_image_weigh_the_same() -> None:
    braking = [(truth(AHEAD), found(AHEAD))] * 3 + [(truth(AHEAD), found())]
    assert accuracy(*braking, (truth(), found(AHEAD))) == pytest.approx(0.5 * (0.75 + 0.0))


def test_images_with_only_ignored_people_ahead_do_not_count() -> None:
    images = [(truth(AHEAD, ignored=True), found(AHEAD)), (truth(AHEAD, ignored=True), found())]
    assert math.isnan(accuracy(*images))
    assert accuracy(*images, (truth(), found())) == 1.0


def test_scores_on_each_side_of_the_region() -> None:
    scores = score_episode([truth(AHEAD, ASIDE)], [found(AHEAD)], 0.5, WARNING)
    assert (scores.alpha_inside, scores.alpha_outside) == pytest.approx((1.0, 0.0))
    assert (scores.recall_inside, scores.recall_outside) == (1.0, 0.0)
    assert scores.precision_inside == 1.0
    assert math.isnan(scores.precision_outside), "nothing is reported there"


@pytest.mark.parametrize("there", [truth(), truth(ASIDE), truth(AHEAD, label=VEHICLE)])
def test_people_reported_where_nobody_is_are_wrong_even_if_nobody_ever_is(there: GroundTruth) -> None:
    scores = score_episode([there], [found(AHEAD)], 0.5, WARNING)
    assert scores.precision_inside == 0.0
