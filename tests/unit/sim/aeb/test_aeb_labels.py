"""The label policy: visible boxes with the same minimum in data sets, episodes and users' annotations."""

import math

import numpy as np
import pytest

from brink.sim.aeb import dataset
from brink.sim.aeb.dataset import Split, labelled_frames
from brink.sim.aeb.labels import PERSON, VEHICLE, label_boxes, label_frame
from brink.sim.driving.camera import LEAST_VISIBLE
from brink.sim.perception.boxes import GroundTruth, LabelledFrame, too_small
from brink.sim.rendering import (
    Body,
    BodyKind,
    Frame,
    Light,
    PictureCamera,
    Renderer,
    StreetScene,
    Viewpoint,
    visible_bodies,
)
from brink.sim.world.scenario import TimeOfDay, Weather

ORIGIN = Viewpoint(x_m=0.0, y_m=0.0, yaw_rad=0.0)
GREY_NOON = Light(time_of_day=TimeOfDay.NOON, weather=Weather.CLOUDY)


def body(number: int, kind: BodyKind, x_m: float, y_m: float, size: tuple[float, float, float]) -> Body:
    return Body(
        id=number,
        kind=kind,
        x_m=x_m,
        y_m=y_m,
        yaw_rad=math.pi / 2,
        length_m=size[0],
        width_m=size[1],
        height_m=size[2],
        look=number,
    )


def person(number: int, x_m: float, y_m: float) -> Body:
    return body(number, BodyKind.PERSON, x_m, y_m, (0.5, 0.5, 1.7))


def car(number: int, x_m: float, y_m: float) -> Body:
    return body(number, BodyKind.VEHICLE, x_m, y_m, (4.4, 1.8, 1.5))


def label(*bodies: Body, width_px: int = 640) -> LabelledFrame:
    camera = PictureCamera(width_px=width_px, height_px=width_px * 9 // 16)
    return label_frame(Renderer(StreetScene(), GREY_NOON, camera, 1).frame(ORIGIN, bodies, 0.0))


def test_a_box_covers_only_what_is_visible_of_a_body() -> None:
    bodies = [car(1, 10.0, 0.0), person(2, 12.0, 1.4)]  # the car hides the legs
    frame = Renderer(StreetScene(), GREY_NOON, PictureCamera(width_px=640, height_px=360), 1).frame(
        ORIGIN, bodies, 0.0
    )
    labelled = label_frame(frame)
    behind = {found.id: found for found in visible_bodies(frame)}[2]
    assert behind.box is not None
    assert behind.box.y_max_px < behind.whole_box.y_max_px
    assert labelled.truth.labels.tolist() == [VEHICLE, PERSON]
    assert tuple(labelled.truth.boxes[1].tolist()) == tuple(behind.box)
    assert labelled.visible[1] == pytest.approx(behind.visible_share)


@pytest.mark.parametrize(("aside_m", "ignored"), [(0.0, True), (3.5, False)])
def test_an_almost_hidden_body_is_ignored(aside_m: float, ignored: bool) -> None:
    labelled = label(car(1, 10.0, 0.0), person(2, 16.0, aside_m))
    assert bool(labelled.truth.ignored[1]) is ignored
    assert bool(labelled.visible[1] < LEAST_VISIBLE) is ignored


@pytest.mark.parametrize("width_px", [320, 640, 1280])
@pytest.mark.parametrize(("ahead_m", "ignored"), [(12.0, False), (40.0, True)])
def test_distant_people_are_ignored_at_any_size_of_the_image(
    ahead_m: float, ignored: bool, width_px: int
) -> None:
    assert label(person(1, ahead_m, 0.0), width_px=width_px).truth.ignored.tolist() == [ignored]


def test_boxes_count_from_12_by_6_px_of_an_image_of_640_by_360() -> None:
    boxes = np.array([[0, 0, 6, 12], [0, 0, 5.9, 12], [0, 0, 6, 11.9]], np.float32)
    assert too_small(boxes, 640, 360).tolist() == [False, True, True]
    assert too_small(boxes / np.float32(2), 320, 180).tolist() == [False, True, True]


@pytest.mark.parametrize("width_px", [320, 640])
def test_episodes_and_data_sets_have_the_same_ground_truth(
    width_px: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    pairs: list[tuple[GroundTruth, GroundTruth]] = []

    def both(frame: Frame) -> LabelledFrame:
        labelled = label_frame(frame)
        pairs.append((labelled.truth, label_boxes(frame)))
        return labelled

    monkeypatch.setattr(dataset, "label_frame", both)
    assert len(list(labelled_frames(Split.VALIDATION, 5, width_px=width_px))) == len(pairs)
    for one, other in pairs:
        assert np.array_equal(one.labels, other.labels)
        assert np.array_equal(one.boxes, other.boxes)
        assert np.array_equal(one.ignored, other.ignored)
    assert any(one.ignored.any() for one, _ in pairs)
