"""Workers on a real Ray: the same campaign, the same result, whoever dies; and they leave as they should."""

import os
import secrets
import signal
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from support.api import ball, eventually, undisturbed_digest
from support.databases import Databases
from support.processes import BRINK, PATIENCE_S, TOY, Program, Site, site

RAY = str(Path(sys.executable).with_name("ray"))
QUICK = {**TOY, "BRINK_RETRY_BACKOFF_S": "0.05", "BRINK_SWEEP_S": "0.1"}

pytestmark = pytest.mark.long("needs Ray")


@pytest.fixture
def ray_home() -> Iterator[Path]:
    """Where Ray leaves its files and its own token; its sockets want a short path."""
    with tempfile.TemporaryDirectory(prefix="brink-ray-", ignore_cleanup_errors=True) as folder:
        yield Path(folder)


@pytest.fixture
def authentication() -> dict[str, str]:
    """What a user sets so that a cluster requires a token."""
    return {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}


@pytest.fixture
def running(
    databases: Databases, tmp_path: Path, ray_home: Path, authentication: dict[str, str]
) -> Iterator[Site]:
    """A coordinator that wants a token."""
    of_ray = {
        "RAY_TMPDIR": str(ray_home),
        "HOME": str(ray_home),
        "RAY_USAGE_STATS_ENABLED": "0",
        **authentication,
    }
    token = {"BRINK_TOKEN": f"token-{secrets.token_hex(12)}"}
    with databases.database() as url, site(tmp_path, url, {**QUICK, **of_ray, **token}) as made:
        yield made


def pool(running: Site, *arguments: str, **more: str) -> Program:
    """Start a pool of workers."""
    command = [BRINK, "worker", "--server", running.url, "--memory-mib", "512", *arguments]
    program = Program(command, cwd=running.folder, env={**running.env, **more})
    running.workers.append(program)  # killed with the others, and its log shown when a campaign gets stuck
    return program


HEAD = ("--head", "--port=0", "--include-dashboard=false")


@contextmanager
def node(running: Site, *arguments: str, **more: str) -> Iterator[Program]:
    """Have one more node of one CPU in the cluster."""
    command = [
        RAY,
        "start",
        "--num-cpus=1",
        "--min-worker-port=0",
        "--max-worker-port=0",
        "--block",
        *arguments,
    ]
    with Program(command, cwd=running.folder, env={**running.env, **more}) as program:
        try:
            program.await_line("Ray runtime started")
            yield program
        finally:
            program.signal(signal.SIGTERM)
            program.wait()


def address_of(head: Program) -> str:
    """Return the address that the head node of a cluster tells its user."""
    return head.await_line(r"ray start --address='([^']+)'")[1]


def workers(running: Site) -> dict[str, dict[str, Any]]:
    """Return the workers that the coordinator has heard of."""
    return {worker["id"]: worker for worker in running.get("/api/v1/workers").json()}


def leased(running: Site) -> int:
    told = running.get("/metrics").text.splitlines()
    counts = [
        line.split()[-1] for line in told if line.startswith("brink_jobs{") and 'status="leased"' in line
    ]
    return int(sum(map(float, counts)))


def command_lines() -> list[bytes]:
    lines = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            lines.append(path.read_bytes())
        except OSError:
            continue  # it has ended
    return lines


def test_killing_an_actor_changes_no_result(running: Site, ray_home: Path, small_problems: None) -> None:
    started = pool(running, "--ray", "local", "--workers", "2")
    slow = ball(simulations=60, problem={"id": "ball@1", "params": {"slow_s": 0.05}})
    campaign = running.submit(slow)
    running.await_progress(campaign, simulations=5)
    eventually(lambda: len(workers(running)) == 2, "both actors work", PATIENCE_S)
    token = running.env["BRINK_TOKEN"].encode()
    lines = command_lines()
    assert any(line.startswith(b"ray::") for line in lines), "actors are seen"
    assert not any(token in line for line in lines)

    victim = next(iter(workers(running).values()))
    os.kill(victim["pid"], signal.SIGKILL)
    done = running.await_end(campaign)
    assert (done["status"], done["failed"]) == ("finished", 0)
    assert done["digest"] == undisturbed_digest(slow)
    eventually(lambda: len(workers(running)) == 3, "another actor took the dead one's place", PATIENCE_S)
    assert started.await_line(r"worker lost: .* worker=(\S+)")[1] == victim["id"]

    long = running.submit(ball(problem={"id": "ball@1", "params": {"slow_s": 1.0}}))
    eventually(lambda: leased(running) > 2, "the workers hold jobs", PATIENCE_S)
    started.signal(signal.SIGTERM)
    assert started.wait() == 0, started.output
    assert leased(running) == 0, "what was not simulated was given back"
    assert running.progress(long)["simulations"] > 0, "what was running was finished"
    files = [path for path in ray_home.rglob("*") if path.is_file()]
    assert any("raylet" in path.name for path in files)
    assert [path for path in files if token in path.read_bytes()] == [], "Ray wrote the token down"


def test_workers_that_are_refused_end_the_pool(running: Site) -> None:
    started = pool(running, "--ray", "local", "--workers", "3", BRINK_TOKEN="a-wrong-one")
    assert started.wait() == 1
    assert "could not work" in started.output
    assert "token rejected" in started.output, "what the workers said is shown"


def test_a_pool_follows_its_cluster(running: Site) -> None:
    with node(running, *HEAD) as head:
        address = address_of(head)
        started = pool(running, "--ray", "auto", BRINK_LOG_FORMAT="json")
        started.await_line('"message": "worker started"')
        with node(running, f"--address={address}"):
            eventually(lambda: len(workers(running)) == 2, "a worker on the new node", PATIENCE_S)
            assert started.output.count("worker started") == 2
            seen = started.await_line('"message": "worker started".*"worker": "([^"]+)"')[1]
            other = next(iter(set(workers(running)) - {seen}))
        started.await_line(f'"worker left", "worker": "{other}"')
        assert running.await_end(running.submit(ball(simulations=20)))["status"] == "finished"
        started.signal(signal.SIGTERM)
        assert started.wait() == 0, started.output


def test_pictures_are_simulated_on_a_cluster_that_requires_a_token(running: Site) -> None:
    body = {
        "name": "pictures",
        "problem": {"id": "urban-camera@1", "params": {"duration_s": 5.0}},
        "algorithm": {"id": "random@1"},
        "budget": {"simulations": 4},
        "seed": 1,
        "execution": {"cache": False},
    }
    with node(running, *HEAD) as head:
        started = pool(running, "--ray", address_of(head))
        campaign = running.submit(body)
        done = running.await_end(campaign)
        assert (done["status"], done["failed"]) == ("finished", 0)
        solution = f"{running.url}/api/v1/campaigns/{campaign}/solutions/0"
        httpx.post(f"{solution}/trace", headers=running.headers).raise_for_status()
        replay = f"{solution}/replay.png?wait_s=60"
        picture = httpx.get(replay, headers=running.headers, timeout=PATIENCE_S)
        assert picture.content.startswith(b"\x89PNG"), "a worker of the cluster recorded the episode"
        started.signal(signal.SIGTERM)
        assert started.wait() == 0, started.output
    running.start_workers(1)
    again = running.await_end(running.submit(body))
    assert again["digest"] == done["digest"], "as without Ray"


@pytest.mark.parametrize("authentication", [{}], ids=["unset"])
def test_a_local_instance_leaves_no_token_behind(running: Site, ray_home: Path) -> None:
    """With a token in the home folder, every later `ray start --head` of its user would require it."""
    started = pool(running, "--ray", "local", "--workers", "1")
    assert running.await_end(running.submit(ball(simulations=20)))["status"] == "finished"
    started.signal(signal.SIGTERM)
    assert started.wait() == 0, started.output
    assert not (ray_home / ".ray" / "auth_token").exists()
    with node(running, *HEAD) as head:
        started = pool(running, "--ray", address_of(head), "--exit-when-idle-s", "1")
        assert running.await_end(running.submit(ball(seed=2, simulations=20)))["status"] == "finished"
        assert started.wait() == 0, started.output
