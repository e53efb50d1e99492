"""Files that users name are read within bounds: pipes and devices are refused, archives unpack to what they may."""

import hashlib
import io
import os
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from brink.guard.drives import load_drives
from brink.guard.model import GuardModel
from brink.packed import read_arrays
from brink.python.study import Study
from brink.recordings.files import read_json
from brink.recordings.reading import read_recording, read_settings
from brink.recordings.recording import RecordingError
from brink.scenarios.logical.document import read_document
from brink.search.analysis.monitor import Monitor
from brink.search.document import Document
from brink.search.errors import DocumentError
from brink.server.documents import errors_in_file, read_yaml
from brink.server.errors import InvalidInput
from brink.server.operations.export_file import BadFile, open_export
from brink.sim.adapters.sumo.own_files import OwnFilesError, _bytes
from brink.sim.errors import InvalidEpisode
from brink.sim.guard.option import guard_digest
from brink.sim.perception.user_files import DatasetError, DetectorError, read_coco, weights_file
from brink.sim.trace import Trace
from brink.user_file import open_file, read_file, read_text

MIB = 1024**2


def _imported(path: Path) -> None:
    with open_export(path):
        pass


def _placed(path: Path) -> None:
    with errors_in_file(path):
        raise InvalidInput.at("/name", "wrong")


READERS: dict[Callable[[Path], Any], type[Exception]] = {
    read_yaml: InvalidInput,
    _placed: InvalidInput,
    _imported: BadFile,
    Monitor.load: OSError,
    Study.load: OSError,
    GuardModel.load: OSError,
    guard_digest: InvalidEpisode,
    read_document: InvalidInput,
    read_coco: DatasetError,
    read_settings: InvalidInput,
    lambda path: read_recording(path, path, format="csv"): RecordingError,
    lambda path: read_recording(path, path, format="coco"): RecordingError,
    lambda path: read_recording(path, path, format="kitti"): RecordingError,
    lambda path: read_recording(path, path, format="mot"): RecordingError,
    lambda path: read_recording(path): RecordingError,
    lambda path: weights_file(f"onnx:{path}"): DetectorError,
    lambda path: _bytes(str(path)): OwnFilesError,
    lambda path: read_text(path, MIB): OSError,
}


@pytest.mark.timeout(30)
@pytest.mark.parametrize("reader", READERS)
def test_a_pipe_and_a_device_are_refused_at_once(reader: Callable[[Path], Any], tmp_path: Path) -> None:
    """Opening a pipe to which nobody writes waits for ever, and the device has no end."""
    pipe = tmp_path / "pipe.json"
    os.mkfifo(pipe)
    for path in (pipe, Path("/dev/zero")):
        with pytest.raises(READERS[reader]):
            reader(path)


@pytest.mark.timeout(30)
def test_pipes_in_the_folders_of_a_recording_are_refused_at_once(tmp_path: Path) -> None:
    for folder in ("kitti", "S/gt", "S/det"):
        (tmp_path / folder).mkdir(parents=True)
    for pipe in ("kitti/0000.txt", "S/gt/gt.txt", "S/det/det.txt"):
        os.mkfifo(tmp_path / pipe)
    with pytest.raises(RecordingError):
        read_recording(tmp_path / "kitti", tmp_path / "kitti", format="kitti")
    with pytest.raises(RecordingError):
        read_recording(tmp_path / "S", tmp_path, format="mot")
    with pytest.raises(RecordingError):
        read_recording(tmp_path)


@pytest.mark.timeout(30)
def test_a_pipe_in_place_of_recorded_drives_is_none(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "drives.npz")
    assert load_drives(tmp_path / "drives.npz") is None


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    file = tmp_path / "large"
    with file.open("wb") as large:
        large.truncate(100 * 1024**3)
    tracemalloc.start()
    try:
        with pytest.raises(OSError, match="larger than 1000 bytes"):
            read_file(file, 1000)
        for reader in (Monitor.load, read_yaml, Study.load, load_drives):
            if reader is load_drives:
                assert load_drives(file) is None
                continue
            with pytest.raises((OSError, InvalidInput), match="larger than"):
                reader(file)
        assert tracemalloc.get_traced_memory()[1] < 10 * MIB
    finally:
        tracemalloc.stop()
    with pytest.raises(OSError, match="expected a regular file"):
        open_file(tmp_path)


def packed(data: bytes, method: int = zipfile.ZIP_DEFLATED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        archive.writestr("header.npy", data)
    return file.getvalue()


def zeros(size: int) -> bytes:
    file = io.BytesIO()
    np.save(file, np.zeros(size, "|u1"))
    return file.getvalue()


def understated() -> bytes:
    content, size = packed(zeros(150 * MIB)), (len(zeros(150 * MIB))).to_bytes(4, "little")
    assert content.count(size) == 2
    return content.replace(size, len(zeros(1000)).to_bytes(4, "little"))


def long_header() -> bytes:
    return packed(b"\x93NUMPY\x02\x00" + (150 * MIB).to_bytes(4, "little") + b" " * 150 * MIB)


BOMBS: dict[str, Callable[[], bytes]] = {
    "zeros": lambda: packed(zeros(150 * MIB)),
    "understated": understated,
    "bzip2": lambda: packed(zeros(150 * MIB), zipfile.ZIP_BZIP2),
    "a long header": long_header,
    "a shape that is huge": lambda: packed(zeros(1000).replace(b"(1000,)", b"(10**9)")),
    "no array": lambda: packed(b"nothing"),
}


@pytest.mark.parametrize("name", BOMBS)
def test_arrays_that_unpack_to_much_more_are_refused_before_they_do(name: str) -> None:
    content = BOMBS[name]()
    tracemalloc.start()
    try:
        with pytest.raises((ValueError, zipfile.BadZipFile)):
            read_arrays(content, 100 * MIB)
        assert tracemalloc.get_traced_memory()[1] < 30 * MIB
    finally:
        tracemalloc.stop()


def test_a_stored_state_is_as_large_as_it_looks() -> None:
    state = Document(kind="x@1", version=1, header={}, arrays={"a": np.asfortranarray(np.eye(3)[:, :2])})
    assert np.array_equal(Document.from_bytes(state.to_bytes()).arrays["a"], np.eye(3)[:, :2])
    content, trace = packed(zeros(150 * MIB)), understated()
    forged = state.to_bytes()[:17] + hashlib.sha256(content).digest() + content
    tracemalloc.start()
    try:
        with pytest.raises(DocumentError, match="expected at most"):
            Document.from_bytes(forged)
        with pytest.raises(InvalidEpisode):
            Trace.from_bytes(trace)
        assert tracemalloc.get_traced_memory()[1] < 30 * MIB
    finally:
        tracemalloc.stop()


def test_json_that_is_nested_too_deeply_is_an_error(tmp_path: Path) -> None:
    file = tmp_path / "deep.json"
    file.write_text("[" * 100_000)
    for reader, kind in (
        (read_json, RecordingError),
        (Study.load, DocumentError),
        (Monitor.load, DocumentError),
    ):
        with pytest.raises(kind):
            reader(file)
