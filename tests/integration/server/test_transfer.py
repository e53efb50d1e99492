"""A campaign as a file: it comes back as it went; a file that is not what it says changes nothing."""

import hashlib
import io
import json
import os
import tracemalloc
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from shutil import copyfile
from typing import Any

import httpx
import numpy as np
import pytest
from sqlalchemy import func, select
from support.api import FakeWorker, ball, coordinator, eventually, expect, finish, progress, reached, submit
from support.databases import Databases, sqlite_then_postgres
from support.marks import mostly_long
from support.queue import Queue
from support.urban_pairs import SAFE, UNSAFE, judged
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.server.db.engine import open_engines
from brink.server.db.models import CampaignRow, JobRow, SolutionRow
from brink.server.errors import Conflict, ServerError
from brink.server.operations.export_file import BadFile, open_export
from brink.server.problems.urban_injected import SIMULATOR
from brink.sim.episode import EpisodeSpec
from brink.worker.wire import Completed, LeasedJob, WireVerdict

pytestmark = pytest.mark.usefixtures("small_problems")


def run(*arguments: str) -> Any:
    return CliRunner().invoke(app, list(arguments), catch_exceptions=False)


def export(database: str, file: Path) -> tuple[str, str]:
    """Run a campaign and write it to a file; return its id and its digest."""
    engines = open_engines(database)
    with coordinator(database, sweep_s=0.05) as client:
        campaign = submit(client, ball(simulations=60))
        Queue(engines=engines).end_leases(*FakeWorker(client, id="lost").lease(max_jobs=1))
        eventually(lambda: progress(client, campaign)["leased"] == 0, "the lease runs out")
        digest = str(FakeWorker(client).work(campaign)["digest"])
    engines.dispose()
    told = run("export", campaign[:4], "--out", str(file), "--database", database, "--json")
    assert told.exit_code == 0, told.output
    assert json.loads(told.stdout)["rows"]["solutions"] == 70
    return campaign, digest


@pytest.fixture(scope="module")
def elsewhere(sqlite_file: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """One database for all forged files, none of which changes it: each is refused before it is written."""
    return f"sqlite:///{copyfile(sqlite_file, tmp_path_factory.mktemp('elsewhere') / 'brink.db')}"


@pytest.fixture(scope="module")
def exports() -> dict[str, tuple[str, str, bytes]]:
    """What was exported from a database of each kind."""
    return {}


@pytest.fixture
def exported(
    databases: Databases, tmp_path: Path, exports: dict[str, tuple[str, str, bytes]]
) -> tuple[str, str, Path]:
    """A finished campaign: its id, its digest, and the file that it was written to."""
    file = tmp_path / "ball.brink"
    if databases.backend not in exports:
        with databases.database("exporting") as database:
            exports[databases.backend] = (*export(database, file), file.read_bytes())
    campaign, digest, written = exports[databases.backend]
    file.write_bytes(written)
    return campaign, digest, file


@sqlite_then_postgres
def test_import_equals_what_was_exported(
    databases: Databases, exported: tuple[str, str, Path], tmp_path: Path
) -> None:
    campaign, digest, file = exported
    with databases.database("other") as elsewhere:
        told = run("import", str(file), "--database", elsewhere)
        assert told.exit_code == 0, told.output
        with coordinator(elsewhere) as client:
            stands = progress(client, campaign)
            assert (stands["status"], stands["digest"]) == ("finished", digest)
            assert (
                len(expect(client.get(f"/api/v1/campaigns/{campaign}/distances?numbers=0,1,2"))["distances"])
                == 3
            )
        again = tmp_path / "again.brink"
        assert run("export", campaign, "--out", str(again), "--database", elsewhere).exit_code == 0
        assert run("doctor", "--thorough", "--database", elsewhere).exit_code == 0
        assert members(again) == members(file)
        assert members(file)["jobs.jsonl"].count(b'"losses":1') == 1
        with pytest.raises(Conflict, match="already exists"):
            run("import", str(file), "--database", elsewhere)


def members(file: Path) -> dict[str, bytes]:
    """Return all members but the manifest."""
    with zipfile.ZipFile(file) as archive:
        return {name: archive.read(name) for name in archive.namelist() if name != "manifest.json"}


@sqlite_then_postgres
def test_a_campaign_that_runs_goes_on_elsewhere_and_finds_the_same(
    databases: Databases, database_url: str, exported: tuple[str, str, Path], tmp_path: Path
) -> None:
    digest, file = exported[1], tmp_path / "half.brink"
    with coordinator(database_url) as client:
        half = submit(client, ball(simulations=60, execution={"cache": False}))
        worker = FakeWorker(client)
        worker.work(half, until=reached(25))
        worker.lease(max_jobs=2)  # nobody will report them there
        expect(client.post(f"/api/v1/campaigns/{half}/pause"))
    assert run("export", half, "--out", str(file), "--database", database_url).exit_code == 0
    with databases.database("other") as elsewhere:
        assert run("import", str(file), "--database", elsewhere).exit_code == 0
        with coordinator(elsewhere) as client:
            assert progress(client, half)["status"] == "paused"
            expect(client.post(f"/api/v1/campaigns/{half}/resume"))
            assert FakeWorker(client).work(half)["digest"] == digest
            fresh = submit(client, ball(simulations=60))
            assert progress(client, fresh)["simulations"] == 0, "results of files are lent to nobody"


@sqlite_then_postgres
def test_a_warm_campaign_goes_on_elsewhere_without_its_source(
    databases: Databases, database_url: str, tmp_path: Path
) -> None:
    """Exported before its first generation was told, and after it: both find what an undisturbed campaign finds."""
    digests = set()
    for stop in (1, 25, 1000):
        file = tmp_path / f"warm-{stop}.brink"
        with coordinator(database_url) as client:
            source = finish(client, ball(seed=7, algorithm={"id": "random@1"}))
            warm = submit(client, ball(start_from={"campaign": source}, execution={"cache": False}))
            digests.add(FakeWorker(client).work(warm, until=reached(stop))["digest"])
            known = expect(client.get(f"/api/v1/campaigns/{warm}/known"))
            if stop < 1000:
                expect(client.post(f"/api/v1/campaigns/{warm}/pause"))
        assert run("export", warm, "--out", str(file), "--database", database_url).exit_code == 0
        with databases.database(f"other-{stop}") as elsewhere:
            assert run("import", str(file), "--database", elsewhere).exit_code == 0
            with coordinator(elsewhere) as client:
                assert expect(client.get(f"/api/v1/campaigns/{warm}/known")) == known
                if stop < 1000:
                    expect(client.post(f"/api/v1/campaigns/{warm}/resume"))
                digests.add(FakeWorker(client).work(warm)["digest"])
    assert len(digests - {None}) == 1


API = "/api/v1/campaigns"


def urban(client: httpx.Client) -> FakeWorker:
    """Return a worker that can simulate the urban problem."""
    return FakeWorker(client, capabilities=(SIMULATOR,), judge=judged)


def with_follow_ups(client: httpx.Client) -> tuple[str, dict[str, str]]:
    """Run a campaign that holds a pair, and ask everything about it; the last follow-up is half simulated."""
    params = {"solutions": [SAFE, UNSAFE], "seed_numbers": [0, 0]}
    body = {
        "name": "given",
        "problem": {"id": "urban-injected@1"},
        "seed": 4,
        "budget": {"simulations": 2},
        "algorithm": {"id": "repeat@1", "params": params},
    }
    campaign = submit(client, body)
    urban(client).work(campaign)
    asked = {}
    for kind in ("confirm", "component", "minimise"):
        answer = client.post(f"{API}/{campaign}/pairs/follow-ups", json={"kind": kind, "d_th": 0.01})
        asked[kind] = str(expect(answer, 201)["campaign"])
        urban(client).work(asked[kind])
    for name, of, numbers in (("of a follow-up", asked["confirm"], [3]), ("half", campaign, [0, 1])):
        answer = client.post(f"{API}/{of}/repeats", json={"repeats": 12, "numbers": numbers})
        asked[name] = str(expect(answer, 201)["campaign"])
        if name != "half":
            urban(client).work(asked[name])
    worker = urban(client)
    worker.report(worker.lease(max_jobs=5))
    worker.lease(max_jobs=2)  # nobody will report them there
    return campaign, asked


def known_of_pairs(client: httpx.Client, campaign: str, asked: dict[str, str]) -> tuple[Any, ...]:
    """Return what is known of a campaign's pairs and of its repeats."""
    pairs = expect(client.get(f"{API}/{campaign}/pairs", params={"d_th": 0.01}))["pairs"]
    repeats = [expect(client.get(f"{API}/{one}/repeats")) for one in (campaign, asked["confirm"])]
    counts = [[(one["campaign"], one["evaluated"], one["unsafe"]) for one in found] for found in repeats]
    return pairs, counts


@sqlite_then_postgres
def test_follow_ups_go_along_and_go_on_elsewhere(
    databases: Databases, database_url: str, tmp_path: Path
) -> None:
    file, again = tmp_path / "followed.brink", tmp_path / "again.brink"
    with coordinator(database_url) as client:
        campaign, asked = with_follow_ups(client)
        before = known_of_pairs(client, campaign, asked)
    told = run("export", campaign, "--out", str(file), "--database", database_url, "--json")
    rows = json.loads(told.stdout)["rows"]
    assert (rows["campaigns"], rows["follow_ups"]) == (6, 5)
    with databases.database("other") as elsewhere:
        told = run("import", str(file), "--database", elsewhere)
        assert f"its follow-up {asked['half']} is paused; continue it with: " in told.output
        assert told.output.count("is paused") == 1
        assert run("export", campaign, "--out", str(again), "--database", elsewhere).exit_code == 0
        assert members(again).keys() == members(file).keys()
        assert run("doctor", "--thorough", "--database", elsewhere).exit_code == 0
        with coordinator(elsewhere) as client:
            assert known_of_pairs(client, campaign, asked) == before
            expect(client.post(f"{API}/{asked['half']}/resume"))
            urban(client).work(asked["half"])
            half = expect(client.get(f"{API}/{campaign}/repeats"))[-1]
            assert [one["evaluated"] for one in half["solutions"]] == [12, 12]
        with pytest.raises(Conflict, match=f"campaign {campaign} already exists"):
            run("import", str(file), "--database", elsewhere)


@pytest.mark.long("imports forged files")
def test_forged_follow_ups_change_nothing(
    databases: Databases, elsewhere: str, database_url: str, tmp_path: Path
) -> None:
    file = tmp_path / "followed.brink"
    with coordinator(database_url) as client:
        campaign, asked = with_follow_ups(client)
    assert run("export", campaign, "--out", str(file), "--database", database_url).exit_code == 0
    lines = [json.loads(line) for line in members(file)["follow_ups.jsonl"].splitlines()]
    places = {one["campaign_id"]: place for place, one in enumerate(lines)}

    def link(name: str, **changes: Any) -> dict[str, Callable[[bytes], bytes | None]]:
        return {"follow_ups.jsonl": in_line(lambda row: row.update(changes), places[asked[name]])}

    folder = f"follow-ups/{asked['component']}"
    other = "expected kind, selection and numbers as in the campaign in"
    wrong: tuple[tuple[dict[str, Callable[[bytes], bytes | None]], str], ...] = (
        (link("confirm", numbers=[0, 999]), f"campaign {campaign} has no solution 999"),
        (link("confirm", kind="minimise"), f"{other} follow-ups/{asked['confirm']}/"),
        (link("confirm", kind="component"), f"{other} follow-ups/{asked['confirm']}/"),
        (link("confirm", selection="numbers"), f"{other} follow-ups/{asked['confirm']}/"),
        (link("confirm", repeats=0), "repeats: "),
        (link("half", selection="pairs"), f"{other} follow-ups/{asked['half']}/"),
        (link("half", selection="boundary"), "thresholds_of_boundary"),
        (link("minimise", kind="confirm", repeats=2), f"{other} follow-ups/{asked['minimise']}/"),
        (link("minimise", kind="other"), "kind: "),
        (link("component", numbers=[0, 1]), f"{other} follow-ups/{asked['component']}/"),
        (link("component", numbers=["1"]), "numbers.0: "),
        (link("component", t_b=2.0), "t_b: "),
        (link("component", repeats=2), "repeats_confirm"),
        (link("component", of_id="f" * 8), "expected a new follow-up of a campaign before it"),
        (link("component", of_id=asked["component"]), "expected a new follow-up of a campaign before it"),
        (link("component", campaign_id=asked["confirm"]), "expected a new follow-up of a campaign before it"),
        ({"follow_ups.jsonl": lambda _: None}, "expected a line for each folder"),
        ({"follow-ups/ffffffff/jobs.jsonl": lambda _: b""}, "expected a line for each folder"),
        (
            {f"{folder}/campaigns.jsonl": in_line(lambda row: row.update(id=campaign))},
            f"{folder}/campaigns.jsonl: expected exactly one campaign, {asked['component']}",
        ),
        (
            {
                f"{folder}/campaigns.jsonl": in_line(
                    lambda row: (row["document"]["budget"].update(simulations=9), row.update(budget=9))
                )
            },
            f"{folder}/campaigns.jsonl: document: budget: expected 1 simulations",
        ),
        ({f"{folder}/jobs.jsonl": lambda _: None}, "undamaged"),
    )
    for changes, message in wrong:
        with pytest.raises(BadFile) as refused:
            run("import", str(rewritten(file, changes)), "--database", elsewhere)
        assert message in str(refused.value)
        engines = open_engines(elsewhere)
        with engines.reader.connect() as connection:
            assert connection.execute(select(func.count()).select_from(CampaignRow)).scalar_one() == 0
        engines.dispose()


def rewritten(file: Path, changes: dict[str, Callable[[bytes], bytes | None]], *, sums: bool = True) -> Path:
    """Return a copy of a file with some members changed, left out or added, and the manifest made to fit."""
    found = members(file)
    with zipfile.ZipFile(file) as archive:
        manifest = json.loads(archive.read("manifest.json"))
    for name, change in changes.items():
        if name == "manifest.json":
            manifest = json.loads(change(json.dumps(manifest).encode()) or b"")
            continue
        data = change(found.get(name, b""))
        if data is None:
            del found[name]
        else:
            found[name] = data
    if sums:
        manifest["sha256"] = {name: hashlib.sha256(data).hexdigest() for name, data in found.items()}
    other = file.with_name("other.brink")
    with zipfile.ZipFile(other, "w") as archive:
        for name, data in found.items():
            archive.writestr(name, data)
        archive.writestr("manifest.json", json.dumps(manifest))
    return other


def in_line(change: Callable[[dict[str, Any]], object], line: int = 0) -> Callable[[bytes], bytes]:
    def changed(data: bytes) -> bytes:
        lines = data.splitlines()
        row = json.loads(lines[line])
        change(row)
        lines[line] = json.dumps(row).encode()
        return b"\n".join(lines) + b"\n"

    return changed


def array(value: Any, **more: Any) -> Callable[[bytes], bytes]:
    def made(_: bytes) -> bytes:
        file = io.BytesIO()
        np.save(file, value, **more)
        return file.getvalue()

    return made


def huge() -> bytes:
    file = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": (10**15, 2)}
    np.lib.format.write_array_header_1_0(file, header)
    return file.getvalue()


WRONG: dict[str, tuple[dict[str, Callable[[bytes], bytes | None]], str]] = {
    "no manifest": ({"manifest.json": lambda _: b"{}"}, "its manifest is from another program"),
    "a later version": (
        {"manifest.json": lambda data: data.replace(b'"version": 2', b'"version": 3')},
        "expected format version 2, got 3",
    ),
    "a table is missing": ({"jobs.jsonl": lambda _: None}, "undamaged"),
    "no JSON": ({"solutions.jsonl": lambda data: data[:-30]}, "line 70"),
    "a column is missing": (
        {"solutions.jsonl": in_line(lambda row: row.pop("seed"))},
        "expected an object with",
    ),
    "a column too many": (
        {"solutions.jsonl": in_line(lambda row: row.update(x=1))},
        "expected an object with",
    ),
    "text for a number": (
        {"solutions.jsonl": in_line(lambda row: row.update(seed="1"))},
        "line 1: seed: expected a int, got '1'",
    ),
    "a number past 64 bits": ({"solutions.jsonl": in_line(lambda row: row.update(seed=2**70))}, "64-bit"),
    "null": ({"solutions.jsonl": in_line(lambda row: row.update(generation=None))}, "got null"),
    "a long text": (
        {"jobs.jsonl": in_line(lambda row: row.update(needs="x" * 999))},
        "at most 128 characters",
    ),
    "a state that is none": (
        {"jobs.jsonl": in_line(lambda row: row.update(status="gone"))},
        "cannot be stored",
    ),
    "another campaign's row": (
        {"solutions.jsonl": in_line(lambda row: row.update(campaign_id="other"))},
        "expected campaign_id",
    ),
    "a spec with another hash": (
        {"jobs.jsonl": in_line(lambda row: row.update(spec_hash="0" * 64))},
        "expected spec_hash to be the hash of",
    ),
    "a spec that is none": ({"jobs.jsonl": in_line(lambda row: row.update(spec="{}"))}, "line 1: spec"),
    "vectors of another length": (
        {"arrays/vectors.npy": array(np.zeros((70, 3)))},
        "expected 2 numbers in each row",
    ),
    "too few vectors": (
        {"arrays/vectors.npy": array(np.zeros((3, 2)))},
        "expected one row for each solution",
    ),
    "vectors of another type": ({"arrays/vectors.npy": array(np.zeros((70, 2), "f4"))}, "type <f8"),
    "objects": (
        {"arrays/vectors.npy": array(np.array([print], object), allow_pickle=True)},
        "expected an array",
    ),
    "an array that claims to be huge": ({"arrays/vectors.npy": lambda _: huge()}, "expected an array"),
    "distances of another generation": (
        {"arrays/distances-0.npy": array(np.zeros((20, 20), "f4"))},
        "does not match its checksum",
    ),
    "notes that are none": ({"campaigns.jsonl": in_line(lambda row: row.update(notes="a\x1bb"))}, "notes: "),
    "a tag that is none": (
        {"campaign_tags.jsonl": lambda _: b'{"campaign_id": "x", "tag": "two words"}'},
        "tags: ",
    ),
    "a tag in capitals": (
        {"campaign_tags.jsonl": lambda _: b'{"campaign_id": "x", "tag": "Night"}'},
        "in lower case",
    ),
    "a checkpoint of another archive": (
        {"checkpoints.jsonl": in_line(lambda row: row.update(generation=0))},
        "checkpoints.jsonl: neighbours: ",
    ),
    "a damaged checkpoint": (
        {"arrays/checkpoint-document.npy": array(np.zeros(9, "u1"))},
        "checkpoints.jsonl: campaign",
    ),
    "distances of other solutions": (
        {"distance_blocks.jsonl": in_line(lambda row: row.update(first_row=1))},
        "up to the last row",
    ),
    "a solution without its job": (
        {"jobs.jsonl": lambda data: data.split(b"\n", 1)[1]},
        "expected a job for each solution",
    ),
    "a number that JSON cannot carry": (
        {"solutions.jsonl": in_line(lambda row: row.update(number=2**53 + 1))},
        "number: expected at most",
    ),
    "a time limit of ages": (
        {"jobs.jsonl": in_line(lambda row: row.update(timeout_s=1e9))},
        "of at most 604800",
    ),
    "an unknown problem": (
        {"campaigns.jsonl": in_line(lambda row: row["document"]["problem"].update(id="none@1"))},
        "unknown problem",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_forged_file_changes_nothing(elsewhere: str, exported: tuple[str, str, Path], name: str) -> None:
    changes, message = WRONG[name]
    wrong = rewritten(exported[2], changes)
    told = CliRunner().invoke(app, ["import", str(wrong), "--database", elsewhere])
    assert told.exit_code != 0
    assert message in str(told.exception), told.exception
    engines = open_engines(elsewhere)
    with engines.reader.connect() as connection:
        for table in (CampaignRow, SolutionRow, JobRow):
            assert connection.execute(select(func.count()).select_from(table)).scalar_one() == 0
    engines.dispose()


LIKE_THE_API: dict[str, tuple[dict[str, Callable[[bytes], bytes | None]], str]] = {
    "a number without end": (
        {"solutions.jsonl": lambda data: data.replace(b'"seed":', b'"robustness":1e400,"seed":', 1)},
        "expected finite numbers, got 1e400",
    ),
    "NaN": (
        {"generations.jsonl": in_line(lambda row: row.update(best_fitness=float("nan")))},
        "expected finite numbers",
    ),
    "a key twice": (
        {"solutions.jsonl": lambda data: data.replace(b'"seed":', b'"seed":1,"seed":', 1)},
        "expected each key once",
    ),
    "an integer without end": (
        {"solutions.jsonl": in_line(lambda row: row.update(robustness=10**4000))},
        "line 1: robustness: ",
    ),
    "a number beyond the limits": (
        {"solutions.jsonl": in_line(lambda row: row.update(robustness=-1e308))},
        "at most 1e+100",
    ),
    "a violation beyond the limits": (
        {"jobs.jsonl": in_line(lambda row: row.update(result=row["result"].replace("null", "1e308", 1)))},
        "violated_at_s",
    ),
    "deep nesting": ({"solutions.jsonl": lambda data: b"[" * 500_000 + b"\n" + data}, "nested too deeply"),
    "many values": (
        {"solutions.jsonl": lambda data: b"[" + b"[]," * 2_000_000 + b"\n" + data},
        "1000000 values",
    ),
    "a lone surrogate": (
        {"solutions.jsonl": in_line(lambda row: row.update(failure="\ud800"))},
        "lone surrogates",
    ),
    "NUL": ({"jobs.jsonl": in_line(lambda row: row.update(last_error="a\0b"))}, "without NUL characters"),
    "escape sequences in a name": (
        {"campaigns.jsonl": in_line(lambda row: row.update(name="\x1b[2J"))},
        "name: expected text without control",
    ),
    "a name that is not the campaign's": (
        {"campaigns.jsonl": in_line(lambda row: row.update(name="another"))},
        "name: expected 'ball' as in document",
    ),
    "a priority out of range": (
        {"campaigns.jsonl": in_line(lambda row: row.update(priority=10**6))},
        "priority: expected 0 as in document",
    ),
    "a negative number": (
        {"solutions.jsonl": in_line(lambda row: row.update(number=-1))},
        "expected a number >= 0",
    ),
    "a number past 32 bits": (
        {"solutions.jsonl": in_line(lambda row: row.update(generation=2**40))},
        "32-bit",
    ),
    "a time out of range": (
        {"campaigns.jsonl": in_line(lambda row: row.update(created_at="0001-01-01T00:00:00+23:59"))},
        "created_at",
    ),
    "ended without a time": (
        {"campaigns.jsonl": in_line(lambda row: row.update(finished_at=None))},
        "finished_at",
    ),
    "counts of other solutions": (
        {"campaigns.jsonl": in_line(lambda row: row.update(unsafe=row["unsafe"] + 1))},
        "solutions unsafe, but",
    ),
    "no time limit": ({"jobs.jsonl": in_line(lambda row: row.update(timeout_s=0))}, "expected a number > 0"),
    "a result that is none": (
        {"jobs.jsonl": in_line(lambda row: row.update(result="{}"))},
        "result: verdicts",
    ),
    "a result without end": (
        {"jobs.jsonl": in_line(lambda row: row.update(result=row["result"].replace("{", '{"a":1e999,', 1)))},
        "result: ",
    ),
    "another simulator": (
        {"jobs.jsonl": in_line(lambda row: row.update(needs="gymnasium@1"))},
        "needs: expected",
    ),
    "a hash that is none": (
        {"campaigns.jsonl": in_line(lambda row: row.update(document_hash="x"))},
        "document_hash: expected a SHA-256",
    ),
    "vectors that are not finite": (
        {"arrays/vectors.npy": array(np.full((70, 2), np.nan))},
        "expected finite",
    ),
    "too many vectors": ({"arrays/vectors.npy": array(np.zeros((71, 2)))}, "expected 70 rows"),
    "a header of gigabytes": (
        {"arrays/vectors.npy": lambda _: b"\x93NUMPY\x02\x00" + b"\xff" * 4 + b" " * 1000},
        "array of format 1.0",
    ),
}
"""What the API would refuse, too."""


@sqlite_then_postgres
def test_what_the_api_would_refuse_is_refused_in_a_file(
    exported: tuple[str, str, Path], tmp_path: Path
) -> None:
    database = f"sqlite:///{tmp_path}/new.db"
    for name, (changes, message) in LIKE_THE_API.items():
        with pytest.raises(BadFile) as refused:
            run("import", str(rewritten(exported[2], changes)), "--database", database)
        assert message in str(refused.value), name
    engines = open_engines(database)
    with engines.reader.connect() as connection:
        for table in (CampaignRow, SolutionRow, JobRow):
            assert connection.execute(select(func.count()).select_from(table)).scalar_one() == 0
    engines.dispose()


def packed(
    file: Path, members: Mapping[str, bytes], method: int = zipfile.ZIP_DEFLATED, **manifest: Any
) -> Path:
    """Write a file with some members and a manifest that fits."""
    sums = {name: hashlib.sha256(data).hexdigest() for name, data in members.items()}
    document = {"format": "brink-campaign", "version": 2, "campaign": "0badf11e", "sha256": sums, **manifest}
    with zipfile.ZipFile(file, "w", method) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
        archive.writestr("manifest.json", json.dumps(document))
    return file


MIB = 1024**2


def long_manifest(file: Path) -> None:
    packed(file, {}, rows={"solutions": " " * 100 * MIB})


def zeros(file: Path) -> None:
    packed(file, {"arrays/vectors.npy": array(np.zeros(100 * MIB, "|u1"))(b"")})


def understated(file: Path) -> None:
    """A member that says that it is small, and unpacks to much more."""
    packed(file, {"jobs.jsonl": b" " * 100 * MIB})
    data, size = file.read_bytes(), (100 * MIB).to_bytes(4, "little")
    assert data.count(size) == 2
    file.write_bytes(data.replace(size, (1000).to_bytes(4, "little")))


def bzip2(file: Path) -> None:
    packed(file, {"jobs.jsonl": b" " * 100 * MIB}, zipfile.ZIP_BZIP2)


def many_members(file: Path) -> None:
    packed(file, {f"{number:0200}": b"" for number in range(40_000)}, zipfile.ZIP_STORED)


def long_line(file: Path) -> None:
    packed(file, {"campaigns.jsonl": b" " * 80 * MIB + bytes(np.random.default_rng(1).bytes(MIB))})


def twice(file: Path) -> None:
    packed(file, {"jobs.jsonl": b""})
    with zipfile.ZipFile(file, "a") as archive, pytest.warns(UserWarning, match="Duplicate name"):
        archive.writestr("jobs.jsonl", b"")


def pipe(file: Path) -> None:
    os.mkfifo(file)


def folder(file: Path) -> None:
    file.mkdir()


BOMBS: dict[Callable[[Path], None], str] = {
    long_manifest: "when unpacked",
    zeros: "when unpacked",
    understated: "undamaged|does not match its checksum",
    bzip2: "stored or deflated",
    many_members: "list of members",
    long_line: "expected lines of at most",
    twice: "each member once",
    pipe: "expected a regular file",
    folder: "expected a regular file",
}


def read_whole(file: Path) -> None:
    with open_export(file) as export:
        for member in export.members:
            assert list(export.documents(member)) is not None


@pytest.mark.parametrize(
    "bomb",
    mostly_long(BOMBS, [understated, twice, pipe, folder], "unpacks much"),
    ids=lambda bomb: bomb.__name__,
)
def test_a_file_that_unpacks_to_much_more_is_refused_before_it_does(
    bomb: Callable[[Path], None], tmp_path: Path
) -> None:
    """Most would take 100 MiB or more, or never end."""
    file, database = tmp_path / "bomb.brink", tmp_path / "new.db"
    bomb(file)
    tracemalloc.start()
    try:
        with pytest.raises(BadFile, match=BOMBS[bomb]):
            read_whole(file)
        assert tracemalloc.get_traced_memory()[1] < 60 * MIB
    finally:
        tracemalloc.stop()
    with pytest.raises(BadFile, match=BOMBS[bomb]):
        run("import", str(file), "--database", f"sqlite:///{database}")
    assert not database.exists() or bomb is long_line, "nothing is created for a file that is none"


def test_an_imported_campaign_that_may_run_is_checked_like_a_new_one(
    databases: Databases, elsewhere: str, database_url: str, tmp_path: Path
) -> None:
    file = tmp_path / "half.brink"
    with coordinator(database_url) as client:
        half = submit(client, ball(simulations=60, execution={"cache": False}))
        FakeWorker(client).work(half, until=reached(25))
        expect(client.post(f"/api/v1/campaigns/{half}/pause"))
    assert run("export", half, "--out", str(file), "--database", database_url).exit_code == 0
    states = [json.loads(line)["status"] for line in members(file)["jobs.jsonl"].splitlines()]
    model = {"endpoint": "https://evil.example/v1", "model": "m", "api_key_env": "AWS_SECRET_ACCESS_KEY"}

    def another(row: dict[str, Any]) -> None:
        spec = {**json.loads(row["spec"]), "seed": 7}
        text = EpisodeSpec.from_json(spec).canonical_json()
        row.update(spec=text, spec_hash=hashlib.sha256(text.encode()).hexdigest())

    wrong: tuple[tuple[dict[str, Callable[[bytes], bytes | None]], str], ...] = (
        (
            {"campaigns.jsonl": in_line(lambda row: row["document"].update(llm=model))},
            "llm.endpoint: this coordinator may use models on its own machine, without a key",
        ),
        (
            {
                "campaigns.jsonl": in_line(
                    lambda row: row["document"].update(llm={**model, "endpoint": "http://[::1]"})
                )
            },
            "llm.api_key_env: this coordinator may not send the key in AWS_SECRET_ACCESS_KEY",
        ),
        (
            {"jobs.jsonl": in_line(another, states.index("queued"))},
            "expected the simulation that ball@1 asks for",
        ),
        ({"arrays/vectors.npy": array(np.full((len(states), 2), 99.0))}, "within the search space"),
    )
    for changes, message in wrong:
        with pytest.raises(BadFile) as refused:
            run("import", str(rewritten(file, changes)), "--database", elsewhere)
        assert message in str(refused.value)
    engines = open_engines(elsewhere)
    with engines.reader.connect() as connection:
        assert connection.execute(select(func.count()).select_from(CampaignRow)).scalar_one() == 0
    engines.dispose()


def _holds_all(job: LeasedJob) -> Completed:
    verdict = WireVerdict(robustness=0.5, unit="m", violated_at_s=None)
    return Completed(verdicts=dict.fromkeys(job.spec["requirements"], verdict))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"robustness": 0.4}, "robustness 0.4, but its result says 0.5"),
        ({"objectives": {"front-gap@1": 0.4}}, "its objectives differ from those of its result"),
    ],
)
def test_a_verdict_that_its_result_does_not_give_is_refused(
    elsewhere: str, database_url: str, tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    file = tmp_path / "drives.brink"
    body = ball(
        simulations=4,
        problem={"id": "urban-injected@1", "params": {"requirement": "front-gap@1"}},
        algorithm={"id": "random@1", "params": {"generation_size": 4}},
        execution={"keep_traces": 0},
    )
    with coordinator(database_url) as client:
        campaign = submit(client, body)
        worker = FakeWorker(client, capabilities=("brink-drive@3",), judge=_holds_all)
        assert worker.work(campaign)["status"] == "finished"
    assert run("export", campaign, "--out", str(file), "--database", database_url).exit_code == 0
    forged = rewritten(file, {"solutions.jsonl": in_line(lambda row: row.update(changes))})
    with pytest.raises(BadFile, match=message):
        run("import", str(forged), "--database", elsewhere)
    assert run("import", str(file), "--database", elsewhere).exit_code == 0


@sqlite_then_postgres
def test_damage_is_noticed(exported: tuple[str, str, Path], tmp_path: Path) -> None:
    changed = rewritten(
        exported[2], {"solutions.jsonl": lambda data: data.replace(b"safe", b"sage")}, sums=False
    )
    with pytest.raises(BadFile, match=r"solutions\.jsonl: damaged"):
        run("import", str(changed), "--database", f"sqlite:///{tmp_path}/new.db")
    (tmp_path / "short.brink").write_bytes(exported[2].read_bytes()[:900])
    for other, words in (
        ("short.brink", "expected an undamaged file written by brink export"),
        ("none.brink", "no such file"),
    ):
        with pytest.raises(BadFile, match=words):
            run("import", str(tmp_path / other), "--database", f"sqlite:///{tmp_path}/new.db")


@pytest.mark.parametrize("places", mostly_long([9, 60], [9], "flips many bits"))
def test_a_flipped_bit_is_noticed_or_harmless(
    databases: Databases, exported: tuple[str, str, Path], tmp_path: Path, places: int
) -> None:
    whole = exported[2].read_bytes()
    flipped = tmp_path / "flipped.brink"
    noticed = 0
    for place in range(0, len(whole), len(whole) // places):
        flipped.write_bytes(whole[:place] + bytes([whole[place] ^ 0x10]) + whole[place + 1 :])
        with databases.database(f"{place}") as url:
            try:
                told = run("import", str(flipped), "--database", url)
            except (BadFile, ServerError):
                noticed += 1
            else:
                assert exported[0] in told.output
    assert noticed > places * 2 // 3
