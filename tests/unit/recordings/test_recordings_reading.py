"""The seam of all formats: which one files are in, what was looked for, and what the user says of a recording."""

from pathlib import Path

import pytest

from brink.recordings import files
from brink.recordings import format as recording_format
from brink.recordings.camera import CameraError, CameraModel
from brink.recordings.formats.csv_format import COLUMNS
from brink.recordings.reading import formats_by_name, parse_classes, read_recording, read_settings
from brink.recordings.recording import CLASSES, ClassMeaning, ReadOptions, RecordingError
from brink.server.errors import InvalidInput

ROWS = ["a,0,truth,1,car,380,420,300,340", "b,0,truth,1,car,380,420,300,340"]


def csv_file(folder: Path) -> Path:
    file = folder / "boxes.csv"
    file.write_text("\n".join([",".join(COLUMNS), *ROWS]))
    return file


def test_every_format_says_what_it_looks_for(tmp_path: Path) -> None:
    assert set(formats_by_name()) == {"csv", "coco", "kitti", "mot", "nuscenes", "osi"}
    (tmp_path / "notes.md").touch()
    with pytest.raises(RecordingError) as caught:
        read_recording(tmp_path)
    message = str(caught.value)
    assert message.startswith(
        f"{tmp_path} is a folder with notes.md. Expected detections and truth (--truth)"
    )
    for name, one in formats_by_name().items():
        assert f"\n  {name}: {one.expects}" in message


@pytest.mark.parametrize("name", formats_by_name())
def test_missing_files_are_refused_in_every_format(tmp_path: Path, name: str) -> None:
    """The message names what is missing, or what was looked for."""
    for truth in (None, tmp_path / "truth"):
        with pytest.raises(RecordingError, match=str(tmp_path)):
            read_recording(tmp_path / "none", truth, format=name)


def test_what_is_not_there_is_named(tmp_path: Path) -> None:
    (tmp_path / "truth").mkdir()
    with pytest.raises(RecordingError, match=r"none does not exist; .*truth is an empty folder\. Expected"):
        read_recording(tmp_path / "none", tmp_path / "truth")
    with pytest.raises(RecordingError, match=r"format: expected one of .*csv.*; got 'cvs'"):
        read_recording(csv_file(tmp_path), format="cvs")
    with pytest.raises(RecordingError, match="File name too long"):
        read_recording(tmp_path / ("a" * 300))
    with pytest.raises(RecordingError, match="does not exist"):
        read_recording(Path("a\0b"))


def test_a_file_that_two_formats_recognise_asks_for_its_format(tmp_path: Path) -> None:
    (tmp_path / "boxes.csv" / "gt").mkdir(parents=True)
    (tmp_path / "boxes.csv" / "gt" / "gt.txt").touch()
    with pytest.raises(RecordingError, match="in several formats: say --format csv or --format mot"):
        read_recording(tmp_path / "boxes.csv")


def test_a_recording_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = csv_file(tmp_path)
    monkeypatch.setattr(recording_format, "MAX_BOXES", 1)
    with pytest.raises(RecordingError, match=r":3: expected at most 1 boxes"):
        read_recording(file)
    monkeypatch.setattr(recording_format, "MAX_IMAGES", 0)
    with pytest.raises(RecordingError, match=r":2: expected at most 0 images"):
        read_recording(file)
    monkeypatch.setattr(files, "MAX_SEQUENCES", 0)
    with pytest.raises(RecordingError, match="expected at most 0 files and folders, found more"):
        read_recording(tmp_path)


SETTINGS = """
camera: {width: 1242, height: 375, fx: 721.5, fy: 722, cx: 609.5, cy: 172.8, above_m: 1.65, pitch_deg: 1}
frames_per_s: 12.5
classes: {Cyclist: person, tram: ignore}
condition: "day, dry"
drives:
  "b": {condition: night, camera: {width: 800, height: 600, fx: 400, cx: 400, cy: 300, above_m: 1.5}}
"""


def test_settings_are_read_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "settings.yaml"
    file.write_text(SETTINGS)
    options = read_settings(file)
    camera = CameraModel(
        width_px=1242,
        height_px=375,
        fx_px=721.5,
        fy_px=722,
        cx_px=609.5,
        cy_px=172.8,
        above_m=1.65,
        pitch_deg=1,
    )
    other = CameraModel.level(800, 600, 90, 1.5)
    assert (options.camera, options.frames_per_s) == (camera, 12.5)
    assert (options.condition, options.conditions) == ("day, dry", {"b": "night"})
    assert options.cameras["b"].fx_px == pytest.approx(other.fx_px)
    assert options.classes == {**CLASSES, "cyclist": ClassMeaning.PERSON, "tram": ClassMeaning.IGNORE}
    recording = read_recording(csv_file(tmp_path), options=options)
    assert recording.drives["a"].camera == recording.camera == camera
    assert recording.drives["b"].camera == options.cameras["b"]
    assert [drive.condition for drive in recording.drives.values()] == ["day, dry", "night"]
    file.write_text("{}")
    assert read_settings(file) == ReadOptions()


def test_settings_of_a_drive_that_is_not_there_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="settings of drive 'c': expected one of the drives a, b"):
        read_recording(csv_file(tmp_path), options=ReadOptions(conditions={"c": "night"}))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[1]", "expected settings of a recording, got a list"),
        ("cameras: {}", "camera"),
        ("drives: {a: {weather: wet}}", "weather"),
        ("drives: {0003: {condition: wet}}", "drives"),
        ("frames_per_s: 0", "frames_per_s|greater than 0"),
        ("frames_per_s: fast", "frames_per_s|number"),
        ("classes: {cyclist: bike}", "one of vehicle, person, ignore; got 'cyclist=bike'"),
        ("camera: {width: 800}", "camera: expected the numbers width, height"),
        ("drives: {a: {camera: {width: 800}}}", "camera of drive a: expected the numbers"),
        ("camera: 3", "camera"),
        (SETTINGS.replace("1242", "1" * 400), "camera: expected the numbers width"),
    ],
)
def test_settings_that_cannot_be_are_refused(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "settings.yaml"
    file.write_text(text)
    with pytest.raises((InvalidInput, RecordingError, CameraError), match=words):
        read_settings(file)


def test_classes_have_a_meaning() -> None:
    assert parse_classes(["Cyclist=person", " a=b = ignore"]) == {
        "cyclist": ClassMeaning.PERSON,
        "a=b": ClassMeaning.IGNORE,
    }
    for given in ("cyclist", "=person", "cyclist=", "cyclist=bike"):
        with pytest.raises(RecordingError, match="classes: expected CLASS=MEANING"):
            parse_classes([given])


def test_the_documented_examples_are_read(tmp_path: Path) -> None:
    page = Path(__file__).parents[3] / "docs" / "reference" / "recordings.md"
    blocks = page.read_text().split("```")[1::2]
    (rows,) = (block for block in blocks if block.startswith("\ndrive,"))
    (settings,) = (block.removeprefix("yaml") for block in blocks if block.startswith("yaml"))
    (tmp_path / "boxes.csv").write_text(rows.strip())
    (tmp_path / "settings.yaml").write_text(settings)
    (drive,) = read_recording(tmp_path / "boxes.csv").drives.values()
    assert (drive.condition, sorted(drive.images)) == ("night, wet", [0.0, 0.1])
    image = drive.images[0.0]
    assert (len(image.road_users), len(image.detections), len(image.ignored)) == (1, 1, 1)
    assert read_settings(tmp_path / "settings.yaml").conditions == {"0003": "night"}
