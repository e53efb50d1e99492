"""Recordings in OSI traces: files encoded here by the public numbers of OSI's fields, not by the reader's classes."""

import math
import struct
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import CompressionType, Writer

from brink.recordings import osi_traces
from brink.recordings.camera import CameraModel
from brink.recordings.formats import osi
from brink.recordings.reading import read_recording
from brink.recordings.recording import ClassMeaning, ReadOptions, RecordedDrive, Recording, RecordingError
from brink.search.errors import MissingExtra
from brink.sim.driving.interface import ObstacleLabel
from brink.sim.urban.detection_errors import Target

Message = list[tuple[int, Any]]
"""Numbers of fields, and their values: a message, a whole number, or a floating-point number."""

HOST, LEAD, PEDESTRIAN, ONCOMING = 7, 11, 12, 13
STEP_S = 0.1
IMAGES = 51
MISSED = range(20, 40)
YAW_RAD = math.pi / 2
REAR_M = -1.35
MOUNT = (3.6, 0.2, 0.6)
VEHICLE, WALKER = 2, 3
CAR, BICYCLE = 4, 11
CAR_SIZE = (4.0, 1.8, 1.5)


def _varint(value: int) -> bytes:
    encoded = bytearray()
    while value >= 0x80:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*encoded, value])


def _encoded(message: Message) -> bytes:
    """Return a message in the wire format of Protocol Buffers."""
    content = b""
    for number, value in message:
        if isinstance(value, list):
            inner = _encoded(value)
            content += _varint(number << 3 | 2) + _varint(len(inner)) + inner
        elif isinstance(value, float):
            content += _varint(number << 3 | 1) + struct.pack("<d", value)
        else:
            content += _varint(number << 3) + _varint(value)
    return content


def _vector(x: float, y: float, z: float) -> Message:
    return [(1, float(x)), (2, float(y)), (3, float(z))]


def _time(time_s: float) -> Message:
    nanos = round(time_s * 1e9)
    return [(1, nanos // 10**9), (2, nanos % 10**9)]


def _base(x: float, y: float, z: float, yaw_rad: float, size: Sequence[float]) -> Message:
    return [(1, _vector(*size)), (2, _vector(x, y, z)), (3, [(3, float(yaw_rad))])]


class _Thing:
    """A moving object at a place relative to the centre of the host, which goes north at 10 m/s from (500, -20)."""

    def __init__(
        self,
        ahead_m: float,
        left_m: float,
        turn_deg: float = 0.0,
        size: Sequence[float] = CAR_SIZE,
        kind: tuple[int, int] = (VEHICLE, CAR),
        lane: int | None = None,
    ) -> None:
        self.ahead_m, self.left_m, self.turn_rad = ahead_m, left_m, math.radians(turn_deg)
        self.size, self.kind, self.lane = size, kind, lane

    def true(self, identity: int, time_s: float) -> Message:
        """Return it as a MovingObject: id, base, type, and what is said of vehicles and of its lanes."""
        place = (500.0 - self.left_m, -20.0 + 10.0 * time_s + self.ahead_m, 0.5 * self.size[2])
        message: Message = [
            (1, [(1, identity)]),
            (2, _base(*place, YAW_RAD + self.turn_rad, self.size)),
            (3, self.kind[0]),
            (5, [(4, _vector(REAR_M, 0.0, -0.4))]),
            (6, [(1, self.kind[1])]),
            (7, [(1, 1)]),  # what is not read is skipped
        ]
        return [*message, (9, [(1, [(1, self.lane)])])] if self.lane is not None else message

    def detected(self, mount_yaw_rad: float = 0.0, score: float | None = 0.75) -> Message:
        """Return it as a DetectedMovingObject in the frame of the sensor: header, base and candidates."""
        ahead, left = self.ahead_m - REAR_M - MOUNT[0], self.left_m - MOUNT[1]
        cos, sin = math.cos(mount_yaw_rad), math.sin(mount_yaw_rad)
        place = (cos * ahead + sin * left, cos * left - sin * ahead, 0.0)
        candidates: list[Message] = [
            [(1, 0.2), (2, 4)],
            [(1, 0.8), (2, self.kind[0]), (3, [(1, self.kind[1])])],
        ]
        return [
            (1, [(1, [(1, 99)])] if score is None else [(3, score)]),
            (2, _base(*place, self.turn_rad - mount_yaw_rad, self.size)),
            *((8, candidate) for candidate in candidates),
        ]


THINGS = {
    LEAD: _Thing(30.0, 0.0),
    PEDESTRIAN: _Thing(16.0, -2.5, 90.0, (0.6, 0.6, 1.8), (WALKER, 0)),
    ONCOMING: _Thing(40.0, 3.5, -178.0, (8.0, 2.5, 3.0), (VEHICLE, 7)),
}
HOST_VEHICLE = _Thing(0.0, 0.0)


def _ground_truth(time_s: float, things: dict[int, _Thing], host: _Thing = HOST_VEHICLE) -> Message:
    objects = [(5, one.true(identity, time_s)) for identity, one in {**things, HOST: host}.items()]
    return [(2, _time(time_s)), (3, [(1, HOST)]), *objects]


def _sensor_view(time_s: float, things: dict[int, _Thing], host: _Thing = HOST_VEHICLE) -> Message:
    return [(2, _time(time_s)), (7, _ground_truth(time_s, things, host)), (8, [(1, HOST)])]


def _sensor_data(
    time_s: float, things: dict[int, _Thing], mount_yaw_rad: float = 0.0, latency_s: float = 0.03
) -> Message:
    return [
        (2, _time(time_s + latency_s)),
        (6, [(1, _vector(*MOUNT)), (2, [(3, mount_yaw_rad)])]),
        (9, _time(time_s)),
        *((13, one.detected(mount_yaw_rad)) for one in things.values()),
    ]


def _times() -> list[float]:
    return [round(STEP_S * number, 6) for number in range(IMAGES)]


def _views(things: dict[int, _Thing] = THINGS, host: _Thing = HOST_VEHICLE) -> list[bytes]:
    return [_encoded(_sensor_view(time_s, things, host)) for time_s in _times()]


def _reports(things: dict[int, _Thing] = THINGS, mount_yaw_rad: float = 0.0) -> list[bytes]:
    """Return what a detector reports that loses the lead for 2 s."""
    return [
        _encoded(
            _sensor_data(
                time_s,
                {one: thing for one, thing in things.items() if one != LEAD or number not in MISSED},
                mount_yaw_rad,
            )
        )
        for number, time_s in enumerate(_times())
    ]


def _write(path: Path, messages: Sequence[bytes]) -> Path:
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"".join(struct.pack("<I", len(one)) + one for one in messages))
    return path


def _write_mcap(
    path: Path,
    channels: Sequence[tuple[str, str, Sequence[bytes]]],
    compression: CompressionType = CompressionType.ZSTD,
) -> Path:
    """Write a multi-channel trace with the library of the format's authors."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=20_000, compression=compression)
        writer.start()
        for topic, type_, messages in channels:
            schema = writer.register_schema(f"osi3.{type_}", "protobuf", b"")
            channel = writer.register_channel(topic, "protobuf", schema)
            for number, message in enumerate(messages):
                writer.add_message(channel, number * 10**8, message, number * 10**8)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def _traces(folder: Path, **of: Any) -> tuple[Path, Path]:
    reports = _reports(of.get("things", THINGS), of.get("mount_yaw_rad", 0.0))
    views = _views(of.get("things", THINGS), of.get("host", HOST_VEHICLE))
    return (
        _write(folder / f"20260101T000000Z_sd_380_500_{IMAGES}_town.osi", reports),
        _write(folder / "20260101T000000Z_sv_380_500_60_town.osi", views),
    )


def _drive(recording: Recording) -> RecordedDrive:
    (drive,) = recording.drives.values()
    return drive


@pytest.mark.parametrize("mount_yaw_rad", [0.0, -0.3])
def test_traces_become_a_drive_with_boxes_in_the_driving_systems_image(
    tmp_path: Path, mount_yaw_rad: float
) -> None:
    recording = read_recording(*_traces(tmp_path, mount_yaw_rad=mount_yaw_rad))
    drive = _drive(recording)
    assert (drive.name, drive.camera, recording.camera) == ("20260101T000000Z_town", None, None)
    assert sorted(drive.images) == pytest.approx(_times())
    users = {one.track: one for one in drive.images[1.5].road_users}
    assert {track: (one.label, one.target, one.occlusion) for track, one in users.items()} == {
        str(LEAD): (ObstacleLabel.VEHICLE, Target.LEAD, 0),
        str(PEDESTRIAN): (ObstacleLabel.PERSON, None, 0),
        str(ONCOMING): (ObstacleLabel.VEHICLE, Target.ONCOMING, 0),
    }
    # From the camera, 1.3 m ahead of the host's centre, to the car's rear bumper.
    assert users[str(LEAD)].distance_m == pytest.approx(30.0 - 2.0 - 1.3)
    assert users[str(LEAD)].left_m == pytest.approx(0.0, abs=1e-6)
    assert users[str(PEDESTRIAN)].left_m == pytest.approx(-2.5)
    detections = {round(one.left_m or 0.0, 3): one for one in drive.images[1.5].detections}
    for one in users.values():
        detection = detections[round(one.left_m or 0.0, 3)]
        assert (detection.label, detection.score) == (one.label, 0.75)
        assert detection.distance_m == pytest.approx(one.distance_m)
        assert detection.sides == pytest.approx(one.sides)


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("truth", ["SensorView", "GroundTruth"])
def test_mcap_file_with_both_channels_is_the_same_drive(
    tmp_path: Path, compression: CompressionType, truth: str
) -> None:
    views = (
        _views()
        if truth == "SensorView"
        else [_encoded(_ground_truth(time_s, THINGS)) for time_s in _times()]
    )
    file = _write_mcap(
        tmp_path / "town.mcap",
        [("log", "TrafficUpdate", [b"\xff"]), ("view", truth, views), ("camera", "SensorData", _reports())],
        compression,
    )
    recording = read_recording(file)
    assert _drive(recording).images == _drive(read_recording(*_traces(tmp_path))).images
    assert (recording.name, list(recording.drives)) == ("town", ["town"])


def test_folders_are_paired_by_name(tmp_path: Path) -> None:
    for name in ("a", "b"):
        _write(tmp_path / f"{name}_sd.osi", _reports())
        _write(tmp_path / f"{name}_sv.osi", _views())
    recording = read_recording(tmp_path)
    assert list(recording.drives) == ["a", "b"]
    assert read_recording(tmp_path, tmp_path) == recording
    (tmp_path / "b_sv.osi").unlink()
    recording = read_recording(tmp_path)
    assert (list(recording.drives), recording.dropped) == (["a"], {"sequences without a file of truth": 1})
    assert recording.notes == ["Left out, without a file of truth: b."]
    with pytest.raises(RecordingError, match=r"found truth of other, and detections of b$"):
        read_recording(
            _write(tmp_path / "b" / "b_sd.osi", _reports()).parent, _write(tmp_path / "other_gt.osi", [])
        )


def test_lane_is_the_hosts_by_assignment_or_straight_ahead(tmp_path: Path) -> None:
    things = {
        1: _Thing(50.0, 9.0, lane=5),
        2: _Thing(20.0, 4.0, lane=6),
        3: _Thing(40.0, -6.0),
        4: _Thing(60.0, 0.5, lane=8),  # the next stretch of the same lane has another number
    }
    drive = _drive(read_recording(*_traces(tmp_path, things=things, host=_Thing(0.0, 0.0, lane=5))))
    lanes = {one.track: one.in_lane for one in drive.images[0.0].road_users}
    assert lanes == {"1": True, "2": False, "3": False, "4": True}


def test_road_user_behind_a_nearer_one_is_hidden(tmp_path: Path) -> None:
    things = {1: _Thing(20.0, 0.0, size=(8.0, 2.5, 3.0)), 2: _Thing(30.0, 0.0)}
    drive = _drive(read_recording(*_traces(tmp_path, things=things)))
    assert {one.track: one.occlusion for one in drive.images[0.0].road_users} == {"1": 0, "2": 2}


def test_detection_without_score_or_size(tmp_path: Path) -> None:
    detected = THINGS[LEAD].detected(score=None)
    without_size = [detected[0], (2, detected[1][1][1:]), *detected[2:]]
    report = [(2, _time(0.0)), (6, [(1, _vector(*MOUNT))]), (13, detected), (13, without_size)]
    recording = read_recording(
        _write(tmp_path / "a_sd.osi", [_encoded(report)]), _write(tmp_path / "a_sv.osi", _views()[:1])
    )
    assert [one.score for one in _drive(recording).images[0.0].detections] == [1.0]
    assert recording.dropped == {"detections without a size": 1}


def _of_times(folder: Path, sent: Sequence[float], true: Sequence[float]) -> Recording:
    return read_recording(
        _write(folder / "a_sd.osi", [_encoded(_sensor_data(time_s, THINGS)) for time_s in sent]),
        _write(folder / "a_sv.osi", [_encoded(_sensor_view(time_s, THINGS)) for time_s in true]),
    )


def test_truth_at_a_higher_rate_makes_no_further_images(tmp_path: Path) -> None:
    recording = _of_times(tmp_path, [0.1, 0.2, 0.3, 0.4, 0.5], [0.02 * number for number in range(28)])
    assert sorted(_drive(recording).images) == [0.1, 0.2, 0.3, 0.4, 0.5]


def test_sensor_that_stops_sending_reports_nothing(tmp_path: Path) -> None:
    true = [0.02 * number for number in range(51)]
    recording = _of_times(tmp_path, [0.2, 0.3, 0.4, 0.7, 0.8], true)
    images = _drive(recording).images
    assert sorted(images) == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0][: len(images)]
    assert len(images) == 9
    assert [time_s for time_s in sorted(images) if not images[time_s].detections] == [0.1, 0.5, 0.6, 0.9]
    assert all(image.road_users for image in images.values())


def test_messages_between_those_of_the_truth_are_dropped_and_counted(tmp_path: Path) -> None:
    recording = _of_times(tmp_path, [0.0, 0.02, 0.1, 0.12, 0.2], [0.0, 0.1, 0.2])
    assert sorted(_drive(recording).images) == [0.0, 0.1, 0.2]
    assert recording.dropped == {"messages of SensorData between those of the truth": 2}
    assert all(len(image.detections) == len(THINGS) for image in _drive(recording).images.values())


def test_messages_of_another_time_are_refused(tmp_path: Path) -> None:
    with pytest.raises(
        RecordingError, match=r"a_sd\.osi: message 2: expected ground truth at 7 s, found it from 0 to 0\.2"
    ):
        _of_times(tmp_path, [0.0, 7.0], [0.0, 0.1, 0.2])
    with pytest.raises(RecordingError, match=r"expected each time once, got 0\.1 s and 0\.1 s"):
        _of_times(tmp_path, [0.0], [0.0, 0.1, 0.1])


def test_cameras_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"expected no camera"):
        read_recording(*_traces(tmp_path), options=ReadOptions(camera=CameraModel.own()))


def test_missing_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mcap.records", None)
    osi_traces._message_classes.cache_clear()
    with pytest.raises(MissingExtra, match=r"OSI traces need mcap and protobuf: .*\[osi\]"):
        read_recording(*_traces(tmp_path))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", r"expected messages of SensorData, found none"),
        (b"\x01\x02", r"message 1: expected its length in 4 bytes"),
        (b"\xff\xff\xff\xff", r"message 1: expected 4294967295 bytes, got 0 up to the end of the file"),
        (b"\x05\0\0\0\x01", r"message 1: expected 5 bytes, got 1"),
        (b"\x02\0\0\0\xff\xff", r"message 1: expected a message SensorData of OSI"),
        (b"\0\0\0\0", r"message 1: expected a timestamp, got none"),
    ],
)
def test_damaged_traces_are_refused(tmp_path: Path, content: bytes, message: str) -> None:
    _, truth = _traces(tmp_path)
    (tmp_path / "x_sd.osi").write_bytes(content)
    with pytest.raises(RecordingError, match=rf"x_sd\.osi: {message}"):
        read_recording(tmp_path / "x_sd.osi", truth)


def test_long_messages_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(osi_traces, "MAX_MESSAGE_BYTES", 100)
    with pytest.raises(RecordingError, match=r"message 1: expected at most 100 bytes, got \d+"):
        read_recording(*_traces(tmp_path))


def test_swapped_and_unnamed_files_are_refused(tmp_path: Path) -> None:
    detections, truth = _traces(tmp_path)
    with pytest.raises(
        RecordingError,
        match=r"expected a trace of SensorView or GroundTruth: .*_gt_ in the name; .*_sd_.* is a file",
    ):
        read_recording(truth, detections)
    with pytest.raises(
        RecordingError, match=r"boxes\.osi: expected a name that says which .*_sd_ \(SensorData\)"
    ):
        read_recording(detections.rename(tmp_path / "boxes.osi"), truth)


@pytest.mark.parametrize(
    ("view", "message"),
    [
        (
            [(2, _time(0.0)), (7, _ground_truth(0.0, THINGS)), (8, [(1, 99)])],
            r"expected the host vehicle 99 among",
        ),
        ([(2, _time(0.0))], r"expected the host vehicle 0 among .* are 0"),
        (
            _sensor_view(0.0, {1: _Thing(9.0, 0.0, size=(0.0, 2.0, 2.0))}),
            r"object 1: expected a length, width",
        ),
        (
            _sensor_view(0.0, {1: _Thing(math.nan, 0.0)}),
            r"object 1: expected a place and a heading in m and rad",
        ),
        (
            _sensor_view(0.0, {1: _Thing(9.0, 0.0, turn_deg=math.inf)}),
            r"object 1: expected a place and a heading",
        ),
        ([(7, [*_ground_truth(0.0, THINGS)[1:]]), (8, [(1, HOST)])], r"expected a timestamp, got none"),
    ],
)
def test_truth_that_cannot_be_is_refused_with_the_message(
    tmp_path: Path, view: Message, message: str
) -> None:
    detections, _ = _traces(tmp_path)
    truth = _write(tmp_path / "x_sv.osi", [_encoded(view)])
    with pytest.raises(RecordingError, match=rf"x_sv\.osi: message 1: .*{message}"):
        read_recording(detections, truth)


def test_host_without_rear_axle_is_refused(tmp_path: Path) -> None:
    detections, _ = _traces(tmp_path)
    host = [(1, [(1, HOST)]), (2, _base(0.0, 0.0, 0.0, 0.0, CAR_SIZE)), (3, VEHICLE)]
    truth: list[bytes] = [_encoded([(2, _time(time_s)), (3, [(1, HOST)]), (5, host)]) for time_s in _times()]
    with pytest.raises(RecordingError, match=r"host vehicle: expected vehicle_attributes\.bbcenter_to_rear"):
        read_recording(detections, _write(tmp_path / "x_gt.osi", truth))


def test_several_channels_of_a_type_are_refused(tmp_path: Path) -> None:
    file = _write_mcap(
        tmp_path / "town.mcap",
        [
            ("view", "SensorView", _views()),
            ("rear", "SensorData", _reports()),
            ("front", "SensorData", _reports()),
        ],
    )
    with pytest.raises(RecordingError, match=r"expected one channel of SensorData, got front, rear"):
        read_recording(file)


def _chunk(compression: str, size: int, data: bytes) -> bytes:
    """Return a chunk that claims to unpack to so many bytes."""
    head = struct.pack("<QQQII", 0, 0, size, 0, len(compression)) + compression.encode()
    content = head + struct.pack("<Q", len(data)) + data
    return struct.pack("<BQ", 6, len(content)) + content


def _bomb(compression: str) -> bytes:
    import lz4.frame
    import zstandard

    zeros = bytes(50_000_000)
    return zstandard.compress(zeros) if compression == "zstd" else lz4.frame.compress(zeros)


MAGIC = b"\x89MCAP0\r\n"


@pytest.mark.parametrize(
    ("records", "message"),
    [
        (lambda: _chunk("zstd", 1000, _bomb("zstd")), r"expected a chunk of 1000 bytes .*damaged"),
        (lambda: _chunk("lz4", 1000, _bomb("lz4")), r"expected a chunk of 1000 bytes .*damaged"),
        (lambda: _chunk("zstd", 2**62, b""), r"expected chunks of at most 268435456 bytes"),
        (lambda: _chunk("zstd", 9, b"abc"), r"expected a chunk of 9 bytes: "),
        (lambda: _chunk("lz4", 9, b"abc"), r"expected a chunk of 9 bytes: "),
        (lambda: _chunk("", 9, b"abc"), r"expected a chunk of 9 bytes: "),
        (lambda: _chunk("gzip", 9, b"abc"), r"expected chunks with zstd, lz4 or no compression, got 'gzip'"),
        (
            lambda: struct.pack("<BQ", 6, 2**63),
            r"expected a record of 9223372036854775808 bytes at byte 17, got 0",
        ),
        (
            lambda: _chunk("", 9, b"")[:-8] + struct.pack("<Q", 2**63),
            r"expected an MCAP file, got a damaged record",
        ),
        (lambda: struct.pack("<BQ", 6, 3) + b"abc", r"expected an MCAP file, got a damaged record"),
        (lambda: struct.pack("<BQHI", 3, 6, 1, 2**31), r"expected an MCAP file, got a damaged record"),
        (lambda: b"\x06", r"expected a record at byte 8, got the end of the file"),
        (lambda: b"", r"expected the footer of an MCAP file, got the end of the file"),
    ],
)
def test_damaged_and_hostile_mcap_files_are_refused(
    tmp_path: Path, records: Callable[[], bytes], message: str
) -> None:
    file = tmp_path / "bad.mcap"
    file.write_bytes(MAGIC + records())
    with pytest.raises(RecordingError, match=rf"bad\.mcap: {message}"):
        read_recording(file)


def test_what_a_file_unpacks_to_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(osi_traces, "MAX_UNPACKED_BYTES", 10_000)
    file = _write_mcap(tmp_path / "town.mcap", [("view", "SensorView", _views())])
    with pytest.raises(RecordingError, match=r"and 10000 together; got \d+, and \d+ so far"):
        read_recording(file)


def test_file_that_is_no_mcap_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bad.mcap").write_bytes(b"PK\x03\x04")
    with pytest.raises(RecordingError, match=r"expected an MCAP file, got one that begins with b'PK"):
        read_recording(tmp_path / "bad.mcap")


def test_objects_of_a_trace_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(osi, "MAX_BOXES", 50)
    with pytest.raises(RecordingError, match=r"expected at most 50 objects in a trace"):
        read_recording(*_traces(tmp_path))


def test_cyclists_are_ignored_unless_the_user_says_what_they_are(tmp_path: Path) -> None:
    paths = _traces(tmp_path, things={1: _Thing(20.0, 1.0, kind=(VEHICLE, BICYCLE))})
    recording = read_recording(*paths)
    image = _drive(recording).images[0.0]
    assert (image.road_users, len(image.ignored), image.detections) == ([], 1, [])
    assert recording.dropped == {"detections of the class bicycle, which is ignored": IMAGES}
    options = ReadOptions(classes={**ReadOptions().classes, "bicycle": ClassMeaning.PERSON})
    image = _drive(read_recording(*paths, options=options)).images[0.0]
    assert [one.label for one in image.road_users] == [ObstacleLabel.PERSON]
    assert [one.label for one in image.detections] == [ObstacleLabel.PERSON]
