"""Traffic campaigns for tests: a worker that simulates them, and campaigns that a language model seeds."""

import base64
import json
from functools import cache
from typing import Any

import httpx
from fastapi.responses import JSONResponse, Response

from brink.sim.encounter.simulator import BrinkEncounter
from brink.sim.episode import EpisodeSpec
from brink.worker.wire import Completed, JobFailed, LeasedJob, WireVerdict
from support.api import FakeWorker, expect
from support.llm_endpoint import MODEL, Asked, Endpoint, action, completion, item, reply_text

POPULATION = 8


def simulate(job: LeasedJob) -> Completed | JobFailed:
    """Simulate a job."""
    return driven(job.spec, record=job.record)


def driven(spec: Any, *, record: bool = False) -> Completed:
    """Simulate an episode, unless the same one was simulated before."""
    return _driven(json.dumps(spec, sort_keys=True), record)


@cache
def _simulator() -> BrinkEncounter:
    return BrinkEncounter()


@cache
def _driven(spec: str, record: bool) -> Completed:
    result = _simulator().run(EpisodeSpec.from_json(json.loads(spec)), record=record)
    return Completed(
        verdicts={
            name: WireVerdict(robustness=v.robustness, unit=v.unit, violated_at_s=v.violated_at_s)
            for name, v in result.verdicts.items()
        },
        objectives=dict(result.objectives),
        features=dict(result.features),
        trace=None if result.trace is None else base64.b64encode(result.trace).decode(),
    )


def traffic_worker(client: httpx.Client) -> FakeWorker:
    """Return a worker that simulates traffic."""
    return FakeWorker(client, capabilities=("brink-encounter@2",), judge=simulate)


def seeded(endpoint: Endpoint, llm: dict[str, Any] | None = None, **params: Any) -> dict[str, Any]:
    """Return the body of a small campaign that a language model seeds.

    Args:
        endpoint: Of the language model.
        llm: Changes to the settings of the language model.
        params: Changes to the parameters of the algorithm.
    """
    return {
        "name": "seeded",
        "problem": {"id": "npc-actions@1", "params": {"participants": 2, "duration_s": 5.0}},
        "algorithm": {
            "id": "mumoea@1",
            "params": {"seeder": "llm", "population_size": POPULATION, "seeds": 3, "rounds": 1, **params},
        },
        "llm": {"endpoint": endpoint.url, "model": MODEL, "retries": 1, "max_wait_s": 1.0, **(llm or {})},
        "budget": {"simulations": 24},
        "seed": 1,
    }


def origins(client: httpx.Client, campaign: str) -> list[str]:
    """Return the origin of each solution, by number."""
    found = expect(client.get(f"/api/v1/campaigns/{campaign}/solutions", params={"limit": 100}))
    return [solution["origin"] for solution in found["solutions"]]


def descriptions(client: httpx.Client, campaign: str) -> list[str]:
    """Return the description of each solution, by number."""
    found = expect(client.get(f"/api/v1/campaigns/{campaign}/solutions", params={"limit": 100}))
    return [solution["words"] for solution in found["solutions"]]


def calls(client: httpx.Client, campaign: str) -> dict[str, Any]:
    """Return the calls that a campaign made to the language model."""
    found: dict[str, Any] = expect(client.get(f"/api/v1/campaigns/{campaign}/llm-calls"))
    return found


def differential_seeds(asked: Asked) -> Response:
    """Answer a request for differential seeds; the same request always gets the same answer."""
    salt = sum(asked.prompt.encode()) % 89
    people = {"kind": "pedestrian", "dd_m": -3.0, "heading": "with_ego", "speed_mps": 1.0}
    found = [
        item(**people, ds_m=5.0 + 0.5 * ((salt + 17 * n) % 89), actions=[action("cross", 4.0, 2.5)] * 2)
        for n in range(6)
    ]
    return JSONResponse(completion(reply_text(found)))
