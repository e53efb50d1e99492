"""Searches for tolerances whose drives a test judges."""

from collections.abc import Mapping
from typing import Any

import httpx
import numpy as np

from brink.server.problems.urban_injected import REQUIREMENTS
from brink.sim.urban.detection_errors import MAGNITUDES, ErrorType
from brink.sim.urban.error_meter import MEASURES
from brink.worker.wire import Completed, JobFailed, LeasedJob, WireVerdict
from support.api import FakeWorker, submit

CELLS = {"type": ["miss", "left"], "target": ["lead", "pedestrian"]}
CONDITIONS = [
    {"name": "by day", "time_of_day": ["noon", "sunset"]},
    {"name": "by night", "time_of_day": "night"},
]


def body(seed: int = 1, simulations: int = 1400, **changes: Any) -> dict[str, Any]:
    """Return the body of a search for tolerances."""
    params = {"cells": CELLS, "conditions": CONDITIONS, "without_error": 25, **changes}
    return {
        "name": f"tolerance-{seed}",
        "problem": {"id": "urban-errors@1", "params": {"errors": 1}},
        "algorithm": {"id": "tolerance@1", "params": params},
        "budget": {"simulations": simulations},
        "seed": seed,
    }


def camera(seed: int = 3) -> dict[str, Any]:
    return {
        "name": "camera",
        "problem": {"id": "urban-camera@1"},
        "algorithm": {"id": "random@1"},
        "budget": {"simulations": 200},
        "seed": seed,
    }


def outcome(unsafe: bool, features: Mapping[str, Any]) -> Completed:
    verdicts = {
        name: WireVerdict(
            robustness=-1.0 if unsafe and name == "front-gap@1" else 1.0, unit="m", violated_at_s=None
        )
        for name in REQUIREMENTS
    }
    return Completed(verdicts=verdicts, features=dict(features))


def judge(job: LeasedJob) -> Completed | JobFailed:
    """Let missing the lead be hazardous from 2 s on in half of the drives, by night more; some violate anyway."""
    spec = job.spec
    chance = np.random.default_rng(spec["seed"] % 2**32).random(2)
    if spec["behaviour"]["mode"] == "detector":
        miss = 6.0 if spec["scenario"]["time_of_day"] == "night" else 0.4
        measures = {"lead": {"miss": miss * chance[1], "left": 0.1}}
        return outcome(bool(chance[0] < 0.1), {MEASURES: measures})
    unsafe = bool(chance[0] < 0.15)
    for error in spec["behaviour"]["errors"]:
        severity = MAGNITUDES[ErrorType(error["type"])].severity(error["magnitude"])
        share = 0.9 if spec["scenario"]["time_of_day"] == "night" else 0.5
        is_hidden = error["type"] == "short_range" and severity == 1.0
        if error["target"] == "lead" and (is_hidden or (error["type"] == "miss" and severity > 0.25)):
            unsafe = unsafe or bool(chance[1] < share)
    return outcome(unsafe, {"error_steps": [[10, 20] for _ in spec["behaviour"]["errors"]], "severity": 0.0})


def finished(client: httpx.Client, document: dict[str, Any]) -> str:
    campaign = submit(client, document)
    needs = ("brink-drive-errors@2", "brink-drive-camera@3")
    done = FakeWorker(client, judge=judge, capabilities=needs).work(campaign)
    assert done["status"] == "finished", done["status_reason"]
    return campaign
