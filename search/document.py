"""File format of stored states: a JSON header and named arrays in one npz file, without pickles.

Equal documents have equal bytes. A checksum over the content is verified before anything else is read.
"""

import hashlib
import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from brink.packed import read_arrays
from brink.search.errors import DocumentError, OtherVersion

_MAGIC = b"brink-document-1\n"
_HEADER = "header"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Document:
    """A versioned document: a JSON header and named arrays.

    Attributes:
        kind: Owner of the state, such as ``mlcshe@1``.
        version: Version of the layout, >= 1.
        header: JSON object.
        arrays: Arrays of numbers or booleans, by name.
    """

    kind: str
    version: int
    header: Mapping[str, Any]
    arrays: Mapping[str, NDArray[Any]]

    def to_bytes(self) -> bytes:
        """Return the document as bytes.

        Raises:
            DocumentError: The header is not plain JSON, or an array holds objects.
        """
        try:
            header = json.dumps(
                {"kind": self.kind, "version": self.version, "header": dict(self.header)},
                sort_keys=True,
                allow_nan=False,
            )
        except (TypeError, ValueError) as error:
            raise DocumentError(f"header of {self.kind}: expected plain JSON: {error}") from error
        content = io.BytesIO()
        arrays = {f"array_{name}": np.asarray(self.arrays[name]) for name in sorted(self.arrays)}
        for name, array in arrays.items():
            if array.dtype.hasobject:
                raise DocumentError(f"{name} of {self.kind}: expected numbers, got {array.dtype}")
        np.savez(content, allow_pickle=False, **{_HEADER: np.frombuffer(header.encode(), np.uint8)}, **arrays)
        payload = content.getvalue()
        return _MAGIC + hashlib.sha256(payload).digest() + payload

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """Return the document that the given bytes encode.

        Raises:
            DocumentError: The bytes are not a document, or are corrupt.
        """
        if not data.startswith(_MAGIC):
            raise DocumentError(f"expected bytes starting with {_MAGIC!r}, got {bytes(data[:20])!r}")
        start = len(_MAGIC) + hashlib.sha256().digest_size
        payload = bytes(data[start:])
        if hashlib.sha256(payload).digest() != data[len(_MAGIC) : start]:
            raise DocumentError("corrupt document: the checksum does not match; restore it from a backup")
        try:
            arrays = read_arrays(payload, len(payload))  # nothing in it is compressed
            content = json.loads(arrays.pop(_HEADER).tobytes())
            return cls(
                kind=content["kind"],
                version=content["version"],
                header=content["header"],
                arrays={name.removeprefix("array_"): array for name, array in arrays.items()},
            )
        except (
            ValueError,
            KeyError,
            TypeError,
            OSError,
            EOFError,
            RuntimeError,
            zipfile.BadZipFile,
            zlib.error,
        ) as error:
            raise DocumentError(f"corrupt document: {error}") from error

    def expect(self, kind: str, version: int) -> Self:
        """Return the document itself, after checking its kind and version.

        Raises:
            OtherVersion: The version differs.
            DocumentError: The kind differs.
        """
        if (self.kind, self.version) != (kind, version):
            message = f"expected a document of {kind}, version {version}; got {self.kind!r}, version {self.version!r}"
            raise OtherVersion(message) if self.kind == kind else DocumentError(message)
        return self
