"""Average precision in cases computed by hand, and its invariants."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from brink.sim.perception.boxes import (
    Detections,
    GroundTruth,
    curves,
    mean_average_precision,
    non_maximum_suppression,
    overlaps,
)

PERSON, VEHICLE = 1, 0


def boxes(*rows: tuple[float, float, float, float]) -> NDArray[np.float32]:
    return np.array(rows, np.float32).reshape(len(rows), 4)


def truth(
    *rows: tuple[float, float, float, float], label: int = PERSON, ignored: tuple[int, ...] = ()
) -> GroundTruth:
    flags = np.zeros(len(rows), np.bool_)
    flags[list(ignored)] = True
    return GroundTruth(labels=np.full(len(rows), label), boxes=boxes(*rows), ignored=flags)


def found(*rows: tuple[float, float, float, float, float], label: int = PERSON) -> Detections:
    array = np.array(rows, np.float32).reshape(len(rows), 5)
    return Detections(labels=np.full(len(rows), label), boxes=array[:, :4], scores=array[:, 4])


A, B, C = (0.0, 0.0, 10.0, 20.0), (50.0, 0.0, 60.0, 20.0), (100.0, 0.0, 110.0, 20.0)


def test_overlap_is_intersection_over_union() -> None:
    got = overlaps(boxes(A, (5.0, 0.0, 15.0, 20.0)), boxes(A, B, (0.0, 0.0, 0.0, 0.0)))
    assert got == pytest.approx(np.array([[1.0, 0.0, 0.0], [1 / 3, 0.0, 0.0]]))


def test_a_perfect_result_has_an_average_precision_of_one() -> None:
    assert mean_average_precision([truth(A, B)], [found((*A, 0.9), (*B, 0.8))]) == pytest.approx(1.0)


def test_finding_half_without_a_mistake_reaches_half_of_the_recalls() -> None:
    # Precision 1 up to a recall of .5: 51 of the 101 recalls.
    assert mean_average_precision([truth(A, B)], [found((*A, 0.9))]) == pytest.approx(51 / 101)


def test_a_false_positive_before_the_last_hit_lowers_precision_beyond_it() -> None:
    # Hit, miss, hit: precision 1 up to a recall of .5, then 2/3.
    got = mean_average_precision([truth(A, B)], [found((*A, 0.9), (*C, 0.8), (*B, 0.7))])
    assert got == pytest.approx((51 + 50 * 2 / 3) / 101)


def test_a_duplicate_is_a_false_positive() -> None:
    (curve,) = curves([truth(A)], [found((*A, 0.9), (*A, 0.8))])
    assert curve.hits.tolist() == [True, False]


def test_an_iou_below_one_half_is_a_false_positive() -> None:
    assert mean_average_precision([truth(A)], [found((4.0, 0.0, 14.0, 20.0, 0.9))]) == 0.0


def test_ignored_ground_truth_is_neutral() -> None:
    assert mean_average_precision([truth(A, B, ignored=(1,))], [found((*B, 0.9), (*A, 0.8))]) == 1.0
    assert mean_average_precision([truth(A, B, ignored=(1,))], [found((*A, 0.8))]) == 1.0


def test_pictures_are_matched_separately_and_scored_together() -> None:
    (curve,) = curves([truth(A), truth(B)], [found((*B, 0.95)), found((*B, 0.9), (*A, 0.5))])
    assert curve.hits.tolist() == [False, True, False]
    assert curve.positives == 2
    assert curve.at_score(0.9) == (0.5, 0.5)
    assert curve.at_score(0.99) == (1.0, 0.0)


def test_the_mean_is_over_the_classes_that_occur() -> None:
    people, cars = truth(A), truth(B, label=VEHICLE)
    both = GroundTruth(
        labels=np.concatenate([people.labels, cars.labels]),
        boxes=np.concatenate([people.boxes, cars.boxes]),
        ignored=np.concatenate([people.ignored, cars.ignored]),
    )
    assert mean_average_precision([both], [found((*A, 0.9))]) == pytest.approx(0.5)
    assert mean_average_precision([people], [found((*A, 0.9))]) == pytest.approx(1.0)
    assert np.isnan(mean_average_precision([truth()], [found()]))


def test_the_numbers_of_pictures_must_agree() -> None:
    with pytest.raises(ValueError, match="expected one set of detections per image"):
        curves([truth(A)], [])


@settings(deadline=None)
@given(st.lists(st.booleans(), min_size=1, max_size=30), st.integers(0, 20))
def test_average_precision_equals_its_definition(hits: list[bool], missed: int) -> None:
    places = [(20.0 * i, 0.0, 20.0 * i + 10.0, 10.0) for i in range(len(hits))]
    real = [place for place, hit in zip(places, hits, strict=True) if hit]
    absent = [(20.0 * i, 100.0, 20.0 * i + 10.0, 110.0) for i in range(missed)]
    said = [(*place, 1.0 - 0.01 * rank) for rank, place in enumerate(places)]
    if not real and not absent:
        return
    total, right, points = len(real) + missed, 0, []
    for rank, hit in enumerate(hits, start=1):
        right += hit
        points.append((right / total, right / rank))
    expected = np.mean([max([p for r, p in points if r >= k / 100 - 1e-9], default=0.0) for k in range(101)])
    assert mean_average_precision([truth(*real, *absent)], [found(*said)]) == pytest.approx(expected)


def test_suppression_keeps_the_best_box_of_each_label() -> None:
    close = (1.0, 0.0, 11.0, 20.0)
    got = non_maximum_suppression(
        boxes(A, close, close, B), np.array([0.5, 0.9, 0.4, 0.3], np.float32), np.array([1, 1, 0, 1]), 0.6
    )
    assert got.tolist() == [1, 2, 3]
