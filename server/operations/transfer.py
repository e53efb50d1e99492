"""Exports a campaign to one file, with everything that belongs to it, and imports it elsewhere.

The file is a zip archive: `manifest.json` with a format version and a checksum of every other member, one member in
JSON Lines for each table (`solutions.jsonl`), and arrays in NumPy's format (`arrays/vectors.npy`), which
``numpy.load`` can read. Nothing in it is ever executed.

Follow-ups, such as repeats, are campaigns as well, and may have follow-ups themselves. The members of each are in a
folder (`follow-ups/3f2a90c1/solutions.jsonl`), and `follow_ups.jsonl` says what each asks. Files of campaigns without
follow-ups have neither.

Imported files are not trusted. `brink.server.operations.export_file` bounds what is read of them. Everything in them
is checked as if it came through the API: types, ranges, text and finite numbers, hashes, the campaign itself, the
language model that it may still use, and the simulations that workers would still be given. A file is stored in one
transaction, and its results are not shared with other campaigns.
"""

import hashlib
import json
import zipfile
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from datetime import datetime
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from sqlalchemy import Connection, RowMapping, Table, insert, select
from sqlalchemy.exc import DataError, IntegrityError

from brink import __version__
from brink.search.errors import ConfigError
from brink.server.campaigns.body import DEFAULT_MAX_LOSSES, MOST_TAGS, search_text
from brink.server.campaigns.follow_ups.follow_up import FollowUp
from brink.server.campaigns.follow_ups.question import question_of
from brink.server.campaigns.follow_ups.store import insert_follow_up
from brink.server.campaigns.plan import Plan, make_plan, restored_archive
from brink.server.campaigns.step_store import read_archive
from brink.server.campaigns.store import CAMPAIGNS, Campaign, stored_body
from brink.server.db.models import (
    Base,
    CampaignRow,
    CampaignTagRow,
    CheckpointRow,
    DistanceBlockRow,
    FollowUpRow,
    GenerationRow,
    JobRow,
    KnownSolutionRow,
    LlmCallRow,
    SolutionRow,
    TraceRow,
    ViolationNameRow,
)
from brink.server.db.sql import allow_pauses, database_now, in_list
from brink.server.errors import Conflict, Damaged, InvalidInput, NotFound
from brink.server.operations.export_file import (
    FORMAT,
    LARGEST_TRACE,
    LINKS,
    MANIFEST,
    VERSION,
    BadFile,
    ExportFile,
    Link,
    plain_json,
    reading,
)
from brink.server.operations.imported_values import imported_value, type_of
from brink.server.operations.verification import count_missing_jobs, verify_counts, verify_results
from brink.server.problems.base import InProcessProblem, MeasuresOnData
from brink.server.problems.catalogue import uses_user_code
from brink.server.seeding import Access
from brink.server.states import ENDED, CampaignStatus, JobKind, JobStatus
from brink.sim.episode import EpisodeSpec
from brink.sim.errors import SimulatorError

_BATCH: Final = 500
_BATCH_BYTES: Final = 32 * 1024**2
"""Rows that are inserted together, at most, and the size of their text."""
_FINAL: Final = (JobStatus.DONE, JobStatus.CANCELLED)
"""States of jobs that nobody can lease any more."""
_LEASE: Final = (
    "lease_token",
    "lost_token",
    "lease_worker",
    "lease_expires_at",
    "failed_worker",
    "not_before",
)
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
"""Tables that a file has only if the campaign has rows there."""
_OPTIONAL_COLUMNS: Final[Mapping[str, Mapping[str, Any]]] = {
    "campaigns": {"notes": ""},
    "jobs": {"losses": 0, "max_losses": DEFAULT_MAX_LOSSES},
}
"""Columns that a file has only if their values are others than these."""
_VECTORS: Final[Mapping[str, str]] = {"solutions": "vectors", "known_solutions": "known-vectors"}
"""Arrays with the vectors of a table's rows."""
_LEFT_OUT: Final[Mapping[str, tuple[str, ...]]] = {
    "campaigns": ("idempotency_key", "turn", "sequence", "search_text", "deleted_at"),
    "jobs": ("id", "cache", "interrupted", *_LEASE),
}
"""Columns that are meaningless in another database, or follow from others."""
_KNOWN_TRACES: Final = select(TraceRow.spec_hash).where(in_list(TraceRow.spec_hash, "hashes"))
_OWN_JOBS: Final = select(JobRow.spec_hash).where(in_list(JobRow.spec_hash, "hashes"))


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


def import_campaign(
    connection: Connection, file: ExportFile, access: Access
) -> tuple[tuple[str, ...], dict[str, int]]:
    """Store the campaign of a file and its follow-ups; return their ids, its own first, and the rows of each table.

    Those that were running are paused.

    Args:
        connection: In a write transaction, which must be rolled back if this raises.
        file: A file written by `export_campaign`.
        access: What campaigns may call.

    Raises:
        BadFile: The file is of another kind, damaged or inconsistent.
        Conflict: A campaign with one of these ids exists.
        InvalidInput: The problem or the algorithm of a campaign is unknown here, or its parameters are invalid.
    """
    allow_pauses(connection)
    with reading(file.path):
        try:
            return _import(connection, file, access)
        except (IntegrityError, DataError) as error:
            words = str(error.orig).strip().splitlines()
            raise BadFile(f"its data cannot be stored: {words[0] if words else error}") from None


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
            "format": FORMAT,
            "version": VERSION,
            "brink": __version__,
            "campaign": campaign_id,
            "rows": rows,
            "sha256": self.sums,
        }
        self._archive.writestr(MANIFEST, json.dumps(manifest, indent=1))


def _export(connection: Connection, members: _Members, campaign_id: str) -> dict[str, int]:
    """Write a campaign and its follow-ups; return the number of rows of each table."""
    counts = Counter(_Export(connection, members, campaign_id).run())
    links = _links(connection, campaign_id)
    for link in links:
        counts.update(_Export(connection, members, link.campaign_id, link.folder).run())
    if links:
        counts["follow_ups"] = len(links)
        with members.member(LINKS) as member:
            for link in links:
                member.write(link.model_dump_json().encode() + b"\n")
    members.write_manifest(campaign_id, counts)
    return counts


def _links(connection: Connection, campaign_id: str) -> list[Link]:
    """Return the follow-ups of a campaign and their own, each after the campaign it is about."""
    found, waiting = list[Link](), [campaign_id]
    while waiting:
        own = FollowUpRow.of_id == waiting.pop(0)
        query = select(FollowUpRow.__table__).where(own).order_by(FollowUpRow.campaign_id)
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


def _import(
    connection: Connection, file: ExportFile, access: Access
) -> tuple[tuple[str, ...], dict[str, int]]:
    """Store the campaign of a file and its follow-ups; return their ids, and the number of rows of each table."""
    links = file.links()
    counts = Counter(_Import(connection, file, access, file.campaign).run())
    for place, link in enumerate(links, start=1):
        one = _Import(connection, file, access, link.campaign_id, link.folder)
        counts.update(one.run())
        asks = link.asks()
        _check_follow_up(connection, one.plan, link.folder, asks, f"{LINKS}, line {place}")
        insert_follow_up(connection, link.campaign_id, asks)
    if links:
        counts["follow_ups"] = len(links)
    return (file.campaign, *(link.campaign_id for link in links)), counts


def _check_follow_up(connection: Connection, plan: Plan, folder: str, asks: FollowUp, where: str) -> None:
    """Check that an imported campaign can be the follow-up that the file says it is.

    Args:
        connection: Where its campaign is stored.
        plan: Plan of the imported campaign.
        folder: Where the file has it, for errors.
        asks: What it asks.
        where: The line of the file that says so, for errors.

    Raises:
        BadFile: It is none, or asks about other solutions.
    """
    try:
        plan.algorithm.check(plan.problem.space, plan.config, budget=plan.body.budget.simulations)
    except ConfigError as error:
        raise BadFile(f"{folder}campaigns.jsonl: document: {error}") from None
    if not question_of(asks.kind).fits(plan, asks):
        raise BadFile(f"{where}: expected kind, selection and numbers as in the campaign in {folder}")
    status = select(CampaignRow.status).where(CampaignRow.id == asks.of_id)
    if connection.execute(status).scalar_one() not in ENDED:
        raise BadFile(f"{where}: of_id: expected a campaign that has ended, since it has follow-ups")
    numbers = set(asks.numbers)
    known = select(SolutionRow.number).where(
        SolutionRow.campaign_id == asks.of_id, SolutionRow.number.in_(numbers)
    )
    if unknown := numbers - set(connection.execute(known).scalars()):
        raise BadFile(f"{where}: numbers: campaign {asks.of_id} has no solution {min(unknown)}")


class _Import:
    """The import of one campaign, from a folder of a file; empty for the campaign of the file itself.

    Attributes:
        plan: The plan of the campaign, once it is stored.
    """

    plan: Plan
    _is_open: bool
    """Whether the campaign may still run."""

    def __init__(
        self, connection: Connection, file: ExportFile, access: Access, campaign_id: str, folder: str = ""
    ) -> None:
        self._connection = connection
        self._file = file
        self._access = access
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
        self._verify(CAMPAIGNS.get(self._connection, self._id))
        return counts

    def _verify(self, stored: Campaign) -> None:
        """Verify the stored campaign as `brink doctor` would, and as its first reader will.

        Results are not evaluated by a plug-in's code, which may take long, and which may have changed.

        Raises:
            BadFile: What it consists of does not fit together.
        """
        if (wrong := verify_counts(self._connection, stored)) is not None:
            raise BadFile(f"{self._folder}campaigns.jsonl: {wrong}")
        for _, count, first in count_missing_jobs(self._connection, self._id):
            raise BadFile(
                f"{self._folder}jobs.jsonl: expected a job for each solution with spec_hash, but {count} have none, "
                f"such as solution {first}"
            )
        try:
            restored_archive(
                self.plan, read_archive(self._connection, self._id, self.plan.problem.space.dimension)
            )
        except (Damaged, ValueError) as error:
            raise BadFile(f"{self._folder}checkpoints.jsonl: {error}") from None
        if not uses_user_code(self.plan.body.problem.id, self.plan.body.algorithm.id):
            done = verify_results(self._connection, stored, None)
            if done.damaged:
                raise BadFile(f"{self._folder}solutions.jsonl: {done}")

    def _has(self, name: str) -> bool:
        return f"{self._folder}{name}" in self._file.members

    def _campaign(self) -> dict[str, Any]:
        rows = list(islice(self._rows("campaigns", CampaignRow.__table__), 2))
        if len(rows) != 1 or rows[0]["id"] != self._id:
            raise BadFile(f"{self._folder}campaigns.jsonl: expected exactly one campaign, {self._id}")
        row = rows[0]
        tags = []
        if self._has("campaign_tags.jsonl"):
            tagged = islice(self._rows("campaign_tags", CampaignTagRow.__table__), MOST_TAGS + 1)
            tags = [one["tag"] for one in tagged]
        try:
            body = stored_body(row["document"], tags, row["notes"])
        except ValidationError as error:
            fault = error.errors(include_url=False)[0]
            where = fault["loc"][0] if fault["loc"] and fault["loc"][0] in ("tags", "notes") else "document"
            raise BadFile(f"{self._folder}campaigns.jsonl: {where}: {fault['msg']}") from None
        if body.tags != sorted(tags):
            raise BadFile(f"{self._folder}campaign_tags.jsonl: expected each tag once, in lower case")
        self.plan = make_plan(body)
        self._is_open = row["status"] not in ENDED
        self._check_campaign(row, f"{self._folder}campaigns.jsonl")
        if row["status"] == CampaignStatus.RUNNING:
            row |= {"status": CampaignStatus.PAUSED, "status_reason": "imported; resume it to continue"}
        searched = search_text(row["name"], body.notes, body.tags)
        return {**row, "idempotency_key": None, "turn": 0, "notes": body.notes, "search_text": searched}

    def _check_campaign(self, row: Mapping[str, Any], where: str) -> None:
        """Check that a campaign's row agrees with its document, and that the campaign could be submitted if it runs.

        Raises:
            BadFile: It does not, or could not.
        """
        body = self.plan.body
        derived = {
            "name": body.name,
            "seed": body.seed,
            "priority": body.priority,
            "budget": body.budget.simulations,
        }
        for name, expected in derived.items():
            if row[name] != expected:
                raise BadFile(
                    f"{where}: {name}: expected {expected!r:.60} as in document, got {row[name]!r:.60}"
                )
        if (row["finished_at"] is None) != self._is_open:
            raise BadFile(f"{where}: finished_at: expected a time if and only if the campaign has ended")
        if not self._is_open:  # what may no longer run is only shown, as after an upgrade
            return
        try:
            self._access.check(body.llm)
            self.plan.algorithm.check(
                self.plan.problem.space, self.plan.config, budget=body.budget.simulations
            )
        except (ConfigError, InvalidInput) as error:
            raise BadFile(f"{where}: document: {error}") from None

    def _insert(self, name: str, model: type[Base]) -> int:
        batch: list[dict[str, Any]] = []
        count = size = 0
        for row in self._complete(name, model.__table__):
            batch.append(row)
            count += 1
            size += sum(len(value) for value in row.values() if isinstance(value, str | bytes))
            if len(batch) == _BATCH or size > _BATCH_BYTES:
                self._connection.execute(insert(model), batch)
                batch, size = [], 0
        if batch:
            self._connection.execute(insert(model), batch)
        return count

    def _complete(self, name: str, table: Any) -> Iterable[dict[str, Any]]:
        """Yield a table's rows with their binary columns and the columns that are not exported."""
        space, member = self.plan.problem.space, f"{self._folder}arrays/{_VECTORS.get(name)}.npy"
        vectors = self._file.rows(member, space.dimension) if name in _VECTORS else iter(())
        place = 0
        for place, row in enumerate(self._rows(name, table), start=1):
            where = f"{self._folder}{name}.jsonl, line {place}"
            if row["campaign_id"] != self._id:
                raise BadFile(f"{where}: expected campaign_id {self._id}")
            if name in _VECTORS:
                row["vector"] = next(vectors, None)
                if row["vector"] is None:
                    raise BadFile(f"{member}: expected one row for each solution")
                if self._is_open and not space.contains(space.split(np.frombuffer(row["vector"], "<f8"))):
                    raise BadFile(f"{where}: expected a solution within the search space")
            elif name == "checkpoints":
                for column in ("document", "neighbours", "unsafe_neighbours"):
                    row[column] = self._file.array(self._array(f"checkpoint-{column}"), "|u1").tobytes()
            elif name == "distance_blocks":
                row["data"] = self._block(row)
            elif name == "jobs":
                row |= self._job(row, where)
            yield row
        if next(vectors, None) is not None:
            raise BadFile(f"{member}: expected {place} rows, one for each solution")

    def _array(self, name: str) -> str:
        return f"{self._folder}arrays/{name}.npy"

    def _block(self, row: Mapping[str, Any]) -> bytes:
        """Return the distances of a generation."""
        member = self._array(f"distances-{row['generation']}")
        block = self._file.array(member, "<f4")
        if block.shape != (row["rows"], row["columns"]):
            raise BadFile(f"{member}: expected {row['rows']} x {row['columns']} numbers")
        if row["columns"] != row["first_row"] + row["rows"]:
            raise BadFile(f"{member}: expected one column for each solution up to the last row")
        data = block.tobytes()
        if hashlib.sha256(data).hexdigest() != row["sha256"]:
            raise BadFile(f"{member}: damaged: it does not match its checksum")
        return data

    def _job(self, row: Mapping[str, Any], where: str) -> dict[str, Any]:
        """Return the columns of an imported job: it is not leased, and does not share its result."""
        try:
            spec = EpisodeSpec.from_json(plain_json(row["spec"].encode()))
        except (SimulatorError, ValueError, TypeError, KeyError) as error:
            raise BadFile(f"{where}: spec: {error}") from None
        if spec.canonical_json() != row["spec"] or spec.digest() != row["spec_hash"]:
            raise BadFile(f"{where}: expected spec_hash to be the hash of spec")
        self._check_simulation(row, spec, where)
        leased = row["status"] == JobStatus.LEASED
        return dict.fromkeys(_LEASE) | {
            "cache": False,
            "status": JobStatus.QUEUED if leased else row["status"],
            "attempt": row["attempt"] - 1 if leased else row["attempt"],
        }

    def _check_simulation(self, row: Mapping[str, Any], spec: EpisodeSpec, where: str) -> None:
        """Check that a job is one of its problem, and that workers are still given only what the problem asks for.

        Raises:
            BadFile: It is another one.
        """
        problem = self.plan.problem
        if isinstance(problem, InProcessProblem):
            raise BadFile(f"{where}: expected no jobs, since {problem.id} is computed by the coordinator")
        needs = problem.needs
        if row["kind"] == JobKind.DATASET and isinstance(problem, MeasuresOnData):
            needs = problem.dataset_needs
        is_earlier = row["needs"].partition("@")[0] == needs.partition("@")[0]  # of another version
        if row["needs"] != spec.simulator or not is_earlier:
            raise BadFile(f"{where}: needs: expected {needs}, which simulates {problem.id}")
        if row["status"] in _FINAL or row["needs"] != needs:
            return
        query = select(SolutionRow.vector, SolutionRow.seed).where(
            SolutionRow.campaign_id == self._id, SolutionRow.number == row["number"]
        )
        if (solution := self._connection.execute(query).one_or_none()) is None:
            raise BadFile(f"{where}: number: expected that of a solution")
        vectors = problem.space.split(np.frombuffer(solution.vector, "<f8"))
        if row["kind"] == JobKind.DATASET and isinstance(problem, MeasuresOnData):
            asked = problem.dataset_evaluation(vectors)
        else:
            asked = problem.episode(vectors, solution.seed)
        # Of which code: workers compare that with theirs, and the first step with that of the campaign.
        if replace(asked, sources=spec.sources).canonical_json() != row["spec"]:
            raise BadFile(f"{where}: spec: expected the simulation that {problem.id} asks for")

    def _traces(self) -> int:
        prefix, suffix = f"{self._folder}arrays/trace-", ".npy"
        names = [name for name in self._file.members if name.startswith(prefix)]
        hashes = [name.removeprefix(prefix).removesuffix(suffix) for name in names]
        there = {"hashes": hashes}
        known = set(self._connection.execute(_KNOWN_TRACES, there).scalars())
        own = set(self._connection.execute(_OWN_JOBS.where(JobRow.campaign_id == self._id), there).scalars())
        taken = [one for one in hashes if one not in known and one in own]
        now = database_now(self._connection)
        for one in taken:
            data = self._file.array(self._array(f"trace-{one}"), "|u1", LARGEST_TRACE).tobytes()
            self._connection.execute(insert(TraceRow).values(spec_hash=one, data=data, created_at=now))
        return len(taken)

    def _rows(self, name: str, table: Table | Any) -> Iterator[dict[str, Any]]:
        """Yield a table's rows, after checks of their columns and types."""
        left_out, optional = _LEFT_OUT.get(name, ()), _OPTIONAL_COLUMNS.get(name, {})
        columns = {
            column.name: column
            for column in table.columns
            if column.name not in left_out and type_of(column) is not bytes
        }
        member = f"{self._folder}{name}.jsonl"
        for place, values in self._file.documents(member):
            if not isinstance(values, dict) or values.keys() | optional.keys() != columns.keys():
                raise BadFile(f"{member}, line {place}: expected an object with {', '.join(columns)}")
            yield {
                key: imported_value(value, columns[key], f"{member}, line {place}")
                for key, value in {**optional, **values}.items()
            }
