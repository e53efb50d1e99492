"""Exports a campaign to one file, with everything that belongs to it, and imports it elsewhere.

The file is a zip archive: `manifest.json` with a format version and a checksum of every other member, one member in
JSON Lines for each table (`solutions.jsonl`), and arrays in NumPy's format (`arrays/vectors.npy`), which
``numpy.load`` can read. Nothing in it is ever executed.

Follow-ups, such as repeats, are campaigns as well, and may have follow-ups themselves. The members of each are in a
folder (`follow-ups/3f2a90c1/solutions.jsonl`), and `repeats.jsonl` says what each asks. Files of campaigns without
follow-ups have neither.

Imported files are not trusted: types, ranges, checksums and hashes are checked, the file is stored in one
transaction, and its results are not shared with other campaigns.
"""

import hashlib
import io
import json
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Annotated, Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from sqlalchemy import JSON, Connection, RowMapping, Table, insert, select
from sqlalchemy.exc import DataError, IntegrityError

from brink import __version__
from brink.search.errors import ConfigError
from brink.server.campaigns.body import DEFAULT_MAX_LOSSES, search_text, stored_body
from brink.server.campaigns.plan import Plan, make_plan
from brink.server.campaigns.repeats import MOST, is_follow_up
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
    RepeatsRow,
    SolutionRow,
    TraceRow,
    ViolationNameRow,
)
from brink.server.db.sql import allow_pauses, database_now
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
_LINKS: Final = "repeats.jsonl"
_FOLLOW_UPS: Final = "follow-ups/"
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
    "campaigns": ("idempotency_key", "turn", "sequence", "search_text", "deleted_at"),
    "jobs": ("id", "cache", "interrupted", *_LEASE),
}
"""Columns that are meaningless in another database, or follow from others."""


_Id = Annotated[str, Field(pattern=r"^[0-9A-Za-z]{1,16}$")]


class Link(BaseModel):
    """What a follow-up asks, as in the table of repeats."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    campaign_id: _Id
    of_id: _Id
    t_b: Annotated[float, Field(ge=0, le=1)]
    d_th: Annotated[float, Field(ge=0, le=1)]
    repeats: Annotated[int, Field(ge=0, le=10_000)]
    numbers: Annotated[list[Annotated[int, Field(ge=0, lt=2**63)]], Field(min_length=1, max_length=MOST)]

    @property
    def folder(self) -> str:
        """The folder of its members."""
        return f"{_FOLLOW_UPS}{self.campaign_id}/"


class BadFile(ServerError):
    """The file was not written by `export_campaign`, or is damaged."""


def export_campaign(connection: Connection, campaign_id: str, file: Path) -> dict[str, int]:
    """Write a campaign with its follow-ups to a file; return the number of rows of each table.

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
            counts = _export(connection, _Members(archive), campaign_id)
        part.replace(file)
    finally:
        part.unlink(missing_ok=True)
    return counts


def import_campaign(connection: Connection, file: Path) -> tuple[tuple[str, ...], dict[str, int]]:
    """Store the campaign of a file and its follow-ups; return their ids, its own first, and the rows of each table.

    Those that were running are paused.

    Args:
        connection: In a write transaction, which must be rolled back if this raises.
        file: A file written by `export_campaign`.

    Raises:
        BadFile: The file is of another kind, damaged or inconsistent.
        Conflict: A campaign with one of these ids exists.
    """
    allow_pauses(connection)
    try:
        with zipfile.ZipFile(file) as archive:
            return _import(connection, _File(archive))
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


class _Members:
    """The members of a file that is being written.

    Attributes:
        sums: Their checksums.
    """

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive
        self.sums: dict[str, str] = {}

    @contextmanager
    def member(self, name: str) -> Iterator[Any]:
        """Open a member for writing, and record its checksum."""
        digest = hashlib.sha256()

        def write(data: bytes) -> None:
            digest.update(data)
            file.write(data)

        with self._archive.open(name, "w", force_zip64=True) as file:
            yield SimpleNamespace(write=write)
        self.sums[name] = digest.hexdigest()

    def write_manifest(self, campaign_id: str, rows: Mapping[str, int]) -> None:
        """Write the manifest, which completes the file."""
        manifest = {
            "format": FORMAT, "version": VERSION, "brink": __version__, "campaign": campaign_id,
            "rows": rows, "sha256": self.sums,
        }  # fmt: skip
        self._archive.writestr(_MANIFEST, json.dumps(manifest, indent=1))


def _export(connection: Connection, members: _Members, campaign_id: str) -> dict[str, int]:
    """Write a campaign and its follow-ups; return the number of rows of each table."""
    counts = Counter(_Export(connection, members, campaign_id).run())
    links = _links(connection, campaign_id)
    for link in links:
        counts.update(_Export(connection, members, link.campaign_id, link.folder).run())
    if links:
        counts["repeats"] = len(links)
        with members.member(_LINKS) as member:
            for link in links:
                member.write(link.model_dump_json().encode() + b"\n")
    members.write_manifest(campaign_id, counts)
    return counts


def _links(connection: Connection, campaign_id: str) -> list[Link]:
    """Return what the follow-ups of a campaign ask, and their follow-ups, each after the one that it is about."""
    found, waiting = list[Link](), [campaign_id]
    while waiting:
        own = RepeatsRow.of_id == waiting.pop(0)
        query = select(RepeatsRow.__table__).where(own).order_by(RepeatsRow.campaign_id)
        links = [Link.model_validate(dict(row)) for row in connection.execute(query).mappings()]
        found += links
        waiting += [link.campaign_id for link in links]
    return found


class _Export:
    """The export of one campaign, to a folder of a file; empty for the campaign of the file itself."""

    def __init__(self, connection: Connection, members: _Members, campaign_id: str, folder: str = "") -> None:
        self._connection = connection
        self._members = members
        self._id = campaign_id
        self._folder = folder

    def run(self) -> dict[str, int]:
        """Write all members; return the number of rows of each table."""
        counts = {
            name: self._write_table(name, model.__table__)
            for name, model in _TABLES.items()
            if name not in _OPTIONAL or self._has_rows(model.__table__)
        }
        counts["traces"] = self._write_traces()
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
        with self._members.member(f"{self._folder}{name}.jsonl") as member:
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
        with self._members.member(f"{self._folder}arrays/{name}.npy") as member:
            np.lib.format.write_array(member, np.ascontiguousarray(array), allow_pickle=False)


def _json(value: Any) -> Any:
    return value.isoformat() if isinstance(value, datetime) else value


class _File:
    """A file to import, whose members have passed the check of their checksums.

    Attributes:
        campaign: Id of its campaign.
        members: Names of its members, without the manifest.

    Raises:
        BadFile: It is of another kind, too large, or damaged.
    """

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive
        if sum(info.file_size for info in archive.infolist()) > LARGEST_BYTES:
            raise BadFile(
                f"expected a file whose contents are at most {LARGEST_BYTES // 1024**3} GiB when unpacked"
            )
        manifest = self._read_manifest()
        self.campaign: str = manifest["campaign"]
        sums: dict[str, str] = manifest["sha256"]
        self.members: frozenset[str] = frozenset(sums)
        for name, expected in sums.items():
            if self._digest(name) != expected:
                raise BadFile(f"{name}: damaged: it does not match its checksum")

    def open(self, member: str) -> IO[bytes]:
        """Open a member for reading.

        Raises:
            KeyError: There is no such member.
        """
        return self._archive.open(member)

    def documents(self, member: str) -> Iterator[tuple[int, Any]]:
        """Yield the documents of a member in JSON Lines, each with the number of its line, from 1 on.

        Raises:
            BadFile: A line is too long, or is not JSON.
        """
        with self.open(member) as file:
            for place, line in enumerate(_lines(file, member), start=1):
                try:
                    yield place, json.loads(line)
                except ValueError as error:
                    raise BadFile(f"{member}, line {place}: {error}") from None

    def links(self) -> list[Link]:
        """Return what the follow-ups in the file ask.

        Raises:
            BadFile: They do not fit the members of the file.
        """
        found: list[Link] = []
        if _LINKS in self.members:
            for place, document in self.documents(_LINKS):
                try:
                    found.append(Link.model_validate(document))
                except ValidationError as error:
                    fault = error.errors(include_url=False)[0]
                    where = ".".join(str(part) for part in fault["loc"])
                    raise BadFile(f"{_LINKS}, line {place}: {where}: {fault['msg']}") from None
        known = {self.campaign}
        for place, link in enumerate(found, start=1):
            if link.of_id not in known or link.campaign_id in known:
                raise BadFile(f"{_LINKS}, line {place}: expected a new follow-up of a campaign before it")
            known.add(link.campaign_id)
        folders = {
            name.removeprefix(_FOLLOW_UPS).split("/")[0]
            for name in self.members
            if name.startswith(_FOLLOW_UPS)
        }
        if folders != known - {self.campaign}:
            raise BadFile(f"{_LINKS}: expected a line for each folder in {_FOLLOW_UPS}")
        return found

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


def _import(connection: Connection, file: _File) -> tuple[tuple[str, ...], dict[str, int]]:
    """Store the campaign of a file and its follow-ups; return their ids, and the number of rows of each table."""
    links = file.links()
    counts = Counter(_Import(connection, file, file.campaign).run())
    for place, link in enumerate(links, start=1):
        one = _Import(connection, file, link.campaign_id, link.folder)
        counts.update(one.run())
        _check_link(connection, one.plan, link, f"{_LINKS}, line {place}")
        connection.execute(insert(RepeatsRow).values(link.model_dump()))
    if links:
        counts["repeats"] = len(links)
    return (file.campaign, *(link.campaign_id for link in links)), counts


def _check_link(connection: Connection, plan: Plan, link: Link, where: str) -> None:
    """Check that an imported campaign can be the follow-up that a link says it is; `where` names its line in errors.

    Raises:
        BadFile: It is none, or asks about other solutions.
    """
    try:
        plan.algorithm.check(plan.problem.space, plan.config, budget=plan.body.budget.simulations)
    except ConfigError as error:
        raise BadFile(f"{link.folder}campaigns.jsonl: document: {error}") from None
    if not is_follow_up(plan, link.repeats, link.numbers):
        raise BadFile(f"{where}: expected repeats and numbers as in campaign {link.campaign_id}")
    numbers = set(link.numbers)
    known = select(SolutionRow.number).where(
        SolutionRow.campaign_id == link.of_id, SolutionRow.number.in_(numbers)
    )
    if unknown := numbers - set(connection.execute(known).scalars()):
        raise BadFile(f"{where}: numbers: campaign {link.of_id} has no solution {min(unknown)}")


class _Import:
    """The import of one campaign, from a folder of a file; empty for the campaign of the file itself.

    Attributes:
        plan: The plan of the campaign, once it is stored.
    """

    plan: Plan

    def __init__(self, connection: Connection, file: _File, campaign_id: str, folder: str = "") -> None:
        self._connection = connection
        self._file = file
        self._id = campaign_id
        self._folder = folder

    def run(self) -> dict[str, int]:
        """Store the campaign; return the number of rows of each table.

        Raises:
            BadFile: The file is inconsistent.
            Conflict: The campaign already exists.
        """
        campaign = self._campaign()
        same = select(CampaignRow.deleted_at).where(CampaignRow.id == self._id)
        if (known := self._connection.execute(same).one_or_none()) is not None:
            deleted = "was deleted and is still being erased: try again later, while a coordinator runs"
            raise Conflict(f"campaign {self._id} {deleted if known.deleted_at else 'already exists'}")
        self._connection.execute(insert(CampaignRow).values(campaign))
        counts = {"campaigns": 1}
        for name, model in _TABLES.items():
            if name != "campaigns" and (name not in _OPTIONAL or self._has(f"{name}.jsonl")):
                counts[name] = self._insert(name, model)
        counts["traces"] = self._traces()
        return counts

    def _has(self, name: str) -> bool:
        return f"{self._folder}{name}" in self._file.members

    def _campaign(self) -> dict[str, Any]:
        rows = list(self._rows("campaigns", CampaignRow.__table__))
        if len(rows) != 1 or rows[0]["id"] != self._id:
            raise BadFile(f"{self._folder}campaigns.jsonl: expected exactly one campaign, {self._id}")
        row = rows[0]
        tags = []
        if self._has("campaign_tags.jsonl"):
            tags = [one["tag"] for one in self._rows("campaign_tags", CampaignTagRow.__table__)]
        try:
            body = stored_body(row["document"], tags, row["notes"])
        except ValidationError as error:
            fault = error.errors(include_url=False)[0]
            where = fault["loc"][0] if fault["loc"] and fault["loc"][0] in ("tags", "notes") else "document"
            raise BadFile(f"{self._folder}campaigns.jsonl: {where}: {fault['msg']}") from None
        if body.tags != sorted(tags):
            raise BadFile(f"{self._folder}campaign_tags.jsonl: expected each tag once, in lower case")
        self.plan = make_plan(body)
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
        dimension, member = self.plan.problem.space.dimension, f"arrays/{_VECTORS.get(name)}.npy"
        vectors = np.empty((0, dimension))
        if name in _VECTORS and self._has(member):
            vectors = self._array(_VECTORS[name], "<f8")
            if vectors.ndim != 2 or vectors.shape[1] != dimension:
                raise BadFile(f"{self._folder}{member}: expected {dimension} numbers in each row")
        for place, row in enumerate(self._rows(name, table)):
            if row["campaign_id"] != self._id:
                raise BadFile(
                    f"{self._folder}{name}.jsonl, line {place + 1}: expected campaign_id {self._id}"
                )
            if name in _VECTORS:
                if place >= len(vectors):
                    raise BadFile(f"{self._folder}{member}: expected one row for each solution")
                row["vector"] = vectors[place].tobytes()
            elif name == "checkpoints":
                for column in ("document", "neighbours", "unsafe_neighbours"):
                    row[column] = self._array(f"checkpoint-{column}", "|u1").tobytes()
            elif name == "distance_blocks":
                array = f"distances-{row['generation']}"
                block = self._array(array, "<f4")
                if block.shape != (row["rows"], row["columns"]):
                    expected = f"expected {row['rows']} x {row['columns']} numbers"
                    raise BadFile(f"{self._folder}arrays/{array}.npy: {expected}")
                row["data"] = block.tobytes()
                if hashlib.sha256(row["data"]).hexdigest() != row["sha256"]:
                    damaged = "damaged: it does not match its checksum"
                    raise BadFile(f"{self._folder}arrays/{array}.npy: {damaged}")
            elif name == "jobs":
                row |= self._job(row, place)
            yield row

    def _job(self, row: Mapping[str, Any], place: int) -> dict[str, Any]:
        """Return the columns of an imported job: it is not leased, and does not share its result."""
        where = f"{self._folder}jobs.jsonl, line {place + 1}"
        try:
            digest = EpisodeSpec.from_json(json.loads(row["spec"])).digest()
        except (SimulatorError, ValueError, TypeError, KeyError) as error:
            raise BadFile(f"{where}: spec: {error}") from None
        if digest != row["spec_hash"]:
            raise BadFile(f"{where}: expected spec_hash to be the hash of spec")
        leased = row["status"] == JobStatus.LEASED
        return dict.fromkeys(_LEASE) | {
            "cache": False,
            "status": JobStatus.QUEUED if leased else row["status"],
            "attempt": row["attempt"] - 1 if leased else row["attempt"],
        }

    def _traces(self) -> int:
        prefix, suffix = f"{self._folder}arrays/trace-", ".npy"
        names = [name for name in self._file.members if name.startswith(prefix)]
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

    def _array(self, name: str, dtype: str) -> NDArray[Any]:
        member = f"{self._folder}arrays/{name}.npy"
        try:
            with self._file.open(member) as file:
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
        member = f"{self._folder}{name}.jsonl"
        for place, values in self._file.documents(member):
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
