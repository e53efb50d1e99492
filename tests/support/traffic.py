"""Traffic campaigns for tests: a worker that really simulates, and campaigns that a language model seeds."""

from functools import lru_cache
from typing import Any

import httpx
from fastapi.responses import JSONResponse, Response

from brink.sim.encounter.simulator import BrinkEncounter
from brink.sim.episode import EpisodeSpec
from brink.worker.wire import Completed, JobFailed, LeasedJob, WireVerdict
from support.api import FakeWorker, expect
from support.llm_endpoint import MODEL, Asked, Endpoint, action, completion, item, reply_text

POPULATION = 8


@lru_cache
def _simulator() -> BrinkEncounter:
    return BrinkEncounter()


def simulate(job: LeasedJob) -> Completed | JobFailed:
    """Return what the simulator makes of a job."""
    return driven(job.spec)


def driven(spec: Any) -> Completed:
    """Return what the simulator makes of an episode."""
    result = _simulator().run(EpisodeSpec.from_json(spec))
    return Completed(
        verdicts={
            name: WireVerdict(robustness=v.robustness, unit=v.unit, violated_at_s=v.violated_at_s)
            for name, v in result.verdicts.items()
        },
        objectives=dict(result.objectives),
        features=dict(result.features),
    )


def traffic_worker(client: httpx.Client) -> FakeWorker:
    """Return a worker that simulates traffic."""
    return FakeWorker(client, capabilities=("brink-encounter@1",), judge=simulate)


def seeded(endpoint: Endpoint, llm: dict[str, Any] | None = None, **params: Any) -> dict[str, Any]:
    """Return a small campaign whose seeds come from an endpoint."""
    return {
        "name": "seeded",
        "problem": {"id": "npc-actions@1", "params": {"participants": 2, "duration_s": 8.0}},
        "algorithm": {
            "id": "mumoea@1",
            "params": {"seeder": "llm", "population_size": POPULATION, "seeds": 3, "rounds": 1, **params},
        },
        "llm": {"endpoint": endpoint.url, "model": MODEL, "retries": 1, "max_wait_s": 1.0, **(llm or {})},
        "budget": {"simulations": 24},
        "seed": 1,
    }


def origins(client: httpx.Client, campaign: str) -> list[str]:
    """Return where each solution comes from, by number."""
    found = expect(client.get(f"/api/v1/campaigns/{campaign}/solutions", params={"limit": 100}))
    return [solution["origin"] for solution in found["solutions"]]


def in_words(client: httpx.Client, campaign: str) -> list[str]:
    """Return what each solution is in words, by number."""
    found = expect(client.get(f"/api/v1/campaigns/{campaign}/solutions", params={"limit": 100}))
    return [solution["words"] for solution in found["solutions"]]


def calls(client: httpx.Client, campaign: str) -> dict[str, Any]:
    """Return what a campaign asked."""
    found: dict[str, Any] = expect(client.get(f"/api/v1/campaigns/{campaign}/llm-calls"))
    return found


def others(asked: Asked) -> Response:
    """Answer a request for differential seeds, decided by the question."""
    salt = sum(asked.prompt.encode()) % 89
    people = {"kind": "pedestrian", "dd_m": -3.0, "heading": "with_ego", "speed_mps": 1.0}
    found = [
        item(**people, ds_m=5.0 + 0.5 * ((salt + 17 * n) % 89), actions=[action("cross", 4.0, 2.5)] * 2)
        for n in range(6)
    ]
    return JSONResponse(completion(reply_text(found)))
