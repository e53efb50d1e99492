"""Unpacks arrays from zip archives (npz) of bounded size.

A few kilobytes can stand for gigabytes, and what an archive says about itself need not be true. Members must be
stored or deflated, since Python cannot unpack a part of a member that was packed with another method, and they are
unpacked in pieces, since Python unpacks up to 2 GB at once otherwise, whatever size a member has according to the
archive. An array must be as large as its header says.
"""

import io
import math
import zipfile
from typing import IO, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

PIECE_BYTES: Final = 1024**2
_METHODS: Final = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


def check_members(archive: zipfile.ZipFile, size: int, most_bytes: int) -> None:
    """Check the list of an archive's members, before any is unpacked.

    Args:
        archive: The archive.
        size: Its size.
        most_bytes: Maximum size of all members together, unpacked.

    Raises:
        ValueError: There is too much in it, or it is not what an archive of this program looks like.
    """
    members = archive.infolist()
    if len({one.filename for one in members}) < len(members):
        raise ValueError("expected each member once")
    if any(one.compress_type not in _METHODS for one in members):
        raise ValueError("expected members that are stored or deflated")
    if sum(one.compress_size for one in members) > size:
        raise ValueError("expected members that do not overlap")
    if (unpacked := sum(one.file_size for one in members)) > most_bytes:
        raise ValueError(f"expected at most {most_bytes} bytes when unpacked, got {unpacked}")


def read_exactly(file: IO[bytes], size: int) -> bytes:
    """Read a number of bytes in pieces.

    Raises:
        ValueError: There are fewer.
    """
    content = bytearray()
    while len(content) < size and (piece := file.read(min(PIECE_BYTES, size - len(content)))):
        content += piece
    if len(content) < size:
        raise ValueError(f"expected {size} bytes, got {len(content)}")
    return bytes(content)


def read_header(file: IO[bytes], size: int) -> tuple[tuple[int, ...], np.dtype[Any], Literal["C", "F"]]:
    """Read the header of an array in NumPy's format; return its shape, the type of its numbers, and their order.

    Args:
        file: At its beginning.
        size: Size of the file.

    Raises:
        ValueError: It is not an array of numbers, or its shape does not fit the size.
    """
    version = np.lib.format.read_magic(file)
    if version != (1, 0):  # later versions have headers of up to 4 GB
        raise ValueError(f"expected an array of format 1.0, got {version}")
    try:
        shape, is_fortran, dtype = np.lib.format.read_array_header_1_0(file)
    except (OverflowError, SyntaxError, RecursionError, MemoryError, TypeError) as error:
        raise ValueError(str(error)) from None
    left = size - file.tell()
    fits = min(shape, default=1) >= 0 and math.prod(shape) * dtype.itemsize == left
    if dtype.hasobject or not fits:
        raise ValueError(f"{left} bytes do not fit the shape {shape} of {dtype.str}")
    return tuple(shape), dtype, "F" if is_fortran else "C"


def read_arrays(content: bytes, most_bytes: int) -> dict[str, NDArray[Any]]:
    """Return the arrays of an npz archive.

    Args:
        content: The archive.
        most_bytes: Maximum size of all arrays together.

    Raises:
        ValueError: It is not such an archive, or is too large.
        zipfile.BadZipFile: It is damaged; other errors of zipfile are possible, too.
    """
    arrays = {}
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        check_members(archive, len(content), most_bytes)
        for member in archive.infolist():
            with archive.open(member) as packed:
                file = io.BytesIO(read_exactly(packed, member.file_size))
                if packed.read(1):
                    raise ValueError(f"{member.filename}: expected {member.file_size} bytes, got more")
            try:
                shape, dtype, order = read_header(file, member.file_size)
            except ValueError as error:
                raise ValueError(f"{member.filename}: expected an array: {error}") from None
            array = np.frombuffer(file.getbuffer()[file.tell() :], dtype).reshape(shape, order=order)
            arrays[member.filename.removesuffix(".npy")] = array
    return arrays
