"""The SLURM script, run by bash as SLURM would run it, against a real coordinator."""

import os
import secrets
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.api import ball, eventually, undisturbed_digest
from support.databases import Databases, on_sqlite
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
    """A coordinator that wants a token."""
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
    """Start a task of the array."""
    settings = {
        **TOY, **TASK, "BRINK": BRINK, "BRINK_SERVER": running.url, "BRINK_TOKEN_FILE": str(token_file),
    }  # fmt: skip
    program = Program(["bash", str(SCRIPT)], cwd=running.folder, env=settings)
    running.workers.append(program)
    return program


def leased(running: Site) -> list[str]:
    told = running.get("/metrics").text.splitlines()
    return [line for line in told if line.startswith("brink_jobs{") and 'status="leased"' in line]


def test_bash_can_read_it() -> None:
    subprocess.run(["bash", "-n", str(SCRIPT)], check=True)


def test_slurm_signals_the_worker_in_time() -> None:
    asked = [
        line.split(maxsplit=1)[1] for line in SCRIPT.read_text().splitlines() if line.startswith("#SBATCH ")
    ]
    assert "--signal=B:TERM@90" in asked, "to the batch shell, whose place the worker takes"
    assert "--cpus-per-task=1" in asked
    assert any(option.startswith("--array=") for option in asked)


@on_sqlite
def test_a_task_works_a_campaign_and_leaves_in_good_order(
    running: Site, token_file: Path, small_problems: None
) -> None:
    started = task(running, token_file)
    campaign = running.submit(ball())
    done = running.await_end(campaign)
    assert (done["status"], done["digest"]) == ("finished", undisturbed_digest(ball()))

    long = running.submit(ball(problem={"id": "ball@1", "params": {"slow_s": 1.0}}))
    # A lease alone says only that the first is about to run; once that is done, the next runs for a second.
    eventually(lambda: running.progress(long)["simulations"] > 0, "the worker has simulated one")
    before = running.progress(long)["simulations"]
    os.killpg(started.process.pid, signal.SIGTERM)  # as scancel does: every process of the task
    assert started.wait() == 0, started.output
    assert leased(running) == [], "what was not simulated was given back"
    assert running.progress(long)["simulations"] > before, "what was running was finished"
    assert "task 3 of job 4711" in started.output
    assert TOKEN not in started.output


@pytest.mark.parametrize(
    ("mode", "words"), [(0o644, "chmod 600"), (0o660, "chmod 600"), (None, "there is no such file")]
)
def test_a_token_that_others_can_read_is_not_used(tmp_path: Path, mode: int | None, words: str) -> None:
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


def test_it_says_that_it_needs_the_address_of_a_coordinator() -> None:
    done = subprocess.run(
        ["bash", str(SCRIPT)], env=environment(TASK), capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    assert "BRINK_SERVER: set it to the URL" in done.stderr
