"""Recordings in CSV files: every column, what is dropped, and what is refused."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from brink.recordings.camera import CameraModel
from brink.recordings.formats.csv_format import COLUMNS, OPTIONAL
from brink.recordings.reading import parse_classes, read_recording
from brink.recordings.recording import CLASSES, Image, ReadOptions, Recording, RecordingError, Sides
from brink.sim.driving.interface import ObstacleLabel
from brink.sim.urban.detection_errors import Target

HEADER = ",".join(COLUMNS)
BOX = "380,420,300,340"


def written(folder: Path, rows: Sequence[str], header: str = HEADER) -> Path:
    file = folder / "boxes.csv"
    file.write_text("\n".join([header, *rows]) + "\n")
    return file


def read(
    folder: Path, rows: Sequence[str], header: str = HEADER, options: ReadOptions | None = None
) -> Recording:
    return read_recording(written(folder, rows, header), options=options)


def only_image(recording: Recording) -> Image:
    (drive,) = recording.drives.values()
    (image,) = drive.images.values()
    return image


def test_rows_become_images_road_users_and_detections(tmp_path: Path) -> None:
    rows = ["a,0.1,detection,,person,1,2,3,4", f"a,0.1,truth,7,car,{BOX}", f"b,0,truth,7,Pedestrian,{BOX}"]
    recording = read(tmp_path, rows)
    assert (recording.name, set(recording.drives)) == ("boxes", {"a", "b"})
    image = recording.drives["a"].images[0.1]
    (car,), (detection,) = image.road_users, image.detections
    assert (car.track, car.label, car.sides) == ("7", ObstacleLabel.VEHICLE, Sides(380, 420, 300, 340))
    assert (car.target, car.distance_m, car.left_m, car.in_lane, car.occlusion) == (None,) * 5
    assert (detection.label, detection.sides, detection.score) == (
        ObstacleLabel.PERSON,
        Sides(1, 2, 3, 4),
        1.0,
    )
    assert recording.drives["b"].images[0.0].road_users[0].label is ObstacleLabel.PERSON


def test_all_optional_columns_are_read(tmp_path: Path) -> None:
    header = ",".join([*COLUMNS, *OPTIONAL, "speed"])
    rows = [
        f'a,0,truth,7,car,{BOX},oncoming,"night, wet",,2,.4,.1,21.5,3.25,left,0,9',
        f"a,0,truth,8,car,{BOX},,,,,,,,,ego,,",
        f"a,0,truth,9,car,{BOX},,,,,,,,,,,",
        "a,0,truth,,tree,1,2,3,4,,,,,,,,,,1,",
        f"a,0,detection,,car,{BOX},,,.25,,,,22,-3,,,",
        f"b,0,truth,9,car,{BOX},,,,,,,,,,,",
    ]
    recording = read(tmp_path, rows, header)
    drive = recording.drives["a"]
    first, second, third = drive.images[0.0].road_users
    assert drive.condition == "night, wet"
    assert (first.target, first.occlusion, first.visible_share, first.truncation) == (
        Target.ONCOMING,
        2,
        0.4,
        0.1,
    )
    assert (first.distance_m, first.left_m, first.in_lane) == (21.5, 3.25, False)
    assert (second.in_lane, third.in_lane) == (True, False), (
        "one without a lane is in none of those that are named"
    )
    assert recording.drives["b"].images[0.0].road_users[0].in_lane is None, "nothing is said of lanes there"
    assert drive.images[0.0].ignored == [Sides(1, 2, 3, 4)]
    (detection,) = drive.images[0.0].detections
    assert (detection.score, detection.distance_m, detection.left_m) == (0.25, 22.0, -3.0)
    assert recording.notes == [f"Columns of {tmp_path / 'boxes.csv'} that were not read: speed."]


def test_images_without_road_users_and_regions_without_class_can_be_said(tmp_path: Path) -> None:
    rows = ["a,0,frame,,,,,,", "a,0.1,ignore,,,1,2,3,4", f"a,0.1,detection,,car,{BOX}"]
    drive = read(tmp_path, rows).drives["a"]
    assert sorted(drive.images) == [0.0, 0.1]
    assert drive.images[0.0] == Image(time_s=0.0)
    assert drive.images[0.1].ignored == [Sides(1, 2, 3, 4)]
    assert len(drive.images[0.1].detections) == 1


def test_a_detection_makes_no_image(tmp_path: Path) -> None:
    drive = read(tmp_path, [f"a,0.02,detection,,car,{BOX}", "a,0,frame,,,,,,"]).drives["a"]
    assert (list(drive.images), list(drive.detections_elsewhere)) == ([0.0], [0.02])


def test_other_classes_mean_what_the_user_says(tmp_path: Path) -> None:
    rows = [f"a,0,truth,1,cyclist,{BOX}", f"a,0,detection,,Cyclist,{BOX}"]
    with pytest.raises(RecordingError, match=r":2: label: .*got 'cyclist' .*--classes cyclist=vehicle"):
        read(tmp_path, rows)
    person = ReadOptions(classes={**CLASSES, **parse_classes(["Cyclist=person"])})
    image = only_image(read(tmp_path, rows, options=person))
    assert image.road_users[0].label is image.detections[0].label is ObstacleLabel.PERSON
    recording = read(tmp_path, rows, options=ReadOptions(classes=parse_classes(["cyclist=ignore"])))
    image = only_image(recording)
    assert (image.road_users, image.detections, len(image.ignored)) == ([], [], 1)
    assert recording.dropped == {"detections of the class cyclist, which is ignored": 1}


def test_boxes_without_size_are_dropped_and_counted(tmp_path: Path) -> None:
    rows = ["a,0,truth,1,car,5,5,3,4", "a,0,detection,,car,5,6,4,4", f"a,0,truth,2,car,{BOX}"]
    recording = read(tmp_path, rows)
    assert recording.dropped == {"boxes without width or height": 2}
    assert [one.track for one in only_image(recording).road_users] == ["2"]


def test_boxes_beyond_the_image_are_refused_with_the_row_or_clipped(tmp_path: Path) -> None:
    rows = ["a,0,truth,1,car,780,820,300,340", "a,0,detection,,car,900,990,300,340"]
    with pytest.raises(
        RecordingError, match=r":2: the box 780 to 820.* beyond the image of 800 x 600 px.*--clip"
    ):
        read(tmp_path, rows)
    recording = read(tmp_path, rows, options=ReadOptions(clip=True))
    (car,) = only_image(recording).road_users
    assert (car.sides, car.truncation) == (Sides(780, 800, 300, 340), 0.5)
    assert only_image(recording).detections == []
    assert recording.dropped == {"boxes clipped to the image": 2, "boxes without width or height": 1}
    camera = CameraModel.level(1920, 1080, 60, 1.4)
    assert not read(tmp_path, rows, options=ReadOptions(camera=camera)).dropped
    assert not read(tmp_path, rows, options=ReadOptions(cameras={"a": camera})).dropped


def test_truth_may_be_in_a_file_of_its_own(tmp_path: Path) -> None:
    truth, detections = tmp_path / "truth.csv", tmp_path / "found.csv"
    truth.write_text(f"{HEADER}\na,0,truth,1,car,{BOX}\n")
    detections.write_text(f"{HEADER},score\na,0,detection,,car,{BOX},.5\n")
    recording = read_recording(detections, truth)
    image = only_image(recording)
    assert (recording.name, len(image.road_users), len(image.detections)) == ("found", 1, 1)


TRUTH = f"a,0,truth,7,car,{BOX}"


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([], "expected boxes, found none"),
        ([f"a,0,detection,,car,{BOX}"], "expected boxes, found none"),
        ([TRUTH.replace("7", "")], ":2: id: expected the id of a true road user"),
        ([TRUTH, TRUTH], ":3: id '7' occurs twice at 0 s"),
        ([TRUTH, TRUTH.replace(",0,", ",0.0002,")], "id '7' occurs twice"),
        ([TRUTH.replace("car", "tree")], "label: expected one of vehicle, car"),
        (
            [TRUTH.replace("truth", "guess")],
            "source: expected one of truth, detection, ignore, frame; got 'guess'",
        ),
        ([TRUTH.replace(",0,", ",soon,")], "time_s: expected a number, got 'soon'"),
        ([TRUTH.replace(",0,", ",nan,")], "time_s: expected a number, got 'nan'"),
        ([TRUTH.replace("380,420", "420,380")], "expected x_min_px <= x_max_px"),
        ([TRUTH.replace("300,340", "340,300")], "y_min_px <= y_max_px"),
        ([f"{TRUTH},1"], ":2: expected 9 fields, as in the first line; got 10"),
        (["a,0,truth,7"], "expected 9 fields, as in the first line; got 4"),
        ([f",0,truth,7,car,{BOX}"], "drive: expected the name of a drive"),
        ([TRUTH.replace("340", "")], "y_max_px: expected a number, got ''"),
    ],
)
def test_a_row_that_cannot_be_is_refused(tmp_path: Path, rows: list[str], words: str) -> None:
    with pytest.raises(RecordingError, match=words):
        read(tmp_path, rows)


@pytest.mark.parametrize(
    ("column", "value", "words"),
    [
        ("target", "sideways", "target: expected one of lead, oncoming, crossing"),
        ("occlusion", "4", "occlusion: expected 0, 1, 2 or 3, got 4"),
        ("occlusion", "0.5", "occlusion: expected a whole number"),
        ("visible_share", "40", "visible_share: expected a share between 0 and 1, got 40"),
        ("truncation", "-1", "truncation: expected a share"),
        ("distance_m", "-3", "distance_m: expected the distance of something ahead"),
        ("lateral_m", "left", "lateral_m: expected a number, got 'left'"),
        ("ignore", "yes", "ignore: expected 0, 1 or nothing, got 'yes'"),
        ("id", "7", "expected each column once, got id twice"),
    ],
)
def test_a_value_of_an_optional_column_is_checked(
    tmp_path: Path, column: str, value: str, words: str
) -> None:
    with pytest.raises(RecordingError, match=words):
        read(tmp_path, [f"{TRUTH},{value}"], f"{HEADER},{column}")


def test_a_detection_is_ahead_and_in_no_region_to_ignore(tmp_path: Path) -> None:
    row = TRUTH.replace("truth,7", "detection,")
    with pytest.raises(RecordingError, match="distance_m: expected the distance of something ahead, got -3"):
        read(tmp_path, [f"{row},-3"], f"{HEADER},distance_m")
    with pytest.raises(RecordingError, match="ignore: expected 1 in rows of truth alone"):
        read(tmp_path, [f"{row},1"], f"{HEADER},ignore")


def test_conditions_belong_to_drives(tmp_path: Path) -> None:
    rows = [f"{TRUTH},day", f"b,0,truth,7,car,{BOX},", f"c,0,truth,7,car,{BOX},"]
    header = f"{HEADER},condition"
    options = ReadOptions(condition="dusk", conditions={"b": "night", "a": "night"})
    drives = read(tmp_path, rows, header, options).drives
    assert [drives[name].condition for name in "abc"] == ["day", "night", "dusk"], (
        "what the file says comes first"
    )
    assert read(tmp_path, rows, header).drives["b"].condition is None
    with pytest.raises(RecordingError, match=":3: condition: expected 'day' throughout drive a, got 'night'"):
        read(tmp_path, [f"{TRUTH},day", f"{TRUTH.replace('7', '8')},night"], header)


def test_missing_columns_wrong_separators_and_missing_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"missing id$"):
        read(tmp_path, [], HEADER.replace(",id", ""))
    with pytest.raises(RecordingError, match="expected commas between them, not ';'"):
        read(tmp_path, [], HEADER.replace(",", ";"))
    with pytest.raises(RecordingError, match=r"none\.csv: No such file"):
        read_recording(tmp_path / "none.csv")
    (tmp_path / "bytes.csv").write_bytes(b"drive,time_s\n\xff\xfe")
    with pytest.raises(RecordingError, match=r"bytes\.csv: .*utf-8"):
        read_recording(tmp_path / "bytes.csv")
    (tmp_path / "long.csv").write_text(f"{HEADER}\n{'a' * 200_000}")
    with pytest.raises(RecordingError, match="field larger than field limit"):
        read_recording(tmp_path / "long.csv")
