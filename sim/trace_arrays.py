"""The named arrays of a trace that came from elsewhere: bounded, whatever its archive says of itself."""

import io
import zipfile
import zlib
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from brink.sim.errors import InvalidEpisode

MOST_BYTES: Final = 256 * 1024**2
"""Of all arrays together, unpacked: a trace of six megabytes can claim gigabytes."""
MOST_SAMPLES: Final = 36_000
"""An hour of ten samples a second."""
FARTHEST: Final = 1e5
"""No place and no time lies farther from the origin, in m or s."""

_PLACES: Final = ("time_s", "ego", "route", "actor.", "scene.")


def unpacked(document: bytes) -> dict[str, NDArray[Any]]:
    """Return the arrays of an npz archive.

    Raises:
        InvalidEpisode: It is none, or larger than any trace is.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(document)) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size > MOST_BYTES:
            raise InvalidEpisode(f"not a trace: expected at most {MOST_BYTES} bytes unpacked, got {size}")
        with np.load(io.BytesIO(document), allow_pickle=False) as npz:
            arrays = {name: npz[name] for name in npz.files}
    except (ValueError, KeyError, OSError, EOFError, MemoryError, RuntimeError) as error:
        raise InvalidEpisode(f"not a trace: {error}") from error
    except (zipfile.BadZipFile, zlib.error) as error:
        raise InvalidEpisode(f"not a trace: {error}") from error
    _check(arrays)
    return arrays


def _check(arrays: dict[str, NDArray[Any]]) -> None:
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
            raise InvalidEpisode(f"not a trace: expected numbers in {name!r}")
        if name.startswith(_PLACES):
            if array.ndim == 0 or (len(array) > MOST_SAMPLES):
                raise InvalidEpisode(f"not a trace: expected at most {MOST_SAMPLES} rows of {name!r}")
            if np.any(np.abs(array) > FARTHEST):
                raise InvalidEpisode(f"not a trace: {name!r} holds a place farther away than {FARTHEST:g}")
