"""The SLURM script, run by bash as SLURM does, against a real coordinator."""

import os
import secrets
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.api import ball, eventually, undisturbed_digest
from support.databases import Databases
from support.processes import BRINK, ROOT, TOY, Program, Site, environment, site

SCRIPT = ROOT / "deploy" / "slurm" / "brink-workers.sbatch"
TASK = {
    "SLURM_JOB_ID": "4712",
    "SLURM_ARRAY_JOB_ID": "4711",
    "SLURM_ARRAY_TASK_ID": "3",
    "SLURM_CPUS_PER_TASK": "1",
}
TOKEN = f"token-{secrets.token_hex(12)}"


@pytest.fixture
def running(databases: Databases, tmp_path: Path) -> Iterator[Site]:
    """A running coordinator that requires a token."""
    settings = {**TOY, "BRINK_SWEEP_S": "0.1", "BRINK_TOKEN": TOKEN}
    with databases.database() as url, site(tmp_path, url, settings) as made:
        yield made


@pytest.fixture
def token_file(tmp_path: Path) -> Path:
    file = tmp_path / "token"
    file.touch(mode=0o600)
    file.write_text(f"{TOKEN}\n")
    return file


def task(running: Site, token_file: Path) -> Program:
    """Start one task of the array."""
    settings = {
        **TOY,
        **TASK,
        "BRINK": BRINK,
        "BRINK_SERVER": running.url,
        "BRINK_TOKEN_FILE": str(token_file),
    }
    program = Program(["bash", str(SCRIPT)], cwd=running.folder, env=settings)
    running.workers.append(program)
    return program


def leased(running: Site) -> list[str]:
    lines = running.get("/metrics").text.splitlines()
    return [line for line in lines if line.startswith("brink_jobs{") and 'status="leased"' in line]


@pytest.mark.long("runs a campaign")
def test_task_runs_a_campaign_and_exits_cleanly(
    running: Site, token_file: Path, small_problems: None
) -> None:
    started = task(running, token_file)
    campaign = running.submit(ball())
    done = running.await_end(campaign)
    assert (done["status"], done["digest"]) == ("finished", undisturbed_digest(ball()))

    long = running.submit(ball(problem={"id": "ball@1", "params": {"slow_s": 1.0}}))
    # Once the first job is done, the second is running for a second; a lease alone would not guarantee that.
    eventually(lambda: running.progress(long)["simulations"] > 0, "the worker has simulated one job")
    before = running.progress(long)["simulations"]
    os.killpg(started.process.pid, signal.SIGTERM)  # like scancel: to every process of the task
    assert started.wait() == 0, started.output
    assert leased(running) == [], "jobs that were not simulated were released"
    assert running.progress(long)["simulations"] > before, "the running job was finished"
    assert "task 3 of job 4711" in started.output
    assert TOKEN not in started.output


@pytest.mark.parametrize(
    ("mode", "words"), [(0o644, "chmod 600"), (0o660, "chmod 600"), (None, "no such file")]
)
def test_a_token_file_that_others_can_read_is_rejected(tmp_path: Path, mode: int | None, words: str) -> None:
    file = tmp_path / "token"
    if mode is not None:
        file.write_text(TOKEN)
        file.chmod(mode)
    settings = {**TASK, "BRINK_SERVER": "http://127.0.0.1:9", "BRINK_TOKEN_FILE": str(file), "BRINK": "false"}
    done = subprocess.run(
        ["bash", str(SCRIPT)], env=environment(settings), capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert words in done.stderr
    assert TOKEN not in done.stderr
