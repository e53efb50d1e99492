"""The scripts of the scheduled backup and of the restoring job, run on a real Postgres."""

import os
import re
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from support.api import FakeWorker, ball, coordinator, expect, submit, undisturbed_digest
from support.databases import Databases, on_postgres
from support.manifests import pod_specs
from support.processes import TOY, brink

from benchmarks.servers import find_binaries

BACKUP, RESTORE = pod_specs()["CronJob brink-backup"], pod_specs()["Job brink-restore-"]

pytestmark = [pytest.mark.long("needs Postgres"), on_postgres]


def container(pod: Mapping[str, Any], name: str) -> dict[str, Any]:
    [one] = [c for c in (*pod.get("initContainers", ()), *pod["containers"]) if c["name"] == name]
    found: dict[str, Any] = one
    return found


def run(
    pod: Mapping[str, Any], name: str, folder: Path, **variables: str
) -> subprocess.CompletedProcess[str]:
    """Run the script of a container, with a folder in place of the volume of backups."""
    one = container(pod, name)
    [script] = one["args"]
    assert set(variables) == {variable["name"] for variable in one.get("env", ())}
    assert [mount["mountPath"] for mount in one["volumeMounts"]] == ["/backups"]
    path = os.pathsep.join((str(find_binaries()), os.environ["PATH"]))
    return subprocess.run(
        [*one["command"], script.replace("/backups", str(folder))],
        env={"PATH": path, **variables},
        capture_output=True,
        text=True,
        check=False,
    )


def dump(database: str, folder: Path) -> Path:
    done = run(BACKUP, "dump", folder, BRINK_DATABASE=database)
    assert done.returncode == 0, done.stderr
    newest = max(folder.glob("brink-*.dump"))
    assert re.fullmatch(r"brink-\d{8}T\d{6}Z\.dump", newest.name)
    return newest


def test_a_campaign_continues_from_a_backup(
    databases: Databases, tmp_path: Path, small_problems: None
) -> None:
    body = ball()
    with databases.database() as database, databases.database(migrated=False) as restored:
        with coordinator(database) as client:
            campaign = submit(client, body)
            FakeWorker(client).work(campaign, until=lambda found: found["simulations"] >= 20)
            dump(database, tmp_path)
            FakeWorker(client).work(campaign, until=lambda found: found["simulations"] >= 40)

        done = run(RESTORE, "restore", tmp_path, BRINK_DATABASE=restored, FILE="")
        assert done.returncode == 0, done.stderr
        examined = brink(
            *container(BACKUP, "examine")["args"][:-1], f"--database={restored}", cwd=tmp_path, env=TOY
        )
        assert examined.returncode == 0, examined.stdout + examined.stderr
        with coordinator(restored) as client:
            before = expect(client.get(f"/api/v1/campaigns/{campaign}/progress"))
            assert 20 <= before["simulations"] < 40
            done_again = FakeWorker(client).work(campaign)
        assert (done_again["status"], done_again["digest"]) == ("finished", undisturbed_digest(body))


def test_a_backup_that_cannot_be_restored_fails_the_job(databases: Databases, tmp_path: Path) -> None:
    with databases.database() as database, databases.database(migrated=False) as scratch:
        newest = dump(database, tmp_path)
        whole = newest.read_bytes()
        newest.write_bytes(whole[: len(whole) // 2])
        assert run(BACKUP, "restore", tmp_path, SCRATCH=scratch).returncode != 0
    with databases.database(migrated=False) as scratch:
        newest.write_bytes(whole)
        done = run(BACKUP, "restore", tmp_path, SCRATCH=scratch)
        assert done.returncode == 0, done.stderr
        examined = brink("doctor", "--restored", f"--database={scratch}", cwd=tmp_path)
        assert examined.returncode == 0, examined.stdout + examined.stderr


def test_old_backups_are_deleted_once_the_new_one_was_examined(databases: Databases, tmp_path: Path) -> None:
    names = [one["name"] for one in (*BACKUP["initContainers"], *BACKUP["containers"])]
    assert names == ["dump", "server", "restore", "examine", "delete-old"], (
        "each begins if those before succeeded"
    )
    old = tmp_path / "brink-20260101T031700Z.dump"
    old.touch()
    os.utime(old, (0, 0))
    with databases.database() as database, databases.database(migrated=False) as scratch:
        newest = dump(database, tmp_path)
        assert run(BACKUP, "restore", tmp_path, SCRATCH=scratch).returncode == 0
    assert old.exists(), "it may be needed until the new one was examined"
    done = run(BACKUP, "delete-old", tmp_path)
    assert done.returncode == 0, done.stderr
    assert list(tmp_path.glob("brink-*")) == [newest]


def test_a_failed_dump_leaves_no_backup(databases: Databases, tmp_path: Path) -> None:
    with databases.database() as database:
        done = run(BACKUP, "dump", tmp_path, BRINK_DATABASE=f"{database}0")
    assert done.returncode != 0
    assert list(tmp_path.glob("*.dump")) == []


def test_a_backup_is_not_restored_over_data(databases: Databases, tmp_path: Path) -> None:
    with databases.database() as database:
        dump(database, tmp_path)
        done = run(RESTORE, "restore", tmp_path, BRINK_DATABASE=database, FILE="")
        assert done.returncode != 0
        assert "already exists" in done.stderr
