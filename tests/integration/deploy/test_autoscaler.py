"""The manifests' own queries start workers of the kind that the queue needs, and none of another kind."""

import math
import os
import secrets
import signal
from pathlib import Path
from typing import Any

import httpx
import pytest
from support.api import FakeWorker, ball, expect, submit
from support.databases import Databases, sqlite_then_postgres
from support.manifests import container, evaluate, extras_of_images, scalings
from support.processes import BRINK, Program, Site, environment, site

from brink.extras import MODULES
from brink.sim.catalogue import EXTRAS, WORKER_KINDS, simulator_ids, worker_kind

PLAIN, VISION = "brink-worker", "brink-worker-vision"


def vision(simulations: int = 20, **changes: Any) -> dict[str, Any]:
    """Return a campaign whose jobs need a camera."""
    return campaign("urban-camera@1", simulations, **changes)


def plain(simulations: int = 20, **changes: Any) -> dict[str, Any]:
    """Return a campaign whose jobs need nothing in particular."""
    return campaign("urban-injected@1", simulations, **changes)


def campaign(problem: str, simulations: int, **changes: Any) -> dict[str, Any]:
    return {
        "name": problem,
        "problem": {"id": problem, "params": {"duration_s": 5.0}},
        "algorithm": {"id": "random@1"},
        "budget": {"simulations": simulations},
        "seed": 1,
        **changes,
    }


def wanted(client: httpx.Client) -> dict[str, int]:
    """Return the number of replicas of each kind of worker."""
    exposition = client.get("/metrics").text
    return {name: scaling.replicas(exposition) for name, scaling in scalings().items()}


def capabilities(deployment: str) -> tuple[str, ...]:
    """Return the simulators that the workers of a Deployment can run, by what is installed in their image."""
    installed = extras_of_images()[container(deployment)["image"]]
    return tuple(
        one
        for one in simulator_ids()
        if worker_kind(one) not in ("function", "other") and EXTRAS.get(one) in (None, *installed)
    )


@pytest.mark.parametrize(
    ("bodies", "replicas"),
    [
        ([], {PLAIN: 0, VISION: 0}),
        ([vision()], {PLAIN: 0, VISION: 5}),
        ([plain()], {PLAIN: 5, VISION: 0}),
        ([vision(), plain(simulations=1)], {PLAIN: 1, VISION: 5}),
        ([vision(simulations=24), vision(simulations=23)], {PLAIN: 0, VISION: 12}),
        ([ball()], {PLAIN: 0, VISION: 0}),
    ],
)
def test_an_autoscaler_starts_the_workers_that_the_queue_needs(
    client: httpx.Client, small_problems: None, bodies: list[dict[str, Any]], replicas: dict[str, int]
) -> None:
    for body in bodies:
        submit(client, body)
    assert wanted(client) == replicas
    for name, number in replicas.items():
        for index in range(number):
            worker = FakeWorker(client, id=f"{name}-{index}", capabilities=capabilities(name))
            assert worker.lease(max_jobs=1), f"worker {index} of {name} has nothing to do"


def test_jobs_of_paused_campaigns_start_no_workers(client: httpx.Client) -> None:
    paused = submit(client, vision())
    expect(client.post(f"/api/v1/campaigns/{paused}/pause"))
    assert wanted(client) == {PLAIN: 0, VISION: 0}
    expect(client.post(f"/api/v1/campaigns/{paused}/resume"))
    assert wanted(client) == {PLAIN: 0, VISION: 5}


@sqlite_then_postgres
def test_every_kind_of_worker_is_reported_even_without_jobs(client: httpx.Client) -> None:
    exposition = client.get("/metrics").text
    for kind in WORKER_KINDS:
        assert evaluate(f'max(brink_open_jobs{{worker="{kind}"}})', exposition) == 0
    assert evaluate('max(brink_open_jobs{worker="none"})', exposition) is None, "KEDA then keeps the number"


def _start(running: Site, deployment: str, folder: Path) -> Program:
    """Start a worker as the Deployment does, without the modules that its image lacks."""
    [name, *options] = container(deployment)["args"]
    given = [one for one in options if not one.startswith(("--server=", "--alive-file=", "--memory-mib="))]
    installed = extras_of_images()[container(deployment)["image"]]
    hidden = [module for extra, modules in MODULES.items() if extra not in installed for module in modules]
    folder.mkdir()
    lines = ["import sys", *(f"sys.modules[{module!r}] = None" for module in hidden)]
    (folder / "sitecustomize.py").write_text("\n".join(lines))
    paths = os.pathsep.join((str(folder), environment()["PYTHONPATH"]))
    command = [BRINK, name, *given, f"--server={running.url}", f"--alive-file={folder / 'alive'}"]
    program = Program(command, cwd=running.folder, env={**running.env, "PYTHONPATH": paths})
    running.workers.append(program)
    return program


@pytest.mark.long("renders camera images")
def test_workers_of_both_kinds_complete_a_mixed_queue(databases: Databases, tmp_path: Path) -> None:
    token = {"BRINK_TOKEN": f"token-{secrets.token_hex(12)}", "OMP_NUM_THREADS": "1"}
    with databases.database() as url, site(tmp_path, url, token) as running:
        pictures = running.submit(vision(simulations=6))
        started: dict[str, list[Program]] = {PLAIN: [], VISION: []}

        def scale() -> dict[str, int]:
            exposition = running.get("/metrics").text
            numbers = {name: scaling.replicas(exposition) for name, scaling in scalings().items()}
            for name, number in numbers.items():
                while len(started[name]) < number:
                    started[name].append(_start(running, name, tmp_path / f"{name}-{len(started[name])}"))
            return numbers

        assert scale() == {PLAIN: 0, VISION: math.ceil(6 / 4)}
        drives = running.submit(plain(simulations=6))
        assert scale()[PLAIN] == 2
        assert running.await_end(pictures)["status"] == "finished"
        assert running.await_end(drives)["status"] == "finished"
        assert scale() == {PLAIN: 0, VISION: 0}
        for name, programs in started.items():
            for program in programs:
                program.signal(signal.SIGTERM)
                assert program.wait() == 0, program.output
                assert ("cannot run brink-aeb@3" in program.output) == (name == PLAIN)
        assert all((tmp_path / f"{name}-0" / "alive").exists() for name in started)
