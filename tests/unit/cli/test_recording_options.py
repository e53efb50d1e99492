"""What a command is told of a recording, and what it tells of it."""

from pathlib import Path

import pytest

from brink.cli.recording_options import GivenRecording
from brink.recordings.recording import RecordingError
from brink.server.errors import InvalidInput

HEADER = "drive,time_s,source,id,label,x_min_px,x_max_px,y_min_px,y_max_px,score"


def recording(folder: Path, *rows: str) -> Path:
    """Return a recording of six seconds with a lead that is reported with a score of .4 or .8 in turns."""
    lines = [HEADER, *rows]
    for step in range(60):
        lines.append(f"a,{step / 10},truth,7,car,382,418,304,334,")
        lines.append(f"a,{step / 10},detection,,car,382,418,304,334,{0.8 if step % 2 else 0.4}")
    file = folder / "boxes.csv"
    file.write_text("\n".join(lines) + "\n")
    return file


def test_it_says_what_was_read_dropped_and_counts(tmp_path: Path) -> None:
    file = recording(
        tmp_path,
        "a,0.0,truth,8,car,100,100,304,334,",
        "a,0.0,truth,9,car,-50,60,304,334,",
        "a,0.0,detection,,cyclist,100,120,304,334,0.9",
    )
    given = GivenRecording(detections=file, clip=True, classes=["cyclist=ignore"], least_share=0.4)
    words = " ".join(given.words(given.read()))
    assert (
        "1 drive, 60 images, 61 true boxes, 60 detections, of which 30 have a score of at least 0.5" in words
    )
    assert "boxes without width or height: 1" in words
    assert "boxes clipped to the image: 1" in words
    assert "class cyclist, which is ignored: 1" in words
    assert "at least 40% of it in sight" in words


def test_boxes_beyond_the_image_are_refused_without_being_told_to_clip(tmp_path: Path) -> None:
    file = recording(tmp_path, "a,0.0,truth,9,car,-50,60,304,334,")
    with pytest.raises(RecordingError, match=r"boxes\.csv:2: the box -50 to 60.*--clip"):
        GivenRecording(detections=file).read()


def test_two_cameras_are_refused(tmp_path: Path) -> None:
    calibration = tmp_path / "camera.yaml"
    calibration.write_text(
        "camera: {width: 800, height: 600, fx: 400, cx: 400, cy: 290, above_m: 1.6}\ncondition: 'day, dry'\n"
    )
    given = GivenRecording(detections=recording(tmp_path), calibration=calibration)
    read = given.read()
    assert read.camera is not None
    assert read.camera.cy_px == 290.0
    assert read.drives["a"].condition == "day, dry"
    both = GivenRecording(
        detections=recording(tmp_path), calibration=calibration, camera=(800.0, 600.0, 90.0, 1.7)
    )
    with pytest.raises(InvalidInput, match="cannot be combined with a camera in"):
        both.read()


def test_a_threshold_that_is_no_number_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="--threshold: expected a number"):
        GivenRecording(detections=recording(tmp_path), threshold=float("nan")).read()
