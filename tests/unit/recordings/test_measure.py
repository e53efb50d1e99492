"""Detections and truth of a recording as errors of the detector: geometry, visibility, and who is the target."""

import math
from dataclasses import replace
from typing import Any

import pytest

from brink.recordings.camera import CameraError, CameraModel
from brink.recordings.choices import Visibility
from brink.recordings.measure import contradictions, observe
from brink.recordings.recording import Detection, RecordedDrive, Recording, RecordingError, RoadUser, Sides
from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import ObstacleLabel
from brink.sim.urban.detection_errors import ErrorType, Target
from brink.sim.urban.error_meter import DriveErrors

OWN = Camera()
TILTED = CameraModel(
    width_px=1242.0,
    height_px=375.0,
    fx_px=721.5,
    fy_px=721.5,
    cx_px=609.6,
    cy_px=172.9,
    above_m=1.65,
    pitch_deg=2.0,
)


def seen_by(model: CameraModel, ahead_m: float, left_m: float, up_m: float) -> tuple[float, float]:
    """Return where a camera shows a point, relative to the ground below it."""
    pitch_rad = math.radians(model.pitch_deg)
    down_m = model.above_m - up_m
    along = ahead_m * math.cos(pitch_rad) + down_m * math.sin(pitch_rad)
    below = down_m * math.cos(pitch_rad) - ahead_m * math.sin(pitch_rad)
    return model.cx_px - model.fx_px * left_m / along, model.cy_px + model.fy_px * below / along


def car(model: CameraModel, ahead_m: float, left_m: float = 0.0) -> Sides:
    """Return the box of a car's rear: 1.8 m wide, 1.5 m high."""
    x_max, bottom = seen_by(model, ahead_m, left_m - 0.9, 0.0)
    x_min, _ = seen_by(model, ahead_m, left_m + 0.9, 0.0)
    return Sides(x_min, x_max, seen_by(model, ahead_m, left_m, 1.5)[1], bottom)


def user(sides: Sides, track: str = "7", **more: Any) -> RoadUser:
    return RoadUser(track=track, label=ObstacleLabel.VEHICLE, sides=sides, **more)


def recording(
    users: list[RoadUser], detections: list[Detection], *, model: CameraModel | None = None, count: int = 60
) -> Recording:
    """Return a drive of the same image again and again, ten times a second."""
    drive = RecordedDrive(name="d")
    for step in range(count):
        image = drive.image(step / 10)
        image.road_users.extend(users)
        image.detections.extend(detections)
    return Recording(name="r", drives={"d": drive}, camera=model)


def errors(made: Recording, **options: Any) -> DriveErrors:
    (drive,) = observe(made, **options)
    return drive.measured.errors


def detection(sides: Sides, **more: Any) -> Detection:
    return Detection(label=ObstacleLabel.VEHICLE, sides=sides, **more)


@pytest.mark.parametrize("ahead_m", [5.0, 12.0, 30.0, 55.0])
@pytest.mark.parametrize("left_m", [-3.5, 0.0, 1.0])
def test_a_tilted_camera_with_its_axis_off_the_middle_shows_the_same_places(
    ahead_m: float, left_m: float
) -> None:
    box = TILTED.box(ObstacleLabel.VEHICLE, car(TILTED, ahead_m, left_m), OWN)
    assert OWN.ground_depth_m(box.y_max_px) == pytest.approx(ahead_m)
    assert OWN.left_m(0.5 * (box.x_min_px + box.x_max_px), ahead_m) == pytest.approx(left_m)
    (one,) = observe(recording([user(car(TILTED, ahead_m, left_m))], [], model=TILTED))
    assert one.meter.samples[0].depth_m == pytest.approx(ahead_m)


def test_a_horizon_that_is_not_at_half_height_is_told_from_distances_or_heights() -> None:
    level = replace(TILTED, cy_px=120.0, pitch_deg=0.0)
    given = [user(car(TILTED, 30.0), distance_m=30.0)]
    assert contradictions(recording(given, [], model=TILTED)) == []
    (words,) = contradictions(recording(given, [], model=level))
    assert "times as far away as the recording says" in words
    (words,) = contradictions(recording([user(car(TILTED, 30.0))], [], model=replace(level, above_m=9.0)))
    assert "m high (median), so distances are wrong" in words
    high = replace(TILTED, cy_px=300.0)
    (words,) = contradictions(recording([user(car(TILTED, 30.0))], [], model=high))
    assert "most vehicles stand above the horizon" in words


def test_distances_of_the_recording_count_instead_of_the_box() -> None:
    made = recording([user(car(TILTED, 20.0), distance_m=50.0, left_m=0.0)], [], model=TILTED)
    (drive,) = observe(made)
    assert {sample.depth_m for sample in drive.meter.samples} == {50.0}


@pytest.mark.parametrize(
    ("hidden", "visibility"),
    [
        ({"occlusion": 2}, Visibility()),
        ({"visible_share": 0.2}, Visibility()),
        ({"truncation": 0.9}, Visibility()),
        ({"occlusion": 1}, Visibility(most_occlusion=0)),
        ({"visible_share": 0.4}, Visibility(least_share=0.5)),
    ],
)
def test_who_cannot_be_seen_cannot_be_missed(hidden: dict[str, Any], visibility: Visibility) -> None:
    ahead = user(car(TILTED, 15.0))
    assert errors(recording([ahead], [], model=TILTED)).magnitudes[Target.LEAD][
        ErrorType.MISS
    ] == pytest.approx(6.0)
    unseen = errors(recording([replace(ahead, **hidden)], [], model=TILTED), visibility=visibility)
    assert ErrorType.MISS not in unseen.magnitudes[Target.LEAD]


def test_what_is_too_small_to_be_expected_cannot_be_missed() -> None:
    tiny = Sides(609.0, 611.0, 170.0, 173.0)
    found = errors(recording([user(tiny, distance_m=40.0, left_m=0.0)], [], model=TILTED))
    assert set(found.magnitudes[Target.LEAD]) == {ErrorType.GHOST_ON_ROAD}


def test_a_car_ahead_that_is_hidden_by_another_is_not_the_lead() -> None:
    near = user(car(TILTED, 15.0), "near", occlusion=3)
    far = user(car(TILTED, 30.0), "far")
    (drive,) = observe(recording([near, far], [], model=TILTED))
    assert {(sample.track, sample.is_target) for sample in drive.meter.samples} == {(0, False), (1, True)}


def test_lanes_of_the_recording_count_instead_of_the_middle_of_the_image() -> None:
    """In a curve, the car ahead in the ego's lane is not in the middle of the image."""
    ahead, beside = user(car(TILTED, 25.0, 4.0), "ahead"), user(car(TILTED, 15.0), "beside")
    for lane, target in ((None, "beside"), (True, "ahead")):
        users = [replace(ahead, in_lane=lane), replace(beside, in_lane=None if lane is None else False)]
        (drive,) = observe(recording(users, [], model=TILTED))
        targets = {drive.tracks[sample.track] for sample in drive.meter.samples if sample.is_target}
        assert targets == {target}


def test_only_detections_from_the_threshold_on_count() -> None:
    sides = car(TILTED, 25.0)
    made = recording([user(sides)], [detection(sides, score=0.4)], model=TILTED)
    for threshold, missed_s in ((0.3, 0.0), (0.5, 6.0)):
        found = errors(made, threshold=threshold)
        assert found.magnitudes[Target.LEAD][ErrorType.MISS] == pytest.approx(missed_s)


def test_an_image_without_road_users_can_have_ghosts() -> None:
    found = errors(recording([], [detection(car(TILTED, 12.0))], model=TILTED))
    assert found.magnitudes[Target.LEAD] == {ErrorType.GHOST_ON_ROAD: pytest.approx(6.0)}


def test_detections_between_images_belong_to_the_nearest_or_to_none() -> None:
    sides = car(TILTED, 25.0)
    for shift_s, missed_s in ((0.02, 0.0), (0.05, None)):
        made = recording([user(sides)], [], model=TILTED)
        for time_s in made.drives["d"].images:
            made.drives["d"].detections_elsewhere[time_s + shift_s] = [detection(sides)]
        if missed_s is None:
            with pytest.raises(RecordingError, match="expected both on one clock"):
                observe(made)
        else:
            assert errors(made).magnitudes[Target.LEAD][ErrorType.MISS] == missed_s


def test_drives_that_are_too_short_or_too_coarse_are_refused() -> None:
    short = recording([user(car(TILTED, 20.0))], [], count=20)
    with pytest.raises(RecordingError, match=r"expected drives of at least 4 s of truth, got at most 1\.9 s"):
        observe(short)
    made = recording([user(car(TILTED, 20.0))], [])
    made.drives["short"] = short.drives["d"]
    assert [drive.drive.name for drive in observe(made)] == ["d"]
    assert made.dropped["drives with less than 4 s of truth"] == 1
    made = recording([user(car(TILTED, 20.0))], [])
    made.drives["d"].images = {
        100.0 * time_s * 10: image for time_s, image in made.drives["d"].images.items()
    }
    with pytest.raises(RecordingError, match=r"got every 100 s \(are the times in milliseconds\?\)"):
        observe(made)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"fx": 0}, "expected positive sizes"),
        ({"cx": 2000}, "the optical axis within the image"),
        ({"pitch_deg": 60}, "a pitch between -45 and 45"),
        ({"fx": "wide"}, "fx: 'wide'"),
        ({"fox": 1}, "unknown: 'fox'"),
    ],
)
def test_a_camera_that_cannot_be_is_refused(change: dict[str, Any], words: str) -> None:
    document = {
        "width": 1242,
        "height": 375,
        "fx": 721.5,
        "cx": 609.6,
        "cy": 172.9,
        "above_m": 1.65,
        "pitch_deg": 2.0,
    }
    assert CameraModel.from_document("camera", document) == TILTED
    with pytest.raises(CameraError, match=words):
        CameraModel.from_document("camera", document | change)
