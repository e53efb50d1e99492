"""Detectors that answer with NaN: their jobs fail with a reason, and nothing is called safe."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import TypeAdapter
from support.api import FakeWorker, coordinator, expect, submit
from support.databases import Databases
from support.marks import mostly_long
from support.onnx_file import write_network

from brink.sim import catalogue
from brink.sim.perception.boxes import Detections
from brink.sim.perception.detector import DETECTORS
from brink.worker.child import SimulatorHost
from brink.worker.wire import Completed, JobFailed, LeasedJob

CAMERAS = ("brink-aeb@3", "brink-dataset@2", "brink-drive-camera@3", "brink-encounter-camera@3")
OUTCOME: TypeAdapter[Completed | JobFailed] = TypeAdapter(Completed | JobFailed)
GREY = 114 / 255
"""Mean of the image on which networks are tried when they are loaded."""


class _Nan:
    """A plug-in's detector that is sure of a person whose place it does not know."""

    def detect(self, picture: NDArray[np.uint8]) -> Detections:
        """Return a box of NaN."""
        return Detections(
            labels=np.array([1]),
            boxes=np.full((1, 4), np.nan, np.float32),
            scores=np.array([0.9], np.float32),
        )


@pytest.fixture
def client(databases: Databases, monkeypatch: pytest.MonkeyPatch) -> Iterator[httpx.Client]:
    monkeypatch.setitem(catalogue._registered, DETECTORS, {"nan@1": _Nan})
    with databases.database() as url, coordinator(url) as opened:
        yield opened


def campaign(problem: str, detector: str, **params: Any) -> dict[str, Any]:
    return {
        "name": "blind",
        "problem": {"id": problem, "params": {"detector": detector, **params}},
        "algorithm": {"id": "random@1", "params": {"generation_size": 3}},
        "budget": {"simulations": 3},
        "seed": 1,
        "execution": {"max_attempts": 3, "max_failed_share": 1.0},
    }


def run(client: httpx.Client, body: dict[str, Any]) -> tuple[dict[str, Any], list[JobFailed]]:
    """Run a campaign with real simulators; return its progress and the failures of its jobs."""
    host, failures = SimulatorHost(), list[JobFailed]()

    def judge(job: LeasedJob) -> Completed | JobFailed:
        outcome = OUTCOME.validate_python(host.run(job.spec, record=job.record))
        failures.extend([outcome] if isinstance(outcome, JobFailed) else [])
        return outcome

    done = FakeWorker(client, capabilities=CAMERAS, judge=judge).work(submit(client, body))
    return done, failures


@pytest.mark.parametrize(
    ("problem", "params"),
    mostly_long(
        [
            ("aeb-crossing@1", {}),
            ("urban-camera@1", {}),
            ("npc-actions@1", {"sight": "detector", "participants": 1, "duration_s": 10.0}),
        ],
        [("aeb-crossing@1", {})],
        "another problem with a camera",
    ),
)
@pytest.mark.parametrize("kind", mostly_long(["plug-in", "onnx"], ["onnx"], "another detector"))
def test_an_episode_with_nan_fails_at_once_and_no_solution_is_safe(
    client: httpx.Client, tmp_path: Path, problem: str, params: dict[str, Any], kind: str
) -> None:
    detector, numbers = "nan@1", "0 of 1 scores and 4 of 4 coordinates of boxes"
    if kind == "onnx":  # a network that only fails on what it is shown, not on what it is tried with
        detector = write_network(
            tmp_path / "net.onnx", np.ones((1, 6, 3), np.float32), input_px=(320, 192), nan_unless_mean=GREY
        )
        numbers = "3 of 3 scores"
    done, failures = run(client, campaign(problem, detector, **params))
    assert (done["evaluated"], done["unsafe"], done["failed"]) == (0, 0, 3)
    assert {failure.reason for failure in failures} == {"invalid"}
    assert len(failures) == 3, "none is tried again"
    message = f"{detector.removeprefix('onnx:')}: expected finite scores and boxes, got NaN or infinity in {numbers}"
    assert all(failure.message.startswith(message) for failure in failures)
    found = expect(client.get(f"/api/v1/campaigns/{done['id']}/solutions"))["solutions"]
    assert {solution["verdict"] for solution in found} == {"failed"}


@pytest.mark.long("renders camera images")
def test_a_measurement_on_data_with_nan_fails(client: httpx.Client) -> None:
    body = campaign("aeb-crossing@1", "nan@1", dataset_frames=10)
    body["algorithm"] = {
        "id": "simood-ga@1",
        "params": {"generations": 1, "population_size": 2, "finalists": 1, "repeats": 1},
    }
    body["budget"] = {"simulations": 20}
    done, failures = run(client, body)
    assert done["evaluated"] == 0
    assert failures
    assert all(failure.message.startswith("nan@1: expected finite scores and boxes") for failure in failures)
