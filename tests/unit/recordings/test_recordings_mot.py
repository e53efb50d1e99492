"""Recordings in the format of MOTChallenge, from folders made here."""

from pathlib import Path

import pytest

from brink.recordings.camera import CameraModel
from brink.recordings.reading import parse_classes, read_recording
from brink.recordings.recording import CLASSES, ReadOptions, RecordingError, Sides
from brink.sim.driving.interface import ObstacleLabel

INFO = "[Sequence]\nname=x\nimDir=img1\nframeRate=20\nseqLength=5\nimWidth=640\nimHeight=480\nimExt=.jpg\n"
WALKER = "101,51,40,100"


def sequence(root: Path, name: str, truth: str, found: str, info: str | None = INFO) -> Path:
    folder = root / name
    for part, content in (("gt", truth), ("det", found)):
        (folder / part).mkdir(parents=True, exist_ok=True)
        (folder / part / f"{part}.txt").write_text(content)
    if info is not None:
        (folder / "seqinfo.ini").write_text(info)
    return folder


def test_sequences_become_drives(tmp_path: Path) -> None:
    truth = [f"1,2,{WALKER},1,1,0.8", f"1,3,{WALKER},1,3,1", f"1,4,{WALKER},1,7,1", f"2,2,{WALKER},0,1,.5"]
    sequence(tmp_path, "S-1", "\n".join(truth), f"1,-1,{WALKER},0.82,-1,-1,-1\n3,-1,1,1,20,30,12.5\n")
    sequence(tmp_path, "S-2", f"1,2,{WALKER},1,1,1\n", "")
    recording = read_recording(tmp_path)
    assert list(recording.drives) == ["S-1", "S-2"]
    drive = recording.drives["S-1"]
    assert sorted(drive.images) == [0.0, 0.05, 0.1, 0.15, 0.2]
    walker, car = drive.images[0.0].road_users
    assert (walker.track, walker.label, walker.visible_share) == ("2", ObstacleLabel.PERSON, 0.8)
    assert walker.sides == Sides(100, 140, 50, 150), "pixels count from 1"
    assert car.label is ObstacleLabel.VEHICLE
    assert drive.images[0.0].ignored == drive.images[0.05].ignored == [walker.sides]
    (detection,) = drive.images[0.0].detections
    assert (detection.label, detection.sides, detection.score) == (ObstacleLabel.PERSON, walker.sides, 0.82)
    assert [one.score for one in drive.images[0.1].detections] == [12.5]
    assert drive.camera == CameraModel.level(640, 480, 90.0, 1.7)
    assert any("Assumed a level" in note for note in recording.notes)


def test_the_first_data_set_has_places_instead_of_classes(tmp_path: Path) -> None:
    sequence(tmp_path, "S", f"1,2,{WALKER},1,3.2,7.5,0\n", f"1,-1,{WALKER},30,3.1,7.4,0\n")
    image = read_recording(tmp_path).drives["S"].images[0.0]
    assert image.road_users[0].label is image.detections[0].label is ObstacleLabel.PERSON
    assert image.road_users[0].visible_share is None


def test_detections_may_have_classes_and_stand_elsewhere(tmp_path: Path) -> None:
    folder = sequence(tmp_path / "train", "S", f"1,2,{WALKER},1,4,1\n", "")
    (tmp_path / "found").mkdir()
    (tmp_path / "found" / "S.txt").write_text(f"1,-1,{WALKER},0.9,3\n1,-1,{WALKER},0.9,4\n")
    recording = read_recording(tmp_path / "found", tmp_path / "train")
    image = recording.drives["S"].images[0.0]
    assert [one.label.value for one in image.detections] == ["vehicle"]
    assert (image.road_users, len(image.ignored)) == ([], 1)
    assert recording.dropped == {"detections of the class bicycle, which is ignored": 1}
    options = ReadOptions(classes={**CLASSES, **parse_classes(["bicycle=person"])})
    for detections, truth in (
        (tmp_path / "found", tmp_path / "train"),
        (tmp_path / "found" / "S.txt", folder),
    ):
        image = read_recording(detections, truth, options=options).drives["S"].images[0.0]
        assert (len(image.road_users), len(image.detections)) == (1, 2)


def test_without_information_on_the_sequence_the_user_gives_it(tmp_path: Path) -> None:
    sequence(tmp_path, "S", f"1,2,{WALKER},1,1,1\n4,2,{WALKER},1,1,1\n", f"6,-1,{WALKER},1\n", None)
    with pytest.raises(RecordingError, match=r"frames per second; looked for frameRate in .*S/seqinfo\.ini"):
        read_recording(tmp_path)
    camera = CameraModel.level(640, 480, 60.0, 1.5)
    recording = read_recording(tmp_path, options=ReadOptions(frames_per_s=10.0, camera=camera))
    assert sorted(recording.drives["S"].images) == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
    assert (recording.drives["S"].camera, recording.notes) == (camera, [])
    sequence(tmp_path, "S", f"1,2,{WALKER},1,1,1\n", "")
    with pytest.raises(RecordingError, match="are 640 x 480 px, but those of its camera 1920 x 1080 px"):
        read_recording(tmp_path, options=ReadOptions(camera=CameraModel.level(1920, 1080, 60.0, 1.5)))


def test_one_drive_with_several_detectors_does_not_count_several_times(tmp_path: Path) -> None:
    for detector in ("DPM", "SDP"):
        sequence(tmp_path, f"S-{detector}", f"1,2,{WALKER},1,1,1\n", "")
    with pytest.raises(
        RecordingError, match="its truth is that of S-DPM, so that one drive would count twice"
    ):
        read_recording(tmp_path)


@pytest.mark.parametrize(
    ("truth", "found", "info", "words"),
    [
        ("1,2,3", "", INFO, r"gt\.txt:1: expected between 6 and 10 columns, got 3"),
        ("", "1,2,3,4,5,6", INFO, r"det\.txt:1: expected between 7 and 10 columns, got 6"),
        (f"0,2,{WALKER},1,1,1", "", INFO, "frame: expected a number between 1 and 5, got 0"),
        ("", f"6,2,{WALKER},1", INFO, r"det\.txt:1: frame: expected a number between 1 and 5, got 6"),
        ("", f"1e99,2,{WALKER},1", INFO.replace("seqLength=5", ""), "frame: expected a number from 1"),
        ("1,2,3,4,-5,6,1,1,1", "", INFO, "got a negative size"),
        ("1,2,-19,51,40,100,1,1,1", "", INFO, "the box -20 to 20.* beyond the image of 640 x 480 px"),
        (f"1,2,{WALKER},1,1,1\n1,2,{WALKER},1,1,1", "", INFO, ":2: id '2' occurs twice at 0 s"),
        (f"1,2,{WALKER},1,14,1", "", INFO, "label: expected one of .*; got '14' .*--classes 14=vehicle"),
        (f"1,2,{WALKER},1,1,70", "", INFO, "visible_share: expected a share between 0 and 1, got 70"),
        ("", f"1,-1,{WALKER},sure", INFO, "score: expected a number, got 'sure'"),
        ("", "", INFO.replace("20", "fast"), r"seqinfo\.ini: frameRate: expected a number, got 'fast'"),
        ("", "", INFO.replace("20", "0"), "frameRate: expected a positive number, got 0"),
        (
            "",
            "",
            INFO.replace("seqLength=5", "seqLength=1e9"),
            "expected at most 1000000 images in a recording, got 1000000000",
        ),
        ("", "", "frameRate=20", r"seqinfo\.ini: File contains no section headers"),
        ("", "", "[Other]\na=1", r"seqinfo\.ini: expected a section \[Sequence\]"),
    ],
)
def test_a_sequence_that_does_not_fit_is_refused(
    tmp_path: Path, truth: str, found: str, info: str, words: str
) -> None:
    sequence(tmp_path, "S", truth, found, info)
    with pytest.raises(RecordingError, match=words):
        read_recording(tmp_path)


def test_a_box_that_reaches_beyond_the_image_is_refused_or_clipped(tmp_path: Path) -> None:
    sequence(tmp_path, "S", "1,2,-19,51,40,100,1,1,1\n", "")
    with pytest.raises(
        RecordingError, match=r"gt\.txt:1: the box -20 to 20.* beyond the image of 640 x 480 px"
    ):
        read_recording(tmp_path)
    (walker,) = read_recording(tmp_path, options=ReadOptions(clip=True)).drives["S"].images[0.0].road_users
    assert (walker.sides, walker.truncation) == (Sides(0, 20, 50, 150), 0.5)
