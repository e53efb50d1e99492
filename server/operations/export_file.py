"""Reads the file of an exported campaign, whose contents are bounded before they are unpacked.

A few kilobytes of a zip archive can stand for gigabytes, and what an archive says about itself need not be true. So
nothing is read that is larger than it may be, and nothing is read in one piece but single values:

- The list of members, which Python reads at once, has a maximum size.
- All members together may be at most `MOST_EXPANSION` times as large as the file, beyond `FREE_BYTES`. Exports of
  campaigns are 5 to 20 times as large: every row contains hashes and random numbers.
- `brink.packed` says what a member may be.
- The sizes of manifest, lines and arrays are limited, and an array must be as large as its header says.

Every member must match its checksum in the manifest before anything of it is used.
"""

import hashlib
import io
import json
import math
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Annotated, Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from brink.packed import PIECE_BYTES, check_members, read_exactly, read_header
from brink.server.campaigns.follow_ups.follow_up import FollowUp
from brink.server.campaigns.follow_ups.limits import MOST
from brink.server.errors import ServerError
from brink.server.states import FollowUpKind, Selection
from brink.user_file import open_file

FORMAT: Final = "brink-campaign"
VERSION: Final = 2
MANIFEST: Final = "manifest.json"
LINKS: Final = "follow_ups.jsonl"
FOLLOW_UPS: Final = "follow-ups/"

LARGEST_BYTES: Final = 64 * 1024**3
"""Maximum size of all members together, unpacked."""
MOST_EXPANSION: Final = 200
FREE_BYTES: Final = 64 * 1024**2
"""Maximum size of all members together: this times the size of the file, and so much more."""
LARGEST_DIRECTORY: Final = 8 * 1024**2
LARGEST_MANIFEST: Final = 16 * 1024**2
LONGEST_LINE: Final = 16 * 1024**2
MOST_VALUES: Final = 1_000_000
"""Maximum number of commas and opening brackets in a line, or in the manifest: parsed, they become Python objects."""
LARGEST_VALUE: Final = 256 * 1024**2
"""Maximum size of an array that is stored as one value: a checkpoint, the distances of a generation."""
LARGEST_TRACE: Final = 6_000_000
"""Maximum size of a trace; workers may report as much."""

CampaignId = Annotated[str, Field(pattern=r"^[0-9A-Za-z]{1,16}$")]


class BadFile(ServerError):
    """The file was not written by `brink export`, is damaged, or contradicts its manifest."""


Threshold = Annotated[float, Field(ge=0, le=1)]


class Link(BaseModel):
    """What a follow-up asks, as in the table of follow-ups."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    campaign_id: CampaignId
    of_id: CampaignId
    numbers: Annotated[
        tuple[Annotated[int, Field(ge=0, lt=2**63)], ...], Field(min_length=1, max_length=MOST, strict=False)
    ]
    kind: Annotated[FollowUpKind, Field(strict=False)]
    selection: Annotated[Selection, Field(strict=False)]
    t_b: Threshold | None
    d_th: Threshold | None
    repeats: Annotated[int, Field(ge=2, le=10_000)] | None

    @property
    def folder(self) -> str:
        """The folder of its members."""
        return f"{FOLLOW_UPS}{self.campaign_id}/"

    def asks(self) -> FollowUp:
        """Return what the follow-up asks."""
        return FollowUp(**self.model_dump(exclude={"campaign_id"}))


class _Manifest(BaseModel):
    """The manifest of a file."""

    model_config = ConfigDict(extra="ignore", frozen=True, strict=True)

    campaign: CampaignId
    sha256: dict[str, Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]]


@contextmanager
def open_export(path: Path) -> Iterator["ExportFile"]:
    """Open an exported campaign whose members match their checksums.

    Raises:
        BadFile: It is of another kind, too large, or damaged.
    """
    with ExitStack() as stack:
        with reading(path):
            file = stack.enter_context(_BoundedReads(stack.enter_context(open_file(path))))
            archive = stack.enter_context(zipfile.ZipFile(file))
            export = ExportFile(path, archive, file.size)
        yield export


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Describe the errors of reading an exported campaign.

    Raises:
        BadFile: The file is damaged, or no such file.
    """
    try:
        yield
    except FileNotFoundError:
        raise BadFile(f"{path}: no such file") from None
    except BadFile as error:
        raise BadFile(f"{path}: {error}") from None
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        OSError,
        KeyError,
        UnicodeDecodeError,
        NotImplementedError,
        RuntimeError,  # raised by zipfile for encrypted members
    ) as error:
        raise BadFile(f"{path}: expected an undamaged file written by brink export: {error}") from None


class _BoundedReads(io.BufferedReader):
    """A file from which at most `LARGEST_DIRECTORY` bytes are read at once: `zipfile` reads its list in one piece.

    Attributes:
        size: The size of the file.
    """

    def __init__(self, file: IO[bytes]) -> None:
        super().__init__(io.FileIO(file.fileno(), closefd=False))
        self.size = self.seek(0, io.SEEK_END)
        self.seek(0)

    def read(self, size: int | None = -1, /) -> bytes:
        left = max(0, self.size - self.tell())
        wanted = left if size is None or size < 0 else min(size, left)
        if wanted > LARGEST_DIRECTORY:
            raise BadFile(f"expected a list of members of at most {LARGEST_DIRECTORY} bytes, got {wanted}")
        return super().read(wanted)


class ExportFile:
    """A file to import, whose members have passed the check of their checksums.

    Attributes:
        path: The file.
        campaign: Id of its campaign.
        members: Names of its members, without the manifest.
    """

    def __init__(self, path: Path, archive: zipfile.ZipFile, size: int) -> None:
        self.path = path
        self._archive = archive
        try:
            check_members(archive, size, min(LARGEST_BYTES, FREE_BYTES + MOST_EXPANSION * size))
        except ValueError as error:
            raise BadFile(str(error)) from None
        manifest = self._read_manifest()
        self.campaign: str = manifest.campaign
        self.members: frozenset[str] = frozenset(manifest.sha256)
        for name, expected in manifest.sha256.items():
            digest = hashlib.sha256()
            with archive.open(name) as member:
                while data := member.read(PIECE_BYTES):
                    digest.update(data)
            if digest.hexdigest() != expected:
                raise BadFile(f"{name}: damaged: it does not match its checksum")

    def documents(self, member: str) -> Iterator[tuple[int, Any]]:
        """Yield the documents of a member in JSON Lines, each with the number of its line, from 1 on.

        Raises:
            KeyError: There is no such member.
            BadFile: A line is too long, or is not plain JSON.
        """
        with self._archive.open(member) as file:
            place = 0
            while line := file.readline(LONGEST_LINE + 1):
                place += 1
                if len(line) > LONGEST_LINE:
                    raise BadFile(f"{member}: expected lines of at most {LONGEST_LINE} bytes")
                try:
                    yield place, plain_json(line)
                except ValueError as error:
                    raise BadFile(f"{member}, line {place}: {error}") from None

    def links(self) -> list[Link]:
        """Return the follow-ups in the file.

        Raises:
            BadFile: They do not fit the members of the file.
        """
        found: list[Link] = []
        for place, document in self.documents(LINKS) if LINKS in self.members else ():
            try:
                found.append(Link.model_validate(document))
            except ValidationError as error:
                fault = error.errors(include_url=False)[0]
                where = ".".join(str(part) for part in fault["loc"])
                raise BadFile(f"{LINKS}, line {place}: {where}: {fault['msg']}") from None
        known = {self.campaign}
        for place, link in enumerate(found, start=1):
            if link.of_id not in known or link.campaign_id in known:
                raise BadFile(f"{LINKS}, line {place}: expected a new follow-up of a campaign before it")
            known.add(link.campaign_id)
        folders = {
            name.removeprefix(FOLLOW_UPS).split("/")[0]
            for name in self.members
            if name.startswith(FOLLOW_UPS)
        }
        if folders != known - {self.campaign}:
            raise BadFile(f"{LINKS}: expected a line for each folder in {FOLLOW_UPS}")
        return found

    def array(self, member: str, dtype: str, most_bytes: int = LARGEST_VALUE) -> NDArray[Any]:
        """Return an array.

        Args:
            member: The member, in NumPy's format.
            dtype: The type of its numbers, such as ``<f8``.
            most_bytes: Maximum size.

        Raises:
            KeyError: There is no such member.
            BadFile: It is not such an array, or larger.
        """
        with self._archive.open(member) as file:
            shape = self._shape(member, file, dtype)
            size = math.prod(shape) * np.dtype(dtype).itemsize
            if size > most_bytes:
                raise BadFile(f"{member}: expected at most {most_bytes} bytes, got {size}")
            return np.frombuffer(_content(member, file, size), dtype).reshape(shape)

    def rows(self, member: str, columns: int) -> Iterator[bytes]:
        """Yield the rows of a matrix of little-endian float64 numbers, one after another.

        Args:
            member: The member, in NumPy's format.
            columns: Number of columns.

        Raises:
            BadFile: It is not such a matrix, or has a number that is not finite.
        """
        if member not in self.members:
            return
        with self._archive.open(member) as file:
            shape = self._shape(member, file, "<f8")
            if len(shape) != 2 or shape[1] != columns:
                raise BadFile(f"{member}: expected {columns} numbers in each row")
            for place in range(shape[0]):
                row = _content(member, file, 8 * columns)
                if not np.isfinite(np.frombuffer(row, "<f8")).all():
                    raise BadFile(f"{member}: row {place}: expected finite numbers")
                yield row

    def _shape(self, member: str, file: IO[bytes], dtype: str) -> tuple[int, ...]:
        """Read the header of an array; return its shape, whose size matches the rest of the member."""
        try:
            shape, found, order = read_header(file, self._archive.getinfo(member).file_size)
        except ValueError as error:
            raise BadFile(f"{member}: expected an array: {error}") from None
        if found.str != dtype or order != "C":
            raise BadFile(f"{member}: expected numbers of type {dtype}, got {found.str}")
        return shape

    def _read_manifest(self) -> _Manifest:
        try:
            size = self._archive.getinfo(MANIFEST).file_size
            if size > LARGEST_MANIFEST:
                raise BadFile(f"{MANIFEST}: expected at most {LARGEST_MANIFEST} bytes, got {size}")
            with self._archive.open(MANIFEST) as member:
                document = plain_json(read_exactly(member, size))
        except (KeyError, ValueError):
            raise BadFile("expected a file written by brink export: it has no manifest") from None
        if not isinstance(document, dict) or document.get("format") != FORMAT:
            raise BadFile("expected a file written by brink export: its manifest is from another program")
        if document.get("version") != VERSION:
            raise BadFile(f"expected format version {VERSION}, got {document.get('version')!r:.20}")
        try:
            manifest = _Manifest.model_validate(document)
        except ValidationError as error:
            fault = error.errors(include_url=False)[0]
            raise BadFile(f"{MANIFEST}: {fault['loc'][0]}: {fault['msg']}") from None
        members = {one.filename for one in self._archive.infolist()} - {MANIFEST}
        if members != manifest.sha256.keys():
            differing = sorted(members ^ manifest.sha256.keys())[:3]
            raise BadFile(f"expected exactly the members that the manifest lists; differing: {differing}")
        return manifest


def _content(member: str, file: IO[bytes], size: int) -> bytes:
    try:
        return read_exactly(file, size)
    except ValueError as error:
        raise BadFile(f"{member}: {error}") from None


def plain_json(text: bytes) -> Any:
    """Parse JSON as strictly as the API does: finite numbers, no duplicate keys, text that can be stored.

    Raises:
        ValueError: It is not such JSON, or has too many values.
    """
    if sum(map(text.count, (b",", b"[", b"{"))) > MOST_VALUES:
        raise ValueError(f"expected at most {MOST_VALUES} values")
    try:
        document = json.loads(
            text.decode("utf-8"), parse_float=_finite, parse_constant=_finite, object_pairs_hook=_unique
        )
    except RecursionError:
        raise ValueError("JSON is nested too deeply") from None
    _check_text(document)
    return document


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"expected finite numbers, got {text:.40}")
    return value


def _unique(pairs: Sequence[tuple[str, Any]]) -> Mapping[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("expected each key once")
    return found


def _check_text(document: Any) -> None:
    """Check that all text in a document can be stored: no NUL, no lone surrogates."""
    waiting = [document]
    while waiting:
        value = waiting.pop()
        if isinstance(value, dict):
            waiting += value.keys()
            waiting += value.values()
        elif isinstance(value, list):
            waiting += value
        elif isinstance(value, str) and not _is_storable(value):
            raise ValueError("expected text without NUL characters and lone surrogates")


def _is_storable(text: str) -> bool:
    if "\0" in text:
        return False
    return text.isascii() or not any("\ud800" <= one <= "\udfff" for one in text)
