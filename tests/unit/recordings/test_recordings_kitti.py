"""Recordings in the format of KITTI tracking, 2D and 3D, from folders made here."""

import math
from pathlib import Path

import pytest

from brink.recordings.camera import CameraModel
from brink.recordings.reading import parse_classes, read_recording
from brink.recordings.recording import CLASSES, ReadOptions, Recording, RecordingError, Sides
from brink.sim.driving.interface import ObstacleLabel
from brink.sim.urban.detection_errors import Target

NO_PLACE = "-1 -1 -1 -1000 -1000 -1000 -10"
AHEAD = -math.pi / 2
P2 = "700.0 0 600.0 45.0 0 710.0 180.0 -0.3 0 0 1 0.005"


def label(
    frame: int,
    track: int,
    kind: str = "Car",
    *,
    flags: str = "0 0",
    box: str = "580 190 640 250",
    place: str = f"1.5 1.8 4.2 -1.25 1.7 24.0 {AHEAD:.6f}",
    score: str = "",
) -> str:
    return f"{frame} {track} {kind} {flags} -1.57 {box} {place} {score}".strip()


def folders(
    root: Path, truth: dict[str, list[str]], found: dict[str, list[str]], p2: str | None = f"P2: {P2}"
) -> tuple[Path, Path]:
    """Write detections and labels, and return their folders."""
    for folder, files in (("label_02", truth), ("results", found), ("calib", truth)):
        (root / folder).mkdir(exist_ok=True)
        for name, rows in files.items():
            lines = [f"P0: {P2}", p2 or "", "R_rect 1 0 0 0 1 0 0 0 1"] if folder == "calib" else rows
            if folder != "calib" or p2 is not None:
                (root / folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
    return root / "results", root / "label_02"


def read(
    root: Path,
    truth: list[str],
    found: list[str],
    options: ReadOptions | None = None,
    p2: str | None = f"P2: {P2}",
) -> Recording:
    return read_recording(*folders(root, {"0007": truth}, {"0007": found}, p2), options=options)


def test_labels_and_results_in_3d(tmp_path: Path) -> None:
    truth = [
        label(0, 3, flags="1 2"),
        label(0, 4, "Pedestrian", place="1.8 .6 .5 3 1.7 10 0"),
        label(0, -1, "DontCare", flags="-1 -1", box="10 150 60 180", place="-1000 -1000 -1000 -10 -1 -1 -1"),
        label(2, 3),
    ]
    found = [label(2, -1, score="0.75"), label(3, -1, place=NO_PLACE, score="3.5")]
    recording = read(tmp_path, truth, found)
    (drive,) = recording.drives.values()
    assert (recording.name, drive.name, sorted(drive.images)) == ("results", "0007", [0.0, 0.1, 0.2, 0.3])
    car, person = drive.images[0.0].road_users
    assert (car.track, car.label, car.sides) == ("3", ObstacleLabel.VEHICLE, Sides(580, 640, 190, 250))
    assert (car.occlusion, car.truncation, car.target) == (2, 0.25, Target.LEAD)
    assert (car.distance_m, car.left_m) == pytest.approx((24.0 - 2.1, 1.25))
    assert (person.label, person.target, person.left_m) == (ObstacleLabel.PERSON, None, -3.0)
    assert person.distance_m == pytest.approx(9.7)
    assert drive.images[0.0].ignored == [Sides(10, 60, 150, 180)]
    assert drive.images[0.1].road_users == [], "an image without labels is an image"
    (in_3d,), (in_2d,) = drive.images[0.2].detections, drive.images[0.3].detections
    assert (in_3d.score, in_3d.distance_m, in_3d.left_m) == pytest.approx((0.75, 21.9, 1.25))
    assert (in_2d.score, in_2d.distance_m, in_2d.left_m) == (3.5, None, None)


def test_the_camera_is_that_of_the_calibration_unless_the_user_gave_one(tmp_path: Path) -> None:
    camera = read(tmp_path, [label(0, 3)], []).drives["0007"].camera
    assert camera == CameraModel(
        width_px=1242, height_px=375, fx_px=700, fy_px=710, cx_px=600, cy_px=180, above_m=1.65
    )
    without_colon = read(tmp_path, [label(0, 3)], [], p2=f"P2 {P2}").drives["0007"].camera
    assert without_colon == camera
    own = CameraModel.level(1300, 400, 80.0, 1.5)
    assert read(tmp_path, [label(0, 3)], [], ReadOptions(camera=own), None).drives["0007"].camera is own
    (tmp_path / "calib" / "0007.txt").unlink()
    with pytest.raises(
        RecordingError, match=r"calibration of sequence 0007; looked for .*calib/0007\.txt and"
    ):
        read(tmp_path, [label(0, 3)], [], p2=None)
    with pytest.raises(RecordingError, match="expected a line P2:"):
        read(tmp_path, [label(0, 3)], [], p2="")
    with pytest.raises(RecordingError, match=":2: P2: expected 12 numbers, got 3"):
        read(tmp_path, [label(0, 3)], [], p2="P2: 1 2 3")


@pytest.mark.parametrize(
    ("rotation_deg", "target", "nearest_m"),
    [
        (-90, Target.LEAD, 17.9),
        (-90 + 44, Target.LEAD, None),
        (-90 + 46, Target.CROSSING, None),
        (0, Target.CROSSING, 19.1),
        (180, Target.CROSSING, 19.1),
        (90 + 46, Target.CROSSING, None),
        (90, Target.ONCOMING, 17.9),
        (90 - 44, Target.ONCOMING, None),
    ],
)
def test_the_rotation_says_which_way_a_vehicle_goes(
    tmp_path: Path, rotation_deg: float, target: Target, nearest_m: float | None
) -> None:
    place = f"1.5 1.8 4.2 0 1.7 20 {math.radians(rotation_deg)}"
    (car,) = read(tmp_path, [label(0, 3, place=place)], []).drives["0007"].images[0.0].road_users
    assert car.target is target
    if nearest_m is not None:
        assert car.distance_m == pytest.approx(nearest_m)


@pytest.mark.parametrize(
    ("flags", "truncation", "occlusion"),
    [("0 0", 0.0, 0), ("2 1", 0.75, 1), ("0.37 3", 0.37, 3), ("1.00 0", 1.0, 0), ("-1 -1", None, None)],
)
def test_truncation_is_a_level_or_a_share(
    tmp_path: Path, flags: str, truncation: float | None, occlusion: int | None
) -> None:
    (car,) = read(tmp_path, [label(0, 3, flags=flags)], []).drives["0007"].images[0.0].road_users
    assert (car.truncation, car.occlusion) == (truncation, occlusion)


def test_cyclists_are_ignored_unless_the_user_says_what_they_mean(tmp_path: Path) -> None:
    truth = [label(0, 1, "Cyclist"), label(0, 2, "Person_sitting"), label(0, 3, "Van"), label(0, 4, "Tram")]
    found = [label(0, -1, "Cyclist", score="1")]
    recording = read(tmp_path, truth, found)
    image = recording.drives["0007"].images[0.0]
    assert [one.label.value for one in image.road_users] == ["person", "vehicle"]
    assert (len(image.ignored), image.detections) == (2, [])
    assert recording.dropped == {"detections of the class cyclist, which is ignored": 1}
    options = ReadOptions(classes={**CLASSES, **parse_classes(["cyclist=person"])})
    image = read(tmp_path, truth, found, options).drives["0007"].images[0.0]
    assert (len(image.road_users), len(image.detections), len(image.ignored)) == (3, 1, 1)
    with pytest.raises(
        RecordingError, match=r"0007\.txt:1: label: expected .*; got 'Horse' .*--classes horse="
    ):
        read(tmp_path, [label(0, 1, "Horse")], [])


def test_detections_of_3d_trackers_are_read(tmp_path: Path) -> None:
    rows = [f"1,2,580,190,640,250,8.5,1.5,1.8,4.2,-1.25,1.7,24,{AHEAD},0.1", "1,1,1,2,3,4,-2,1,1,1,0,1,9,0,0"]
    car, person = read(tmp_path, [label(0, 3), label(1, 3)], rows).drives["0007"].images[0.1].detections
    assert (car.label, car.sides, car.score) == (ObstacleLabel.VEHICLE, Sides(580, 640, 190, 250), 8.5)
    assert (car.distance_m, car.left_m) == pytest.approx((21.9, 1.25))
    assert (person.label, person.score) == (ObstacleLabel.PERSON, -2.0)


def test_the_number_of_images_is_known_from_the_data_set(tmp_path: Path) -> None:
    assert len(read(tmp_path, [label(2, 3)], []).drives["0007"].images) == 3
    images = tmp_path / "image_02" / "0007"
    images.mkdir(parents=True)
    for frame in range(6):
        (images / f"{frame:06d}.png").touch()
    assert len(read(tmp_path, [label(2, 3)], []).drives["0007"].images) == 6
    (tmp_path / "evaluate_tracking.seqmap.training").write_text(
        "0006 empty 000000 000009\n0007 empty 000000 000008\n"
    )
    drive = read(tmp_path, [label(2, 3)], [], ReadOptions(frames_per_s=20.0)).drives["0007"]
    assert (len(drive.images), max(drive.images)) == (8, 0.35)


def test_sequences_without_detections_are_left_out_and_said(tmp_path: Path) -> None:
    truth = {name: [label(0, 3)] for name in ("0001", "0002", "0003")}
    recording = read_recording(*folders(tmp_path, truth, {"0002": [], "0003": [], "0009": []}))
    assert sorted(recording.drives) == ["0002", "0003"], "an empty file says that nothing was detected"
    assert recording.dropped == {
        "sequences without a file of detections": 1,
        "sequences without a file of truth": 1,
    }
    assert any("without a file of detections: 0001" in note for note in recording.notes)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "x.txt").touch()
    with pytest.raises(RecordingError, match=r"found truth of 0001, 0002, 0003, and detections of x"):
        read_recording(tmp_path / "other", tmp_path / "label_02")


def test_a_single_sequence_and_the_data_sets_own_folders_are_found(tmp_path: Path) -> None:
    folders(tmp_path, {"0001": [label(0, 3)]}, {"0001": [label(0, 3)]})
    single = read_recording(tmp_path / "results" / "0001.txt", tmp_path / "label_02" / "0001.txt")
    whole = read_recording(tmp_path / "results", tmp_path)
    assert single.drives == whole.drives
    assert set(whole.drives) == {"0001"}


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("Car 0 0 -1.57 1 2 3 4 1 1 1 0 0 9 0", "expected the 17 columns .* got 15 .*object benchmark"),
        (label(0, 3) + " 1 2", "expected the 17 columns .* got 19$"),
        (label(0, 3).replace("0 3", "0.5 3"), "frame: expected a whole number, got '0.5'"),
        (label(0, 3).replace("0 3", "-1 3"), "frame: expected a number from 0, got -1"),
        (label(0, 3).replace("0 3", "9e99 3"), "frame: expected a number from 0, got 9e99"),
        (label(0, 3, box="a 1 2 3"), "bbox: expected a number, got 'a'"),
        (label(0, 3, box="640 190 580 250"), "expected x_min_px <= x_max_px"),
        (label(0, 3, box="640 190 1300 250"), "beyond the image of 1242 x 375 px"),
        (label(0, 3, place="1 1 1 x 0 9 0"), "x: expected a number, got 'x'"),
        (label(0, 3, flags="3 0"), "truncation: expected a share between 0 and 1, got 3"),
        (label(0, 3, flags="0 7"), "occlusion: expected 0, 1, 2 or 3, got 7"),
        (label(0, 3) + "\n" + label(0, 3), "id '3' occurs twice at 0 s"),
        (label(0, 3, score="high"), "score: expected a number, got 'high'"),
    ],
)
def test_a_row_that_cannot_be_is_refused(tmp_path: Path, row: str, words: str) -> None:
    with pytest.raises(RecordingError, match=words):
        read_recording(*folders(tmp_path, {"0007": [row]}, {"0007": []}), format="kitti")
