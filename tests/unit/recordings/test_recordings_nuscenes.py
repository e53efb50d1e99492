"""Recordings in nuScenes tables: files made here by the public schema and the format of detection results."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from brink.recordings.camera import CameraModel
from brink.recordings.formats import nuscenes
from brink.recordings.measure import observe
from brink.recordings.reading import read_recording
from brink.recordings.recording import ClassMeaning, ReadOptions, Recording, RecordingError, RoadUser
from brink.sim.driving.interface import ObstacleLabel
from brink.sim.urban.detection_errors import ErrorType, Target

YAW_RAD = math.radians(30.0)
START_US = 1_532_402_927_612_460
IMAGES = 13
MISSED = range(4, 8)
CAR = (1.8, 4.0, 1.5)
"""Width, length and height, as in the tables."""


def _place(ahead_m: float, left_m: float, time_s: float) -> list[float]:
    """Return a place from the ego's centre, which drives at 10 m/s with a heading of 30 degrees."""
    ahead_m += 10.0 * time_s
    cos, sin = math.cos(YAW_RAD), math.sin(YAW_RAD)
    return [100.0 + ahead_m * cos - left_m * sin, 200.0 + ahead_m * sin + left_m * cos, 0.75]


def _rotation(turn_deg: float = 0.0) -> list[float]:
    half_rad = 0.5 * (YAW_RAD + math.radians(turn_deg))
    return [math.cos(half_rad), 0.0, 0.0, math.sin(half_rad)]


def _tables(
    categories: dict[str, tuple[str, list[float], tuple[float, ...], float]],
) -> dict[str, list[dict[str, Any]]]:
    """Return the tables of one scene with objects that keep their place relative to the ego.

    Args:
        categories: Category, place ahead and left, size and turn of each instance.
    """
    tables: dict[str, list[dict[str, Any]]] = {
        "scene": [{"token": "s", "name": "scene-0001", "description": "Night, rain", "nbr_samples": IMAGES}],
        "sensor": [
            {"token": "top", "channel": "LIDAR_TOP", "modality": "lidar"},
            {"token": "front", "channel": "CAM_FRONT", "modality": "camera"},
        ],
        "calibrated_sensor": [{"token": f"c-{one}", "sensor_token": one} for one in ("top", "front")],
        "category": [{"token": f"c-{one}", "name": what[0]} for one, what in categories.items()],
        "instance": [{"token": one, "category_token": f"c-{one}"} for one in categories],
        **{name: [] for name in ("sample", "sample_data", "ego_pose", "sample_annotation")},
    }
    for number in range(IMAGES):
        time_s = 0.5 * number
        sample = f"sample-{number}"
        tables["sample"].append(
            {
                "token": sample,
                "timestamp": START_US + number * 500_000,
                "scene_token": "s",
                "next": "",
                "prev": "",
            }
        )
        for sensor, off_m in (("front", 5.0), ("top", 0.0)):
            for is_key in (False, True):
                pose = f"pose-{number}-{sensor}-{'a' if is_key else 'z'}"
                ahead_m = -nuscenes.CENTRE_AHEAD_M + off_m + (0.0 if is_key else 3.0)
                tables["ego_pose"].append(
                    {"token": pose, "translation": _place(ahead_m, 0.0, time_s), "rotation": _rotation()}
                )
                tables["sample_data"].append(
                    {
                        "token": f"data-{pose}",
                        "sample_token": sample,
                        "ego_pose_token": pose,
                        "calibrated_sensor_token": f"c-{sensor}",
                        "is_key_frame": is_key,
                    }
                )
        for one, (_, (ahead_m, left_m), size, turn_deg) in categories.items():
            tables["sample_annotation"].append(
                {
                    "token": f"a-{number}-{one}",
                    "sample_token": sample,
                    "instance_token": one,
                    "visibility_token": "4",
                    "translation": _place(ahead_m, left_m, time_s),
                    "size": list(size),
                    "rotation": _rotation(turn_deg),
                }
            )
    return tables


OBJECTS: dict[str, tuple[str, list[float], tuple[float, ...], float]] = {
    "lead": ("vehicle.car", [27.3, 0.0], CAR, 5.0),
    "pedestrian": ("human.pedestrian.adult", [16.0, 2.5], (0.6, 0.6, 1.8), 90.0),
    "oncoming": ("vehicle.truck", [40.0, 3.5], (2.5, 8.0, 3.0), 178.0),
    "behind": ("vehicle.car", [-20.0, 0.0], CAR, 0.0),
}


def _results(tables: dict[str, list[dict[str, Any]]], names: dict[str, str]) -> dict[str, Any]:
    """Return the results of a detector that sees all, but loses the lead for 2 s."""
    boxes: dict[str, list[dict[str, Any]]] = {row["token"]: [] for row in tables["sample"]}
    for row in tables["sample_annotation"]:
        instance, number = row["instance_token"], int(row["sample_token"].rpartition("-")[2])
        if instance in names and not (instance == "lead" and number in MISSED):
            boxes[row["sample_token"]].append(
                {
                    **{name: row[name] for name in ("sample_token", "translation", "size", "rotation")},
                    "velocity": [0.0, 0.0],
                    "detection_name": names[instance],
                    "detection_score": 0.8,
                    "attribute_name": "",
                }
            )
    return {"meta": {"use_camera": True}, "results": boxes}


def _write(
    folder: Path, tables: dict[str, list[dict[str, Any]]], results: object, version: str = "v1.0-mini"
) -> tuple[Path, Path]:
    (folder / version).mkdir(parents=True, exist_ok=True)
    for name, rows in tables.items():
        (folder / version / f"{name}.json").write_text(json.dumps(rows, indent=0))
    (folder / "results.json").write_text(json.dumps(results))
    return folder / "results.json", folder


def _read(folder: Path, options: ReadOptions | None = None) -> Recording:
    tables = _tables(OBJECTS)
    names = {"lead": "car", "pedestrian": "pedestrian", "oncoming": "truck", "behind": "car"}
    return read_recording(*_write(folder, tables, _results(tables, names)), options=options)


def test_scene_becomes_a_drive_with_boxes_in_the_driving_systems_image(tmp_path: Path) -> None:
    recording = _read(tmp_path)
    assert list(recording.drives) == ["scene-0001"]
    drive = recording.drives["scene-0001"]
    assert (drive.camera, recording.camera, drive.condition) == (None, None, None)
    images = [drive.images[time_s] for time_s in sorted(drive.images)]
    assert [image.time_s for image in images] == [0.5 * number for number in range(IMAGES)]
    assert recording.dropped == {
        "true objects outside the driving system's image": IMAGES,
        "detections outside the driving system's image": IMAGES,
    }
    users = {one.track: one for one in images[3].road_users}
    assert {track: (one.label, one.target) for track, one in users.items()} == {
        "lead": (ObstacleLabel.VEHICLE, Target.LEAD),
        "pedestrian": (ObstacleLabel.PERSON, None),
        "oncoming": (ObstacleLabel.VEHICLE, Target.ONCOMING),
    }
    assert users["pedestrian"].left_m == pytest.approx(2.5)
    assert users["pedestrian"].distance_m == pytest.approx(16.0 - 0.3 - 1.3, abs=0.01)
    assert users["lead"].left_m == pytest.approx(0.0, abs=1e-6)
    # Its half length and width, turned by 5 degrees, and the camera 1.3 m ahead of the ego's centre.
    turn = math.radians(5.0)
    nearest_m = 27.3 - 2.0 * math.cos(turn) - 0.9 * math.sin(turn) - 1.3
    assert users["lead"].distance_m == pytest.approx(nearest_m)
    assert users["lead"].sides.y_max == pytest.approx(300.0 + 400.0 * 1.7 / nearest_m)
    assert users["lead"].sides.x_min + users["lead"].sides.x_max == pytest.approx(800.0, abs=5.0)


def test_lead_that_is_lost_for_two_seconds_is_missed_for_two_seconds(tmp_path: Path) -> None:
    recording = _read(tmp_path)
    drive = recording.drives["scene-0001"]
    undetected = [
        time_s
        for time_s, image in sorted(drive.images.items())
        for one in image.road_users
        if all(detection.sides != one.sides for detection in image.detections)
    ]
    assert undetected == [0.5 * number for number in MISSED]
    (observed,) = observe(recording, threshold=0.5)
    misses = {target: by[ErrorType.MISS] for target, by in observed.measured.errors.magnitudes.items()}
    assert misses == {
        Target.LEAD: pytest.approx(2.0),
        Target.ONCOMING: 0.0,
        Target.PEDESTRIAN: 0.0,
        Target.EVERYBODY: 0.0,
    }
    detection = drive.images[0.0].detections[0]
    assert (detection.label, detection.score) == (ObstacleLabel.VEHICLE, 0.8)
    assert detection.distance_m == drive.images[0.0].road_users[0].distance_m
    assert detection.left_m == drive.images[0.0].road_users[0].left_m


def _users(recording: Recording, time_s: float = 0.0) -> dict[str, RoadUser]:
    return {one.track: one for one in recording.drives["scene-0001"].images[time_s].road_users}


def test_visibility_is_a_visible_share(tmp_path: Path) -> None:
    tables = _tables({"lead": OBJECTS["lead"]})
    for row, token in zip(tables["sample_annotation"], ("1", "2", "3", "4", ""), strict=False):
        row["visibility_token"] = token
    tables["sample_annotation"][5].update(num_lidar_pts=0, num_radar_pts=0)
    tables["sample_annotation"][6].update(num_lidar_pts=0, num_radar_pts=1)
    recording = read_recording(*_write(tmp_path, tables, _results(tables, {"lead": "car"})))
    shares = [_users(recording, 0.5 * number)["lead"].visible_share for number in range(7)]
    assert shares == [0.2, 0.5, 0.7, 0.9, None, 0.0, 0.9], (
        "a box without any point is not sure to be in sight"
    )


def test_ego_pose_of_the_front_camera_serves_where_there_is_no_lidar(tmp_path: Path) -> None:
    tables = _tables({"lead": OBJECTS["lead"]})
    tables["sensor"][0]["channel"] = "RADAR_FRONT"
    recording = read_recording(*_write(tmp_path, tables, _results(tables, {"lead": "car"})))
    ahead = _read(tmp_path / "lidar")
    assert _users(recording)["lead"].distance_m == pytest.approx(
        (_users(ahead)["lead"].distance_m or 0.0) - 5.0
    )


@pytest.mark.parametrize(
    ("category", "meaning"),
    [
        ("vehicle.bus.bendy", ObstacleLabel.VEHICLE),
        ("vehicle.emergency.police", ObstacleLabel.VEHICLE),
        ("vehicle.construction", ObstacleLabel.VEHICLE),
        ("human.pedestrian.child", ObstacleLabel.PERSON),
        ("human.pedestrian.wheelchair", "region"),
        ("vehicle.bicycle", "region"),
        ("vehicle.motorcycle", "region"),
        ("movable_object.trafficcone", None),
        ("static_object.bicycle_rack", None),
    ],
)
def test_categories_are_road_users_regions_to_ignore_or_things(
    tmp_path: Path, category: str, meaning: ObstacleLabel | str | None
) -> None:
    tables = _tables({"it": (category, [20.0, 1.0], (1.0, 2.0, 1.5), 0.0)})
    image = read_recording(*_write(tmp_path, tables, _results(tables, {}))).drives["scene-0001"].images[0.0]
    assert [one.label for one in image.road_users] == [meaning] * isinstance(meaning, ObstacleLabel)
    assert len(image.ignored) == (meaning == "region")


def test_scenes_without_results_are_left_out_and_said(tmp_path: Path) -> None:
    tables = _tables(OBJECTS)
    results = _results(tables, {"lead": "car"})
    tables["scene"].append({"token": "other", "name": "scene-0002"})
    tables["sample"].append({"token": "far", "timestamp": START_US, "scene_token": "other"})
    recording = read_recording(*_write(tmp_path, tables, results))
    assert list(recording.drives) == ["scene-0001"]
    assert recording.notes == ["Left out, without results: 1 of 2 scenes."]


@pytest.mark.parametrize("piece", [2**20, 700, 701, 702, 703, 1000])
def test_tables_are_read_in_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, piece: int) -> None:
    whole = _read(tmp_path)
    monkeypatch.setattr(nuscenes, "_PIECE", piece)
    assert _read(tmp_path) == whole


def test_cameras_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"expected no camera"):
        _read(tmp_path, ReadOptions(camera=CameraModel.own()))


Tables = dict[str, list[dict[str, Any]]]


def _set(table: str, **values: object) -> Callable[[Tables, dict[str, Any]], None]:
    return lambda tables, results: tables[table][0].update(values)


def _set_box(**values: object) -> Callable[[Tables, dict[str, Any]], None]:
    return lambda tables, results: results["results"]["sample-0"][0].update(values)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda tables, results: results.pop("results"), r"results\.json: expected .*sample_token"),
        (lambda tables, results: results["results"].clear(), r"with one sample at least"),
        (lambda tables, results: results["results"].pop("sample-7"), r"'sample-7' of scene 's' is missing"),
        (
            lambda tables, results: results["results"].update(x=[]),
            r"expected samples of .*sample\.json, got 'x'",
        ),
        (
            lambda tables, results: results["results"].update({"sample-0": [3]}),
            r"\[0\]: expected a box, got 3",
        ),
        (_set_box(size=[1.8, 0.0, 1.5]), r"'sample-0'\]\[0\]: expected a length, width and height between 0"),
        (_set_box(size=[1800, 4000, 1500]), r"between 0 and 200 m"),
        (_set_box(translation=[1.0, math.nan, 0.0]), r"translation: expected 3 numbers, got \[1.0, nan"),
        (_set_box(rotation=[0.0, 0.0, 0.0, 0.0]), r"rotation: expected a unit quaternion"),
        (_set_box(detection_score=None), r"detection_score: expected 1 number, got"),
        (_set_box(detection_score=80), r"detection_score: expected a score between 0 and 1, got 80"),
        (_set_box(detection_name="boat"), r"label: expected one of .*'boat'.*--classes boat=vehicle"),
        (
            _set("sample_annotation", size=[1.8, -4.0, 1.5]),
            r"sample_annotation\.json: row 1: expected a length",
        ),
        (_set("sample_annotation", visibility_token="v80"), r"row 1: visibility_token: expected 1, 2, 3, 4"),
        (_set("sample_annotation", instance_token="?"), r"expected an instance with a category, got '\?'"),
        (_set("category", name="vehicle_like"), r"--classes vehicle_like=vehicle"),
        (_set("sample", timestamp="now"), r"sample\.json: row 1: timestamp: expected 1 number"),
        (_set("ego_pose", token=None), r"ego_pose\.json: row 1: token: expected text, got None"),
        (
            lambda tables, results: tables["ego_pose"].clear(),
            r"'sample-0': expected .* the ego pose of a key frame",
        ),
        (
            lambda tables, results: tables["scene"].append({"token": "t", "name": "scene-0001"}),
            r"each name once",
        ),
        (
            lambda tables, results: tables.pop("instance"),
            r"expected a folder with scene\.json, .*instance\.json",
        ),
        (
            lambda tables, results: tables.update(category=["x"]),
            r"category\.json: row 1: expected an object, got 'x'",
        ),
        (
            lambda tables, results: tables.update(sensor={}),
            r"sensor\.json: expected a JSON array of rows, got '\{\}'",
        ),
    ],
)
def test_bad_files_are_refused_with_the_place(
    tmp_path: Path, spoil: Callable[[Tables, dict[str, Any]], object], message: str
) -> None:
    tables = _tables(OBJECTS)
    results = _results(tables, {"lead": "car"})
    spoil(tables, results)
    with pytest.raises(RecordingError, match=message):
        read_recording(*_write(tmp_path, tables, results), format="nuscenes")


@pytest.mark.parametrize("cut", ["]", "}", '"', ","])
def test_tables_that_end_early_are_refused(tmp_path: Path, cut: str) -> None:
    tables = _tables(OBJECTS)
    detections, truth = _write(tmp_path, tables, _results(tables, {}))
    table = truth / "v1.0-mini" / "sample_annotation.json"
    content = table.read_text()
    table.write_text(content[: content.rindex(cut)])
    with pytest.raises(RecordingError, match=r"sample_annotation\.json: expected a JSON array of rows"):
        read_recording(detections, truth)


def test_folder_with_several_versions_is_refused(tmp_path: Path) -> None:
    tables = _tables(OBJECTS)
    _write(tmp_path, tables, {}, "v1.0-trainval")
    detections, truth = _write(tmp_path, tables, _results(tables, {}))
    with pytest.raises(RecordingError, match=r"several: v1\.0-mini, v1\.0-trainval"):
        read_recording(detections, truth)
    assert read_recording(detections, truth / "v1.0-mini").drives


@pytest.mark.parametrize("name", ["bicycle", "vehicle.bicycle"])
def test_user_says_what_cyclists_are(tmp_path: Path, name: str) -> None:
    tables = _tables({"it": ("vehicle.bicycle", [20.0, 1.0], (1.0, 2.0, 1.5), 0.0)})
    paths = _write(tmp_path, tables, _results(tables, {"it": "bicycle"}))
    recording = read_recording(*paths)
    assert recording.dropped == {"detections of the class bicycle, which is ignored": IMAGES}
    options = ReadOptions(classes={**ReadOptions().classes, name: ClassMeaning.PERSON})
    image = read_recording(*paths, options=options).drives["scene-0001"].images[0.0]
    assert [one.label for one in image.road_users] == [ObstacleLabel.PERSON]
    assert [one.label for one in image.detections] == [ObstacleLabel.PERSON] * (name == "bicycle")
