"""Exports a campaign to one file, with everything that belongs to it, and imports it elsewhere.

The file is a zip archive: `manifest.json` with a format version and a checksum of every other member, one member in
JSON Lines for each table (`solutions.jsonl`), and arrays in NumPy's format (`arrays/vectors.npy`), which
``numpy.load`` can read. Nothing in it is ever executed.

Imported files are not trusted: types, ranges, checksums and hashes are checked, the file is stored in one
transaction, and its results are not shared with other campaigns.
"""

import hashlib
import io
import json
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from sqlalchemy import JSON, Connection, RowMapping, Table, insert, select
from sqlalchemy.exc import DataError, IntegrityError

from brink import __version__
from brink.server.campaigns.body import DEFAULT_MAX_LOSSES, search_text, stored_body
from brink.server.campaigns.plan import make_plan
from brink.server.campaigns.store import CAMPAIGNS
from brink.server.db.models import (
    Base,
    CampaignRow,
    CampaignTagRow,
    CheckpointRow,
    DistanceBlockRow,
    GenerationRow,
    JobRow,
    KnownSolutionRow,
    LlmCallRow,
    SolutionRow,
    TraceRow,
    ViolationNameRow,
)
from brink.server.db.sql import database_now
from brink.server.db.types import UtcDateTime
from brink.server.errors import Conflict, NotFound, ServerError
from brink.server.states import CampaignStatus, JobStatus
from brink.sim.episode import EpisodeSpec
from brink.sim.errors import SimulatorError

FORMAT: Final = "brink-campaign"
VERSION: Final = 1
LONGEST_LINE: Final = 16 * 1024 * 1024
LARGEST_BYTES: Final = 64 * 1024**3
"""Maximum size of all members together, unpacked."""
_BATCH: Final = 500
_MANIFEST: Final = "manifest.json"
_LEASE: Final = (
    "lease_token", "lost_token", "lease_worker", "lease_expires_at", "failed_worker", "not_before",
)  # fmt: skip
_TABLES: Final[Mapping[str, type[Base]]] = {
    "campaigns": CampaignRow,
    "campaign_tags": CampaignTagRow,
    "generations": GenerationRow,
    "solutions": SolutionRow,
    "known_solutions": KnownSolutionRow,
    "checkpoints": CheckpointRow,
    "distance_blocks": DistanceBlockRow,
    "jobs": JobRow,
    "violation_names": ViolationNameRow,
    "llm_calls": LlmCallRow,
}
_OPTIONAL: Final = ("campaign_tags", "known_solutions")
"""Tables that a file has only if the campaign has rows there; files of older versions lack them."""
_OPTIONAL_COLUMNS: Final[Mapping[str, Mapping[str, Any]]] = {
    "campaigns": {"notes": ""},
    "jobs": {"losses": 0, "max_losses": DEFAULT_MAX_LOSSES},
}
"""Columns that a file has only if their values are others than these; files of older versions lack them."""
_VECTORS: Final[Mapping[str, str]] = {"solutions": "vectors", "known_solutions": "known-vectors"}
"""Arrays with the vectors of a table's rows."""
_LEFT_OUT: Final[Mapping[str, tuple[str, ...]]] = {
    "campaigns": ("idempotency_key", "turn", "sequence", "search_text"),
    "jobs": ("id", "cache", "interrupted", *_LEASE),
}
"""Columns that are meaningless in another database, or follow from others."""


class BadFile(ServerError):
    """The file was not written by `export_campaign`, or is damaged."""


def export_campaign(connection: Connection, campaign_id: str, file: Path) -> dict[str, int]:
    """Write a campaign to a file; return the number of rows of each table.

    Args:
        connection: Sees one snapshot.
        campaign_id: The campaign.
        file: The file, which appears only when it is complete.

    Raises:
        NotFound: There is no such campaign.
    """
    if CAMPAIGNS.find(connection, campaign_id) is None:
        raise NotFound(f"campaign {campaign_id}: no such campaign")
    part = file.with_name(f"{file.name}.part")
    try:
        with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
            counts = _Export(connection, archive, campaign_id).run()
        part.replace(file)
    finally:
        part.unlink(missing_ok=True)
    return counts


def import_campaign(connection: Connection, file: Path) -> tuple[str, dict[str, int]]:
    """Store the campaign of a file; return its id and the number of rows of each table.

    A campaign that was running is paused.

    Args:
        connection: In a write transaction, which must be rolled back if this raises.
        file: A file written by `export_campaign`.

    Raises:
        BadFile: The file is of another kind, damaged or inconsistent.
        Conflict: A campaign with its id exists.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            return _Import(connection, archive).run()
    except (IntegrityError, DataError) as error:
        words = str(error.orig).strip().splitlines()
        raise BadFile(f"{file}: its data cannot be stored: {words[0] if words else error}") from None
    except FileNotFoundError:
        raise BadFile(f"{file}: no such file") from None
    except (
        zipfile.BadZipFile, zlib.error, EOFError, OSError, KeyError, UnicodeDecodeError, NotImplementedError,
        RuntimeError,  # raised by zipfile for encrypted members
    ) as error:  # fmt: skip
        raise BadFile(f"{file}: expected an undamaged file written by brink export: {error}") from None


class _Export:
    """The export of one campaign."""

    def __init__(self, connection: Connection, archive: zipfile.ZipFile, campaign_id: str) -> None:
        self._connection = connection
        self._archive = archive
        self._id = campaign_id
        self._sums: dict[str, str] = {}

    def run(self) -> dict[str, int]:
        """Write all members; return the number of rows of each table."""
        counts = {
            name: self._write_table(name, model.__table__)
            for name, model in _TABLES.items()
            if name not in _OPTIONAL or self._has_rows(model.__table__)
        }
        counts["traces"] = self._write_traces()
        manifest = {
            "format": FORMAT, "version": VERSION, "brink": __version__, "campaign": self._id,
            "rows": counts, "sha256": self._sums,
        }  # fmt: skip
        self._archive.writestr(_MANIFEST, json.dumps(manifest, indent=1))
        return counts

    def _has_rows(self, table: Any) -> bool:
        query = select(table.c.campaign_id).where(table.c.campaign_id == self._id).limit(1)
        return self._connection.execute(query).first() is not None

    def _write_table(self, name: str, table: Any) -> int:
        """Write the campaign's rows of a table: binary columns as arrays, the others as JSON Lines."""
        columns = [column.name for column in table.columns if column.name not in _LEFT_OUT.get(name, ())]
        optional = _OPTIONAL_COLUMNS.get(name, {})
        own = table.c.id if name == "campaigns" else table.c.campaign_id
        query = select(*(table.c[column] for column in columns)).where(own == self._id)
        query = query.order_by(*(table.c.id,) if name == "jobs" else table.primary_key.columns)
        vectors: list[bytes] = []
        count = 0
        with self._member(f"{name}.jsonl") as member:
            for row in self._rows(query, _BATCH):
                count += 1
                plain = {
                    key: _json(value)
                    for key, value in row.items()
                    if not isinstance(value, bytes) and (key not in optional or value != optional[key])
                }
                member.write(json.dumps(plain, separators=(",", ":"), sort_keys=True).encode() + b"\n")
                if name in _VECTORS:
                    vectors.append(row["vector"])
        if vectors:
            self._write_array(
                _VECTORS[name], np.frombuffer(b"".join(vectors), "<f8").reshape(len(vectors), -1)
            )
        for row in self._rows(query, 1) if name in ("checkpoints", "distance_blocks") else ():
            if name == "checkpoints":
                for column in ("document", "neighbours", "unsafe_neighbours"):
                    self._write_array(f"checkpoint-{column}", np.frombuffer(row[column], np.uint8))
            else:
                block = np.frombuffer(row["data"], "<f4").reshape(row["rows"], row["columns"])
                self._write_array(f"distances-{row['generation']}", block)
        return count

    def _write_traces(self) -> int:
        own = select(JobRow.spec_hash).where(JobRow.campaign_id == self._id)
        count = 0
        for row in self._rows(
            select(TraceRow.spec_hash, TraceRow.data).where(TraceRow.spec_hash.in_(own)), 1
        ):
            self._write_array(f"trace-{row['spec_hash']}", np.frombuffer(row["data"], np.uint8))
            count += 1
        return count

    def _rows(self, query: Any, batch: int) -> Iterator[RowMapping]:
        """Yield rows as they are read: together they may not fit into memory."""
        options = self._connection.execution_options(stream_results=True, yield_per=batch)
        with options.execute(query) as rows:
            yield from rows.mappings()

    def _write_array(self, name: str, array: NDArray[Any]) -> None:
        with self._member(f"arrays/{name}.npy") as member:
            np.lib.format.write_array(member, np.ascontiguousarray(array), allow_pickle=False)

    @contextmanager
    def _member(self, name: str) -> Iterator[Any]:
        """Open a member of the archive for writing, and record its checksum."""
        digest = hashlib.sha256()

        def write(data: bytes) -> None:
            digest.update(data)
            file.write(data)

        with self._archive.open(name, "w", force_zip64=True) as file:
            yield SimpleNamespace(write=write)
        self._sums[name] = digest.hexdigest()


def _json(value: Any) -> Any:
    return value.isoformat() if isinstance(value, datetime) else value


class _Import:
    """The import of one file."""

    def __init__(self, connection: Connection, archive: zipfile.ZipFile) -> None:
        self._connection = connection
        self._archive = archive
        if sum(info.file_size for info in archive.infolist()) > LARGEST_BYTES:
            raise BadFile(
                f"expected a file whose contents are at most {LARGEST_BYTES // 1024**3} GiB when unpacked"
            )
        self._manifest = self._read_manifest()
        self._id = str(self._manifest["campaign"])

    def run(self) -> tuple[str, dict[str, int]]:
        """Store the campaign; return its id and the number of rows of each table.

        Raises:
            BadFile: The file is damaged or inconsistent.
            Conflict: The campaign already exists.
        """
        for name, expected in self._manifest["sha256"].items():
            if self._digest(name) != expected:
                raise BadFile(f"{name}: damaged: it does not match its checksum")
        campaign = self._campaign()
        if CAMPAIGNS.find(self._connection, self._id) is not None:
            raise Conflict(f"campaign {self._id} already exists")
        self._connection.execute(insert(CampaignRow).values(campaign))
        counts = {"campaigns": 1}
        for name, model in _TABLES.items():
            if name != "campaigns" and (name not in _OPTIONAL or f"{name}.jsonl" in self._sums):
                counts[name] = self._insert(name, model)
        counts["traces"] = self._traces()
        return self._id, counts

    def _read_manifest(self) -> dict[str, Any]:
        manifest: Any
        try:
            manifest = json.loads(self._archive.read(_MANIFEST))
        except (KeyError, ValueError):
            raise BadFile("expected a file written by brink export: it has no manifest") from None
        right = isinstance(manifest, dict) and manifest.get("format") == FORMAT
        sums = manifest.get("sha256") if right else None
        if not right or not isinstance(sums, dict) or not isinstance(manifest.get("campaign"), str):
            raise BadFile("expected a file written by brink export: its manifest is from another program")
        if manifest.get("version") != VERSION:
            raise BadFile(f"expected format version {VERSION}, got {manifest.get('version')!r}")
        members = {info.filename for info in self._archive.infolist()} - {_MANIFEST}
        if members != set(sums):
            raise BadFile(
                f"expected exactly the members that the manifest lists; differing: {sorted(members ^ set(sums))[:3]}"
            )
        if not 1 <= len(manifest["campaign"]) <= 16 or not manifest["campaign"].isalnum():
            raise BadFile(f"campaign: expected an id, got {manifest['campaign'][:40]!r}")
        checked: dict[str, Any] = manifest
        return checked

    def _digest(self, name: str) -> str:
        digest = hashlib.sha256()
        with self._archive.open(name) as member:
            while data := member.read(1 << 20):
                digest.update(data)
        return digest.hexdigest()

    def _campaign(self) -> dict[str, Any]:
        rows = list(self._rows("campaigns", CampaignRow.__table__))
        if len(rows) != 1 or rows[0]["id"] != self._id:
            raise BadFile("campaigns.jsonl: expected exactly one campaign, the one in the manifest")
        row = rows[0]
        tags = []
        if "campaign_tags.jsonl" in self._sums:
            tags = [one["tag"] for one in self._rows("campaign_tags", CampaignTagRow.__table__)]
        try:
            body = stored_body(row["document"], tags, row["notes"])
        except ValidationError as error:
            fault = error.errors(include_url=False)[0]
            where = fault["loc"][0] if fault["loc"] and fault["loc"][0] in ("tags", "notes") else "document"
            raise BadFile(f"campaigns.jsonl: {where}: {fault['msg']}") from None
        if body.tags != sorted(tags):
            raise BadFile("campaign_tags.jsonl: expected each tag once, in lower case")
        self._dimension = make_plan(body).problem.space.dimension
        if row["status"] == CampaignStatus.RUNNING:
            row |= {"status": CampaignStatus.PAUSED, "status_reason": "imported; resume it to continue"}
        searched = search_text(row["name"], body.notes, body.tags)
        return {**row, "idempotency_key": None, "turn": 0, "notes": body.notes, "search_text": searched}

    def _insert(self, name: str, model: type[Base]) -> int:
        batch: list[dict[str, Any]] = []
        count = 0
        for row in self._complete(name, model.__table__):
            batch.append(row)
            count += 1
            if len(batch) == _BATCH:
                self._connection.execute(insert(model), batch)
                batch = []
        if batch:
            self._connection.execute(insert(model), batch)
        return count

    def _complete(self, name: str, table: Any) -> Iterable[dict[str, Any]]:
        """Yield a table's rows with their binary columns and the columns that are not exported."""
        vectors, member = np.empty((0, self._dimension)), f"arrays/{_VECTORS.get(name)}.npy"
        if name in _VECTORS and member in self._sums:
            vectors = self._array(_VECTORS[name], "<f8")
            if vectors.ndim != 2 or vectors.shape[1] != self._dimension:
                raise BadFile(f"{member}: expected {self._dimension} numbers in each row")
        for place, row in enumerate(self._rows(name, table)):
            if row["campaign_id"] != self._id:
                raise BadFile(f"{name}.jsonl, line {place + 1}: expected campaign_id {self._id}")
            if name in _VECTORS:
                if place >= len(vectors):
                    raise BadFile(f"{member}: expected one row for each solution")
                row["vector"] = vectors[place].tobytes()
            elif name == "checkpoints":
                for column in ("document", "neighbours", "unsafe_neighbours"):
                    row[column] = self._array(f"checkpoint-{column}", "|u1").tobytes()
            elif name == "distance_blocks":
                array = f"distances-{row['generation']}"
                block = self._array(array, "<f4")
                if block.shape != (row["rows"], row["columns"]):
                    raise BadFile(f"arrays/{array}.npy: expected {row['rows']} x {row['columns']} numbers")
                row["data"] = block.tobytes()
                if hashlib.sha256(row["data"]).hexdigest() != row["sha256"]:
                    raise BadFile(f"arrays/{array}.npy: damaged: it does not match its checksum")
            elif name == "jobs":
                row |= self._job(row, place)
            yield row

    def _job(self, row: Mapping[str, Any], place: int) -> dict[str, Any]:
        """Return the columns of an imported job: it is not leased, and does not share its result."""
        try:
            digest = EpisodeSpec.from_json(json.loads(row["spec"])).digest()
        except (SimulatorError, ValueError, TypeError, KeyError) as error:
            raise BadFile(f"jobs.jsonl, line {place + 1}: spec: {error}") from None
        if digest != row["spec_hash"]:
            raise BadFile(f"jobs.jsonl, line {place + 1}: expected spec_hash to be the hash of spec")
        leased = row["status"] == JobStatus.LEASED
        return dict.fromkeys(_LEASE) | {
            "cache": False,
            "status": JobStatus.QUEUED if leased else row["status"],
            "attempt": row["attempt"] - 1 if leased else row["attempt"],
        }

    def _traces(self) -> int:
        prefix, suffix = "arrays/trace-", ".npy"
        names = [name for name in self._sums if name.startswith(prefix)]
        hashes = [name.removeprefix(prefix).removesuffix(suffix) for name in names]
        known = set(
            self._connection.execute(
                select(TraceRow.spec_hash).where(TraceRow.spec_hash.in_(hashes))
            ).scalars()
        )
        own = set(
            self._connection.execute(select(JobRow.spec_hash).where(JobRow.campaign_id == self._id)).scalars()
        )
        taken = [one for one in hashes if one not in known and one in own]
        now = database_now(self._connection)
        for one in taken:
            data = self._array(f"trace-{one}", "|u1").tobytes()
            self._connection.execute(insert(TraceRow).values(spec_hash=one, data=data, created_at=now))
        return len(taken)

    @property
    def _sums(self) -> dict[str, str]:
        sums: dict[str, str] = self._manifest["sha256"]
        return sums

    def _array(self, name: str, dtype: str) -> NDArray[Any]:
        member = f"arrays/{name}.npy"
        try:
            with self._archive.open(member) as file:
                array = np.lib.format.read_array(io.BytesIO(file.read()), allow_pickle=False)
        except (KeyError, ValueError, OverflowError, MemoryError) as error:
            raise BadFile(f"{member}: expected an array: {error}") from None
        if array.dtype.str != dtype:
            raise BadFile(f"{member}: expected numbers of type {dtype}, got {array.dtype.str}")
        return array

    def _rows(self, name: str, table: Table | Any) -> Iterator[dict[str, Any]]:
        """Yield a table's rows, after checks of their columns and types."""
        left_out, optional = _LEFT_OUT.get(name, ()), _OPTIONAL_COLUMNS.get(name, {})
        columns = {
            column.name: column
            for column in table.columns
            if column.name not in left_out and _type_of(column) is not bytes
        }
        member = f"{name}.jsonl"
        with self._archive.open(member) as file:
            for place, line in enumerate(_lines(file, member), start=1):
                try:
                    values = json.loads(line)
                except ValueError as error:
                    raise BadFile(f"{member}, line {place}: {error}") from None
                if not isinstance(values, dict) or values.keys() | optional.keys() != columns.keys():
                    raise BadFile(f"{member}, line {place}: expected an object with {', '.join(columns)}")
                yield {
                    key: _value(value, columns[key], f"{member}, line {place}")
                    for key, value in {**optional, **values}.items()
                }


def _lines(file: IO[bytes], member: str) -> Iterator[bytes]:
    while line := file.readline(LONGEST_LINE + 1):
        if len(line) > LONGEST_LINE:
            raise BadFile(f"{member}: expected lines of at most {LONGEST_LINE} bytes")
        yield line


def _type_of(column: Any) -> type[Any]:
    if isinstance(column.type, UtcDateTime):
        return datetime
    if isinstance(column.type, JSON):
        return dict
    wanted: type[Any] = column.type.python_type
    return wanted


def _value(value: Any, column: Any, where: str) -> Any:
    """Convert a JSON value to the type of its column; `where` names its line in errors."""
    wanted = _type_of(column)
    if value is None:
        if not column.nullable:
            raise BadFile(f"{where}: {column.name}: expected a {wanted.__name__}, got null")
        return None
    if wanted is datetime:
        try:
            moment = datetime.fromisoformat(value)
        except (TypeError, ValueError):
            moment = None
        if moment is None or moment.tzinfo is None:
            raise BadFile(f"{where}: {column.name}: expected a time with a time zone, got {value!r:.60}")
        return moment
    if wanted is float and type(value) is int:
        value = float(value)
    if not isinstance(value, wanted) or (wanted is int and isinstance(value, bool)):
        raise BadFile(f"{where}: {column.name}: expected a {wanted.__name__}, got {value!r:.60}")
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise BadFile(f"{where}: {column.name}: expected a 64-bit integer")
    if isinstance(value, str) and getattr(column.type, "length", None) and len(value) > column.type.length:
        raise BadFile(f"{where}: {column.name}: expected at most {column.type.length} characters")
    return value
