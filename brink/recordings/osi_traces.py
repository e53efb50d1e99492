"""OSI trace files: the messages in them, within bounds.

A trace is a file NAME.osi with messages of one type, or NAME.mcap with channels of several. Messages are read with
those fields alone that recordings need; all others are skipped. So traces of any version 3 of OSI can be read, and
the packages with OSI's own classes are not needed.

References:
    ASAM OSI 3.8, *OSI trace file formats* and *OSI trace file naming conventions*; MCAP format specification, version
    0x30.
"""

import io
import re
import struct
import zlib
from collections.abc import Collection, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import IO, Any, Final, NamedTuple

from brink.extras import install_command
from brink.packed import read_exactly
from brink.recordings.recording import MAX_BYTES, RecordingError
from brink.search.errors import MissingExtra
from brink.user_file import read_file

MAX_MESSAGE_BYTES: Final = 64 * 1024**2
"""Maximum size of a message."""
MAX_CHUNK_BYTES: Final = 256 * 1024**2
"""Maximum size of a chunk of an MCAP file, unpacked."""
MAX_UNPACKED_BYTES: Final = 4 * MAX_BYTES
"""Maximum size of all chunks of an MCAP file together, unpacked."""
SUFFIXES: Final = (".osi", ".mcap")
TYPES: Final = {"sv": "SensorView", "gt": "GroundTruth", "sd": "SensorData"}
"""Types of messages that are read, by the code for them in the name of a file."""
_FIELDS: Final = """
    Timestamp: seconds 1 int64, nanos 2 uint32
    Vector3d: x 1 double, y 2 double, z 3 double
    Dimension3d: length 1 double, width 2 double, height 3 double
    Orientation3d: roll 1 double, pitch 2 double, yaw 3 double
    Identifier: value 1 uint64
    MountingPosition: position 1 Vector3d, orientation 2 Orientation3d
    BaseMoving: dimension 1 Dimension3d, position 2 Vector3d, orientation 3 Orientation3d
    VehicleAttributes: bbcenter_to_rear 4 Vector3d
    VehicleClassification: type 1 int32
    MovingObjectClassification: assigned_lane_id* 1 Identifier
    MovingObject: id 1 Identifier, base 2 BaseMoving, type 3 int32, assigned_lane_id* 4 Identifier,
        vehicle_attributes 5 VehicleAttributes, vehicle_classification 6 VehicleClassification,
        moving_object_classification 9 MovingObjectClassification
    GroundTruth: timestamp 2 Timestamp, host_vehicle_id 3 Identifier, moving_object* 5 MovingObject
    SensorView: timestamp 2 Timestamp, global_ground_truth 7 GroundTruth, host_vehicle_id 8 Identifier
    DetectedItemHeader: existence_probability 3 double
    CandidateMovingObject: probability 1 double, type 2 int32, vehicle_classification 3 VehicleClassification
    DetectedMovingObject: header 1 DetectedItemHeader, base 2 BaseMoving, candidate* 8 CandidateMovingObject
    SensorData: timestamp 2 Timestamp, mounting_position 6 MountingPosition, last_measurement_time 9 Timestamp,
        moving_object* 13 DetectedMovingObject
"""
"""Fields of messages with their numbers and types; * marks repeated ones. Enumerations are read as numbers."""
_MAGIC: Final = b"\x89MCAP0\r\n"
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _FOOTER = 3, 4, 5, 6, 2


class TraceMessage(NamedTuple):
    """A message of a trace: its position (for error messages), type, channel and content."""

    where: str
    type: str
    channel: str
    content: Any


def type_by_name(path: Path) -> str | None:
    """Return the type of the messages in a file by the code in its name, such as ``…_sv_…``; None if it has none."""
    found = [TYPES[part] for part in path.stem.lower().split("_") if part in TYPES]
    return found[0] if len(found) == 1 else None


def read_messages(path: Path, types: Collection[str]) -> Iterator[TraceMessage]:
    """Yield the messages of a trace with one of these types of `TYPES`, in the order of the file.

    Raises:
        RecordingError: The file cannot be read, is damaged or too large, or its name does not say what is in it.
        MissingExtra: The packages that read it are not installed.
    """
    classes = _message_classes()
    try:
        content = read_file(path, MAX_BYTES)
    except (OSError, ValueError) as error:
        raise RecordingError(f"{path}: {getattr(error, 'strerror', None) or error}") from error
    from google.protobuf.message import DecodeError

    packed = _mcap_messages(path, content) if path.suffix.lower() == ".mcap" else _osi_messages(path, content)
    for where, type_, channel, data in packed:
        if type_ not in types:
            continue
        if len(data) > MAX_MESSAGE_BYTES:
            raise RecordingError(f"{where}: expected at most {MAX_MESSAGE_BYTES} bytes, got {len(data)}")
        try:
            message = classes[type_].FromString(data)
        except DecodeError as error:
            raise RecordingError(f"{where}: expected a message {type_} of OSI: {error}") from error
        yield TraceMessage(where, type_, channel, message)


def _osi_messages(path: Path, content: bytes) -> Iterator[tuple[str, str, str, bytes]]:
    """Yield the messages of a single-channel trace: each after its length, in four bytes, little-endian."""
    type_ = type_by_name(path)
    if type_ is None:
        codes = " or ".join(f"_{code}_ ({name})" for code, name in TYPES.items())
        raise RecordingError(f"{path}: expected a name that says which messages are in it: {codes}")
    at, number = 0, 0
    while at < len(content):
        number += 1
        where = f"{path}: message {number}"
        if at + 4 > len(content):
            raise RecordingError(f"{where}: expected its length in 4 bytes, got the end of the file")
        size = int.from_bytes(content[at : at + 4], "little")
        if size > len(content) - at - 4:
            raise RecordingError(
                f"{where}: expected {size} bytes, got {len(content) - at - 4} up to the end of the file"
            )
        yield where, type_, "", content[at + 4 : at + 4 + size]
        at += 4 + size


def _mcap_messages(path: Path, content: bytes) -> Iterator[tuple[str, str, str, bytes]]:
    """Yield the messages of a multi-channel trace."""
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import McapError
    from mcap.records import Channel, Message, Schema

    if not content.startswith(_MAGIC):
        raise RecordingError(f"{path}: expected an MCAP file, got one that begins with {content[:8]!r}")
    names: dict[int, str] = {}
    channels: dict[int, tuple[str, str]] = {}
    number = 0
    try:
        for opcode, record in _unpacked_records(path, content):
            stream = ReadDataStream(io.BytesIO(record))
            if opcode == _SCHEMA:
                schema = Schema.read(stream)
                names[schema.id] = schema.name
            elif opcode == _CHANNEL:
                channel = Channel.read(stream)
                type_ = names.get(channel.schema_id, "").removeprefix("osi3.")
                if type_ in TYPES.values() and channel.message_encoding == "protobuf":
                    channels[channel.id] = type_, channel.topic
            elif opcode == _MESSAGE:
                message = Message.read(stream, len(record))
                if message.channel_id in channels:
                    number += 1
                    yield f"{path}: message {number}", *channels[message.channel_id], message.data
    except (McapError, struct.error, ValueError, OverflowError) as error:
        raise RecordingError(f"{path}: expected an MCAP file, got a damaged record: {error!r}") from error


def _unpacked_records(path: Path, content: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the records of an MCAP file, and those in its chunks, each with its opcode."""
    from mcap.data_stream import ReadDataStream
    from mcap.records import Chunk

    unpacked = 0
    for opcode, record in _records(path, content, len(_MAGIC)):
        if opcode == _FOOTER:
            return
        if opcode != _CHUNK:
            yield opcode, record
            continue
        chunk = Chunk.read(ReadDataStream(io.BytesIO(record)))
        unpacked += chunk.uncompressed_size
        if chunk.uncompressed_size > MAX_CHUNK_BYTES or unpacked > MAX_UNPACKED_BYTES:
            raise RecordingError(
                f"{path}: expected chunks of at most {MAX_CHUNK_BYTES} bytes, and {MAX_UNPACKED_BYTES} together; got "
                f"{chunk.uncompressed_size}, and {unpacked} so far"
            )
        yield from _records(path, _unpacked(path, chunk), 0)
    raise RecordingError(f"{path}: expected the footer of an MCAP file, got the end of the file")


def _records(path: Path, content: bytes, at: int) -> Iterator[tuple[int, bytes]]:
    while at < len(content):
        if at + 9 > len(content):
            raise RecordingError(f"{path}: expected a record at byte {at}, got the end of the file")
        opcode, size = struct.unpack_from("<BQ", content, at)
        at += 9
        if size > len(content) - at:
            raise RecordingError(
                f"{path}: expected a record of {size} bytes at byte {at}, got {len(content) - at}"
            )
        yield opcode, content[at : at + size]
        at += size


def _unpacked(path: Path, chunk: Any) -> bytes:
    """Return the content of a chunk, which must have the size that it declares."""
    import lz4.frame
    import zstandard

    packed: IO[bytes] = io.BytesIO(chunk.data)
    if chunk.compression == "zstd":
        packed = zstandard.ZstdDecompressor(max_window_size=MAX_CHUNK_BYTES).stream_reader(packed)
    elif chunk.compression == "lz4":
        packed = lz4.frame.open(packed)
    elif chunk.compression:
        raise RecordingError(
            f"{path}: expected chunks with zstd, lz4 or no compression, got {chunk.compression!r:.40}"
        )
    try:
        data = read_exactly(packed, chunk.uncompressed_size)
        is_longer = bool(packed.read(1))
    except (zstandard.ZstdError, RuntimeError, EOFError, ValueError) as error:
        raise RecordingError(
            f"{path}: expected a chunk of {chunk.uncompressed_size} bytes: {error}"
        ) from error
    if is_longer or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
        raise RecordingError(
            f"{path}: expected a chunk of {chunk.uncompressed_size} bytes with the checksum "
            f"{chunk.uncompressed_crc}; it is damaged"
        )
    return data


@cache
def _message_classes() -> Mapping[str, Any]:
    """Return the class of each type of messages.

    Raises:
        MissingExtra: The packages that read traces are not installed.
    """
    try:
        import mcap.records  # noqa: F401
        from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
    except ImportError:
        raise MissingExtra(f"OSI traces need mcap and protobuf: {install_command('osi')}") from None
    kinds = {
        "double": descriptor_pb2.FieldDescriptorProto.TYPE_DOUBLE,
        "int32": descriptor_pb2.FieldDescriptorProto.TYPE_INT32,
        "int64": descriptor_pb2.FieldDescriptorProto.TYPE_INT64,
        "uint32": descriptor_pb2.FieldDescriptorProto.TYPE_UINT32,
        "uint64": descriptor_pb2.FieldDescriptorProto.TYPE_UINT64,
    }
    file = descriptor_pb2.FileDescriptorProto(name="osi3.proto", package="osi3", syntax="proto2")
    for name, fields in re.findall(r"(\w+):((?:[^:]*)(?=\n\s*\w+:|\Z))", _FIELDS):
        message = file.message_type.add(name=name)
        for field, star, number, kind in re.findall(r"(\w+)(\*?) (\d+) (\w+)", fields):
            added = message.field.add(name=field, number=int(number), label=3 if star else 1)
            if kind in kinds:
                added.type = kinds[kind]
            else:
                added.type, added.type_name = (
                    descriptor_pb2.FieldDescriptorProto.TYPE_MESSAGE,
                    f".osi3.{kind}",
                )
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return {
        name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"osi3.{name}"))
        for name in TYPES.values()
    }
