"""How wrong a detector was in a drive, from the simulator and from files."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import Box, ObstacleLabel
from brink.sim.episode import EpisodeSpec
from brink.sim.urban.camera import BrinkDriveCamera
from brink.sim.urban.detection_errors import MAGNITUDES, RELEVANT_M, ErrorType, Target
from brink.sim.urban.detection_files import CameraModel, DetectionFileError, read_coco, read_csv
from brink.sim.urban.error_meter import MEASURES, RANGE_FROM_M, ErrorMeter, Measures, ReportedBox, TrueBox

CAMERA = Camera()
STEPS = 100
Report = Callable[[int, Box], Box | None]


def standing(depth_m: float, left_m: float = 0.0, label: ObstacleLabel = ObstacleLabel.VEHICLE) -> Box:
    """Return the box of something 1.8 m wide and 1.5 m high that stands at a place."""
    middle = CAMERA.centre_x_px - left_m * CAMERA.focal_px / depth_m
    half = 0.9 * CAMERA.focal_px / depth_m
    bottom = CAMERA.horizon_px + CAMERA.focal_px * CAMERA.height_m / depth_m
    top = bottom - 1.5 * CAMERA.focal_px / depth_m
    return Box(label=label, x_min_px=middle - half, x_max_px=middle + half, y_min_px=top, y_max_px=bottom)


LEAD = standing(15.0)


def measured(report: Report, true: Box = LEAD, kind: Target = Target.LEAD) -> Measures:
    """Return what the meter says of a drive with one road user, given how it is reported at each step."""
    meter = ErrorMeter(CAMERA)
    for step in range(STEPS):
        box = report(step, true)
        meter.see(step / 10, [TrueBox(7, true, kind, True)], [] if box is None else [ReportedBox(box)])
    return meter.errors().magnitudes


def at_distance(box: Box, depth_m: float) -> Box:
    return box._replace(y_max_px=CAMERA.horizon_px + CAMERA.focal_px * CAMERA.height_m / depth_m)


def test_a_true_report_has_no_error() -> None:
    found = measured(lambda step, box: box)
    assert set(found) == {Target.LEAD, Target.EVERYBODY, Target.PEDESTRIAN}
    assert set(found[Target.PEDESTRIAN]) == {ErrorType.GHOST_ON_ROAD}
    for errors in found.values():
        assert {kind: MAGNITUDES[kind].severity(value) for kind, value in errors.items()} == dict.fromkeys(
            errors, 0.0
        )


@pytest.mark.parametrize(
    ("report", "kind", "expected"),
    [
        (lambda step, box: None if 20 <= step < 33 else box, ErrorType.MISS, 1.3),
        (lambda step, box: None if step < 13 else box, ErrorType.LATE, 1.3),
        (lambda step, box: None if step % 20 < 5 and step > 0 else box, ErrorType.FLICKER, 0.24),
        (lambda step, box: at_distance(box, 18.0), ErrorType.TOO_FAR, 0.2),
        (lambda step, box: at_distance(box, 12.0), ErrorType.TOO_NEAR, 0.2),
        (lambda step, box: standing(15.0, 0.5), ErrorType.LEFT, 0.5),
        (lambda step, box: standing(15.0, -0.5), ErrorType.RIGHT, 0.5),
        (
            lambda step, box: box._replace(label=ObstacleLabel.PERSON) if 20 <= step < 33 else box,
            ErrorType.WRONG_LABEL, 1.3,
        ),
    ],
)  # fmt: skip
def test_each_error_is_measured_in_its_unit(report: Report, kind: ErrorType, expected: float) -> None:
    errors = measured(report)[Target.LEAD]
    assert errors[kind] == pytest.approx(expected, abs=1e-6)
    missed_s = {ErrorType.MISS: 1.3, ErrorType.LATE: 1.3, ErrorType.FLICKER: 0.5}
    assert errors[ErrorType.MISS] == pytest.approx(missed_s.get(kind, 0.0))


def test_sizes_are_measured_about_the_centre() -> None:
    def larger(step: int, box: Box) -> Box:
        wide, high = box.x_max_px - box.x_min_px, box.y_max_px - box.y_min_px
        return box._replace(
            x_min_px=box.x_min_px - 0.1 * wide, x_max_px=box.x_max_px + 0.1 * wide,
            y_min_px=box.y_min_px - 0.1 * high, y_max_px=box.y_max_px + 0.1 * high,
        )  # fmt: skip

    assert measured(larger)[Target.LEAD][ErrorType.TOO_LARGE] == pytest.approx(0.2)


def test_an_error_of_place_counts_as_a_mean_over_the_time_for_which_the_target_is_there() -> None:
    brief = measured(lambda step, box: at_distance(box, 18.0) if 30 <= step < 40 else box)
    assert brief[Target.LEAD][ErrorType.TOO_FAR] == pytest.approx(0.2 / 10)


def test_a_range_is_short_only_if_there_was_something_beyond_it() -> None:
    meter = ErrorMeter(CAMERA)
    for step in range(STEPS):
        depth_m = 50.0 - 0.4 * step
        box = standing(depth_m)
        meter.see(
            step / 10, [TrueBox(1, box, Target.LEAD, True)], [ReportedBox(box)] if depth_m <= 25.0 else []
        )
    assert meter.errors().magnitudes[Target.LEAD][ErrorType.SHORT_RANGE] == pytest.approx(25.0, abs=0.5)
    far = measured(lambda step, box: box, standing(RANGE_FROM_M + 1.0))
    assert far[Target.LEAD][ErrorType.SHORT_RANGE] == RELEVANT_M
    assert ErrorType.SHORT_RANGE not in measured(lambda step, box: box)[Target.LEAD]


def test_a_few_far_detections_are_no_range() -> None:
    meter = ErrorMeter(CAMERA)
    for step in range(STEPS):
        box = standing(58.0 - 0.5 * step)
        meter.see(
            step / 10, [TrueBox(1, box, Target.LEAD, True)], [ReportedBox(box)] if step in (1, 50) else []
        )
    assert meter.errors().magnitudes[Target.LEAD][ErrorType.SHORT_RANGE] < 10.0


def test_what_is_missed_beyond_the_relevant_distance_does_not_count() -> None:
    far = standing(RELEVANT_M + 5.0)
    assert set(measured(lambda step, box: None, far)[Target.LEAD]) == {ErrorType.GHOST_ON_ROAD}


def test_a_detection_in_the_lane_where_nothing_is_counts_as_a_ghost() -> None:
    meter, far, ghost = ErrorMeter(CAMERA), standing(40.0), standing(8.0, 0.3)
    for step in range(STEPS):
        boxes = [ReportedBox(far), ReportedBox(ghost)] if step < 7 else [ReportedBox(far)]
        meter.see(step / 10, [TrueBox(1, far, Target.LEAD, True)], boxes)
    assert meter.errors().magnitudes[Target.LEAD][ErrorType.GHOST_ON_ROAD] == pytest.approx(0.7)
    assert measured(lambda step, box: box)[Target.LEAD][ErrorType.GHOST_ON_ROAD] == 0.0


def test_a_target_that_is_hardly_there_is_not_measured() -> None:
    meter = ErrorMeter(CAMERA)
    for step in range(5):
        meter.see(step / 10, [TrueBox(1, LEAD, Target.LEAD, True)], [])
    assert all(set(errors) == {ErrorType.GHOST_ON_ROAD} for errors in meter.errors().magnitudes.values())


def test_a_target_that_is_never_reported_is_missed_and_late_for_its_whole_life() -> None:
    found = measured(lambda step, box: None)[Target.LEAD]
    assert found[ErrorType.MISS] == found[ErrorType.LATE] == pytest.approx(STEPS / 10)
    assert found[ErrorType.FLICKER] == 1.0
    # Nobody knows where a detection would have been.
    assert not found.keys() & {ErrorType.TOO_FAR, ErrorType.LEFT, ErrorType.TOO_LARGE, ErrorType.WRONG_LABEL}


def test_a_miss_counts_while_the_road_user_is_a_target_whatever_it_was_before() -> None:
    meter, beside, ahead = ErrorMeter(CAMERA), standing(20.0, 3.5), standing(20.0)
    for step in range(STEPS):
        is_target = step >= 50
        box = ahead if is_target else beside
        reported = [] if 50 <= step < 90 else [ReportedBox(box)]
        kind = Target.LEAD if is_target else Target.EVERYBODY
        meter.see(step / 10, [TrueBox(1, box, kind, is_target)], reported)
    errors = meter.errors()
    assert errors.magnitudes[Target.LEAD][ErrorType.MISS] == pytest.approx(4.0)
    assert errors.magnitudes[Target.LEAD][ErrorType.LATE] == 0.0
    assert errors.spans[Target.LEAD][ErrorType.MISS] == (5.0, pytest.approx(4.0), 1)


def test_time_out_of_sight_is_no_delay() -> None:
    meter = ErrorMeter(CAMERA)
    for step in range(240):
        is_hidden = 20 <= step < 220
        hidden = TrueBox(1, LEAD, Target.LEAD, not is_hidden, is_visible=not is_hidden)
        truth = [] if 120 <= step < 220 else [hidden]
        meter.see(step / 10, truth, [])
    errors = meter.errors()
    assert errors.magnitudes[Target.LEAD][ErrorType.MISS] == pytest.approx(2.0)
    assert errors.magnitudes[Target.LEAD][ErrorType.LATE] == pytest.approx(4.0)
    assert ErrorType.LATE in errors.at_least[Target.LEAD]


def test_a_report_while_out_of_sight_is_the_first_detection_and_no_ghost() -> None:
    meter, near = ErrorMeter(CAMERA), standing(12.0)
    for step in range(STEPS):
        is_visible = step >= 10
        true = TrueBox(1, near, Target.LEAD, is_visible, is_visible=is_visible)
        meter.see(step / 10, [true], [ReportedBox(near)])
    found = meter.errors().magnitudes[Target.LEAD]
    assert (found[ErrorType.LATE], found[ErrorType.GHOST_ON_ROAD]) == (0.0, 0.0)


def test_nobody_knows_how_late_what_an_excerpt_begins_with_was_reported() -> None:
    for is_excerpt in (False, True):
        for missed in (0, 3):
            meter = ErrorMeter(CAMERA, is_excerpt=is_excerpt)
            for step in range(STEPS):
                reported = [] if step < missed else [ReportedBox(LEAD)]
                meter.see(step / 10, [TrueBox(1, LEAD, Target.LEAD, True)], reported)
            errors = meter.errors()
            assert errors.magnitudes[Target.LEAD][ErrorType.LATE] == pytest.approx(missed / 10)
            assert (ErrorType.LATE in errors.at_least.get(Target.LEAD, ())) is is_excerpt
            assert (ErrorType.MISS in errors.at_least.get(Target.LEAD, ())) is (is_excerpt and missed > 0)


def test_what_is_reported_where_nothing_was_labelled_is_no_ghost() -> None:
    ghost, far = standing(8.0), standing(40.0)
    for ignored, expected_s in (([], STEPS / 10), ([ghost], 0.0)):
        meter = ErrorMeter(CAMERA)
        for step in range(STEPS):
            truth = [TrueBox(1, far, Target.LEAD, True)]
            meter.see(step / 10, truth, [ReportedBox(far), ReportedBox(ghost)], ignored)
        found = meter.errors().magnitudes[Target.LEAD]
        assert found[ErrorType.GHOST_ON_ROAD] == pytest.approx(expected_s)


def test_places_that_are_given_count_instead_of_the_box() -> None:
    meter = ErrorMeter(CAMERA)
    for step in range(STEPS):
        true = TrueBox(1, LEAD, Target.LEAD, True, depth_m=30.0, left_m=0.0)
        meter.see(step / 10, [true], [ReportedBox(LEAD, depth_m=36.0, left_m=0.5)])
    found = meter.errors().magnitudes[Target.LEAD]
    assert (found[ErrorType.TOO_FAR], found[ErrorType.LEFT]) == (pytest.approx(0.2), pytest.approx(0.5))
    assert found[ErrorType.SHORT_RANGE] == RELEVANT_M


def test_drives_with_a_camera_tell_the_errors_of_their_detector() -> None:
    spec = EpisodeSpec(
        simulator="brink-drive-camera@2",
        scenario={
            "time_of_day": "noon", "weather": "clear", "pedestrians": 0, "road_curve": "straight", "road_id": 0,
            "road_length": 0, "driving_task": "follow_road",
        },
        behaviour={"mode": "detector", "detector": "brink-det@2", "threshold": 0.5},
        requirements=("front-gap@1",), seed=1, duration_s=5.0, options={"fidelity": "bicycle"},
    )  # fmt: skip
    found = BrinkDriveCamera().run(spec).features[MEASURES]
    assert isinstance(found, dict)
    lead = found["lead"]
    assert isinstance(lead, dict)
    assert set(lead) >= {kind.value for kind in (ErrorType.MISS, ErrorType.TOO_FAR, ErrorType.LATE)}
    assert float(str(lead["too_far"])) < 0.3
    assert float(str(lead["miss"])) < 3.0


# Files.

HEADER = "drive,time_s,source,id,label,x_min_px,x_max_px,y_min_px,y_max_px,target,condition"
SIDES = f"{LEAD.x_min_px},{LEAD.x_max_px},{LEAD.y_min_px},{LEAD.y_max_px}"


def rows(
    *, missed: range = range(30, 43), step_s: float = 0.1, count: int = STEPS, clock_s: float = 0.0
) -> list[str]:
    found = []
    for step in range(count):
        time_s = step * step_s
        found.append(f"a,{time_s:.3f},truth,7,car,{SIDES},,by night")
        if step not in missed:
            found.append(f"a,{time_s + clock_s:.3f},detection,,vehicle,{SIDES},,by night")
    return found


def written(path: Path, lines: list[str], header: str = HEADER) -> Path:
    file = path / "boxes.csv"
    file.write_text("\n".join([header, *lines]) + "\n")
    return file


def test_a_csv_file_is_measured_like_a_drive(tmp_path: Path) -> None:
    (drive,) = read_csv(written(tmp_path, rows()))
    assert (drive.name, drive.condition) == ("a", "by night")
    assert drive.errors.magnitudes[Target.LEAD][ErrorType.MISS] == pytest.approx(1.3)
    assert drive.errors.magnitudes[Target.LEAD][ErrorType.TOO_FAR] == pytest.approx(0.0, abs=1e-9)


def test_boxes_of_another_camera_mean_the_same_places(tmp_path: Path) -> None:
    model = CameraModel(width_px=1600.0, height_px=900.0, fov_deg=60.0, height_m=1.2)
    box = model.box(ObstacleLabel.VEHICLE, (700.0, 900.0, 450.0, 450.0 + 1385.6406 * 1.2 / 15.0), CAMERA)
    depth_m = CAMERA.ground_depth_m(box.y_max_px)
    assert depth_m == pytest.approx(15.0, rel=1e-4)
    assert CAMERA.left_m(box.x_min_px, 15.0) == pytest.approx(100.0 * 15.0 / 1385.6406, rel=1e-4)


def test_of_several_vehicles_the_nearest_in_the_lane_is_the_lead(tmp_path: Path) -> None:
    beside, behind = standing(10.0, 4.0), standing(30.0)
    lines = rows()
    for step in range(STEPS):
        for track, box in (("8", beside), ("9", behind)):
            sides = f"{box.x_min_px},{box.x_max_px},{box.y_min_px},{box.y_max_px}"
            lines.append(f"a,{step / 10:.3f},truth,{track},car,{sides},,by night")
    (drive,) = read_csv(written(tmp_path, lines))
    assert drive.errors.magnitudes[Target.LEAD][ErrorType.MISS] == pytest.approx(1.3)
    assert drive.errors.magnitudes[Target.LEAD][ErrorType.LATE] == 0.0
    assert Target.ONCOMING not in drive.errors.magnitudes


def replaced(lines: list[str], place: int, old: str, new: str) -> list[str]:
    assert old in lines[place]
    return [*lines[:place], lines[place].replace(old, new), *lines[place + 1 :]]


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ([], "expected boxes, found none"),
        (rows(count=20), r"expected at least 4 s of truth, got 1\.9 s: too short for durations"),
        (rows(step_s=1.0), r"expected images every 0\.02 to 0\.5 s, got every 1 s"),
        (
            rows(clock_s=0.05),
            r"detections at 0\.05 s, but the nearest truth is at .*: expected both|one clock",
        ),
        (rows(clock_s=1000.0), "expected both on one clock"),
        (replaced(rows(), 0, "truth,7", "truth,"), ":2: id: expected the id of a true road user"),
        ([*rows(), rows()[0]], "id '7' occurs twice at 0 s"),
        (replaced(rows(), 0, "car", "tree"), "label: expected one of vehicle, car"),
        (replaced(rows(), 0, "truth", "guess"), "source: expected truth or detection, got 'guess'"),
        (replaced(rows(), 0, "0.000", "soon"), "time_s: expected a number, got 'soon'"),
        (replaced(rows(), 2, "by night", "by day"), "condition: expected 'by night' throughout drive a"),
        (replaced(rows(), 0, ",,by", ",sideways,by"), "target: expected one of lead, oncoming, crossing"),
        (replaced(rows(), 0, f"{LEAD.x_max_px}", "0"), "expected x_min_px < x_max_px"),
    ],
)
def test_a_csv_file_that_does_not_fit_is_refused(tmp_path: Path, lines: list[str], words: str) -> None:
    with pytest.raises(DetectionFileError, match=words):
        read_csv(written(tmp_path, lines))


def test_missing_columns_and_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(DetectionFileError, match="missing id"):
        read_csv(written(tmp_path, [], HEADER.replace(",id", "")))
    with pytest.raises(DetectionFileError, match="No such file"):
        read_csv(tmp_path / "none.csv")
    with pytest.raises(DetectionFileError, match="expected positive sizes"):
        CameraModel(fov_deg=180.0)


def coco(**changes: Any) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return a data set of one sequence at 10 frames per second, and results that miss the car for 1.3 s."""
    bbox = [LEAD.x_min_px, LEAD.y_min_px, LEAD.x_max_px - LEAD.x_min_px, LEAD.y_max_px - LEAD.y_min_px]
    images = [{"id": i, "width": 800, "height": 600, "video_id": 4, "frame_id": i} for i in range(STEPS)]
    notes = [{"id": i, "image_id": i, "category_id": 3, "track_id": 7, "bbox": bbox} for i in range(STEPS)]
    categories = [{"id": 3, "name": "car"}, {"id": 9, "name": "traffic light"}]
    results = [
        {"image_id": i, "category_id": 3, "bbox": bbox, "score": 0.4 if 30 <= i < 43 else 0.9}
        for i in range(STEPS)
    ]
    return {"images": images, "annotations": notes, "categories": categories, **changes}, results


def in_files(folder: Path, document: Any, results: Any) -> tuple[Path, Path]:
    files = folder / "truth.json", folder / "results.json"
    for file, content in zip(files, (document, results), strict=True):
        file.write_text(json.dumps(content))
    return files


def test_a_coco_data_set_with_sequences_is_measured(tmp_path: Path) -> None:
    (drive,) = read_coco(*in_files(tmp_path, *coco()), frames_per_s=10.0)
    assert (drive.name, drive.condition) == ("4", None)
    assert drive.errors.magnitudes[Target.LEAD][ErrorType.MISS] == pytest.approx(1.3)
    (sure,) = read_coco(*in_files(tmp_path, *coco()), frames_per_s=10.0, threshold=0.3)
    assert sure.errors.magnitudes[Target.LEAD][ErrorType.MISS] == 0.0


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda d, r: (d, {}), "a list of results"),
        (lambda d, r: ({**d, "images": 3}, r), "images: expected a list"),
        (lambda d, r: ({**d, "images": [{"id": 1}]}, r), r"images\[0\]: missing width, height"),
        (
            lambda d, r: ({**d, "images": [{"id": 0, "width": 8, "height": 6}]}, r),
            "expected video_id or sequence",
        ),
        (
            lambda d, r: (
                {**d, "annotations": [{k: v for k, v in d["annotations"][0].items() if k != "track_id"}]},
                r,
            ),
            "track_id is missing: without it, nothing has a duration",
        ),
        (
            lambda d, r: ({**d, "categories": [{"id": 3, "name": "tree"}]}, r),
            "expected one of the categories vehicle",
        ),
        (lambda d, r: (d, [{**r[0], "image_id": 5000}]), "expected the id of an image, got 5000"),
        (lambda d, r: (d, [{**r[0], "bbox": [1, 2, 0, 4]}]), "a positive width and height"),
        (lambda d, r: (d, [{"image_id": 0}]), "expected image_id, category_id, bbox and score"),
        (lambda d, r: (d, [{**r[0], "score": "0.9"}]), "result 0: score: expected a number, got '0.9'"),
        (lambda d, r: (d, [{**r[0], "image_id": [0]}]), "result 0: image_id: expected an id, got"),
        (lambda d, r: (d, [{**r[0], "category_id": {}}]), "result 0: category_id: expected an id, got"),
    ],
)
def test_a_coco_data_set_that_does_not_fit_is_refused(
    tmp_path: Path, spoil: Callable[[Any, Any], tuple[Any, Any]], words: str
) -> None:
    with pytest.raises(DetectionFileError, match=words):
        read_coco(*in_files(tmp_path, *spoil(*coco())), frames_per_s=10.0)


def test_images_need_times_or_a_frame_rate(tmp_path: Path) -> None:
    with pytest.raises(
        DetectionFileError, match="expected time_s, or frame_id and the number of frames per second"
    ):
        read_coco(*in_files(tmp_path, *coco()))
